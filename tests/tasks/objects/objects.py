"""Imagers and a catalog of resident space objects (RSO) near them, for tests."""

from __future__ import annotations

import math
from typing import Any

import torch

from bsk_torch import ConstellationTasking, act, obs, sats
from bsk_torch.astro.elements import ClassicElements, elem2rv
from bsk_torch.constants import MU_EARTH
from bsk_torch.sim import dyn
from bsk_torch.tasks.objects import (
    ImageRSO,
    RSOImageReward,
    RSOTarget,
    RSOTargetCatalog,
    RSOTargetProperties,
    RSOTargets,
    SpaceToSpaceImagingDynModel,
    SpaceToSpaceImagingFSWModel,
)

EPOCH = "2021 JUN 05 09:12:05.830 (UTC)"

RADIUS = 7.0e6

KEPT = dict(
    imageAttErrorRequirement=0.02,
    instrumentBaudRate=1e6,
    dataStorageCapacity=2e7,
    transmitterBaudRate=-1e5,
    batteryStorageCapacity=1e9,
    storedCharge_Init=1e9,
    u_max=0.4,
    disturbance_vector=[0.0, 0.0, 0.0],
    sigma_init=[0.1, 0.2, -0.3],
    omega_init=[0.0, 0.0, 0.0],
    wheelSpeeds=[0.0, 0.0, 0.0],
)


class Imager(sats.AccessSatellite):
    dyn_type = (SpaceToSpaceImagingDynModel, dyn.GroundStationDynModel)
    fsw_type = SpaceToSpaceImagingFSWModel
    observation_spec = (
        obs.SatProperties(dict(prop="storage_level_fraction")),
        RSOTargetProperties(dict(prop="valid"), dict(prop="target_distance", norm=1e6), n_ahead_observe=3),
        obs.Time(),
    )
    action_spec = (
        act.Charge(duration=60.0),
        act.Downlink(duration=90.0),
        ImageRSO(3, max_duration=200.0, min_pointing_hold_s=5.0, require_illumination_during_hold=False),
    )


def elements(anomaly: float, radius: float = RADIUS, e: float = 0.0) -> ClassicElements:
    """A polar orbit at an angle, rad, from where the first imager begins."""
    return ClassicElements(a=radius / (1.0 - e), e=e, i=0.5 * math.pi, Omega=0.3, omega=0.0, f=anomaly)


def state(anomaly: float, **others: float) -> tuple[Any, Any]:
    """Position, m, and velocity, m/s, on such an orbit."""
    return elem2rv(MU_EARTH, elements(anomaly, **others))


def catalog(angles: tuple[float, ...] = (0.05, 0.1, -0.08, 2.5), **options: Any) -> RSOTargetCatalog:
    """Targets on the orbit of the imagers, 50 km above, at angles from them; their priorities are 1, 2, ..."""
    targets = [
        RSOTarget(f"object {k}", f"target{k}", *state(angle, radius=RADIUS + 5e4), priority=1.0 + k)
        for k, angle in enumerate(angles)
    ]
    return RSOTargetCatalog(tuple(targets), **options)


def environment(imagers: int = 1, kind: type[sats.Satellite] = Imager, **options: Any) -> ConstellationTasking:
    """Imagers one behind the other, a degree apart, and a catalog."""
    given, args = options.pop("catalog", None), options.pop("sat_args", {})
    names = [f"Imager{k}" for k in range(imagers)]
    satellites = []
    for k, name in enumerate(names):
        r_N, v_N = state(-0.02 * k)
        satellites.append(kind(name, KEPT | dict(oe=None, rN=r_N.tolist(), vN=v_N.tolist()) | args))
    block = options.pop("block_pending_targets", True)
    defaults: dict[str, Any] = dict(
        scenario=RSOTargets(catalog() if given is None else given, names, block_pending_targets=block),
        rewarder=RSOImageReward(quality_threshold=0.0, multi_imager_credit="shared" if imagers > 1 else None),
        world_args=dict(utc_init=EPOCH, gsMinimumElevation=-0.5 * math.pi),
        time_limit=1500.0,
        num_envs=2,
        seed=0,
    )
    return ConstellationTasking(satellites, **(defaults | options))


def play(env: ConstellationTasking, *actions: int) -> Any:
    """Step with the same action of each imager in all environments."""
    moves = torch.ones(env.num_envs, dtype=torch.bool)
    return env.play([torch.tensor([list(actions)] * env.num_envs)], moves)
