"""Mistakes in users' components raise errors that name the component, when an environment is built."""

from __future__ import annotations

import pytest
import torch

from bsk_torch import SatelliteTasking, act, dyn, fsw, obs, sats
from bsk_torch.sim.component import Arg, Component, Field

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


@pytest.mark.parametrize("num_envs", [1, 2])
@pytest.mark.parametrize(
    ("update", "words"),
    [
        (written("power", lambda bus: bus.power + torch.mean(bus.power)), r"another bus\.power next to a second environment"),
        (
            written("power", lambda bus: bus.power + torch.rand_like(bus.power)),
            r"another bus\.power next to a second environment",
        ),
        (lambda bus: bus.power.add_(1.0) and None, r"fails|changes bus\.power in place"),
        (
            written("powr", lambda bus: bus.power + bus.heater_power),
            r"writes bus\.powr, which no component reads; did you mean 'power'",
        ),
        (written("power", lambda bus: bus.r_BN_N), r"writes bus\.power = a Vec3; it must be a number"),
        (written("power", lambda bus: None), r"writes bus\.power = None; it must be a number"),
        (written("power", lambda bus: bus.power if bus.power > 0 else bus.power * 2.0), r"slot 'heater' fails: .*torch\.where"),
        (lambda bus: 3.0, r"returns 3\.0; it must return None"),
    ],
)
def test_updates_that_cannot_be_used(update, words, num_envs):
    with pytest.raises(TypeError, match=words):
        environment(heater(update=update), num_envs)


def test_updates_that_can_be_used():
    def twice(bus) -> None:
        bus.spare_power = bus.heater_power  # only read here
        bus.power = bus.power + 2.0 * bus.spare_power

    def noted(bus) -> None:
        bus.heat_rate_of_this_tick = bus.heater_power  # read by none, but no misspelling

    for update in (heat, twice, noted):
        played = environment(heater(update=update)).rollout(2)
        assert torch.isfinite(played["next", "observation"]).all()


@pytest.mark.parametrize(
    ("entries", "words"),
    [
        (dict(prepare=lambda args: None), r"prepare\(args\) of the component in slot 'heater' returns None"),
        (dict(prepare=lambda args: {}), "lacks 'heater_power'"),
        (dict(prepare=lambda args: {"heater_power": 1.0}), r"is 1\.0; it must be a float64 tensor"),
        (dict(prepare=lambda args: {"heater_power": torch.ones(7)}), r"is of shape \[7\]"),
        (dict(prepare=lambda args: {"heater_power": args["heaterPowerDraw"] * torch.nan}), "is NaN in row 0"),
        (
            dict(prepare=lambda args: dict.fromkeys(("heater_power", "z"), args["heaterPowerDraw"])),
            "returns 'z', which is not in",
        ),
        (dict(initial=lambda args: {"e": torch.zeros(1)}), "returns 'e', which is not in state="),
        (dict(state=(Field("e"),)), "no component gives 'e' a value when episodes start"),
        (
            dict(state=(Field("charge"),), initial=lambda args: {"charge": torch.zeros(1)}),
            "'charge', which another component returns",
        ),
        (dict(check=lambda args: False), "returns False; it must raise ValueError"),
    ],
)
def test_what_components_compute_at_reset(entries, words):
    with pytest.raises((TypeError, ValueError), match=words):
        environment(heater(**entries))


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: heater(args=ARGS[0]), "has args=.*must be a tuple of Arg"),
        (lambda: heater(slot=None), "slot of a Component=None"),
        (lambda: heater(prepare=None), "has prepare=None; it must be a function"),
        (lambda: Field("e", 0), "width=0 must be a whole number from 1 on"),
        (lambda: fsw.Mode(resets={"sun_fresh": [1.0, 2.0]}), r"resets\['sun_fresh'\]=\[1\.0, 2\.0\]"),
        (lambda: fsw.Command(("charge", "drift")), "has several modes; name the argument that chooses one"),
    ],
)
def test_entries_of_wrong_kinds(make, words):
    with pytest.raises((TypeError, ValueError), match=words):
        make()


@pytest.mark.parametrize(
    ("members", "words"),
    [
        (dict(modes={"nope": None}), "removes 'nope', which no base class has"),
        (dict(modes={"m": ("control_on",)}), "must be an fsw.Mode"),
        (dict(commands={"charge": fsw.Command(("nope",))}), "enters the unknown mode 'nope'"),
        (dict(commands={"charge": fsw.Command(("drift", "charge"), choice="mass")}), "must be an argument of kind 'choice'"),
    ],
)
def test_modes_and_commands(members, words):
    with pytest.raises((TypeError, ValueError), match=words):
        environment(heater(), flight=type("Flight", (fsw.BasicFSWModel,), members))


@pytest.mark.parametrize(
    "check", [lambda self: (self.battery_charge > 0.0).all(), lambda self: self.battery_charge, lambda self: 1]
)
def test_an_aliveness_check_of_all_environments_together(check):
    with pytest.raises(TypeError, match=r"Model\.lives\(\) is .* must be a tensor of shape"):
        environment(heater(), lives=dyn.aliveness_checker(check))
