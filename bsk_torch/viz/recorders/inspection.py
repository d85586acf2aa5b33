"""Recorder of one inspection episode, for :func:`bsk_torch.tasks.inspection.figure.inspection_figure`."""

from __future__ import annotations

import torch
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from bsk_torch.astro.relative import rv2HN
from bsk_torch.data import ComposedReward
from bsk_torch.env import ConstellationTasking
from bsk_torch.env.base import Tasking
from bsk_torch.env.rollout import play_episodes
from bsk_torch.tasks.inspection import RSOInspectionReward, RSOPoints
from bsk_torch.tasks.inspection.figure import InspectionEpisode
from bsk_torch.viz.recorders.decisions import DecisionLog
from bsk_torch.viz.recorders.episode import first_row

__all__ = ["InspectionRecorder", "inspects", "record_inspection", "rewarder_of"]


def inspects(env: Tasking) -> bool:
    """Return whether the satellites of an environment are rewarded for inspecting points of an RSO."""
    return isinstance(env.scenario, RSOPoints) and rewarder_of(env) is not None


def rewarder_of(env: Tasking) -> RSOInspectionReward | None:
    """Return the rewarder for inspected points, alone or among others; None for other problems."""
    parts = env.rewarder.rewarders if isinstance(env.rewarder, ComposedReward) else [env.rewarder]
    return next((part for part in parts if isinstance(part, RSOInspectionReward)), None)


class InspectionRecorder:
    """Records episode 0 of an environment at every tick and decision, without changing the episode."""

    def __init__(self, env: ConstellationTasking) -> None:
        """Record ``env``, from its next reset on; ValueError for one without an inspection."""
        rewarder = rewarder_of(env)
        if rewarder is None or not isinstance(env.scenario, RSOPoints):
            raise ValueError(f"env has the scenario {env.scenario!r}; an inspection needs RSOPoints and an RSOInspectionReward")
        self.env, self.fleet, self.scenario, self.rewarder = env, env.fleet, env.scenario, rewarder
        self.log, self.decisions = DecisionLog(env), list[float]()
        self.fuel: list[Tensor] = []
        self.lit_at = torch.full((self.scenario.n_points,), torch.inf, dtype=torch.float64)
        self.inspected_at = self.lit_at.clone()
        self.deaths = torch.full((self.fleet.size,), torch.inf, dtype=torch.float64)

    def play(self, policy: TensorDictModuleBase, seed: int) -> None:
        """Play the first episode of ``seed``, with the most probable actions."""
        self.env.set_seed(seed)
        start = self.env.reset()
        self.look()
        with self.env.record(("r_BN_N", "illumination"), rows=0) as recording:
            for _, step in play_episodes(self.env, policy, start, first_row(self.env)):
                self.log.note(step, self.decisions[-1], self.removed)
                self.look()
        self.flight = recording.of(0, 0)

    def paths(self) -> Tensor:
        """Return the positions of the inspectors relative to the RSO, in its Hill frame, at every tick, [I, T, 3] m."""
        r_BN_N = self.flight["r_BN_N"].movedim(1, 0)
        r_C = r_BN_N[self.scenario.rso_column]
        # two positions span the plane of the orbit as position and velocity do
        ahead = torch.cat([r_C[1:] - r_C[:-1], r_C[-1:] - r_C[-2:-1]])
        rho_N = r_BN_N[self.scenario.inspector_columns] - r_C
        return (rv2HN(r_C, ahead) @ rho_N.unsqueeze(-1)).squeeze(-1)

    def look(self) -> None:
        """Note fuel, points and deaths at a decision boundary."""
        now = float(self.fleet.sim_time[0])
        self.decisions.append(now)
        tanks = [self._fuel(k) for k in self.scenario.inspector_types]
        self.fuel.append(torch.cat(tanks))
        self.lit_at = self._noted(self.lit_at, self.rewarder.illuminated[0], now)
        self.inspected_at = self._noted(self.inspected_at, self.rewarder.inspected[0], now)
        self.deaths = self._noted(self.deaths, self.env.dead[0], now)
        self.removed = self.fleet.state.removed[0].clone()

    def _fuel(self, k: int) -> Tensor:
        """What the tanks of the inspectors of a type are good for, m/s [count]; zero if they have none."""
        simulator = self.fleet.simulators[k]
        if not simulator.has_tank:
            return torch.zeros(simulator.count, dtype=torch.float64)
        return simulator.read("dv_available")[: simulator.count].cpu().clone()

    @staticmethod
    def _noted(at: Tensor, happened: Tensor, now: float) -> Tensor:
        return torch.where(happened.cpu(), at.clamp(max=now), at)

    def episode(self) -> InspectionEpisode:
        """Return the recorded episode."""
        points = self.scenario.points_of(0)
        reach = [point.range_max if point.range_max > 0.0 else torch.inf for point in points]
        completed = float(self.rewarder.bonus_reward_time[0])
        columns = self.scenario.inspector_columns
        return InspectionEpisode(
            names=[self.fleet.names[column] for column in columns],
            times=self.flight["time"].cpu(),
            rho_H=self.paths().cpu(),
            illumination=self.flight["illumination"][:, self.scenario.rso_column].cpu(),
            decisions=torch.tensor(self.decisions, dtype=torch.float64),
            fuel=torch.stack(self.fuel, 1),
            points=torch.tensor([list(point.n_B) for point in points], dtype=torch.float64),
            lit_at=self.lit_at,
            inspected_at=self.inspected_at,
            deaths=self.deaths[columns],
            completed=completed if completed == completed else torch.inf,
            reach=max(reach),
            rewards=torch.stack(self.log.rewards, 1)[columns],
            actions=torch.stack(self.log.numbers, 1)[columns] if self.log.width else None,
            tasks=self.log.tasks_of(columns, self.decisions[-1]),
        )


def record_inspection(policy: TensorDictModuleBase, env: ConstellationTasking, *, seed: int) -> InspectionEpisode:
    """Play the first episode of ``seed`` in row 0 of ``env``, with the most probable actions.

    ValueError for an environment without an inspection; see :func:`inspects`.
    """
    recorder = InspectionRecorder(env)
    recorder.play(policy, seed)
    return recorder.episode()
