"""AEOSBench-v1: up to fifty satellites point their sensors at tasks on the ground, one joint decision of all in every second.

The task is that of AEOS-Bench (NeurIPS 2025, arXiv 2510.26297). By default, every episode draws a small case, of 8 satellites and
50 tasks; those of the benchmark have 1 to 50 satellites and 50 to 300 tasks, ``satellites=(1, 50), tasks=(50, 300)``. Their
orbits are random as in its training set, or with ``orbits="real"`` real as in its test set. With ``folder``, its files are flown.

Observation of each satellite, 9 numbers:

===========================  ====================================================
``battery_charge_fraction``  charge of the battery
``wheel_speeds_normd`` (3)   speeds of the wheels, divided by 6000 rpm
``true_anomaly_normd``       true anomaly, divided by pi
``sigma_BN`` (3)             attitude (MRP)
``time``                     time since the start, divided by an hour
===========================  ====================================================

Actions: 0 points at the Earth's center, k at task k - 1 of the case, for ``step_duration``, by default a second. With
``until_done``, a satellite chooses again once its task has succeeded or is overdue. ``action_mask`` allows the offered tasks.

With ``candidates=True``, satellites also observe the eight tasks that they can be expected to complete first, see
:class:`~bsk_torch.tasks.aeos_bench.TaskProperties`, and action k points at the k-th of them.

Reward: a completed task pays 1 / n of n tasks, shared by the satellites that see it; see
:class:`~bsk_torch.tasks.aeos_bench.TaskReward`, whose ``measures()`` are those of the benchmark.

Termination: nothing dies; an empty battery stops nothing. At the time limit of an hour, the episode is truncated. With
``end_when_closed``, it terminates before, once all tasks have succeeded or are overdue.

Random at reset: orbits, bodies, wheels, gains, panels, sensors and batteries of the satellites, and the tasks; see
:class:`~bsk_torch.tasks.aeos_bench.AEOSBenchGenerator`. With ``folder``, which of its cases is flown.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar, Literal, cast

import torch
from typing_extensions import override

from bsk_torch import obs, sats
from bsk_torch._checks import number, switch
from bsk_torch.constants import RPM
from bsk_torch.env import ConstellationTasking
from bsk_torch.formations import Formation, Settings
from bsk_torch.rand import Key, first_key
from bsk_torch.tasks.aeos_bench.act import PointAtTask
from bsk_torch.tasks.aeos_bench.dyn import AEOSBenchDynModel, AEOSBenchTracedDynModel
from bsk_torch.tasks.aeos_bench.files import HORIZON, MOST_TORQUE, MU, TOP_SPEED, Cases
from bsk_torch.tasks.aeos_bench.fsw import AEOSBenchFSWModel
from bsk_torch.tasks.aeos_bench.generator import AEOSBenchGenerator
from bsk_torch.tasks.aeos_bench.obs import TaskProperties
from bsk_torch.tasks.aeos_bench.reward import TaskReward
from bsk_torch.tasks.aeos_bench.scene import AEOSBench

__all__ = ["BenchSatellite", "CaseSatellites", "aeos_bench"]

EPOCH = "2019 JAN 01 00:00:00.000 (UTC)"
"""Epoch of all cases."""

FIXED: dict[str, object] = dict(
    checkInertia=False,  # a seventh of the benchmark's inertias are those of no body
    omega_init=(0.0, 0.0, 0.0),
    mu=MU,
    min_orbital_radius=0.0,
    u_max=(MOST_TORQUE,) * 3,
    rwOmegaMax=(TOP_SPEED,) * 3,
    rwElecToMechEfficiency=(1.0,) * 3,
)
"""Arguments that all satellites of the benchmark share."""


TICK = 1.0
"""Length of a tick, s."""

SMALL = 8, 50
"""Satellites and tasks of the random cases, unless others are chosen."""


class CaseSatellites(Formation):
    """The satellites of the cases that a :class:`~bsk_torch.tasks.aeos_bench.AEOSBench` draws."""

    def __init__(self, scenario: AEOSBench) -> None:
        """Follow the draws of ``scenario``."""
        self.scenario = scenario

    def check(self, names: Sequence[str]) -> None:
        """ValueError unless there are as many satellites as the cases are padded to."""
        count = self.scenario.cases.n_satellites
        if len(names) != count:
            raise ValueError(f"the cases are padded to {count} satellites, but the environment has {len(names)}")

    @override
    def draw(self, key: Key, names: Sequence[str]) -> Settings:
        return {name: (range(len(names)), values) for name, values in self.scenario.cases_of(key).satellites.items()}


class BenchSatellite(sats.Satellite):
    """A satellite of AEOS-Bench."""

    dyn_type = AEOSBenchDynModel
    fsw_type = AEOSBenchFSWModel
    observation_spec: ClassVar[Sequence[obs.Observation]] = (
        obs.SatProperties(
            dict(prop="battery_charge_fraction"),
            dict(prop="wheel_speeds", norm=TOP_SPEED * RPM),
            dict(prop="true_anomaly", norm=math.pi),
            dict(prop="sigma_BN"),
        ),
        obs.Time(),
    )
    action_spec = (PointAtTask(),)


class HeldBenchSatellite(BenchSatellite):
    """A satellite whose choices last longer than a second."""

    dyn_type = AEOSBenchTracedDynModel


CANDIDATES = 8
"""Tasks among which satellites with candidates choose."""


def aeos_bench(
    folder: str | Path | Cases | AEOSBenchGenerator | None = None,
    satellites: int | tuple[int, int] | None = None,
    tasks: int | tuple[int, int] | None = None,
    *,
    orbits: Literal["random", "real"] = "random",
    order: Literal["random", "listed"] = "random",
    sensor: Literal["assigned", "on", "chosen"] = "assigned",
    step_duration: float = TICK,
    until_done: bool = False,
    end_when_closed: bool = False,
    candidates: bool = False,
    as_set: bool = False,
    haste: float = 1.0,
    obs_type: type | None = None,
    **options: object,
) -> ConstellationTasking:
    """Return AEOSBench-v1: cases of AEOS-Bench; see the module.

    Args:
        folder: A folder with files of the benchmark, the result of :func:`~bsk_torch.tasks.aeos_bench.read_cases`, or a
            generator; None: random cases.
        satellites: Satellites of random cases (default: 8), or the smallest and the largest number. Of a folder: the number to
            which its cases are padded (default: the most of any case).
        tasks: Tasks, likewise (default of random cases: 50).
        orbits: Orbits of random cases; see :class:`~bsk_torch.tasks.aeos_bench.AEOSBenchGenerator`.
        order: Cases of the episodes; see :class:`~bsk_torch.tasks.aeos_bench.AEOSBench`.
        sensor: When sensors are on; see :class:`~bsk_torch.tasks.aeos_bench.PointAtTask`. The benchmark's rule needs "on".
        step_duration: Time for which choices hold, s. With more than a second, tasks still count in every second.
        until_done: Whether a satellite chooses again once its task has succeeded or is overdue, before ``step_duration``.
        end_when_closed: Whether an episode terminates once all tasks have succeeded or are overdue; see
            :class:`~bsk_torch.tasks.aeos_bench.TaskReward`.
        candidates: Whether satellites choose among the 8 tasks that they can be expected to complete first, which
            they observe; see :class:`~bsk_torch.tasks.aeos_bench.TaskProperties`. Sensors are on while a task is chosen.
        as_set: Whether candidates are observed as ``rows`` [N, S, 8, 11] with a ``mask``.
        haste: Share of its expected time that a turn to a candidate may take; see :class:`~bsk_torch.tasks.aeos_bench.AEOSBench`.
        obs_type: ``torch.Tensor`` for one vector, ``dict`` for named observations (default: with ``as_set``).
        **options: Arguments of :class:`~bsk_torch.ConstellationTasking` that replace these.

    Raises:
        FileNotFoundError: For a folder without cases.
        ValueError: For files that are not those of the benchmark, and for wrong arguments.
    """
    held = number("step_duration", step_duration, TICK, unit="s") > TICK
    if switch("until_done", until_done) and not held:
        raise ValueError(f"until_done=True needs a longer step_duration than {TICK:g} s, such as step_duration=60.0")
    action = PointAtTask(
        sensor,
        n_candidates=CANDIDATES if switch("candidates", candidates) else None,
        duration=step_duration if held else None,
        until_done=until_done,
    )
    if candidates and sensor != "assigned":
        raise ValueError(f"sensor={sensor!r} does not go with candidates=True, for which it must be 'assigned'")
    if as_set and not candidates:
        raise ValueError("as_set=True observes candidates as a set; give candidates=True with it")
    own, time = BenchSatellite.observation_spec
    ahead = (TaskProperties(n_ahead_observe=CANDIDATES, as_set=switch("as_set", as_set)),) if candidates else ()
    observed_as = (dict if as_set else torch.Tensor) if obs_type is None else obs_type
    if folder is not None and orbits != "random":
        raise ValueError(f"orbits={orbits!r} is of random cases, but folder gives the cases; leave one of them out")
    if folder is None:
        sizes = SMALL[0] if satellites is None else satellites, SMALL[1] if tasks is None else tasks
        generator = AEOSBenchGenerator(*sizes, orbits)
        scenario = AEOSBench(generator, order=order, haste=haste)
    else:  # ranges are an error of the scenario
        scenario = AEOSBench(folder, cast("int | None", satellites), cast("int | None", tasks), order=order, haste=haste)
    # these numbers decide the form of hub and wheels; every episode replaces them
    example = scenario.cases if isinstance(scenario.cases, Cases) else scenario.cases_of(first_key(1))
    form = {name: of_form(values) for name, values in example.satellites.items()}
    names = [f"Satellite{k}" for k in range(scenario.cases.n_satellites)]
    defaults: dict[str, Any] = dict(
        scenario=scenario,
        rewarder=TaskReward(end_when_closed=end_when_closed),
        sat_arg_randomizer=CaseSatellites(scenario),
        world_args={"utc_init": EPOCH},
        time_limit=HORIZON,
        sim_rate=TICK,
        terminate_on_time_limit=False,
    )
    kind = HeldBenchSatellite if held else BenchSatellite
    settings: dict[str, Any] = dict(obs_type=observed_as, observation_spec=(own, *ahead, time), action_spec=(action,))
    fleet = [kind(name, FIXED | form, **settings) for name in names]
    return ConstellationTasking(fleet, **(defaults | options))


def of_form(values: torch.Tensor) -> Any:
    """Return the numbers of an argument [C, S, ...] of the satellite that has the most that are not zero."""
    rows = values.flatten(0, 1)
    return rows[int((rows != 0.0).flatten(1).sum(1).argmax()) if rows.ndim > 1 else 0].tolist()
