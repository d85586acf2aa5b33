"""Record flights of AEOS-Bench's satellites on Basilisk, in the order of the benchmark's tick.

Usage::

    python scripts/recorders/record_aeos_bench.py                        # every file, into tests/basilisk/recordings
    python scripts/recorders/record_aeos_bench.py aeos_bench_random      # only this one
    python scripts/recorders/record_aeos_bench.py --list

See ``recording.py`` for what it needs; bsk_rl has no part in it. Scenarios are in the benchmark's JSON form. They are drawn from
the distributions of the benchmark (AEOS-Bench, NeurIPS 2025, arXiv 2510.26297), with tasks near the ground tracks, so that a
short flight sees some.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.random import RandomState
from recording import Array, record_files, versions

from bsk_torch.lab.basilisk.aeos_reference import ORBIT, Flight, Progress, greedy_rule

NUDGE = 1e-14  # change of the initial attitude that tells how far a flight can be trusted
MOMENTA = {"Honeywell_HR12": (12.0, 25.0, 50.0), "Honeywell_HR14": (25.0, 50.0, 75.0), "Honeywell_HR16": (50.0, 75.0, 100.0)}

Scenario = dict[str, Any]
Rule = Callable[["Flight", Array], tuple[Array, Array]]
"""Returns the task of each satellite, -1 for none, and whether to toggle its sensor; given the tasks that are open."""


# --- tasks and rules ---


def random_rule(seed: int, every: int) -> Rule:
    """Return a rule that changes half of the tasks and toggles a third of the sensors at multiples of ``every`` seconds.

    One task in three is none or one that the Earth hides.
    """
    rng = RandomState(seed)
    held: dict[int, int] = {}

    def decide(flight: Flight, is_open: Array) -> tuple[Array, Array]:
        n, places = len(flight.crafts), flight.places_P @ flight.PN
        toggle = np.zeros(n, dtype=bool)
        if flight.tick % every == 0:
            toggle = rng.random_sample(n) < 1 / 3
            for s, r in enumerate(flight.positions):
                above = np.flatnonzero(((places * (r - places)).sum(1) > 0) & is_open)
                if rng.random_sample() < 0.5:
                    held[s] = (
                        int(rng.choice(above)) if len(above) and rng.random_sample() < 2 / 3 else rng.randint(-1, len(places))
                    )
        return np.array([held.get(s, -1) for s in range(n)]), toggle

    return decide


def greedy() -> Rule:
    """Return the benchmark's greedy rule, with sensors that stay on."""
    choose = greedy_rule()
    return lambda flight, is_open: (choose(flight, is_open), ~flight.sensors_on)


def again(events: Array, n: int) -> Rule:
    """Return a rule that repeats recorded actions."""
    rows, choice = {}, np.full(n, -1)
    for tick, s, task, flip in events.tolist():
        rows.setdefault(tick, []).append((s, task, flip))

    def decide(flight: Flight, is_open: Array) -> tuple[Array, Array]:
        toggle = np.zeros(n, dtype=bool)
        for s, task, flip in rows.get(flight.tick, ()):
            choice[s], toggle[s] = task, flip
        return choice.copy(), toggle

    return decide


# --- scenarios ---


def draw_satellite(rng: RandomState, k: int, p_over_I: tuple[float, float]) -> dict[str, Any]:
    """A satellite from the benchmark's distributions, whose gain of rates over inertia is within these bounds, 1/s.

    The benchmark keeps satellites that pass a test flight; the bounds stand for that test.
    """
    while True:
        moments, kind = rng.uniform(50, 200, 3), rng.choice(sorted(MOMENTA))
        momentum = float(rng.choice(MOMENTA[kind]))
        gain = rng.uniform(2, 5) * moments.max() / momentum
        ki, p = rng.uniform(0, 0.01), rng.uniform(2, 4) * gain
        ratios = p * (1 + ki * moments) / moments
        if p_over_I[0] < ratios.min() and ratios.max() < p_over_I[1] and 2 * moments.max() < moments.sum():
            break
    phi, theta = math.pi * rng.uniform(), math.pi * rng.uniform(-0.5, 0.5)
    wheels = [
        {
            "rw_type": str(kind),
            "rw_direction": axis,
            "max_momentum": momentum,
            "rw_speed_init": rng.uniform(400, 750),
            "power": rng.uniform(5, 7),
            "efficiency": rng.uniform(0.5, 0.6),
        }
        for axis in np.eye(3).tolist()
    ]
    return {
        "id": k,
        "inertia": np.diag(moments).ravel().tolist(),
        "mass": rng.uniform(50, 200),
        "center_of_mass": [0.0, 0.0, 0.0],
        "orbit": k,
        "solar_panel": {
            "direction": [math.cos(theta) * math.cos(phi), math.cos(theta) * math.sin(phi), math.sin(theta)],
            "area": rng.uniform(0.1, 0.5),
            "efficiency": rng.uniform(0.1, 0.5),
        },
        "sensor": {"type": 1, "enabled": False, "half_field_of_view": rng.uniform(0.1, 0.5), "power": rng.uniform(1, 10)},
        "battery": {"capacity": rng.uniform(8000, 30000), "percentage": rng.uniform(0.1, 1)},
        "reaction_wheels": wheels,
        "mrp_control": {"k": gain, "ki": ki, "p": p, "integral_limit": rng.uniform(0, 5) * ki},
        "true_anomaly": rng.uniform(0, 360),
        "mrp_attitude_bn": [0.0, 0.0, 0.0],
    }


def draw_orbit(rng: RandomState, k: int) -> dict[str, Any]:
    values = (rng.uniform(6.8e6, 8e6), rng.uniform(0, 0.005), rng.uniform(0, 180), rng.uniform(0, 360), rng.uniform(0, 360))
    return {"id": k, **dict(zip(ORBIT, values, strict=True))}


def draw_tasks(
    rng: RandomState, constellation: Any, count: int, horizon: int, durations: tuple[int, int]
) -> list[dict[str, Any]]:
    """Tasks within 8 degrees of where satellites will be at a time between release and due time."""
    flight, tracks = Flight({"constellation": constellation, "taskset": []}), []
    for tick in range(0, horizon, 10):
        flight.run_to(tick)
        tracks.append(flight.positions @ flight.PN.T)
    tasks = []
    for k in range(count):
        duration = rng.randint(durations[0], durations[1] + 1)
        release = rng.randint(0, max(1, horizon - 3 * duration))
        due = rng.randint(min(release + 3 * duration, horizon - 1), horizon)
        x, y, z = tracks[rng.randint(release, due + 1) // 10][rng.randint(len(flight.crafts))]
        latitude = np.clip(math.degrees(math.atan2(z, math.hypot(x, y))) + rng.uniform(-8, 8), -89.9, 89.9)
        place = [round(float(latitude), 4), round(math.degrees(math.atan2(y, x)) + rng.uniform(-8, 8), 4)]
        times = {"release_time": release, "due_time": due, "duration": duration}
        tasks.append({"id": k, **times, "coordinate": place, "sensor_type": 1})
    return tasks


def drawn(rng: RandomState, count: int, p_over_I: tuple[float, float]) -> dict[str, Any]:
    """A constellation of satellites like those of the benchmark."""
    satellites = [draw_satellite(rng, k, p_over_I) for k in range(count)]
    return {"orbits": [draw_orbit(rng, k) for k in range(count)], "satellites": satellites}


def odd(rng: RandomState) -> dict[str, Any]:
    """A pair that the format allows, though the benchmark draws none of the kind."""
    constellation = drawn(rng, 2, (0.2, 1.0))
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    for k, one in enumerate(constellation["satellites"]):
        moments = np.array([one["inertia"][j] for j in (0, 4, 8)])
        one["inertia"] = ((turn * moments) @ turn.T).ravel().tolist()
        one["center_of_mass"] = rng.uniform(-0.1, 0.1, 3).tolist()
        for wheel in one["reaction_wheels"]:
            wheel["rw_direction"] = (np.array(wheel["rw_direction"]) + rng.uniform(-0.3, 0.3, 3)).tolist()
        one["sensor"] |= {"type": 1 + k, "enabled": True, "half_field_of_view": 3.0}
        one["mrp_attitude_bn"] = (rng.uniform(0.4, 0.8, 3) * (-1) ** k).tolist()
    constellation["satellites"][1]["battery"]["percentage"] = 1.0
    return constellation


def stiff(rng: RandomState) -> dict[str, Any]:
    """Moments that no body has and an empty battery; a satellite that chatters; one whose wheels start near 6000 rpm."""
    constellation = drawn(rng, 1, (0.2, 0.6))
    impossible = constellation["satellites"][0]
    impossible["inertia"] = np.diag([55.0, 70.0, 190.0]).ravel().tolist()
    impossible["battery"]["percentage"] = 0.0002
    for k, bounds in ((1, (2.2, 5.0)), (2, (0.2, 2.0))):
        constellation["satellites"].append(draw_satellite(rng, k, bounds))
        constellation["orbits"].append(draw_orbit(rng, k))
    for wheel in constellation["satellites"][2]["reaction_wheels"]:
        wheel |= {"rw_type": "Honeywell_HR12", "max_momentum": 12.0, "rw_speed_init": 5900.0}
    return constellation


# --- files ---


@dataclass(frozen=True)
class Case:
    """A file: its constellation, tasks, rule, length in seconds, and the ticks whose states are kept."""

    seed: int
    constellation: Callable[[RandomState], dict[str, Any]]
    tasks: int
    durations: tuple[int, int]
    rule: Callable[[], Rule]
    steps: int
    kept: Callable[[int], bool]


CASES = {
    "aeos_bench_random": Case(
        19, lambda rng: drawn(rng, 3, (0.2, 2.0)), 40, (15, 60), lambda: random_rule(1, 50), 300, lambda t: t < 6 or t % 10 < 2
    ),
    "aeos_bench_odd": Case(23, odd, 40, (15, 60), lambda: random_rule(2, 30), 300, lambda t: t < 6 or t % 10 < 2),
    "aeos_bench_stiff": Case(29, stiff, 40, (15, 30), greedy, 120, lambda t: True),
    "aeos_bench_greedy": Case(31, lambda rng: drawn(rng, 5, (0.2, 0.5)), 50, (15, 60), greedy, 1200, lambda t: t % 60 == 0),
}


def fly(scenario: Scenario, rule: Rule, case: Case) -> tuple[dict[str, Array], Progress]:
    """States of the kept ticks, and events: (tick, satellite, task, toggle) and (tick, satellite, task, access)."""
    flight, progress = Flight(scenario), Progress(scenario)
    states: list[list[dict[str, Any]]] = []
    ticks, actions, sights = [], [], []
    seen, last = np.zeros((len(flight.crafts), len(flight.places_P)), dtype=bool), np.full(len(flight.crafts), -1)
    for tick in range(case.steps + 1):
        flight.run_to(tick)
        if case.kept(tick):
            ticks.append(tick)
            states.append([craft.state() for craft in flight.crafts])
        access = flight.access
        choice, toggle = rule(flight, progress.open(tick))
        sights += [(tick, *pair, access[tuple(pair)]) for pair in np.argwhere(access != seen)]
        actions += [(tick, s, choice[s], toggle[s]) for s in np.flatnonzero((choice != last) | toggle)]
        progress.add(flight, access)
        flight.act(choice, toggle)
        seen, last = access, choice
    arrays = {key: np.array([[one[key] for one in row] for row in states]) for key in states[0][0]}
    events = {key: np.array(rows, dtype=np.int32).reshape(-1, 4) for key, rows in (("action", actions), ("access", sights))}
    return {"tick": np.array(ticks, dtype=np.int32), **arrays, **events}, progress


def record(name: str) -> dict[str, Any]:
    """A flight, and how far one is away whose attitude starts ``NUDGE`` away: the largest difference of rates in each tick."""
    case = CASES[name]
    rng = RandomState(case.seed)
    constellation = case.constellation(rng)
    scenario = {"constellation": constellation, "taskset": draw_tasks(rng, constellation, case.tasks, case.steps, case.durations)}
    if name == "aeos_bench_odd":
        for task in scenario["taskset"]:
            task["sensor_type"] = rng.randint(1, 3)
    flown, progress = fly(scenario, case.rule(), case)
    nudged = [one | {"mrp_attitude_bn": [x + NUDGE for x in one["mrp_attitude_bn"]]} for one in constellation["satellites"]]
    rule = again(flown["action"], len(nudged))
    twin, _ = fly({"constellation": constellation | {"satellites": nudged}, "taskset": scenario["taskset"]}, rule, case)
    away = np.abs(twin["omega"] - flown["omega"]).max(-1).astype(np.float32)
    texts = {key: json.dumps(value) for key, value in scenario.items()} | {"versions": json.dumps(versions())}
    return texts | flown | {"success": progress.success, "most": progress.most, "sensitivity": away}


RECORDERS: dict[str, Callable[[str], dict[str, Any]]] = dict.fromkeys(CASES, record)


if __name__ == "__main__":
    record_files(RECORDERS)
