"""ThreeSensors-v1 and Walker4-v1: satellites image the same objects in orbit, each by what it knows of the others' images.

The tasks are those of studies of multi-agent imaging in BSK-RL's public branches of 2026.

=====================  ==========================================  =====================================================
preset                 ThreeSensors-v1                             Walker4-v1
=====================  ==========================================  =====================================================
orbits                 700, 800, 700 km; 97, 70, 97 degrees;       Walker delta 97:4/2/1, 700 km, circular; node and
                       nodes at 0, 30, 60 degrees, anomalies at    phase are random
                       0, 15, 30 degrees, eccentricity 0.001
objects                100 low ones                                50 low, 30 medium, 20 geosynchronous
others' images         unknown (``information="independent"``)     what the radio tells (``information="radio"``)
=====================  ==========================================  =====================================================

Observation, 26 + 10 x 17 + 12 numbers for each peer: 232 in Walker4-v1, 220 in ThreeSensors-v1 with a radio, and 196 without one.
First the 14 of the imager itself in Services-v1 (:mod:`bsk_torch.tasks.objects.preset`), then:

=====================================  ==========================================================================
``task_status``:                       see :class:`~bsk_torch.tasks.objects.RSOTaskStatus`; times are divided by 12,000 s:
``task`` (5)                           1 for the task in progress: charge, downlink, desaturate, transmit, image
``elapsed``, ``remaining``             time since the task began, and until it ends at the latest
``held``                               time held of an image or a packet, as a fraction
``untold``                             records that some other imager has not been told of, per object
``exchange_age``, ``exchange_known``   time since the last message of or to any other imager, and whether there is one
``busy``                               1 if a task is in progress
``rso_targets``:                       for each of the next 10 candidates:
``priority``                           priority, divided by 10
``rel_pos_vector_r_BR_H`` (3)          position relative to the imager in its Hill frame, divided by 15,960 km
``rel_vel_vector_v_BR_H`` (3)          difference of the inertial velocities in the same frame, divided by 12 km/s
``angle_to_target``                    angle between instrument and candidate, divided by 90 degrees
``target_distance``                    distance, divided by 15,960 km
``target_illumination_factor``         visible fraction of the Sun at the candidate
``capture_age``, ``capture_known``     time since the latest known capture, divided by 12,000 s; whether there is one
``delivery_age``, ``delivery_known``   the same of captures known to be delivered
``on_board``                           1 if an image of it waits for a downlink
``in_progress``                        1 if it is being imaged
``valid``                              1 if there is a candidate
``peers``:                             for each peer, with a radio, see :class:`~bsk_torch.tasks.objects.RSOPeers`:
``r_H`` (3), ``v_H`` (3)               position and velocity relative to the imager, as of candidates
``angle``, ``distance``                angle from the instrument, divided by 180 degrees; distance, divided by 15,960 km
``news``                               records that the peer has not been told of, per object
``exchange_age``, ``exchange_known``   time since the last message between both, and whether there is one
``valid``                              1 if the imager can transmit to the peer
=====================================  ==========================================================================

Actions: 0 charge (300 s), 1 downlink (until the store is empty; 10 to 300 s), 2 desaturate the wheels (150 s), 3 to 12 image the
candidates 0 to 9 (at most 300 s), with a radio 13 to 15 transmit to a peer (at most 300 s). The last action continues the task.
With ``retasking="conflict"``, a busy imager decides if it is told of a recent image of its object; with ``"continuous"``, all
decide at the end of each step, and choosing the task in progress continues it.

With ``shielded=True``, ``action_mask`` excludes downlinks with an empty store.

Reward: an image with at least half of the Sun at its object, on average over the 10 s that it must be held, pays 0.9 of the
priority when it is taken and 0.1 when it has been downlinked, each only if taken two orbits after the one paid last; see
:class:`~bsk_torch.tasks.objects.RSOTeamReward`. A downlink with an empty store costs 1, and so does a death.

Termination: a satellite whose battery is empty, whose wheels are at their maximum speed or whose orbit is too low dies and
leaves. At the time limit of 45,000 s, the episode is truncated.

Random at reset: orbits and priorities of the objects, the latter with a sum of 100; attitudes; in Walker4-v1 also the pattern.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, cast

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch import act, comm, data, formations, obs, sats
from bsk_torch._checks import switch
from bsk_torch.astro.elements import ClassicElements
from bsk_torch.env import ConstellationTasking
from bsk_torch.sim.dyn.events import LEFT_OVER
from bsk_torch.sim.names import one_of
from bsk_torch.tasks.objects.comm import CatalogCommunication
from bsk_torch.tasks.objects.fsw import CatalogRadioFSWModel
from bsk_torch.tasks.objects.obs import RSOTargetProperties
from bsk_torch.tasks.objects.preset import (
    BATTERY,
    CANDIDATES,
    EPISODE,
    MIXTURE,
    ORDERS,
    OUTLOOK,
    ServicingDynModel,
    ServicingImager,
    own_properties,
    servicing_args,
    servicing_catalog,
)
from bsk_torch.tasks.objects.radio import CatalogRadioDynModel
from bsk_torch.tasks.objects.scene import RSOTargets
from bsk_torch.tasks.objects.team_act import TransmitCatalog
from bsk_torch.tasks.objects.team_obs import LONG, RSOPeers, RSOTaskStatus
from bsk_torch.tasks.objects.team_reward import RSOTeamReward

COMMUNICATORS = {"independent": comm.NoCommunication, "ideal": comm.FreeCommunication, "radio": CatalogCommunication}
"""What imagers are told of the images of others, by name."""

RETASKING = ("conflict", "continuous")
"""When busy imagers decide."""

EARTH = 6371e3
"""Radius above which altitudes are counted, m."""

ORBITS = ((700e3, 97.0), (800e3, 70.0), (700e3, 97.0))
"""Altitudes, m, and inclinations, degrees, of three sensors."""

CANDIDATE = (
    dict(prop="priority", norm=10.0),
    dict(prop="rel_pos_vector_r_BR_H", norm=15960e3),
    dict(prop="rel_vel_vector_v_BR_H", norm=12e3),
    dict(prop="angle_to_target", norm=90.0),
    dict(prop="target_distance", norm=15960e3),
    dict(prop="target_illumination_factor"),
    dict(prop="capture_age", norm=LONG),
    dict(prop="capture_known"),
    dict(prop="delivery_age", norm=LONG),
    dict(prop="delivery_known"),
    dict(prop="on_board"),
    dict(prop="in_progress"),
    dict(prop="valid"),
)
"""Observed properties of candidates."""

SIGHTED = (*CANDIDATE, dict(prop="in_sight"))
"""The same, and what the studies do not observe: whether the Earth is not in the way."""


class SensorDynModel(CatalogRadioDynModel, ServicingDynModel):
    """Dynamics of an imager of objects in orbit with a radio to other imagers."""


class Sensor(ServicingImager):
    """Images objects in orbit, and knows its images and those that it is told of."""

    dyn_type = SensorDynModel
    fsw_type = CatalogRadioFSWModel

    @override
    def legal_actions(self) -> Tensor | None:
        if not self.shielded:
            return None
        satellite = cast(sats.BoundSatellite, self)
        empty = satellite.dynamics.storage_level <= LEFT_OVER
        return act.forbid(satellite.action_description, "action_downlink", where=empty)


def observed(peers: int, as_set: bool = False, outlook: bool = False) -> tuple[obs.Observation, ...]:
    """Return the observations of a sensor that tells so many ``peers`` of images; for the other arguments, see the presets."""
    properties = (*SIGHTED, *(OUTLOOK if outlook else ())) if as_set else CANDIDATE
    return (
        *own_properties(),
        RSOTaskStatus(norm=LONG),
        *((obs.Time(),) if outlook else ()),
        RSOTargetProperties(*properties, n_ahead_observe=CANDIDATES, as_set=as_set),
        *((RSOPeers(peers),) if peers else ()),
    )


def team(
    orbits: Sequence[dict[str, Any]],
    *,
    mixture: tuple[float, float, float] | str,
    information: str,
    retasking: str,
    n_targets: int,
    delivery_share: float,
    sat_args: dict[str, object] | None,
    obs_type: type | None,
    order: str,
    as_set: bool,
    outlook: bool,
    shielded: bool,
    options: dict[str, object],
) -> ConstellationTasking:
    """Return a team of sensors, with arguments of each orbit."""
    ranks = ORDERS[one_of("order", order, ORDERS)]
    communicator = COMMUNICATORS[one_of("information", information, COMMUNICATORS)]
    names = [f"SS{k + 1}" for k in range(len(orbits))]
    common = servicing_args() | dict(storedCharge_Init=0.9 * BATTERY, wheelSpeeds=[0.0, 0.0, 0.0])
    if switch("outlook", outlook) and not switch("as_set", as_set):
        raise ValueError("outlook=True needs as_set=True: what is expected of images is observed of candidates in a set")
    peers = len(names) - 1 if information == "radio" else 0
    settings: dict[str, Any] = dict(
        obs_type=(dict if as_set else torch.Tensor) if obs_type is None else obs_type,
        observation_spec=observed(peers, as_set, outlook),
        action_spec=(*Sensor.action_spec, *((TransmitCatalog(peers),) if peers else ())),
    )
    satellites = [Sensor(name, common | orbit | (sat_args or {}), **settings) for name, orbit in zip(names, orbits, strict=True)]
    for satellite in satellites:
        satellite.shielded = switch("shielded", shielded)
    catalog = servicing_catalog(n_targets, mixture, exact_mixture=True, priority_event=False)
    defaults: dict[str, Any] = dict(
        scenario=RSOTargets(catalog, names, knowledge="own", order=ranks),
        rewarder=(RSOTeamReward(delivery_share=delivery_share), data.OperationsPenalty(empty_downlink=-1.0)),
        communicator=communicator(),
        time_limit=EPISODE,
        max_step_duration=300.0,
        failure_penalty=-1.0,
        mask_busy=one_of("retasking", retasking, RETASKING) == "conflict",
        continue_repeated=True,
    )
    return ConstellationTasking(satellites, **(defaults | options))


def three_sensors(
    *,
    n_targets: int = 100,
    mixture: tuple[float, float, float] | str = "LEO",
    information: str = "independent",
    retasking: str = "conflict",
    delivery_share: float = 0.1,
    sat_args: dict[str, object] | None = None,
    order: str = "elevation",
    as_set: bool = False,
    outlook: bool = False,
    shielded: bool = False,
    obs_type: type | None = None,
    **options: object,
) -> ConstellationTasking:
    """Return ThreeSensors-v1; see the module.

    Args:
        n_targets: Number of objects.
        mixture: Shares of low, medium and geosynchronous orbits, or ``"LEO"``; exactly these.
        information: What imagers are told: nothing (``"independent"``), the records of all at the end of each step (``"ideal"``),
            or what they send each other (``"radio"``).
        retasking: ``"conflict"`` or ``"continuous"``; see the module.
        delivery_share: Share of the priority that is paid when an image has been downlinked.
        sat_args: Arguments of the satellites that replace those of the preset.
        obs_type: ``torch.Tensor`` for one vector, ``dict`` for named observations (default: with ``as_set``).
        order: Order of the candidates: ``"elevation"``, the one of the studies, or ``"priority_per_second"``; see
            :func:`~bsk_torch.tasks.objects.by_priority_per_second`.
        as_set: Whether candidates are observed as ``rows`` [N, 10, 18] with a ``mask`` instead of in one vector; the last
            number is 1 where the Earth does not hide the candidate.
        outlook: Whether to observe the elapsed fraction of the episode as well, and five more properties of each candidate in
            the set; see :func:`bsk_torch.tasks.objects.preset.services`.
        shielded: Whether ``action_mask`` excludes downlinks with an empty store.
        **options: Arguments of :class:`~bsk_torch.ConstellationTasking` that replace those of the preset.
    """
    orbits = [
        dict(oe=elements(EARTH + altitude, 0.001, inclination, 30.0 * k, 15.0 * k))
        for k, (altitude, inclination) in enumerate(ORBITS)
    ]
    return team(
        orbits,
        mixture=mixture,
        information=information,
        retasking=retasking,
        n_targets=n_targets,
        delivery_share=delivery_share,
        sat_args=sat_args,
        obs_type=obs_type,
        order=order,
        as_set=as_set,
        outlook=outlook,
        shielded=shielded,
        options=options,
    )


def elements(a: float, e: float, i: float, Omega: float, f: float) -> ClassicElements:
    """Return orbital elements from a semi-major axis, m, and angles in degrees; the argument of perigee is zero."""
    angles = torch.deg2rad(torch.tensor([i, Omega, 0.0, f], dtype=torch.float64)).tolist()
    return ClassicElements(a, e, *angles)


def walker4(
    *,
    n_targets: int = 100,
    mixture: tuple[float, float, float] | str = MIXTURE,
    information: str = "radio",
    retasking: str = "conflict",
    delivery_share: float = 0.1,
    sat_args: dict[str, object] | None = None,
    order: str = "elevation",
    as_set: bool = False,
    outlook: bool = False,
    shielded: bool = False,
    obs_type: type | None = None,
    **options: object,
) -> ConstellationTasking:
    """Return Walker4-v1; see the module. Arguments and errors are those of :func:`three_sensors`."""
    pattern = formations.walker_delta_args(2, phasing=1, altitude=700.0, inc=97.0)
    return team(
        [{}] * 4,
        mixture=mixture,
        information=information,
        retasking=retasking,
        n_targets=n_targets,
        delivery_share=delivery_share,
        sat_args=sat_args,
        obs_type=obs_type,
        order=order,
        as_set=as_set,
        outlook=outlook,
        shielded=shielded,
        options=dict(sat_arg_randomizer=pattern) | options,
    )
