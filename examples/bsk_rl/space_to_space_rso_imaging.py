"""
Imaging of objects in orbit
===========================

An imager takes pictures of resident space objects (RSO) of a catalog and sends them to ground stations.

On the command line::

    python examples/bsk_rl/space_to_space_rso_imaging.py --num-envs 4
    python examples/bsk_rl/space_to_space_rso_imaging.py amos --policy nearest --num-envs 64 --time-limit 20000

The problem of bsk_rl's page "Space-to-Space RSO Imaging", with both of its profiles and the rules of its evaluation. Comments
mark lines that differ from it. Objects are not satellites of the environment, so they have no actions.
"""

# sphinx_gallery_thumbnail_path = "_static/readme/Services-v1.png"

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from aeos import s_hat_H  # bsk_rl: a function sun_in_hill
from torch import Tensor

from bsk_torch import (  # bsk_rl: from bsk_rl import ConstellationTasking, act, data, obs, sats, scene
    ConstellationTasking,
    act,
    obs,
    rand,
    sats,
)
from bsk_torch.sim import dyn  # bsk_rl: from bsk_rl.sim import dyn, fsw
from bsk_torch.tasks.objects import (
    ImageRSO,
    RandomRSOCatalog,
    RSOImageReward,
    RSOTargetCatalog,
    RSOTargetProperties,
    RSOTargets,
    SpaceToSpaceImagingDynModel,
    SpaceToSpaceImagingFSWModel,
)

EPOCH = "2026 JUN 21 00:00:00.000 (UTC)"
ORBIT = 5700.0
RADII = (7.2e6, 7.3e6, 7.4e6)
"""Radii of the orbits of the three objects, m."""


# bsk_rl: make_catalog(seed), a loop with elem2rv
@dataclass(frozen=True)
class NearbyOrbit(rand.Distribution):
    """Elements [n, 6] of a circular orbit of a given radius, m, which begins up to 0.1 rad ahead of its ascending node."""

    radius: float

    def draw(self, key: rand.Key) -> Tensor:
        """See :meth:`bsk_torch.rand.Distribution.draw`."""
        u = key.uniform(2)
        zero = torch.zeros_like(u[:, 0])
        elements = (zero + self.radius, zero, 0.5 * math.pi * u[:, 0], zero, zero)
        return torch.stack([*elements, 0.1 * u[:, 1]], -1)


def random_catalog() -> RandomRSOCatalog:
    """Return a catalog of three objects, on other orbits in each episode."""
    return RandomRSOCatalog(
        3, oe=[NearbyOrbit(radius) for radius in RADII], priority=[1.0, 2.0, 3.0]
    )


class Imager(sats.AccessSatellite):
    """Charges, downlinks, slows its wheels down, or images one of the next three objects."""

    observation_spec = [
        obs.SatProperties(dict(prop="storage_level_fraction")),
        RSOTargetProperties(
            dict(prop="valid"),
            dict(prop="priority"),
            dict(prop="target_distance"),
            dict(prop="target_illumination_factor"),
            n_ahead_observe=3,
        ),
    ]
    action_spec = [
        act.Charge(duration=60.0),
        act.Downlink(duration=90.0),
        act.Desat(duration=60.0),
        ImageRSO(
            3,
            max_duration=300.0,
            min_pointing_hold_s=10.0,
            hold_mode="cumulative",
            require_illumination_during_hold=False,
        ),
    ]
    dyn_type = (SpaceToSpaceImagingDynModel, dyn.GroundStationDynModel)
    fsw_type = SpaceToSpaceImagingFSWModel


class AmosImager(Imager):
    """Observes more, has ten actions that image, and longer others."""

    observation_spec = [
        obs.SatProperties(
            dict(prop="storage_level_fraction"),
            dict(prop="battery_charge_fraction"),
            dict(prop="wheel_speeds_fraction"),
            dict(prop="s_hat_H", fn=s_hat_H),
        ),
        obs.Eclipse(norm=ORBIT),
        obs.OpportunityProperties(
            dict(prop="opportunity_open", norm=ORBIT),
            dict(prop="opportunity_close", norm=ORBIT),
            type="ground_station",
            n_ahead_observe=2,
        ),
        RSOTargetProperties(n_ahead_observe=10),
    ]
    action_spec = [
        act.Charge(duration=300.0),
        act.Downlink(duration=300.0),
        act.Desat(duration=150.0),
        ImageRSO(
            10,
            max_duration=300.0,
            min_pointing_hold_s=10.0,
            hold_mode="cumulative",
            require_illumination_during_hold=False,
        ),
    ]


SAT_ARGS: dict[str, Any] = dict(
    # bsk_rl: random_circular_orbit(i=45.0, alt=600.0, Omega=0.0, f=0.0)
    oe=rand.random_circular_orbit(i=45.0, alt=600.0, Omega=0.0, f=0.0),
    sigma_init=[0.0, 0.0, 0.0],
    omega_init=[0.0, 0.0, 0.0],
    wheelSpeeds=[0.0, 0.0, 0.0],
    maxWheelSpeed=6000.0,
    batteryStorageCapacity=1e9,
    storedCharge_Init=1e9,
)

AMOS_ARGS = SAT_ARGS | dict(
    imageAttErrorRequirement=0.0025,
    imageRateErrorRequirement=0.01,
    dataStorageCapacity=50 * 4e6,  # fifty images
    instrumentBaudRate=4e6,
    transmitterBaudRate=-4e6,
    batteryStorageCapacity=500 * 3600.0,
    storedCharge_Init=500 * 3600.0,
    basePowerDraw=-10.0,
    instrumentPowerDraw=-30.0,
    transmitterPowerDraw=-25.0,
    thrusterPowerDraw=-80.0,
    panelArea=1.0,
    desatAttitude="sun",
)

PROFILES: dict[str, tuple[type[Imager], dict[str, Any], float, float]] = {
    "compact": (Imager, SAT_ARGS, 0.0, 1.0),
    "amos": (AmosImager, AMOS_ARGS, 0.9, 0.1),
}
"""Imager, its arguments, and shares of the priority paid for an image and for its delivery."""


def make(
    profile: str = "compact",
    num_envs: int = 1,
    sat_args: dict[str, Any] | None = None,
    catalog: RSOTargetCatalog | RandomRSOCatalog | None = None,
    **options: Any,
) -> ConstellationTasking:
    """Return ``num_envs`` episodes of a profile of :data:`PROFILES`.

    ``sat_args`` of the imager replace its own, ``options`` those of the problem. ``catalog`` replaces the random one, such as a
    file of bsk_rl read by ``RSOTargetCatalog.load``.
    """
    kind, arguments, acquired, delivered = PROFILES[profile]
    given = random_catalog() if catalog is None else catalog
    defaults = dict(
        scenario=RSOTargets(given, ["imager"]),
        rewarder=RSOImageReward(
            acquisition_reward_fn=lambda record, target: acquired * target.priority,
            delivery_reward_fn=lambda record, target: delivered * target.priority,
        ),
        world_args=dict(utc_init=EPOCH),
        time_limit=1200.0,
        max_step_duration=300.0,
    )
    return ConstellationTasking(
        # bsk_rl: a satellite with dyn.RSOTargetDynModel for each object, too
        satellites=[kind("imager", arguments | (sat_args or {}))],
        num_envs=num_envs,  # bsk_rl: one episode
        **(defaults | options),
    )


CHARGE, DOWNLINK, DESAT, IMAGE = range(4)


def choose(env: ConstellationTasking, rule: str) -> Tensor:
    """Return the actions of a rule of the page's evaluation, [N, 1].

    It charges below 30 percent of the battery, slows wheels down above 80 percent of their speed, and downlinks while there are
    images. Otherwise it images the candidate in sight and in light that has the highest priority (``"priority"``) or is the
    nearest (``"nearest"``), or one at random (``"random"``), and charges without one.
    """
    scenario, imager = env.scenario, env.satellites[0]
    model = imager.dynamics
    count = len(imager.action_description) - IMAGE
    candidates = scenario.candidates(imager, count)
    seen = scenario.views(imager, candidates)
    rank = {
        "priority": scenario.priority.gather(1, candidates.place),
        "nearest": -seen.target_distance,
        "random": torch.rand_like(seen.target_distance),
    }[rule]
    # bsk_rl: imager.dynamics.rso_access_messages[target_id].read().hasAccess
    lit = seen.target_illumination_factor >= env.rewarder.quality_threshold
    possible = scenario.in_sight(imager, candidates) & lit
    image = IMAGE + torch.where(possible, rank, -torch.inf).argmax(1)
    action = torch.where(possible.any(1), image, CHARGE)
    action = torch.where(model.storage_level > 0.0, DOWNLINK, action)
    fast = model.wheel_speeds_fraction.abs().amax(1) > 0.8
    action = torch.where(fast, DESAT, action)
    return torch.where(model.battery_charge_fraction < 0.3, CHARGE, action).unsqueeze(1)


def main() -> None:
    """Fly by a rule, and print images, deliveries and rewards."""
    parser = argparse.ArgumentParser(description="Image objects in orbit by a rule.")
    parser.add_argument("profile", nargs="?", default="compact", choices=[*PROFILES])
    parser.add_argument(
        "--policy", default="priority", choices=["priority", "nearest", "random"]
    )
    parser.add_argument("--num-envs", type=int, default=4, help="episodes at once")
    parser.add_argument(
        "--time-limit", type=float, default=6000.0, help="length of an episode, s"
    )
    parser.add_argument(
        "--catalog", type=Path, help="file of a catalog, in place of random ones"
    )
    parser.add_argument("--backend", default="compiled", choices=["compiled", "eager"])
    parser.add_argument(
        "--figure",
        type=Path,
        help="file for a figure of the first episode at the end; needs the extra viz",
    )
    options = parser.parse_args()
    torch.manual_seed(0)
    given = options.catalog and RSOTargetCatalog.load(options.catalog)
    env = make(
        options.profile,
        options.num_envs,
        catalog=given,
        time_limit=options.time_limit,
        backend=options.backend,
        seed=0,
    )
    td = env.rollout(
        1000, lambda td: td.set(("agents", "action"), choose(env, options.policy))
    )
    for name, number in env.rewarder.counts().items():
        print(f"{name}: {number.squeeze(1).tolist()}")
    print("return:", td["next", "agents", "reward"].sum(1).flatten().tolist())
    if options.figure is not None:
        from PIL import Image

        Image.fromarray(env.render(rows=0).numpy()).save(options.figure)


if __name__ == "__main__":
    main()
