"""Areas on the ground that satellites cover with the swath of their instrument, cell by cell."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch._checks import number, parts, whole
from bsk_torch.astro.geodetic import SEMI_MAJOR_AXIS, SEMI_MINOR_AXIS
from bsk_torch.rand import Key
from bsk_torch.sats.bound import SatelliteFleet
from bsk_torch.scene.base import Scenario
from bsk_torch.scene.draws import Numbers, calls_user, check_numbers, draw_numbers
from bsk_torch.scene.recorded import RecordedTargets
from bsk_torch.sim.places import DrawnPlaces, Places, PlaceTables, Sight
from bsk_torch.sim.places.clearance import SLACK
from bsk_torch.sim.state import FINITE
from bsk_torch.sim.tick.trace import Flight
from bsk_torch.tasks.areas.cells import Area, padded
from bsk_torch.tasks.areas.fsw import FOOTPRINT
from bsk_torch.vec3 import Vec3

AREA_KIND = "area"
"""Type of the opportunities over areas."""

INDEX, WEIGHT = "area_index", "area_weight"
"""Draws of an episode: numbers of its areas among all of them, and their weights, [n or 1, A]."""

RECORDED = "area_recorded"
"""Field of the state with the tick at the end of the step in which each cell was last recorded, [N, A, C] int32."""

NEVER = -1
"""Value of :data:`RECORDED` for cells that have not been recorded, and padding."""

FAR = 1e9
"""Distance of padding from the Earth's center, m."""

PAIRS = 64
"""Pairs of a satellite and an area whose cells are compared at once: temporary tensors should fit into a processor's cache."""


class Hits(NamedTuple):
    """Cells recorded in a step, [H] each; a cell that several satellites record is there for each of them."""

    env: Tensor
    satellite: Tensor
    area: Tensor
    cell: Tensor


@dataclass(frozen=True)
class WithinReach:
    """The place below the satellite is within an angle of a place, given for each of them by ``angle`` of L areas."""

    angle: Tensor

    def margin(self, sight: Sight) -> Tensor:
        """Return the difference of the cosines of the central angle and of its limit."""
        cosine = sight.r_LP_P.dot(sight.r_BP_P) / (sight.r_LP_P.norm() * sight.r_BP_P.norm())
        return cosine - self._limit(sight).cos()

    def reachable(self, sight: Sight, moved_B: Tensor, moved_L: Tensor) -> Tensor:
        """Compare the central angle with the limit: a satellite at r that moves by d turns by at most asin(d / r)."""
        r_B = sight.r_BP_P.norm()
        most = self._limit(sight) + torch.asin((moved_B / r_B).clamp(max=1.0)) + SLACK
        return sight.r_LP_P.dot(sight.r_BP_P) / (r_B * sight.r_LP_P.norm()) > torch.cos(most.clamp(max=torch.pi))

    def _limit(self, sight: Sight) -> Tensor:
        return self.angle[sight.tables.of_rows(INDEX, sight.rows, sight.place).long()]


class AreaPlaces(DrawnPlaces):
    """Areas as places: their windows are the times in which the place below the satellite is within reach of them."""

    def __init__(self, tables: PlaceTables, center: Tensor, angle: Tensor, names: Sequence[str]) -> None:
        """Describe areas by centers [L, 3] m and angles of their reach [L] rad."""
        super().__init__(tables, [WithinReach(angle)], advice="choose areas below the orbits", names=names)
        self._center = center

    @property
    @override
    def count(self) -> int:
        return self.tables.drawn[INDEX].shape[1]

    @override
    def position(self, rows: Tensor, place: Tensor, time: Tensor) -> Tensor:
        return self._center[self.tables.of_rows(INDEX, rows, place).long()]

    @override
    def max_speed(self, rows: Tensor) -> Tensor:
        return torch.zeros(1, 1, dtype=torch.float64, device=rows.device)


class Areas(Scenario):
    """Areas recorded cell by cell: the same ones in all episodes, or a selection drawn for each.

    A cell is recorded in a tick in which the instrument stores data and its axis meets the ground no more than half a swath
    away, along a straight line. So the swath is the track of a circle on the ground. Satellites need
    :class:`~bsk_torch.tasks.areas.AreaScanFSWModel`.

    A cell is *due* until it is recorded; with ``revisit`` seconds, it is due again after that time, and in part before.
    Tables of cells are stored once for all environments; an episode has numbers of areas, weights, and the state of its cells.
    """

    _link_needs_super = True

    def __init__(
        self,
        areas: Sequence[Area],
        swath: float,
        n_areas: int | None = None,
        weights: Numbers | None = None,
        revisit: float | None = None,
    ) -> None:
        """ValueError for a wrong argument.

        Args:
            areas: Areas, such as :func:`~bsk_torch.tasks.areas.read_areas` or :func:`~bsk_torch.tasks.areas.random_caps` return.
                Cells much smaller than the swath cost time, and larger ones may lie between two passes that show parts of them.
            swath: Width of the recorded ground, m.
            n_areas: Number of different areas A drawn for each episode; None for all of them, in their order.
            weights: Weight of each area of an episode: a number, a distribution, or a callable; None for the areas' own.
            revisit: Time after which a recorded cell is due again, s; None for never.
        """
        what = "a list of areas, such as areas.random_caps(1000, cell=100e3)"
        listed = parts("areas", areas, Area, what)
        self.names = tuple(area.name for area in listed)
        self.swath = number("swath", swath, 0.0, 5e6, unit="m", above=True)
        self.n_areas = len(listed) if n_areas is None else whole("n_areas", n_areas, 1, len(listed))
        self._all = n_areas is None
        self.weights = weights
        if weights is not None:
            check_numbers("weights", weights, self.n_areas, low=0.0)
        self.revisit = None if revisit is None else number("revisit", revisit, 0.0, unit="s", above=True)
        self.own_weight = torch.tensor([area.weight for area in listed], dtype=torch.float64)
        self.r_CP_P, self.share = (torch.from_numpy(table) for table in padded(listed, FAR))
        self.center, self.reach = _circles(listed, self.swath)

    # -- episodes -----------------------------------------------------------------------------------------------------

    @property
    @override
    def calls_user(self) -> bool:
        return calls_user(self.weights)

    @override
    def draw(self, key: Key) -> dict[str, Tensor]:
        total = len(self.names)
        index = torch.arange(total).unsqueeze(0) if self._all else key.named(INDEX).distinct(self.n_areas, total)
        if self.weights is None:
            weight = self.own_weight[index]
        else:
            weight = draw_numbers("weights", self.weights, key.named(WEIGHT), self.n_areas, low=0.0)
        return {INDEX: index.double(), WEIGHT: weight}

    @override
    def _bounds(self) -> dict[str, tuple[float, float]]:
        return {INDEX: (0.0, len(self.names) - 1.0), WEIGHT: (0.0, FINITE)}

    @override
    def place_kinds(self, tables: PlaceTables) -> Mapping[str, Places]:
        angle = 2.0 * torch.asin((0.5 * self.reach / SEMI_MINOR_AXIS).clamp(max=1.0))
        device = tables.drawn[INDEX].device
        names = self.names if self._all else ()
        return {**super().place_kinds(tables), AREA_KIND: AreaPlaces(tables, self.center.to(device), angle.to(device), names)}

    @override
    def link(self, fleet: SatelliteFleet) -> None:
        super().link(fleet)
        self._types = [k for k, s in enumerate(fleet.simulators) if FOOTPRINT in s.state.layout.fields]
        if not self._types:
            models = " and ".join(type(part.fsw).__name__ for part in fleet.satellites)
            raise ValueError(f"Areas needs a satellite whose fsw_type is AreaScanFSWModel; {models} leaves no trace of its swath")
        self.r_CP_P, self.share, self.center, self.reach = (
            table.to(fleet.device) for table in (self.r_CP_P, self.share, self.center, self.reach)
        )
        self.cells = Vec3(*(part.contiguous() for part in self.r_CP_P.unbind(-1)))
        self.memory.declare(RECORDED, NEVER, self.n_areas, self.share.shape[1], dtype=torch.int32, low=NEVER)
        self._hits = list[Hits]()
        fleet.flight_observers.append(self._look)

    @property
    def index(self) -> Tensor:
        """Number of each area of an episode among all areas, [N, A] int64."""
        return self.drawn(INDEX).long()

    @property
    def weight(self) -> Tensor:
        """Weight of each area of an episode, [N, A]."""
        return self.drawn(WEIGHT)

    def due(self, recorded: Tensor, tick: Tensor) -> Tensor:
        """Return to which part, from 0 to 1, cells are due at a ``tick`` that were last ``recorded`` at another one.

        Both are ticks since reset that broadcast; a cell that was never recorded is due.
        """
        new = (recorded == NEVER).double()
        if self.revisit is None:
            return new
        passed = (tick - recorded).double() * (self.fleet.h / self.revisit)
        return torch.maximum(new, passed.clamp(max=1.0))

    def covered(self) -> Tensor:
        """Return the share of each area recorded in the episode, [N, A]."""
        return torch.where(self.memory[RECORDED] == NEVER, 0.0, self.share[self.index]).sum(-1)

    # -- steps --------------------------------------------------------------------------------------------------------

    def hits(self) -> Hits:
        """Return the cells recorded in the current step."""
        none = torch.zeros(0, dtype=torch.int64, device=self.fleet.device)
        return Hits(*(torch.cat(column) for column in zip(Hits(none, none, none, none), *self._hits, strict=True)))

    def worth(self, hits: Hits) -> Tensor:
        """Return weight times share of recorded cells, as far as they were due, [H]."""
        env, _, area, cell = hits
        due = self.due(self.memory[RECORDED][env, area, cell], self.fleet.ticks[env])
        return self.weight[env, area] * self.share[self.index[env, area], cell] * due

    @override
    def after_step(self, sim_time: Tensor) -> None:
        super().after_step(sim_time)
        if self._hits:
            env, _, area, cell = self.hits()
            self.memory[RECORDED][env, area, cell] = self.fleet.ticks[env].int()
            self.memory.touch()
            self._hits.clear()

    def _look(self, flight: Flight) -> None:
        """Find the cells recorded in a flight."""
        for k in self._types:
            place = flight.read(k, FOOTPRINT)[:, :, 1:]
            tick = torch.arange(1, place.shape[2] + 1, device=place.device)
            on = (place != 0.0).any(-1) & (tick <= flight.ticks.view(-1, 1, 1))
            env, number = torch.nonzero(on.any(-1)).unbind(1)
            if len(env):
                seen_cells = self._seen_by(flight.envs[env], place[env, number], on[env, number])
                columns = self.fleet.columns[k]
                self._hits += [Hits(flight.envs[env[row]], columns[number[row]], area, cell) for row, area, cell in seen_cells]

    def _seen_by(self, envs: Tensor, place: Tensor, on: Tensor) -> Iterator[tuple[Tensor, Tensor, Tensor]]:
        """Yield rows, areas and cells of which tracks show something.

        First the areas that a ball around the track reaches, then the ticks within reach of each of them, then their cells.

        Args:
            envs: Environments of R tracks, [R].
            place: Recorded places, [R, K, 3] m.
            on: Ticks in which something is recorded, [R, K]; in others the place is the Earth's center, near no cell.
        """
        place = torch.where(on.unsqueeze(-1), place, 0.0)
        last = on.shape[1] - 1 - on.flip(1).byte().argmax(1)
        first = on.byte().argmax(1)
        rows = torch.arange(len(envs), device=envs.device)
        middle = 0.5 * (place[rows, first] + place[rows, last])
        ball = torch.where(on, _distance(place, middle.unsqueeze(1)), 0.0).amax(1)
        index = self.index[envs]
        near = _distance(self.center[index], middle.unsqueeze(1)) <= self.reach[index] + ball.unsqueeze(1)
        row, area = torch.nonzero(near).unbind(1)
        index = index[row, area]
        within = _distance(place[row], self.center[index].unsqueeze(1)) <= self.reach[index].unsqueeze(1)
        pairs = torch.nonzero(within.any(1)).squeeze(-1)
        row, area, index, within = row[pairs], area[pairs], index[pairs], within[pairs]
        first = within.byte().argmax(1)
        count = place.shape[1] - within.flip(1).byte().argmax(1) - first
        for part in count.argsort(descending=True, stable=True).split(PAIRS) if len(pairs) else ():  # long ones together
            tick = first[part].unsqueeze(1) + torch.arange(int(count[part[0]]), device=row.device)
            track = place[row[part].unsqueeze(1), tick.clamp(max=place.shape[1] - 1)]
            pair, cell = torch.nonzero(self._in_swath(self.r_CP_P[index[part]], track)).unbind(1)
            yield row[part[pair]], area[part[pair]], cell

    def _in_swath(self, cells: Tensor, track: Tensor) -> Tensor:
        """Return which cells [Q, C, 3] m are at most half a swath away from any place of tracks [Q, W, 3] m, [Q, C]."""
        nearest = _squares(cells.unsqueeze(2), track.unsqueeze(1)).amin(-1)
        return nearest <= (0.5 * self.swath) ** 2

    # -- recordings ---------------------------------------------------------------------------------------------------

    @override
    def recorded_targets(self, env: int) -> RecordedTargets:
        index = self.index[env]
        exists = self.share[index] > 0.0
        worth = (self.weight[env].unsqueeze(-1) * self.share[index])[exists]
        return RecordedTargets(places="ground", r=self.r_CP_P[index][exists].cpu(), priority=worth.cpu())

    def recorded_cells(self, env: int) -> Tensor:
        """Return which of the cells of :meth:`recorded_targets` have been recorded, bool on the CPU."""
        exists = self.share[self.index[env]] > 0.0
        return (self.memory[RECORDED][env] != NEVER)[exists].cpu()


def _circles(areas: Sequence[Area], swath: float) -> tuple[Tensor, Tensor]:
    """Return centers of areas at the equatorial radius, [L, 3] m, and the distances within which tracks may see them, [L] m."""
    centers, reach = [], []
    for area in areas:
        mean = area.r_CP_P.mean(0)
        length = np.linalg.norm(mean)
        center = mean if length > 1.0 else area.r_CP_P[0]  # of one all over the Earth, from where everything is within reach
        center = center * (SEMI_MAJOR_AXIS / np.linalg.norm(center))
        centers.append(center)
        reach.append(np.linalg.norm(area.r_CP_P - center, axis=1).max() + 0.5 * swath)
    return torch.from_numpy(np.array(centers)), torch.from_numpy(np.array(reach))


def _squares(one: Tensor, other: Tensor) -> Tensor:
    """Return squared distances [...] of places [..., 3] that broadcast, one coordinate after the other."""
    (x, y, z), (u, v, w) = one.unbind(-1), other.unbind(-1)
    total = (x - u).square_()
    total += (y - v).square_()
    total += (z - w).square_()
    return total


def _distance(one: Tensor, other: Tensor) -> Tensor:
    return _squares(one, other).sqrt_()
