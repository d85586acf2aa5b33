"""Record episodes of several satellites on Basilisk, driven through bsk_rl, as numpy files that the parity tests replay.

Usage::

    python scripts/recorders/record_constellation.py                        # every file, into tests/basilisk/recordings
    python scripts/recorders/record_constellation.py constellation_los      # only this one
    python scripts/recorders/record_constellation.py --list

See ``recording.py`` for what it needs. Initial conditions and targets are drawn here, passed explicitly and stored; so are the
actions. Targets lie along the tracks of the satellites, so that satellites compete for them.

What bsk_rl 1.3.8 does, and the recordings therefore avoid:

* ``LOSCommunication`` counts a link twice, and lets everybody talk where half of all ordered pairs see each other: such a step
  raises RuntimeError here.
* A query that finds no target at all raises RuntimeError; episodes leave some unimaged.
* The search for the highest point of a pass loses some on eccentric orbits: orbits are circular.
* A satellite class keeps the models of its parent once they have been composed: every episode makes its own class.
* Rewarders ask every satellite for its store: where some have none, a ``MixedReward`` asks the others only.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from bsk_rl import NO_ACTION, ConstellationTasking, GeneralSatelliteTasking, act, comm, data, obs, sats, scene
from bsk_rl.scene.targets import Target
from bsk_rl.sim import dyn, fsw
from bsk_rl.utils.orbital import TrajectorySimulator
from constellation_variants import STATION, TARGET, VARIANTS, Kind, Member, Variant
from imaging_variants import EARTH_RADIUS, FIXED, IMAGE, ORBIT_PERIOD
from numpy.typing import NDArray
from record_imaging import RESOLUTION, columns, entries
from recording import COLUMNS, NUDGE, Array, orbit_state, random_utc, record_files, streams, versions

Rows = dict[str, Any]

SEMI_MAJOR_AXIS = 6871.0  # [km]
STORAGE = 5000 * 8e6  # [bit] of a scanning satellite
NONE = -1  # action of a satellite that is given none


class BroadcastLOSMulti(comm.BroadcastCommunication, comm.LOSMultiCommunication):
    """Who broadcasts is heard by everyone that relays can reach."""


class ImagerDyn(dyn.GroundStationDynModel, dyn.LOSCommDynModel):
    """Images, downlinks and sees other satellites."""


class RelayDyn(dyn.BasicDynamicsModel, dyn.LOSCommDynModel):
    """Sees other satellites; has no instrument and no store."""


class ScannerDyn(dyn.ContinuousImagingDynModel, dyn.GroundStationDynModel):
    """Scans and downlinks."""


def satellite_class(kind: Kind) -> type[sats.Satellite]:
    """A new satellite class, because bsk_rl caches what it composes on the class."""
    base, dynamics, software = {
        "imager": (sats.ImagingSatellite, ImagerDyn, fsw.ImagingFSWModel),
        "relay": (sats.Satellite, RelayDyn, fsw.BasicFSWModel),
        "scanner": (sats.AccessSatellite, ScannerDyn, fsw.ContinuousImagingFSWModel),
    }[kind.role]
    observations: list[Any] = [obs.SatProperties(*entries(kind.satellite))]
    for name, properties, count in (("target", TARGET, kind.targets), ("ground_station", STATION, kind.stations)):
        if count:
            observations.append(obs.OpportunityProperties(*entries(properties), type=name, n_ahead_observe=count))
    observations += [obs.Eclipse(norm=ORBIT_PERIOD)] if kind.eclipse else []
    actions = [getattr(act, name)(duration=duration) for name, duration in kind.modes]
    actions += [act.Image(n_ahead_image=kind.images, max_duration=kind.max_duration)] if kind.images else []
    actions += [act.Broadcast(duration=kind.broadcast)] if kind.broadcast else []
    attributes = {"observation_spec": [*observations, obs.Time()], "action_spec": actions}
    return type(kind.role.title(), (base,), {**attributes, "dyn_type": dynamics, "fsw_type": software})


def common_arguments(kind: Kind) -> dict[str, Any]:
    """Arguments that all satellites of a kind share."""
    power = {
        name: FIXED[name] for name in ("batteryStorageCapacity", "basePowerDraw", "thrusterPowerDraw", "u_max", "maxWheelSpeed")
    }
    scanning = {
        "imageAttErrorRequirement": 0.1,
        "imageRateErrorRequirement": 0.1,
        "dataStorageCapacity": STORAGE,
        "instrumentBaudRate": IMAGE,
        "transmitterBaudRate": -50 * 8e6,
    }
    return {"imager": FIXED, "relay": power, "scanner": power | scanning}[kind.role]


def arguments(variant: Variant) -> list[dict[str, Any]]:
    """Arguments of each satellite that do not differ from episode to episode."""
    return [{**common_arguments(variant.kinds[member.kind]), **member.fixed} for member in variant.fleet]


def draw_satellite(rng: np.random.Generator, variant: Variant, member: Member, angles: Array) -> dict[str, Any]:
    """What a satellite starts with, on an orbit with the ``angles`` of the first satellite's."""
    kind, capacity = variant.kinds[member.kind], {**FIXED, **member.fixed}["batteryStorageCapacity"]
    offset = np.radians([0.0, member.node, 0.0, member.phase])
    initial = {
        **orbit_state(SEMI_MAJOR_AXIS, 0.0, angles + offset),
        "sigma_init": rng.uniform(0.0, 1.0, 3).tolist(),
        "omega_init": rng.uniform(-1e-3, 1e-3, 3).tolist(),
        "wheelSpeeds": rng.uniform(-1500.0, 1500.0, 3).tolist(),
        "disturbance_vector": rng.normal(scale=1e-4, size=3).tolist(),
        "storedCharge_Init": float(rng.uniform(0.6, 1.0) * capacity),
    }
    full = {"imager": 0.0, "scanner": float(np.floor(rng.uniform(0.0, 0.8) * STORAGE))}
    return initial | ({"storageInit": full[kind.role]} if kind.role in full else {})


def draw_targets(rng: np.random.Generator, variant: Variant, initial: dict[str, Any]) -> Array:
    """Positions [m] and priorities of targets near the tracks of all satellites, [T, 4]."""
    epoch, last, tracks = initial["utc_init"], initial["time_limit"] + variant.beyond, []
    for satellite in initial["satellites"]:
        trajectory = TrajectorySimulator(epoch, rN=satellite["rN"], vN=satellite["vN"])
        trajectory.extend_to(last + 60.0)
        tracks.append(trajectory.r_BP_P)
    below = np.array([tracks[k % len(tracks)](rng.uniform(0.0, last)) for k in range(variant.targets)])
    r_LP_P = EARTH_RADIUS * below / np.linalg.norm(below, axis=1, keepdims=True) + rng.normal(
        scale=variant.width, size=below.shape
    )
    r_LP_P *= EARTH_RADIUS / np.linalg.norm(r_LP_P, axis=1, keepdims=True)
    return np.column_stack([r_LP_P, rng.uniform(size=variant.targets)])


def draw_initial(rng: np.random.Generator, variant: Variant, position: int) -> tuple[dict[str, Any], Array]:
    """Everything that differs from episode to episode, JSON-ready, and the targets [T, 4]."""
    angles = np.append(np.radians(variant.inclination), rng.uniform(0.0, 2 * np.pi, 3))
    initial = {
        "utc_init": random_utc(rng),
        "time_limit": variant.limits[position],
        "satellites": [draw_satellite(rng, variant, member, angles) for member in variant.fleet],
    }
    return initial, draw_targets(rng, variant, initial) if variant.targets else np.zeros((0, 4))


class TargetTable(scene.UniformTargets):
    """The targets of a table [T, 4], named by their number."""

    def __init__(self, table: Array) -> None:
        """See ``draw_targets``."""
        super().__init__(len(table))
        self.table = table

    def regenerate_targets(self) -> None:
        """Called by bsk_rl at reset."""
        self.targets = [Target(str(number), row[:3], float(row[3])) for number, row in enumerate(self.table)]


def make_rewarder(variant: Variant) -> data.GlobalReward:
    """Unique images by those who take any, or time spent scanning."""
    if not variant.targets:
        return data.ScanningTimeReward()
    imagers = [member.name for member in variant.fleet if variant.kinds[member.kind].role == "imager"]
    if len(imagers) == len(variant.fleet):
        return data.UniqueImageReward()
    return data.MixedReward({"images": data.UniqueImageReward()}, {"images": imagers})


def make_env(variant: Variant, initial: dict[str, Any], targets: Array) -> GeneralSatelliteTasking:
    """The environment, with every initial condition pinned; ValueError where an argument is left to chance."""
    classes = {name: satellite_class(kind) for name, kind in variant.kinds.items()}
    satellites = [
        classes[member.kind](member.name, sat_args={**fixed, **own, "oe": None}, **member.options)
        for member, fixed, own in zip(variant.fleet, arguments(variant), initial["satellites"], strict=True)
    ]
    for satellite in satellites:
        if drawn := [name for name, value in satellite.sat_args_generator.items() if callable(value)]:
            raise ValueError(f"{satellite.name} draws {drawn} at reset; pin them")
    kind, options = variant.communicator
    communicator = BroadcastLOSMulti if kind == "BroadcastLOSMulti" else getattr(comm, kind)
    groups = {} if variant.joint else {"meta_agent_groupings": {name: list(team) for name, team in variant.agents.items()}}
    groups |= {"only_retask_idle_meta_agent_members": True} if variant.idle_only else {}
    return (GeneralSatelliteTasking if variant.joint else ConstellationTasking)(
        satellites=satellites,
        scenario=TargetTable(targets) if variant.targets else scene.UniformNadirScanning(value_per_second=1 / ORBIT_PERIOD),
        rewarder=make_rewarder(variant),
        communicator=communicator(**options),
        time_limit=initial["time_limit"],
        world_args={"utc_init": initial["utc_init"]},
        log_level="CRITICAL",
        **groups,
        **variant.env,
    )


class Ears:
    """Listens to a communicator: who saw whom in a step, and who talked to whom at its end.

    Attributes:
        access: Whether satellite i's module saw satellite j in any tick of the step, [S, S].
        links: Whether i was heard by j, [S, S].
        evaluated: Whether the communicator was asked at all.
    """

    def __init__(self, communicator: comm.CommunicationMethod) -> None:
        """Put ears on a ``communicator``."""
        self.communicator, self.satellites = communicator, list(communicator.satellites)
        self.pairs, self.exchange = communicator.communication_pairs, communicator.communicate
        communicator.communication_pairs, communicator.communicate = self.listen, self.watch

    def matrix(self, pairs: Sequence[tuple[sats.Satellite, sats.Satellite]]) -> NDArray[np.bool_]:
        """Pairs as a matrix."""
        found = np.zeros((len(self.satellites),) * 2, dtype=bool)
        for sender, receiver in pairs:
            found[self.satellites.index(sender), self.satellites.index(receiver)] = True
        return found

    def listen(self) -> list[tuple[sats.Satellite, sats.Satellite]]:
        """In place of ``communication_pairs``; RuntimeError where bsk_rl takes some pairs for all."""
        pairs = self.pairs()
        self.links, self.evaluated = self.matrix(pairs), True
        whole = self.links.size - len(self.satellites)
        if len(pairs) == whole > self.links.sum():
            raise RuntimeError("half of all pairs see each other, and bsk_rl would let everybody talk")
        return pairs

    def watch(self) -> None:
        """In place of ``communicate``."""
        logs = getattr(self.communicator, "los_logs", {})
        self.access = self.matrix([(one, two) for one, rest in logs.items() for two, log in rest.items() if any(log.hasAccess)])
        self.links, self.evaluated = self.matrix([]), False
        self.exchange()

    def row(self) -> Rows:
        """What was heard in the last step."""
        return {"access": self.access, "links": self.links, "evaluated": self.evaluated}


class Table:
    """One interface to both environments of bsk_rl: outputs by agent, rows by satellite."""

    def __init__(self, variant: Variant, initial: dict[str, Any], targets: Array) -> None:
        """Build the environment."""
        self.env, self.variant, self.count = make_env(variant, initial, targets), variant, len(targets)
        self.ears, self.over = Ears(self.env.communicator), False
        self.satellites, self.groups = {satellite.name: satellite for satellite in self.env.satellites}, variant.groups

    def reset(self) -> Rows:
        """Start the episode; the first row of decisions."""
        observation, _ = self.env.reset(seed=self.variant.seed)
        self.width = max(satellite.observation_space.shape[0] for satellite in self.env.satellites)
        return self.boundary(observation)

    @property
    def active(self) -> list[str]:
        """Agents that may still act."""
        if self.variant.joint:
            return [] if self.over else list(self.groups)
        return list(self.env.agents)

    def step(self, actions: dict[str, int]) -> tuple[Rows, Rows]:
        """Task the satellites named; rows of the step and of the decision after it."""
        before = self.env.simulator.sim_time
        tasks = {name: actions.get(name, NO_ACTION) for name in self.satellites}
        if self.variant.joint:
            observation, *results, _ = self.env.step(tuple(tasks.values()))
            reward, terminated, truncated = ({"everyone": result} for result in results)
            self.over = results[1] or results[2]
        else:
            commanded = [agent for agent, team in self.groups.items() if any(name in actions for name in team)]
            given = {agent: self.command(self.groups[agent], tasks) for agent in commanded}
            observation, reward, terminated, truncated, _ = self.env.step(given)
        present = [agent in reward for agent in self.groups]
        row = {
            "action": [actions.get(name, NONE) for name in self.satellites],
            "duration": self.env.simulator.sim_time - before,
            "present": present,
            "reward": [reward.get(agent, 0.0) for agent in self.groups],
            "terminated": [bool(terminated.get(agent, False)) for agent in self.groups],
            "truncated": [bool(truncated.get(agent, False)) for agent in self.groups],
            "paid": [self.env.reward_dict[name] for name in self.satellites],
            "image": [self.image(satellite) for satellite in self.satellites.values()],
            **self.ears.row(),
        }
        return row, self.boundary(observation)

    @staticmethod
    def command(team: list[str], tasks: dict[str, int]) -> Any:
        """The action of an agent."""
        return tasks[team[0]] if len(team) == 1 else np.array([tasks[name] for name in team])

    def image(self, satellite: sats.Satellite) -> int:
        """Number of the target that a satellite imaged in the last step, or -1."""
        fresh = self.imaged(satellite.data_store.new_data)
        return int(np.flatnonzero(fresh)[0]) if fresh.any() else -1

    def channel(self, unit: data.Data) -> Any:
        """What is known about images, or None."""
        return unit.data.get("images") if isinstance(unit, data.MixedData) else unit

    def imaged(self, unit: data.Data) -> NDArray[np.bool_]:
        """Targets in a unit of data, [T]."""
        return self.numbers(getattr(self.channel(unit), "imaged", ()))

    def numbers(self, targets: Any) -> NDArray[np.bool_]:
        """A set of targets as booleans, [T]."""
        found = np.zeros(self.count, dtype=bool)
        found[[int(target.name) for target in targets]] = True
        return found

    def boundary(self, observation: Any) -> Rows:
        """The row of a decision."""
        satellites = self.satellites.values()
        seen, observed = self.by_satellite(observation)
        return {
            "obs": seen,
            "observed": observed,
            "state": np.stack([self.state(satellite) for satellite in satellites]),
            "requires_retasking": [bool(satellite.requires_retasking) for satellite in satellites],
            "alive": [satellite.is_alive() for satellite in satellites],
            "active": [agent in self.active for agent in self.groups],
            "knows": np.stack([self.imaged(satellite.data_store.data) for satellite in satellites]),
            "known": np.stack(
                [self.numbers(getattr(self.channel(satellite.data_store.data), "known", ())) for satellite in satellites]
            ),
            "everyone": self.imaged(self.env.rewarder.data),
            "duplicates": getattr(self.channel(self.env.rewarder.data), "duplicates", 0),
            "imaged": [getattr(satellite, "imaged", 0) for satellite in satellites],
        }

    def by_satellite(self, observation: Any) -> tuple[Array, NDArray[np.bool_]]:
        """Observations [S, O], padded with zeros, and who got one."""
        parts = {"everyone": np.concatenate(observation)} if self.variant.joint else observation
        rows, observed = np.zeros((len(self.satellites), self.width)), np.zeros(len(self.satellites), dtype=bool)
        names = list(self.satellites)
        for agent, whole in parts.items():
            team = self.groups[agent]
            ends = np.cumsum([self.satellites[name].observation_space.shape[0] for name in team])
            for name, part in zip(team, np.split(whole, ends[:-1]), strict=True):
                rows[names.index(name), : len(part)], observed[names.index(name)] = part, True
        return rows, observed

    def state(self, satellite: sats.Satellite) -> Array:
        """The row of ``COLUMNS`` and the images' partition, zero for what a satellite lacks."""
        simulator, dynamics = self.env.simulator, satellite.dynamics
        lit = simulator.world.eclipseObject.eclipseOutMsgs[dynamics.eclipse_index].read().shadowFactor
        imager = isinstance(satellite, sats.ImagingSatellite)
        buffer = dynamics.storageUnit.storageUnitDataOutMsg.read().storedData[0] if imager else 0.0
        return np.concatenate(
            [
                [simulator.sim_time],
                *(dynamics.r_BN_N, dynamics.v_BN_N, dynamics.sigma_BN, dynamics.omega_BN_B, dynamics.wheel_speeds),
                [dynamics.battery_charge, getattr(dynamics, "storage_level", 0.0), lit, buffer],
            ]
        )


def choose(variant: Variant, table: Table, last: dict[str, int], rng: np.random.Generator) -> dict[str, int]:
    """Actions of the satellites that get one; ``last`` remembers them."""
    kinds = {member.name: variant.kinds[member.kind].probabilities for member in variant.fleet}
    waits = {member.name: member.waits > table.env.simulator.sim_time for member in variant.fleet}
    actions = {}
    for agent in table.active:
        team = table.groups[agent]
        asked = any(table.satellites[name].requires_retasking for name in team)
        for name in team:
            # agents of several satellites command all of them, whoever asks
            idle = asked if len(team) > 1 and not variant.joint else table.satellites[name].requires_retasking
            luck, again, drawn = rng.random(), rng.random(), int(rng.choice(len(kinds[name]), p=kinds[name]))
            if not waits[name] and (luck >= variant.skip if idle else luck < variant.retask):
                actions[name] = last[name] = last[name] if name in last and again < variant.repeat else drawn
    return actions


@dataclass
class Flight:
    """An episode: rows at decisions, the last one after the end, and rows of steps, one fewer."""

    boundary: dict[str, NDArray[Any]]
    step: dict[str, NDArray[Any]]

    def summary(self) -> str:
        """What happened, for the log."""
        step, boundary = self.step, self.boundary
        tasked, idle = step["action"] >= 0, boundary["requires_retasking"][:-1] & boundary["alive"][:-1]
        links = step["links"].sum((1, 2))
        counts = {
            "steps": len(tasked),
            "images": (step["image"] >= 0).sum(),
            "unpaid": ((step["image"] >= 0) & (step["paid"] == 0.0)).sum(),
            "shared": sum(len(set(row[row >= 0])) < (row >= 0).sum() for row in step["image"]),
            "idle without task": (idle & ~tasked).sum(),
            "busy retasked": (~idle & tasked).sum(),
            "asked together": (boundary["requires_retasking"].sum(1) > 1).sum(),
            "dead": (~boundary["alive"][-1]).sum(),
        }
        spread = f"links {links.min()} to {links.max()}, {(np.diff(links) != 0).sum()} changes"
        knowledge = "knows " + "/".join(map(str, boundary["knows"][-1].sum(1))) + f" of {boundary['everyone'][-1].sum()}"
        return (
            ", ".join(f"{v} {k}" for k, v in counts.items()) + f", {spread}, {knowledge}, end {boundary['state'][-1, 0, 0]:.1f} s"
        )


def fly(variant: Variant, initial: dict[str, Any], targets: Array, rng: np.random.Generator) -> Flight:
    """An episode, to its end."""
    table = Table(variant, initial, targets)
    boundaries, steps, last = [table.reset()], [], {}
    while table.active:
        step, boundary = table.step(choose(variant, table, last, rng))
        steps.append(step)
        boundaries.append(boundary)
    table.env.close()
    return Flight(columns(boundaries), columns(steps))


def nudge(initial: dict[str, Any]) -> dict[str, Any]:
    """The same start but for ``NUDGE`` in an attitude of every satellite."""
    nudged = [{**own, "sigma_init": [own["sigma_init"][0] + NUDGE, *own["sigma_init"][1:]]} for own in initial["satellites"]]
    return {**initial, "satellites": nudged}


def record_episode(variant: Variant, position: int) -> tuple[dict[str, Any], Array, Flight, Array]:
    """Initial conditions, targets, flight and sensitivity of the episode at a ``position`` of the file."""
    number = variant.episodes[position]
    initial, targets = draw_initial(streams(variant.seed, number)[0], variant, position)

    def play(start: dict[str, Any]) -> Flight:
        return fly(variant, start, targets, streams(variant.seed, number)[1])

    flight, twin = play(initial), play(nudge(initial))
    rows = min(len(twin.step["action"]), len(flight.step["action"])) + 1
    change = np.abs(twin.boundary["state"][:rows] - flight.boundary["state"][:rows]).max((0, 1))
    return initial, targets, flight, change


def describe(variant: Variant) -> dict[str, str]:
    """JSON entries that make a file readable on its own."""
    environment = {
        "options": variant.env,
        "communicator": variant.communicator,
        "groups": variant.groups,
        "idle_only": variant.idle_only,
        "joint": variant.joint,
        "satellites": [{"name": member.name, "kind": member.kind, "options": member.options} for member in variant.fleet],
        "kinds": {name: asdict(kind) for name, kind in variant.kinds.items()},
        "properties": {"target": TARGET, "ground_station": STATION},
        "eclipse_norm": ORBIT_PERIOD,
        "value_per_second": 1 / ORBIT_PERIOD,
    }
    described = {"fixed": arguments(variant), "env": environment, "columns": [*COLUMNS, "buffer"], "versions": versions()}
    return {name: json.dumps(value) for name, value in described.items()}


def record_episodes(name: str) -> dict[str, Any]:
    """Decision-boundary episodes of one variant."""
    variant, episodes = VARIANTS[name], []
    for position, number in enumerate(variant.episodes):
        episodes.append(record_episode(variant, position))
        *_, flight, change = episodes[-1]
        print(f"  {name}[{number}] {flight.summary()}, sigma sensitivity {change[7:10].max():.0e}", flush=True)
    initials, targets, flights, changes = zip(*episodes, strict=True)
    arrays = {
        "ic": json.dumps(initials),
        "length": np.array([len(flight.step["action"]) for flight in flights]),
        "targets": np.stack(targets),
        "sensitivity": np.stack(changes),
        **{key: np.concatenate([flight.boundary[key] for flight in flights]) for key in flights[0].boundary},
        **{key: np.concatenate([flight.step[key] for flight in flights]) for key in flights[0].step},
        **describe(variant),
    }
    arrays["obs"] = np.rint(arrays["obs"] / RESOLUTION) * RESOLUTION
    return arrays


RECORDERS: dict[str, Callable[[str], dict[str, Any]]] = dict.fromkeys(VARIANTS, record_episodes)


if __name__ == "__main__":
    record_files(RECORDERS)
