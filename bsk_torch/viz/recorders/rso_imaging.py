"""Recorder of one episode of imaging in orbit, and of skies, for the figures of :mod:`bsk_torch.tasks.objects.figure`."""

from __future__ import annotations

import torch
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from bsk_torch._checks import whole
from bsk_torch.constants import R_EARTH
from bsk_torch.data import ComposedReward
from bsk_torch.env import ConstellationTasking
from bsk_torch.env.base import Tasking
from bsk_torch.env.rollout import play_episodes
from bsk_torch.sats.bound import BoundSatellite
from bsk_torch.sim.names import nearest
from bsk_torch.tasks.objects import RSOImageReward, RSOTargets
from bsk_torch.tasks.objects.candidates import Candidates, Views
from bsk_torch.tasks.objects.figure import RSOImagingEpisode, Sky
from bsk_torch.tasks.objects.reward import NONE
from bsk_torch.viz.recorders.constellation import quantities
from bsk_torch.viz.recorders.decisions import DecisionLog
from bsk_torch.viz.recorders.episode import first_row

__all__ = ["RSOImagingRecorder", "images_objects", "record_rso_imaging", "sky_of"]


def images_objects(env: Tasking) -> bool:
    """Return whether the satellites of an environment are rewarded for images of the objects of a catalog."""
    return isinstance(env.scenario, RSOTargets) and rewarder_of(env) is not None


def rewarder_of(env: Tasking) -> RSOImageReward | None:
    """Return the rewarder for images of objects, alone or among others; None for other problems."""
    parts = env.rewarder.rewarders if isinstance(env.rewarder, ComposedReward) else [env.rewarder]
    return next((part for part in parts if isinstance(part, RSOImageReward)), None)


def images_on_board(rewarder: RSOImageReward) -> list[tuple[int, int, float, float]]:
    """Return imager, object, time and quality of the images that the imagers of episode 0 hold."""
    memory = rewarder.memory
    target, time, quality = (memory[f"rso_product_{name}"][0].cpu() for name in ("target", "time", "quality"))
    there = target != NONE
    imager = torch.arange(target.shape[1]).expand_as(target)
    return list(zip(*(part[there].tolist() for part in (imager, target, time, quality)), strict=True))


def _parts(env: Tasking) -> tuple[RSOTargets, RSOImageReward]:
    """Return scenario and rewarder; ValueError for other problems."""
    rewarder = rewarder_of(env)
    if rewarder is None or not isinstance(env.scenario, RSOTargets):
        raise ValueError(f"env has the scenario {env.scenario!r}; imaging in orbit needs RSOTargets and an RSOImageReward")
    return env.scenario, rewarder


def _views(scenario: RSOTargets, satellite: BoundSatellite) -> tuple[Candidates, Views]:
    """Return all objects in the order of the catalog, and what satellites of a type see of them."""
    place = torch.arange(scenario.n_targets, device=satellite.simulator.device).expand(satellite.simulator.state.rows, -1)
    everything = Candidates(place, torch.ones_like(place, dtype=torch.bool))
    return everything, scenario.views(satellite, everything)


def sky_of(env: Tasking, imager: str | None = None, env_row: int = 0) -> Sky:
    """Return the current sky of an imager.

    Args:
        env: The environment, after a reset.
        imager: Name of the imager (default: the first one).
        env_row: Which of its episodes.

    Raises:
        ValueError: For an environment without imaging in orbit, an unknown imager, or an episode that does not exist.
    """
    scenario, rewarder = _parts(env)
    name = scenario.imager_names[0] if imager is None else imager
    if name not in scenario.imager_names:
        raise ValueError(f"imager={name!r} is none of {list(scenario.imager_names)}; {nearest(str(name), scenario.imager_names)}")
    whole("env_row", env_row, 0, env.batch_size[0] - 1)
    kind, number = env.fleet.place_of(name)
    satellite = env.fleet.satellites[kind]
    row = env_row * satellite.simulator.count + number
    everything, seen = _views(scenario, satellite)
    candidates = scenario.candidates(satellite, scenario.n_targets)
    _, ahead, normal = seen.rel_pos_vector_r_BR_H[row].cpu().unbind(-1)
    height = float(satellite.dynamics.r_BN_N[row].norm())
    return Sky(
        imager=name,
        time=float(env.fleet.sim_time[env_row]),
        ids=scenario.ids,
        azimuth=torch.rad2deg(torch.atan2(-normal, ahead)),
        elevation=seen.target_elevation_angle[row].cpu(),
        limb=-float(torch.rad2deg(torch.acos(torch.tensor(R_EARTH / height)))),
        light=seen.target_illumination_factor[row].cpu(),
        in_sight=scenario.in_sight(satellite, everything)[row].cpu(),
        priority=scenario.priority[env_row].cpu(),
        pending=scenario.pending[env_row].cpu(),
        imaged=rewarder.imaged[env_row].cpu(),
        candidates=candidates.place[row][candidates.exists[row]].cpu(),
    )


class RSOImagingRecorder:
    """Records episode 0 of an environment at every decision, without changing the episode."""

    def __init__(self, env: Tasking) -> None:
        """Record ``env``, from its next reset on; ValueError for one without imaging in orbit, or without separate agents."""
        self.scenario, self.rewarder = _parts(env)
        if not isinstance(env, ConstellationTasking) or env.joint:
            raise ValueError(
                "imaging in orbit is recorded agent by agent; build env as a ConstellationTasking without joint=True"
            )
        self.env, self.fleet, self.log = env, env.fleet, DecisionLog(env)
        self.columns = self.scenario.imager_columns
        self.decisions: list[float] = []
        self.lights: list[Tensor] = []
        self.priorities: list[Tensor] = []
        self.series: dict[str, list[Tensor]] = {}
        self.qualities: dict[tuple[int, int, float], float] = {}
        self.deliveries: dict[tuple[int, int, float], float] = {}
        self.on_board: set[tuple[int, int, float]] = set()
        self.deaths = torch.full((self.fleet.size,), torch.inf, dtype=torch.float64)

    def play(self, policy: TensorDictModuleBase, seed: int) -> None:
        """Play the first episode of ``seed``, with the most probable actions."""
        self.env.set_seed(seed)
        start = self.env.reset()
        self.look()
        for _, step in play_episodes(self.env, policy, start, first_row(self.env)):
            self.log.note(step, self.decisions[-1], self.removed)
            self.look()

    def look(self) -> None:
        """Note images, deliveries, light and deaths at a decision boundary."""
        now = float(self.fleet.sim_time[0])
        self.decisions.append(now)
        first = self.fleet.satellites[self.scenario.imager_types[0]]
        self.lights.append(_views(self.scenario, first)[1].target_illumination_factor[0].cpu())
        self.priorities.append(self.scenario.priority[0].cpu())
        for name, values in quantities(self.fleet).items():
            self.series.setdefault(name, []).append(values[self.columns])
        products = {(k, target, time): quality for k, target, time, quality in images_on_board(self.rewarder)}
        for image in self.on_board - products.keys():
            self.deliveries[image] = now
        self.qualities |= products
        self.on_board = set(products)
        self.deaths = torch.where(self.env.dead[0].cpu(), self.deaths.clamp(max=now), self.deaths)
        self.removed = self.fleet.state.removed[0].clone()

    def episode(self) -> RSOImagingEpisode:
        """Return the recorded episode."""
        images = sorted(self.qualities, key=lambda image: image[2])
        return RSOImagingEpisode(
            names=[self.fleet.names[column] for column in self.columns],
            ids=self.scenario.ids,
            decisions=torch.tensor(self.decisions, dtype=torch.float64),
            light=torch.stack(self.lights, 1),
            priority=torch.stack(self.priorities, 1),
            taken=torch.tensor([image[2] for image in images], dtype=torch.float64),
            delivered=torch.tensor([self.deliveries.get(image, torch.inf) for image in images], dtype=torch.float64),
            imager=torch.tensor([image[0] for image in images], dtype=torch.int64),
            target=torch.tensor([image[1] for image in images], dtype=torch.int64),
            quality=torch.tensor([self.qualities[image] for image in images], dtype=torch.float64),
            rewards=torch.stack(self.log.rewards, 1)[self.columns],
            deaths=self.deaths[self.columns],
            tasks=self.log.tasks_of(self.columns, self.decisions[-1]),
            series={name: torch.stack(values, 1) for name, values in self.series.items()},
        )


def record_rso_imaging(policy: TensorDictModuleBase, env: Tasking, *, seed: int) -> RSOImagingEpisode:
    """Play the first episode of ``seed`` in row 0 of ``env``, with the most probable actions.

    ValueError for an environment without imaging in orbit, see :func:`images_objects`, or without separate agents.
    """
    recorder = RSOImagingRecorder(env)
    recorder.play(policy, seed)
    return recorder.episode()
