"""The simulation under an episode: satellites of the core with the values that the episode has drawn."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from bsk_torch._checks import number
from bsk_torch.act.base import Action as CoreAction
from bsk_torch.astro.atmosphere import top_radius
from bsk_torch.astro.orbit import periapsis_radius
from bsk_torch.bsk_rl.sim.commands import arranged
from bsk_torch.bsk_rl.sim.models import core_world
from bsk_torch.bsk_rl.sim.setup import changed_arguments
from bsk_torch.bsk_rl.sim.trajectory import initial_state
from bsk_torch.codegen.ir import UntraceableError
from bsk_torch.constants import MU_EARTH
from bsk_torch.data.base import NoReward
from bsk_torch.env.assembly.fleets import FleetBuilder
from bsk_torch.env.options import TaskingOptions
from bsk_torch.rand import first_key
from bsk_torch.sats.bound import BoundSatellite, SatelliteFleet
from bsk_torch.sats.satellite import Satellite as CoreSatellite
from bsk_torch.scene.base import Scenario as CoreScenario
from bsk_torch.sim.arguments.table import ArgumentTable
from bsk_torch.sim.arguments.values import is_fixed
from bsk_torch.sim.assembly.composition import compose
from bsk_torch.sim.assembly.initial_orbits import HIGHEST_APOAPSIS, LOWEST_PERIAPSIS
from bsk_torch.sim.component import MissingMessageError, UserArguments
from bsk_torch.sim.dyn.models import DynamicsModel
from bsk_torch.sim.fsw.models import FSWModel, MagicOrbitalManeuverFSWModel
from bsk_torch.sim.fsw.setpoint import AttitudeSetpointFSWModel, InertialHoldFSWModel
from bsk_torch.sim.readout.observables import Now, ObserverProgram
from bsk_torch.sim.satellite_state import SatelliteState
from bsk_torch.sim.world import WorldModel
from bsk_torch.vec3 import Mat3, Vec3

if TYPE_CHECKING:
    from bsk_torch.bsk_rl.sats.satellite import Satellite

BUILT_FOR = ("transmitterNumBuffers", "storageInit")
"""Arguments for which partitions are built, in addition to those that are the same for all environments of the core."""

WORLD_ONLY = ("utc_init",)
"""Arguments that bsk_rl repeats among those of satellites."""


def PN(now: Now) -> Mat3:
    """DCM from N to the Earth-fixed frame."""
    return now.PN


def omega_PN_N(now: Now) -> Vec3:
    """Rate of the Earth-fixed frame, rad/s in N."""
    return now.omega_PN_N


def r_SN_N(now: Now) -> Vec3:
    """Sun relative to the Earth, m in N."""
    return now.r_SN_N


SKY = {function.__name__: function for function in (PN, omega_PN_N, r_SN_N)}
"""Properties of the world that the kernel of observables computes."""


def described_type(dyn_type: type[DynamicsModel], fsw_type: type[FSWModel], holds: bool) -> type[CoreSatellite]:
    """Return the core's satellite class for two models; with ``holds`` its flight software follows set-points, too."""
    added = [AttitudeSetpointFSWModel] if holds else []
    if issubclass(fsw_type, MagicOrbitalManeuverFSWModel):
        added.append(InertialHoldFSWModel)  # type: ignore[arg-type]
    if (own := arranged(dyn_type, fsw_type)) is not None:
        added.append(own)  # type: ignore[arg-type]
    return _described(dyn_type, compose((fsw_type, *added), FSWModel) if added else fsw_type)  # type: ignore[arg-type]  # mypy: as above


@functools.cache
def _described(dyn_type: type[DynamicsModel], fsw_type: type[FSWModel]) -> type[CoreSatellite]:
    body = {"dyn_type": dyn_type, "fsw_type": fsw_type, "action_spec": (CoreAction("anything"),)}  # the user's may do anything
    return type("Described", (CoreSatellite,), body)


class Engine:
    """Builds the simulation of an environment's episodes, and starts each of them.

    What has been built is used again as long as the next episode has the same structure: the same models, the same arguments
    that are None, the same stations. ``fleet`` is the simulation of the episode, and ``world`` the arguments of its world.
    """

    fleet: SatelliteFleet

    def __init__(self, backend: str = "compiled", orbit: str | None = None) -> None:
        """Build with a back end; ``orbit`` is ``"arc"``, ``"integrated"``, or None for what each episode needs."""
        self.backend, self.orbit = backend, orbit
        self._key: object = None
        self._values: list[dict[str, object]] = []
        self.world: dict[str, object] = {}
        self._limit = float("inf")

    def begin(
        self,
        satellites: Sequence[Satellite],
        world_type: type[WorldModel],
        world_args: dict[str, object],
        sim_rate: float,
        time_limit: float,
    ) -> SatelliteFleet:
        """Start an episode with the drawn arguments of satellites and world; return its simulation."""
        self._values = [_own_values(satellite) for satellite in satellites]
        self.world, self._limit = world_args | changed_arguments(world_type, world_args), float(time_limit)
        world_type = core_world(world_type)  # type: ignore[arg-type]  # mypy: a class is not Hashable
        types = [described_type(s.dyn_type, s.fsw_type, s.holds_attitudes) for s in satellites]
        orbit = self.orbit or _needed_orbit(self._values, self.world)
        key = self._structure(satellites, types, world_type, sim_rate, orbit)
        if key != self._key:
            self._key = None
            self._build(satellites, types, world_type, sim_rate, orbit)
            self._key = key
        fleet = self.fleet
        self._builder.draw_and_start(fleet, fleet.all_envs, first_key(1))
        for begin in fleet.beginnings:
            begin(fleet.all_envs)
        fleet.since = fleet.ticks
        return fleet

    def _structure(
        self, satellites: Sequence[Satellite], types: Sequence[type[CoreSatellite]], world_type: type[WorldModel], *others: object
    ) -> object:
        """Return what decides whether a simulation that has been built can be used again."""
        each = [
            (s.name, t, s.variable_interval, _fixed(t.default_sat_args(), values))
            for s, t, values in zip(satellites, types, self._values, strict=True)
        ]
        return repr(
            [(name, id(t), interval, sorted(table_arguments.items(), key=str)) for name, t, interval, table_arguments in each]
        ), repr((sorted(_fixed(world_type.default_world_args(), self.world).items(), key=str), world_type, *others))

    def _build(
        self,
        satellites: Sequence[Satellite],
        types: Sequence[type[CoreSatellite]],
        world_type: type[WorldModel],
        sim_rate: float,
        orbit: str | None,
    ) -> None:
        described = [
            made(s.name, self._sources(made.default_sat_args(), k), variable_interval=bool(s.variable_interval))
            for k, (s, made) in enumerate(zip(satellites, types, strict=True))
        ]
        options = TaskingOptions(
            num_envs=1,
            world_type=world_type,
            world_args=self._sources(world_type.default_world_args(), None),
            sim_rate=sim_rate,
            time_limit=lambda: self._limit,
            orbit=orbit,
            backend=self.backend,
            compat="bsk_rl",
        )
        self._builder = FleetBuilder(described, CoreScenario(), NoReward(), options, None, torch.device("cpu"))
        self.fleet = fleet = self._builder.make_fleet(1)
        parts = enumerate(fleet.simulators)
        fleet.satellites = tuple(BoundSatellite.of(self._builder.satellites[s.columns[0]], fleet, k) for k, s in parts)
        for part in fleet.satellites:
            models = (type(part.dynamics), type(part.fsw))
            functions = [
                function for model in models for each in (model.observables(), model.vitals()) for function in each.values()
            ]
            simulator = part.simulator
            simulator.observer.want(function for function in (*functions, *SKY.values()) if _exists(simulator.state, function))

    def _sources(self, table: ArgumentTable, k: int | None) -> dict[str, object]:
        """Return arguments by name: those that determine the structure unchanged, others as functions of the episode."""
        values = self.world if k is None else self._values[k]
        arguments = _fixed(table, values)
        return {name: arguments[name] if name in arguments else self._reader(k, name) for name in table.rows if name in values}

    def _reader(self, k: int | None, name: str) -> Callable[[], object]:
        return lambda: (self.world if k is None else self._values[k])[name]


def _exists(state: SatelliteState, function: Callable[[Now], object]) -> bool:
    """Return whether satellites have what an observable follows from."""
    try:
        ObserverProgram(state, [function])
    except (MissingMessageError, UntraceableError):
        return False
    return True


def _own_values(satellite: Satellite) -> dict[str, object]:
    """Return the arguments of a satellite as the core takes them: with the state at time zero in place of elements."""
    args = satellite.sat_args
    for model in (satellite.dyn_type, satellite.fsw_type):
        args = args | changed_arguments(model, args, satellite)
    satellite.model_args = args
    values = {name: value for name, value in args.items() if name not in WORLD_ONLY}
    values["rN"], values["vN"] = initial_state(values["rN"], values["vN"], values["oe"], values["mu"])
    values["oe"] = None
    if "storageInit" in values and not 0 <= values["storageInit"] <= values["dataStorageCapacity"]:
        satellite.logger.warning(
            "storageInit=%s is outside of [0, %s]; it is set to 0", values["storageInit"], values["dataStorageCapacity"]
        )
        values["storageInit"] = 0
    if "storedCharge_Init" in values:  # what the battery does in its first tick
        charge = (
            number(f"sat_args: {name}", values[name], unit="W s") for name in ("storedCharge_Init", "batteryStorageCapacity")
        )
        values["storedCharge_Init"] = min(charge)
    return values


def _fixed(table: ArgumentTable, values: Mapping[str, object]) -> dict[str, object]:
    """Return the arguments that decide the structure of a simulation."""
    rows = ((name, arg) for name, arg in table.rows.items() if name in values)
    return {name: values[name] for name, arg in rows if values[name] is None or is_fixed(arg) or name in BUILT_FOR}


# -- orbits ----------------------------------------------------------------------------------------------------------------------


def is_orbit(r: Vec3, v: Vec3) -> bool:
    """Return whether a position, m, and a velocity, m/s, are an orbit that can be solved in advance: near the Earth, above it."""
    inverse = float(2.0 / r.norm() - v.dot(v) / MU_EARTH)
    if inverse <= 0.0 or float(r.cross(v).norm()) == 0.0:
        return False
    periapsis = float(periapsis_radius(r, v))
    return periapsis >= LOWEST_PERIAPSIS and 2.0 / inverse - periapsis <= HIGHEST_APOAPSIS


def _needed_orbit(values: Sequence[UserArguments], world: UserArguments) -> str | None:
    """Return how orbits must be computed: freely where one is none, in every tick where one meets the atmosphere."""
    drag = {"planetRadius", "baseDensity", "scaleHeight"} <= world.keys()
    top = top_radius(*(float(world[name]) for name in ("planetRadius", "baseDensity", "scaleHeight"))) if drag else 0.0
    needed = None
    for satellite_values in values:
        r, v = (Vec3.of(torch.from_numpy(np.asarray(satellite_values[name], dtype=float))) for name in ("rN", "vN"))
        if not is_orbit(r, v):
            return "free"
        if float(periapsis_radius(r, v)) < top:
            needed = "integrated"
    return needed


def row_mask(fleet: SatelliteFleet, part: int, row: int) -> Tensor:
    """Return a mask of the rows of one type that holds for one of them."""
    mask = torch.zeros(fleet.simulators[part].state.rows, dtype=torch.bool)
    mask[row] = True
    return mask
