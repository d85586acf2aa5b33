"""Orbits of the objects of a catalog, carried along from decision to decision.

At a decision all objects are looked at, within a run only those at which instruments point: the flights of all are kept, 42
numbers each, and nodes are made for a few. The force model is that of satellites whose orbits are solved in advance.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from bsk_torch.codegen.kernel import Samples
from bsk_torch.sim.environment.ephemeris import RECORD_SPACING, ephemeris_records
from bsk_torch.sim.orbit.arcs import FARTHEST, REACH_AROUND
from bsk_torch.sim.orbit.flights import FIRST_STEP, REMEMBERED, Flights, positions, velocities
from bsk_torch.sim.orbit.flown_arc import FLOWN_STATE, MULTISTEP_STEP
from bsk_torch.sim.state import StateTable, outside_inference
from bsk_torch.vec3 import Vec3

CHUNK, DEVICE_CHUNK = 4096, 1 << 20
"""Objects advanced at once on the CPU, where they should fit into its cache, and on other devices."""

PAST_NODES = REMEMBERED // 2 + 1
"""Nodes of a track at or before the step of its flight."""

NOT_STARTED = 0
"""Step of objects that have not been looked at in the episode."""


class CatalogOrbits(StateTable):
    """Flights of the G objects of each episode: object g of episode e is row ``e * G + g``.

    ``flights`` [C, rows] are the states of :mod:`bsk_torch.sim.orbit.flights`, and ``steps`` [rows] the steps since the epoch at
    which they are. Both are brought up to date by :meth:`catch_up`.
    """

    flights: Tensor
    steps: Tensor

    def __init__(
        self,
        num_envs: int,
        count: int,
        solver: Flights,
        epoch: Callable[[Tensor], Tensor],
        beginning: Callable[[Tensor], tuple[Tensor, Tensor]],
    ) -> None:
        """Make room for objects.

        Args:
            num_envs: Number of episodes.
            count: Number of objects G of each.
            solver: Solver of their orbits.
            epoch: Returns ET at time zero, [n] s, of episodes [n].
            beginning: Returns positions, m, and velocities, m/s, of the objects then in N, [n, G, 3] each, likewise.
        """
        super().__init__(num_envs, count, solver.device)
        self.solver, self.epoch, self.beginning = solver, epoch, beginning
        self.declare("flights", None, FLOWN_STATE, planes=True, low=-FARTHEST, high=FARTHEST)
        self.declare("steps", NOT_STARTED, low=NOT_STARTED, high=2**53)

    def check_relations(self, path: str) -> None:
        """See :meth:`StateTable.check_relations`: the objects of an episode are at the same step."""
        steps = self.steps.view(self.num_envs, -1)
        wrong = (steps != steps[:, :1]).flatten()
        self.refuse(f"{path}steps", self.steps, wrong, "all objects of an episode must be at the same step")

    # -- time ---------------------------------------------------------------------------------------------------------

    @outside_inference
    def catch_up(self, time: Tensor) -> None:
        """Bring all objects to the first step at or after ``time`` [num_envs] s; those of an episode are at the same one."""
        present = self.steps.view(self.num_envs, -1)[:, 0]
        goal = torch.ceil(time * (1.0 / MULTISTEP_STEP)).long().clamp(min=FIRST_STEP)
        behind = present < goal
        if not bool(behind.any()):
            return
        new = torch.nonzero(present == NOT_STARTED).squeeze(-1)
        size = max(1, (CHUNK if self.device.type == "cpu" else DEVICE_CHUNK) // self.count)
        for envs in new.split(size):
            self._start(envs)
        present = torch.where(present == NOT_STARTED, FIRST_STEP, present)
        counts = torch.where(behind, goal - present, 0)
        if most := int(counts.max()):
            index = torch.arange(self.num_envs, device=self.device)
            owner = index.repeat_interleave(self.count)
            around = _around(self.epoch(index), present, most)._replace(owner=owner)
            self.solver.advance(self.flights, present[owner], counts[owner], around)
        self.steps = torch.maximum(present, goal).repeat_interleave(self.count)
        self.touch()

    def _start(self, envs: Tensor) -> None:
        """Start the flights of the objects of episodes ``envs`` [n]."""
        none = torch.zeros(len(envs), dtype=torch.float64, device=self.device)
        owner = torch.arange(len(envs), device=self.device).repeat_interleave(self.count)
        around = Samples(_records(self.epoch(envs), none, 0), none, owner)
        r_N, v_N = (part.flatten(0, 1) for part in self.beginning(envs))
        self.flights[:, self.rows_of(envs)] = self.solver.start(r_N, v_N, around)

    def _since(self, time: Tensor) -> Tensor:
        """Return ``time`` [num_envs] s in steps since those at which the objects are, [num_envs]."""
        return time * (1.0 / MULTISTEP_STEP) - self.steps.view(self.num_envs, -1)[:, 0].double()

    # -- looking ------------------------------------------------------------------------------------------------------

    def positions(self, time: Tensor) -> Tensor:
        """Return positions of all objects, [3, num_envs, G] m in N, at ``time`` [num_envs] s, to which they have caught up."""
        return positions(self.flights.view(FLOWN_STATE, self.num_envs, -1), self._since(time))

    def motion(self, envs: Tensor, place: Tensor, time: Tensor) -> tuple[Vec3, Vec3]:
        """Return positions, [n, k] m, and velocities, m/s, of some objects in N; for arguments, see :meth:`states`."""
        flights, now = self.flights[:, envs.unsqueeze(-1) * self.count + place], self._since(time)[envs]
        return Vec3(*positions(flights, now)), Vec3(*velocities(flights, now))

    def states(self, envs: Tensor, place: Tensor, time: Tensor, ago: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return positions, m, and velocities, m/s, of some objects in N, and their positions before, [n, k, 3] each.

        Args:
            envs: Episodes of n satellites, [n].
            place: Numbers of objects, [n, k].
            time: Times, [num_envs] s, to which the objects have caught up.
            ago: Earlier times, [num_envs] s, by a tick.
        """
        flights = self.flights[:, envs.unsqueeze(-1) * self.count + place]
        now, before = (self._since(moment)[envs] for moment in (time, ago))
        r_N, v_N, before_N = positions(flights, now), velocities(flights, now), positions(flights, before)
        return r_N.movedim(0, -1), v_N.movedim(0, -1), before_N.movedim(0, -1)

    def nodes(self, envs: Tensor, place: Tensor, until: Tensor) -> Samples:
        """Return the nodes of n objects, a minute apart, from before the step at which they are to behind ``until`` [n] s.

        The objects are those of numbers ``place`` [n] in the episodes ``envs`` [n].
        """
        rows = envs * self.count + place
        flights, step = self.flights[:, rows], self.steps[rows]
        odd = step % 2
        first = step - odd - 2 * (PAST_NODES - 1)
        back = first - step + 2 * torch.arange(PAST_NODES, device=self.device).unsqueeze(-1)
        past = [positions(flights, since.double()).mT for since in back]
        most = int(((until + REACH_AROUND) * (1.0 / MULTISTEP_STEP)).ceil().long().sub(step).max().clamp(min=6)) + 2
        around = _around(self.epoch(envs), step, most)
        ahead = self.solver.fly(flights, step, most, around)
        index = 1 - odd.unsqueeze(-1) + 2 * torch.arange(most // 2, device=self.device)
        nodes = torch.cat([torch.stack(past, 1), ahead.gather(1, index.unsqueeze(-1).expand(-1, -1, 3))], 1)
        return Samples(nodes.contiguous(), first.double() * MULTISTEP_STEP)


def _around(et: Tensor, step: Tensor, count: int) -> Samples:
    """Return the records of Sun and Earth around ``count`` steps from ``step`` [n] on, for epochs ET [n] s."""
    start = torch.floor(step.double() * (MULTISTEP_STEP / RECORD_SPACING)) * RECORD_SPACING
    return Samples(_records(et, start, count), start)


def _records(et: Tensor, start: Tensor, count: int) -> Tensor:
    hours = 3 + int(count * MULTISTEP_STEP / RECORD_SPACING)
    return ephemeris_records(et, hours, start)
