"""Recorder of one episode of a policy that images targets, with positions of the satellite and of the imaged targets."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, cast

import torch
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from typing_extensions import override

from bsk_torch.act import Image
from bsk_torch.constants import R_EARTH
from bsk_torch.env import SatelliteTasking
from bsk_torch.viz.recorders.track import TrackEpisode, TrackRecorder

__all__ = ["ImagingEpisode", "record_imaging_episode"]

if TYPE_CHECKING:
    from bsk_torch.sats import BoundImagingSatellite
    from bsk_torch.scene.targets import TargetScenario

NONE = -1
"""Target of a decision that does something else."""

OPEN, LOST, UNPAID, IMAGED = range(4)
"""Outcomes of a target: not chosen; chosen, but not imaged; imaged without reward; imaged."""


@dataclass(frozen=True, kw_only=True)
class ImagingEpisode(TrackEpisode):
    """A :class:`TrackEpisode` of T decisions with K targets; positions are Earth-fixed, m.

    Attributes:
        r_LP_P: Positions of the targets, including padding, [K, 3].
        exists: Targets other than padding, [K].
        priority: Highest priority of each target at any decision, [K].
        chosen: Target of each decision, [T]; :data:`NONE` for other actions.
        worth: Priority of the chosen target at its decision, [T].
        imaged: Decisions that led to an image, [T].
        missed: Decisions that ended because the target's window closed without an image, [T].
        least_elevation: Least elevation, rad, of a satellite that images a target.
    """

    r_LP_P: Tensor
    exists: Tensor
    priority: Tensor
    chosen: Tensor
    worth: Tensor
    imaged: Tensor
    missed: Tensor
    least_elevation: float

    @property
    def reach(self) -> float:
        """Angle, rad, at the Earth's center between the satellite and the farthest target that it can image.

        ``acos(q cos e) - e`` at elevation e, with q the Earth's radius over the satellite's.
        """
        e = torch.tensor(self.least_elevation, dtype=torch.float64)
        return float(torch.acos(R_EARTH / self.track.norm(dim=-1).mean() * torch.cos(e)) - e)

    @property
    @override
    def outcome(self) -> str:
        images = int(self.imaged.sum())
        return f"{images} image{'s' * (images != 1)}, {super().outcome}"

    @property
    def outcomes(self) -> Tensor:
        """Outcome of the target of every decision, [T]; :data:`OPEN` for decisions without a target.

        Decisions for the same target in a row are one: they have the outcome of the last one.
        """
        now = torch.where(self.imaged, torch.where(self.rewards > 0.0, IMAGED, UNPAID), LOST)
        goes_on = (self.chosen[1:] == self.chosen[:-1]) & ~self.imaged[:-1]
        number = torch.cat([torch.zeros(1, dtype=torch.int64), (~goes_on).cumsum(0)])
        last = torch.bincount(number).cumsum(0) - 1
        return torch.where(self.chosen >= 0, now[last[number]], OPEN)

    @property
    def fate(self) -> Tensor:
        """Best outcome of every target, [K]."""
        rows = self.chosen >= 0
        none = torch.full((len(self.r_LP_P),), OPEN)
        return none.scatter_reduce(0, self.chosen[rows], self.outcomes[rows], "amax")


class ImagingRecorder(TrackRecorder):
    """Also notes targets and counters."""

    @override
    def look(self) -> dict[str, Tensor]:
        satellite = cast("BoundImagingSatellite", self.satellite)
        seen = {name: getattr(satellite, name)[0] for name in ("latest_target", "imaged", "missed")}
        return super().look() | seen | {"priority": satellite.scenario.priority[0]}

    @override
    def episode(self) -> ImagingEpisode:
        scenario, priority = cast("TargetScenario", self.env.scenario), self.noted("priority")
        entries = self.satellite.actions.entries
        images = torch.tensor([isinstance(entries[k], Image) for k in self.actions], dtype=torch.bool)
        chosen = torch.where(images, self.noted("latest_target")[1:], NONE)
        return ImagingEpisode(
            **vars(super().episode()),
            r_LP_P=scenario.r_LP_P[0].cpu(),
            exists=scenario.drawn("target_exists")[0].cpu() > 0.5,
            priority=priority.amax(0),
            chosen=chosen,
            worth=priority[:-1].gather(1, chosen.clamp(min=0).unsqueeze(-1)).squeeze(-1) * images,
            imaged=self.noted("imaged").diff() > 0,
            missed=self.noted("missed").diff() > 0,
            least_elevation=float(self.simulator.argument("imageTargetMinimumElevation")[0]),
        )


def record_imaging_episode(policy: TensorDictModuleBase, env: SatelliteTasking, *, seed: int) -> ImagingEpisode:
    """Play the first episode of ``seed`` in row 0 of ``env``, with the most probable actions.

    Images are counted at the ends of decisions, which are the times of the images unless ``variable_interval`` is off.

    Raises:
        ValueError: For an environment without targets.
    """
    _check(env)
    recorder = ImagingRecorder(env)
    recorder.play(policy, seed)
    return recorder.episode()


def _check(env: SatelliteTasking) -> None:
    for part, name in ((env.scenario, "most_targets"), (env.satellite, "latest_target")):
        if not hasattr(part, name):
            raise ValueError(
                f"env has a {type(part).__name__}; a ground track needs a scenario with targets, such as scene.UniformTargets, "
                "and a sats.ImagingSatellite, as in AEOS-v1"
            )
