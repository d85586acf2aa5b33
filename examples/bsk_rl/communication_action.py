"""
Communication as an action
==========================

Two imagers, five degrees apart, share the list of imaged targets by a broadcast action.

On the command line::

    python examples/bsk_rl/communication_action.py --num-envs 2

The problem of bsk_rl's page "Broadcast Communication". Comments mark lines that differ from it.
"""

# sphinx_gallery_thumbnail_path = "_static/readme/RelayConstellation-v1.png"

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch

from bsk_torch import (  # bsk_rl: from bsk_rl import act, comm, data, obs, sats, scene
    ConstellationTasking,
    act,
    comm,
    data,
    formations,
    obs,
    sats,
    scene,
)
from bsk_torch.sim import dyn, fsw  # bsk_rl: from bsk_rl.sim import dyn, fsw

N_AGENTS = 2
BROADCAST, IMAGE_0, IMAGE_1, IMAGE_2, IMAGE_3 = range(5)


class ImagingSatellite(sats.ImagingSatellite):
    """Broadcasts for a quarter of a minute, or images one of the next four targets."""

    observation_spec = [
        obs.OpportunityProperties(
            dict(prop="priority"),
            dict(prop="opportunity_open", norm=5700.0),
            n_ahead_observe=4,
        )
    ]
    action_spec = [act.Broadcast(duration=15.0), act.Image(n_ahead_image=4)]
    dyn_type = dyn.FullFeaturedDynModel
    fsw_type = fsw.SteeringImagerFSWModel


class BroadcastLOS(comm.BroadcastCommunication, comm.LOSMultiCommunication):
    """A broadcast reaches every satellite connected by relays."""


SAT_ARGS = dict(
    imageAttErrorRequirement=0.01,
    imageRateErrorRequirement=0.01,
    batteryStorageCapacity=1e9,
    storedCharge_Init=1e9,
    dataStorageCapacity=1e12,
    u_max=0.4,
    K1=0.25,
    K3=3.0,
    omega_max=0.087,
    servo_Ki=5.0,
    servo_P=150 / 5,
)
"""Power and storage never run out."""


def make(
    num_envs: int = 1, sat_args: Sequence[dict[str, Any]] | None = None, **options: Any
) -> ConstellationTasking:
    """Return ``num_envs`` episodes of the problem.

    ``sat_args`` of each satellite replace what would be drawn, ``options`` those of the problem.
    """
    own = [{}] * N_AGENTS if sat_args is None else sat_args
    # bsk_rl: walker_delta_args(altitude=800.0, inc=60.0, n_planes=1, clustersize=N_AGENTS, clusterspacing=5.0)
    pair = formations.walker_delta_args(
        altitude=800.0, inc=60.0, n_planes=1, clustersize=N_AGENTS, clusterspacing=5.0
    )
    defaults = dict(
        scenario=scene.UniformTargets(1000),
        rewarder=data.UniqueImageReward(),
        communicator=BroadcastLOS(),
        sat_arg_randomizer=pair if sat_args is None else None,
    )
    return ConstellationTasking(
        satellites=[
            ImagingSatellite(f"EO{k + 1}", SAT_ARGS | own[k]) for k in range(N_AGENTS)
        ],
        num_envs=num_envs,  # bsk_rl: one episode
        **(defaults | options),
    )


def main() -> None:
    """Image, broadcast together, and let one broadcast while the other images."""
    parser = argparse.ArgumentParser(description="Broadcast what has been imaged.")
    parser.add_argument("--num-envs", type=int, default=2, help="episodes at once")
    parser.add_argument("--backend", default="compiled", choices=["compiled", "eager"])
    parser.add_argument(
        "--figure",
        type=Path,
        help="file for a figure of the first episode at the end; needs the extra viz",
    )
    options = parser.parse_args()
    env = make(options.num_envs, backend=options.backend, seed=0)
    td = env.reset()
    for actions in ([IMAGE_3, IMAGE_2], [BROADCAST, BROADCAST], [IMAGE_2, BROADCAST]):
        # bsk_rl: {"EO-1": .., "EO-2": ..}
        td["agents", "action"] = torch.tensor(actions).expand(
            options.num_envs, N_AGENTS
        )
        td = env.step(td)["next"]
        # everyone hears itself
        heard = env.links.flatten(1).sum(1) - N_AGENTS * env.links.diagonal(
            dim1=1, dim2=2
        ).any(1)
        known = env.rewarder.known.sum(2)
        print(
            "rewards",
            td["agents", "reward"].squeeze(2).tolist(),
            "heard",
            heard.tolist(),
            "images known",
            known.tolist(),
        )
    if options.figure is not None:
        from PIL import Image

        Image.fromarray(env.render(rows=0).numpy()).save(options.figure)


if __name__ == "__main__":
    main()
