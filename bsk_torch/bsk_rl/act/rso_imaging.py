"""Images of spacecraft; counterpart of ``bsk_rl.act.rso_imaging``."""

from __future__ import annotations

import warnings

from bsk_torch._checks import number, whole
from bsk_torch.bsk_rl.act.discrete_actions import DiscreteAction
from bsk_torch.bsk_rl.utils.rso_imaging import candidate_snapshot
from bsk_torch.sim.names import nearest
from bsk_torch.tasks.objects.act import HOLD_MODES


class ImageRSO(DiscreteAction):
    """Images one of the first candidates of a scenario :class:`~bsk_torch.bsk_rl.scene.RSOTargets`, in their order.

    The satellite points at the target. The image is taken in the first tick in which pointing, line of sight and light have been
    right for ``min_pointing_hold_s``, and the store has room. Instead of a number, the id of a target may be given.

    Attributes:
        chosen_target_ids: Ids of the targets chosen in the episode.
    """

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
    ) -> None:
        """Provide an action for each of ``n_ahead_image`` candidates; ValueError for a wrong argument.

        Args:
            n_ahead_image: Number of candidates.
            max_duration: Time until the deadline, s, at which no image is taken.
            min_pointing_hold_s: Time for which the conditions must hold, s.
            hold_mode: ``"cumulative"`` for a hold that breaks interrupt, ``"continuous"`` for one that they end.
            require_illumination_during_hold: Whether light at the target is a condition.
            hold_illumination_threshold: Least visible fraction of the Sun at the target.
            variable_duration_imaging: Whether the action ends with the image; else at the deadline.
            name: Name of the action.
        """
        super().__init__(name, whole("n_ahead_image", n_ahead_image, 1))
        self.max_duration = number("max_duration", max_duration, 0.0, above=True, unit="s")
        self.min_pointing_hold_s = number("min_pointing_hold_s", min_pointing_hold_s, 0.0, unit="s")
        if hold_mode not in HOLD_MODES:
            raise ValueError(f"hold_mode={hold_mode!r} must be one of {list(HOLD_MODES)}")
        self.hold_mode = hold_mode
        self.require_illumination_during_hold = require_illumination_during_hold
        self.hold_illumination_threshold = number("hold_illumination_threshold", hold_illumination_threshold, 0.0, 1.0)
        self.variable_duration_imaging = variable_duration_imaging
        self.reset_overwrite_previous()

    def reset_overwrite_previous(self) -> None:
        """Forget the last episode."""
        self.event_name: str | None = None
        self.chosen_target_ids: list[str] = []

    def _image(self, target_id: str) -> str:
        satellite, simulator = self.satellite, self.simulator
        targets = satellite.rso_scenario.targets_by_id
        if target_id not in targets:
            raise ValueError(f"{target_id!r} is no target of the scenario; {nearest(str(target_id), list(targets))}")
        if not satellite.rso_scenario.is_eligible(target_id, simulator.sim_time):
            raise ValueError(f"target {target_id!r} cannot be chosen: it is pending or in cooldown")
        if self.event_name in simulator.eventMap:
            simulator.delete_event(str(self.event_name))
        satellite.fsw.action_image_rso(
            targets[target_id],
            duration=self.max_duration,
            hold_s=self.min_pointing_hold_s,
            hold_mode=self.hold_mode,
            require_illumination=self.require_illumination_during_hold,
            illumination_threshold=self.hold_illumination_threshold,
        )
        self.chosen_target_ids.append(target_id)
        satellite.update_timed_terminal_event(
            simulator.sim_time + self.max_duration,
            info="for image_rso",
            extra_actions=lambda _: satellite.fsw.rso_capture.cancel(),
        )
        if self.variable_duration_imaging:
            self.event_name = f"rso_image_success_{satellite.name}"

            def taken(_: object) -> None:
                satellite.logger.info("imaged %s", target_id)
                satellite.requires_retasking = True

            simulator.add_image_event(self.event_name, satellite, taken, bool(satellite.variable_interval))
        return target_id

    def set_action(self, action: int, prev_action_key: object = None) -> str:
        """See :meth:`DiscreteAction.set_action`; the candidates are those of the last observation.

        Raises:
            ValueError: Where there are not as many candidates, or the target is not eligible.
        """
        if not 0 <= action < self.n_actions:
            raise ValueError(f"action={action} of {self.name} must be from 0 to {self.n_actions - 1}")
        scenario = self.satellite.rso_scenario
        observed = getattr(self.satellite, "_rso_candidate_snapshot", None)
        if observed is None:
            observed = candidate_snapshot(self.satellite, self.n_actions)
        if (observed.time, observed.revision) != (self.simulator.sim_time, scenario.revision):
            warnings.warn(
                "the candidates have changed since they were observed; the action means the target that was observed",
                stacklevel=2,
            )
        if len(observed.targets) < self.n_actions:
            raise ValueError(f"{len(observed.targets)} candidates were observed; {self.name} has {self.n_actions} actions")
        if (target := observed.targets[action]) is None:
            raise ValueError(f"action={action} of {self.name} is an empty candidate; there are not as many eligible targets")
        return self._image(target.id)

    def set_action_override(self, action: object, prev_action_key: object = None) -> str:
        """Image a target given by its id, or as an object with an ``id``; TypeError for something else."""
        target_id = action if isinstance(action, str) else getattr(action, "id", None)
        if target_id is None:
            raise TypeError(f"action={action!r} must be the id of a target, or a target")
        return self._image(target_id)
