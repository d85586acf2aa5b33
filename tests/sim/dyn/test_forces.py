"""Forces of components of one's own: low thrust against Gauss's equation, and where they are refused."""

import math

import torch

from bsk_torch import SatelliteTasking, act, dyn, fsw, obs, sats
from bsk_torch.sim.component import Arg, Component, Field
from tests.support.manoeuvring import MU, RADIUS, START
from tests.support.refusals import check_refusals, refusal

MASS, THRUST = 330.0, 0.5
"""kg and N: 1.5 mm/s^2, thousands of times as much as electric propulsion, so that minutes show it."""


def push_forward(bus):
    """Thrust along the velocity."""
    dyn.add_force(bus, bus.v_BN_N * (bus.thrust / bus.v_BN_N.norm()))


def engine(**options):
    return Component(
        slot="engine",
        update=push_forward,
        args=(Arg("thrust", THRUST, "N", "thrust along the velocity", low=0.0, high=100.0),),
        params=(Field("thrust", 1, "N"),),
        prepare=lambda args: {"thrust": args["thrust"]},
        **({"before": "hub"} | options),
    )


class PushedDynModel(dyn.DynamicsModel):
    """Has an engine."""

    components = (engine(),)
    orbit = "integrated"


class TwiceDynModel(PushedDynModel):
    """Has two engines, in different slots."""

    components = (Component(slot="other", update=push_forward, before="hub"),)


class LateDynModel(dyn.DynamicsModel):
    """Has an engine in the wrong place."""

    components = (engine(before=None, after="hub"),)
    orbit = "integrated"


def make(dyn_type=PushedDynModel, thrust=THRUST, **options):
    class Pushed(sats.Satellite):
        fsw_type = fsw.FSWModel
        observation_spec = (obs.SatProperties({"prop": "semi_major_axis"}),)
        action_spec = (act.Drift(duration=600.0),)

    Pushed.dyn_type = dyn_type
    args = START | {"mass": MASS} | ({"thrust": thrust} if dyn_type is not dyn.DynamicsModel else {})
    return SatelliteTasking(Pushed("sat", args), dtype=torch.float64, sim_rate=10.0, seed=0, **({"backend": "eager"} | options))


def axes(env, steps=2):
    """Semi-major axes, m, after every ten minutes."""
    td, found = env.reset(), []
    for _ in range(steps):
        td = env.step(td.set("action", torch.zeros(1, dtype=torch.int64)))["next"]
        found.append(float(td["observation"]))
    return torch.tensor(found, dtype=torch.float64)


def test_low_thrust_raises_the_orbit_as_gauss_says():
    """Tangential thrust: ``da/dt = 2 a^2 v f / mu``, which on a circular orbit is ``2 a f / v``.

    The oblate Earth makes the axis oscillate by kilometres, with and without thrust, so the difference is compared. It deviates
    by the share by which a and v change, 2e-3, and by J2's 1e-3.
    """
    raised = axes(make()) - axes(make(thrust=0.0))
    f, v = THRUST / MASS, math.sqrt(MU / RADIUS)
    time = 600.0 * torch.arange(1, 3, dtype=torch.float64)
    torch.testing.assert_close(raised, 2.0 * RADIUS * f / v * time, rtol=5e-3, atol=0.0)


def test_forces_add_up_and_none_changes_nothing():
    def axis(*args, **options):
        return axes(make(*args, max_step_duration=60.0, **options), 1)

    torch.testing.assert_close(axis(), axis(TwiceDynModel, thrust=0.5 * THRUST), rtol=1e-14, atol=0.0)
    assert torch.equal(axis(thrust=0.0), axis(dyn.DynamicsModel, orbit="integrated"))


def test_rejects_forces_that_the_orbit_would_not_feel():
    check_refusals(
        refusal(lambda: make(orbit="arc", backend="eager"), TypeError, "external_force_N", "orbit='integrated'"),
        refusal(lambda: make(orbit="arc", backend="compiled"), TypeError, "external_force_N", "orbit='integrated'"),
        refusal(lambda: make(LateDynModel), TypeError, "external_force_N", "hub", "before='hub'"),
    )
