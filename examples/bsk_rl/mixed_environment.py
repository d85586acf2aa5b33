"""
Mixed environment
=================

A satellite images targets on the ground while another one inspects a spacecraft: two scenarios, each with its channel of rewards.

On the command line::

    python examples/bsk_rl/mixed_environment.py --num-envs 4

The composition of bsk_rl's page "Mixed Ground and Space Imaging", with an inspection in place of its imaging of an RSO. Comments
mark lines that differ from bsk_rl.
"""

# sphinx_gallery_thumbnail_path = "_static/readme/RSOInspection-v1.png"

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch

from bsk_torch import (  # bsk_rl: from bsk_rl import ConstellationTasking, act, data, obs, sats, scene
    ConstellationTasking,
    act,
    comm,
    data,
    formations,
    obs,
    rand,
    sats,
    scene,
)
from bsk_torch.sim import dyn, fsw  # bsk_rl: from bsk_rl.sim import dyn, fsw
from bsk_torch.tasks.inspection import (
    RSODynModel,
    RSOInspectionReward,
    RSOInspectorDynModel,
    RSOInspectorFSWModel,
    SphericalRSO,
)

ORBIT = 5700.0


class GroundObserver(sats.ImagingSatellite):
    """Images one of the next four targets, or charges."""

    observation_spec = [
        obs.SatProperties(
            dict(prop="storage_level_fraction"), dict(prop="r_BN_P", norm=7e6)
        ),
        obs.OpportunityProperties(
            dict(prop="priority"),
            dict(prop="opportunity_close", norm=300.0),
            n_ahead_observe=4,
        ),
        obs.Time(),
    ]
    action_spec = [act.Image(4, max_duration=120.0), act.Charge(duration=60.0)]
    dyn_type = dyn.GroundStationDynModel
    fsw_type = fsw.ImagingFSWModel


class RSO(sats.Satellite):
    """Points along its Hill frame; it takes part in a scenario, but collects no data."""

    observation_spec = [obs.Time()]
    action_spec = [act.NadirPoint(duration=1e9)]
    dyn_type = RSODynModel
    fsw_type = fsw.FSWModel


class Inspector(sats.Satellite):
    """Points its instrument at the RSO, or charges."""

    observation_spec = [
        obs.SatProperties(dict(prop="wheel_speeds_fraction")),
        obs.RelativeProperties(
            dict(prop="r_DC_Hc", norm=100.0), dict(prop="v_DC_Hc"), chief_name="RSO"
        ),
        obs.Time(),
    ]
    action_spec = [
        act.DiscreteFSWAction("action_inspect_rso", name="inspect", duration=60.0),
        act.Charge(duration=60.0),
    ]
    dyn_type = RSOInspectorDynModel
    fsw_type = (fsw.BasicFSWModel, RSOInspectorFSWModel)


CAMERA = dict(imageAttErrorRequirement=0.1, imageRateErrorRequirement=0.1, u_max=0.8)

NEAR = dict(
    imageAttErrorRequirement=1.0,
    imageRateErrorRequirement=None,
    instrumentBaudRate=1.0,
    dataStorageCapacity=1e6,
)


def make(
    num_envs: int = 1, sat_args: Sequence[dict[str, Any]] | None = None, **options: Any
) -> ConstellationTasking:
    """Return ``num_envs`` episodes of the problem.

    ``sat_args`` of the three satellites replace what would be drawn, ``options`` those of the problem.
    """
    own = [{}] * 3 if sat_args is None else sat_args
    # bsk_rl: start is a function that draws six numbers
    near = rand.Uniform(
        [-60.0, -60.0, -60.0, -0.3, -0.3, -0.3], [60.0, 60.0, 60.0, 0.3, 0.3, 0.3]
    )
    about = formations.relative_to_chief(
        "RSO", rand.random_orbit(a=7000.0), {"Inspector": near}
    )
    defaults = dict(
        scenario=scene.MixedScenario(
            {
                "ground_scene": scene.UniformTargets(1000),
                "rso_scene": SphericalRSO(
                    n_points=100, theta_max=1.4, theta_solar_max=1.5
                ),
            },
            {"ground_scene": ["Ground"], "rso_scene": ["RSO", "Inspector"]},
        ),
        rewarder=data.MixedReward(
            {
                "ground_images": data.UniqueImageReward(),
                "inspection": RSOInspectionReward(
                    completion_bonus=1.0, completion_threshold=0.6
                ),
            },
            {"ground_images": ["Ground"], "inspection": ["Inspector"]},
            {"ground_images": "ground_scene", "inspection": "rso_scene"},
        ),
        communicator=comm.FreeCommunication(),
        sat_arg_randomizer=about if sat_args is None else None,
        time_limit=ORBIT,
        num_envs=num_envs,
    )
    return ConstellationTasking(
        satellites=[
            GroundObserver("Ground", {**CAMERA, **own[0]}),
            RSO("RSO", own[1]),
            Inspector("Inspector", {**NEAR, **own[2]}),
        ],
        **(defaults | options),
    )


def main() -> None:
    """Play random actions, and print what each channel pays."""
    parser = argparse.ArgumentParser(
        description="Image targets on the ground, and inspect a spacecraft."
    )
    parser.add_argument("--num-envs", type=int, default=4, help="episodes at once")
    parser.add_argument(
        "--time-limit", type=float, default=ORBIT, help="length of an episode, s"
    )
    parser.add_argument("--backend", default="compiled", choices=["compiled", "eager"])
    parser.add_argument(
        "--figure",
        type=Path,
        help="file for a figure of the first episode at the end; needs the extra viz",
    )
    options = parser.parse_args()
    env = make(
        options.num_envs, time_limit=options.time_limit, backend=options.backend, seed=0
    )

    def anything(td: Any) -> Any:
        """Give each satellite that needs a task a random one of those that its mask allows."""
        for group in env.group_map:
            weights = td[group, "action_mask"].float()
            # the last entry stands for no task; bsk_rl: env.action_space(..).sample()
            weights[..., -1] *= 1e-9
            action = torch.multinomial(weights.flatten(0, 1), 1)
            td[group, "action"] = action.view(weights.shape[:2])
        return td

    env.rollout(1000, anything, break_when_all_done=True)
    for channel, rewarder in env.rewarder.channels.items():
        paid = torch.stack(list(rewarder.cum_reward.values()), 1).sum(1)
        print(f"{channel}: {[round(value, 3) for value in paid.tolist()]}")
    if options.figure is not None:
        from PIL import Image

        Image.fromarray(env.render(rows=0).numpy()).save(options.figure)


if __name__ == "__main__":
    main()
