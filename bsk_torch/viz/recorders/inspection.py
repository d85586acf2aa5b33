"""One episode of an inspection, recorded to be drawn by :func:`bsk_torch.viz.figures.inspection.inspection_figure`."""

from __future__ import annotations

import torch
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from bsk_torch.astro.relative import rv2HN
from bsk_torch.constants import NANO
from bsk_torch.data import ComposedReward, RSOInspectionReward
from bsk_torch.env import ConstellationTasking
from bsk_torch.env.rollout import play_episodes
from bsk_torch.scene import RSOPoints
from bsk_torch.sim.trace import Flight
from bsk_torch.viz.figures.inspection import InspectionEpisode
from bsk_torch.viz.recorders.episode import first_row

__all__ = ["InspectionRecorder", "inspects", "record_inspection"]


def inspects(env: ConstellationTasking) -> bool:
    """Return whether the satellites of an environment are rewarded for inspecting points of an RSO."""
    return isinstance(env.scenario, RSOPoints) and any(isinstance(part, RSOInspectionReward) for part in _parts(env))


def _parts(env: ConstellationTasking) -> list[object]:
    return list(env.rewarder.rewarders) if isinstance(env.rewarder, ComposedReward) else [env.rewarder]


class InspectionRecorder:
    """Notes what episode 0 of an environment shows at every tick and decision boundary, without changing what comes next."""

    def __init__(self, env: ConstellationTasking) -> None:
        """Record ``env``, from its next reset on; ValueError for one without an inspection."""
        if not inspects(env):
            raise ValueError(f"env has the scenario {env.scenario!r}; an inspection needs RSOPoints and an RSOInspectionReward")
        assert isinstance(env.scenario, RSOPoints)
        self.env, self.fleet, self.scenario = env, env.fleet, env.scenario
        self.rewarder = next(part for part in _parts(env) if isinstance(part, RSOInspectionReward))
        self.times: list[Tensor] = []
        self.paths: list[Tensor] = []
        self.light: list[Tensor] = []
        self.decisions: list[float] = []
        self.fuel: list[Tensor] = []
        self.lit_at = torch.full((self.scenario.n_points,), torch.inf, dtype=torch.float64)
        self.inspected_at = self.lit_at.clone()
        self.deaths = torch.full((self.fleet.size,), torch.inf, dtype=torch.float64)

    def play(self, policy: TensorDictModuleBase, seed: int) -> None:
        """Play the first episode of ``seed``, with the most probable actions."""
        self.env.set_seed(seed)
        start = self.env.reset()
        self.look()
        self.fleet.flight_observers.append(self.follow)
        try:
            for _ in play_episodes(self.env, policy, start, first_row(self.env)):
                self.look()
        finally:
            self.fleet.flight_observers.remove(self.follow)

    def follow(self, flight: Flight) -> None:
        """Note where the inspectors are at every tick of a flight, and how much of the Sun the RSO sees."""
        here = torch.nonzero(flight.envs == 0).flatten()
        if not len(here):
            return
        row, ticks = int(here[0]), int(flight.ticks[here[0]])
        first = 1 if self.times else 0  # the last record of a flight is the first one of the next
        if ticks < 1:
            return
        r_C = flight.read(self.scenario.rso_type, "r_BN_N")[row, 0, : ticks + 1]
        # two positions span the plane of the orbit as position and velocity do
        ahead = torch.cat([r_C[1:] - r_C[:-1], r_C[-1:] - r_C[-2:-1]])
        HN = rv2HN(r_C, ahead)
        each = [flight.read(k, "r_BN_N")[row, :, : ticks + 1] for k in self.scenario.inspector_types]
        rho_H = (HN @ (torch.cat(each) - r_C).unsqueeze(-1)).squeeze(-1)
        self.times.append((flight.since[row] + torch.arange(first, ticks + 1, device=r_C.device)).cpu())
        self.paths.append(rho_H[:, first:].cpu())
        self.light.append(flight.read(self.scenario.rso_type, "illumination")[row, 0, first : ticks + 1].cpu())

    def look(self) -> None:
        """Note fuel, points and deaths at a decision boundary."""
        now = float(self.fleet.sim_time[0])
        self.decisions.append(now)
        tanks = [self._fuel(k) for k in self.scenario.inspector_types]
        self.fuel.append(torch.cat(tanks))
        self.lit_at = self._noted(self.lit_at, self.rewarder.illuminated[0], now)
        self.inspected_at = self._noted(self.inspected_at, self.rewarder.inspected[0], now)
        self.deaths = self._noted(self.deaths, self.env.dead[0], now)

    def _fuel(self, k: int) -> Tensor:
        """What the tanks of the inspectors of a type are good for, m/s [count]; zero where they have none."""
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
            times=(torch.cat(self.times) * self.fleet.simulators[0].h_ns).double() * NANO,  # rounded as the clock is
            rho_H=torch.cat(self.paths, 1),
            illumination=torch.cat(self.light),
            decisions=torch.tensor(self.decisions, dtype=torch.float64),
            fuel=torch.stack(self.fuel, 1),
            points=torch.tensor([list(point.n_B) for point in points], dtype=torch.float64),
            lit_at=self.lit_at,
            inspected_at=self.inspected_at,
            deaths=self.deaths[columns],
            completed=completed if completed == completed else torch.inf,
            reach=max(reach),
        )


def record_inspection(policy: TensorDictModuleBase, env: ConstellationTasking, *, seed: int) -> InspectionEpisode:
    """Play the first episode of ``seed`` in row 0 of ``env``, with the most probable actions.

    ValueError for an environment without an inspection; see :func:`inspects`.
    """
    recorder = InspectionRecorder(env)
    recorder.play(policy, seed)
    return recorder.episode()
