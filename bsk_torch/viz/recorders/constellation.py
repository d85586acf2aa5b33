"""Recorder of one episode of a constellation, for :func:`bsk_torch.viz.figures.constellation.constellation_figure`."""

from __future__ import annotations

from typing import NamedTuple

import torch
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from bsk_torch.astro.frames import fixed_to_lla
from bsk_torch.env import ConstellationTasking
from bsk_torch.env.rollout import play_episodes
from bsk_torch.sats.fleet import SatelliteFleet
from bsk_torch.viz.figures.constellation import ConstellationEpisode
from bsk_torch.viz.recorders.decisions import DecisionLog
from bsk_torch.viz.recorders.episode import QUANTITIES, first_row

__all__ = ["ConstellationRecorder", "record_constellation"]

SAME_PLANE = 1e-6
"""Nodes and inclinations, rad, that differ by less are those of one plane."""


class Image(NamedTuple):
    """An image: its time, satellite and target, and whether it was rewarded."""

    time: float
    satellite: int
    target: int
    paid: bool


class ConstellationRecorder:
    """Records episode 0 of an environment at every decision, without changing the episode."""

    def __init__(self, env: ConstellationTasking) -> None:
        """Record ``env``, from its next reset on."""
        self.env, self.fleet = env, env.fleet
        self.times: list[float] = []
        self.places: list[Tensor] = []
        self.links: list[Tensor] = []
        self.images: list[Image] = []
        self.log = DecisionLog(env)
        self.series: dict[str, list[Tensor]] = {}
        self.deaths = torch.full((self.fleet.size,), torch.inf, dtype=torch.float64)

    def look(self) -> None:
        """Record positions and active links."""
        self.times.append(float(self.fleet.sim_time[0]))
        self.places.append(self.fleet.each(lambda part: part.dynamics.r_BN_P)[0].cpu())
        for name, values in quantities(self.fleet).items():
            self.series.setdefault(name, []).append(values)
        links = self.env.links
        none = torch.zeros(self.fleet.size, self.fleet.size, dtype=torch.bool)
        self.links.append(none if links is None or len(self.times) == 1 else links[0].cpu())
        self.present = self.env.present[0].cpu()
        self.counted, self.removed = self._counts(), self.fleet.state.removed[0].clone()
        self.deaths = torch.where(self.env.dead[0].cpu(), self.deaths.clamp(max=self.times[-1]), self.deaths)

    def play(self, policy: TensorDictModuleBase, seed: int) -> None:
        """Play the first episode of ``seed``, with the most probable actions."""
        self.env.set_seed(seed)
        start = self.env.reset()
        self.look()
        for _, step in play_episodes(self.env, policy, start, first_row(self.env)):
            self.log.note(step, self.times[-1], self.removed)
            before = self.counted
            self.look()
            self._note_images(before)

    def _counts(self) -> tuple[Tensor, Tensor]:
        """Images and images without reward of each satellite, [S] each."""
        counts, none = self.env.counts(), torch.zeros(1, self.fleet.size, dtype=torch.int64)
        return counts.get("imaged", none)[0].clone(), counts.get("duplicates", none)[0].clone()

    def _note_images(self, before: tuple[Tensor, Tensor]) -> None:
        images, again = (after - old for after, old in zip(self.counted, before, strict=True))
        if not bool(images.any()):
            return
        target = self.fleet.each(lambda part: part.latest_target, missing=-1)[0]
        for k in torch.nonzero(images > 0).flatten().tolist():
            self.images.append(Image(self.times[-1], k, int(target[k]), not bool(again[k])))

    def _planes(self) -> Tensor | None:
        """Orbital plane of each satellite, [S]; None where orbits were not given as elements."""
        if any(part.simulator.argument("oe") is None for part in self.fleet.satellites):
            return None
        oe = self.fleet.each(lambda part: part.simulator.state.arguments["oe"])[0].cpu()
        _, plane = torch.unique(torch.round(oe[:, 2:4] / SAME_PLANE), dim=0, return_inverse=True)
        return plane

    def episode(self) -> ConstellationEpisode:
        """Return the recorded episode, of the satellites that took part in it."""
        shown = torch.nonzero(self.present).squeeze(-1)
        number, planes = self.present.cumsum(0) - 1, self._planes()  # of each satellite among those shown
        latitude, longitude, _ = fixed_to_lla(torch.stack(self.places, 1)[shown])
        images = torch.tensor([image.target for image in self.images], dtype=torch.int64)
        targets = (
            self.env.scenario.r_LP_P[0].cpu() if hasattr(self.env.scenario, "r_LP_P") else torch.empty(0, 3, dtype=torch.float64)
        )
        if hasattr(self.env.scenario, "most_targets"):
            there = self.fleet.scenario_state["target_exists"][0].cpu() > 0.5
        else:
            there = torch.zeros(0, dtype=torch.bool)
        where = fixed_to_lla(targets)
        tasks = self.log.tasks_of(shown.tolist(), self.times[-1])
        return ConstellationEpisode(
            names=[self.fleet.names[k] for k in shown.tolist()],
            times=torch.tensor(self.times, dtype=torch.float64),
            latitude=torch.rad2deg(latitude),
            longitude=torch.rad2deg(longitude),
            groups=None if planes is None else planes[shown],
            links=None if self.env.links is None else torch.stack(self.links)[:, shown][:, :, shown],
            image_times=torch.tensor([image.time for image in self.images], dtype=torch.float64),
            image_satellite=number[torch.tensor([image.satellite for image in self.images], dtype=torch.int64)],
            image_latitude=torch.rad2deg(where[0])[images],
            image_longitude=torch.rad2deg(where[1])[images],
            image_paid=torch.tensor([image.paid for image in self.images], dtype=torch.bool),
            target_latitude=torch.rad2deg(where[0])[there],
            target_longitude=torch.rad2deg(where[1])[there],
            task_satellite=tasks.satellite,
            task_spans=tasks.spans,
            task_kind=tasks.kind,
            task_names=tasks.names,
            deaths=self.deaths[shown],
            rewards=torch.stack(self.log.rewards, 1)[shown],
            series={name: torch.stack(values, 1)[shown] for name, values in self.series.items()},
            actions=torch.stack(self.log.numbers, 1)[shown] if self.log.width else None,
        )


def quantities(fleet: SatelliteFleet) -> dict[str, Tensor]:
    """Return the :data:`QUANTITIES` of all satellites of episode 0 that have them, [S, width] each, nan for those that do not."""
    found = {}
    for name in QUANTITIES:
        parts = [part for part in fleet.satellites if hasattr(type(part.dynamics), name)]
        values = {id(part): _matrix(getattr(part.dynamics, name)) for part in parts}
        if values:
            width = max(value.shape[1] for value in values.values())
            wide = [
                torch.nn.functional.pad(value, (0, width - value.shape[1]), value=torch.nan)
                for value in (values.get(id(part), _matrix(part.dynamics.r_BN_P)[:, :0]) for part in fleet.satellites)
            ]
            found[name] = fleet.joined(wide)[0].cpu()
    return found


def _matrix(value: Tensor) -> Tensor:
    """Return a quantity of rows, [R] or [R, width], as [R, width]."""
    return value.double().reshape(len(value), -1)


def record_constellation(policy: TensorDictModuleBase, env: ConstellationTasking, *, seed: int) -> ConstellationEpisode:
    """Play the first episode of ``seed`` in row 0 of ``env``, with the most probable actions.

    ValueError for ``joint=True``, whose agent has no group.
    """
    if env.joint:
        raise ValueError("env has joint=True; a constellation is recorded agent by agent, so build it without")
    recorder = ConstellationRecorder(env)
    recorder.play(policy, seed)
    return recorder.episode()
