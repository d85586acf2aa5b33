"""Names of earlier releases still work: they are the new objects, and warn once."""

from __future__ import annotations

import importlib
import operator
import pickle
import subprocess
import sys
import warnings
from typing import Any

import pytest
import torch

from bsk_torch import SatelliteTasking
from bsk_torch._deprecated import ATTRIBUTES, MODULES, NAMES, REMOVED_IN, SPLIT
from bsk_torch.presets.nadir_scan import ScanningSatellite

RENAMED = [(module, old) for module, names in NAMES.items() for old in names]
OLD_ATTRIBUTES = [(owner, old, new) for owner, names in ATTRIBUTES.items() for old, new in names.items()]


@pytest.fixture(autouse=True)
def fresh(monkeypatch):
    """No old name has been used, and those that a test uses are forgotten after it."""
    for old in MODULES:
        monkeypatch.delitem(sys.modules, old, raising=False)
    before = set(sys.modules)
    yield
    for name in set(sys.modules) - before:
        if name.startswith(tuple(MODULES)):
            del sys.modules[name]


def used(action: Any) -> tuple[Any, list[warnings.WarningMessage]]:
    """What ``action`` returns, and the warnings that doing it twice gives."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        first, second = action(), action()
    assert first is second
    return first, [warning for warning in caught if warning.category is DeprecationWarning]


def message(old: str, new: str) -> str:
    return f"{old} is deprecated and will be removed in bsk_torch {REMOVED_IN}; use {new}"


@pytest.mark.parametrize("old", MODULES)
def test_a_moved_module_is_the_new_one_and_warns_once(old):
    new = importlib.import_module(MODULES[old])
    spec, path = new.__spec__, getattr(new, "__path__", None)
    found, warned = used(lambda: importlib.import_module(old))
    assert found is new
    parents = [parent for parent in MODULES if old.startswith(f"{parent}.")]
    assert [str(warning.message) for warning in warned] == [message(name, MODULES[name]) for name in [*parents, old]]
    assert (new.__spec__, getattr(new, "__path__", None)) == (spec, path)
    assert new.__name__ == MODULES[old]


@pytest.mark.parametrize("old", SPLIT)
def test_contents_of_a_module_that_is_a_package_now_are_found(old):
    package, new = importlib.import_module(old), importlib.import_module(SPLIT[old])
    contents = [name for name, value in vars(new).items() if getattr(value, "__module__", None) == new.__name__]
    names = [name for name in contents if not name.startswith("_") and name not in getattr(package, "__all__", ())]
    assert names
    for name in names:
        found, warned = used(lambda name=name: getattr(package, name))
        assert found is getattr(new, name)
        assert [str(warning.message) for warning in warned] == [message(f"{old}.{name}", f"{new.__name__}.{name}")]
        delattr(package, name)


@pytest.mark.parametrize(("module", "old"), RENAMED)
def test_a_renamed_object_is_the_new_one_and_warns_once(module, old):
    place, _, new = NAMES[module][old].rpartition(":")
    holder = importlib.import_module(module)
    vars(holder).pop(old, None)
    found, warned = used(lambda: getattr(holder, old))
    assert found is getattr(importlib.import_module(place or module), new)
    assert [str(warning.message) for warning in warned] == [message(f"{module}.{old}", f"{place or module}.{new}")]
    delattr(holder, old)


def equal(first: Any, second: Any) -> bool:
    """Whether two attributes are the same object, or equal values that a property computes at each read."""
    if isinstance(first, torch.Tensor):
        return torch.equal(first, second)
    if isinstance(first, dict):
        return first.keys() == second.keys() and all(equal(value, second[name]) for name, value in first.items())
    return first is second or first == second


@pytest.fixture(scope="module")
def owners():
    """An object of each class with renamed attributes, by the name of the class."""
    env = SatelliteTasking(ScanningSatellite("A"), num_envs=2, backend="eager", time_limit=300.0)
    env.reset(seed=0)
    simulator = env.simulator
    return {
        "Fleet": env.fleet,
        "Satellite": env.satellites[0],
        "Simulator": simulator,
        "Tasking": env,
        "World": simulator.world,
    }


@pytest.mark.parametrize(("owner", "old", "new"), OLD_ATTRIBUTES)
def test_a_renamed_attribute_is_the_new_one_and_warns(owners, owner, old, new):
    instance = owners[owner]
    title = type(instance).__name__
    with pytest.warns(DeprecationWarning, match=f"{old} is deprecated") as warned:
        found = getattr(instance, old)
    assert equal(found, operator.attrgetter(new)(instance))
    assert [str(warning.message) for warning in warned] == [message(f"{title}.{old}", f"{title}.{new}")]
    assert warned[0].filename == __file__


def test_setting_a_renamed_attribute_sets_the_new_one(owners):
    env = owners["Tasking"]
    with pytest.warns(DeprecationWarning, match="use SatelliteTasking.state.seed"):
        env.seed_rows = torch.tensor([5, 7])
    assert env.state.seed.tolist() == [5, 7]


def test_memory_still_adds_tensors(owners):
    memory = owners["Simulator"].memory
    with pytest.warns(DeprecationWarning, match=r"use memory\.declare") as warned:
        memory.add("visits", -1, 3)
    assert memory["visits"].tolist() == [[-1] * 3] * 2
    assert memory["visits"].dtype == torch.int64
    assert warned[0].filename == __file__
    with pytest.raises(TypeError, match=r"table='0' must be a StateTable; declare\(name, initial\)"):
        memory.add("visits", "0")


def test_satellites_that_define_equip_are_bound_once():
    class Bound(ScanningSatellite):
        def on_bind(self):
            super().on_bind()
            calls.append("on_bind")

    with pytest.warns(DeprecationWarning, match=r"Mine\.equip is deprecated .* use Mine\.on_bind") as warned:

        class Mine(Bound):
            def equip(self):
                super().equip()
                calls.append("equip")
                self.simulator.memory.declare("visits", 4)

    assert warned[0].filename == __file__
    calls: list[str] = []
    env = SatelliteTasking(Mine("A"), num_envs=2, backend="eager", time_limit=300.0)
    assert calls == ["on_bind", "equip"] * 2  # of the trial, and of the environment
    assert env.simulator.memory["visits"].tolist() == [4, 4]


def test_rows_lead_to_names_that_are_not_deprecated():
    assert not MODULES.keys() & {*MODULES.values(), *SPLIT, *SPLIT.values(), *NAMES}
    assert not SPLIT.keys() & set(SPLIT.values())


def test_submodules_move_with_their_package():
    with pytest.warns(DeprecationWarning, match="use bsk_torch.codegen"):
        assert importlib.import_module("bsk_torch.lanes.build") is importlib.import_module("bsk_torch.codegen.build")


def test_the_warning_points_to_the_users_line():
    code = "import bsk_torch\nimport bsk_torch.sim.sky\nfrom bsk_torch.sim.orbit import Arcs\n"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    lines = [line.split(": ")[0] for line in result.stderr.splitlines() if "DeprecationWarning" in line]
    assert lines == ["<string>:2", "<string>:3"]


def test_unknown_names_are_refused_as_usual():
    with pytest.raises(AttributeError, match="no attribute 'Orbits'"):
        importlib.import_module("bsk_torch.sim.orbit").Orbits  # noqa: B018
    with pytest.raises(ModuleNotFoundError), pytest.warns(DeprecationWarning, match="bsk_torch.lanes"):
        importlib.import_module("bsk_torch.lanes.nothing")


def test_pickles_of_earlier_releases_find_their_classes():
    for module, name, new in (
        ("bsk_torch.rl.networks", "Recall", "bsk_torch.rl.networks.plans"),  # a package now
        ("bsk_torch.rl.evaluate", "Evaluation", "bsk_torch.rl.evaluation.evaluate"),  # moved
    ):
        with pytest.warns(DeprecationWarning, match=module):
            found = pickle.loads(f"c{module}\n{name}\n.".encode())
        assert found.__module__ == new


def test_importing_the_package_is_silent():
    subprocess.run([sys.executable, "-W", "error", "-c", "import bsk_torch"], check=True)
