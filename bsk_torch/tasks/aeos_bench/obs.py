"""Observations of the tasks of AEOS-Bench that a satellite can complete first."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch.obs.candidates import CandidateProperties
from bsk_torch.sats.bound import BoundSatellite
from bsk_torch.tasks.aeos_bench.outlook import NEVER, match
from bsk_torch.tasks.aeos_bench.scene import PLACES, AEOSBench

OUTLOOK = ("angle", "turn", "start", "end")
"""Properties that :class:`~bsk_torch.tasks.aeos_bench.outlook.TaskOutlook` explains: rad, and s from now on."""

MATCHED = "matched"
"""Property of candidates: 1 for the one that the satellite should take by :func:`~bsk_torch.tasks.aeos_bench.outlook.match`."""

PROPERTIES = (*OUTLOOK, "slack", "progress", "duration", "held", "held_by_others", "lead", MATCHED)
"""Properties of candidates: the allowed values of ``prop``.

``slack``: time between the expected end and the last moment, s. ``progress``: part of the task that is done. ``duration``: how
long it lasts, s. ``held``: 1 for the task that the satellite points at. ``held_by_others``: number of other satellites that do.
``lead``: how much earlier the satellite would complete the task than the first of the others, s; negative where another one
would, and at most :data:`MOST_LEAD`.
"""

MOST_LEAD = 300.0
"""Limit of ``lead``, s: that of tasks which no other satellite can complete now."""

DEFAULT = (
    {"prop": "angle"},
    {"prop": "turn", "norm": 100},
    {"prop": "start", "norm": 100},
    {"prop": "end", "norm": 100},
    {"prop": "slack", "norm": 300},
    {"prop": "progress"},
    {"prop": "duration", "norm": 60},
    {"prop": "held"},
    {"prop": "held_by_others"},
    {"prop": "lead", "norm": 100},
    {"prop": MATCHED},
)
"""Entries where none are given."""


class TaskProperties(CandidateProperties):
    """Properties of the n tasks that a satellite can be expected to complete first.

    Action k of :class:`~bsk_torch.tasks.aeos_bench.PointAtTask` with ``n_candidates`` points at the k-th, counted from 1. For
    what can be expected, see :class:`~bsk_torch.tasks.aeos_bench.outlook.TaskOutlook`; for properties, :data:`PROPERTIES`.
    Where there are fewer candidates, all properties are zero.
    """

    properties = PROPERTIES
    usual = DEFAULT
    title = "TaskProperties"

    def __init__(
        self, *properties: Mapping[str, object], n_ahead_observe: int = 8, name: str = "tasks", as_set: bool = False
    ) -> None:
        """See :class:`~bsk_torch.obs.candidates.CandidateProperties`; :data:`DEFAULT` where no ``properties`` are given."""
        super().__init__(*properties, n_ahead_observe=n_ahead_observe, name=name, as_set=as_set)

    def link_satellite(self, satellite: BoundSatellite) -> None:
        """See :meth:`Observation.link_satellite`; ValueError unless the scenario has tasks of AEOS-Bench."""
        super().link_satellite(satellite)
        if PLACES not in satellite.simulator.scenario_state:
            raise ValueError(f"{self.title} {self.name!r} needs AEOSBench as the scenario of the environment")

    @override
    def read_candidates(self, wanted: frozenset[str]) -> tuple[dict[str, Tensor], Tensor]:
        scenario: AEOSBench = self.satellite.scenario
        outlook, candidates, held = scenario.outlook(), scenario.candidates(self.n_ahead_observe), scenario.held_task
        task, fleet = candidates.task, scenario.fleet

        def chosen(table: Tensor) -> Tensor:
            return table.gather(2, task)

        def of_task(table: Tensor) -> Tensor:
            return chosen(table.unsqueeze(1).expand(-1, fleet.size, -1))

        values = {name: chosen(getattr(outlook, name)) for name in OUTLOOK}
        values["slack"] = chosen(outlook.last) - values["end"]
        values["duration"] = of_task(scenario.drawn("task_duration"))
        values["progress"] = of_task(scenario.memory["task_progress"]) / values["duration"].clamp(min=1.0)
        current = task == held.unsqueeze(2)
        holders = torch.zeros_like(scenario.memory["task_progress"]).scatter_add(1, held.clamp(min=0), (held >= 0).double())
        values |= {"held": current.double(), "held_by_others": of_task(holders) - current.double()}
        if "lead" in wanted:
            values["lead"] = self._lead(torch.where(outlook.feasible, outlook.end, NEVER), task)
        if MATCHED in wanted:
            place = match(candidates, scenario.n_tasks)
            values[MATCHED] = (place.unsqueeze(2) == torch.arange(self.n_ahead_observe, device=place.device)).double()
        rows = self.satellite.type_index
        return {name: fleet.rows_of(rows, value) for name, value in values.items()}, fleet.rows_of(rows, candidates.exists)

    @staticmethod
    def _lead(end: Tensor, task: Tensor) -> Tensor:
        """Return how much earlier satellites complete tasks than the first of the others, s, [N, S, n]."""
        first = torch.cat([end, torch.full_like(end[:, :1], NEVER)], 1).topk(2, 1, largest=False).values  # also of one satellite
        ends, best, second = (part.expand_as(end).gather(2, task) for part in (end, first[:, :1], first[:, 1:]))
        return (torch.where(ends > best, best, second) - ends).clamp(-MOST_LEAD, MOST_LEAD)
