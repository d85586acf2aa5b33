"""Models of several classes: which one wins, what they require, and what is no model."""

import pickle
from typing import ClassVar

import pytest
import torch

from bsk_torch import SatelliteTasking, act, obs, sats
from bsk_torch.env.assembly.types import same_type
from bsk_torch.sim import dyn, fsw, world
from bsk_torch.sim.assembly.composition import compose, providers, world_components, world_of
from bsk_torch.sim.component import Arg, Component, Field
from bsk_torch.sim.schedule import SCHEDULE
from tests.support.refusals import check_refusals, refusal


def heat(bus) -> None:
    """Draw power."""
    bus.power = bus.power + bus.heater_power


def heater(default: float) -> Component:
    return Component(
        "heater",
        heat,
        (Arg("heaterPower", default, "W", "power"),),
        params=(Field("heater_power"),),
        prepare=lambda args: {"heater_power": args["heaterPower"]},
        after="base_power",
    )


class WarmDynModel(dyn.BasicDynamicsModel):
    components = (heater(-1.0),)

    @property
    def warmth(self) -> str:
        return "warm"


class HotDynModel(dyn.BasicDynamicsModel):
    components = (heater(-9.0),)

    @property
    def warmth(self) -> str:
        return "hot"


class SafeFSWModel(fsw.FSWModel):
    modes: ClassVar = {"drift": fsw.Mode(("nadir_on",)), "safe": fsw.Mode(("control_on",))}


class Composed(sats.Satellite):
    observation_spec = (obs.Time(),)
    action_spec = (act.Drift(duration=30.0),)
    dyn_type = (WarmDynModel, HotDynModel, dyn.LOSCommDynModel, dyn.BasicDynamicsModel, WarmDynModel)
    fsw_type = (SafeFSWModel, fsw.BasicFSWModel)


def slots(model: type) -> list[str]:
    return [component.slot for component in model.all_components()]


def test_several_models_are_composed_and_one_stands_for_itself():
    assert Composed.dyn_type.__bases__ == (WarmDynModel, HotDynModel, dyn.LOSCommDynModel)
    assert Composed.default_sat_args()["heaterPower"] == -1.0
    assert Composed.dyn_type.warmth is WarmDynModel.warmth
    assert Composed.dyn_type.__name__ == "Dyn(WarmDynModel, HotDynModel, LOSCommDynModel)"
    assert compose(dyn.ImagingDynModel, dyn.DynamicsModel) is dyn.ImagingDynModel
    assert compose([dyn.ImagingDynModel, dyn.EclipseDynModel], dyn.DynamicsModel) is dyn.ImagingDynModel
    assert compose((), fsw.FSWModel) is fsw.FSWModel


def test_modes_resolve_by_the_same_order_and_components_run_in_that_of_the_schedule():
    modes = Composed.fsw_type.all_modes()
    assert modes["drift"].on == ("nadir_on",)
    assert {"safe", "charge"} <= modes.keys()
    places = [SCHEDULE.place(component) for component in Composed.dyn_type.all_components()]
    assert places == sorted(places)
    assert "heater" in slots(Composed.dyn_type)


def test_models_of_subclasses_and_later_ones_are_composed():
    """bsk_rl keeps what it has composed on the class, where subclasses find it."""
    Composed.default_sat_args()
    other = type("Other", (Composed,), {"dyn_type": (dyn.ImagingDynModel, HotDynModel)})
    assert other.default_sat_args()["heaterPower"] == -9.0
    assert other.get_dyn_type() is other.dyn_type
    assert Composed.default_sat_args()["heaterPower"] == -1.0
    late = type("Late", (Composed,), {})
    late.dyn_type = (dyn.LOSCommDynModel, dyn.BasicDynamicsModel)
    assert late("A").dyn_type.__bases__ == (dyn.LOSCommDynModel, dyn.BasicDynamicsModel)


def test_satellites_of_composed_models_are_simulated_together_and_pickled():
    one, other = Composed("A", dict(heaterPower=-2.0)), Composed("B")
    assert same_type(one, other)
    env = SatelliteTasking(one, num_envs=2, backend="eager", time_limit=60.0, seed=0)
    assert isinstance(env.satellite.dynamics, WarmDynModel)
    assert env.satellite.dynamics.warmth == "warm"
    env.reset()
    assert (env.satellite.sat_args["heaterPower"] == -2.0).all()
    assert pickle.loads(pickle.dumps(env)).satellite.dyn_type is Composed.dyn_type


def build(base: type, members: dict, **options):
    return SatelliteTasking(type("Mine", (base,), members)("A"), time_limit=60.0, **{"backend": "eager"} | options)


def test_rejects_entries_that_are_no_models():
    def define(**members):
        return type("Mine", (sats.Satellite,), members)

    flight, worlds = (fsw.FSWModel, dyn.DynamicsModel), (dyn.ImagingDynModel, world.EclipseWorldModel)
    less, lacking = world.EclipseWorldModel, ("world_type=EclipseWorldModel", "AtmosphereWorldModel", "Dyn(EclipseDynModel, ")
    check_refusals(
        refusal(lambda: define(dyn_type=fsw.BasicFSWModel), TypeError, "Mine.dyn_type", "BasicFSWModel", "fsw_type"),
        refusal(lambda: define(fsw_type=flight), TypeError, "Mine.fsw_type", "DynamicsModel", "dyn_type"),
        refusal(lambda: define(dyn_type=worlds), TypeError, "Mine.dyn_type", "EclipseWorldModel", "world_type"),
        refusal(lambda: define(dyn_type="ImagingDynModel"), TypeError, "Mine.dyn_type", "'ImagingDynModel'", "dyn.Imaging"),
        refusal(lambda: define(fsw_type=None), TypeError, "Mine.fsw_type", "None", "fsw.ImagingFSWModel"),
        refusal(lambda: build(Passive, {}, world_type=less), TypeError, *lacking),
        refusal(lambda: build(Passive, {}, world_type=flight[1]), TypeError, "world_type", "DynamicsModel", "dyn_type"),
    )


def test_flight_software_without_the_devices_that_it_commands_is_refused():
    """bsk_rl raises TypeError too, at reset."""
    bare, names = {"dyn_type": dyn.EclipseDynModel, "fsw_type": fsw.BasicFSWModel}, ("BasicFSWModel", "EclipseDynModel")
    check_refusals(refusal(lambda: build(Composed, bare), TypeError, "BasicDynamicsModel", "dyn_type", *names))


def test_the_model_for_everything_warns_as_in_bsk_rl():
    assert issubclass(dyn.FullFeaturedDynModel, (dyn.GroundStationDynModel, dyn.LOSCommDynModel))
    with pytest.warns(DeprecationWarning, match=r"dyn_type = \(dyn.GroundStationDynModel, dyn.LOSCommDynModel\)"):
        dyn.FullFeaturedDynModel(simulator=None)


def listen(bus) -> None:
    """Read what a satellite without stations lacks."""
    bus.heard = bus.heard + bus.station_access


RADIO = Component(
    "radio", listen, state=(Field("heard"),), initial=lambda args: {"heard": torch.zeros(1).double()}, after="transmitter"
)


def test_rejects_reads_that_nothing_answers():
    listening = type("Listening", (dyn.EclipseDynModel,), {"components": (RADIO,)})
    mine = {"dyn_type": listening, "fsw_type": fsw.FSWModel}
    tanks = type("Tanks", (dyn.DynamicsModel,), {"tanks": dyn.observable(lambda now: now.charge)})

    def observe(prop: str):
        spec = (obs.SatProperties(dict(prop=prop)),)
        return build(Composed, {"dyn_type": tanks, "fsw_type": fsw.FSWModel, "observation_spec": spec})

    heard = "'radio'", "'station_access'", "world.GroundStationWorldModel"
    charged = ("dyn.BasicDynamicsModel",)
    check_refusals(
        refusal(lambda: build(Composed, mine), TypeError, *heard),
        refusal(lambda: build(Composed, mine, backend="compiled"), TypeError, *heard),
        refusal(lambda: observe("battery_charge_fraction"), ValueError, "prop='battery_charge_fraction'", *charged),
        refusal(lambda: observe("c_hat_P"), ValueError, "prop='c_hat_P'", "fsw.ImagingFSWModel"),
        refusal(lambda: observe("tanks"), TypeError, "'charge'", *charged),
    )


def test_a_component_whose_reads_are_answered_by_another_model_is_built():
    listening = type("Listening", (dyn.EclipseDynModel,), {"components": (RADIO,)})
    models = {"dyn_type": (listening, dyn.GroundStationDynModel), "fsw_type": fsw.ImagingFSWModel}
    heard = type("Mine", (Composed,), models)
    assert SatelliteTasking(heard("A"), backend="eager", time_limit=60.0).satellite.dynamics.state("heard").shape == (1,)


@pytest.mark.parametrize("model", [dyn.ImagingDynModel, dyn.ContinuousImagingDynModel])
def test_an_instrument_that_nothing_commands_always_records_as_in_bsk_rl(model):
    """bsk_rl's levels are 8e7 bit after ten seconds and 1.6e8 bit, the capacity, from 20 s on."""
    satellite = type(
        "Mine", (Composed,), {"dyn_type": model, "fsw_type": fsw.FSWModel, "action_spec": (act.Drift(duration=10.0),)}
    )
    env = SatelliteTasking(satellite("A"), backend="eager", time_limit=60.0)
    td, levels = env.reset(), []
    for _ in range(3):
        td = env.step(td.set("action", torch.zeros(1, dtype=torch.int64)))["next"]
        levels.append(float(env.satellite.dynamics.storage_level))
    assert levels == [8e7, 1.6e8, 1.6e8]


@pytest.mark.parametrize(
    ("name", "model"),
    [
        ("station_access", "world.GroundStationWorldModel"),
        ("illumination", "world.EclipseWorldModel"),
        ("power", "dyn.BasicDynamicsModel"),
        ("charge", "dyn.BasicDynamicsModel"),
        ("instrument_command", "fsw.ImagingFSWModel"),
        ("instrument_axis_B", "fsw.ImagingFSWModel"),
        ("partitions", "dyn.ImagingDynModel"),
        ("error", "fsw.FSWModel"),
    ],
)
def test_the_model_that_provides_a_message_is_found(name, model):
    assert model in providers(name)


MOON = Component("moon", lambda bus: None, (Arg("moonMass", 7.3e22, "kg", "mass"),), after="ephemeris")


class MoonWorldModel(world.EclipseWorldModel):
    components = (MOON,)

    @property
    def moon_mass(self) -> torch.Tensor:
        """Mass of the Moon, [N] kg."""
        return self._state.argument("moonMass")


class Passive(sats.Satellite):
    observation_spec = (obs.Time(),)
    action_spec = (act.Drift(duration=30.0),)
    dyn_type = (dyn.EclipseDynModel, dyn.AtmosphericDragDynModel)
    fsw_type = fsw.FSWModel


def test_the_world_follows_from_the_dynamics_models():
    assert world_of(dyn.DynamicsModel) is world.WorldModel
    inferred = world_of(Passive.dyn_type)
    assert issubclass(inferred, world.EclipseWorldModel)
    assert issubclass(inferred, world.AtmosphereWorldModel)
    assert [c.slot for c in world_components(Passive("A").dyn_type)] == ["earth_pole", "ephemeris", "atmosphere", "eclipse"]


def test_a_world_of_the_users_own_adds_its_components_arguments_and_readouts():
    kinds = (MoonWorldModel, world.AtmosphereWorldModel)
    env = SatelliteTasking(
        Passive("A"),
        world_type=kinds,
        world_args=dict(moonMass=1.0, scaleHeight=7e3),
        num_envs=2,
        backend="eager",
        time_limit=60.0,
    )
    env.reset()
    assert (env.simulator.world.moon_mass == 1.0).all()
    assert "moon" in [component.slot for component in env.simulator.type.arguments.parts]
    assert set(env.default_world_args()) == set(compose(kinds, world.WorldModel).default_world_args())


def test_stations_of_a_world_are_not_seen_by_satellites_that_do_not_require_them():
    """bsk_rl links stations to the transmitters of GroundStationDynModel only."""
    kinds = compose((world.GroundStationWorldModel, MoonWorldModel), world.WorldModel)
    plain = [c.slot for c in world_components(dyn.ImagingDynModel)]
    assert "ground_stations" not in plain
    unlinked = [c.slot for c in kinds.components_for(dyn.ImagingDynModel.all_required_worlds())]
    linked = [c.slot for c in kinds.components_for(dyn.GroundStationDynModel.all_required_worlds())]
    assert "moon" in unlinked
    assert "ground_stations" not in unlinked
    assert "ground_stations" in linked


def test_arguments_of_a_world_are_listed_with_overrides():
    assert world.AtmosphereWorldModel.default_world_args(baseDensity=2.0)["baseDensity"] == 2.0
    with pytest.raises(KeyError, match=r"world_args\['baseDensty'\] is unknown; did you mean 'baseDensity'"):
        world.AtmosphereWorldModel.default_world_args(baseDensty=2.0)


def test_default_arguments_take_overrides_on_class_and_object():
    for owner in (Composed, Composed("A")):
        table = owner.default_sat_args(K=3.5, heaterPower=-4.0)
        assert (table["K"], table["heaterPower"], table["P"]) == (3.5, -4.0, 35.0)
        assert "3.5" in repr(table)
        with pytest.raises(KeyError, match=r"sat_args\['heaterPowr'\] is unknown; did you mean 'heaterPower'"):
            owner.default_sat_args(heaterPowr=1.0)
    assert Composed("A", Composed.default_sat_args(mass=100.0)).sat_args_generator["mass"] == 100.0
