"""Models and worlds as bsk_rl programs write them."""

from __future__ import annotations

from typing import Any

import pytest

from bsk_torch import SatelliteTasking, act, obs, sats
from bsk_torch.sim import dyn, fsw, world
from tests.idioms.runner import Idiom, run, title


class Base(sats.Satellite):
    observation_spec = (obs.Time(),)
    action_spec = (act.Drift(duration=30.0),)


def subclass(**members: Any) -> type[sats.Satellite]:
    """What a class statement with these members makes."""
    return type("MySat", (Base,), members)


def bases(kind: str, *names: str) -> Any:
    """A check of the models of which a satellite's is composed."""
    return lambda sat: [base.__name__ for base in getattr(sat, kind).__mro__ if base.__name__ in names] == list(names)


def builds(satellite: type[sats.Satellite], **options: Any) -> bool:
    env = SatelliteTasking(satellite("Sat1"), backend="eager", time_limit=60.0, **options)
    return bool(env.reset()["observation"].isfinite().all())


IDIOMS: list[Idiom] = [
    (
        "MySat(dyn_type=(dyn.ContinuousImagingDynModel, dyn.GroundStationDynModel))",
        bases("dyn_type", "ContinuousImagingDynModel", "GroundStationDynModel", "ImagingDynModel", "DynamicsModel"),
    ),
    (
        "MySat(dyn_type=[dyn.GroundStationDynModel, dyn.LOSCommDynModel, dyn.ImagingDynModel])",
        bases("dyn_type", "GroundStationDynModel", "ImagingDynModel", "LOSCommDynModel"),
    ),
    ("MySat(dyn_type=dyn.FullFeaturedDynModel)", bases("dyn_type", "GroundStationDynModel", "LOSCommDynModel")),
    ("MySat(fsw_type=(fsw.SteeringFSWModel, fsw.ImagingFSWModel))", bases("fsw_type", "SteeringFSWModel", "ImagingFSWModel")),
    ("MySat(dyn_type=(dyn.BasicDynamicsModel,), fsw_type=(fsw.BasicFSWModel,))", builds),
    ("MySat(dyn_type=dyn.DynamicsModel, fsw_type=fsw.FSWModel)", builds),
    ("MySat(dyn_type=(dyn.EclipseDynModel, dyn.DisturbanceTorqueDynModel), fsw_type=fsw.FSWModel)", builds),
    ("MySat(dyn_type=dyn.ContinuousImagingDynModel, fsw_type=fsw.ContinuousImagingFSWModel)", builds),
    (
        "MySat(dyn_type=dyn.DynamicsModel, fsw_type=fsw.FSWModel, action_spec=[act.NadirPoint(duration=60.0), act.Drift()])",
        builds,
    ),
    (
        "MySat(dyn_type=dyn.ContinuousImagingDynModel, fsw_type=fsw.ContinuousImagingFSWModel, "
        "action_spec=[act.Scan(duration=60.0), act.Charge(duration=600.0), act.Downlink(duration=60.0)])",
        builds,
    ),
    ("MySat().default_sat_args(mass=200.0)['mass']", lambda mass: mass == 200.0),
    ("MySat()('Sat1', sat_args=MySat().default_sat_args(K=7.0, P=35.0))", lambda sat: sat.sat_args_generator["P"] == 35.0),
    ("MySat(dyn_type=dyn.ImagingDynModel).get_dyn_type()", lambda model: issubclass(model, dyn.ImagingDynModel)),
    ("MySat().get_fsw_type()", lambda model: issubclass(model, fsw.BasicFSWModel)),
    ("world.GroundStationWorldModel.default_world_args(gsMaximumRange=2e6)['gsMaximumRange']", lambda value: value == 2e6),
    ("world.WorldModel.default_world_args()", lambda args: set(args) == {"utc_init"}),
    ("act.DiscreteFSWAction('action_nadir_point', duration=30.0).name", lambda name: name == "action_nadir_point"),
]


@pytest.mark.parametrize("idiom", IDIOMS, ids=title)
def test_models_as_bsk_rl_writes_them(idiom):
    line, check = idiom
    assert check(run(line, MySat=subclass, world=world))


def arguments_of_the_world(options: dict[str, Any]) -> set[str]:
    """Names of the arguments of the world of a passive satellite's environment."""
    satellite = subclass(dyn_type=dyn.EclipseDynModel, fsw_type=fsw.FSWModel)
    return set(SatelliteTasking(satellite("Sat1"), backend="eager", time_limit=60.0, **options).default_world_args())


WORLDS: list[Idiom] = [
    ("dict(world_type=world.EclipseWorldModel)", lambda names: names == {"utc_init"}),
    (
        "dict(world_type=(world.EclipseWorldModel, world.GroundStationWorldModel), world_args=dict(gsMinimumElevation=0.1))",
        lambda names: "groundStationsData" in names,
    ),
    ("dict(world_type=[world.AtmosphereWorldModel, world.EclipseWorldModel])", lambda names: "scaleHeight" in names),
    ("dict(world_type=None, world_args=None)", lambda names: names == {"utc_init"}),
]


@pytest.mark.parametrize("idiom", WORLDS, ids=title)
def test_worlds_as_bsk_rl_passes_them(idiom):
    line, check = idiom
    assert check(arguments_of_the_world(run(line, world=world)))
