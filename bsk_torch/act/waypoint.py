"""Transfers to waypoints about another satellite, as discrete actions."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch._checks import no_gradient, number
from bsk_torch.act.base import Action, Decision
from bsk_torch.act.thrust import ImpulsiveThrustHill
from bsk_torch.astro.linear_motion import LinearMotion, about_orbit
from bsk_torch.astro.relative import cd2hill, fibonacci_sphere
from bsk_torch.astro.transfers import Transfers, transfers
from bsk_torch.sats.bound import BoundSatellite

RESERVE = 1e-6
"""Velocity change always left in the tank, m/s."""

SPACING = 100.0
"""Maximum time between computed points of a path, s; paths are straight in between, within 2 m at 1 m/s."""

FAR = 1e12
"""Distance, m, assigned to absent satellites, so that transfers are not kept apart from them."""

WEIGHT = 1e4
"""Scale, m, for comparing violated distances if none of the transfers keeps all distances."""


class Options(NamedTuple):
    """Available transfers of N satellites."""

    versions: list[int]  # versions of the states used
    inputs: Tensor  # numbers used, by row, [N, F]
    ahead: Transfers
    legal: Tensor  # whether each transfer is legal, [N, n_actions]
    stuck: Tensor  # whether no transfer keeps the distances, [N]


class HillWaypoint(Action):
    """Fly to one of several waypoints around a chief in one of several durations, by a single maneuver.

    Action ``d * K + k`` is the transfer to waypoint d in duration k. The maneuver is computed from the linear relative motion
    about a chief on a two-body orbit (:func:`bsk_torch.astro.linear_motion.about_orbit`). There is no maneuver on arrival, so the
    satellite passes the waypoint.

    A transfer is illegal if it passes closer to the chief than ``keep_out``, goes beyond ``keep_in``, passes closer than
    ``keep_apart`` to the predicted drift of another satellite, or costs more than ``max_dv`` or the content of the tank. A
    maneuver that costs too much is scaled down to the limit and lasts for the shortest duration, after which another maneuver is
    possible. If all are illegal, one is legal nevertheless: the transfer that best keeps the distances for the shortest duration
    and keeps the satellite closest to the chief during an equally long drift afterwards. It also lasts for the shortest duration.

    Satellites of one type and episode that decide at the same time do not know each other's choice when they read their masks. A
    shield keeps their paths ``keep_apart``, in the order of their numbers. If the chosen path comes too close to the path of an
    earlier satellite, the satellite flies another legal transfer that is clear of the earlier paths: the one with the waypoint,
    then the duration, closest to the chosen one. If there is none, it flies the legal transfer that stays farthest apart, for the
    shortest duration. The recorded action does not change.

    Maneuvers of BSK-RL are :class:`ImpulsiveThrustHill`.
    """

    fsw_type = ImpulsiveThrustHill.fsw_type

    def __init__(
        self,
        chief_name: str,
        waypoints: object = 32,
        durations: Sequence[float] = (600.0, 1200.0, 2000.0),
        *,
        distance: float = 60.0,
        max_dv: float = math.inf,
        keep_out: float = 0.0,
        keep_in: float = math.inf,
        keep_apart: float = 0.0,
        fsw_action: str | None = None,
        name: str = "waypoint",
    ) -> None:
        """Define waypoints and durations.

        Args:
            chief_name: Name of the chief.
            waypoints: Positions in the chief's Hill frame, [D, 3] m, or their number, distributed evenly at the ``distance``.
            durations: Durations of transfers, s.
            distance: Distance of evenly distributed waypoints from the chief, m.
            max_dv: Maximum maneuver, m/s.
            keep_out: Minimum distance from the chief on the way, m.
            keep_in: Maximum distance from the chief on the way, m.
            keep_apart: Minimum distance from other satellites on the way, m.
            fsw_action: Flight-software command during the transfer.
            name: Name of the entry.
        """
        super().__init__(name)
        title = f"action {self.name!r}: "
        # executes the maneuvers, and checks chief, tank and command
        self._thrust = ImpulsiveThrustHill(chief_name, self.name, max_dv, math.inf, fsw_action)
        self.chief_name, self.max_dv = self._thrust.chief_name, self._thrust.max_dv
        self.distance = number(f"{title}distance", distance, 0.0, unit="m", above=True)
        self.keep_out = number(f"{title}keep_out", keep_out, 0.0, unit="m")
        self.keep_in = number(f"{title}keep_in", keep_in, self.keep_out, unit="m", above=True, finite=False)
        self.keep_apart = number(f"{title}keep_apart", keep_apart, 0.0, unit="m")
        self.waypoints = self._positions(title, waypoints)
        seconds = [number(f"{title}durations", each, 0.0, unit="s", above=True) for each in durations]
        if not seconds:
            raise ValueError(f"{title}durations={list(durations)} must have at least one entry")
        self.durations = torch.tensor(seconds, dtype=torch.float64)
        self.shortest, self.samples = min(seconds), math.ceil(max(seconds) / SPACING)
        self.n_actions = len(self.waypoints) * len(self.durations)
        self._order = self._replacement_order()
        self._options: Options | None = None

    def _positions(self, title: str, waypoints: object) -> Tensor:
        if isinstance(waypoints, int) and not isinstance(waypoints, bool):
            if waypoints < 1:
                raise ValueError(f"{title}waypoints={waypoints} must be at least 1")
            return torch.as_tensor(fibonacci_sphere(waypoints)) * self.distance
        positions = torch.as_tensor(no_gradient(f"{title}waypoints", waypoints), dtype=torch.float64)
        if positions.ndim != 2 or positions.shape[1] != 3 or not len(positions) or not bool(torch.isfinite(positions).all()):
            fault = f"shape {list(positions.shape)}" if bool(torch.isfinite(positions).all()) else "values that are not finite"
            raise ValueError(f"{title}waypoints must be a number, or finite positions [D, 3] m; they have {fault}")
        return positions

    def link_satellite(self, satellite: BoundSatellite) -> None:
        """See :meth:`Action.link_satellite`; ValueError without a tank, for an unknown command or chief, or its own type."""
        super().link_satellite(satellite)
        self._thrust.link_satellite(satellite)
        if satellite.fleet.place_of(self.chief_name)[0] == satellite.type_index:
            raise ValueError(f"action {self.name!r}: chief_name={self.chief_name!r} has the same type as its deputies")

    @override
    def names(self) -> list[str]:
        return [f"{self.name}_{d}_{time:g}s" for d in range(len(self.waypoints)) for time in self.durations.tolist()]

    @property
    def options(self) -> Options:
        """Transfers and their legality, updated only for rows of changed episodes."""
        versions = [simulator.state.version for simulator in self.satellite.fleet.simulators]
        last = self._options
        if last is not None and last.versions == versions:
            return last
        ahead, inputs = self.ahead(), self.inputs()
        if last is None:
            legal, stuck = self.legal(ahead, torch.arange(len(inputs), device=inputs.device))
        else:
            rows = torch.nonzero((inputs != last.inputs).any(1)).squeeze(1)
            parts = self.legal(ahead.some(rows), rows)
            legal, stuck = (old.index_copy(0, rows, new) for old, new in zip((last.legal, last.stuck), parts, strict=True))
        self._options = Options(versions, inputs, ahead, legal, stuck)
        return self._options

    def inputs(self) -> Tensor:
        """Return the inputs of transfers and their legality, [N, F]; equal inputs give equal results."""
        places = [place.flatten(1) for place in self.places()]
        simulator, present = self.satellite.simulator, self.satellite.fleet.present
        flags = [] if present is None else [present.double().repeat_interleave(simulator.count, 0)]
        return torch.cat([*places, self.most_dv.unsqueeze(1), *flags], 1)

    def places(self) -> tuple[Tensor, Tensor]:
        """Return positions, m, and velocities, m/s, of all S satellites of the episode of each row, [N, S, 3] each in N."""
        fleet, simulator = self.satellite.fleet, self.satellite.simulator
        r, v = (fleet.joined([each.state.read(name) for each in fleet.simulators]) for name in ("r_BN_N", "v_BN_N"))
        return r.repeat_interleave(simulator.count, 0), v.repeat_interleave(simulator.count, 0)

    def ahead(self) -> Transfers:
        """Return all transfers from the current position."""
        motion = self.motion(self.durations, self.samples)
        return transfers(motion, *self.relative_state(), self.waypoints.to(motion.time.device), self.most_dv)

    def motion(self, durations: Tensor, samples: int) -> LinearMotion:
        """Return the motion about the chief at given times, s."""
        count = self.satellite.simulator.count
        r_CN_N, v_CN_N = (vector[::count] for vector in self._thrust.chief_state())  # the same for all of an episode
        return about_orbit(r_CN_N, v_CN_N, durations.to(r_CN_N.device), samples).repeated(count)

    @property
    def most_dv(self) -> Tensor:
        """Maximum maneuver now, [N] m/s; a maneuver that empties the tank would kill the satellite."""
        return (self.satellite.simulator.read("dv_available") - RESERVE).clamp(0.0, self.max_dv)

    def others(self) -> tuple[Tensor, Tensor]:
        """Return positions [N, O, 3] m and velocities [N, O, 3] m/s of all other satellites in the chief's Hill frame."""
        fleet, simulator = self.satellite.fleet, self.satellite.simulator
        r, v = self.places()
        column = torch.tensor(simulator.columns, device=r.device).repeat(simulator.num_envs)
        chief = fleet.names.index(self.chief_name)
        columns = torch.arange(fleet.size, device=r.device).expand(len(r), -1)
        here = columns[(columns != column.unsqueeze(1)) & (columns != chief)].view(len(r), -1)
        r_C, v_C = (vector.unsqueeze(1) for vector in self._thrust.chief_state())
        r, v = (each.gather(1, here.unsqueeze(-1).expand(-1, -1, 3)) for each in (r, v))
        rho, velocity = cd2hill(r_C, v_C, r, v)
        if fleet.present is None:
            return rho, velocity
        present = fleet.present.repeat_interleave(simulator.count, 0).gather(1, here).unsqueeze(-1)
        far = torch.tensor([0.0, FAR, 0.0], dtype=rho.dtype, device=rho.device)  # along the chief's track, where it stays
        return torch.where(present, rho, far), torch.where(present, velocity, 0.0)

    def relative_state(self) -> tuple[Tensor, Tensor]:
        """Return position [N, 3] m and velocity [N, 3] m/s in the chief's Hill frame."""
        state = [self.satellite.simulator.read(name) for name in ("r_BN_N", "v_BN_N")]
        return cd2hill(*self._thrust.chief_state(), *state)

    @override
    def decide(self, index: Tensor, mask: Tensor, action: Tensor, previous: Tensor) -> Decision:
        ahead = self.options.ahead
        flown, apart = self.shielded(index.clamp(0, self.n_actions - 1), mask)
        dv_N = self._thrust.change_of_velocity(ahead.manoeuvre(flown))
        duration = self.durations.to(index.device)[flown % len(self.durations)]
        reached = ahead.cost.flatten(1).gather(1, flown.unsqueeze(1)).squeeze(1) <= self.most_dv
        duration = torch.where(reached & apart & ~self.options.stuck, duration, self.shortest)
        return self._thrust.enter(self._thrust.fsw_action, duration, dv_N)._replace(key=action)

    @override
    def begin(self, mask: Tensor, decision: Decision) -> None:
        self._thrust.begin(mask, decision)

    @override
    def mask(self) -> Tensor:
        return self.options.legal

    def legal(self, ahead: Transfers, rows: Tensor) -> tuple[Tensor, Tensor]:
        """Return which transfers ``ahead`` of the R rows are legal, [R, n_actions], and where none keeps the distances, [R]."""
        others = self.others_of(rows)
        legal = ((self.missed(ahead, others) <= 0.0) & (ahead.cost <= self.most_dv[rows, None, None])).flatten(1)
        none = ~legal.any(1)
        stuck = torch.nonzero(none).squeeze(1)
        if len(stuck):  # few rows, often none: finding a legal transfer there takes as long as the rest
            least = self.least(ahead.some(stuck), rows[stuck])
            legal[stuck] = torch.zeros_like(legal[stuck]).scatter(1, least, True)
        return legal, none

    def others_of(self, rows: Tensor) -> tuple[Tensor, Tensor] | None:
        """Return positions and velocities of the satellites to keep apart from the rows; None for none."""
        if self.keep_apart == 0.0 or self.satellite.fleet.size == 2:
            return None
        rho, velocity = self.others()
        return rho[rows], velocity[rows]

    def missed(self, ahead: Transfers, others: tuple[Tensor, Tensor] | None) -> Tensor:
        """Return the relative violation of distances by transfers, [N, D, K]; not positive for transfers without violation.

        ``others`` are the satellites to keep apart; see :meth:`others_of`.
        """
        if others is None:
            nearest, farthest = ahead.distances()
            missed = (self.keep_out - nearest) / max(self.keep_out, 1.0)
        else:
            near, farthest = ahead.extremes(*others)
            missed = torch.maximum(
                (self.keep_out - near[:, 0]) / max(self.keep_out, 1.0),
                (self.keep_apart - near[:, 1:].amin(1)) / self.keep_apart,
            )
        return torch.maximum(missed, farthest / self.keep_in - 1.0) if math.isfinite(self.keep_in) else missed

    def least(self, ahead: Transfers, rows: Tensor) -> Tensor:
        """Return the transfers among ``ahead`` to allow where none keeps the distances, [R, 1] for R rows."""
        soon = math.ceil(self.shortest / SPACING)
        twice = self.motion(torch.tensor([2.0 * self.shortest], dtype=torch.float64), 2 * soon).some(rows)
        later = torch.linalg.vector_norm(ahead.along(twice).position(-1), dim=-1)
        missed = self.missed(ahead.along(twice.until(soon)), self.others_of(rows)).clamp(min=0.0)
        return (missed * WEIGHT + later).flatten(1).argmin(1, keepdim=True)

    def shielded(self, chosen: Tensor, mask: Tensor) -> tuple[Tensor, Tensor]:
        """Return the transfers to fly, [N], for ``chosen`` [N], decided at the same time in the rows ``mask`` [N].

        The second tensor, [N], is True for transfers that stay ``keep_apart`` from those of earlier satellites.

        The first satellite of an episode flies its chosen transfer. So does each following satellite, unless its path comes
        closer than ``keep_apart`` to an earlier one; for this case, see the class. Paths continue after arrival.
        """
        count = self.satellite.simulator.count
        if count == 1 or self.keep_apart == 0.0:
            return chosen, torch.ones_like(mask)
        ahead = self.options.ahead
        legal, order = self.options.legal.view(-1, count, self.n_actions), self._order.to(chosen.device)
        rho, before = (each.view(-1, count, 3) for each in self.relative_state())
        chosen, decides = chosen.view(-1, count), mask.view(-1, count)
        flown, kept = [chosen[:, 0]], [torch.ones_like(decides[:, 0])]
        after = [before[:, 0] + ahead.rows(0, count).manoeuvre(chosen[:, 0])]
        for k in range(1, count):  # one after the other, since each choice depends on those before
            options, wanted = ahead.rows(k, count), chosen[:, k]
            apart = options.apart(rho[:, :k], torch.stack(after, 1)).flatten(2)
            apart = torch.where(decides[:, :k, None], apart, torch.inf).amin(1)
            clear = legal[:, k] & (apart >= self.keep_apart)
            nearest = torch.where(clear, order[wanted], self.n_actions).argmin(1)
            widest = torch.where(legal[:, k], apart, -1.0).argmax(1)
            instead = torch.where(clear.any(1), nearest, widest)
            stays = apart.gather(1, wanted.unsqueeze(1)).squeeze(1) >= self.keep_apart
            flown.append(torch.where(stays, wanted, instead))
            kept.append(stays | clear.any(1))
            after.append(before[:, k] + options.manoeuvre(flown[-1]))
        return torch.stack(flown, 1).flatten(), torch.stack(kept, 1).flatten()

    def _replacement_order(self) -> Tensor:
        """Return the rank [A, A] of transfers by closeness to each transfer: first by waypoint, then by duration."""
        apart = torch.cdist(self.waypoints, self.waypoints, compute_mode="donot_use_mm_for_euclid_dist")
        longer = (self.durations - self.durations.unsqueeze(1)).abs()
        apart = (apart.repeat_interleave(len(longer), 0)).repeat_interleave(len(longer), 1)
        by_duration = longer.repeat(len(self.waypoints), len(self.waypoints)).argsort(dim=1, stable=True)
        by_both = by_duration.gather(1, apart.gather(1, by_duration).argsort(dim=1, stable=True))
        return by_both.argsort(1)
