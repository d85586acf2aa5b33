"""NadirScan-v1: the demonstration of the BSK-RL paper (section 4 and appendix).

One satellite records data of the ground below it for five orbits, and must keep its battery charged, its wheels slow and its data
buffer from filling up.

Observation, 12 numbers:

======================================  ==========================================================================
``storage_level_fraction``              data in the buffer as a fraction of the capacity
``battery_charge_fraction``             battery charge as a fraction of the capacity
``wheel_speeds_fraction`` (3)           wheel speeds as fractions of the maximum speed
``instrument_pointing_error_normd``     angle between instrument and nadir, divided by pi
``solar_pointing_error_normd``          angle between panel normal and Sun, divided by pi
``ground_station`` (2)                  time until the next pass over a station opens and closes, divided by 5700 s
``eclipse`` (2)                         time until the next eclipse begins and ends, divided by 5700 s
``time``                                time since reset, divided by the time limit
======================================  ==========================================================================

Actions: 0 scan (180 s), 1 charge (120 s), 2 downlink (60 s), 3 desaturate the wheels (60 s).

Reward: seconds of recorded data divided by the episode's 28,500 s; -1 if the satellite dies.

Termination: at the end of a step with an empty battery, a wheel at its maximum speed, or an altitude below 200 km; and at the
time limit of 28,500 s.

Eclipses are observed with ``obs.Eclipse(sampled=True)``: up to 30 s late, and, where none comes, at one second
after reset.

Random at reset: orbit, attitude, initial storage, charge and wheel speeds, disturbance torque; see :func:`scanning_args`.
"""

from __future__ import annotations

from typing import Any, ClassVar

import torch
from torch import Tensor

from bsk_torch import act, data, obs, rand, sats, scene
from bsk_torch.astro.frames import angle_between
from bsk_torch.env import SatelliteTasking
from bsk_torch.sim import dyn, fsw
from bsk_torch.sim.dyn import Now, observable
from bsk_torch.sim.instruments import axis_now

ORBIT = 5700.0
"""Length of an orbit for norms and time limits, s."""

CAPACITY = 5000 * 8e6
"""Capacity of the data buffer, bit."""

BATTERY = 200 * 3600.0
"""Capacity of the battery, W s."""


def next_station() -> obs.OpportunityProperties:
    """Return the observation of the next pass over a ground station."""
    times = (dict(prop=name, norm=ORBIT) for name in ("opportunity_open", "opportunity_close"))
    return obs.OpportunityProperties(*times, type="ground_station", n_ahead_observe=1)


class ScanningDownlinkDynModel(dyn.ContinuousImagingDynModel, dyn.GroundStationDynModel):
    """Dynamics of a satellite that scans and downlinks, with the two observed pointing errors."""

    @observable
    def instrument_pointing_error(now: Now) -> Tensor:
        """Angle between instrument axis and nadir direction, [N] rad; of several ``instruments``, that of the one chosen last."""
        return angle_between(-now.r_BN_N, now.BN.mT @ axis_now(now))

    @observable
    def solar_pointing_error(now: Now) -> Tensor:
        """Angle between panel normal and the direction from the Earth to the Sun, [N] rad."""
        return angle_between(now.BN.mT @ now.args.nHat_B, now.r_SN_N)


class ScanningSatellite(sats.AccessSatellite):
    """The satellite of the paper."""

    observation_spec: ClassVar[tuple[obs.Observation, ...]] = (
        obs.SatProperties(
            dict(prop="storage_level_fraction"),
            dict(prop="battery_charge_fraction"),
            dict(prop="wheel_speeds_fraction"),
            dict(prop="instrument_pointing_error", norm=torch.pi),
            dict(prop="solar_pointing_error", norm=torch.pi),
        ),
        next_station(),
        obs.Eclipse(norm=ORBIT, sampled=True),
        obs.Time(),
    )
    action_spec = (
        act.Scan(duration=180.0),
        act.Charge(duration=120.0),
        act.Downlink(duration=60.0),
        act.Desat(duration=60.0),
    )
    dyn_type = ScanningDownlinkDynModel
    fsw_type = fsw.ContinuousImagingFSWModel


def scanning_args() -> dict[str, object]:
    """Return the arguments of the paper, with distributions for random ones."""
    return dict(
        dataStorageCapacity=CAPACITY,
        storageInit=rand.Uniform(0.0, 0.8 * CAPACITY),
        instrumentBaudRate=0.5 * 8e6,
        transmitterBaudRate=-50 * 8e6,
        batteryStorageCapacity=BATTERY,
        storedCharge_Init=rand.Uniform(0.3 * BATTERY, BATTERY),
        basePowerDraw=-10.0,
        instrumentPowerDraw=-30.0,
        transmitterPowerDraw=-25.0,
        thrusterPowerDraw=-80.0,
        panelArea=0.25,
        imageAttErrorRequirement=0.1,
        imageRateErrorRequirement=0.1,
        disturbance_vector=rand.Normal(0.0, 1e-4, 3),
        maxWheelSpeed=6000.0,
        wheelSpeeds=rand.Uniform(-3000.0, 3000.0, 3),
        desatAttitude="nadir",
    )


def nadir_scan(
    *, sat_args: dict[str, object] | None = None, obs_type: type = torch.Tensor, **options: object
) -> SatelliteTasking:
    """Return NadirScan-v1; see the module.

    Args:
        sat_args: Arguments of the satellite that replace those of the preset.
        obs_type: ``torch.Tensor`` for one vector, ``dict`` for named observations.
        **options: Arguments of :class:`~bsk_torch.SatelliteTasking` that replace those of the preset.
    """
    return scanning_environment(ScanningSatellite("Scanner1", scanning_args() | (sat_args or {}), obs_type=obs_type), options)


def scanning_environment(satellite: ScanningSatellite, options: dict[str, object]) -> SatelliteTasking:
    """Return the task of the paper for a satellite; ``options`` replace those of the preset."""
    defaults: dict[str, Any] = dict(
        scenario=scene.UniformNadirScanning(value_per_second=1 / (5 * ORBIT)),
        rewarder=data.ScanningTimeReward(),
        time_limit=5 * ORBIT,
        failure_penalty=-1.0,
        terminate_on_time_limit=True,
    )
    return SatelliteTasking(satellite, **(defaults | options))
