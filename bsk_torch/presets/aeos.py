"""AEOS-v1, AEOSCity-v1 and CloudyAEOS-v1: agile Earth observation, choosing among the next 32 targets.

AEOS-v1 is the task ``aeos_single`` of BSK-RL's benchmark suite: the satellite is limited by time, not by power or storage. With
``benchmark=True``, angles of targets are divided by pi / 2, and the data buffer is ten times as large, exactly as there. The
targets of AEOSCity-v1 are cities. In CloudyAEOS-v1, clouds cover targets and are observed only as a forecast.

Observation, 12 + 32 * 8 + 1 = 269 numbers (32 more in CloudyAEOS-v1):

============================  ==================================================================================
``omega_BH_H_normd`` (3)      angular velocity relative to the Hill frame, divided by 0.03 rad/s
``c_hat_H`` (3)               direction of the instrument in the Hill frame
``r_BN_P_normd`` (3)          position in the Earth-fixed frame, divided by the radius of the Earth
``v_BN_P_normd`` (3)          velocity in the Earth-fixed frame, divided by 7616.5 m/s
of each target:
``priority``                  its reward
``r_LB_H_normd`` (3)          its position relative to the satellite, in the Hill frame, divided by 800 km
``target_angle_normd``        angle between its direction and the instrument, divided by pi
``target_angle_rate_normd``   angular rate of the body relative to the line of sight, divided by 0.03 rad/s
``opportunity_open_normd``    time until its window opens, divided by 300 s
``opportunity_close_normd``   time until its window closes, divided by 300 s
``cloud_forecast``            forecast of the cloud cover (CloudyAEOS-v1)
``time``                      time since reset, divided by the time limit
============================  ==================================================================================

The observed targets are those of the next windows, in order of closing time, without imaged targets. With ``as_set=True``, they
are ``rows`` [N, 32, features] with a ``mask`` [N, 32].

Actions: 0 to 31 image the corresponding target. The step ends with the image, with the end of the window, or after 300 s.

Reward: the priority of a target for its first image; none in CloudyAEOS-v1 if the cloud cover is above 0.7.

Termination: at the time limit of 17,100 s (three orbits).

Windows that open after the time limit are legal: ``act.Image(mask_late=False)``.

Random at reset: orbit (800 km, 45 degrees); number (100 to 9,999 in AEOS-v1), positions and priorities of targets; clouds.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any, ClassVar, Literal, TypeVar

import torch
from torch import Tensor

from bsk_torch import act, data, obs, rand, sats, scene
from bsk_torch._checks import switch, whole
from bsk_torch.constants import R_EARTH
from bsk_torch.env import SatelliteTasking
from bsk_torch.sim import dyn, fsw

Imager = TypeVar("Imager", bound=sats.ImagingSatellite)

ORBIT = 5700.0
"""Duration of an orbit for norms and time limits, s; episodes last three orbits."""

ALTITUDE = 800e3
"""Altitude of the orbit, m."""

SPEED = 7616.5
"""Norm of velocities, m/s."""

SOON = 300.0
"""Norm of the times of windows, and maximum step, s."""

AHEAD = 32
"""Number of observed targets to choose from."""

SATELLITE = (
    dict(prop="omega_BH_H", norm=0.03),
    dict(prop="c_hat_H"),
    dict(prop="r_BN_P", norm=R_EARTH),
    dict(prop="v_BN_P", norm=SPEED),
)
"""Observed properties of the satellite: angular velocity, direction of the instrument, orbit."""

TARGET = (
    dict(prop="priority"),
    dict(prop="r_LB_H", norm=ALTITUDE),
    dict(prop="target_angle", norm=math.pi),
    dict(prop="target_angle_rate", norm=0.03),
    dict(prop="opportunity_open", norm=SOON),
    dict(prop="opportunity_close", norm=SOON),
)
"""Observed properties of each target."""


def targets_ahead(
    *more: dict[str, Any], as_set: bool = False, n_ahead: int = AHEAD, benchmark: bool = False
) -> obs.OpportunityProperties:
    """Return the observation of the next targets: :data:`TARGET`, and ``more``; angles as in the suite with ``benchmark``."""
    half = dict(norm=math.pi / 2)
    properties = [entry | half if benchmark and entry["prop"] == "target_angle" else entry for entry in TARGET]
    return obs.OpportunityProperties(*properties, *more, type="target", n_ahead_observe=n_ahead, as_set=as_set)


def looking_ahead(*more: dict[str, Any], as_set: bool, n_ahead: int = AHEAD, benchmark: bool = False) -> dict[str, Any]:
    """Return the settings of a satellite that chooses among the next ``n_ahead`` targets; see :func:`targets_ahead`."""
    targets = targets_ahead(*more, as_set=as_set, n_ahead=whole("n_ahead", n_ahead, 1), benchmark=switch("benchmark", benchmark))
    return dict(
        obs_type=dict if as_set else torch.Tensor,
        observation_spec=(obs.SatProperties(*SATELLITE), targets, obs.Time()),
        action_spec=(act.Image(n_ahead_image=n_ahead, mask_late=False),),
    )


class AgileSatellite(sats.ImagingSatellite):
    """Observes the next 32 targets and images one of them."""

    observation_spec: ClassVar[Sequence[obs.Observation]] = (obs.SatProperties(*SATELLITE), targets_ahead(), obs.Time())
    action_spec: ClassVar[Sequence[act.Action]] = (act.Image(n_ahead_image=AHEAD, mask_late=False),)
    dyn_type = dyn.ImagingDynModel
    fsw_type = fsw.SteeringImagerFSWModel


def agile_args(benchmark: bool = False) -> dict[str, object]:
    """Return orbit, agility and instrument of the benchmark suite, with a hundred times the power and storage of its defaults.

    With ``benchmark``, the storage is that of the suite, a thousand times the default; it never fills up in either case.
    """
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
        dataStorageCapacity=(1000 if benchmark else 100) * 20 * 8e6,
    )


def imagers(
    kind: type[Imager], names: Iterable[str], arguments: dict[str, object], options: dict[str, Any], **settings: Any
) -> list[Imager]:
    """Return satellites with ``settings``; ``sat_args``, ``obs_type`` and ``variable_interval`` of ``options`` move there."""
    arguments = arguments | options.pop("sat_args", {})
    settings |= {name: options.pop(name) for name in ("obs_type", "variable_interval") if name in options}
    return [kind(name, arguments, may_see_nothing=True, **settings) for name in names]


def agile_environment(satellite: AgileSatellite, options: dict[str, Any]) -> SatelliteTasking:
    """Return the task of AEOS-v1 for a satellite; ``options`` replace those of the preset."""
    defaults: dict[str, Any] = dict(
        rewarder=data.UniqueImageReward(),
        time_limit=3 * ORBIT,
        sim_rate=0.5,
        max_step_duration=SOON,
        failure_penalty=0.0,
        terminate_on_time_limit=True,
    )
    return SatelliteTasking(satellite, **(defaults | options))


def aeos(
    *,
    n_targets: int | tuple[int, int] = (100, 10_000),
    n_ahead: int = AHEAD,
    as_set: bool = False,
    benchmark: bool = False,
    **options: object,
) -> SatelliteTasking:
    """Return AEOS-v1; see the module.

    Args:
        n_targets: Number of targets, or its range (the upper end excluded).
        n_ahead: Number of observed targets to choose from, those whose windows close next.
        as_set: Whether targets are observed as ``rows`` [N, n_ahead, features] with a ``mask`` instead of in one vector.
        benchmark: Whether angles of targets are divided by pi / 2, and the data buffer holds 1.6e11 bit instead of 1.6e10, as in
            the benchmark suite.
        **options: Arguments of :class:`~bsk_torch.SatelliteTasking` that replace those of the preset, and ``obs_type`` and
            ``sat_args`` of the satellite.
    """
    options = {"scenario": scene.UniformTargets(n_targets)} | options
    settings = looking_ahead(as_set=as_set, n_ahead=n_ahead, benchmark=benchmark)
    (satellite,) = imagers(AgileSatellite, ["EO1"], agile_args(benchmark), options, **settings)
    return agile_environment(satellite, options)


def aeos_city(
    *,
    n_targets: int = 1000,
    n_select_from: int | Literal["all"] | None = 5000,
    n_ahead: int = AHEAD,
    as_set: bool = False,
    **options: object,
) -> SatelliteTasking:
    """Return AEOSCity-v1: targets are ``n_targets`` of the ``n_select_from`` largest cities, drawn at reset; see :func:`aeos`."""
    options = {"scenario": scene.CityTargets(n_targets, n_select_from)} | options
    settings = looking_ahead(as_set=as_set, n_ahead=n_ahead)
    (satellite,) = imagers(AgileSatellite, ["EO1"], agile_args(), options, **settings)
    return agile_environment(satellite, options)


def cloud_forecast(satellite: sats.BoundSatellite, targets: sats.Opportunities) -> Tensor:
    """Return the forecast of the cloud cover over each target, [N, n] in [0, 1]."""
    return satellite.simulator.look_up(satellite.scenario.cloud_forecast, targets.place)


CLOUDS = dict(fn=cloud_forecast, name="cloud_forecast")
"""Target property observed by CloudyAEOS-v1 in addition to :data:`TARGET`."""


def cloudy_aeos(
    *, n_targets: int | tuple[int, int] = 1000, n_ahead: int = AHEAD, as_set: bool = False, **options: object
) -> SatelliteTasking:
    """Return CloudyAEOS-v1: only images without clouds are rewarded; see :func:`aeos`."""
    clouds = dict(scenario=scene.CloudyTargets(scene.UniformTargets(n_targets)), rewarder=data.CloudFreeImageReward())
    options = clouds | options
    settings = looking_ahead(CLOUDS, as_set=as_set, n_ahead=n_ahead)
    (satellite,) = imagers(AgileSatellite, ["EO1"], agile_args(), options, **settings)
    return agile_environment(satellite, options)
