"""Every public name of bsk_rl is at its place, or answered with advice and listed among unsupported features."""

import importlib
import json
import pkgutil
import re
from pathlib import Path

import pytest

MODULES = json.loads((Path(__file__).parent / "data" / "names.json").read_text())
"""Public names of bsk_rl 1.3.8 by module below its root."""

PLACES = list(MODULES)
PAGE = Path(__file__).parents[2] / "docs" / "migration.md"
ENVIRONMENTS = {"ConstellationTasking", "GeneralSatelliteTasking", "SatelliteTasking"}
NAMES = [(module, name) for module in PLACES for name in MODULES[module]]


def test_the_tables_of_names_are_there():
    assert len(PLACES) > 50
    assert len(NAMES) > 250


def answer(holder, name):
    try:
        return getattr(holder, name)
    except ImportError as error:
        return error


@pytest.mark.parametrize("module", PLACES)
def test_names_are_there_or_answered(module):
    holder = importlib.import_module(f"bsk_torch.bsk_rl.{module}".rstrip("."))
    names = MODULES[module]
    assert names or module == "utils"
    elsewhere = ENVIRONMENTS if module.startswith("utils") else set()  # bsk_rl imports them there
    for name in sorted(set(names) - elsewhere - {"NO_ACTION"}):
        found = answer(holder, name)
        if isinstance(found, ImportError):
            assert name in str(found)
            assert len(str(found)) > len(name) + 30, "an answer without advice"
        else:
            assert getattr(found, "__module__", "bsk_torch").startswith(("bsk_torch", "typing", "builtins", "collections"))


def test_answered_names_are_listed_as_unsupported():
    unsupported = PAGE.read_text().partition("## Unsupported features")[2].partition("\n## ")[0]
    listed = set(re.findall(r"`(\w+)`", unsupported))
    places = [(module, name) for module, name in NAMES if name not in ENVIRONMENTS | {"NO_ACTION"}]
    found = {name: answer(importlib.import_module(f"bsk_torch.bsk_rl.{module}"), name) for module, name in places}
    answered = {name for name, value in found.items() if isinstance(value, ImportError)}
    assert answered
    assert answered <= listed


@pytest.mark.basilisk
def test_the_table_has_every_public_name_of_bsk_rl():
    """``__all__`` of every module, and the classes and functions that it defines; modules of RLlib need Ray."""
    import bsk_rl

    parts = [part.name for part in pkgutil.walk_packages(bsk_rl.__path__, "bsk_rl.")]
    missing = []
    for name in (part for part in parts if not part.startswith(("bsk_rl.finish_install", "bsk_rl.utils.rllib"))):
        module, place = importlib.import_module(name), name.removeprefix("bsk_rl.")
        kinds = {key for key, value in vars(module).items() if callable(value) and getattr(value, "__module__", "") == name}
        public = {key for key in kinds if not key.startswith("_")} - {"P", "T"} | {*getattr(module, "__all__", ())}
        missing += sorted(f"{place}.{key}" for key in public - set(MODULES.get(place, [])))
    assert not missing
