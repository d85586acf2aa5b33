"""Recorder of one episode of a policy."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import torch
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from bsk_torch.env import SatelliteTasking, Tasking
from bsk_torch.env.rollout import Policy, play_episodes
from bsk_torch.sats import BoundAccessSatellite
from bsk_torch.viz.table import Columns, Tabular, number_columns

__all__ = ["Episode", "record_episode"]

QUANTITIES = {
    "battery_charge_fraction": "battery",
    "storage_level_fraction": "data buffer",
    "wheel_speeds_fraction": "wheel speeds",
}
"""Recorded properties of the dynamics model, if the satellite has them, and their names in figures."""


@dataclass(frozen=True, kw_only=True)
class Episode(Tabular):
    """One recorded episode of T decisions; times are seconds since reset.

    Attributes:
        names: Names of the entries of the satellite's ``action_spec``.
        times: Times of the decisions, and of the end, [T + 1].
        actions: Index into ``names`` of each decision, [T].
        rewards: Reward of each decision, [T].
        series: Quantities at these times by name, [T + 1, width] each; see :data:`QUANTITIES`.
        eclipses: Start and end of every eclipse, [n, 2].
        passes: Start and end of every period in view of a ground station, [n, 2].
        died: Whether the satellite died.
    """

    names: list[str]
    times: Tensor
    actions: Tensor
    rewards: Tensor
    series: dict[str, Tensor]
    eclipses: Tensor
    passes: Tensor
    died: bool

    @property
    def total(self) -> float:
        """Return of the episode."""
        return float(self.rewards.sum())

    @property
    def outcome(self) -> str:
        """Outcome of the episode as text."""
        return f"return {self.total:.3f}, {'died' if self.died else 'survived'}"

    def columns(self) -> dict[str, Tensor]:
        """Return the quantities at the boundaries by name, [T + 1, width] each."""
        return dict(self.series)

    def to_numpy(self) -> Columns:
        """Return the episode as a table: columns by name, [T + 1] each, a row for each decision boundary.

        ``time`` is in seconds since reset; ``action`` and ``reward`` belong to the decision that begins there, empty and nan in
        the last row. Quantities of several numbers have a column for each, such as ``wheel_speeds_fraction_0``.
        """
        decisions: Columns = {
            "time": self.times.double().numpy(),
            "action": np.array([*(self.names[k] for k in self.actions.tolist()), ""]),
            "reward": np.append(self.rewards.double().numpy(), np.nan),
        }
        return decisions | number_columns(self.columns())


def first_row(env: Tasking) -> Tensor:
    """True for the recorded row 0 of an environment, [N]."""
    return torch.arange(env.batch_size[0], device=env.device) == 0


class Recorder:
    """Records row 0 of an environment at every decision, without changing the episode."""

    def __init__(self, env: SatelliteTasking) -> None:
        """Record ``env``, starting with its next reset."""
        self.env, self.satellite, self.simulator = env, env.satellite, env.simulator
        self.boundaries: list[dict[str, Tensor]] = []
        self.actions: list[int] = []
        self.rewards: list[float] = []
        self.eclipses: set[tuple[float, float]] = set()
        self.passes: set[tuple[float, float]] = set()

    def look(self) -> dict[str, Tensor]:
        """Return the quantities recorded at a boundary."""
        dynamics = self.satellite.dynamics
        there = {name: getattr(dynamics, name)[0] for name in QUANTITIES if hasattr(type(dynamics), name)}
        return {"times": self.simulator.sim_time[0], **{name: value.reshape(-1) for name, value in there.items()}}

    def note(self) -> None:
        """Record the current state."""
        self.boundaries.append({name: value.clone() for name, value in self.look().items()})
        now = float(self.simulator.sim_time[0])
        start, end = (float(time[0]) for time in self.satellite.next_eclipse())
        self.eclipses.add((start if start < end else now, end))
        if isinstance(self.satellite, BoundAccessSatellite) and "ground_station" in self.satellite.opportunity_types:
            known = self.satellite.opportunities_dict(0, "ground_station")
            self.passes.update(window for windows in known.values() for window in windows)

    def play(self, policy: Policy, seed: int) -> None:
        """Play the first episode of ``seed``, with the most probable actions."""
        self.env.set_seed(seed)
        start = self.env.reset()
        self.note()
        for _, step in play_episodes(self.env, policy, start, first_row(self.env)):
            self.actions.append(self.satellite.actions.entry_of(step["action"][0]))
            self.rewards.append(float(step["next", "reward"][0]))
            self.note()

    def noted(self, name: str) -> Tensor:
        """Return the recorded values of ``name``, [T + 1, ...]."""
        return torch.stack([boundary[name] for boundary in self.boundaries]).cpu()

    def episode(self) -> Episode:
        """Return the recorded episode."""
        times = self.noted("times")
        last = float(times[-1])
        return Episode(
            names=[entry.name for entry in self.satellite.actions.entries],
            times=times,
            actions=torch.tensor(self.actions, dtype=torch.int64),
            rewards=torch.tensor(self.rewards, dtype=torch.float64),
            series={name: self.noted(name) for name in QUANTITIES if name in self.boundaries[0]},
            eclipses=union(self.eclipses, last),
            passes=union(self.passes, last),
            died=bool(self.env.dead[0]),
        )


def union(intervals: Iterable[tuple[float, float]], last: float) -> Tensor:
    """Return start and end, [n, 2], of the union of the intervals between 0 and ``last``, in ascending order."""
    merged: list[list[float]] = []
    for start, end in sorted((max(start, 0.0), min(end, last)) for start, end in intervals):
        if merged and start <= merged[-1][1]:
            merged[-1][1] = max(merged[-1][1], end)
        elif start < end:
            merged.append([start, end])
    return torch.tensor(merged, dtype=torch.float64).reshape(-1, 2)


def record_episode(policy: TensorDictModuleBase, env: SatelliteTasking, *, seed: int) -> Episode:
    """Play the first episode of ``seed`` in row 0 of ``env``, with the most probable actions."""
    recorder = Recorder(env)
    recorder.play(policy, seed)
    return recorder.episode()
