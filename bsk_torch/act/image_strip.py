"""Actions that record strips on the ground."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch._checks import number
from bsk_torch.act.base import Decision
from bsk_torch.act.candidates import NO_TARGET
from bsk_torch.act.continuous import HybridAction
from bsk_torch.act.image import Image
from bsk_torch.sats.bound import BoundSatellite
from bsk_torch.scene.overlaid import StripTargets
from bsk_torch.sim.fsw.strip import STRIP_MODE


class ImageStrip(Image):
    """Record the strip of the k-th next access window, for k from 0 to ``n_ahead_image`` - 1.

    The instrument follows a place that moves along the strip and its extension before the start, and records from the start on.
    The action ends at the end of the strip. It starts so that the middle of the strip is passed in the middle of the window, but
    not before ``pre_imaging_time`` has passed, in which the satellite turns. Choosing a strip again starts it from the beginning.

    For :class:`bsk_torch.scene.StripTargets` and :class:`bsk_torch.sim.fsw.StripImagingFSWModel`.
    """

    flight_mode = STRIP_MODE

    def __init__(
        self,
        n_ahead_image: int,
        pre_imaging_time: float = 60.0,
        name: str = "action_image_strip",
        mask_repeated: bool = False,
        mask_late: bool = True,
    ) -> None:
        """See :class:`Image`; a strip is recorded ``pre_imaging_time``, s, after the choice at the earliest."""
        super().__init__(n_ahead_image, None, name, mask_repeated, mask_late)
        self.pre_imaging_time = number("pre_imaging_time", pre_imaging_time, 0.0, 1e5, unit="s")

    def link_satellite(self, satellite: BoundSatellite) -> None:
        """See :meth:`Image.link_satellite`; ValueError for targets other than strips."""
        super().link_satellite(satellite)
        if "strip_length" not in satellite.simulator.scenario_state:
            raise ValueError(f"{self.name!r} needs strips, such as scenario=scene.StripTargets(scene.UniformTargets(300))")

    @override
    def decide(self, index: Tensor, mask: Tensor, action: Tensor, previous: Tensor) -> Decision:
        now = self.satellite.simulator.sim_time
        chosen = super().decide(index, mask, action, previous)
        waits = chosen.key == NO_TARGET
        target = torch.where(waits, 0, self.keys(chosen.key))  # keys() is its own inverse
        seconds = self._look_up("strip_seconds", target)
        opens, closes = self.satellite.window_of(target, self.kind)
        best = torch.where(torch.isfinite(closes), 0.5 * (opens + closes - seconds), now)
        before = torch.maximum(best - now, torch.full_like(now, self.pre_imaging_time))
        duration = torch.where(waits, chosen.duration, before + seconds)
        return chosen._replace(retask=~waits, duration=duration, expected=duration, command=before)

    def begin(self, mask: Tensor, decision: Decision) -> None:
        """See :meth:`Image.begin`: set the strip, and the place before its start from which the instrument follows it."""
        simulator, mask = self.satellite.simulator, mask & (decision.key != NO_TARGET)
        target = torch.where(mask, self.keys(decision.key), 0)
        middle, along, length = (self._look_up(name, target) for name in ("r_LP_P", "strip_along", "strip_length"))
        radius = middle.norm(dim=-1)
        half, rate = 0.5 * length / radius, self._scenario.acquisition_speed / radius
        before = torch.zeros_like(half) if decision.command is None else decision.command
        strip = {"middle": middle, "along": along, "half": half, "rate": rate, "angle": -half - rate * before}
        for name, value in strip.items():
            simulator.write(f"strip_{name}", mask, value)
        self.remember(mask, target)

    def end(self, mask: Tensor, decision: Decision, event: Tensor) -> None:
        """See :meth:`Image.end`; the rewarder finds out whether the strip was recorded."""

    @property
    def _scenario(self) -> StripTargets:
        return self.satellite.scenario

    def _look_up(self, name: str, target: Tensor) -> Tensor:
        """Return values of the scenario for each satellite's target [N], [N, ...]."""
        return self.satellite.simulator.look_up(getattr(self._scenario, name), target.unsqueeze(1)).squeeze(1)


class HybridImageStrip(HybridAction):
    """Record one of the next strips after a chosen time, as in a branch of BSK-RL.

    The choice is a strip as in :class:`ImageStrip`. The number ``x`` in [0, 1] sets the time before the strip is recorded to
    ``x`` times ``max_duration``, whatever the window is.
    """

    def __init__(self, n_ahead_image: int, max_duration: float = 300.0, name: str = "action_image_strip") -> None:
        """Provide ``n_ahead_image`` choices; ValueError for fewer than one, or a ``max_duration``, s, that is not positive."""
        super().__init__(name)
        self.max_duration = number("max_duration", max_duration, 0.0, 1e5, unit="s", above=True)
        self.strips = ImageStrip(n_ahead_image, name=name)

    @override
    def link_satellite(self, satellite: BoundSatellite) -> None:
        super().link_satellite(satellite)
        self.strips.link_satellite(satellite)

    @override
    def bounds(self) -> tuple[Sequence[float], Sequence[float]]:
        return [0.0], [1.0]

    @override
    def names(self) -> list[str]:
        return ["pre_imaging_time"]

    @override
    def choices(self) -> list[str]:
        return self.strips.names()

    @override
    def decide(self, action: Tensor, mask: Tensor) -> Decision:
        choice = action[:, 1].long()
        chosen = self.strips.decide(choice, mask, choice, torch.full_like(choice, NO_TARGET))
        waits = chosen.key == NO_TARGET
        seconds = self.strips._look_up("strip_seconds", torch.where(waits, 0, self.strips.keys(chosen.key)))
        before = action[:, 0].clamp(0.0, 1.0) * self.max_duration
        duration = torch.where(waits, chosen.duration, before + seconds)
        return chosen._replace(duration=duration, expected=duration, command=before)

    @override
    def begin(self, mask: Tensor, decision: Decision) -> None:
        self.strips.begin(mask, decision)
