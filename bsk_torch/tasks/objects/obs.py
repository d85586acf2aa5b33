"""Observations of the candidates of an imager of resident space objects (RSO)."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch.obs.candidates import CandidateProperties
from bsk_torch.sats.bound import BoundSatellite
from bsk_torch.tasks.objects.aim import AIM
from bsk_torch.tasks.objects.candidates import Views
from bsk_torch.tasks.objects.outlook import Outlook, expected_rate
from bsk_torch.tasks.objects.records import AGO, CAPTURED, DELIVERED
from bsk_torch.tasks.objects.scene import OWN_PENDING, RSOTargets, check_imager

KNOWN = ("capture_age", "capture_known", "delivery_age", "delivery_known", "on_board", "in_progress")
"""Properties of candidates that need ``knowledge="own"`` in :class:`~bsk_torch.tasks.objects.RSOTargets`.

Time since the latest capture that the imager knows, s, and since the latest one known to be delivered, each with 1 where there is
one, else 0; 1 where an image is on board; 1 where the imager is imaging the candidate.
"""

EXPECTED_RATE = "expected_priority_per_second"
"""Property of candidates: priority to expect of an image per second of its duration; 0 if dark or hidden at its end."""

PROPERTIES = ("valid", "priority", "in_sight", *Views._fields, *Outlook._fields, EXPECTED_RATE, *KNOWN)
"""Properties of candidates: the allowed values of ``prop``. ``in_sight`` is 1 where the Earth is not in the way; see
:meth:`~bsk_torch.tasks.objects.RSOTargets.in_sight`."""

DEFAULT = (
    {"prop": "priority", "norm": 2},
    {"prop": "target_elevation_angle", "norm": 90},
    {"prop": "rel_pos_vector_r_BR_H", "norm": 15960e3},
    {"prop": "rel_vel_vector_v_BR_H", "norm": 16000},
    {"prop": "angle_to_target", "norm": 90},
    {"prop": "target_distance", "norm": 15960e3},
    {"prop": "target_illumination_factor"},
)
"""Entries where none are given, those of bsk_rl."""


class RSOTargetProperties(CandidateProperties):
    """Properties of the first n candidates of an imager; action k of :class:`~bsk_torch.tasks.objects.ImageRSO` images the k-th.

    For the order of candidates, see :class:`~bsk_torch.tasks.objects.RSOTargets`; for properties, :data:`PROPERTIES`,
    :class:`~bsk_torch.tasks.objects.candidates.Views`, and :class:`~bsk_torch.tasks.objects.outlook.Outlook` for those at the
    end of an image, from which :data:`EXPECTED_RATE` follows. Where there are fewer candidates, all properties are zero,
    ``valid`` too, which is 1 for the others.
    """

    properties = PROPERTIES
    usual = DEFAULT
    in_orbit = True
    title = "RSOTargetProperties"

    def __init__(
        self, *properties: dict[str, Any], n_ahead_observe: int = 10, name: str = "rso_targets", as_set: bool = False
    ) -> None:
        """Observe candidates.

        Args:
            *properties: Dictionaries with ``prop``, and optionally ``norm`` (divisor) and ``name``; those of :data:`DEFAULT` if
                none are given.
            n_ahead_observe: Number of candidates n.
            name: Name of the observation.
            as_set: Whether to return ``rows`` [N, n, features] and ``mask`` [N, n] (1, or 0 where there are fewer candidates)
                instead of named numbers, for permutation-invariant policies.

        Raises:
            ValueError: For unknown properties or keys, equal names, or fewer than one candidate.
        """
        super().__init__(*properties, n_ahead_observe=n_ahead_observe, name=name, as_set=as_set)

    def link_satellite(self, satellite: BoundSatellite) -> None:
        """See :meth:`Observation.link_satellite`; ValueError unless it is an imager of a catalog."""
        super().link_satellite(satellite)
        check_imager(satellite, f"RSOTargetProperties {self.name!r}")

    @override
    def read_candidates(self, wanted: frozenset[str]) -> tuple[dict[str, Tensor], Tensor]:
        scenario: RSOTargets = self.satellite.scenario
        candidates = scenario.candidates(self.satellite, self.n_ahead_observe)
        seen = scenario.views(self.satellite, candidates)
        known = seen._asdict() | {
            "valid": torch.ones_like(seen.target_distance),
            "priority": self.satellite.of_env(scenario.priority).gather(1, candidates.place),
        }
        if "in_sight" in wanted:
            known["in_sight"] = scenario.in_sight(self.satellite, candidates).double()
        if not wanted.isdisjoint((*Outlook._fields, EXPECTED_RATE)):
            outlook = scenario.outlook(self.satellite, candidates)
            known |= outlook._asdict() | {EXPECTED_RATE: expected_rate(known["priority"], outlook)}
        if not wanted.isdisjoint(KNOWN):
            known |= self._known(candidates.place)
        return known, candidates.exists

    def _known(self, place: Tensor) -> dict[str, Tensor]:
        """Return what satellites know of targets, [N, n] each; see :data:`KNOWN`."""
        satellite, scenario = self.satellite, self.satellite.scenario
        records, now = scenario.known_records, satellite.simulator.sim_time.unsqueeze(1)
        found: dict[str, Tensor] = {}
        for name, version in (("capture", CAPTURED), ("delivery", DELIVERED)):
            latest = scenario.of_imagers(satellite, records.latest(version)).gather(1, place)
            there = latest > AGO
            found |= {f"{name}_age": torch.where(there, now - latest, 0.0), f"{name}_known": there.double()}
        pending = scenario.of_imagers(satellite, scenario.memory[OWN_PENDING]).gather(1, place)
        images = satellite.simulator.mode == satellite.simulator.mode_names.index("image_rso")
        busy = images & ~satellite.task.requires_retasking
        mine = busy.unsqueeze(1) & (satellite.simulator.memory[AIM].unsqueeze(1) == place)
        return found | {"on_board": (pending > 0).double(), "in_progress": mine.double()}
