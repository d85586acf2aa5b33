"""Action that images a resident space object (RSO) of a catalog."""

from __future__ import annotations

import math

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch._checks import number, switch, whole
from bsk_torch.act.base import Decision, positive_duration
from bsk_torch.act.candidates import NO_TARGET, SLEW, CandidateAction
from bsk_torch.sats.bound import BoundSatellite
from bsk_torch.sim.names import one_of
from bsk_torch.tasks.objects.aim import AIM
from bsk_torch.tasks.objects.candidates import Candidates
from bsk_torch.tasks.objects.scene import POSITIONS, RSOTargets, check_imager

HOLD_MODES = ("cumulative", "continuous")

EXPOSURES = ("held", "first")


class ImageRSO(CandidateAction):
    """Image the k-th candidate, for k from 0 to ``n_ahead_image`` - 1.

    For their order, see :class:`~bsk_torch.tasks.objects.RSOTargets`. The satellite points at the target. The image is taken in
    the first tick in which pointing, line of sight and light have been right for ``min_pointing_hold_s`` and the store has
    room; see :func:`bsk_torch.tasks.objects.dyn.hold`. The action ends with it, or after ``max_duration``. Choosing the same
    target again starts over.

    With ``exposure="first"``, the image is taken in the tick after the first one in which pointing and line of sight are right,
    and lost if the store is full then. The hold is checked afterward; see :func:`bsk_torch.tasks.objects.dyn.check_hold`. The
    action ends when the image is stored and the hold complete. At the deadline, an image without a complete hold remains in the
    store, with the light of that time as its quality; if another command comes before, with the quality zero.

    Without as many candidates, the last actions wait for ``max_duration`` in the present mode; ``action_mask`` excludes them.
    Actions -1, -2, ... select targets 0, 1, ... of the catalog, see :func:`~bsk_torch.act.image_target`; they must be eligible.
    """

    aim = AIM
    drawn = POSITIONS

    def __init__(
        self,
        n_ahead_image: int,
        max_duration: float = 300.0,
        min_pointing_hold_s: float = 10.0,
        hold_mode: str = "cumulative",
        require_illumination_during_hold: bool = True,
        hold_illumination_threshold: float = 0.5,
        variable_duration_imaging: bool = True,
        name: str = "image_rso",
        exposure: str = "held",
    ) -> None:
        """Provide ``n_ahead_image`` actions.

        Args:
            n_ahead_image: Number of candidates to choose from.
            max_duration: Time until the deadline, s, at which no image is taken.
            min_pointing_hold_s: Time for which the conditions must hold, s.
            hold_mode: ``"cumulative"`` for a hold that breaks interrupt, ``"continuous"`` for one that they end.
            require_illumination_during_hold: Whether light at the target is a condition.
            hold_illumination_threshold: Least visible fraction of the Sun at the target.
            variable_duration_imaging: Whether the action ends with the image; else at the deadline.
            name: Name in ``action_description``.
            exposure: ``"held"`` for an image at the end of the hold, ``"first"`` for one in the first valid tick, for which light
                cannot be a condition.
        """
        super().__init__(name)
        self.n_actions = whole("n_ahead_image", n_ahead_image, 1)
        self.max_duration = positive_duration("max_duration", max_duration, name, math.inf)
        self.min_pointing_hold_s = number("min_pointing_hold_s", min_pointing_hold_s, 0.0, unit="s")
        self.hold_mode = one_of("hold_mode", hold_mode, HOLD_MODES)
        self.require_illumination_during_hold = switch("require_illumination_during_hold", require_illumination_during_hold)
        self.hold_illumination_threshold = number("hold_illumination_threshold", hold_illumination_threshold, 0.0, 1.0)
        self.variable_duration_imaging = switch("variable_duration_imaging", variable_duration_imaging)
        self.exposure = one_of("exposure", exposure, EXPOSURES)
        if exposure == "held" and self.min_pointing_hold_s >= self.max_duration:
            raise ValueError(
                f"action {name!r}: min_pointing_hold_s={min_pointing_hold_s} s must be below max_duration={max_duration} s, or "
                "it takes no image"
            )
        if exposure == "first" and self.require_illumination_during_hold:
            raise ValueError(
                "exposure='first' takes images in any light; give require_illumination_during_hold=False with it, and the "
                "rewarder a quality_threshold"
            )

    @override
    def link_satellite(self, satellite: BoundSatellite) -> None:
        super().link_satellite(satellite)
        check_imager(satellite, f"ImageRSO {self.name!r}")

    @property
    def _scenario(self) -> RSOTargets:
        scenario: RSOTargets = self.satellite.scenario
        return scenario

    @override
    def candidates(self) -> Candidates:
        return self._scenario.candidates(self.satellite, self.n_actions)

    @override
    def decide(self, index: Tensor, mask: Tensor, action: Tensor, previous: Tensor) -> Decision:
        simulator, scenario = self.satellite.simulator, self._scenario
        target, exists = self.chosen(index)
        by_index = mask & (action < 0)
        if bool(by_index.any()):
            target = torch.where(by_index, -1 - action, target)
            eligible = scenario.eligible_for(self.satellite).gather(1, target.clamp(min=0).unsqueeze(-1)).squeeze(-1)
            why = "which waits for the downlink of an image, or cools down"
            self.refuse(by_index & ~eligible, target, lambda number: f"{scenario.ids[number]!r}, {why}")
        valid = exists | by_index
        key = torch.where(valid, self.keys(target), NO_TARGET)
        duration = torch.full_like(simulator.sim_time, self.max_duration)
        expected = duration.clamp(max=SLEW + self.min_pointing_hold_s) if self.variable_duration_imaging else duration
        mode = torch.full_like(target, simulator.mode_names.index("image_rso"))
        return Decision(mode, valid, duration, key, expected)

    def begin(self, mask: Tensor, decision: Decision) -> None:
        """See :meth:`Action.begin`: set the target of the pointing guidance, and the requirements of the gate."""
        simulator, mask = self.satellite.simulator, mask & (decision.key != NO_TARGET)
        target, ticks = self.keys(decision.key), simulator.ticks.double()
        self.remember(mask, target)
        if self._scenario.n_targets > 1:
            simulator.write("data_partition", mask, target.double())
        deadline = ticks + math.ceil(round(min(self.max_duration, 1e9) * 1e9) / simulator.h_ns)
        least = self.hold_illumination_threshold if self.require_illumination_during_hold else -1.0
        simulator.write("rso_deadline", mask, deadline)
        task = {
            "rso_hold": self.min_pointing_hold_s,
            "rso_continuous": float(self.hold_mode == "continuous"),
            "rso_least_light": least,
            "rso_ends": float(self.variable_duration_imaging),
            "rso_first": float(self.exposure == "first"),
        }
        for name, value in task.items():
            simulator.write(name, mask, torch.full_like(ticks, value))
