"""Every name of bsk_rl's utilities, scenarios, data and communication is at its place, or answered with advice."""

import importlib

import pytest

from bsk_torch._bsk_rl import MODULES

PLACES = [module for module in MODULES if module.split(".")[0] in ("utils", "scene", "data", "comm")]
ENVIRONMENTS = {"ConstellationTasking", "GeneralSatelliteTasking", "SatelliteTasking"}
NAMES = [(module, name) for module in PLACES for name in MODULES[module][1].split()]


def test_the_tables_of_names_are_there():
    assert len(PLACES) > 20
    assert len(NAMES) > 100


def answer(holder, name):
    try:
        return getattr(holder, name)
    except ImportError as error:
        return error


@pytest.mark.parametrize("module", PLACES)
def test_names_are_there_or_answered(module):
    holder = importlib.import_module(f"bsk_torch.bsk_rl.{module}")
    names = MODULES[module][1].split()
    assert names or module == "utils"
    for name in sorted(set(names) - ENVIRONMENTS):  # those are of bsk_rl.gym
        found = answer(holder, name)
        if isinstance(found, ImportError):
            assert name in str(found)
            assert len(str(found)) > len(name) + 30, "an answer without advice"
        else:
            assert getattr(found, "__module__", "bsk_torch").startswith(("bsk_torch", "typing", "builtins"))


def test_a_name_that_nobody_has_is_an_attribute_error():
    for module in ("scene", "data", "utils.rso_imaging", "utils.rllib.callbacks"):
        with pytest.raises(AttributeError, match="no_such_name"):
            _ = importlib.import_module(f"bsk_torch.bsk_rl.{module}").no_such_name
