"""Every module and public name of bsk_rl 1.3.8 can be imported, or its import says what to write instead."""

import importlib
import math

import pytest

from bsk_torch._bsk_rl import ADVICE, MODULES, NotInBskTorchError, lookup, place

NAMES = [(module, name) for module, (_, names) in MODULES.items() for name in names.split()]
HERE = [(module, name) for module, name in NAMES if name not in ADVICE]


@pytest.mark.parametrize(("module", "name"), NAMES, ids=[f"{module}.{name}" for module, name in NAMES])
def test_a_name_is_found_or_answered(module, name):
    holder = importlib.import_module(place(module))
    if name in ADVICE and name not in vars(holder):
        with pytest.raises(ImportError, match=rf"bsk_rl's {name} "):
            exec(f"from {place(module)} import {name}", {})
        with pytest.raises(NotInBskTorchError):
            getattr(holder, name)
    else:
        assert getattr(holder, name).__name__ == name if name != "NO_ACTION" else getattr(holder, name) == 2**31 - 1


def test_many_names_are_there():
    assert len(HERE) > 100


def test_no_advice_is_given_for_what_is_there():
    homes = [(name, importlib.import_module(place(home))) for module, name in NAMES for home in MODULES[module][0].split()]
    assert not [f"{home.__name__}.{name}" for name, home in homes if name in ADVICE and name in vars(home)]


@pytest.mark.parametrize("module", MODULES)
def test_modules_lead_to_their_submodules(module):
    found = importlib.import_module(place(module))
    for part in module.split(".") if module else []:
        assert part in found.__name__
    assert importlib.import_module(place(module)) is found


def test_modules_can_be_reached_as_attributes():
    import bsk_torch

    assert bsk_torch.utils.orbital.random_orbit is bsk_torch.rand.random_orbit
    assert "rv2HN" in dir(bsk_torch.utils.orbital)
    assert "TrajectorySimulator" not in dir(bsk_torch.utils.orbital)


@pytest.mark.parametrize("module", ["utils.orbital", "act", "sim.dyn.base"])
def test_what_bsk_rl_does_not_have_either_is_an_ordinary_error(module):
    holder = importlib.import_module(place(module))
    assert not hasattr(holder, "warp_drive")
    with pytest.raises(AttributeError, match="no attribute 'warp_drive'"):
        lookup(module, "warp_drive")
    with pytest.raises(ModuleNotFoundError):
        importlib.import_module(f"{place(module)}.warp_drive")


def test_an_object_is_the_one_of_this_package():
    from bsk_torch.sim.dyn.base import BasicDynamicsModel

    from bsk_torch import scene
    from bsk_torch.scene.targets import TargetScenario, UniformTargets
    from bsk_torch.sim.dyn.models import BasicDynamicsModel as Model

    assert UniformTargets is scene.UniformTargets
    assert issubclass(UniformTargets, TargetScenario)
    assert BasicDynamicsModel is Model
    assert math.isclose(lookup("utils.orbital", "lla2ecef")(90.0, 0.0, 2.0)[2], 2.0)
