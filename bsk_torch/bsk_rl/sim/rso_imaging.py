"""Imagers that point at other satellites of the episode: orbits of these for the ticks, and the gate before the instrument."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import torch

from bsk_torch.bsk_rl.sim.engine import row_mask
from bsk_torch.bsk_rl.utils.rso_imaging import RSOImageRecord
from bsk_torch.constants import NANO
from bsk_torch.sats.bound import SatelliteFleet
from bsk_torch.sim.assembly.satellite_type import whole_nanoseconds
from bsk_torch.sim.orbit.flights import make_flights
from bsk_torch.tasks.objects.aim import AIM, NO_AIM, AimedNodes
from bsk_torch.tasks.objects.dyn import GATE_FIELDS, RSO_TRACK
from bsk_torch.tasks.objects.orbits import CatalogOrbits

if TYPE_CHECKING:
    from bsk_torch.bsk_rl.sats.satellite import Satellite
    from bsk_torch.bsk_rl.scene.rso_targets import EpisodeTarget


LONGEST = 1e9
"""Longest time until a deadline, s."""


class Aims:
    """Supplies the orbits of satellites at which others point; ticks know no states of other satellites.

    The orbits are those of the initial states, without drag; see :class:`bsk_torch.tasks.objects.orbits.CatalogOrbits`.
    """

    def __init__(self, fleet: SatelliteFleet) -> None:
        self.fleet = fleet
        self._targets: list[Satellite] = []
        self._orbits: CatalogOrbits | None = None

    def add(self, target: Satellite) -> None:
        """Add a satellite as a target."""
        if target not in self._targets:
            self._targets.append(target)
            self._orbits = None

    def point(self, imager: Satellite, target: Satellite) -> None:
        """Let the instrument of an imager point at a target whenever it images."""
        if self._orbits is None:
            self._orbits = self._begin()
        self._orbits.catch_up(self.fleet.sim_time)
        part, row = imager.core_row
        memory = self.fleet.simulators[part].memory
        memory[AIM] = torch.where(row_mask(self.fleet, part, row), self._targets.index(target), memory[AIM])

    def _begin(self) -> CatalogOrbits:
        """Return the orbits of the targets, from which all imagers get what their ticks read."""
        first = self.fleet.simulators[0]
        solver = make_flights(first.h, first.type.options.backend, self.fleet.device, first.type.gravity_degree)
        states = (torch.tensor([[list(t.sat_args[name]) for t in self._targets]]).double() for name in ("rN", "vN"))
        r_N, v_N = states
        et = first.state.arguments["utc_init"][:1]
        orbits = CatalogOrbits(1, len(self._targets), solver, lambda envs: et[envs], lambda envs: (r_N[envs], v_N[envs]))
        for simulator in self.fleet.simulators:
            if "rso_armed" in simulator.tick.state.fields:
                if AIM not in simulator.memory:
                    simulator.memory.declare(AIM, NO_AIM, low=NO_AIM)
                simulator.sources[RSO_TRACK.name] = AimedNodes(simulator, orbits)
        return orbits


class Capture:
    """The gate before the instrument of an imager, and the images that it has taken; ``fsw.rso_capture``.

    Attributes:
        records: Images of the episode.
        completed: Whether the image of the current task has been taken, as of the last :meth:`check_capture`.
    """

    def __init__(self, satellite: Satellite) -> None:
        self.satellite = satellite
        self.records: list[RSOImageRecord] = []
        self.completed = False
        self._target: Any = None
        self._deadline = 0

    def _read(self, name: str) -> float:
        part, row = self.satellite.core_row
        return float(self.satellite.simulator.fleet.simulators[part].read(name)[row])

    @property
    def target(self) -> EpisodeTarget | None:
        """The target of the task; None without a task, and after its deadline has passed without an image."""
        late = self.satellite.simulator.sim_time_ns >= self._deadline and not self.check_capture()
        return None if late else self._target

    held_s = property(lambda gate: gate._read("rso_held"), doc="Time for which the conditions of the image have held, s.")
    previous_valid = property(lambda gate: gate._read("rso_valid") > 0.0, doc="Whether they held in the last tick.")

    def start(self, target: EpisodeTarget, duration: float, **task: float) -> None:
        """Begin a task, whose command has been given, with conditions in the fields of the state ``task``."""
        satellite, simulator = self.satellite, self.satellite.simulator
        self._target = target
        simulator.aims.point(satellite, target.target_spacecraft)
        names = satellite.sat_args["bufferNames"]
        if len(names) > 1:
            satellite.fsw._write("data_partition", float(names.index(satellite.dynamics.rso_partition_names[target.id])))
        self._deadline = simulator.sim_time_ns + whole_nanoseconds(min(duration, LONGEST))
        task |= {"rso_deadline": float(-(-self._deadline // simulator.tick_ns)), "rso_ends": 0.0}
        for name, value in task.items():
            satellite.fsw._write(name, value)

    def forget(self) -> None:
        """Forget the task, which another command has ended or will end."""
        self.check_capture()
        self.completed, self._target = False, None

    def cancel(self) -> None:
        """End the task: no image is taken."""
        self.forget()
        for field in GATE_FIELDS:
            self.satellite.fsw._write(field.name, 0.0)

    def check_capture(self) -> bool:
        """Add a new image to the records; return whether the image of the task has been taken."""
        number = int(self._read("rso_images"))
        if number > len(self.records):
            satellite, target = self.satellite, self._target
            time = round(self._read("rso_image_tick")) * satellite.simulator.tick_ns * NANO
            size, quality = float(satellite.sat_args["instrumentBaudRate"]), self._read("rso_image_quality")
            record_id, held = f"{satellite.name}:{number}", self._read("rso_image_held")
            self.records.append(RSOImageRecord(record_id, target.id, satellite.name, time, size, quality, held))
            self.completed = True
        return self.completed
