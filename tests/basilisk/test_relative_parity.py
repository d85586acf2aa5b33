"""Relative properties of recorded states are what bsk_rl observed, and recorded steps end with the encounters that ended them."""

import json
from datetime import datetime, timedelta
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from bsk_torch import ConstellationTasking, act, dyn, fsw, obs, rand, sats
from bsk_torch.astro.relative import rv2HN
from bsk_torch.obs.relative_observations import FUNCTIONS
from bsk_torch.sim.run.encounters import first_ticks
from bsk_torch.sim.tick.trace import Flight
from tests.conftest import RECORDINGS

CASES = sorted(path.stem for path in RECORDINGS.glob("inspection_*.npz"))

NORMS = {
    "r_DC_N": 1.0,
    "v_DC_N": 1.0,
    "r_DC_Hc": 500.0,
    "v_DC_Hc": 5.0,
    "rso_sigma_BH": 1.0,
    "rso_omega_BH": 1.0,
    "sun_hat_Hc": 1.0,
}
"""Recorded properties, and the divisors with which they were observed."""

BOUND = 4e-15
"""Of the largest observed number, or of 1: differences are exact, a rotation is a few roundings (4e-16 were seen)."""


def satellite(state, sun):
    """A satellite as the functions see it, from recorded rows of time, position, velocity, attitude and rate."""
    names = {"r_BN_N": slice(1, 4), "v_BN_N": slice(4, 7), "sigma_BN": slice(7, 10), "omega_BN_B": slice(10, 13)}
    dynamics = SimpleNamespace(**{name: state[..., part] for name, part in names.items()})
    return SimpleNamespace(dynamics=dynamics, simulator=SimpleNamespace(world=SimpleNamespace(r_SN_N=sun)))


def column(names, prop):
    """Columns of a property in the recorded vector."""
    wanted = f"rel_props.{prop}" + ("_normd" if NORMS[prop] != 1.0 else "")
    return [k for k, name in enumerate(names) if name.split("[")[0] == wanted]


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("convert", [torch.from_numpy, np.asarray], ids=["batch", "one"])
def test_recorded_states_give_the_recorded_observations(case, convert):
    recorded = np.load(RECORDINGS / f"{case}.npz")
    names = json.loads(str(recorded["obs_names"]))
    seen, states, suns = recorded["obs"], recorded["state"], recorded["sun"]
    assert len(seen) > 2
    for k in range(seen.shape[1]):
        there = ~np.isnan(seen[:, k]).any(-1)
        rows = [np.flatnonzero(there)] if convert is torch.from_numpy else list(np.flatnonzero(there))
        for row in rows:
            chief, deputy = (satellite(convert(states[row, s]), convert(suns[row])) for s in (0, k + 1))
            for prop, norm in NORMS.items():
                columns = column(names, prop)
                assert len(columns) == 3
                value = np.asarray(FUNCTIONS[prop](deputy, chief)) / norm
                expected = seen[row][..., k, :][..., columns]
                scale = max(1.0, float(np.abs(expected).max()))
                np.testing.assert_allclose(value, expected, rtol=0.0, atol=BOUND * scale, err_msg=f"{case} {prop}")


class Flown(sats.Satellite):
    """Only the motion is compared: no drag acts at these altitudes, so it does not depend on attitudes."""

    observation_spec = (obs.Time(),)
    action_spec = (act.Drift(duration=1e9),)
    dyn_type, fsw_type = (dyn.ConjunctionDynModel, dyn.MaxRangeDynModel), fsw.FSWModel


def recorded_steps(case):
    """The recorded steps: where and when they begin, how long they take, and who is alive before and after."""
    recorded = np.load(RECORDINGS / f"{case}.npz")
    initial, states = json.loads(str(recorded["ic"])), recorded["state"]
    starts, at = [], 0
    for length in recorded["length"]:
        starts += range(at, at + length)
        at += length + 1
    starts = np.array(starts)
    r, v = states[starts, :, 1:4], states[starts, :, 4:7].copy()
    episode = np.repeat(np.arange(len(recorded["length"])), recorded["length"])
    chief = torch.from_numpy(states[starts, 0])
    NH = rv2HN(chief[:, 1:4], chief[:, 4:7]).mT.numpy()
    thrust = np.nan_to_num(recorded["action"][..., :3])  # in the chief's Hill frame
    for k in range(thrust.shape[1]):
        dv, left = np.linalg.norm(thrust[:, k], axis=-1), states[starts, k + 1, 14]
        used = np.minimum(np.minimum(dv, 1.0), left)
        v[:, k + 1] += np.einsum("nij,nj->ni", NH, thrust[:, k] * (used / np.maximum(dv, 1e-300))[:, None])
    alive = recorded["alive"]
    return initial, episode, r, v, states[starts, 0, 0], recorded["duration"], alive[starts], alive[starts + 1], recorded["death"]


def flown_steps(initial, r, v, begin, ticks):
    """Every recorded step as its own environment, and the first tick at which each condition holds in it, [n, C]."""
    names = ["RSO", *(f"Inspector{k}" for k in range(1, r.shape[1]))]
    far = dict(chief_name="RSO", max_range_radius=initial["sats"][1]["max_range_radius"], conjunction_radius=2.0)
    satellites = [
        Flown(name, dict(oe=None, rN=rand.per_env(r[:, k]), vN=rand.per_env(v[:, k])) | far) for k, name in enumerate(names)
    ]
    options = dict(num_envs=len(r), sim_rate=initial["sim_rate"], backend="eager")
    epoch = datetime.strptime(initial["utc_init"].removesuffix(" (UTC)"), "%Y %b %d %H:%M:%S.%f")
    epochs = rand.per_env([str(epoch + timedelta(seconds=float(t))) for t in begin])
    env = ConstellationTasking(satellites, world_args=dict(utc_init=epochs), **options)
    env.reset()
    fleet, longest = env.fleet, int(ticks.max())
    traces = [simulator.trace(longest) for simulator in fleet.simulators]
    for simulator, trace in zip(fleet.simulators, traces, strict=True):
        simulator.run(simulator.state.of_env(ticks), trace=trace)
    counts = tuple(simulator.count for simulator in fleet.simulators)
    never = torch.full_like(ticks, 2**40)
    flight = Flight(fleet.all_envs, torch.zeros_like(ticks), ticks, never, tuple(traces), counts)
    limits = fleet.encounters.limits(fleet.all_envs)
    return fleet.encounters, first_ticks(fleet.encounters._pieces(flight), limits, ticks)


ENCOUNTERS = ("inspection_collide3", "inspection_collision", "inspection_range", "inspection_three")
"""Recordings that hold some."""


@pytest.mark.parametrize("case", CASES)
@pytest.mark.nightly(*(set(CASES) - {"inspection_collide3", "inspection_range"}))
def test_recorded_steps_end_with_the_first_encounter_and_bookings_are_bsk_rls(case):
    """No condition that waits holds before the end of a recorded step; if one holds at its end, its victims die with it."""
    initial, episode, r, v, begin, duration, before, after, death = recorded_steps(case)
    h = initial[0]["sim_rate"]
    ticks = torch.from_numpy(np.round(duration / h)).long()
    fired: dict[int, set[int]] = {}
    happened = 0
    for e in np.unique(episode):
        rows = np.flatnonzero(episode == e)
        encounters, first = flown_steps(initial[e], r[rows], v[rows], begin[rows], ticks[rows])
        pairs = [*encounters.pairs.conjunctions, *encounters.pairs.ranges]
        done = fired.setdefault(int(e), set())
        for row, mine in zip(rows, first.tolist(), strict=True):
            waiting = {c: tick for c, tick in enumerate(mine) if c not in done}
            assert min(waiting.values()) >= int(ticks[row]), (case, row)
            now = [c for c, tick in waiting.items() if tick == int(ticks[row])]
            if begin[row] + duration[row] >= initial[e]["time_limit"]:
                now = []  # the clock stops first
            victims = set()
            for c in now:
                done.add(c)
                later, earlier = pairs[c]
                colliding = c < len(encounters.pairs.conjunctions)
                victims |= {later, later - 1} if colliding else {later, earlier}  # the chief dies with a deputy that is lost
            died = set(np.flatnonzero(before[row] & ~after[row]).tolist())
            if not now:  # of fuel, at the beginning of the step
                assert all(death[e][k] == begin[row] for k in died), (case, row)
            else:
                assert died == victims & set(np.flatnonzero(before[row]).tolist()), (case, row)
            happened += len(now)
    assert happened > 0 or case not in ENCOUNTERS
