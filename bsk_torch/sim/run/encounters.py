"""Conditions on the distance between two satellites of an episode, which end its steps: conjunctions and ranges.

Distances are checked when a step starts and after its ticks, on the traces of the satellites' positions; see
:mod:`bsk_torch.sim.run.coupled`. At the time limit the clock stops before any condition is evaluated. Every condition fires once
in an episode.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import torch
from torch import Tensor

from bsk_torch.constants import NANO
from bsk_torch.sim.dyn.models import DynamicsModel
from bsk_torch.sim.dyn.relative_motion import ConjunctionDynModel, MaxRangeDynModel
from bsk_torch.sim.names import nearest
from bsk_torch.sim.tick.trace import Flight
from bsk_torch.vec3 import Vec3

if TYPE_CHECKING:
    from bsk_torch.sim.fleet import Fleet

logger = logging.getLogger(__name__)

NEVER = 2**62
"""Number of a tick that does not come."""
AT_ONCE = 1 << 18  # distances computed in one go: few enough to stay in a processor's cache
AT_REST = 1e-300  # square of a distance, m^2, below which two satellites do not move relative to each other within a tick

MET, LEFT = "conjunctions_met", "ranges_left"
"""Tensors of the fleet's memory: pairs that have met, [N, P], and deputies that have left their chief's surroundings, [N, Q]."""


class EncounterPairs(NamedTuple):
    """Pairs of satellites whose distance matters, by their numbers in an episode."""

    conjunctions: tuple[tuple[int, int], ...]  # pairs that may collide, the later satellite of the list first
    ranges: tuple[tuple[int, int], ...]  # deputies, each with its chief

    @property
    def all(self) -> tuple[tuple[int, int], ...]:
        """Pairs of both kinds, ranges last."""
        return (*self.conjunctions, *self.ranges)

    @property
    def watched(self) -> set[int]:
        """Satellites whose positions are looked at."""
        return {column for pair in self.all for column in pair}

    def among(self, chosen: Sequence[int]) -> EncounterPairs:
        """Return the pairs of some satellites alone, by their numbers among these."""
        place = {column: k for k, column in enumerate(chosen)}

        def within(pairs: tuple[tuple[int, int], ...]) -> tuple[tuple[int, int], ...]:
            return tuple((place[a], place[b]) for a, b in pairs if a in place and b in place)

        return EncounterPairs(within(self.conjunctions), within(self.ranges))


NO_PAIRS = EncounterPairs((), ())  # no pairs


def find_pairs(
    names: Sequence[str], models: Sequence[type[DynamicsModel]], chiefs: Sequence[str | None], compat: bool
) -> EncounterPairs:
    """Return the pairs of satellites of the given names, dynamics models and values of ``chief_name``.

    ValueError for a chief that is not a satellite, or an order of satellites in which BSK-RL's steps raise, if it is repeated.
    """
    for name, model, chief in zip(names, models, chiefs, strict=True):
        if not issubclass(model, MaxRangeDynModel):
            continue
        if chief is None:
            logger.warning("%s has dyn.MaxRangeDynModel and chief_name=None: its range is not looked at", name)
        elif chief not in names:
            raise ValueError(
                f"sat_args of {name}: chief_name={chief!r} is not a satellite of the environment; {nearest(str(chief), names)}"
            )
    may_collide = [k for k, model in enumerate(models) if issubclass(model, ConjunctionDynModel)]
    if compat:
        for k in may_collide[1:]:
            if k - 1 not in may_collide:
                raise ValueError(
                    f"compat='bsk_rl' books conjunctions of {names[k]!r} on the satellite before it, and {names[k - 1]!r} has no "
                    "dyn.ConjunctionDynModel, which raises there; put those that may collide next to one another"
                )
    deputies = [k for k, model in enumerate(models) if issubclass(model, MaxRangeDynModel) and chiefs[k] is not None]
    return EncounterPairs(
        tuple((k, j) for k in may_collide for j in may_collide if j < k),
        tuple((k, names.index(str(chiefs[k]))) for k in deputies if names[k] != chiefs[k]),
    )


class Limits(NamedTuple):
    """Conditions on the distance of satellites in n episodes."""

    pair: tuple[int, ...]  # number of the pair of satellites whose distance each condition is about, C of them
    distance: Tensor  # distance of the condition, [n, C] m
    beyond: tuple[bool, ...]  # whether it holds from this distance on, C of them; else up to it
    every: Tensor  # ticks from one look to the next, [n, C]
    # whether the smallest distance since the last tick counts, if satellites move uniformly within it, [n, C]. A largest
    # distance is always that of a tick.
    between: Tensor


def reached(before: Vec3, now: Vec3, limits: Limits) -> Tensor:
    """Return whether conditions hold, [n, C, T], at the ends of ticks with relative positions ``before`` and ``now`` [n, P, T] m.

    Where the ticks' course counts, the satellites are closest at ``d0 + s (d1 - d0)`` with
    ``s = -d0 . (d1 - d0) / |d1 - d0|^2`` clamped to [0, 1].
    """
    square, nearest_square = now.dot(now), None
    if bool(limits.between.any()):
        step = now - before
        share = torch.clamp(-before.dot(step) / torch.clamp(step.dot(step), min=AT_REST), 0.0, 1.0)
        closest = before + step * share
        nearest_square = torch.minimum(closest.dot(closest), square)
    hits = []
    for c, (pair, beyond) in enumerate(zip(limits.pair, limits.beyond, strict=True)):
        bound, distance2 = limits.distance[:, c : c + 1] ** 2, square[:, pair]
        if beyond:
            hits.append(distance2 >= bound)
            continue
        if nearest_square is not None:
            distance2 = torch.where(limits.between[:, c : c + 1], nearest_square[:, pair], distance2)
        hits.append(distance2 <= bound)
    return torch.stack(hits, 1)


def looked(ticks: Tensor, limits: Limits) -> Tensor:
    """Return whether conditions are looked at, [n, C, T], at ``ticks`` [T] or [n, 1, T] since the start of the step."""
    return torch.remainder(ticks, limits.every.unsqueeze(-1)) == 0


def first_ticks(pieces: Iterator[tuple[Tensor, Vec3, Vec3]], limits: Limits, last: Tensor) -> Tensor:
    """Return the first tick at which each condition holds when it is looked at, [n, C]; ``NEVER`` where it does not.

    Each piece of the run has its ticks [T], and the relative positions [n, P, T], m, one tick before each and at it; the tick
    before the start is the start itself. ``last`` [n] is the last tick looked at; negative for none.
    """
    first = torch.full_like(limits.every, NEVER)
    for ticks, before, now in pieces:
        hit = reached(before, now, limits)
        if bool(hit.any()):
            hit = hit & looked(ticks, limits) & (ticks <= last.view(-1, 1, 1))
            first = torch.minimum(first, torch.where(hit, ticks, NEVER).amin(-1))
    return first


class Encounters:
    """Conjunctions and ranges of the satellites of a fleet."""

    def __init__(self, fleet: Fleet, pairs: EncounterPairs, compat: bool) -> None:
        """Declare what the episodes remember, and end the steps of the fleet; ``compat`` repeats the bookings of recordings."""
        self.fleet, self.pairs = fleet, pairs
        self._distances = list(dict.fromkeys(tuple(sorted(pair)) for pair in pairs.all))
        self._pair = tuple(self._distances.index(tuple(sorted(pair))) for pair in pairs.all)
        places = sorted((c, k, i) for k, columns in enumerate(fleet.columns) for i, c in enumerate(columns.tolist()))
        self._places, size = [(k, i) for _, k, i in places], fleet.size
        booked = torch.zeros(len(pairs.conjunctions), size, size, dtype=torch.bool)
        for row, (later, earlier) in enumerate(pairs.conjunctions):
            other = later - 1 if compat else earlier
            booked[row, later, other] = booked[row, other, later] = True
        self._booked = booked.to(fleet.device)
        if pairs.conjunctions:
            fleet.memory.declare(MET, False, len(pairs.conjunctions))
        if pairs.ranges:
            fleet.memory.declare(LEFT, False, len(pairs.ranges))
        if pairs.all:
            fleet.stop_conditions.append(self.first_tick)
            fleet.flight_observers.append(self.book)

    def _of(self, column: int, name: str) -> Tensor:
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
        beyond = (*[False] * len(self.pairs.conjunctions), *[True] * len(self.pairs.ranges))
        return Limits(self._pair, torch.stack(radii, 1)[envs], beyond, every, torch.stack(between, 1)[envs])

    def _waiting(self, envs: Tensor) -> Tensor:
        """Return the conditions that have not fired, on satellites that are present, [n, C]."""
        memory, parts = self.fleet.memory, [name for name in (MET, LEFT) if name in self.fleet.memory]
        waiting = ~torch.cat([memory[name][envs] for name in parts], 1)
        if self.fleet.present is None:
            return waiting
        present = self.fleet.present[envs]
        return waiting & torch.stack([present[:, one] & present[:, other] for one, other in self.pairs.all], 1)

    def _tracks(self, flight: Flight) -> dict[int, Tensor]:
        """Return the recorded positions of the watched satellites, [n, K + 1, 3] m each, by their numbers."""
        places = ((column, *self._places[column]) for column in sorted(self.pairs.watched))
        return {column: flight.read(k, "r_BN_N")[:, number] for column, k, number in places}

    def _relative(self, tracks: Mapping[int, Tensor]) -> Vec3:
        """Return the relative positions of the pairs, [n, P, T] m, of positions [n, T, 3] by satellite."""
        shape = next(iter(tracks.values())).shape
        relative = torch.empty(shape[0], len(self._distances), *shape[1:], dtype=torch.float64, device=self.fleet.device)
        for p, (one, other) in enumerate(self._distances):
            torch.sub(tracks[one], tracks[other], out=relative[:, p])
        return Vec3.of(relative)

    def _pieces(self, flight: Flight) -> Iterator[tuple[Tensor, Vec3, Vec3]]:
        tracks, count = self._tracks(flight), 1 + int(flight.ticks.max())
        length = max(1, AT_ONCE // max(1, len(flight.envs) * len(self._distances)))
        for start in range(0, count, length):
            stop, early = min(start + length, count), max(start - 1, 0)
            relative = self._relative({column: track[:, early:stop] for column, track in tracks.items()})
            first = start - early
            now = Vec3(*(plane[..., first:] for plane in relative))
            # the first position is its own predecessor
            before = Vec3(*(plane[..., :-1] if start else torch.cat([plane[..., :1], plane[..., :-1]], -1) for plane in relative))
            yield torch.arange(start, stop, device=self.fleet.device), before, now

    def first_tick(self, flight: Flight) -> Tensor:
        """Return the first tick of a flight at which a condition holds, [n]; see ``fleet.stop_conditions``."""
        limits, last = self.limits(flight.envs), torch.minimum(flight.ticks, flight.remaining - 1)
        first = first_ticks(self._pieces(flight), limits, last)
        return torch.where(self._waiting(flight.envs), first, NEVER).amin(-1)

    def book(self, flight: Flight) -> None:
        """Remember the conditions that hold at the last tick of a flight; see ``fleet.flight_observers``."""
        end = flight.ticks.view(-1, 1, 1)
        records = torch.cat([(end - 1).clamp(min=0), end], 1).expand(-1, -1, 3)
        relative = self._relative({column: track.gather(1, records) for column, track in self._tracks(flight).items()})
        before, now = (Vec3(*(plane[..., k : k + 1] for plane in relative)) for k in (0, 1))
        limits, fires = self.limits(flight.envs), flight.ticks < flight.remaining
        hit = (reached(before, now, limits) & looked(flight.ticks.view(-1, 1, 1), limits)).squeeze(-1)
        hit = hit & self._waiting(flight.envs) & fires.unsqueeze(1)
        collisions = len(self.pairs.conjunctions)
        for name, happened in ((MET, hit[:, :collisions]), (LEFT, hit[:, collisions:])):
            if name in self.fleet.memory:
                earlier = self.fleet.memory[name]
                self.fleet.memory[name] = earlier.index_copy(0, flight.envs, earlier[flight.envs] | happened)

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
            chief_type, number = self._places[chief]
            simulator, enforced = self.fleet.simulators[chief_type], self._of(deputy, "enforce_range_on_chief") > 0.0
            if chief_type != k or not bool(enforced.any()):
                continue
            valid = torch.ones(self.fleet.num_envs, simulator.count, dtype=torch.bool, device=self.fleet.device)
            valid[:, number] = ~(self.fleet.memory[LEFT][:, row] & enforced)
            checks[f"range_valid_{self.fleet.names[deputy]}"] = valid.flatten()
        return checks
