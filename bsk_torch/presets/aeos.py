"""Agile Earth observation: which of the next 32 targets to image.

AEOS-v1 is the task ``aeos_single`` of bsk_rl's benchmark suite: power and storage do not bind, only time does. AEOSCity-v1 looks
for cities instead of random places, and in CloudyAEOS-v1 targets hide under clouds of which only a forecast is known.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, ClassVar, Literal

import torch
from torch import Tensor

from bsk_torch import act, data, obs, rand, sats, scene
from bsk_torch.constants import R_EARTH
from bsk_torch.env import SatelliteTasking
from bsk_torch.sim import dyn, fsw

ORBIT = 5700.0
"""What one orbit counts as, s; episodes last three."""

ALTITUDE = 800e3
"""Height of the orbit, m."""

SPEED = 7616.5
"""What velocities are divided by, m/s."""

SOON = 300.0
"""What times of windows are divided by, s; also the longest step."""

AHEAD = 32
"""Targets that are seen and can be chosen."""

SATELLITE = (
    dict(prop="omega_BH_H", norm=0.03),
    dict(prop="c_hat_H"),
    dict(prop="r_BN_P", norm=R_EARTH),
    dict(prop="v_BN_P", norm=SPEED),
)
"""What is observed of the satellite: its rate, where its instrument points, and its orbit."""

TARGET = (
    dict(prop="priority"),
    dict(prop="r_LB_H", norm=ALTITUDE),
    dict(prop="target_angle", norm=math.pi),
    dict(prop="target_angle_rate", norm=0.03),
    dict(prop="opportunity_open", norm=SOON),
    dict(prop="opportunity_close", norm=SOON),
)
"""What is observed of each target."""


def targets_ahead(*more: dict[str, Any], as_set: bool = False) -> obs.OpportunityProperties:
    """Observation of the next targets, with ``more`` properties than :data:`TARGET`."""
    return obs.OpportunityProperties(*TARGET, *more, type="target", n_ahead_observe=AHEAD, as_set=as_set)


class AgileSatellite(sats.ImagingSatellite):
    """Sees the next 32 targets and images one of them."""

    observation_spec: ClassVar[Sequence[obs.Observation]] = (obs.SatProperties(*SATELLITE), targets_ahead(), obs.Time())
    action_spec: ClassVar[Sequence[act.Action]] = (act.Image(n_ahead_image=AHEAD),)
    dyn_type = dyn.ImagingDynModel
    fsw_type = fsw.SteeringImagerFSWModel


class AgileSetSatellite(AgileSatellite):
    """The same, with the targets as a set for policies that treat them alike."""

    observation_spec = (obs.SatProperties(*SATELLITE), targets_ahead(as_set=True), obs.Time())


def agile_args() -> dict[str, Any]:
    """Orbit, agility and instrument of bsk_rl's benchmark; a hundred times the power and the storage of its defaults."""
    return dict(
        oe=rand.random_orbit(a=(6371e3 + ALTITUDE) / 1e3, i=45.0),
        imageTargetMinimumElevation=math.atan(ALTITUDE / 500e3),
        imageAttErrorRequirement=0.01,
        imageRateErrorRequirement=0.01,
        u_max=0.4,
        omega_max=math.radians(5.0),
        servo_P=30.0,
        batteryStorageCapacity=100 * 80.0 * 3600.0,
        storedCharge_Init=100 * 80.0 * 3600.0,
        dataStorageCapacity=100 * 20 * 8e6,
    )


def agile_environment(
    satellites: tuple[type[sats.ImagingSatellite], type[sats.ImagingSatellite]],
    arguments: dict[str, Any],
    as_set: bool,
    options: dict[str, Any],
) -> SatelliteTasking:
    """An environment of one of two satellites, the second of which observes targets ``as_set``; see :func:`aeos`."""
    obs_type = options.pop("obs_type", dict if as_set else torch.Tensor)
    satellite = satellites[as_set]("EO1", arguments | options.pop("sat_args", {}), obs_type=obs_type, may_see_nothing=True)
    defaults: dict[str, Any] = dict(
        rewarder=data.UniqueImageReward(),
        time_limit=3 * ORBIT,
        sim_rate=0.5,
        max_step_duration=SOON,
        failure_penalty=0.0,
        terminate_on_time_limit=True,
    )
    return SatelliteTasking(satellite, **(defaults | options))


def aeos(*, n_targets: int | tuple[int, int] = (100, 10_000), as_set: bool = False, **options: Any) -> SatelliteTasking:
    """AEOS-v1; see :func:`bsk_torch.make`.

    Args:
        n_targets: Number of targets, or its range (the upper end excluded).
        as_set: Whether targets are observed as ``rows`` [N, 32, features] with a ``mask`` instead of in one vector.
        **options: Arguments of the environment to override.
    """
    options = {"scenario": scene.UniformTargets(n_targets)} | options
    return agile_environment((AgileSatellite, AgileSetSatellite), agile_args(), as_set, options)


def aeos_city(
    *, n_targets: int = 1000, n_select_from: int | Literal["all"] | None = 5000, as_set: bool = False, **options: Any
) -> SatelliteTasking:
    """AEOSCity-v1: every episode asks for ``n_targets`` of the ``n_select_from`` largest cities; see :func:`aeos`."""
    options = {"scenario": scene.CityTargets(n_targets, n_select_from)} | options
    return agile_environment((AgileSatellite, AgileSetSatellite), agile_args(), as_set, options)


def cloud_forecast(satellite: Any, targets: Any) -> Tensor:
    """Forecast of the cloud cover over each target, [N, n]."""
    return satellite.simulator.look_up(satellite.scenario.cloud_forecast, targets.place)


CLOUDS = dict(fn=cloud_forecast, name="cloud_forecast")


class CloudySatellite(AgileSatellite):
    """Also sees the forecast."""

    observation_spec = (obs.SatProperties(*SATELLITE), targets_ahead(CLOUDS), obs.Time())


class CloudySetSatellite(AgileSatellite):
    """The same, as a set."""

    observation_spec = (obs.SatProperties(*SATELLITE), targets_ahead(CLOUDS, as_set=True), obs.Time())


def cloudy_aeos(*, n_targets: int | tuple[int, int] = 1000, as_set: bool = False, **options: Any) -> SatelliteTasking:
    """CloudyAEOS-v1: only images without clouds count; see :func:`aeos`."""
    clouds = dict(scenario=scene.CloudyTargets(scene.UniformTargets(n_targets)), rewarder=data.CloudFreeImageReward())
    return agile_environment((CloudySatellite, CloudySetSatellite), agile_args(), as_set, clouds | options)
