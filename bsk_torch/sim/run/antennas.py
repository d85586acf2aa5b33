"""Antennas of ground stations, for which the satellites of an episode contend."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor

from bsk_torch.sim.environment.world import ANTENNA_TICK
from bsk_torch.sim.places import STATION_KIND

if TYPE_CHECKING:
    from bsk_torch.sim.fleet import Fleet

SINCE = "downlink_since"  # name in the memory of the fleet
IDLE = -1.0  # value of satellites that do not transmit

LONGEST_PASS = 1800.0
"""Time for which passes are known beyond a step, s; longer ones count as if they ended then."""


class Antennas:
    """Serves no more satellites at a station at a time than it has antennas.

    A satellite that transmits asks for an antenna of each station in view, from the beginning of its downlink or of its pass,
    whichever is later, until one of them ends. It is served while fewer satellites than there are antennas have begun before it,
    so that one which is served keeps its antenna. Of those that begin at once, the one whose pass opened first comes first, which
    ends first on similar orbits; then the one with the lower number.

    Passes are those over the minimum elevation, also beyond the maximum range. A step is reckoned at its beginning, for the next
    pass over each station.

    Attributes:
        number: Antennas of each station, [P] int64; the number of satellites where there is no limit.
    """

    def __init__(self, fleet: Fleet, number: Tensor) -> None:
        self.fleet, self.number = fleet, number.to(fleet.device)
        fleet.memory.declare(SINCE, IDLE, fleet.size, low=IDLE)

    @classmethod
    def of(cls, fleet: Fleet) -> Antennas | None:
        """Return the antennas of a fleet; None where satellites do not contend for any."""
        limited = [s for s in fleet.simulators if s.contended]
        if fleet.size == 1 or not limited:
            return None
        stations = limited[0].type.arguments.world_args.given["groundStationsData"]
        return cls(fleet, torch.tensor([min(s.get("antennas") or fleet.size, fleet.size) for s in stations]))

    def _transmits(self) -> Tensor:
        """Return which satellites are in a mode with the transmitter on, [N, S]."""
        parts = []
        for simulator in self.fleet.simulators:
            flags, off = list(simulator.tick.flags.fields), torch.zeros_like(simulator.mode, dtype=torch.bool)
            on = "transmitter_on" in flags
            parts.append(simulator.flag_table[flags.index("transmitter_on")][simulator.mode] > 0.0 if on else off)
        return self.fleet.joined(parts) & ~self.fleet.state.removed

    def _passes(self, until: Tensor) -> tuple[Tensor, Tensor]:
        """Return when the next pass of each satellite over each station opens and closes, [N, S, P] s; infinity for none."""
        opens: list[Tensor] = []
        closes: list[Tensor] = []
        for simulator in self.fleet.simulators:
            never = simulator.sim_time.new_full((len(simulator.sim_time), len(self.number)), torch.inf)
            if not simulator.contended:
                opens, closes = [*opens, never], [*closes, never]
                continue
            now, access = simulator.sim_time, simulator.lookahead.access
            assert access is not None
            simulator.lookahead.generate_until(simulator.of_env(until) + LONGEST_PASS, now)
            windows, end = access.windows[STATION_KIND], access.until.unsqueeze(1)
            ahead = (windows.close >= now.unsqueeze(1)) & (windows.open < end)
            for tables, time in ((opens, windows.open), (closes, torch.minimum(windows.close, end))):
                tables.append(never.scatter_reduce(1, windows.place, torch.where(ahead, time, torch.inf), "amin"))
        return self.fleet.joined(opens), self.fleet.joined(closes)

    def _turns(self, until: Tensor) -> tuple[Tensor, Tensor]:
        """Return when satellites ask for an antenna, and until when they wait, minus infinity if they do not, [N, S, P] s."""
        opens, closes = self._passes(until)
        since = self.fleet.memory[SINCE]
        since = torch.where(since == IDLE, self.fleet.sim_time.unsqueeze(1), since).unsqueeze(2)
        begin, index = torch.maximum(opens, since), torch.arange(self.fleet.size, device=opens.device)
        own, others = (begin.unsqueeze(2), opens.unsqueeze(2)), (begin.unsqueeze(1), opens.unsqueeze(1))
        tied = (others[1] < own[1]) | ((others[1] == own[1]) & (index < index.unsqueeze(1)).unsqueeze(2))
        before = (others[0] < own[0]) | ((others[0] == own[0]) & tied)
        served = before & self._transmits()[:, None, :, None] & (closes.unsqueeze(1) > own[0])
        ends = torch.where(served, closes.unsqueeze(1), -torch.inf).sort(2, descending=True).values
        return begin, ends.gather(2, (self.number - 1).expand_as(begin).unsqueeze(2)).squeeze(2)

    def assign(self, moves: Tensor, until: Tensor) -> None:
        """Assign the antennas in the episodes ``moves`` [N], before they run up to the ticks ``until`` [N]."""
        fleet = self.fleet
        since = fleet.memory[SINCE]
        begun = torch.where(since == IDLE, fleet.sim_time.unsqueeze(1), since)
        fleet.memory[SINCE] = torch.where(moves.unsqueeze(1), torch.where(self._transmits(), begun, IDLE), since)
        _, turn = self._turns(until.double() * fleet.h)
        tick = torch.where(turn > -torch.inf, turn / fleet.h + 1.0, -1.0)
        for k, simulator in enumerate(fleet.simulators):
            if simulator.contended:
                simulator.write(ANTENNA_TICK, simulator.of_env(moves), fleet.rows_of(k, tick))

    def wait(self) -> Tensor:
        """Return for how long each satellite waits for an antenna in its next pass over each station, [N, S, P] s.

        It is 0 where one is free, and counts from now or the beginning of the pass. Those that do not transmit would begin now,
        and all others continue.
        """
        begin, turn = self._turns(self.fleet.sim_time)
        now = self.fleet.sim_time[:, None, None]
        return torch.where(turn > -torch.inf, turn - torch.maximum(begin, now), 0.0).clamp(min=0.0)
