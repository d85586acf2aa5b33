"""Every public name has an entry in the reference, and every name of another project has a page to link to."""

import importlib
import inspect
import pkgutil

import pytest

from tests.support.blocks import ROOT

pytestmark = [pytest.mark.docs, pytest.mark.xdist_group("site")]

UNLISTED = {
    "bsk_torch.rl",
    "bsk_torch.viz",
    "bsk_torch.viz.figures",
    "bsk_torch.viz.report",
    "bsk_torch.astro",
    "bsk_torch.formats",
}
UNLISTED |= {
    "bsk_torch.sim",
    "bsk_torch.codegen",
    "bsk_torch.cli",
    "bsk_torch.wrappers.gymnasium",
    "bsk_torch.viewer",
    "bsk_torch.tasks",
}
UNLISTED |= {"bsk_torch.lab", *(f"bsk_torch.lab.{name}" for name in ("agents", "audit", "commands", "risk", "suites"))}
"""Packages without a list of names, with names that another package lists, or that are imported nowhere."""


def packages():
    """Names of the packages of bsk_torch, to the depth to which users import."""
    import bsk_torch

    found = (info.name for info in pkgutil.walk_packages(bsk_torch.__path__, "bsk_torch.") if info.ispkg)
    inside = "bsk_torch.sim.", "bsk_torch.viz.render", "bsk_torch.env.assembly", "bsk_torch.bsk_rl"  # the last has bsk_rl's names
    return [name for name in found if not name.startswith(inside)]


def test_every_public_name_is_in_the_reference(site):
    import sphobjinv

    from docs._ext import public

    entries = {entry.name for entry in sphobjinv.Inventory(str(site / "objects.inv")).objects if entry.domain == "py"}
    names = [name for module in public.modules() for name in module.own if name.kind != "module"]
    assert len(names) > 200
    assert not [name.full for name in names if name.full not in entries]


def test_public_names_have_docstrings_and_packages_are_listed():
    from docs._ext import public

    assert not [name.full for module in public.modules() for name in module.own if not name.documentation]
    listed = {module.name for module in public.modules()} | UNLISTED
    assert not [name for name in packages() if name not in listed]


def test_modules_have_what_they_list():
    from docs._ext import public

    modules = list(public.modules())
    assert len(modules) > 20
    for module in modules:
        loaded = importlib.import_module(module.name)
        assert loaded.__all__, module.name
        assert not [name for name in loaded.__all__ if not hasattr(loaded, name)], module.name


def test_members_of_classes_have_entries(site):
    import sphobjinv

    from docs._ext import public

    entries = {entry.name for entry in sphobjinv.Inventory(str(site / "objects.inv")).objects if entry.domain == "py"}
    classes = [name for module in public.modules() for name in module.of("class")]
    wanted = [f"{name.full}.{member}" for name in classes for member in name.members]
    assert len(wanted) > 300
    assert not [name for name in wanted if name not in entries]


@pytest.mark.parametrize("table", sorted((ROOT / "docs" / "inventories").glob("*.txt")), ids=lambda table: table.stem)
def test_tables_of_other_projects_name_what_exists(table):
    """So that a name which another project drops is noticed; the build's warnings show names that a table lacks."""
    from docs._ext import inventories

    address, rows = inventories.read(table)
    assert address.startswith("https://")
    assert address.endswith("/")
    for role, name, page in rows:
        assert role == "py:class"
        assert not page.startswith("/")
        assert inspect.isclass(pkgutil.resolve_name(name)) or name.startswith("collections.abc"), name
