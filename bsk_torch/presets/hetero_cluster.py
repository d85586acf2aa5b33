"""HeteroCluster-v1: two optical satellites and a radar image the same targets; clouds and night matter to the optical ones only.

The task follows the description of the heterogeneous clusters of M. Hady et al. (arXiv 2506.15207, 2511.12792, 2605.31023); all
numbers are this package's.

==========================  ======================================  ==============================================
satellites                  ``EO1``, ``EO2``: optical               ``SAR1``: radar
==========================  ======================================  ==============================================
useful images               of lit targets (Sun at least 10         of all targets
                            degrees above them), with a cloud
                            cover of at most 0.7
elevation of the satellite  at least 58 degrees                     at least 45 degrees
body                        that of AEOSPower-v1, 330 kg            :func:`bsk_torch.craft.agile_imager`, 1,000 kg
battery, power when idle    160 Wh, 60 W                            2,000 Wh, 340 W
power while imaging         30 W more                               1,200 W more
image, data rate down       8 Mbit, 8 Mbit/s                        64 Mbit, 16 Mbit/s
store                       100 images                              100 images
==========================  ======================================  ==============================================

They fly one behind the other on a circular orbit (600 km, 45 degrees), 4 degrees apart, the radar last, and share all knowledge
after every step.

Observation of each satellite, 182 numbers (183 for the radar, which has four wheels):

=============================  ==================================================================================
``omega_BH_H_normd`` (3)       angular velocity relative to the Hill frame, divided by 0.03 rad/s
``c_hat_H`` (3)                direction of the instrument in the Hill frame
``r_BN_P_normd`` (3)           position in the Earth-fixed frame, divided by the radius of the Earth
``v_BN_P_normd`` (3)           velocity in the Earth-fixed frame, divided by 7616.5 m/s
``battery_charge_fraction``    battery charge as a fraction of the capacity
``wheel_speeds_fraction``      wheel speeds as fractions of the maximum speed (3, or 4)
``storage_level_fraction``     data in the store as a fraction of the capacity
of each of 16 targets:
``priority``                   its reward
``r_LB_H_normd`` (3)           its position relative to the satellite, in the Hill frame, divided by 800 km
``target_angle_normd``         angle between its direction and the instrument, divided by pi
``target_angle_rate_normd``    angular rate of the body relative to the line of sight, divided by 0.03 rad/s
``opportunity_open_normd``     time until its window opens, divided by 300 s
``opportunity_close_normd``    time until its window closes, divided by 300 s
``cloud_forecast``             forecast of the cloud cover
``claimed``                    number of other satellites that are about to image it
``ground_station`` (2)         time until the next pass over a station opens and closes, divided by 5700 s
``eclipse`` (2)                time until the next eclipse begins and ends, divided by 5700 s
``time``                       time since reset, divided by the time limit
=============================  ==================================================================================

The targets are those of the next windows, in order of closing time, without targets that the satellite knows to be imaged, and
for the optical ones without those that they know to be covered from an image.

Actions: 0 charge, 1 downlink, 2 desaturate the wheels (60 s each), 3 to 18 image one of the next 16 targets; the last action
continues the current task. ``action_mask`` excludes actions as in :mod:`bsk_torch.presets.aeos_power`; batteries can
still run empty.

Reward: the priority of a target for its first useful image, shared by satellites that take it in the same step; -1 if a satellite
dies.

Termination: at the time limit of 11,400 s (two orbits). A satellite with an empty battery or a wheel at its maximum speed dies
and leaves.

Eclipses are observed with ``obs.Eclipse(sampled=True)``: up to 30 s late, and, where none comes, at one second
after reset.
Windows that open after the time limit are legal: ``act.Image(mask_late=False)``.

Random at reset: node and phase of the orbit; positions and priorities of 5,000 targets, their clouds and forecasts; initial
charge and wheel speeds, disturbance torque of the optical satellites.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, ClassVar, cast

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch import act, comm, craft, data, formations, obs, sats, scene
from bsk_torch.env import ConstellationTasking
from bsk_torch.presets.aeos import CLOUDS, ORBIT, SATELLITE, SOON, imagers, targets_ahead
from bsk_torch.presets.aeos_power import CHARGE, RESOURCES, power_args, shield
from bsk_torch.presets.constellation import CHOICES
from bsk_torch.presets.nadir_scan import next_station
from bsk_torch.sim import dyn, fsw

ALTITUDE, INCLINATION, SPACING = 600.0, 45.0, 4.0
"""Altitude of the orbit, km, its inclination, and the angle from a satellite to the next, degrees."""

LIT = math.radians(10.0)
"""Least elevation of the Sun above targets of optical satellites, rad."""


def task_in_progress(satellite: sats.BoundSatellite) -> Tensor:
    """Return the keys of the current tasks, [N]; that of charging where there is none."""
    task = satellite.task
    return torch.where(task.requires_retasking | task.dead, CHARGE, task.previous_action)


def claimed(satellite: sats.BoundSatellite, targets: sats.Opportunities) -> Tensor:
    """Return how many other satellites are about to image each target, [N, n]."""
    tasks = satellite.fleet.each(task_in_progress)
    keys = act.Image.keys(targets.place).unsqueeze(-1)
    claims = (satellite.of_env(tasks).unsqueeze(1) == keys).sum(-1) - (satellite.rows_of(tasks).view(-1, 1, 1) == keys).sum(-1)
    return claims.to(targets.close.dtype)


def observed(as_set: bool) -> tuple[obs.Observation, ...]:
    """Return the observations of a satellite of the cluster."""
    claims = dict(fn=claimed, name="claimed")
    return (
        obs.SatProperties(*SATELLITE, *RESOURCES),
        targets_ahead(CLOUDS, claims, as_set=as_set, n_ahead=CHOICES),
        next_station(),
        obs.Eclipse(norm=ORBIT, sampled=True),
        obs.Time(),
    )


class OpticalImager(sats.ImagingSatellite):
    """Images lit targets without clouds, charges, downlinks and desaturates; the shield of AEOSPower-v1 limits its actions."""

    observation_spec: ClassVar[Sequence[obs.Observation]] = observed(as_set=False)
    action_spec: ClassVar[Sequence[act.Action]] = (
        act.Charge(duration=60.0),
        act.Downlink(duration=60.0),
        act.Desat(duration=60.0),
        act.Image(n_ahead_image=CHOICES, mask_late=False),
    )
    dyn_type = dyn.GroundStationDynModel
    fsw_type = fsw.SteeringImagerFSWModel

    @override
    def legal_actions(self) -> Tensor | None:
        return shield(cast(sats.BoundSatellite, self))


class OpticalSetImager(OpticalImager):
    """The same, with targets as a set."""

    observation_spec = observed(as_set=True)


class RadarImager(OpticalImager):
    """The same for all targets: clouds and night do not matter."""

    sees_through_clouds = True


class RadarSetImager(OpticalSetImager):
    """The same, with targets as a set."""

    sees_through_clouds = True


def optical_args() -> dict[str, object]:
    """Return the arguments of the satellite of AEOSPower-v1 with gains that are stable with ticks of 1 s, for lit targets."""
    arguments = {name: value for name, value in power_args().items() if name != "oe"}
    return arguments | dict(K1=0.5, K3=3.0, servo_Ki=5.0, imageTargetMinimumSunElevation=LIT)


def radar_args() -> dict[str, object]:
    """Return the arguments of a radar on an agile spacecraft of the library."""
    return craft.agile_imager(h=1.0, law="steering") | dict(
        inst_pHat_B=[0.0, 0.0, 1.0],  # not craft's: episodes of this version stay the same
        imageTargetMinimumElevation=math.radians(45.0),
        imageAttErrorRequirement=0.01,
        imageRateErrorRequirement=0.01,
        instrumentPowerDraw=-1200.0,
        instrumentBaudRate=64e6,
        transmitterBaudRate=-16e6,
        transmitterPowerDraw=-100.0,
        thrusterPowerDraw=-80.0,
        dataStorageCapacity=100 * 64e6,
        desatAttitude="nadir",
    )


def hetero_cluster(*, n_targets: int | tuple[int, int] = 5000, as_set: bool = False, **options: Any) -> ConstellationTasking:
    """Return HeteroCluster-v1; see the module.

    Groups of agents are ``optical_imager`` and ``radar_imager``, or ``optical_set_imager`` and ``radar_set_imager`` with
    ``as_set=True``. Arguments are those of :func:`bsk_torch.presets.constellation.constellation`; ``sat_args`` are merged with
    those of the optical satellites, ``radar_args`` with those of the radar.
    """
    kinds = (OpticalSetImager, RadarSetImager) if as_set else (OpticalImager, RadarImager)
    settings: dict[str, Any] = {"obs_type": options.pop("obs_type", dict if as_set else torch.Tensor)}
    radars = imagers(kinds[1], ["SAR1"], radar_args(), {"sat_args": options.pop("radar_args", {})}, **settings)
    satellites = [*imagers(kinds[0], ["EO1", "EO2"], optical_args(), options, **settings), *radars]
    defaults: dict[str, Any] = dict(
        scenario=scene.CloudyTargets(scene.UniformTargets(n_targets)),
        rewarder=data.CloudFreeImageReward(),
        communicator=comm.FreeCommunication(),
        sat_arg_randomizer=formations.train_args(SPACING, altitude=ALTITUDE, inc=INCLINATION),
        time_limit=2 * ORBIT,
        max_step_duration=SOON,
        failure_penalty=-1.0,
        terminate_on_time_limit=True,
    )
    return ConstellationTasking(satellites, **(defaults | options))
