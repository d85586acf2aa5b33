"""AEOS-Bench: up to fifty satellites point their sensors at tasks on the ground, one joint decision of all in every second.

The cases are those of the user's files, so :func:`aeos_bench` is not among the named presets.

Observation of each satellite, 9 numbers: charge of the battery, the speeds of the three wheels over 6000 rpm, the true anomaly
over pi, the attitude (MRP), and the time over an hour.

Actions: 0 points at the Earth's center, k at task k - 1 of the case. ``action_mask`` allows the tasks that are offered.

Reward: a completed task pays 1 / n of n tasks, shared by the satellites that see it; see :class:`~bsk_torch.data.TaskReward`,
whose ``measures()`` are those of the benchmark. The episode is truncated after an hour. Nothing dies.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import torch

from bsk_torch import act, data, obs, sats, scene
from bsk_torch.constants import RPM
from bsk_torch.env import ConstellationTasking
from bsk_torch.formations import Formation, Settings
from bsk_torch.rand import Key
from bsk_torch.scene.aeos_files import HORIZON, MOST_TORQUE, MU, TOP_SPEED
from bsk_torch.sim import dyn, fsw

__all__ = ["BenchSatellite", "CaseSatellites", "aeos_bench"]

EPOCH = "2019 JAN 01 00:00:00.000 (UTC)"
"""Epoch of all cases."""

FIXED: dict[str, Any] = dict(
    checkInertia=False,  # a seventh of the benchmark's inertias are those of no body
    omega_init=(0.0, 0.0, 0.0),
    mu=MU,
    min_orbital_radius=0.0,
    u_max=(MOST_TORQUE,) * 3,
    rwOmegaMax=(TOP_SPEED,) * 3,
    rwElecToMechEfficiency=(1.0,) * 3,
)
"""Arguments that all satellites of the benchmark share."""


class CaseSatellites(Formation):
    """The satellites of the cases that a :class:`~bsk_torch.scene.AEOSBench` draws."""

    def __init__(self, scenario: scene.AEOSBench) -> None:
        """Follow the draws of ``scenario``."""
        self.scenario = scenario

    def check(self, names: Sequence[str]) -> None:
        """ValueError unless there are as many satellites as the cases are padded to."""
        count = self.scenario.cases.present.shape[1]
        if len(names) != count:
            raise ValueError(f"the cases are padded to {count} satellites, but the environment has {len(names)}")

    def draw(self, key: Key, names: Sequence[str]) -> Settings:
        """See :meth:`Formation.draw`."""
        case = self.scenario.case_of(key)
        return {name: (range(len(names)), values[case]) for name, values in self.scenario.cases.satellites.items()}


class BenchSatellite(sats.Satellite):
    """A satellite of AEOS-Bench."""

    dyn_type = dyn.AEOSBenchDynModel
    fsw_type = fsw.AEOSBenchFSWModel
    observation_spec = (
        obs.SatProperties(
            dict(prop="battery_charge_fraction"),
            dict(prop="wheel_speeds", norm=TOP_SPEED * RPM),
            dict(prop="true_anomaly", norm=math.pi),
            dict(prop="sigma_BN"),
        ),
        obs.Time(),
    )
    action_spec = (act.PointAtTask(),)


def aeos_bench(
    cases: scene.Cases | str | Path,
    satellites: int | None = None,
    tasks: int | None = None,
    *,
    order: Literal["random", "listed"] = "random",
    sensor: Literal["assigned", "on", "chosen"] = "assigned",
    **options: Any,
) -> ConstellationTasking:
    """Return the environment of cases of AEOS-Bench.

    Args:
        cases: A folder with files of the benchmark, or the result of :func:`bsk_torch.scene.read_cases`.
        satellites: Satellites to which the cases of a folder are padded (default: the most of any case).
        tasks: Tasks to which they are padded, likewise.
        order: Cases of the episodes; see :class:`~bsk_torch.scene.AEOSBench`.
        sensor: When sensors are on; see :class:`~bsk_torch.act.PointAtTask`. The benchmark's rule has them always on.
        **options: Arguments of :class:`~bsk_torch.ConstellationTasking` that replace these.

    Raises:
        FileNotFoundError: For a folder without cases.
        ValueError: For files that are not those of the benchmark, and for wrong arguments.
    """
    scenario = scene.AEOSBench(cases, satellites, tasks, order=order)
    kind = type("BenchSatellite", (BenchSatellite,), {"action_spec": (act.PointAtTask(sensor),)})
    # these numbers decide the form of hub and wheels; every episode replaces them
    form = {name: of_form(values) for name, values in scenario.cases.satellites.items()}
    names = [f"Satellite{k}" for k in range(scenario.cases.present.shape[1])]
    defaults: dict[str, Any] = dict(
        scenario=scenario,
        rewarder=data.TaskReward(),
        sat_arg_randomizer=CaseSatellites(scenario),
        world_args={"utc_init": EPOCH},
        time_limit=HORIZON,
        sim_rate=1.0,
        terminate_on_time_limit=False,
    )
    return ConstellationTasking([kind(name, FIXED | form) for name in names], **(defaults | options))


def of_form(values: torch.Tensor) -> Any:
    """Return the numbers of an argument [C, S, ...] of the satellite that has the most that are not zero."""
    each = values.flatten(0, 1)
    return each[int((each != 0.0).flatten(1).sum(1).argmax()) if each.ndim > 1 else 0].tolist()
