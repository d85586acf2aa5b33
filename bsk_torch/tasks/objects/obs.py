"""Observations of the candidates of an imager of resident space objects (RSO)."""

from __future__ import annotations

from collections.abc import Mapping

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
"""Entries where none are given."""


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
        self, *properties: Mapping[str, object], n_ahead_observe: int = 10, name: str = "rso_targets", as_set: bool = False
    ) -> None:
        """See :class:`~bsk_torch.obs.candidates.CandidateProperties`; :data:`DEFAULT` where no ``properties`` are given."""
        super().__init__(*properties, n_ahead_observe=n_ahead_observe, name=name, as_set=as_set)

    @override
    def link_satellite(self, satellite: BoundSatellite) -> None:
        super().link_satellite(satellite)
        check_imager(satellite, f"RSOTargetProperties {self.name!r}")

    @override
    def read_candidates(self, wanted: frozenset[str]) -> tuple[dict[str, Tensor], Tensor]:
        scenario: RSOTargets = self.satellite.scenario
        candidates = scenario.candidates(self.satellite, self.n_ahead_observe)
        views = scenario.views(self.satellite, candidates)
        values = views._asdict() | {
            "valid": torch.ones_like(views.target_distance),
            "priority": self.satellite.of_env(scenario.priority).gather(1, candidates.place),
        }
        if "in_sight" in wanted:
            values["in_sight"] = scenario.in_sight(self.satellite, candidates).double()
        if not wanted.isdisjoint((*Outlook._fields, EXPECTED_RATE)):
            outlook = scenario.outlook(self.satellite, candidates)
            values |= outlook._asdict() | {EXPECTED_RATE: expected_rate(values["priority"], outlook)}
        if not wanted.isdisjoint(KNOWN):
            values |= self._knowledge(candidates.place)
        return values, candidates.exists

    def _knowledge(self, place: Tensor) -> dict[str, Tensor]:
        """Return what satellites know of targets, [N, n] each; see :data:`KNOWN`."""
        satellite, scenario = self.satellite, self.satellite.scenario
        records, now = scenario.known_records, satellite.simulator.sim_time.unsqueeze(1)
        values: dict[str, Tensor] = {}
        for name, version in (("capture", CAPTURED), ("delivery", DELIVERED)):
            latest = scenario.of_imagers(satellite, records.latest(version)).gather(1, place)
            exists = latest > AGO
            values |= {f"{name}_age": torch.where(exists, now - latest, 0.0), f"{name}_known": exists.double()}
        pending = scenario.of_imagers(satellite, scenario.memory[OWN_PENDING]).gather(1, place)
        images = satellite.simulator.mode == satellite.simulator.mode_names.index("image_rso")
        busy = images & ~satellite.task.requires_retasking
        aimed = busy.unsqueeze(1) & (satellite.simulator.memory[AIM].unsqueeze(1) == place)
        return values | {"on_board": (pending > 0).double(), "in_progress": aimed.double()}
