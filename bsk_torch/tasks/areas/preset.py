"""Areas-v1 and AreasTeam-v1: record areas on the ground, cell by cell, with an instrument that fills the store.

One satellite of :mod:`bsk_torch.presets.nadir_scan`, with more data, a wider swath, half of the store, two thirds of the panel
and 0.6 of the rate of downlinks, flies five orbits over 500 areas, which differ between episodes. The store is full after ten
minutes of recording, whatever lies below, so that only areas are worth it, and not all of them.

In AreasTeam-v1, three such satellites fly one behind the other, 8 degrees apart, over the same areas, on a circular orbit 500 km
high, whose inclination is uniform from 40 to 98 degrees. Each observes and does what that of Areas-v1 does, so that policies of
Areas-v1 can fly it. What one has recorded is no longer due for the others, which see that at once; they do not observe each
other's batteries and stores. Downlinks of a full store take five minutes, and each ground station has one antenna, for which the
satellites contend.

Observation, 96 numbers: the twelve of NadirScan-v1; ``areas`` (36), for each of the four areas whose windows close next, see
:class:`~bsk_torch.tasks.areas.AreaProperties`; and ``outlook`` (48), see :class:`~bsk_torch.tasks.areas.AreaOutlook`:

======================================  ==========================================================================
``opens``, ``closes``                   time until the window opens and closes, divided by 5700 s, from 0 to 1
``weight``                              weight of the area
``remaining``                           share of its surface that has not been recorded
``gain``                                the part of it that a scan along the rest of the window would record
``offset``                              distance of its center from the track, as a fraction of the reach, from -1 to 1
``pays``                                ``weight`` times ``gain``
``opens_soon``, ``closes_soon``         exp(-t / 240 s) for the time t until the window opens or closes, from 0 to 1
``worth`` (24)                          what scans would bring in each of the next 64 minutes' intervals: eight of 60 s,
                                        eight of 120 s, and eight of 300 s
``in_view`` (24)                        the part of each interval in which a ground station is in view
======================================  ==========================================================================

Actions: 0 scan (60 s), 1 charge (60 s), 2 downlink (60 s), 3 desaturate the wheels (60 s).

Reward: weight of the area times share of its surface for every cell recorded for the first time: each area pays its
weight in all; -1 if the satellite dies. See :class:`~bsk_torch.tasks.areas.AreaReward` for rewards of revisits, or at the end.

Termination: as in NadirScan-v1; and at the time limit of 28,500 s, which truncates.

Eclipses are observed as in NadirScan-v1.

Random at reset: as in NadirScan-v1; 500 of 1000 round areas with radii of 100 to 400 km between the latitudes of 75 degrees, and
their weights, uniform in [0, 1). The swath is 300 km wide, a cell about 100 km.
"""

from __future__ import annotations

import functools
from typing import Any, ClassVar

import torch

from bsk_torch import act, formations, rand
from bsk_torch.env import ConstellationTasking, SatelliteTasking
from bsk_torch.presets.nadir_scan import BATTERY, ORBIT, ScanningSatellite, scanning_args
from bsk_torch.sim.environment.world import DEFAULT_STATIONS
from bsk_torch.tasks.areas.cells import Area, random_caps
from bsk_torch.tasks.areas.fsw import AreaScanFSWModel
from bsk_torch.tasks.areas.obs import AreaOutlook, AreaProperties
from bsk_torch.tasks.areas.reward import AreaReward
from bsk_torch.tasks.areas.scene import Areas

SWATH, CELL = 300e3, 100e3
"""Width of the recorded ground, and side of a cell, m."""

STEP = 60.0
"""Duration of an action, s."""

STORE = 2500 * 8e6
"""Capacity of the data buffer, bit."""

RATE = 4 * 8e6
"""Data rate of the instrument, bit/s: it fills the store in 625 s."""

APART = 8.0
"""Angle at the Earth's center between two satellites of a team, degrees: two minutes of flight."""

SLOW_DOWNLINK = 8 * 8e6
"""Rate of downlinks in a team, bit/s: a full store takes 312 s, and a pass eight minutes at most."""


@functools.cache
def round_areas() -> tuple[Area, ...]:
    """Return the areas of which each episode draws some."""
    return tuple(random_caps(1000, CELL))


class AreaScanner(ScanningSatellite):
    """The satellite of NadirScan-v1 with a trace of its swath."""

    observation_spec = (*ScanningSatellite.observation_spec, AreaProperties(n_ahead_observe=4), AreaOutlook())
    action_spec = (act.Scan(duration=STEP), act.Charge(duration=STEP), act.Downlink(duration=STEP), act.Desat(duration=STEP))
    fsw_type: ClassVar[type[AreaScanFSWModel]] = AreaScanFSWModel


def area_args() -> dict[str, Any]:
    """Return the arguments of the satellite, with distributions for random ones."""
    return scanning_args() | dict(
        dataStorageCapacity=STORE,
        storageInit=rand.Uniform(0.0, 0.8 * STORE),
        instrumentBaudRate=RATE,
        transmitterBaudRate=-30 * 8e6,
        panelArea=0.17,
        imageAttErrorRequirement=0.01,
        storedCharge_Init=rand.Uniform(0.3 * BATTERY, BATTERY),
    )


def areas(
    *,
    sat_args: dict[str, Any] | None = None,
    obs_type: type = torch.Tensor,
    n_areas: int = 500,
    revisit: float | None = None,
    **options: Any,
) -> SatelliteTasking:
    """Return Areas-v1; see the module.

    Args:
        sat_args: Arguments of the satellite that replace those of the preset.
        obs_type: ``torch.Tensor`` for one vector, ``dict`` for named observations.
        n_areas: Number of areas of an episode, up to 1000.
        revisit: Time after which a recorded cell pays again, s; None for never. See :class:`~bsk_torch.tasks.areas.Areas`.
        **options: Arguments of :class:`~bsk_torch.SatelliteTasking` that replace those of the preset.
    """
    satellite = AreaScanner("Scanner1", area_args() | (sat_args or {}), obs_type=obs_type, may_see_nothing=True)
    return SatelliteTasking(satellite, **(_parts(n_areas, revisit) | options))


def areas_team(
    *,
    n_satellites: int = 3,
    sat_args: dict[str, Any] | None = None,
    obs_type: type = torch.Tensor,
    n_areas: int = 500,
    revisit: float | None = None,
    **options: Any,
) -> ConstellationTasking:
    """Return AreasTeam-v1; see the module, and :func:`areas` for the other arguments.

    Args:
        n_satellites: Number of satellites, one behind the other.
        sat_args: Arguments of all satellites that replace those of the preset.
        obs_type: See :func:`areas`.
        n_areas: See :func:`areas`.
        revisit: See :func:`areas`.
        **options: Arguments of :class:`~bsk_torch.ConstellationTasking` that replace those of the preset.
    """
    arguments = area_args() | {"transmitterBaudRate": -SLOW_DOWNLINK} | (sat_args or {})
    satellites = [AreaScanner(f"Scanner{k + 1}", arguments, obs_type=obs_type, may_see_nothing=True) for k in range(n_satellites)]
    parts = dict(
        sat_arg_randomizer=formations.train_args(APART, inc=rand.Uniform(40.0, 98.0)),
        world_args={"groundStationsData": [station | {"antennas": 1} for station in DEFAULT_STATIONS]},
    )
    return ConstellationTasking(satellites, **(_parts(n_areas, revisit) | parts | options))


def _parts(n_areas: int, revisit: float | None) -> dict[str, Any]:
    scenario = Areas(round_areas(), SWATH, n_areas, weights=rand.Uniform(), revisit=revisit)
    return dict(scenario=scenario, rewarder=AreaReward(), time_limit=5 * ORBIT, failure_penalty=-1.0)
