"""Mistakes in users' components raise errors that name the component, when an environment is built."""

import torch

from bsk_torch import SatelliteTasking, act, dyn, fsw, obs, sats
from bsk_torch.sim.component import Arg, Component, Field
from tests.support.refusals import check_refusals, refusal

ARGS = (Arg("heaterPowerDraw", -20.0, "W", "power", high=0.0),)


def heat(bus) -> None:
    bus.power = bus.power + bus.heater_power


def heater(**entries) -> Component:
    given = dict(
        slot="heater",
        after="transmitter_draw",
        update=heat,
        args=ARGS,
        params=(Field("heater_power", 1, "W"),),
        prepare=lambda args: {"heater_power": args["heaterPowerDraw"]},
    )
    return Component(**(given | entries))


def environment(component: Component, num_envs: int = 2, flight: type = fsw.BasicFSWModel, **members) -> SatelliteTasking:
    class Model(dyn.BasicDynamicsModel):
        components = (component,)

    for name, member in members.items():
        setattr(Model, name, member)

    class Satellite(sats.Satellite):
        observation_spec = (obs.SatProperties(dict(prop="battery_charge_fraction")),)
        action_spec = (act.Charge(duration=20.0),)
        dyn_type, fsw_type = Model, flight

    return SatelliteTasking(Satellite("A"), num_envs=num_envs, time_limit=60.0, seed=0, backend="eager")


def written(name: str, value):
    return lambda bus: setattr(bus, name, value(bus))


def test_rejects_updates_and_entries_that_cannot_be_used():
    power = "bus.power", "number"
    second = "bus.power", "environment", "random numbers"
    updates = [
        (written("power", lambda bus: bus.power + torch.mean(bus.power)), *second),
        (written("power", lambda bus: bus.power + torch.rand_like(bus.power)), *second),
        (lambda bus: (bus.power.add_(1.0), None)[1], "bus.power", "in place"),
        (written("powr", lambda bus: bus.power + bus.heater_power), "bus.powr", "'power'"),
        (written("power", lambda bus: bus.r_BN_N), "Vec3", *power),
        (written("power", lambda bus: None), "None", *power),
        (written("power", lambda bus: bus.power if bus.power > 0 else bus.power * 2.0), "torch.where"),
        (lambda bus: 3.0, "3.0", "None"),
    ]
    check_refusals(
        refusal(lambda update=update, n=n: environment(heater(update=update), n), TypeError, "slot 'heater'", *names)
        for update, *names in updates
        for n in (1, 2)
    )

    def flight(**members):
        return environment(heater(), flight=type("Flight", (fsw.BasicFSWModel,), members))

    unknown, chosen = {"charge": fsw.Command(("nope",))}, {"charge": fsw.Command(("drift", "charge"), choice="mass")}
    two = {"sun_fresh": [1.0, 2.0]}
    check_refusals(
        refusal(lambda: heater(args=ARGS[0]), TypeError, "slot 'heater'", "args=Arg(name='heaterPowerDraw'", "tuple"),
        refusal(lambda: heater(slot=None), ValueError, "slot", "Component=None", "string"),
        refusal(lambda: heater(prepare={}), TypeError, "slot 'heater'", "prepare={}", "function"),
        refusal(lambda: Field("e", 0), ValueError, "'e'", "width=0", "whole number"),
        refusal(lambda: fsw.Mode(resets=two), ValueError, "resets['sun_fresh']=[1.0, 2.0]"),
        refusal(lambda: fsw.Command(("charge", "drift")), ValueError, "modes=('charge', 'drift')", "choice="),
        refusal(lambda: flight(modes={"nope": None}), ValueError, "Flight.modes", "'nope'", "nadir_point"),
        refusal(lambda: flight(modes={"m": ("control_on",)}), TypeError, "Flight.modes['m']=('control_on',)", "fsw.Mode"),
        refusal(lambda: flight(commands=unknown), ValueError, "'charge'", "'nope'", "nadir_point"),
        refusal(lambda: flight(commands=chosen), ValueError, "'charge'", "choice='mass'", "'choice'", "2"),
    )


def test_updates_that_can_be_used():
    def twice(bus) -> None:
        bus.spare_power = bus.heater_power  # only read here
        bus.power = bus.power + 2.0 * bus.spare_power

    def noted(bus) -> None:
        bus.heat_rate_of_this_tick = bus.heater_power  # read by none, but no misspelling

    for update in (heat, twice, noted):
        played = environment(heater(update=update)).rollout(2)
        assert torch.isfinite(played["next", "observation"]).all()


def test_rejects_what_components_compute_at_reset():
    def returning(value):
        return environment(heater(prepare=lambda args: value))

    def build(**entries):
        return environment(heater(**entries))

    charge = dict(state=(Field("charge"),), initial=lambda args: {"charge": torch.zeros(1)})
    one = torch.ones(1, dtype=torch.float64)
    check_refusals(
        refusal(lambda: returning(None), TypeError, "prepare(args)", "slot 'heater'", "None"),
        refusal(lambda: returning({}), ValueError, "prepare(args)", "'heater_power'", "params="),
        refusal(lambda: returning({"heater_power": 1.0}), TypeError, "'heater_power'", "1.0", "float64", "[1]", "[2]"),
        refusal(lambda: returning({"heater_power": torch.ones(7)}), TypeError, "'heater_power'", "[7]", "[1]", "[2]"),
        refusal(lambda: returning({"heater_power": one * torch.nan}), ValueError, "'heater_power'", "NaN", "row 0"),
        refusal(lambda: returning({"heater_power": one, "z": one}), ValueError, "'z'", "params=", "heater_power"),
        refusal(lambda: build(initial=lambda args: {"e": torch.zeros(1)}), ValueError, "initial(args)", "'e'", "state="),
        refusal(lambda: build(prepare=None), ValueError, "'heater_power'", "prepare=", "params="),
        refusal(lambda: build(**charge), ValueError, "initial(args)", "slot 'heater'", "'charge'"),
        refusal(lambda: build(check=lambda args: False), TypeError, "check(args)", "slot 'heater'", "False", "ValueError"),
    )


def test_an_aliveness_check_of_all_environments_together():
    def lives(check):
        return environment(heater(), lives=dyn.aliveness_checker(check))

    wanted = "Model.lives()", "shape [1]", "torch.bool"
    check_refusals(
        refusal(lambda: lives(lambda self: (self.battery_charge > 0.0).all()), TypeError, "shape []", *wanted),
        refusal(lambda: lives(lambda self: self.battery_charge), TypeError, "torch.float64", *wanted),
        refusal(lambda: lives(lambda self: 1), TypeError, "is 1;", *wanted),
    )
