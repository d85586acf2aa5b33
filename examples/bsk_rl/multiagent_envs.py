"""
Joint or separate agents
========================

Three imagers in one orbit, controlled by one agent or three, share imaged targets over lines of sight.

On the command line::

    python examples/bsk_rl/multiagent_envs.py --num-envs 2

The problem of bsk_rl's page "Multi-Agent Environments". Comments mark lines that differ from it.
"""

# sphinx_gallery_thumbnail_path = "_static/readme/Constellation-v1.png"

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from bsk_torch import (  # bsk_rl: from bsk_rl import sats, act, obs, scene, data, comm
    NO_ACTION,
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


class MortalDynModel(dyn.FullFeaturedDynModel):
    """Can also be killed by a flag in the environment's memory."""

    @dyn.aliveness_checker
    # bsk_rl: a function isnt_alive that takes the place of satellite.is_alive
    def not_killed(self) -> Tensor:
        """[N]."""
        return ~self.simulator.memory["killed"]


class ImagingSatellite(sats.ImagingSatellite):
    """Chooses among the next ten targets."""

    observation_spec = [
        obs.OpportunityProperties(
            dict(prop="priority"),
            dict(prop="opportunity_open", norm=5700.0),
            n_ahead_observe=10,
        )
    ]
    action_spec = [act.Image(n_ahead_image=10)]
    dyn_type = MortalDynModel  # bsk_rl: dyn.FullFeaturedDynModel
    fsw_type = fsw.SteeringImagerFSWModel

    def on_bind(self) -> None:
        """No agent has died at the start."""
        super().on_bind()
        self.simulator.memory.declare("killed", 0, dtype=torch.bool)


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
    num_envs: int = 1,
    sat_args: Sequence[dict[str, Any]] | None = None,
    joint: bool = False,
    **options: Any,
) -> ConstellationTasking:
    """Return ``num_envs`` episodes of the problem.

    ``sat_args`` of each satellite replace what would be drawn, ``options`` those of the problem. With ``joint`` one agent
    commands all satellites.
    """
    own = [{}] * 3 if sat_args is None else sat_args
    defaults = dict(
        scenario=scene.UniformTargets(1000),
        rewarder=data.UniqueImageReward(),
        communicator=comm.LOSCommunication(),
        # bsk_rl: walker_delta_args(altitude=800.0, inc=60.0, n_planes=1)
        sat_arg_randomizer=formations.walker_delta_args(
            altitude=800.0, inc=60.0, n_planes=1
        )
        if sat_args is None
        else None,
    )
    return ConstellationTasking(
        satellites=[
            ImagingSatellite(f"EO{k + 1}", SAT_ARGS | own[k]) for k in range(3)
        ],
        num_envs=num_envs,  # bsk_rl: one episode
        # bsk_rl: GeneralSatelliteTasking(...) instead of ConstellationTasking(...)
        joint=joint,
        **(defaults | options),
    )


def kill(env: ConstellationTasking, satellite: int) -> None:
    """Let a satellite of every episode die at the end of the next step."""
    memory = env.fleet.satellites[0].simulator.memory
    memory["killed"] = memory["killed"] | (
        torch.arange(env.fleet.size) == satellite
    ).repeat(env.fleet.num_envs)


def main() -> None:
    """Fly with one agent, then with three, one of which dies."""
    parser = argparse.ArgumentParser(description="Fly three imagers.")
    parser.add_argument("--num-envs", type=int, default=2, help="episodes at once")
    parser.add_argument("--backend", default="compiled", choices=["compiled", "eager"])
    parser.add_argument(
        "--figure",
        type=Path,
        help="file for a figure of the first episode at the end; needs the extra viz",
    )
    options = parser.parse_args()
    common = dict(num_envs=options.num_envs, backend=options.backend, seed=0)
    first = torch.tensor([7, 9, 8]).expand(options.num_envs, 3)

    env = make(joint=True, **common)
    td = env.reset()
    print(
        env.observation_spec["observation"].shape, env.action_spec
    )  # bsk_rl: tuples of spaces
    td = env.step(td.set("action", first))["next"]  # bsk_rl: env.step([7, 9, 8])
    # [N, 3]; bsk_rl: info[sat.name]["requires_retasking"]
    asked = td["members_require_retasking"]
    # bsk_rl: 0 or None for each
    td = env.step(td.set("action", torch.where(asked, 0, NO_ACTION)))["next"]
    print(
        "joint: rewards",
        td["reward"].squeeze(1),
        "after",
        td["duration"].squeeze(1),
        "s",
    )

    env = make(**common)
    td = env.reset()
    print(
        env.group_map, td["agents", "observation"].shape
    )  # bsk_rl: dictionaries by agent
    # bsk_rl: {env.agents[0]: 7, env.agents[1]: 9, env.agents[2]: 8}
    td["agents", "action"] = first
    td = env.step(td)["next"]
    print("rewards", td["agents", "reward"].squeeze(2))
    kill(env, 0)  # bsk_rl: env.satellites[0].is_alive = isnt_alive
    td["agents", "action"] = first
    td = env.step(td)["next"]
    print("alive", td["agents", "mask"])
    if options.figure is not None:
        from PIL import Image

        Image.fromarray(env.render(rows=0).numpy()).save(options.figure)


if __name__ == "__main__":
    main()
