"""Conditions on the distance between two satellites of an episode, which end its steps: conjunctions and ranges.

Distances are looked at when a step starts and after its ticks, on the traces of the satellites' positions; see
:mod:`bsk_torch.sim.flight`. At the time limit the clock stops before any condition is looked at. Every condition fires once in
an episode.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, NamedTuple

import torch
from torch import Tensor

from bsk_torch.constants import NANO
from bsk_torch.sim.dyn.relative_motion import ConjunctionDynModel, MaxRangeDynModel
from bsk_torch.sim.names import nearest
from bsk_torch.sim.trace import Flight
from bsk_torch.vec3 import Vec3

if TYPE_CHECKING:
    from bsk_torch.sim.dyn.models import DynamicsModel
    from bsk_torch.sim.fleet import Fleet

logger = logging.getLogger(__name__)

NEVER = 2**62
"""Number of a tick that does not come."""

AT_ONCE = 1 << 18
"""Distances that are computed in one go: few enough to stay in a processor's cache."""

AT_REST = 1e-300
"""Square of a distance, m^2, below which two satellites do not move relative to each other within a tick."""

MET, LEFT = "conjunctions_met", "ranges_left"
"""Tensors of the fleet's memory: pairs that have met, [N, P], and deputies that have left their chief's surroundings, [N, Q]."""


# -- who is with whom ------------------------------------------------------------------------------------------------------------


class EncounterPairs(NamedTuple):
    """Pairs of satellites whose distance matters, by their numbers in an episode.

    Attributes:
        conjunctions: Pairs that may collide, the later satellite of the list first.
        ranges: Deputies, each with its chief.
    """

    conjunctions: tuple[tuple[int, int], ...]
    ranges: tuple[tuple[int, int], ...]

    @property
    def watched(self) -> set[int]:
        """Satellites whose positions are looked at."""
        return {column for pair in (*self.conjunctions, *self.ranges) for column in pair}

    def among(self, chosen: Sequence[int]) -> EncounterPairs:
        """Return the pairs of some satellites alone, by their numbers among these."""
        place = {column: k for k, column in enumerate(chosen)}

        def within(pairs: tuple[tuple[int, int], ...]) -> tuple[tuple[int, int], ...]:
            return tuple((place[a], place[b]) for a, b in pairs if a in place and b in place)

        return EncounterPairs(within(self.conjunctions), within(self.ranges))


NOBODY = EncounterPairs((), ())
"""No pairs."""


def find_pairs(
    names: Sequence[str], models: Sequence[type[DynamicsModel]], chiefs: Sequence[str | None], as_bsk_rl: bool
) -> EncounterPairs:
    """Return the pairs of satellites of the given names, dynamics models and values of ``chief_name``.

    Raises:
        ValueError: For a chief that is no satellite, or an order of satellites in which bsk_rl's steps raise, if it is repeated.
    """
    for name, model, chief in zip(names, models, chiefs, strict=True):
        if not issubclass(model, MaxRangeDynModel):
            continue
        if chief is None:
            logger.warning("%s has dyn.MaxRangeDynModel and chief_name=None: its range is not looked at", name)
        elif chief not in names:
            raise ValueError(
                f"sat_args of {name}: chief_name={chief!r} is no satellite of the environment; {nearest(str(chief), names)}"
            )
    may_collide = [k for k, model in enumerate(models) if issubclass(model, ConjunctionDynModel)]
    if as_bsk_rl:
        for k in may_collide[1:]:
            if k - 1 not in may_collide:
                raise ValueError(
                    f"compat='bsk_rl' books conjunctions of {names[k]!r} on the satellite before it, and {names[k - 1]!r} has no "
                    "dyn.ConjunctionDynModel, so that bsk_rl raises; put those that may collide next to one another"
                )
    deputies = [k for k, model in enumerate(models) if issubclass(model, MaxRangeDynModel) and chiefs[k] is not None]
    return EncounterPairs(
        tuple((k, j) for k in may_collide for j in may_collide if j < k),
        tuple((k, names.index(str(chiefs[k]))) for k in deputies if names[k] != chiefs[k]),
    )


# -- when ------------------------------------------------------------------------------------------------------------------------


class Limits(NamedTuple):
    """Conditions on the distance of C pairs in n episodes.

    Attributes:
        distance: Distance of the condition, [n, C] m.
        beyond: Whether it holds from this distance on, [C]; else up to it.
        every: Ticks from one look to the next, [n, C].
        between: Whether the smallest distance since the last tick counts, if satellites move uniformly within it, [n, C]. A
            largest distance is always that of a tick.
    """

    distance: Tensor
    beyond: Tensor
    every: Tensor
    between: Tensor


def reached(before: Vec3, now: Vec3, limits: Limits) -> Tensor:
    """Return whether conditions hold, [n, C, T], at the ends of ticks with relative positions ``before`` and ``now``, m.

    Where the ticks' course counts, the satellites are closest at ``d0 + s (d1 - d0)`` with
    ``s = -d0 . (d1 - d0) / |d1 - d0|^2`` clamped to [0, 1].
    """
    bound, beyond, between = limits.distance**2, limits.beyond.unsqueeze(-1), limits.between.unsqueeze(-1)
    bound, square = bound.unsqueeze(-1), now.dot(now)
    hit = torch.where(beyond, square >= bound, square <= bound)
    if not bool(limits.between.any()):
        return hit
    step = now - before
    share = torch.clamp(-before.dot(step) / torch.clamp(step.dot(step), min=AT_REST), 0.0, 1.0)
    closest = before + step * share
    return hit | (between & ~beyond & (closest.dot(closest) <= bound))


def looked(ticks: Tensor, limits: Limits) -> Tensor:
    """Return whether conditions are looked at, [n, C, T], at ``ticks`` [T] or [n, 1, T] since the start of the step."""
    return torch.remainder(ticks, limits.every.unsqueeze(-1)) == 0


def first_ticks(pieces: Iterator[tuple[Tensor, Vec3, Vec3]], limits: Limits, last: Tensor) -> Tensor:
    """Return the first tick at which each condition holds when it is looked at, [n, C]; ``NEVER`` where it does not.

    Args:
        pieces: Ticks [T] of a piece of the run, and the relative positions [n, C, T], m, one tick before each and at it; the tick
            before the start is the start itself.
        limits: The conditions.
        last: Last tick that is looked at, [n]; negative for none.
    """
    first = torch.full_like(limits.every, NEVER)
    for ticks, before, now in pieces:
        hit = reached(before, now, limits) & looked(ticks, limits) & (ticks <= last.view(-1, 1, 1))
        if bool(hit.any()):
            first = torch.minimum(first, torch.where(hit, ticks, NEVER).amin(-1))
    return first


# -- in a fleet ------------------------------------------------------------------------------------------------------------------


class Encounters:
    """Conjunctions and ranges of the satellites of a fleet.

    Attributes:
        pairs: Pairs of satellites by their numbers in the fleet.
    """

    def __init__(self, fleet: Fleet, pairs: EncounterPairs, as_bsk_rl: bool) -> None:
        """Declare what the episodes remember, and end the steps of the fleet; ``as_bsk_rl`` repeats bsk_rl's bookings."""
        self.fleet, self.pairs = fleet, pairs
        every = (*pairs.conjunctions, *pairs.ranges)
        self._beyond = torch.tensor([k >= len(pairs.conjunctions) for k in range(len(every))], device=fleet.device)
        self._watched = sorted(pairs.watched)
        within = [[self._watched.index(column) for column in pair] for pair in every]
        self._sides = torch.tensor(within, dtype=torch.int64, device=fleet.device).view(-1, 2).mT
        found = sorted((c, k, i) for k, columns in enumerate(fleet.columns) for i, c in enumerate(columns.tolist()))
        self._places, size = [(k, i) for _, k, i in found], fleet.size
        booked = torch.zeros(len(pairs.conjunctions), size, size, dtype=torch.bool)
        for row, (later, earlier) in enumerate(pairs.conjunctions):
            other = later - 1 if as_bsk_rl else earlier
            booked[row, later, other] = booked[row, other, later] = True
        self._booked = booked.to(fleet.device)
        if pairs.conjunctions:
            fleet.memory.declare(MET, False, len(pairs.conjunctions))
        if pairs.ranges:
            fleet.memory.declare(LEFT, False, len(pairs.ranges))
        if every:
            fleet.stop_conditions.append(self.first_tick)
            fleet.flight_observers.append(self.book)

    # -- conditions -----------------------------------------------------------------------------------------------------

    def _of(self, column: int, name: str) -> Tensor:
        """Return an argument of a satellite, [N]."""
        k, number = self._places[column]
        simulator = self.fleet.simulators[k]
        return simulator.state.arguments[name].view(-1, simulator.count)[:, number]

    def limits(self, envs: Tensor) -> Limits:
        """Return the conditions of all pairs in the episodes ``envs`` [n]; those on ranges come last."""
        radii, rates, between = [], [], []
        for later, earlier in self.pairs.conjunctions:
            radii.append(self._of(later, "conjunction_radius") + self._of(earlier, "conjunction_radius"))
            rates.append(self._of(later, "conjunction_check_rate"))
            between.append(self._of(later, "conjunction_exact") > 0.0)
        for deputy, _ in self.pairs.ranges:
            radii.append(self._of(deputy, "max_range_radius"))
            rates.append(torch.zeros_like(radii[-1]))
            between.append(torch.zeros_like(radii[-1], dtype=torch.bool))
        nanoseconds = torch.floor(torch.stack(rates, 1)[envs] / NANO + 0.5)
        every = torch.ceil(nanoseconds / self.fleet.simulators[0].h_ns).clamp(min=1.0).long()
        return Limits(torch.stack(radii, 1)[envs], self._beyond, every, torch.stack(between, 1)[envs])

    def _waiting(self, envs: Tensor) -> Tensor:
        """Return the conditions that have not fired, [n, C]."""
        memory, parts = self.fleet.memory, [name for name in (MET, LEFT) if name in self.fleet.memory]
        return ~torch.cat([memory[name][envs] for name in parts], 1)

    def _relative(self, planes: Sequence[Tensor]) -> Vec3:
        """Return the relative positions of the pairs, [n, C, T] m, of positions of the watched, [n, W, T] in three planes."""
        first, second = self._sides
        return Vec3(*(plane[:, first] - plane[:, second] for plane in planes))

    def _tracks(self, flight: Flight) -> list[Tensor]:
        """Return the recorded positions of the watched satellites, [n, K + 1, 3] m each."""
        places = (self._places[column] for column in self._watched)
        return [flight.read(k, "r_BN_N")[:, number] for k, number in places]

    def _pieces(self, flight: Flight) -> Iterator[tuple[Tensor, Vec3, Vec3]]:
        """Yield the relative positions during a flight piece by piece; see :func:`first_ticks`."""
        tracks, count = self._tracks(flight), 1 + int(flight.ticks.max())
        length = max(1, AT_ONCE // max(1, len(flight.envs) * self._sides.shape[1]))
        for start in range(0, count, length):
            stop, early = min(start + length, count), max(start - 1, 0)
            planes = [torch.stack([track[:, early:stop, axis] for track in tracks], 1) for axis in range(3)]
            relative = self._relative(planes)
            now = relative.map(lambda plane: plane[..., start - early :])  # noqa: B023 - used at once
            before = relative.map(lambda plane: plane[..., :-1]) if start else relative.map(_held_back)
            yield torch.arange(start, stop, device=self.fleet.device), before, now

    def first_tick(self, flight: Flight) -> Tensor:
        """Return the first tick of a flight at which a condition holds, [n]; see ``fleet.stop_conditions``."""
        limits, last = self.limits(flight.envs), torch.minimum(flight.ticks, flight.left - 1)
        first = first_ticks(self._pieces(flight), limits, last)
        return torch.where(self._waiting(flight.envs), first, NEVER).amin(-1)

    def book(self, flight: Flight) -> None:
        """Remember the conditions that hold at the last tick of a flight; see ``fleet.flight_observers``."""
        end = flight.ticks.view(-1, 1, 1, 1)
        tracks = torch.stack(self._tracks(flight), 1)
        records = torch.cat([(end - 1).clamp(min=0), end], 2).expand(-1, tracks.shape[1], -1, 3)
        relative = self._relative(tracks.gather(2, records).unbind(-1))
        before, now = (relative.map(lambda plane: plane[..., k : k + 1]) for k in (0, 1))  # noqa: B023 - used at once
        limits, fires = self.limits(flight.envs), flight.ticks < flight.left
        hit = (reached(before, now, limits) & looked(flight.ticks.view(-1, 1, 1), limits)).squeeze(-1)
        hit = hit & self._waiting(flight.envs) & fires.unsqueeze(1)
        for name, mine in ((MET, hit[:, ~self._beyond]), (LEFT, hit[:, self._beyond])):
            if name in self.fleet.memory:
                known = self.fleet.memory[name]
                self.fleet.memory[name] = known.index_copy(0, flight.envs, known[flight.envs] | mine)

    # -- what has happened ----------------------------------------------------------------------------------------------

    def conjunctions(self, k: int) -> Tensor:
        """Return with whom each satellite of type k is booked to have collided, [rows, S]."""
        return self.fleet.rows_of(k, self._table(MET, self._booked))

    def out_of_ranges(self, k: int) -> Tensor:
        """Return from which chief each satellite of type k is too far away, [rows, S]."""
        size = self.fleet.size
        where = torch.zeros(len(self.pairs.ranges), size, size, dtype=torch.bool, device=self.fleet.device)
        for row, (deputy, chief) in enumerate(self.pairs.ranges):
            where[row, deputy, chief] = True
        return self.fleet.rows_of(k, self._table(LEFT, where))

    def _table(self, name: str, where: Tensor) -> Tensor:
        """Return the cells [N, S, S] that pairs which have fired fill; ``where`` are those of each pair, [P, S, S]."""
        size = self.fleet.size
        if name not in self.fleet.memory:
            return torch.zeros(self.fleet.num_envs, size, size, dtype=torch.bool, device=self.fleet.device)
        fired = self.fleet.memory[name].double() @ where.flatten(1).double()
        return (fired > 0.0).view(-1, size, size)

    def checks_of_deputies(self, k: int) -> dict[str, Tensor]:
        """Return aliveness checks that deputies put on their chiefs of type k, [rows] each by name: ``range_valid_<deputy>``."""
        checks = {}
        for row, (deputy, chief) in enumerate(self.pairs.ranges):
            mine, number = self._places[chief]
            simulator, enforced = self.fleet.simulators[mine], self._of(deputy, "enforce_range_on_chief") > 0.0
            if mine != k or not bool(enforced.any()):
                continue
            valid = torch.ones(self.fleet.num_envs, simulator.count, dtype=torch.bool, device=self.fleet.device)
            valid[:, number] = ~(self.fleet.memory[LEFT][:, row] & enforced)
            checks[f"range_valid_{self.fleet.names[deputy]}"] = valid.flatten()
        return checks


def _held_back(plane: Tensor) -> Tensor:
    """Return the values [n, C, T] one tick before each; the first is its own predecessor."""
    return torch.cat([plane[..., :1], plane[..., :-1]], -1)
