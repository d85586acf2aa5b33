"""Images of spacecraft, and the order in which imagers see their targets; counterpart of ``bsk_rl.utils.rso_imaging``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from bsk_torch.tasks.objects.candidates import HIGHEST, LOWEST

if TYPE_CHECKING:
    from bsk_torch.bsk_rl.sats.satellite import Satellite
    from bsk_torch.bsk_rl.scene.rso_targets import EpisodeTarget


@dataclass(frozen=True)
class RSOImageRecord:
    """An image in the store of an imager.

    Attributes:
        record_id: Name of the imager and number of its image.
        target_id: Id of the target.
        source_imager: Name of the imager.
        capture_time: Time at which the image was taken, s.
        size_bits: Size, bit.
        quality: Mean visible fraction of the Sun at the target over the hold.
        hold_valid_time_s: Time for which the conditions of the image had held, s.
        delivery_time: End of the step in which the downlink was completed, s; None before.
    """

    record_id: str
    target_id: str
    source_imager: str
    capture_time: float
    size_bits: float
    quality: float
    hold_valid_time_s: float
    delivery_time: float | None = None


@dataclass(frozen=True)
class CandidateSnapshot:
    """Targets among which an imager chooses, None where there are no more, in their order at a time, s."""

    time: float
    revision: int  # of the scenario
    targets: tuple[EpisodeTarget | None, ...]


def target_geometry(imager: Satellite, target: EpisodeTarget) -> tuple[np.ndarray, float, float]:
    """Return a target's position relative to an imager, m in N [3], its distance, m, and its elevation, degrees.

    The elevation is the angle above the horizontal plane of the imager.
    """
    r_BN_N = np.asarray(imager.dynamics.r_BN_N)
    line_N = np.asarray(target.target_spacecraft.dynamics.r_BN_N) - r_BN_N
    distance = float(np.linalg.norm(line_N))
    sine = line_N @ r_BN_N / (distance * np.linalg.norm(r_BN_N))
    return line_N, distance, float(np.degrees(np.arcsin(np.clip(sine, -1, 1))))


def candidate_snapshot(imager: Any, count: int) -> CandidateSnapshot:
    """Return at least the first ``count`` candidates of an imager, which its observations and actions share.

    Candidates are the eligible targets: first those with an elevation from -21 to 90 degrees, in ascending order, then the others
    by their distance. Of equal ones, the first in the catalog comes first. Whether the Earth is in the way does not matter.
    """
    scenario, now = imager.rso_scenario, float(imager.simulator.sim_time)
    last = getattr(imager, "_rso_candidate_snapshot", None)
    if last is not None and (last.time, last.revision) == (now, scenario.revision) and len(last.targets) >= count:
        return last
    entries = getattr(getattr(imager, "action_builder", None), "action_spec", ())
    count = max([count, *(entry.n_actions for entry in entries if hasattr(entry, "chosen_target_ids"))])
    ranked = []
    for target in scenario.targets_by_id.values():
        if scenario.is_eligible(target.id, now):
            _, distance, elevation = target_geometry(imager, target)
            first = LOWEST <= elevation <= HIGHEST
            ranked.append(((not first, elevation if first else distance), target))
    ranked.sort(key=lambda entry: entry[0])
    targets = [target for _, target in ranked[:count]]
    targets += [None] * (count - len(targets))
    imager._rso_candidate_snapshot = CandidateSnapshot(now, scenario.revision, tuple(targets))
    return imager._rso_candidate_snapshot


def illumination_factor(payload: Any) -> float:
    """Return the visible fraction of the Sun in an eclipse message: 1 in full sunlight."""
    return float(payload.illuminationFactor)
