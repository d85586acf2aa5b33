"""NadirScience-v1: the task ``nadir_science`` of BSK-RL's benchmark suite.

The satellite and actions are those of NadirScan-v1 (:mod:`bsk_torch.presets.nadir_scan`), with a battery twice as large and a
disturbance torque twenty times as large, which saturates the wheels within an orbit or two. Pointing errors are not observed.

Observation, 10 numbers:

======================================  ==========================================================================
``storage_level_fraction``              data in the buffer as a fraction of the capacity
``battery_charge_fraction``             battery charge as a fraction of the capacity
``wheel_speeds_fraction`` (3)           wheel speeds as fractions of the maximum speed
``ground_station`` (2)                  time until the next pass over a station opens and closes, divided by 5700 s
``eclipse`` (2)                         time until the next eclipse begins and ends, divided by 5700 s
``time``                                time since reset, divided by the time limit
======================================  ==========================================================================

Actions: 0 scan (180 s), 1 charge (120 s), 2 downlink (60 s), 3 desaturate the wheels (60 s).

Reward: seconds of recorded data divided by the episode's 28,500 s; -1 if the satellite dies.

Termination: as in NadirScan-v1.

Eclipses are observed with ``obs.Eclipse(sampled=True)``: up to 30 s late, and, where none comes, at one second
after reset.

Random at reset: as in NadirScan-v1, with the charge of the larger battery and the larger disturbance.
"""

from __future__ import annotations

import torch

from bsk_torch import obs, rand
from bsk_torch.env import SatelliteTasking
from bsk_torch.presets.nadir_scan import ORBIT, ScanningSatellite, next_station, scanning_args, scanning_environment

BATTERY = 400 * 3600.0
"""Capacity of the battery, W s."""


class ScienceSatellite(ScanningSatellite):
    """The satellite of the benchmark."""

    observation_spec = (
        obs.SatProperties(
            dict(prop="storage_level_fraction"),
            dict(prop="battery_charge_fraction"),
            dict(prop="wheel_speeds_fraction"),
        ),
        next_station(),
        obs.Eclipse(norm=ORBIT, sampled=True),
        obs.Time(),
    )


def science_args() -> dict[str, object]:
    """Return the arguments of the benchmark, with distributions for random ones."""
    return scanning_args() | dict(
        batteryStorageCapacity=BATTERY,
        storedCharge_Init=rand.Uniform(0.3 * BATTERY, BATTERY),
        disturbance_vector=rand.Normal(0.0, 0.002, 3),
    )


def nadir_science(
    *, sat_args: dict[str, object] | None = None, obs_type: type = torch.Tensor, **options: object
) -> SatelliteTasking:
    """Return NadirScience-v1; see the module, and :func:`bsk_torch.presets.nadir_scan.nadir_scan` for the arguments."""
    return scanning_environment(ScienceSatellite("Scanner1", science_args() | (sat_args or {}), obs_type=obs_type), options)
