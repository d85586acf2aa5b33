"""Reward for inspecting the points of a resident space object (RSO)."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import torch
from torch import Tensor

from bsk_torch._checks import number, switch
from bsk_torch.constants import NANO
from bsk_torch.data.base import GlobalReward, Log
from bsk_torch.scene.rso_points import RSOPoints
from bsk_torch.sim.inspection.flags import Records, find_flags
from bsk_torch.sim.run.trace import Flight
from bsk_torch.sim.state import FINITE

if TYPE_CHECKING:
    from bsk_torch.sats.fleet import SatelliteFleet
    from bsk_torch.scene.base import Scenario

KINDS = ("inspected", "illuminated")
"""What is known of a point."""

NEVER = -1.0
"""Time of a completion that has not come, s."""


class RSOInspectionData(NamedTuple):
    """What is known of the points of RSOs, of the whole crew [N, P] or of the satellites of one type [N * count, P].

    Attributes:
        inspected: Points that have been inspected, bool.
        illuminated: Points that have been lit, bool.
    """

    inspected: Tensor
    illuminated: Tensor


class InspectionStore(NamedTuple):
    """A store of data, as bsk_rl's ``satellite.data_store``: ``data`` is what it holds."""

    data: RSOInspectionData


class _Found(NamedTuple):
    """Points of a step: episodes that took part [N], and points [N, S, P] that satellites inspected, or saw lit."""

    moved: Tensor
    inspected: Tensor
    illuminated: Tensor


class RSOInspectionReward(GlobalReward):
    """Pays for every point of an RSO that is inspected for the first time, and for completing the inspection.

    A satellite that inspects k of the P points that had not been inspected before the step gets
    ``inspection_reward_scale * k / P``; two that inspect the same point in one step are both paid, as in bsk_rl. Inspecting takes
    an inspector whose instrument records, see :mod:`bsk_torch.sim.inspection.flags`, of a :class:`scene.RSOPoints` scenario.

    The inspection is complete at the end of the first step at which enough is known, and enough of that inspected::

        lit >= min_illuminated_for_completion * P, or sim_time > min_time_for_completion
        inspected >= completion_threshold * lit

    with the numbers of points that were lit, and inspected, at any time in the episode. Every satellite of the environment, the
    RSO included, then gets ``completion_bonus``, once. At least one point must have been lit; bsk_rl pays for none, which
    ``compat="bsk_rl"`` repeats.

    Points that were in view or lit at time zero do not count: the RSO has no attitude before its first command is carried out. In
    bsk_rl its attitude is zero in the first two records of an episode, which count as inspected, and by a test that rounding
    decides also as lit; ``compat="bsk_rl"`` repeats that.

    Satellites that have died go on inspecting, as in bsk_rl: their points earn no reward any more, and they count for
    completion.
    """

    def __init__(
        self,
        inspection_reward_scale: float = 1.0,
        completion_bonus: float = 0.0,
        completion_threshold: float = 0.90,
        min_illuminated_for_completion: float = 0.4,
        min_time_for_completion: float = 5700.0,
        terminate_on_completion: bool = True,
    ) -> None:
        """ValueError for a wrong argument.

        Args:
            inspection_reward_scale: Reward for inspecting all points.
            completion_bonus: Reward of each satellite for completing the inspection.
            completion_threshold: Inspected points that complete it, as a fraction of those that have been lit.
            min_illuminated_for_completion: Points that must have been lit before, as a fraction of all ...
            min_time_for_completion: ... unless this time has passed, s.
            terminate_on_completion: Whether the episode ends with it.
        """
        self.inspection_reward_scale = number("inspection_reward_scale", inspection_reward_scale)
        self.completion_bonus = number("completion_bonus", completion_bonus)
        self.completion_threshold = number("completion_threshold", completion_threshold, 0.0)
        self.min_illuminated_for_completion = number("min_illuminated_for_completion", min_illuminated_for_completion, 0.0, 1.0)
        self.min_time_for_completion = number("min_time_for_completion", min_time_for_completion, unit="s", finite=False)
        self.terminate_on_completion = switch("terminate_on_completion", terminate_on_completion)

    def link(self, scenario: Scenario, fleet: SatelliteFleet) -> None:
        """See :meth:`GlobalReward.link`; ValueError for a scenario without points."""
        super().link(scenario, fleet)
        if not isinstance(scenario, RSOPoints):
            raise ValueError(
                f"RSOInspectionReward needs a scenario with points, such as scene.SphericalRSO; the scenario is "
                f"{type(scenario).__name__}"
            )
        self._points: RSOPoints = scenario
        self._found: _Found | None = None
        shape = fleet.size, scenario.n_points
        for kind in KINDS:
            self.memory.declare(f"{kind}_points", False, shape[1])
            self.memory.declare(f"known_{kind}", False, *shape)
        self.memory.declare("inspection_bonus_time", NEVER, low=NEVER, high=FINITE)
        fleet.flight_observers.append(self._look)

    # -- what a step shows --------------------------------------------------------------------------------------------

    def _look(self, flight: Flight) -> None:
        """Note the points of the episodes of a flight."""
        fleet, scenario = self.fleet, self._points
        found = self._found
        if found is None:
            none = torch.zeros(fleet.num_envs, fleet.size, scenario.n_points, dtype=torch.bool, device=fleet.device)
            found = _Found(torch.zeros(fleet.num_envs, dtype=torch.bool, device=fleet.device), none, none.clone())
            self._found = found
        found.moved[flight.envs] = True
        if not len(flight.envs) or not int(flight.ticks.max()):
            return
        n, points = len(flight.envs), scenario.columns
        for k in scenario.inspector_types:
            columns = points if points.ndim == 2 else points[:, flight.envs.repeat_interleave(flight.counts[k])]
            flags = find_flags(columns, self._records(flight, k), fleet.simulators[k].type.options.backend == "compiled")
            for table, new in zip((found.inspected, found.illuminated), flags, strict=True):
                seen = new.view(n, flight.counts[k], -1)
                if fleet.present is not None:
                    present = fleet.present[flight.envs]
                    pairs = present[:, fleet.columns[k]] & present[:, fleet.columns[scenario.rso_type]]
                    seen = seen & pairs.unsqueeze(-1)
                table[flight.envs.unsqueeze(-1), fleet.columns[k]] = seen

    def _records(self, flight: Flight, k: int) -> Records:
        """Return the records of the inspectors of type k in a flight."""
        chief, inspectors = flight.traces[self._points.rso_type], flight.traces[k]
        assert chief is not None
        assert inspectors is not None
        count = flight.counts[k]
        episodes = torch.arange(len(flight.envs), device=flight.envs.device).repeat_interleave(count)
        pairs = torch.arange(len(episodes), device=flight.envs.device)
        of_pairs = (part.repeat_interleave(count) for part in (flight.ticks, *self._first_records(flight)))
        return Records(chief, episodes, inspectors, pairs, *of_pairs)

    def _first_records(self, flight: Flight) -> tuple[Tensor, Tensor]:
        """Return the first record in which points may be inspected, and lit, [n] each."""
        begins, zero = flight.since == 0, torch.zeros_like(flight.since)
        simulator = self.fleet.simulators[0]
        if not simulator.type.as_bsk_rl:
            first = torch.where(begins, 1, zero)
            return first, first
        # by this difference bsk_rl recognises the first step of an episode; rounding makes some of them fail
        time, n = (flight.ticks * simulator.h_ns).double() * NANO, flight.ticks.double()
        return zero, torch.where(begins & (time - simulator.h * n == 0.0), 2, zero)

    # -- knowledge ----------------------------------------------------------------------------------------------------

    @property
    def inspected(self) -> Tensor:
        """Points that have been inspected in the present episodes, [N, P] bool."""
        return self.memory["inspected_points"]

    @property
    def illuminated(self) -> Tensor:
        """Points that have been lit in the present episodes, whether or not observed, [N, P] bool."""
        return self.memory["illuminated_points"]

    @property
    def known(self) -> RSOInspectionData:
        """What each satellite knows, by itself and by communication, [N, S, P] each."""
        return RSOInspectionData(*(self.memory[f"known_{kind}"] for kind in KINDS))

    @property
    def bonus_reward_time(self) -> Tensor:
        """Time at which the inspection was completed, [N] s; NaN before."""
        return torch.where(self.bonus_reward_yielded, self.memory["inspection_bonus_time"], torch.nan)

    @property
    def bonus_reward_yielded(self) -> Tensor:
        """Whether the inspection has been completed, [N] bool."""
        return self.memory["inspection_bonus_time"] != NEVER

    def store_of(self, part: int) -> InspectionStore:
        """Return what the satellites of type number ``part`` know, [N * count, P]; it is their ``data_store``."""
        return InspectionStore(RSOInspectionData(*(self.fleet.rows_of(part, table) for table in self.known)))

    def store_of_one(self, part: int, row: int) -> InspectionStore:
        """Return what the satellite of a row [N * count] of type number ``part`` knows, [P] each."""
        return InspectionStore(RSOInspectionData(*(table[row] for table in self.store_of(part).data)))

    def share(self, links: Tensor) -> None:
        """See :meth:`GlobalReward.share`; knowledge spreads along one link in a step."""
        for kind in KINDS:
            known = self.memory[f"known_{kind}"]
            self.memory[f"known_{kind}"] = known | (torch.bmm(links.mT.float(), known.float()) > 0.5)

    # -- reward -------------------------------------------------------------------------------------------------------

    def read_log(self) -> Log:
        """See :meth:`GlobalReward.read_log`; the records of a run take its place."""
        return {}

    def calculate_reward(self, before: Log, after: Log) -> Tensor:
        """See :meth:`GlobalReward.calculate_reward`."""
        found, self._found = self._found, None
        fleet, memory = self.fleet, self.memory
        if found is None:  # a trial without a run
            return torch.zeros(fleet.num_envs, fleet.size, dtype=torch.float64, device=fleet.device)
        new = (found.inspected & ~self.inspected.unsqueeze(1)).sum(2).double()
        for kind, points in zip(KINDS, (found.inspected, found.illuminated), strict=True):
            memory[f"{kind}_points"] = memory[f"{kind}_points"] | points.any(1)
            memory[f"known_{kind}"] = memory[f"known_{kind}"] | points
        completed = self._completed() & found.moved & ~self.bonus_reward_yielded
        memory["inspection_bonus_time"] = torch.where(completed, fleet.sim_time, memory["inspection_bonus_time"])
        reward = new * (self.inspection_reward_scale / self._points.n_points)
        return reward + self.completion_bonus * completed.double().unsqueeze(1)

    def _completed(self) -> Tensor:
        """Return where the conditions of completion hold, [N]."""
        inspected, lit = (points.sum(1).double() for points in (self.inspected, self.illuminated))
        enough = (lit >= self.min_illuminated_for_completion * self._points.n_points) | (
            self.fleet.sim_time > self.min_time_for_completion
        )
        something = torch.ones_like(enough) if self.fleet.simulators[0].type.as_bsk_rl else lit > 0.0
        return enough & something & (inspected >= self.completion_threshold * lit)

    def is_terminated(self) -> Tensor:
        """See :meth:`GlobalReward.is_terminated`; all satellites of completed episodes."""
        ended = self.bonus_reward_yielded & self.terminate_on_completion
        return ended.unsqueeze(1).expand(-1, self.fleet.size)
