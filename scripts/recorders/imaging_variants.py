"""Which point-imaging episodes ``record_imaging.py`` records: their satellites, observations, environments and policies."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

ORBIT_PERIOD = 5700.0  # [s]
EARTH_RADIUS = 6378136.6  # [m] where the targets are
IMAGE = 0.5 * 8e6  # [bit]
BATTERY = 400 * 3600.0  # [W s]
MODES: tuple[tuple[str, float], ...] = (("Charge", 60.0), ("Downlink", 60.0), ("Desat", 60.0))
FIXED: dict[str, Any] = {
    "imageAttErrorRequirement": 0.01,
    "imageRateErrorRequirement": 0.01,
    "imageTargetMinimumElevation": float(np.radians(45.0)),
    "dataStorageCapacity": 40 * IMAGE,
    "instrumentBaudRate": IMAGE,
    "transmitterBaudRate": -8e6,
    "batteryStorageCapacity": BATTERY,
    "basePowerDraw": -10.0,
    "thrusterPowerDraw": -80.0,
    "u_max": 0.4,
    "maxWheelSpeed": 6000.0,
}
POINTING = {"inst_pHat_B": (0.0, 0.0, 1.0), "instrumentPowerDraw": -30.0}  # bsk_rl's defaults
STEERING = {"K1": 0.5, "K3": 3.0, "omega_max": float(np.radians(5.0)), "servo_Ki": 5.0, "servo_P": 30.0}
TARGET_PROPERTIES: tuple[tuple[str, float], ...] = (
    ("priority", 1.0),
    ("r_LP_P", EARTH_RADIUS),
    ("r_LB_H", 800e3),
    ("opportunity_open", 300.0),
    ("opportunity_mid", 300.0),
    ("opportunity_close", 300.0),
    ("target_angle", np.pi),
    ("target_angle_rate", 0.03),
)
LIMITED_PROPERTIES: tuple[tuple[str, float], ...] = (
    ("priority", 1.0),
    ("r_LP_P", EARTH_RADIUS),
    ("opportunity_open", 300.0),
    ("opportunity_close", 300.0),
)
STATION_PROPERTIES = (("r_LP_P", EARTH_RADIUS), ("opportunity_open", ORBIT_PERIOD), ("opportunity_close", ORBIT_PERIOD))
SATELLITE_PROPERTIES: tuple[tuple[str, float], ...] = (
    ("omega_BP_P", 0.03),
    ("omega_BH_H", 0.03),
    ("c_hat_P", 1.0),
    ("c_hat_H", 1.0),
    ("r_BN_P", EARTH_RADIUS),
    ("v_BN_P", 7616.5),
    ("battery_charge_fraction", 1.0),
    ("storage_level_fraction", 1.0),
    ("wheel_speeds_fraction", 1.0),
)


@dataclass(frozen=True)
class Variant:
    """One file of episodes: the distribution of its initial conditions, its environment and its policy.

    Attributes:
        seed: Seed of every draw; with an episode's number it gives one stream for the start and one for the actions.
        episodes: Numbers of the episodes.
        time_limit: [s] Length of an episode; infinity for none.
        limits: [s] Time limit of each episode, where they differ.
        steps: Most decisions in an episode.
        targets: Number of targets.
        ahead: Number of targets observed, and that the action chooses from.
        stations: Number of ground stations observed.
        inclination: [deg], or None for a random one.
        steering: Whether the steering law controls the attitude, instead of feedback.
        max_duration: [s] Longest image action.
        others: Probabilities of the actions in ``MODES``; images share the rest.
        opening: First actions of each episode, where they are not random.
        repeat: Probability of repeating the previous action.
        stored: [bit] Data in the store at reset.
        fixed: Satellite arguments on top of ``FIXED``.
        instruments: Name of each of several instruments, between which the action chooses, and arguments in which they differ.
        satellite: Options of the satellite.
        env: Options of the environment.
    """

    seed: int
    episodes: tuple[int, ...] = (0, 1)
    time_limit: float = ORBIT_PERIOD
    limits: tuple[float, ...] = ()
    steps: int | None = None
    targets: int = 1500
    ahead: int = 8
    stations: int = 0
    inclination: float | None = None
    steering: bool = False
    max_duration: float | None = None
    others: tuple[float, float, float] = (0.08, 0.08, 0.04)
    opening: tuple[tuple[int, ...], ...] = ()
    repeat: float = 0.0
    stored: int = 0
    fixed: dict[str, Any] = field(default_factory=dict)
    instruments: dict[str, dict[str, Any]] = field(default_factory=dict)
    satellite: dict[str, Any] = field(default_factory=dict)
    env: dict[str, Any] = field(default_factory=dict)


def minimum_elevation(degrees: float) -> dict[str, float]:
    """The argument that limits the elevation at which targets can be imaged."""
    return {"imageTargetMinimumElevation": float(np.radians(degrees))}


# Numbers of episodes, limits and openings were searched for: test_imaging_parity.py lists the content of each file.
VARIANTS: dict[str, Variant] = {
    "imaging_feedback": Variant(1, (5, 9), time_limit=2 * ORBIT_PERIOD, stations=2),
    "imaging_steering": Variant(2, (6, 10), time_limit=2 * ORBIT_PERIOD, stations=2, steering=True),
    "imaging_few": Variant(3, (6, 7), 2 * ORBIT_PERIOD, targets=10, ahead=4, max_duration=300.0),
    "imaging_padded": Variant(
        4, (3, 12, 18), 2 * ORBIT_PERIOD, targets=4, ahead=4, max_duration=600.0, repeat=0.4, opening=((6,), (6,), (6,))
    ),
    "imaging_bounded": Variant(
        5,
        (1, 4),
        ORBIT_PERIOD / 2,
        targets=200,
        max_duration=150.0,
        satellite={"max_generation_duration_beyond_initial": 1200.0},
    ),
    "imaging_sparse": Variant(5, (0, 8), targets=100, max_duration=200.0),
    "imaging_dense": Variant(6, time_limit=ORBIT_PERIOD / 3, targets=5000),
    "imaging_polar": Variant(7, time_limit=2 * ORBIT_PERIOD / 3, inclination=97.0, ahead=4),
    "imaging_equatorial": Variant(8, time_limit=2 * ORBIT_PERIOD / 3, inclination=0.0, ahead=4),
    "imaging_30deg": Variant(9, time_limit=ORBIT_PERIOD / 2, fixed=minimum_elevation(30.0), ahead=4),
    "imaging_80deg": Variant(10, fixed=minimum_elevation(80.0), ahead=4),
    "imaging_range": Variant(
        11,
        time_limit=ORBIT_PERIOD / 2,
        fixed={"imageTargetMaximumRange": 600e3, "imageRateErrorRequirement": None},
        ahead=4,
    ),
    "imaging_full": Variant(12, time_limit=2 * ORBIT_PERIOD / 3, fixed={"dataStorageCapacity": 3 * IMAGE}, ahead=4),
    "imaging_cut": Variant(13, tuple(range(6)), limits=(347.0, 498.0, 394.5, 555.0, 333.4, 600.0), ahead=4),
    "imaging_timeout": Variant(14, (5, 7), ORBIT_PERIOD / 2, max_duration=33.0, repeat=0.4, ahead=4, others=(0.15, 0.1, 0.1)),
    "imaging_stale": Variant(
        14,
        (21, 44, 75, 95),
        time_limit=700.0,
        max_duration=72.5,
        repeat=0.4,
        ahead=4,
        opening=((4, 0, 1), (3, 5), (6, 6), (6, 2, 2, 0)),
    ),
    "imaging_interval": Variant(
        15,
        (4, 7, 11),
        ORBIT_PERIOD / 2,
        ahead=4,
        satellite={"variable_interval": False},
        env={"max_step_duration": 70.5},
    ),
    "imaging_stored": Variant(16, (9, 14), 2 * ORBIT_PERIOD / 3, stored=47_123_457, others=(0.08, 0.4, 0.04), ahead=4),
    "imaging_unlimited": Variant(17, time_limit=float("inf"), steps=30, stations=1),
    "imaging_half_second": Variant(18, (0,), ORBIT_PERIOD / 2, env={"sim_rate": 0.5}, ahead=4),
    "imaging_instruments": Variant(
        19,
        time_limit=2 * ORBIT_PERIOD / 3,
        ahead=4,
        fixed={"transmitterPacketSize": -2e6},
        instruments={
            "wide": {},
            "narrow": {
                "inst_pHat_B": (0.6, 0.0, 0.8),
                "imageAttErrorRequirement": 0.003,
                "imageRateErrorRequirement": 0.004,
                "instrumentBaudRate": 2.5e6,
                "instrumentPowerDraw": -55.0,
            },
        },
    ),
    "imaging_limits": Variant(
        20,
        time_limit=ORBIT_PERIOD,
        targets=2500,
        ahead=3,
        max_duration=120.0,
        fixed={"transmitterPacketSize": -2e6},
        instruments={
            "wide": {},
            "high": {"imageTargetMinimumElevation": float(np.radians(65.0)), "inst_pHat_B": (0.0, 0.6, 0.8)},
            "near": {"imageTargetMinimumElevation": float(np.radians(35.0)), "imageTargetMaximumRange": 640e3},
            "day": {"imageTargetMinimumSunElevation": float(np.radians(10.0)), "imageTargetMaximumRange": 620e3},
            "dusk": {
                "imageTargetMinimumElevation": float(np.radians(40.0)),
                "imageTargetMinimumSunElevation": float(np.radians(-50.0)),
                "imageTargetMaximumSunElevation": float(np.radians(20.0)),
            },
        },
    ),
}
