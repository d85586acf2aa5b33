"""Names, units and values of all arguments equal bsk_rl's, as ``scripts/recorders/record_arguments.py`` recorded them."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bsk_torch import make, rand, sats
from bsk_torch.rand import Distribution
from bsk_torch.sim import dyn, fsw, world
from bsk_torch.sim.arguments.sources import OPTIONAL, RANKS, in_order
from bsk_torch.sim.arguments.table import short
from tests.support.core_arguments import SPACECRAFT

RECORDED = json.loads((Path(__file__).parents[1] / "data" / "default_args.json").read_text())

POINTING = {"groundLocationPlanetRadius", "imageTargetMinimumElevation", "imageTargetMaximumRange"}
"""Arguments of bsk_rl's dynamics that the flight software has here; every imaging satellite has both."""

AXIS = {"inst_pHat_B"}
"""Argument that every flight software which points at nadir has here."""


def equal(mine: Any, recorded: Any) -> bool:
    """Whether a default is what bsk_rl has."""
    if recorded == "drawn":
        return isinstance(mine, Distribution)
    if mine is None or isinstance(mine, str | bool) or recorded is None:
        return mine == recorded
    if isinstance(recorded, list) and isinstance(recorded[0], dict):
        return [dict(station) for station in mine] == recorded
    return bool(np.allclose(np.ravel(np.asarray(mine, float)), np.ravel(recorded), rtol=1e-12, atol=0.0))


def models(module: Any, kind: str) -> list[Any]:
    return [pytest.param(getattr(module, name), recorded, id=name) for name, recorded in RECORDED[kind].items()]


def check(mine: dict[str, Any], recorded: dict[str, Any], elsewhere: set[str]) -> None:
    lacking = [name for name in recorded if name not in mine and name not in elsewhere]
    assert not lacking
    different = {name: (mine[name], value) for name, value in recorded.items() if name in mine and not equal(mine[name], value)}
    assert not different
    assert not [name for name in mine if name not in recorded and name not in elsewhere]


@pytest.mark.parametrize(("model", "recorded"), models(dyn, "dyn"))
def test_dynamics_have_the_defaults_of_bsk_rl(model, recorded):
    check(
        {arg.name: arg.default for part in model.all_components() for arg in part.args},
        recorded,
        {"utc_init"} | POINTING | SPACECRAFT,
    )


@pytest.mark.parametrize(("model", "recorded"), models(fsw, "fsw"))
def test_flight_software_has_the_defaults_of_bsk_rl(model, recorded):
    check({arg.name: arg.default for part in model.all_components() for arg in part.args}, recorded, POINTING | SPACECRAFT | AXIS)


def test_where_an_image_is_taken_has_the_defaults_of_bsk_rl():
    recorded = RECORDED["dyn"]["ImagingDynModel"]
    mine = sats.ImagingSatellite.default_sat_args()
    assert all(equal(mine[name], recorded[name]) for name in POINTING)


@pytest.mark.parametrize(("model", "recorded"), models(world, "world"))
def test_worlds_have_the_defaults_of_bsk_rl(model, recorded):
    values = {arg.name: arg.default for part in model.all_components() for arg in part.args}
    assert values.pop("groundLocationPlanetRadius", None) is None  # stations lie on the ellipsoid, unless bsk_rl is asked for
    check(values, recorded, {"groundLocationPlanetRadius", "earthRotation"})


def test_functions_are_called_in_the_order_of_bsk_rl():
    """World, flight software, dynamics; arguments that the world and imaging share stand with the world."""
    for kind in ("dyn", "fsw"):
        for recorded in RECORDED[kind].values():
            names = [name for name in recorded if name not in ("utc_init", "groundLocationPlanetRadius")]
            assert in_order(sorted(names)) == names
    assert in_order(["zeta", "mass", "K", "alpha"]) == ["K", "mass", "zeta", "alpha"]
    assert {name for kind in RECORDED.values() for model in kind.values() for name in model} == set(RANKS)


def test_an_environment_shows_its_values_before_the_defaults():
    env = make("NadirScan-v1", num_envs=2, backend="eager")
    table = env.default_sat_args()
    assert table["panelArea"] == 1.0  # as the name says
    lines = str(table).splitlines()
    assert lines[0].split() == ["argument", "here", "default", "unit", "meaning"]
    changed = [line.split()[0] for line in lines[1 : len(table.here) + 1]]
    assert set(changed) == set(table.here) >= {"panelArea", "batteryStorageCapacity", "basePowerDraw", "storageInit"}
    assert [line.split()[1:3] for line in lines if line.startswith("panelArea")] == [["0.25", "1"]]
    env.set_sat_args({"panelArea": 0.5})
    lines = str(env.default_sat_args()).splitlines()
    assert [line.split()[1:3] for line in lines if line.startswith("panelArea")] == [["0.5", "1"]]
    assert len(str(type(env.builder.satellites[0]).default_sat_args()).splitlines()) == len(table)  # no environment, no values


def test_values_are_shown_without_what_says_nothing():
    assert short(rand.Uniform(216000.0, 720000.0)) == "Uniform(216000, 720000)"
    assert short(rand.Normal(0.0, 1e-4, size=3)) == "Normal(0, 0.0001, size=3)"
    assert (short((1.0, 0, -0.5)), short(None)) == ("(1, 0, -0.5)", "None")


def test_arguments_of_optional_models_are_named():
    """What an error advises is what these models declare, and no other model has."""
    models = dyn.NavigationErrorsDynModel, dyn.TorqueBarsDynModel, fsw.MagneticUnloadingFSWModel
    declared = {
        arg.name: f"{model.__module__.split('.')[2]}.{model.__name__}"
        for model in models
        for part in vars(model)["components"]
        for arg in part.args
    }
    assert declared | {"instruments": "dyn.ImagingDynModel"} == OPTIONAL  # not of the models of scanning, which derive from it
