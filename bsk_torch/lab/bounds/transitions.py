"""Transitions between images, recorded in flight."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import torch
from torch import Tensor

from bsk_torch.astro.frames import angle_between
from bsk_torch.env import SatelliteTasking
from bsk_torch.env.rollout import Policy, play_episodes
from bsk_torch.lab.bounds.windows import satellite_positions
from bsk_torch.sats import BoundImagingSatellite


class Transitions(NamedTuple):
    """Pairs of successive images of a satellite.

    Attributes:
        angle: Angle between the directions of both targets from the satellite at the first image, [n] rad.
        ticks: Time from image to image, [n] int64 ticks.
        one_step: Whether the second image was taken in the step after the first, [n].
        carried: Number of excluded images that were carried over; see :func:`carried_over`.
    """

    angle: Tensor
    ticks: Tensor
    one_step: Tensor
    carried: int

    @classmethod
    def joined(cls, parts: list[Transitions]) -> Transitions:
        """The transitions of all ``parts``."""
        angle, ticks, one_step = (torch.cat(column) for column in zip(*(part[:3] for part in parts), strict=True))
        return cls(angle, ticks, one_step, sum(part.carried for part in parts))


def carried_over(imaged: Tensor, ticks: Tensor) -> Tensor:
    """Return which steps were credited with the image of the step before, as masks of any shape.

    A step that ends, because its window closes, in the very tick in which the instrument is told to record leaves the data to the
    next step: bsk_rl and this package credit the image to the next action's target. Such a step lasts a single tick, and no step
    can take an image in fewer than two.

    Args:
        imaged: Whether the step ended with an image.
        ticks: Its length, ticks.
    """
    return imaged & (ticks <= 1)


class ImageStep(NamedTuple):
    """What a step of N episodes imaged.

    Attributes:
        satellite: The satellites.
        r_LP_P: Earth-fixed positions of the targets, [N, T, 3] m.
        own: Whether the step ended with an image that was not carried over, [N].
        carried: Whether it was credited with the image of the step before, [N].
        target: Latest target with an image, [N].
        before, now: Ticks at which it began and ended, [N].
        reward: What it paid, [N]; 0 for episodes that have ended.
    """

    satellite: BoundImagingSatellite
    r_LP_P: Tensor
    own: Tensor
    carried: Tensor
    target: Tensor
    before: Tensor
    now: Tensor
    reward: Tensor


def imaging_satellite(env: SatelliteTasking) -> BoundImagingSatellite:
    """Return the satellite of the environment; ValueError if it takes no images."""
    satellite = env.satellite
    if not isinstance(satellite, BoundImagingSatellite):
        raise ValueError(f"{satellite.name} is a {type(satellite).__name__}; transitions need a sats.ImagingSatellite")
    return satellite


def image_steps(env: SatelliteTasking, policy: Policy, seed: int) -> Iterator[ImageStep]:
    """Play one episode in each row to its end and yield what every step imaged.

    ValueError for a satellite that takes no images.
    """
    satellite = imaging_satellite(env)
    env.set_seed(seed)
    start, state = env.reset(), env.simulator.state
    places = env.simulator.scenario_state["target_r_LP_P"]
    before, images = state.ticks.clone(), satellite.imaged.clone()
    for playing, step in play_episodes(env, policy, start):
        now = state.ticks.clone()
        imaged = (satellite.imaged > images) & playing
        carried = carried_over(imaged, now - before)
        reward = torch.where(playing, step["next", "reward"].squeeze(-1), 0.0)
        yield ImageStep(satellite, places, imaged & ~carried, carried, satellite.latest_target, before, now, reward)
        before, images = now, satellite.imaged.clone()


def record_transitions(env: SatelliteTasking, policy: Policy, seed: int) -> Transitions:
    """Play one episode in each row to its end and return the transitions between images that were not carried over.

    ValueError for a satellite that takes no images.
    """
    rows = torch.arange(len(env.env_ids))
    found, carried = [], 0
    since, from_target = torch.full_like(rows, -1), torch.zeros_like(rows)
    for step in image_steps(env, policy, seed):
        carried += int(step.carried.sum())
        row = rows[step.own & (since >= 0)]
        here = satellite_positions(step.satellite, row, since[row] * env.simulator.h)
        angle = angle_between(step.r_LP_P[row, from_target[row]] - here, step.r_LP_P[row, step.target[row]] - here)
        found.append((angle, step.now[row] - since[row], step.before[row] == since[row]))
        since, from_target = torch.where(step.own, step.now, since), torch.where(step.own, step.target, from_target)
    angles, ticks, one_step = (torch.cat(column) for column in zip(*found, strict=True))
    return Transitions(angles, ticks, one_step, carried)
