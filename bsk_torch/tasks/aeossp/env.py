"""Cases of aeossp_standard as environments: satellites with body, wheels and battery choose among the requests of the case.

Satellites come from the element sets of the case, and slew as in :mod:`bsk_torch.tasks.aeossp.flight`. A look counts if pointing
and rate stay within the limits of :func:`bsk_torch.tasks.aeossp.fly` for as long as the task wants, between release and due time.

The off-nadir limit of a task is the largest of the satellites with its sensor. Satellites with a smaller one have a minimum
elevation instead, above which the off-nadir angle is within their limit everywhere on their orbits: it leaves out up to a
degree.

Observation of each satellite: for each of the tasks whose windows close next, weight, opening and closing, length of the look,
spare time, due time, the angle to it and its direction, and the charge. Actions: look at one of them, or wait for a minute.

Reward: the weight of a completed task as a share of all, so that the return is WCR. A satellite with an empty battery is lost,
which costs nothing else.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from datetime import timedelta
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from bsk_torch import ConstellationTasking, act, data, obs, rand, sats, scene
from bsk_torch.constants import R_EARTH
from bsk_torch.sim.component import Bus, Component
from bsk_torch.sim.dyn.models import ImagingDynModel
from bsk_torch.sim.fsw.look import LookFSWModel
from bsk_torch.sim.fsw.modes import Command, Mode
from bsk_torch.sim.fsw.reference_slew import ReferenceSlewFSWModel
from bsk_torch.tasks.aeossp.files import Case, read_case
from bsk_torch.tasks.aeossp.flight import ANGLE, RATE, TICK, UTC, crew_arguments
from bsk_torch.tasks.aeossp.geometry import tracks
from bsk_torch.tasks.aeossp.models import CASE_POWER, write_power

AHEAD = 24
"""Tasks that a satellite observes and chooses from."""

WAIT = 60.0
"""Duration of waiting, s."""

SLACK = math.radians(0.2)
"""By which elevations above the ellipsoid may differ from those above the sphere, rad."""

HOUR = 3600.0


def balance_power(bus: Bus) -> None:
    """Write the power of the battery, W; the load of imaging lasts from the beginning of a look to its image."""
    write_power(bus, (bus.look_ticks > 0.0) & (bus.image_taken < 0.5))


class CaseDynModel(ImagingDynModel):
    """A rigid body with wheels and the battery and powers of a case."""

    components: ClassVar[tuple[Component, ...]] = (
        dataclasses.replace(CASE_POWER, update=balance_power),
        Component(slot="wheel_power"),
    )


class CaseFSWModel(LookFSWModel, ReferenceSlewFSWModel):
    """Looks of a required length after reference slews; panels charge at any attitude, so that none turns to the Sun."""

    components: ClassVar[tuple[Component, ...]] = (Component(slot="sun_pointing"),)
    modes: ClassVar[dict[str, Mode | None]] = {"charge": None, "desat_sun": None}
    commands: ClassVar[dict[str, Command]] = {"desat": Command(("desat_nadir", "desat_none"), choice="desatAttitude")}


class CaseImager(sats.RequestSatellite):
    """A satellite of a case."""

    observation_spec: ClassVar[Sequence[obs.Observation]] = (
        obs.OpportunityProperties(
            dict(prop="priority", norm=5.0),
            dict(prop="opportunity_open", norm=600.0),
            dict(prop="opportunity_close", norm=600.0),
            dict(prop="look_duration", norm=60.0),
            dict(prop="look_slack", norm=60.0),
            dict(prop="time_to_due", norm=HOUR),
            dict(prop="target_angle", norm=math.pi),
            dict(prop="r_LB_H", norm=1e6),
            n_ahead_observe=AHEAD,
            as_set=True,
        ),
        obs.SatProperties(dict(prop="battery_charge_fraction")),
    )
    action_spec: ClassVar[Sequence[act.Action]] = (act.ImageRequest(n_ahead_image=AHEAD), act.Drift(duration=WAIT))
    dyn_type = CaseDynModel
    fsw_type = CaseFSWModel


def case_env(case: Case | str | Path, num_envs: int = 1, *, tick: float = TICK, **options: object) -> ConstellationTasking:
    """Return a case as an environment, the same in every episode.

    Args:
        case: The case, or its folder.
        num_envs: Number of environments.
        tick: Length of a tick, s.
        **options: Arguments of :class:`~bsk_torch.ConstellationTasking` that replace those of the case.

    Raises:
        OSError: If a file is missing, or cannot be read.
        ValueError: For another content of the files.
    """
    case = case if isinstance(case, Case) else read_case(case)
    usual = dict(time_limit=float(case.horizon_s), world_args={"utc_init": case.start.strftime(UTC)}, orbit="sgp4")
    return _env(case, _imaging_arguments(case, tick), _requests(case), tick, num_envs, usual | options)


def drawn_case_env(
    case: Case | str | Path, num_envs: int = 1, *, hours: float = 2.0, tick: float = TICK, **options: object
) -> ConstellationTasking:
    """Return an environment whose episodes are drawn in the manner of a case, to learn from.

    The first hours of an episode of the case have as many tasks as the case has in that time, at different places of the case.
    Times, lengths and weights are drawn from the case's own, independently of each other. Each satellite takes, in each episode,
    the orbit of any satellite of the case with the same limits.

    Args:
        case: The case, or its folder.
        num_envs: Number of environments.
        hours: Length of an episode, hours.
        tick: Length of a tick, s.
        **options: Arguments of :class:`~bsk_torch.ConstellationTasking` that replace those of the case.

    Raises:
        OSError: If a file is missing, or cannot be read.
        ValueError: For another content of the files.
    """
    case = case if isinstance(case, Case) else read_case(case)
    windows = case.requests.due_s - case.requests.release_s
    requests = _requests(
        case,
        rand.Choice(case.requests.weight.tolist()),
        release=rand.Uniform(-float(windows.mean()), float(case.horizon_s)),
        window=rand.Choice(windows.tolist()),
        duration=rand.Choice(case.requests.duration_s.tolist()),
    )
    arguments = _imaging_arguments(case, tick)
    orbits: dict[str, list[object]] = {}
    for satellite, row in zip(case.satellites, arguments, strict=True):
        orbits.setdefault(satellite.sensor, []).append(row["oe"])
    for satellite, row in zip(case.satellites, arguments, strict=True):
        row["oe"] = rand.Choice(orbits[satellite.sensor])
        del row["sigma_init"], row["omega_init"]
    starts = [(case.start + timedelta(hours=hour)).strftime(UTC) for hour in range(0, 48, 6)]
    usual = dict(time_limit=HOUR * hours, world_args={"utc_init": rand.Choice(starts)})
    return _env(case, arguments, requests, tick, num_envs, usual | options)


def _env(
    case: Case,
    arguments: Sequence[dict[str, Any]],
    requests: scene.Requests,
    tick: float,
    num_envs: int,
    options: dict[str, Any],
) -> ConstellationTasking:
    satellites = [
        CaseImager(satellite.name, row, sensor_types=[satellite.sensor], obs_type=dict)
        for satellite, row in zip(case.satellites, arguments, strict=True)
    ]
    return ConstellationTasking(satellites, requests, data.RequestReward(), num_envs=num_envs, sim_rate=tick, **options)


def _imaging_arguments(case: Case, tick: float) -> list[dict[str, object]]:
    """Return the arguments of the satellites: those of flights of plans, and what looks ask for."""
    crew = range(len(case.satellites))
    radius = np.linalg.norm(tracks(case).r, axis=-1).min(-1)
    looks = {
        "imageAttErrorRequirement": math.tan(0.25 * ANGLE),  # the norm of an MRP
        "imageRateErrorRequirement": RATE,
        "instrumentBaudRate": 1.0,
        "dataStorageCapacity": 1e9,
        "disturbance_vector": [0.0, 0.0, 0.0],
    }
    rows = crew_arguments(case, crew, tick, np.ones(len(crew)))
    return [row | looks | {"imageTargetMinimumElevation": _least_elevation(case, k, radius[k])} for k, row in enumerate(rows)]


def _least_elevation(case: Case, number: int, radius: float) -> float:
    """Return the elevation above which the off-nadir angle is within a satellite's limit, rad; 0 if tasks have that limit.

    With the Earth's radius R and the satellite at r, ``R cos(elevation) = r sin(off-nadir)``, as on a sphere.
    """
    satellite = case.satellites[number]
    if satellite.off_nadir >= _widest(case, satellite.sensor):
        return 0.0
    return math.acos(radius / R_EARTH * math.sin(math.radians(satellite.off_nadir))) + SLACK


def _requests(case: Case, weight: object = None, **times: object) -> scene.Requests:
    """Return the tasks of a case, or with another ``weight`` and ``times``."""
    requests = case.requests
    weights = requests.weight if weight is None else weight
    places = scene.Targets.from_geodetic(requests.latitude, requests.longitude, requests.altitude, weights, list(requests.names))
    listed = dict(release=requests.release_s, due=requests.due_s, duration=requests.duration_s)
    limits = {"max_off_nadir": np.radians([_widest(case, sensor) for sensor in requests.sensor])}
    return scene.Requests(places, **((times or listed) | limits), sensors=list(requests.sensor))


def _widest(case: Case, sensor: str) -> float:
    """Return the largest off-nadir limit of satellites with a sensor, deg; 90 without such a satellite."""
    return max((satellite.off_nadir for satellite in case.satellites if satellite.sensor == sensor), default=90.0)
