"""Which episodes of several satellites ``record_constellation.py`` records: their fleets, environments and policies."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from imaging_variants import EARTH_RADIUS, ORBIT_PERIOD

Properties = tuple[tuple[str, float], ...]

ATTITUDE: Properties = (("omega_BP_P", 0.03), ("c_hat_H", 1.0), ("r_BN_P", EARTH_RADIUS))
LEVELS: Properties = (("battery_charge_fraction", 1.0), ("storage_level_fraction", 1.0))
WINDOW: Properties = (("opportunity_open", 300.0), ("opportunity_close", 300.0))
TARGET: Properties = (("priority", 1.0), *WINDOW, ("target_angle", np.pi))
STATION: Properties = (("opportunity_open", ORBIT_PERIOD), ("opportunity_close", ORBIT_PERIOD))
RELAY: Properties = (("r_BN_P", EARTH_RADIUS), ("battery_charge_fraction", 1.0), ("wheel_speeds_fraction", 1.0))
SCANNER: Properties = (*LEVELS, ("wheel_speeds_fraction", 1.0), ("omega_BH_H", 0.03))


@dataclass(frozen=True)
class Kind:
    """A type of satellite; satellites of one kind share their spaces.

    Attributes:
        role: "imager", "relay" or "scanner": which models it has.
        satellite: Observed properties of the satellite, with norms.
        targets: Number of targets observed.
        stations: Number of ground stations observed.
        eclipse: Whether eclipses are observed.
        modes: Actions besides images, with durations [s].
        images: Number of targets that the action chooses from.
        max_duration: [s] Longest image action.
        broadcast: [s] Length of a broadcast, the last action; None for no such action.
        weights: Relative frequencies of the modes, of all images together, and of the broadcast.
    """

    role: str = "imager"
    satellite: Properties = (*ATTITUDE, *LEVELS)
    targets: int = 4
    stations: int = 0
    eclipse: bool = False
    modes: Properties = (("Charge", 60.0), ("Downlink", 60.0), ("Desat", 60.0))
    images: int = 4
    max_duration: float | None = 180.0
    broadcast: float | None = None
    weights: tuple[float, ...] = (0.08, 0.04, 0.04, 0.84)

    @property
    def probabilities(self) -> list[float]:
        """Of each action."""
        modes = len(self.modes)
        images = [self.weights[modes] / self.images] * self.images if self.images else []
        whole = [*self.weights[:modes], *images, *self.weights[modes + bool(self.images) :]]
        return [weight / sum(whole) for weight in whole]


@dataclass(frozen=True)
class Member:
    """One satellite of a constellation.

    Attributes:
        name: Its name.
        kind: Name of its kind.
        phase: [deg] How far it flies ahead of the first, along the orbit.
        node: [deg] How far its node lies east of the first's.
        waits: [s] Until when it is given no task.
        fixed: Fixed satellite arguments.
        options: Options of the satellite.
    """

    name: str
    kind: str = "imager"
    phase: float = 0.0
    node: float = 0.0
    waits: float = 0.0
    fixed: dict[str, Any] = field(default_factory=dict)
    options: dict[str, Any] = field(default_factory=dict)


def train(count: int, gap: float, **options: Any) -> tuple[Member, ...]:
    """Imagers that follow each other at a ``gap`` of some degrees, with ``options`` by name of the satellite."""
    return tuple(Member(f"sat{k}", phase=-gap * k, **options.get(f"sat{k}", {})) for k in range(count))


@dataclass(frozen=True)
class Variant:
    """One file of episodes: the constellation, its environment and its policy.

    Attributes:
        seed: Seed of every draw; with an episode's number it gives one stream for the start and one for the actions.
        fleet: The satellites.
        episodes: Numbers of the episodes.
        limits: [s] Time limit of each episode.
        kinds: Kinds of satellites by name.
        inclination: [deg]
        targets: Number of targets; 0 for nadir scanning.
        width: [m] Standard deviation of the targets' distance from a track.
        beyond: [s] How long after the time limit the tracks still lead over targets.
        communicator: Its class and options.
        agents: Agents that command several satellites; the others are separate agents.
        idle_only: Whether busy satellites of such agents keep their task.
        joint: Whether one agent commands all, in a ``GeneralSatelliteTasking``.
        env: Options of the environment.
        retask: Probability of giving a busy satellite a new task.
        skip: Probability of giving an idle satellite none.
        repeat: Probability of the same action again.
    """

    seed: int
    fleet: tuple[Member, ...]
    episodes: tuple[int, ...] = (0,)
    limits: tuple[float, ...] = (1800.0,)
    kinds: dict[str, Kind] = field(default_factory=lambda: {"imager": Kind()})
    inclination: float = 50.0
    targets: int = 120
    width: float = 120e3
    beyond: float = 2400.0
    communicator: tuple[str, dict[str, Any]] = ("LOSCommunication", {})
    agents: dict[str, list[str]] = field(default_factory=dict)
    idle_only: bool = False
    joint: bool = False
    env: dict[str, Any] = field(default_factory=dict)
    retask: float = 0.0
    skip: float = 0.0
    repeat: float = 0.0

    @property
    def groups(self) -> dict[str, list[str]]:
        """Names of the satellites that each agent commands."""
        names = [member.name for member in self.fleet]
        if self.joint:
            return {"everyone": names}
        together = set(itertools.chain.from_iterable(self.agents.values()))
        return self.agents | {name: [name] for name in names if name not in together}


BROADCASTER = replace(Kind(), modes=(("Charge", 60.0),), broadcast=30.0, weights=(0.1, 0.75, 0.15))
SECOND_IMAGER = Kind(
    satellite=(("c_hat_P", 1.0), ("omega_BH_H", 0.03), *LEVELS),
    targets=3,
    stations=1,
    eclipse=True,
    modes=(("Charge", 90.0), ("NadirPoint", 40.0)),
    images=2,
    max_duration=None,
    weights=(0.15, 0.1, 0.75),
)
RELAYING = Kind(
    "relay",
    satellite=RELAY,
    targets=0,
    eclipse=True,
    modes=(("Charge", 130.0), ("Drift", 75.5), ("NadirPoint", 200.0)),
    images=0,
    weights=(0.4, 0.3, 0.3),
)
SCANS = Kind(
    "scanner",
    satellite=SCANNER,
    targets=0,
    stations=1,
    eclipse=True,
    modes=(("Scan", 180.0), ("Charge", 120.0), ("Downlink", 60.0), ("Desat", 60.0)),
    images=0,
    weights=(0.4, 0.3, 0.2, 0.1),
)
OTHER_SCANS = replace(SCANS, modes=(("Scan", 100.0), ("Charge", 70.5), ("Downlink", 85.0), ("Desat", 60.0)))


def hungry(power: float) -> dict[str, Any]:
    """Arguments of a satellite that soon dies: a small battery and a base that draws ``power`` [W]."""
    return {"batteryStorageCapacity": 60 * 3600.0, "basePowerDraw": -power}


FIXED_INTERVAL = {"options": {"variable_interval": False}}

# Numbers of episodes and phases were searched for: test_constellation_parity.py lists the content of each file.
VARIANTS: dict[str, Variant] = {
    "constellation_los": Variant(
        1,
        tuple(Member(f"sat{k}", phase=phase) for k, phase in enumerate((0.0, -10.0, -56.0, -66.0, -112.0))),
        episodes=(2,),
        inclination=97.0,
        targets=200,
    ),
    "constellation_range": Variant(
        2,
        (
            Member("sat0", fixed={"losMaximumRange": 1400e3}),
            Member("sat1", phase=-10.0, fixed={"losMaximumRange": 1000e3}),
            Member("sat2", phase=-3.0, node=14.0, fixed={"losMaximumRange": 150e3}),
        ),
        episodes=(3,),
        inclination=70.0,
        limits=(2400.0,),
        targets=160,
        communicator=("LOSCommunication", {"min_period": 60.0}),
    ),
    "constellation_multi": Variant(
        3,
        tuple(Member(f"sat{k}", phase=phase) for k, phase in enumerate((0.0, -30.0, -60.0, -106.0, -136.0))),
        inclination=97.0,
        targets=250,
        communicator=("LOSMultiCommunication", {}),
    ),
    "constellation_free": Variant(
        4,
        train(3, 6.0, sat1=FIXED_INTERVAL),
        episodes=(2,),
        limits=(1500.5,),
        communicator=("FreeCommunication", {"min_period": 300.0}),
        env={"max_step_duration": 70.5, "generate_obs_retasking_only": True},
        retask=0.05,
        skip=0.1,
        repeat=0.2,
    ),
    "constellation_broadcast": Variant(
        5,
        train(3, 12.0),
        episodes=(1,),
        kinds={"imager": BROADCASTER},
        communicator=("BroadcastLOSMulti", {}),
    ),
    "constellation_types": Variant(
        6,
        (
            Member("scout"),
            Member("relay", "relay", phase=-25.0),
            Member("camera", "second", phase=-8.0),
            Member("follower", phase=-71.0),
        ),
        episodes=(2,),
        inclination=97.0,
        targets=160,
        kinds={"imager": Kind(), "relay": RELAYING, "second": SECOND_IMAGER},
        communicator=("LOSMultiCommunication", {}),
    ),
    "constellation_death": Variant(
        7,
        train(3, 8.0, sat0={"fixed": hungry(130.0)}, sat1={"fixed": hungry(400.0)}, sat2={"fixed": hungry(340.0)}),
        episodes=(0, 1),
        limits=(1100.0, 3000.0),
        env={"failure_penalty": -2.0, "terminate_on_time_limit": True},
    ),
    "constellation_meta": Variant(
        8,
        train(4, 7.0),
        limits=(1200.0,),
        communicator=("NoCommunication", {}),
        agents={"pair": ["sat2", "sat0"]},
    ),
    "constellation_meta_idle": Variant(
        8,
        train(4, 7.0, sat0={"fixed": hungry(300.0)}),
        episodes=(1,),
        limits=(1200.0,),
        communicator=("NoCommunication", {}),
        agents={"pair": ["sat2", "sat0"]},
        idle_only=True,
    ),
    "constellation_scan": Variant(
        9,
        (Member("one", "scanner"), Member("other", "second", phase=-5.0)),
        episodes=(0, 1),
        limits=(5700.0, 1500.0),
        kinds={"scanner": SCANS, "second": OTHER_SCANS},
        targets=0,
        communicator=("NoCommunication", {}),
        env={"max_step_duration": 150.0, "terminate_on_time_limit": True},
        retask=0.1,
        skip=0.1,
    ),
    "constellation_untasked": Variant(
        12,
        (Member("one", "scanner"), Member("other", "scanner", phase=-4.0, waits=900.0)),
        episodes=(7,),
        limits=(1500.0,),
        kinds={"scanner": SCANS},
        targets=0,
        communicator=("NoCommunication", {}),
    ),
    "constellation_joint": Variant(
        10,
        train(2, 6.0, sat1={"fixed": hungry(200.0)}),
        communicator=("FreeCommunication", {}),
        joint=True,
        retask=0.05,
    ),
    "constellation_shared": Variant(
        11,
        train(3, 1.0, sat0=FIXED_INTERVAL, sat1=FIXED_INTERVAL, sat2=FIXED_INTERVAL),
        episodes=(0, 1),
        limits=(1800.0, 1800.0),
        targets=60,
        communicator=("NoCommunication", {}),
        env={"max_step_duration": 120.0},
    ),
}
