"""Impulsive manoeuvres as actions: clamps, frames, the drift, and single precision."""

import logging

import pytest
import torch
from tensordict import TensorDict

from bsk_torch import ConstellationTasking, SatelliteTasking, act, obs, sats
from bsk_torch.astro.relative import rv2HN
from bsk_torch.env.satellite_group import command
from bsk_torch.sim import dyn, fsw
from tests.support.episodes import begun
from tests.support.refusals import check_refusals, refusal

MU, RADIUS = 3.986004415e14, 6.9e6
START = dict(oe=None, rN=[RADIUS, 0.0, 0.0], vN=[0.0, 0.8 * (MU / RADIUS) ** 0.5, 0.6 * (MU / RADIUS) ** 0.5])
MODELS = dyn.DynamicsModel, (fsw.MagicOrbitalManeuverFSWModel, fsw.FSWModel)


def mover(*entries, name="Mover", models=MODELS):
    spec = obs.SatProperties(dict(prop="dv_available"), dict(prop="thrust_count"), dict(prop="sigma_BN")), obs.Time(norm=1.0)
    attributes = {"action_spec": entries, "observation_spec": spec, "dyn_type": models[0], "fsw_type": models[1]}
    return type(name, (sats.Satellite,), attributes)


def make(entry, num_envs=1, models=MODELS, **options):
    options = dict(time_limit=20000.0, seed=1, backend="eager", dtype=torch.float64, orbit="integrated") | options
    return SatelliteTasking(mover(entry, models=models)("A", START), num_envs=num_envs, **options)


def thrust(env, *rows, dtype=torch.float64):
    """Velocity changes that wait for the next tick, [N, 3], and durations, after actions without running them."""
    action = torch.tensor(rows, dtype=dtype)
    satellites, every = env.satellite, torch.ones(len(rows), dtype=torch.bool)
    action = satellites.actions.checked(action, every)
    decision = satellites.actions.decide(action, satellites.task.previous_action, every)
    command(satellites, action, every, decision, every)
    return env.simulator.read("delta_v_N"), decision.duration


def step(env, *rows, dtype=torch.float64):
    return env.step(TensorDict({"action": torch.tensor(rows, dtype=dtype)}, env.batch_size))["next"]


class TestClamps:
    @pytest.mark.parametrize(
        ("asked", "sim_rate", "lasts"),
        [
            (7.0, 1.0, 7.0),
            (10.5, 1.0, 11.0),
            (1.0, 1.0, 2.0),
            (-5.0, 1.0, 2.0),
            (0.3, 5.0, 10.0),
            (11.0, 5.0, 15.0),
            (99.0, 1.0, 40.0),
        ],
    )
    def test_drifts_last_two_ticks_at_least_and_whole_ones(self, asked, sim_rate, lasts):
        env = begun(make(act.ImpulsiveThrust(max_drift_duration=40.0), sim_rate=sim_rate))
        assert float(step(env, [1.0, 0.0, 0.0, asked])["duration"]) == lasts

    def test_an_endless_drift_lasts_until_the_time_limit(self):
        env = begun(make(act.ImpulsiveThrust(), time_limit=50.0))
        td = step(env, [0.0, 0.0, 0.0, 1e300])
        assert float(td["duration"]) == 50.0
        assert bool(td["truncated"])

    def test_the_tank_allows_less(self):
        env = begun(make(act.ImpulsiveThrust(max_dv=80.0)))
        step(env, [60.0, 0.0, 0.0, 5.0])
        dv_N, _ = thrust(env, [0.0, 60.0, 0.0, 5.0])
        assert dv_N.tolist() == [[0.0, 40.0, 0.0]]


class TestAttitude:
    @pytest.mark.parametrize(
        ("fsw_action", "mode"), [(None, "hold_inertial"), ("nadir_point", "nadir_point"), ("action_nadir_point", "nadir_point")]
    )
    def test_the_mode_of_the_drift(self, fsw_action, mode):
        env = begun(make(act.ImpulsiveThrust(fsw_action=fsw_action)))
        td = step(env, [1.0, 0.0, 0.0, 9.0])
        assert env.simulator.mode_names[int(env.simulator.mode)] == mode
        assert bool((td["observation"][0, 2:5] == 0.0).all()) == (fsw_action is None)  # without actuators: B is N at once

    def test_wheels_turn_to_the_attitude_of_N(self):
        models = dyn.BasicDynamicsModel, (fsw.MagicOrbitalManeuverFSWModel, fsw.BasicFSWModel)
        env = make(act.ImpulsiveThrust(), models=models, backend="eager")
        before = env.reset()["observation"][0, 2:5].norm()
        after = step(env, [1.0, 0.0, 0.0, 60.0])["observation"][0, 2:5].norm()
        assert after < 0.7 * before


class TestSinglePrecision:
    """Numbers of float32 are exact by default; bsk_rl computes with them in float32."""

    def test_by_default_drifts_last_what_they_say(self):
        env = begun(make(act.ImpulsiveThrust()))
        assert [float(step(env, [0.0, 0.0, 0.1, t], dtype=torch.float32)["duration"]) for t in (20.0, 7.0)] == [20.0, 7.0]
        assert float(env.satellite.fsw.dv_available) == pytest.approx(100.0 - 2 * float(torch.tensor(0.1)), abs=1e-13)

    def test_the_hill_variant_is_in_double_precision(self):
        env = begun(make(act.ImpulsiveThrustHill("A"), compat="bsk_rl"))
        assert [float(step(env, [0.0, 0.0, 0.1, t], dtype=torch.float32)["duration"]) for t in (20.0, 7.0)] == [20.0, 7.0]


class TestHillFrame:
    def make(self, order):
        """A deputy that thrusts in the frame of a chief of another type, which thrusts at the same time."""
        chief = mover(act.ImpulsiveThrust(), name="Chief")("Chief", START)
        away = {**START, "rN": [RADIUS, 1e5, 2e5]}
        deputy = mover(act.ImpulsiveThrustHill("Chief"), name="Deputy")
        deputies = [deputy(name, away) for name in ("D1", "D2")]
        options = dict(time_limit=2000.0, seed=1, backend="eager", dtype=torch.float64, orbit="integrated", num_envs=2)
        return ConstellationTasking([chief, *deputies] if order == "first" else [*deputies, chief], **options)

    @pytest.mark.parametrize("order", ["first", "last"])
    def test_the_frame_is_that_before_any_thrust(self, order):
        env = self.make(order)
        td = env.reset()
        deputies = next(group for group in env.satellites if "D1" in group.names)
        for seconds in (30.0, 11.0):
            chief = env.fleet.satellite("Chief").dynamics
            HN = rv2HN(chief.r_BN_N, chief.v_BN_N)
            dv_H = torch.tensor([[[1.0, 2.0, -0.5], [0.0, 0.3, 0.0]], [[0.1, 0.0, 0.0], [4.0, 0.0, 3.0]]], dtype=torch.float64)
            lasts = torch.full((2, 2, 1), seconds, dtype=torch.float64)
            td["chief", "action"] = torch.tensor([[[900.0, -50.0, 70.0, seconds]]] * 2, dtype=torch.float64)
            td["deputy", "action"] = torch.cat([dv_H, lasts], -1)
            done = []
            simulator = deputies.simulator
            plain = simulator.thrust
            simulator.thrust = lambda rows, dv_N, done=done, plain=plain: (done.append(dv_N), plain(rows, dv_N))
            td = env.step(td)["next"]
            simulator.thrust = plain
            expected = torch.einsum("nij,nki->nkj", HN, dv_H)  # dv_N = [HN]^T dv_H
            torch.testing.assert_close(done[0].view(2, 2, 3), expected, rtol=0.0, atol=1e-14)

    def test_the_own_frame_and_radial_components(self):
        env = begun(make(act.ImpulsiveThrustHill("A", max_dv=5.0)))
        dv_N, _ = thrust(env, [10.0, 0.0, 0.0, 60.0])
        torch.testing.assert_close(dv_N, torch.tensor([[5.0, 0.0, 0.0]], dtype=torch.float64), atol=1e-14, rtol=0.0)


def test_emptying_the_tank_kills_once_and_the_drift_is_flown(caplog):
    env = begun(make(act.ImpulsiveThrust(), failure_penalty=-3.0))
    with caplog.at_level(logging.WARNING):
        td = step(env, [150.0, 0.0, 0.0, 25.0])
    assert (float(td["duration"]), float(td["reward"])) == (25.0, -3.0)
    assert bool(td["terminated"])


def test_the_norm_is_clamped_and_not_the_components():
    env = begun(make(act.ImpulsiveThrust(max_dv=3.0), num_envs=4))
    dv_N, _ = thrust(env, [2.0, 2.0, 2.0, 9.0], [2.0, 1.0, 2.0, 9.0], [-30.0, 0.0, 40.0, 9.0], [0.0, 0.0, 0.0, 9.0])
    expected = [[3**0.5] * 3, [2.0, 1.0, 2.0], [-1.8, 0.0, 2.4], [0.0] * 3]
    torch.testing.assert_close(dv_N, torch.tensor(expected, dtype=torch.float64), rtol=1e-15, atol=0.0)
    assert env.satellite.fsw.thrust_count.tolist() == [1.0] * 4


def test_nan_is_refused():
    env = begun(make(act.ImpulsiveThrust()))
    check_refusals(refusal(lambda: step(env, [0.0, torch.nan, 0.0, 5.0]), ValueError, "environment 0", "dV_N_y=nan"))


def test_under_compat_the_event_and_the_tank_are_rounded():
    """At 20 s a drift of 7 s in float32 ends at 27.000000512 s, so it takes 8 ticks."""
    env = begun(make(act.ImpulsiveThrust(), compat="bsk_rl"))
    assert [float(step(env, [0.0, 0.0, 0.1, t], dtype=torch.float32)["duration"]) for t in (20.0, 7.0)] == [20.0, 8.0]
    left = torch.tensor(100.0) - torch.tensor(0.1) - torch.tensor(0.1)
    assert float(env.satellite.fsw.dv_available) == float(left)
    assert float(step(env, [0.0, 0.0, 0.0, 7.0])["duration"]) == 7.0  # float64 has none of this


def test_bounds_follow_the_environment():
    env = make(act.ImpulsiveThrust(max_dv=3.0, max_drift_duration=60.0), sim_rate=0.5)
    assert env.action_spec.low[0].tolist() == [-3.0, -3.0, -3.0, 1.0]  # two ticks
    assert env.action_spec.high[0].tolist() == [3.0, 3.0, 3.0, 60.0]
    assert env.satellite.action_description == ["dV_N_x", "dV_N_y", "dV_N_z", "duration"]
