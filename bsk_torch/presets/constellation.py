"""Constellation-v1, AEOSConstellation-v1 and RelayConstellation-v1: constellations that image targets.

AEOSConstellation-v1 is the task ``aeos_constellation`` of BSK-RL's benchmark suite. The other two exist only in this package.

========================  =============================  ==========================  ==================================
preset                    Constellation-v1               AEOSConstellation-v1        RelayConstellation-v1
========================  =============================  ==========================  ==================================
satellites                12 imagers                     3 imagers                   4 imagers, 2 relays
orbits                    Walker 45:12/3/1, 800 km       one plane, 45 deg, 800 km   imagers 45 deg, 500 km; relays
                                                                                     60 deg, 2500 km
targets                   5,000                          100 to 9,999                500
communication             along lines of sight           all, once a minute          broadcasts along lines of sight
tick                      1 s                            0.5 s                       1 s
penalty of a death        none                           none                        -1
========================  =============================  ==========================  ==================================

Observation of an imager, 141 numbers (269 in AEOSConstellation-v1): as in AEOS-v1 (:mod:`bsk_torch.presets.aeos`), for the next
16 targets (32), without targets that the satellite knows to be imaged. Observation of a relay, 7 numbers:
``battery_charge_fraction``, ``r_BN_P_normd`` (3, divided by the radius of the Earth), ``eclipse`` (2, times divided by 5700 s)
and ``time`` (divided by the time limit).

Actions of an imager: image one of these targets; in RelayConstellation-v1, the next action is to broadcast (1 s). Actions of a
relay: 0 charge (300 s), 1 point at nadir (300 s), 2 broadcast (60 s). The last action of every space continues the current task.

Reward: the priority of a target for its first image, shared by satellites that take it in the same step.

Termination: at the time limit of 17,100 s (three orbits of AEOS-v1). A satellite with an empty battery dies and leaves.

Eclipses of relays are observed with ``obs.Eclipse(sampled=True)``: up to 30 s late, and, where none comes, at
one second after reset.
Windows that open after the time limit are legal: ``act.Image(mask_late=False)``.

Random at reset: common node and phase of the orbits; number, positions and priorities of targets.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

from bsk_torch import act, comm, data, formations, obs, sats, scene
from bsk_torch.constants import R_EARTH
from bsk_torch.env import ConstellationTasking
from bsk_torch.presets.aeos import AHEAD, ALTITUDE, ORBIT, SOON, AgileSatellite, agile_args, imagers, looking_ahead
from bsk_torch.sim import dyn, fsw

CHOICES = 16
"""Number of observed targets of an imager in Constellation-v1 and RelayConstellation-v1."""

RELAY_ALTITUDE = 2500.0
"""Altitude of the relays, km. The Earth blocks two relays half an orbit apart, but each sees low imagers on its side."""


class LinkedDynModel(dyn.ImagingDynModel, dyn.LOSCommDynModel):
    """Dynamics of an imager that communicates along lines of sight."""


class RelayDynModel(dyn.BasicDynamicsModel, dyn.LOSCommDynModel):
    """Dynamics of a relay that communicates along lines of sight."""


class LinkedImager(AgileSatellite):
    """An imager of AEOS-v1 that communicates."""

    dyn_type = LinkedDynModel


class BroadcastingImager(LinkedImager):
    """Can also broadcast its knowledge of images."""


class BroadcastingSetImager(BroadcastingImager):
    """The same, observing targets as a set; groups of agents are named after the classes."""


class Relay(sats.Satellite):
    """Relays knowledge of images, and must keep its battery charged."""

    observation_spec: ClassVar[Sequence[obs.Observation]] = (
        obs.SatProperties(dict(prop="battery_charge_fraction"), dict(prop="r_BN_P", norm=R_EARTH)),
        obs.Eclipse(norm=ORBIT, sampled=True),
        obs.Time(),
    )
    action_spec: ClassVar[Sequence[act.Action]] = (
        act.Charge(duration=SOON),
        act.NadirPoint(duration=SOON),
        act.Broadcast(duration=60.0),
    )
    dyn_type = RelayDynModel
    fsw_type = fsw.BasicFSWModel


def names_of(count: int) -> list[str]:
    """Return the names of imagers."""
    return [f"EO{k + 1}" for k in range(count)]


class BroadcastInSight(comm.BroadcastCommunication, comm.LOSCommunication):
    """Broadcasts received by satellites with a line of sight."""


def steady_args() -> dict[str, object]:
    """Return arguments of agile imagers whose attitude control is stable with ticks of 1 s."""
    return {name: value for name, value in agile_args().items() if name != "oe"} | dict(K1=0.5, K3=3.0, servo_Ki=5.0)


def defaults() -> dict[str, Any]:
    """Return the arguments shared by all environments of this module."""
    return dict(
        rewarder=data.UniqueImageReward(),
        time_limit=3 * ORBIT,
        max_step_duration=SOON,
        failure_penalty=0.0,
        terminate_on_time_limit=True,
    )


def constellation(
    *,
    n_satellites: int = 12,
    n_planes: int = 3,
    phasing: int | None = None,
    n_targets: int | tuple[int, int] = 5000,
    as_set: bool = False,
    **options: Any,
) -> ConstellationTasking:
    """Return Constellation-v1; see the module.

    Args:
        n_satellites: Number of satellites.
        n_planes: Number of their orbital planes.
        phasing: Phase between neighboring planes, in units of 360 degrees divided by the number of satellites; None for 1, or
            0 for a single plane.
        n_targets: Number of targets shared by all satellites, or its range (the upper end excluded).
        as_set: Whether targets are observed as ``rows`` [N, S, 16, features] with a ``mask`` instead of in one vector.
        **options: Arguments of the environment to override, and ``variable_interval`` of the satellites; ``sat_args`` are merged
            with the preset's.
    """
    settings = looking_ahead(as_set=as_set, n_ahead=CHOICES)
    satellites = imagers(LinkedImager, names_of(n_satellites), steady_args(), options, **settings)
    parts = dict(
        scenario=scene.UniformTargets(n_targets),
        communicator=comm.LOSCommunication(),
        sat_arg_randomizer=formations.walker_delta_args(
            n_planes, phasing=min(1, n_planes - 1) if phasing is None else phasing, altitude=ALTITUDE / 1e3, inc=45.0
        ),
    )
    return ConstellationTasking(satellites, **(defaults() | parts | options))


def aeos_constellation(
    *,
    n_satellites: int = 3,
    n_targets: int | tuple[int, int] = (100, 10_000),
    n_ahead: int = AHEAD,
    as_set: bool = False,
    benchmark: bool = False,
    **options: Any,
) -> ConstellationTasking:
    """Return AEOSConstellation-v1; see the module, and :func:`constellation` and :func:`bsk_torch.presets.aeos.aeos`."""
    settings = looking_ahead(as_set=as_set, n_ahead=n_ahead, benchmark=benchmark)
    arguments = {name: value for name, value in agile_args(benchmark).items() if name != "oe"}
    satellites = imagers(AgileSatellite, names_of(n_satellites), arguments, options, **settings)
    parts = dict(
        scenario=scene.UniformTargets(n_targets),
        communicator=comm.FreeCommunication(min_period=60.0),
        sat_arg_randomizer=formations.walker_delta_args(1, altitude=ALTITUDE / 1e3, inc=45.0),
        sim_rate=0.5,
    )
    return ConstellationTasking(satellites, **(defaults() | parts | options))


def relay_constellation(
    *,
    n_imagers: int = 4,
    n_relays: int = 2,
    n_targets: int | tuple[int, int] = 500,
    as_set: bool = False,
    **options: Any,
) -> ConstellationTasking:
    """Return RelayConstellation-v1: low imagers without line of sight to each other, and high relays; see the module.

    Groups of agents are ``broadcasting_imager``, or ``broadcasting_set_imager`` with ``as_set=True``, and ``relay``. Arguments
    are those of :func:`constellation`; ``sat_args`` are merged with those of the imagers, ``relay_args`` with the relays' own.
    """
    relay_args = dict(basePowerDraw=-60.0, batteryStorageCapacity=1e6, storedCharge_Init=5e5) | options.pop("relay_args", {})
    kind: type[BroadcastingImager] = BroadcastingSetImager if as_set else BroadcastingImager
    settings = looking_ahead(as_set=as_set, n_ahead=CHOICES)
    settings["action_spec"] = (*settings["action_spec"], act.Broadcast(duration=1.0))
    low = imagers(kind, names_of(n_imagers), steady_args(), options, **settings)
    relays = [Relay(f"Relay{k + 1}", relay_args) for k in range(n_relays)]
    parts = dict(
        scenario=scene.UniformTargets(n_targets),
        communicator=BroadcastInSight(),
        sat_arg_randomizer=formations.together(
            {
                tuple(satellite.name for satellite in low): formations.walker_delta_args(1, altitude=500.0, inc=45.0),
                tuple(satellite.name for satellite in relays): formations.walker_delta_args(1, altitude=RELAY_ALTITUDE, inc=60.0),
            }
        ),
        failure_penalty=-1.0,
    )
    return ConstellationTasking([*low, *relays], **(defaults() | parts | options))
