"""The task of AEOS-Bench: places that satellites see for a while, each within its time, whoever sees them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal, NamedTuple

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch._checks import number
from bsk_torch.rand import Key
from bsk_torch.scene.base import Memo, Scenario
from bsk_torch.scene.recorded import RecordedTargets
from bsk_torch.sim.names import one_of
from bsk_torch.tasks.aeos_bench.dyn import VIEWS
from bsk_torch.tasks.aeos_bench.files import EARTH_RADIUS, HORIZON, MOST_TORQUE, Cases, read_cases
from bsk_torch.tasks.aeos_bench.generator import AEOSBenchGenerator
from bsk_torch.tasks.aeos_bench.outlook import (
    EARTH_SPIN,
    TaskCandidates,
    TaskOutlook,
    dot,
    find_candidates,
    sight_times,
    time_constant,
    turn_time,
)

if TYPE_CHECKING:
    from bsk_torch.sats.bound import BoundSatellite, SatelliteFleet
    from bsk_torch.sim.tick.trace import Flight

FARTHEST = 1e9
"""Range, m, of the benchmark's access."""

MARGIN = 1e-5
"""Share of the squared radius of the Earth by which float32 tests of cones are widened."""

PIECE, AT_ONCE = 64, 1 << 14
"""Ticks of a flight, and pairs of satellites and tasks, tested at once."""

SENSOR_ON = "sensor_on"
"""Flight mode in which the sensor is on."""

ASSIGNED, NO_TASK = "assigned_task", -1
"""Memory of the task that a satellite points at, and its value for none."""

AWAITED = "awaited_task"
"""Memory of the task whose success ends the choice of a satellite; ``NO_TASK`` for none."""

PLACES = "task_place"
"""Name of the drawn positions of tasks."""

ORDERS = ("random", "listed")


class AEOSBench(Scenario):
    """Cases of AEOS-Bench: tasks at places on the ground, with release and due times, that last for some seconds.

    A task is ongoing from its release to its due time, both included, until it succeeds. It is visible where a present satellite
    whose sensor is on, and of the task's type, has it in its cone and above its horizon, whichever place the satellite points at.
    It succeeds once it has been visible in as many ticks without a gap as it lasts; satellites may take turns. All of this is
    counted by :class:`bsk_torch.tasks.aeos_bench.TaskReward`.

    The satellites of the cases come with :class:`bsk_torch.tasks.aeos_bench.preset.CaseSatellites`, as ``sat_arg_randomizer``.
    """

    def __init__(
        self,
        cases: Cases | AEOSBenchGenerator | str | Path,
        satellites: int | None = None,
        tasks: int | None = None,
        order: Literal["random", "listed"] = "random",
        horizon: float = HORIZON,
        haste: float = 1.0,
    ) -> None:
        """Fly cases of a folder, or those given, or random ones.

        Args:
            cases: A folder with files of the benchmark, see :func:`bsk_torch.tasks.aeos_bench.read_cases`, its result, or a
                generator.
            satellites: Satellites to which the cases of a folder are padded (default: the most of any case).
            tasks: Tasks to which they are padded, likewise.
            order: ``"random"``: every episode draws one of the cases. ``"listed"``: the episode with seed s in environment i
                flies case s + i, counted modulo their number, and the following episodes the cases after it.
            horizon: Time from which on nothing counts, s.
            haste: Share of its expected time that a turn may take where :meth:`outlook` calls a task feasible. Below 1, there are
                candidates that only a faster turn than expected completes in time, as half of all turns are.

        Raises:
            ValueError, FileNotFoundError: For a wrong argument, and as :func:`bsk_torch.tasks.aeos_bench.read_cases`.
        """
        self.order = one_of("order", order, ORDERS)
        in_memory = isinstance(cases, Cases | AEOSBenchGenerator)
        if in_memory and not (satellites is None and tasks is None):
            raise ValueError(f"satellites={satellites} and tasks={tasks} pad cases of a folder; those given have their sizes")
        if isinstance(cases, AEOSBenchGenerator) and order != "random":
            raise ValueError(f"order={order!r} lists cases, but a generator draws them; leave it out")
        self.cases = cases if isinstance(cases, Cases | AEOSBenchGenerator) else read_cases(cases, satellites, tasks)
        self.horizon = number("horizon", horizon, 0.0, unit="s", above=True)
        self.haste = number("haste", haste, 0.0, 1.0)
        self._memo = Memo()

    def case_of(self, key: Key) -> Tensor:
        """Return the number of the case of each episode, [n]; -1 for cases of a generator."""
        if isinstance(self.cases, AEOSBenchGenerator):
            return torch.full((len(key),), -1)
        if self.order == "listed":
            return (key.seed + key.env_id + key.episode) % len(self.cases)
        return (key.named("case").uniform(1).squeeze(1) * len(self.cases)).long()

    def cases_of(self, key: Key) -> Cases:
        """Return the cases of the episodes that begin in the n environments of a key."""
        return self.cases.draw(key) if isinstance(self.cases, AEOSBenchGenerator) else self.cases.take(self.case_of(key))

    @override
    def draw(self, key: Key) -> dict[str, Tensor]:
        cases = self.cases_of(key)
        tasks = {f"task_{name}": values for name, values in cases.tasks.items()}
        sensors = {"sensor_type": cases.sensors, "sensor_enabled": cases.enabled.double()}
        return tasks | sensors | {PLACES: cases.places, "case": self.case_of(key).double()}

    @override
    def present(self, key: Key, names: Sequence[str]) -> Tensor:
        return self.cases_of(key).present

    def link(self, fleet: SatelliteFleet) -> None:
        """See :meth:`Scenario.link`; ValueError for satellites without the sensor of the benchmark."""
        super().link(fleet)
        for satellite in fleet.satellites:
            if not hasattr(type(satellite.dynamics), "boresight_P"):
                raise ValueError(f"AEOSBench needs satellites with AEOSBenchDynModel; {satellite.name} has none")
            kind = type(satellite.dynamics)
            satellite.simulator.observer.want([kind.boresight_P.function, kind.r_BN_P.function, kind.sensor_cone.function])
        count = self.n_tasks
        fleet.memory.declare("task_progress", 0.0, count, low=0.0)
        fleet.memory.declare("task_best", 0.0, count, low=0.0)
        fleet.memory.declare("task_success", -1.0, count, low=-1.0)

    @property
    def n_tasks(self) -> int:
        """Number of tasks of an episode, those that pad included."""
        return self.cases.n_tasks

    @override
    def recorded_targets(self, env: int) -> RecordedTargets:
        r_P = torch.where(self.task_exists[env].unsqueeze(-1), self.drawn(PLACES)[env], torch.nan).cpu()
        return RecordedTargets(places="ground", r=r_P, priority=torch.ones(len(r_P), dtype=torch.float64))

    @property
    def task_time(self) -> Tensor:
        """Time since the start, [N] s; whole ticks are not rounded."""
        return self.fleet.ticks.double() * self.fleet.h

    @property
    def task_exists(self) -> Tensor:
        """Which tasks exist, [N, T]."""
        return self.drawn("task_duration") > 0.0

    @property
    def task_succeeded(self) -> Tensor:
        """Which tasks have succeeded, [N, T]."""
        return self.memory["task_success"] >= 0.0

    @property
    def task_ongoing(self) -> Tensor:
        """Which tasks are ongoing at the current time, [N, T]: released, not overdue, and not succeeded."""
        return self._timely & ~self.task_succeeded

    @property
    def task_offered(self) -> Tensor:
        """Which tasks can be chosen, [N, T]: the ongoing ones, and those that succeed at this time.

        The benchmark decides before it counts, so its satellites point at a task for one more second.
        """
        success = self.memory["task_success"]
        return self._timely & ((success < 0.0) | (success == self.task_time.unsqueeze(1)))

    @property
    def _timely(self) -> Tensor:
        def find() -> Tensor:
            now = self.task_time.unsqueeze(1)
            timely = (self.drawn("task_release") <= now) & (now <= self.drawn("task_due"))
            return timely & self.task_exists & (now < self.horizon)

        return self._memo.once("timely", self.fleet, find)

    def timely(self, envs: Tensor, now: Tensor) -> Tensor:
        """Return which tasks of the episodes ``envs`` [n] are released and not overdue at times ``now`` [n, K] s, [n, K, T]."""
        release, due = (self.drawn(name)[envs].unsqueeze(1) for name in ("task_release", "task_due"))
        now = now.unsqueeze(2)
        return (release <= now) & (now <= due) & self.task_exists[envs].unsqueeze(1) & (now < self.horizon)

    def views(self) -> Views:
        """Return where the sensors of the satellites are and look, [N, S, ...] each."""
        satellites = self.fleet.satellites
        r_P, axis_P, tangent = (
            self.fleet.joined([read(satellite.dynamics) for satellite in satellites])
            for read in (lambda dyn: dyn.r_BN_P, lambda dyn: dyn.boresight_P, lambda dyn: dyn.sensor_cone)
        )
        return Views(r_P, axis_P, tangent)

    def task_access(self) -> Tensor:
        """Return which places each present satellite has in its cone and above its horizon, [N, S, T].

        With the position r of a satellite, m, the axis n of its sensor, and the place p, all Earth-fixed, and ``d = p - r``::

            0 <= d . n <= 1e9,    |d - (d . n) n| < (d . n) tan(half field of view),    p . (r - p) > 0,    |d| <= 1e9
        """
        place, view = self.drawn(PLACES).unsqueeze(1), Views(*(part.unsqueeze(2) for part in self.views()))
        return in_access(view, place) & self.present_now.unsqueeze(-1)

    @property
    def present_now(self) -> Tensor:
        """Which satellites exist in the current episodes, [N, S]."""
        return self.fleet.joined([satellite.present for satellite in self.fleet.satellites])

    @property
    def sensor_in_mode(self) -> Tensor:
        """Which satellites are in the mode in which the sensor is on, [N, S]."""
        return self.fleet.joined([part.mode == part.mode_names.index(SENSOR_ON) for part in self.fleet.simulators])

    @property
    def sensor_on(self) -> Tensor:
        """Which satellites have had their sensor on in the last tick, [N, S]; at the start, those that the file enables."""
        return torch.where((self.fleet.ticks == 0).unsqueeze(1), self.drawn("sensor_enabled") > 0.5, self.sensor_in_mode)

    def motion(self) -> tuple[Tensor, Tensor]:
        """Return positions, m, and velocities relative to the Earth, m/s, of satellites, Earth-fixed, [N, S, 3] each."""
        r_P = self.views().r_P

        def velocity(satellite: BoundSatellite) -> Tensor:
            PN: Tensor = satellite.simulator.observer.now.PN.stack()
            return (PN @ satellite.dynamics.v_BN_N.unsqueeze(-1)).squeeze(-1)

        spin = torch.tensor(EARTH_SPIN, dtype=r_P.dtype, device=r_P.device).expand_as(r_P)
        return r_P, self.fleet.each(velocity) - torch.linalg.cross(spin, r_P)

    def outlook(self) -> TaskOutlook:
        """Return what satellites can expect of tasks if they turn to them now."""
        return self._memo.once("outlook", self.fleet, self._outlook)

    def _outlook(self) -> TaskOutlook:
        fleet, now, views, place = self.fleet, self.task_time.view(-1, 1, 1), self.views(), self.drawn(PLACES)
        pace, acceleration = (fleet.joined(parts).unsqueeze(2) for parts in zip(*map(_abilities, fleet.satellites), strict=True))
        height, rise, below = sight_times(*self.motion(), place)
        radius2 = (views.r_P / EARTH_RADIUS).square().sum(-1).unsqueeze(2)
        distance = (1.0 + radius2 - 2.0 * height).clamp(min=1e-12).sqrt() * EARTH_RADIUS
        along = (dot(views.axis_P, place) - (views.r_P * views.axis_P).sum(-1).unsqueeze(2)) / distance
        angle, cone = torch.acos(along.clamp(-1.0, 1.0)), views.tangent.atan().unsqueeze(2)
        turn = turn_time(angle, cone, pace, acceleration)
        start = torch.maximum(turn, rise)
        progress = torch.where(angle > cone, 0.0, self.memory["task_progress"].unsqueeze(1))
        remaining = self.drawn("task_duration").unsqueeze(1) - progress
        last = torch.minimum(below, self.drawn("task_due").unsqueeze(1).clamp(max=self.horizon - 1.0) - now)
        in_time = torch.maximum(self.haste * turn, rise) + remaining <= last
        feasible = in_time & self.task_ongoing.unsqueeze(1) & self.present_now.unsqueeze(2)
        return TaskOutlook(angle, turn, start, start + remaining, last, feasible)

    def candidates(self, count: int) -> TaskCandidates:
        """Return the first ``count`` tasks of each satellite, in the order of their costs."""
        name = f"candidates {count}"
        return self._memo.once(name, self.fleet, lambda: find_candidates(self.outlook(), self.held_task, count))

    @property
    def held_task(self) -> Tensor:
        """Number of the task that each satellite points at, [N, S]; -1 for none."""
        return self.fleet.each(lambda satellite: satellite.simulator.memory[ASSIGNED])

    def task_visible(self, counted: Tensor | None = None) -> tuple[Tensor, Tensor, Tensor]:
        """Return the tasks that satellites see with their sensors, as indices of episode, satellite and task, [m] each.

        Few satellites have an ongoing task near the cone of their sensor. These are found in float32, within a margin of ten
        times its rounding errors, and their tasks are tested as in :meth:`task_access`.

        Args:
            counted: The tasks that count, [N, T] (default: the ongoing ones).
        """
        views, places, ongoing = self.views(), self.drawn(PLACES), self.task_ongoing if counted is None else counted
        near = near_cone(views, places * ongoing.unsqueeze(-1))
        looks = (near.closest > near.limit) & self.sensor_on & self.present_now
        row, column = torch.nonzero(looks, as_tuple=True)
        pair, task = torch.nonzero(near.closeness[row, column] > near.limit[row, column].unsqueeze(1), as_tuple=True)
        episode, satellite = row[pair], column[pair]
        view = Views(*(part[episode, satellite] for part in views))
        fits = self.drawn("sensor_type")[episode, satellite] == self.drawn("task_type")[episode, task]
        access = in_access(view, places[episode, task]) & fits & ongoing[episode, task]
        return episode[access], satellite[access], task[access]

    def sights(self, envs: Tensor, views: Views, ran: Tensor, on: Tensor, ongoing: Tensor) -> Sights:
        """Return which tasks satellites see with their sensors at each of K ticks.

        Most pairs of satellites and tasks are never above the horizon. The others are tested at every tick as in
        :meth:`task_access`.

        Args:
            envs: The episodes, [n].
            views: Where their satellites look, [n, S, K].
            ran: Number of ticks for which this is known, [n].
            on: Which of their sensors are on, [n, S].
            ongoing: Which of their tasks count, [n, K, T].
        """
        places, looks = self.drawn(PLACES)[envs], (on & self.present_now[envs]).unsqueeze(-1)
        fits = self.drawn("sensor_type")[envs].unsqueeze(2) == self.drawn("task_type")[envs].unsqueeze(1)
        parts = [torch.empty(4, 0, dtype=torch.int64, device=envs.device)]
        for start in range(0, ongoing.shape[1], PIECE):
            piece, count = Views(*(part[:, :, start : start + PIECE] for part in views)), ongoing[:, start : start + PIECE]
            above = above_horizon(piece.r_P, (ran - start).clamp(0, count.shape[1]), places)
            pairs = torch.nonzero(above & count.any(1).unsqueeze(1) & looks & fits)
            for row, satellite, task in (some.unbind(1) for some in pairs.split(AT_ONCE)):
                view = Views(*(part[row, satellite] for part in piece))
                access = in_access(view, places[row, task].unsqueeze(1)) & count[row, :, task]
                pair, tick = torch.nonzero(access, as_tuple=True)
                parts.append(torch.stack([row[pair], tick + start, satellite[pair], task[pair]]))
        return Sights(*torch.cat(parts, 1))

    def flown_views(self, flight: Flight, ticks: int) -> Views:
        """Return where satellites of a flight looked at each of its first ticks, [n, S, K]; they record it."""
        order = torch.cat(self.fleet.columns).argsort()
        r_P, axis_P = (
            torch.cat([flight.read(k, name)[:, :, 1 : 1 + ticks] for k in range(len(flight.counts))], 1)[:, order]
            for name in VIEWS
        )
        tangent = self.fleet.joined([satellite.dynamics.sensor_cone for satellite in self.fleet.satellites])[flight.envs]
        return Views(r_P, axis_P, tangent.unsqueeze(2).expand(r_P.shape[:3]))


def _abilities(satellite: BoundSatellite) -> tuple[Tensor, Tensor]:
    """Return how satellites of a type turn: their time constant, s, and acceleration, rad/s^2, [n] each."""
    inertia, K, P, Ki = (satellite.simulator.argument(name) for name in ("inertia", "K", "P", "Ki"))
    across = inertia[..., [0, 4]].amax(-1)  # of turns of the axis +z
    return time_constant(across, K, P, Ki), MOST_TORQUE / across


class Sights(NamedTuple):
    """Tasks that satellites see: numbers of episode, tick, satellite and task, [m] each."""

    episode: Tensor
    tick: Tensor
    satellite: Tensor
    task: Tensor


class Views(NamedTuple):
    """Positions of satellites, [..., 3] m, axes of their sensors, [..., 3], both Earth-fixed, and tangents of cones, [...]."""

    r_P: Tensor
    axis_P: Tensor
    tangent: Tensor


def in_access(view: Views, place: Tensor) -> Tensor:
    """Return whether satellites have access to places [..., 3], [...]; see :meth:`AEOSBench.task_access`."""
    d = place - view.r_P
    along, range2 = (d * view.axis_P).sum(-1), (d * d).sum(-1)
    aside = d - along.unsqueeze(-1) * view.axis_P
    inside = ((aside * aside).sum(-1) < (along * view.tangent) ** 2) & (along >= 0.0) & (along <= FARTHEST)
    return inside & ((place * d).sum(-1) < 0.0) & (range2 <= FARTHEST * FARTHEST)


class NearCone(NamedTuple):
    """Which places may be in access: those whose ``closeness`` [N, S, T] exceeds ``limit`` [N, S], float32 each.

    ``closest`` [N, S] is the largest closeness of each satellite.
    """

    closeness: Tensor
    limit: Tensor
    closest: Tensor


def near_cone(views: Views, places: Tensor) -> NearCone:
    """Return which of the places [N, T, 3] may be in access of satellites [N, S], from float32 numbers in Earth radii.

    In the plane of its axis n and of the nadir, a satellite at r sees along directions with the angle a from the nadir, to the
    range ``s = x - sqrt(x^2 - r^2 + 1)`` with ``x = r cos a``, at most that of the horizon. With those of both ends of its cone,
    s1 and s2, the point q on the axis at ``s = (s1 + s2) / 2``, and the tangent t of the cone, places p that it sees have

        |p - q|^2 < (s2 - s1)^2 / 4 + s2 s t^2 = e,    so that    p . q > (1 + |q|^2 - e) / 2,

    less :data:`MARGIN` for rounding. The limit is infinite where the cone misses the Earth.
    """
    r, tangent = views.r_P / EARTH_RADIUS, views.tangent
    radius2, x = (r * r).sum(-1), -(r * views.axis_P).sum(-1)
    across, cosine = (radius2 - x * x).clamp(min=0.0).sqrt(), (1.0 + tangent * tangent).rsqrt()
    horizon2 = (radius2 - 1.0).clamp(min=0.0)
    low, high = horizon2.sqrt(), radius2.sqrt()
    outer = (x - across * tangent) * cosine
    inner = torch.where(across <= x * tangent, high, (x + across * tangent) * cosine)
    ranges = (part - (part * part - horizon2).clamp(min=0.0).sqrt() for part in (at.clamp(low, high) for at in (inner, outer)))
    nearest_range, farthest_range = ranges
    middle = 0.5 * (nearest_range + farthest_range)
    q = r + middle.unsqueeze(-1) * views.axis_P
    error = 0.25 * (farthest_range - nearest_range).square() + farthest_range * middle * tangent * tangent
    limit = 0.5 * (1.0 + (q * q).sum(-1) - error) - MARGIN
    limit = torch.where(inner < low - MARGIN, torch.inf, limit).float()
    closeness = q.float() @ (places / EARTH_RADIUS).float().mT
    return NearCone(closeness, limit, closeness.amax(-1))


def above_horizon(r_P: Tensor, ran: Tensor, places: Tensor) -> Tensor:
    """Return the pairs of satellites and places that may see each other at some of the first ``ran`` [n] of K ticks, [n, S, T].

    A place p [n, T, 3] is above the horizon of a satellite at ``r_P`` [n, S, K, 3] within the angle ``arccos(R / r)`` of it. The
    test is at the middle tick, for the largest r, with the largest angle of motion since or until then, and a margin of 1e-3 rad.
    """
    radius = r_P.norm(dim=-1)
    up = r_P / radius.clamp(min=1.0).unsqueeze(-1)
    middle = up[torch.arange(len(ran), device=ran.device), :, ran // 2]
    valid = (torch.arange(r_P.shape[2], device=ran.device) < ran.unsqueeze(1)).unsqueeze(1)
    moved = torch.where(valid, (up * middle.unsqueeze(2)).sum(-1), 1.0).amin(2).clamp(-1.0, 1.0).arccos()
    highest = torch.where(valid, radius, EARTH_RADIUS).amax(2)
    reach = (EARTH_RADIUS / highest).clamp(max=1.0).arccos() + moved + 1e-3
    return middle @ (places.mT / EARTH_RADIUS) > reach.clamp(max=math.pi).cos().unsqueeze(-1)
