"""Services-v1: image satellites and debris again and again, and downlink the images, as in a branch of BSK-RL of 2026.

The task is that of the study of space-to-space imaging for AMOS 2026 in BSK-RL's public branches: a satellite in a circular orbit
at 500 km images 200 objects in low, medium and geosynchronous orbits. It does not know whether an image is good: that is verified
on the ground.

Observation, 124 numbers:

======================================  ==========================================================================
``storage_level_fraction``              data in the store as a fraction of the capacity of 50 images
``battery_charge_fraction``             battery charge as a fraction of the capacity
``wheel_speeds_fraction`` (3)           wheel speeds as fractions of the maximum speed
``sun_hat_H`` (3)                       direction of the Sun in the Hill frame
``eclipse`` (2)                         time until the next eclipse begins and ends, divided by 5700 s
``ground_station`` (4)                  time until each of the next two passes opens and closes, divided by 5700 s
``rso_targets`` (110)                   for each of the next 10 candidates, see :class:`~bsk_torch.tasks.objects.RSOTargets`:
``priority``                            priority, divided by 2
``target_elevation_angle``              angle above the local horizontal, divided by 90 degrees
``rel_pos_vector_r_BR_H`` (3)           position relative to the satellite in the Hill frame, divided by 15,960 km
``rel_vel_vector_v_BR_H`` (3)           difference of the inertial velocities in the same frame, divided by 16 km/s
``angle_to_target``                     angle between instrument and candidate, divided by 90 degrees
``target_distance``                     distance, divided by 15,960 km
``target_illumination_factor``          visible fraction of the Sun at the candidate
======================================  ==========================================================================

Actions: 0 charge (300 s), 1 downlink (until the store is empty; 10 to 300 s), 2 desaturate the wheels (150 s), 3 to 12 image
the candidates 0 to 9 (at most 300 s). An image is taken in the first tick in which pointing and line of sight are right, and
the satellite must keep both for 10 s in all; see ``exposure="first"`` of :class:`~bsk_torch.tasks.objects.ImageRSO`. Slots
without a candidate are masked; the branch repeats the last candidate there.

Reward: a good image that has been downlinked pays the priority of its object. An image is good if at least half of the Sun was
visible at the object, on average over the 10 s. With ``delivery_share`` below 1, the rest is paid when the image is taken. With
``advance``, a share is paid then, and paid back at the time limit for images that have not been downlinked. A
downlink with an empty store costs 1, and the death of the satellite 1. An object is no candidate while its image is on board, nor
in the two orbits after a good image was taken, as soon as this has been downlinked.

Termination: as in NadirScan-v1 (:mod:`bsk_torch.presets.nadir_scan`); and at the time limit of 45,000 s, which truncates.

Eclipses are observed with ``obs.Eclipse(sampled=True)``: up to 30 s late, and, where none comes, at one second
after reset.

Random at reset: orbit, attitude, charge and wheel speeds; orbits of the objects, half of which are low, 30 percent medium and
20 percent geosynchronous on average, see :class:`~bsk_torch.tasks.objects.RSOMixture`; and their priorities, uniform and scaled
to a sum of 100. From the first decision after half of the episode on, five objects have the priority 5, and three others 10.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar, cast

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch import act, data, obs, rand, sats
from bsk_torch._checks import number, switch, whole
from bsk_torch.act import forbid
from bsk_torch.env import SatelliteTasking
from bsk_torch.presets.nadir_scan import ORBIT
from bsk_torch.sats import BoundSatellite
from bsk_torch.sim import dyn
from bsk_torch.sim.dyn import Now, observable
from bsk_torch.sim.names import one_of
from bsk_torch.tasks.objects.act import ImageRSO
from bsk_torch.tasks.objects.catalog import RandomRSOCatalog, RSOPriorityEvent
from bsk_torch.tasks.objects.dyn import SpaceToSpaceImagingDynModel
from bsk_torch.tasks.objects.fsw import SpaceToSpaceImagingFSWModel
from bsk_torch.tasks.objects.mixture import RSOMixture
from bsk_torch.tasks.objects.obs import DEFAULT, EXPECTED_RATE, RSOTargetProperties
from bsk_torch.tasks.objects.outlook import by_priority_per_second, by_priority_per_second_ahead, expected_rate
from bsk_torch.tasks.objects.reward import RSOImageReward
from bsk_torch.tasks.objects.scene import Order, RSOTargets
from bsk_torch.vec3 import Vec3

OUTLOOK = (
    {"prop": "expected_duration", "norm": 100},
    {"prop": "expected_elevation_angle", "norm": 90},
    {"prop": "expected_illumination_factor"},
    {"prop": "expected_in_sight"},
    {"prop": EXPECTED_RATE, "norm": 0.02},
)
"""What is observed of candidates in addition with ``outlook``."""

CANDIDATES = 10
"""Number of candidates."""

EPISODE = 45000.0
"""Time limit, s."""

IMAGE = 4e6
"""Data of an image, bit."""

FULL = 0.99
"""Fraction of the store above which there is no room for another image."""

BATTERY = 500 * 3600.0
"""Capacity of the battery, W s."""

RAISED = ((5, 5.0), (3, 10.0))
"""How many objects get which priority in the middle of the episode."""

MIXTURE = (0.5, 0.3, 0.2)
"""Shares of low, medium and geosynchronous orbits."""


class ServicingDynModel(SpaceToSpaceImagingDynModel, dyn.GroundStationDynModel):
    """Dynamics of an imager of objects in orbit that observes the direction of the Sun."""

    @observable
    def sun_hat_H(now: Now) -> Vec3:
        """Direction from the satellite to the Sun in the Hill frame, [N, 3]."""
        return (now.HN @ (now.r_SN_N - now.r_BN_N)).unit()


def shield(satellite: BoundSatellite) -> Tensor:
    """Return which actions can bring anything, [N, n_actions] bool.

    Images of objects that are expected to be in the dark or out of sight at their end cannot, nor any images while the store is
    full, nor a downlink while it is empty.
    """
    level, scenario = satellite.dynamics.storage_level_fraction, satellite.scenario
    assert isinstance(scenario, RSOTargets)
    candidates = scenario.candidates(satellite, CANDIDATES)
    priority = satellite.of_env(scenario.priority).gather(1, candidates.place)
    images = (expected_rate(priority, scenario.outlook(satellite, candidates)) > 0.0) & (level < FULL).unsqueeze(1)
    modes = forbid(satellite.action_description[:-CANDIDATES], "action_downlink", where=level <= 0.0)
    return torch.cat([modes, images], 1)


def own_properties() -> tuple[obs.Observation, ...]:
    """Return the observations of the imager itself, 14 numbers."""
    times = (dict(prop=name, norm=ORBIT) for name in ("opportunity_open", "opportunity_close"))
    return (
        obs.SatProperties(
            dict(prop="storage_level_fraction"),
            dict(prop="battery_charge_fraction"),
            dict(prop="wheel_speeds_fraction"),
            dict(prop="sun_hat_H"),
        ),
        obs.Eclipse(norm=ORBIT, sampled=True),
        obs.OpportunityProperties(*times, type="ground_station", n_ahead_observe=2),
    )


def observed(as_set: bool = False, outlook: bool = False) -> tuple[obs.Observation, ...]:
    """Return the observations of the imager; see :func:`services`."""
    time, properties = ((obs.Time(),), (*DEFAULT, *OUTLOOK)) if outlook else ((), DEFAULT)
    return (*own_properties(), *time, RSOTargetProperties(*properties, n_ahead_observe=CANDIDATES, as_set=as_set))


class ServicingImager(sats.AccessSatellite):
    """The imager of the study."""

    dyn_type = ServicingDynModel
    fsw_type = SpaceToSpaceImagingFSWModel
    shielded = False
    observation_spec: ClassVar[Sequence[obs.Observation]] = observed()
    action_spec: ClassVar[tuple[act.Action, ...]] = (
        act.Charge(duration=300.0),
        act.Downlink(duration=300.0, until_empty=True),
        act.Desat(duration=150.0),
        ImageRSO(CANDIDATES, exposure="first", require_illumination_during_hold=False),
    )

    @override
    def legal_actions(self) -> Tensor | None:
        return shield(cast(BoundSatellite, self)) if self.shielded else None


ORDERS: dict[str, Order | None] = {
    "elevation": None,
    "priority_per_second": by_priority_per_second,
    "priority_per_second_ahead": by_priority_per_second_ahead,
}
"""Orders of the candidates by name; None for that of the scenario."""


def servicing_args() -> dict[str, object]:
    """Return the arguments of the study, with distributions for random ones."""
    return dict(
        oe=rand.random_circular_orbit(i=45.0, alt=500.0),
        imageAttErrorRequirement=0.0025,
        imageRateErrorRequirement=0.01,
        instrumentBaudRate=IMAGE,
        transmitterBaudRate=-IMAGE,
        transmitterPacketSize=-IMAGE,
        dataStorageCapacity=50 * IMAGE,
        storageInit=0.0,
        batteryStorageCapacity=BATTERY,
        storedCharge_Init=rand.Uniform(0.8 * BATTERY, BATTERY),
        basePowerDraw=-10.0,
        instrumentPowerDraw=-30.0,
        transmitterPowerDraw=-25.0,
        thrusterPowerDraw=-80.0,
        panelArea=1.0,
        wheelSpeeds=rand.Uniform(-500.0, 500.0, 3),
        maxWheelSpeed=6000.0,
        disturbance_vector=[0.0, 0.0, 0.0],
        desatAttitude="sun",
    )


def servicing_catalog(
    n_targets: int = 200,
    mixture: tuple[float, float, float] | str = MIXTURE,
    exact_mixture: bool = False,
    priority_sum: float = 100.0,
    priority_event: bool = True,
) -> RandomRSOCatalog:
    """Return the objects of the study; see :func:`services`."""
    count = whole("n_targets", n_targets, 1)
    events = []
    if switch("priority_event", priority_event):
        raised = [priority for number, priority in RAISED for _ in range(number)]
        if count < len(raised):
            raise ValueError(f"n_targets={count}: {len(raised)} objects change their priority; there must be as many, at least")
        # objects are exchangeable, so the first ones are a random choice
        events = [RSOPriorityEvent(EPISODE / 2, tuple((f"rso-{k}", priority) for k, priority in enumerate(raised)))]
    total = number("priority_sum", priority_sum, 0.0, above=True)
    mean = rand.Uniform(0.0, 2.0 * total / count)
    return RandomRSOCatalog(count, RSOMixture(mixture, exact_mixture), mean, events, total)


def services(
    *,
    n_targets: int = 200,
    mixture: tuple[float, float, float] | str = MIXTURE,
    exact_mixture: bool = False,
    delivery_share: float = 1.0,
    advance: float = 0.0,
    priority_sum: float = 100.0,
    priority_event: bool = True,
    low_battery_penalty: float = 0.0,
    full_storage_penalty: float = 0.0,
    empty_downlink_penalty: float = -1.0,
    order: str = "elevation",
    as_set: bool = False,
    outlook: bool = False,
    shielded: bool = False,
    sat_args: dict[str, object] | None = None,
    obs_type: type | None = None,
    **options: object,
) -> SatelliteTasking:
    """Return Services-v1; see the module.

    Args:
        n_targets: Number of objects.
        mixture: Shares of low, medium and geosynchronous orbits, ``"LEO"`` or ``"random"``; see
            :class:`~bsk_torch.tasks.objects.RSOMixture`.
        exact_mixture: Whether the catalog has exactly these shares; likewise.
        delivery_share: Share of the priority that a good image pays when it has been downlinked; the study calls it alpha.
        advance: Share that it pays in advance when taken, which changes when rewards come, but not their sum; see
            :class:`~bsk_torch.tasks.objects.RSOImageReward`.
        priority_sum: Sum of the initial priorities.
        priority_event: Whether some priorities change in the middle of the episode.
        low_battery_penalty: Reward at every step that ends with a battery below 10 percent, negative.
        full_storage_penalty: Reward at every step that ends with a store above 99.1 percent, negative.
        empty_downlink_penalty: Reward for a downlink with an empty store, negative.
        order: Order of the candidates: ``"elevation"``, the one of the study, or ``"priority_per_second"``, in which those come
            first that promise the most now, see :func:`~bsk_torch.tasks.objects.by_priority_per_second`, or
            ``"priority_per_second_ahead"``, for the end of the image, see
            :func:`~bsk_torch.tasks.objects.by_priority_per_second_ahead`.
        as_set: Whether candidates are observed as ``rows`` [N, 10, 11] with a ``mask`` instead of in one vector.
        outlook: Whether to observe the elapsed fraction of the episode as well, and five more properties of each candidate:
            those of :class:`~bsk_torch.tasks.objects.outlook.Outlook`, and the priority per second that they promise.
        shielded: Whether ``action_mask`` excludes actions that cannot bring anything; see :func:`shield`.
        sat_args: Arguments of the satellite that replace those of the preset.
        obs_type: ``torch.Tensor`` for one vector, ``dict`` for named observations (default: with ``as_set``).
        **options: Arguments of :class:`~bsk_torch.SatelliteTasking` that replace those of the preset.
    """
    ranks = ORDERS[one_of("order", order, ORDERS)]
    catalog = servicing_catalog(n_targets, mixture, exact_mixture, priority_sum, priority_event)
    defaults: dict[str, Any] = dict(
        scenario=RSOTargets(catalog, ["SS1"], order=ranks),
        rewarder=(
            RSOImageReward(cooldown_orbits=2.0, delivery_share=delivery_share, advance=advance),
            data.OperationsPenalty(low_battery_penalty, full_storage_penalty, empty_downlink_penalty),
        ),
        time_limit=EPISODE,
        failure_penalty=-1.0,
        terminate_on_time_limit=False,
    )
    spec = observed(switch("as_set", as_set), switch("outlook", outlook))
    observed_as = (dict if as_set else torch.Tensor) if obs_type is None else obs_type
    satellite = ServicingImager("SS1", servicing_args() | (sat_args or {}), obs_type=observed_as, observation_spec=spec)
    satellite.shielded = switch("shielded", shielded)
    return SatelliteTasking(satellite, **(defaults | options))
