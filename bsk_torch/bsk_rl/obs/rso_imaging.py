"""Observations of candidates for images; counterpart of ``bsk_rl.obs.rso_imaging``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from bsk_torch._checks import whole
from bsk_torch.bsk_rl.obs.observations import Observation
from bsk_torch.bsk_rl.utils.orbital import rv2HN
from bsk_torch.bsk_rl.utils.rso_imaging import candidate_snapshot, illumination_factor, target_geometry
from bsk_torch.sim.names import nearest
from bsk_torch.tasks.objects.obs import DEFAULT

if TYPE_CHECKING:
    from bsk_torch.bsk_rl.sats.satellite import Satellite
    from bsk_torch.bsk_rl.scene.rso_targets import EpisodeTarget

NOTHING: dict[str, object] = {
    "valid": 0.0,
    "priority": 0.0,
    "target_elevation_angle": 0.0,
    "rel_pos_vector_r_BR_H": np.zeros(3),
    "rel_vel_vector_v_BR_H": np.zeros(3),
    "angle_to_target": 0.0,
    "target_distance": 0.0,
    "target_illumination_factor": 0.0,
}
"""Properties of a candidate that does not exist."""


def target_properties(imager: Satellite, target: EpisodeTarget | None) -> dict[str, Any]:
    """Return what an imager sees of a target: zeros for None.

    ``target_elevation_angle`` and ``angle_to_target``, from the axis of the instrument, are degrees. ``rel_pos_vector_r_BR_H``,
    m, and ``rel_vel_vector_v_BR_H``, a difference of inertial velocities, m/s, are in the imager's Hill frame.
    """
    if target is None:
        return {name: np.copy(value) if isinstance(value, np.ndarray) else value for name, value in NOTHING.items()}
    line_N, distance, elevation = target_geometry(imager, target)
    dynamics, subject = imager.dynamics, target.target_spacecraft.dynamics
    HN = rv2HN(dynamics.r_BN_N, dynamics.v_BN_N)
    axis_N = np.asarray(dynamics.BN).T @ np.asarray(imager.fsw.locPoint.pHat_B)
    light = subject.world.eclipseObject.eclipseOutMsgs[subject.eclipse_index].read()
    return {
        "valid": 1.0,
        "priority": float(target.priority),
        "target_elevation_angle": elevation,
        "rel_pos_vector_r_BR_H": HN @ line_N,
        "rel_vel_vector_v_BR_H": HN @ (np.asarray(subject.v_BN_N) - np.asarray(dynamics.v_BN_N)),
        "angle_to_target": float(np.degrees(np.arccos(np.clip(line_N @ axis_N / distance, -1, 1)))),
        "target_distance": distance,
        "target_illumination_factor": illumination_factor(light),
    }


class RSOTargetProperties(Observation):
    """Properties of the first candidates of an imager, in the order of :class:`~bsk_torch.bsk_rl.act.ImageRSO`."""

    def __init__(self, *properties: Mapping[str, object], n_ahead_observe: int = 10, name: str = "rso_targets") -> None:
        """Observe ``n_ahead_observe`` candidates; ValueError for a wrong argument.

        Args:
            *properties: Dictionaries with ``prop``, a key of :func:`target_properties`; ``norm``, a divisor; and ``name``.
            n_ahead_observe: Number of candidates.
            name: Name of the observation.
        """
        super().__init__(name)
        self.n_ahead_observe = whole("n_ahead_observe", n_ahead_observe, 1)
        self.properties = []
        for entry in properties or DEFAULT:
            prop, norm = entry["prop"], float(entry.get("norm", 1))  # type: ignore[arg-type]
            if prop not in NOTHING:
                raise ValueError(f"prop={prop!r} is no property of targets; {nearest(str(prop), list(NOTHING))}")
            if not np.isfinite(norm) or norm == 0:
                raise ValueError(f"norm={norm} of {prop!r} must be a finite number other than zero")
            self.properties.append((prop, entry.get("name", prop), norm))
        names = [title for _, title, _ in self.properties]
        if len(set(names)) < len(names):
            raise ValueError(f"names of properties must be unique; they are {names}")

    def reset_overwrite_previous(self) -> None:
        """Forget the candidates of the last episode."""
        self.satellite._rso_candidate_snapshot = None

    def _candidates(self) -> tuple[EpisodeTarget | None, ...]:
        return candidate_snapshot(self.satellite, self.n_ahead_observe).targets[: self.n_ahead_observe]

    def get_obs(self) -> dict[str, object]:
        """See :meth:`Observation.get_obs`; a dictionary for each candidate."""
        observation: dict[str, object] = {}
        for k, target in enumerate(self._candidates()):
            values = target_properties(self.satellite, target)
            observation[f"{self.name}_{k}"] = {title: values[prop] / norm for prop, title, norm in self.properties}
        return observation

    def candidate_ids(self) -> tuple[str | None, ...]:
        """Return the ids of the candidates; None for those that do not exist."""
        return tuple(None if target is None else target.id for target in self._candidates())
