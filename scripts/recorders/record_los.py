"""Record when the satellites of Basilisk see one another, driven through bsk_rl, as numpy files that the tests replay.

Usage::

    python scripts/recorders/record_los.py              # every file, into tests/basilisk/recordings
    python scripts/recorders/record_los.py los_ranges   # only this one
    python scripts/recorders/record_los.py --list

See ``recording.py`` for what it needs. Five satellites drift; steps last a random number of ticks, mostly one. Elements and
ranges were tuned by hand until some ticks lay within millimeters of a limit, see ``nearest`` in the files.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from bsk_rl import GeneralSatelliteTasking, act, comm, data, obs, sats, scene
from bsk_rl.sim import dyn, fsw
from numpy.typing import NDArray
from recording import Array, orbit_state, record_files, versions

DURATIONS = (1,) * 12 + (2, 3, 7, 20, 61, 150)
"""Ticks of the steps that are drawn."""

RADIUS, FLATTENED = 6378136.6, 0.98
UTC = "2021 MAR 05 07:12:33.250 (UTC)"


@dataclass
class Variant:
    """A file: elements of each satellite (a in km, e, then angles in degrees), longest ranges, m, tick, s, and ticks in all."""

    elements: tuple[tuple[float, ...], ...]
    ranges: tuple[float, ...]
    seed: int
    sim_rate: float = 1.0
    ticks: int = 6000


ORBITS = (
    (6871.0, 0.0, 51.0, 20.0, 0.0, 10.0),
    (6871.0, 0.0, 51.0, 20.0, 0.0, 54.50000475),
    (6900.0, 0.001, 97.5, 60.0, 30.0, 20.0),
    (8500.0, 0.19, 63.0, 340.0, 200.0, 259.9999763),
    (7500.0, 0.02, 20.0, 100.0, 0.0, 300.0),
)

VARIANTS = {
    "los_unlimited": Variant(ORBITS, (-1.0,) * 5, 1),
    "los_ranges": Variant(ORBITS, (-1.0, 0.0, 4.0e6, 5000007.475434, 2.5e6), 2),
    "los_two_seconds": Variant(ORBITS, (-1.0, 5050940.843672, -1.0, -1.0, -1.0), 3, 2.0, 2000),
}


class LOSDynModel(dyn.BasicDynamicsModel, dyn.LOSCommDynModel):
    """A satellite that flies and can be asked whom it sees."""


class Noted(comm.LOSCommunication):
    """Keeps what ``communication_pairs`` returned last."""

    def communication_pairs(self) -> list[Any]:
        """See bsk_rl; the pairs as a matrix are kept."""
        pairs = super().communication_pairs()
        self.matrix = np.zeros((len(self.satellites),) * 2, dtype=bool)
        for sender, receiver in pairs:
            self.matrix[self.satellites.index(sender), self.satellites.index(receiver)] = True
        return pairs


def drifter_class(sim_rate: float) -> type[sats.Satellite]:
    """Satellites that can only drift, for one of the durations; bsk_rl caches what it composes on the class."""
    attributes = {
        "observation_spec": [obs.Time()],
        "action_spec": [act.Drift(f"drift_{k}", duration=k * sim_rate) for k in sorted(set(DURATIONS))],
        "dyn_type": LOSDynModel,
        "fsw_type": fsw.BasicFSWModel,
    }
    return type("Drifter", (sats.Satellite,), attributes)


def make_env(variant: Variant) -> tuple[GeneralSatelliteTasking, list[dict[str, Any]]]:
    """The environment, and the initial state of every satellite."""
    satellite_class = drifter_class(variant.sim_rate)
    states = [orbit_state(a, e, np.radians(angles)) for a, e, *angles in variant.elements]
    satellites = [
        satellite_class(f"Sat{k}", {**state, "oe": None, "losMaximumRange": reach, "wheelSpeeds": [0.0, 0.0, 0.0]})
        for k, (state, reach) in enumerate(zip(states, variant.ranges, strict=True))
    ]
    env = GeneralSatelliteTasking(
        satellites,
        scenario=scene.Scenario(),
        rewarder=data.NoReward(),
        communicator=Noted(),
        world_args={"utc_init": UTC},
        sim_rate=variant.sim_rate,
        log_level="ERROR",
    )
    return env, states


@dataclass
class Recorders:
    """Messages about access of each ordered pair, and recorders that run last in each tick: of these, of states, of the Earth."""

    messages: dict[tuple[int, int], Any]
    access: dict[tuple[int, int], Any]
    states: list[Any]
    earth: Any

    @classmethod
    def attach(cls, env: GeneralSatelliteTasking) -> Recorders:
        """Add recorders to the tasks of the satellites."""
        names = [satellite.name for satellite in env.satellites]
        messages = {
            (i, names.index(name)): satellite.dynamics.losComms.accessOutMsgs[k]
            for i, satellite in enumerate(env.satellites)
            for k, name in enumerate(satellite.dynamics.los_comms_ids)
        }
        access = {pair: message.recorder() for pair, message in messages.items()}
        states = [satellite.dynamics.scObject.scStateOutMsg.recorder() for satellite in env.satellites]
        world = env.simulator.world
        earth = world.gravFactory.spiceObject.planetStateOutMsgs[world.body_index].recorder()
        owned = [(i, recorder) for (i, _), recorder in access.items()] + [*enumerate(states), (0, earth)]
        for i, recorder in owned:
            env.simulator.AddModelToTask(env.satellites[i].dynamics.task_name, recorder, ModelPriority=1)
        return cls(messages, access, states, earth)

    def latest(self) -> Array:
        """Who sees whom now, [S, S]."""
        found = np.zeros((len(self.states),) * 2, dtype=bool)
        for pair, message in self.messages.items():
            found[pair] = message.read().hasAccess
        return found

    def history(self) -> Array:
        """Who saw whom at every tick since the reset, [T, S, S]."""
        found = np.zeros((len(self.earth.times()), *(len(self.states),) * 2), dtype=bool)
        for (i, j), recorder in self.access.items():
            found[:, i, j] = recorder.hasAccess
        return found


def margins(r: Array, PN: Array, ranges: tuple[float, ...]) -> tuple[Array, Array]:
    """How far every line of sight passes the Earth, and how much of the range is left, [T, S, S] m each.

    Args:
        r: Positions at a tick and the T that follow, [T + 1, S, 3] m.
        PN: DCM of the Earth at them, [T + 1, 3, 3].
        ranges: Longest range of each satellite, m.
    """
    late = np.triu(np.ones((r.shape[1],) * 2, dtype=bool), 1)[None, :, :, None]
    own = np.broadcast_to(r[1:, :, None], (len(r) - 1, r.shape[1], r.shape[1], 3))
    other = np.where(late, r[:-1, None], r[1:, None])
    scale = np.array([1.0, 1.0, 1.0 / FLATTENED])
    p, q = (np.einsum("tab,tijb->tija", PN[1:], part) * scale for part in (own, other))
    d = q - p
    k = np.clip(-(p * d).sum(-1) / np.maximum((d * d).sum(-1), 1e-300), 0.0, 1.0)[..., None]
    clear = np.linalg.norm(p + k * d, axis=-1) - RADIUS
    limit = np.array([reach if reach > 0.0 else np.inf for reach in ranges])
    return clear, limit[:, None] - np.linalg.norm(other - own, axis=-1)


def nearest(access: Array, clear: Array, left: Array) -> Array:
    """Distance, m, of the tick that is closest to a limit: of the Earth, and of a range; tells how often these formulas err."""
    apart = ~np.eye(access.shape[1], dtype=bool)
    sees = (clear > 0.0) & (left >= 0.0) & apart
    print(f"  the formulas disagree with Basilisk at {int((sees != access).sum())} of {sees.size} pairs and ticks")
    limits = {"Earth": np.where(apart, np.abs(clear), np.inf), "range": np.where(apart & (clear > 0.0), np.abs(left), np.inf)}
    for name, distance in limits.items():
        for t, i, j in zip(*np.unravel_index(np.argsort(distance, axis=None)[:3], distance.shape), strict=True):
            print(f"  {name}: {distance[t, i, j]:.6f} m from the limit at tick {t + 2}, {i} to {j}")
    return np.array([distance.min() for distance in limits.values()])


def steps(env: GeneralSatelliteTasking, variant: Variant) -> tuple[list[int], list[Array]]:
    """Ticks of each step taken, and who communicated after it."""
    rng, lasts, ticks, pairs = np.random.default_rng(variant.seed), sorted(set(DURATIONS)), [], []
    while sum(ticks) < variant.ticks:
        ticks.append(int(rng.choice(DURATIONS)))
        shortest = lasts.index(ticks[-1])
        actions = rng.integers(shortest, len(lasts), len(env.satellites))
        actions[rng.integers(len(actions))] = shortest  # it ends the step of all
        env.step(tuple(int(action) for action in actions))
        pairs.append(env.communicator.matrix)
    return ticks, pairs


def fly(variant: Variant) -> dict[str, Any]:
    """The arrays of a file."""
    env, states = make_env(variant)
    env.reset(seed=variant.seed)
    recorders = Recorders.attach(env)
    at_reset = recorders.latest()
    ticks, pairs = steps(env, variant)
    access = recorders.history()
    if len(access) != sum(ticks):
        raise RuntimeError(f"{len(access)} ticks were recorded, but steps lasted {sum(ticks)}")
    r = np.stack([recorder.r_BN_N for recorder in recorders.states], 1)
    margin = margins(r, np.array(recorders.earth.J20002Pfix), variant.ranges)
    print(f"  {int(np.diff(access, axis=0).sum())} changes in {len(ticks)} steps of {len(access)} ticks")
    return {
        "ic": json.dumps([{**state, "utc_init": UTC} for state in states]),
        "ranges": np.array(variant.ranges),
        "env": json.dumps({"sim_rate": variant.sim_rate}),
        "versions": json.dumps(versions()),
        "ticks": np.array(ticks, dtype=np.int16),
        "pairs": np.stack(pairs),
        "access": np.concatenate([at_reset[None], access]),
        "nearest": nearest(access[1:], *margin),
    }


RECORDERS: dict[str, Callable[[str], dict[str, NDArray[Any]]]] = {name: lambda name: fly(VARIANTS[name]) for name in VARIANTS}


if __name__ == "__main__":
    record_files(RECORDERS)
