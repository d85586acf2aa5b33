"""
Inspection of a spacecraft
==========================

An inspector flies around a resident space object (RSO) by velocity changes until its surface has been seen in sunlight.

On the command line::

    python examples/bsk_rl/rso_inspection.py --num-envs 4

The problem of bsk_rl's page "RSO Inspection". Comments mark lines that differ from it. The preset ``RSOInspection-v1`` is the
problem of bsk_rl's benchmark, without the steering law.
"""

# sphinx_gallery_thumbnail_path = "_static/readme/RSOInspection-v1.png"

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from bsk_torch import (  # bsk_rl: from bsk_rl import act, data, obs, sats, scene
    ConstellationTasking,
    act,
    data,
    formations,
    obs,
    rand,
    sats,
)
from bsk_torch.astro.clohessy_wiltshire import transfer

# bsk_rl: from bsk_rl.utils.orbital import fibonacci_sphere
from bsk_torch.astro.relative import fibonacci_sphere
from bsk_torch.sim import dyn, fsw  # bsk_rl: from bsk_rl.sim import dyn, fsw
from bsk_torch.tasks.inspection import (
    RSODynModel,
    RSOInspectionReward,
    RSOInspectorDynModel,
    RSOInspectorFSWModel,
    SphericalRSO,
)

# bsk_rl: from bsk_rl.obs.relative_observations import ...
from bsk_torch.tasks.inspection.obs import rso_imaged_regions
from bsk_torch.tasks.inspection.preset import EccentricOrbit, RelativeState

CHIEF = "RSO"
ORBIT = 5700.0
MEAN_MOTION = 2.0 * math.pi / ORBIT


def one(satellite: Any) -> Tensor:
    """Return an observation of nothing, [N]; bsk_rl: lambda _: 1.0."""
    return torch.ones_like(satellite.simulator.sim_time)


class RSO(sats.Satellite):
    """Points along its Hill frame."""

    observation_spec = [obs.SatProperties(dict(prop="one", fn=one))]
    action_spec = [act.NadirPoint(duration=1e9)]
    dyn_type = (dyn.ConjunctionDynModel, RSODynModel)
    fsw_type = fsw.FSWModel


class Inspector(sats.Satellite):
    """Thrusts in the RSO's Hill frame, and drifts with the instrument on the RSO."""

    observation_spec = [
        obs.SatProperties(dict(prop="dv_available", norm=10)),
        obs.ResourceRewardWeight(),
        obs.RelativeProperties(
            dict(prop="r_DC_Hc", norm=500),
            dict(prop="v_DC_Hc", norm=5),
            dict(
                prop="rso_imaged_regions",
                fn=partial(rso_imaged_regions, region_centers=fibonacci_sphere(15)),
            ),
            dict(prop="sun_hat_Hc"),  # bsk_rl: a function sun_hat_chief
            chief_name=CHIEF,
        ),
        obs.Eclipse(norm=ORBIT),
        obs.Time(),
    ]
    action_spec = [
        act.ImpulsiveThrustHill(
            chief_name=CHIEF,
            max_dv=1.0,
            max_drift_duration=2 * ORBIT,
            fsw_action="action_inspect_rso",
        )
    ]
    dyn_type = (dyn.MaxRangeDynModel, dyn.ConjunctionDynModel, RSOInspectorDynModel)
    fsw_type = (
        fsw.SteeringFSWModel,
        fsw.MagicOrbitalManeuverFSWModel,
        RSOInspectorFSWModel,
    )


RSO_ARGS = dict(conjunction_radius=2.0)

INSPECTOR_ARGS = dict(
    imageAttErrorRequirement=1.0,
    imageRateErrorRequirement=None,
    instrumentBaudRate=1,
    dataStorageCapacity=1e6,
    batteryStorageCapacity=1e9,
    storedCharge_Init=1e9,
    conjunction_radius=2.0,
    dv_available_init=10.0,
    max_range_radius=1000,
    chief_name=CHIEF,
    u_max=1.0,
    # bsk_rl: its default gains, with which attitudes are not stable in ticks of 5 s
    K1=0.04,
    servo_P=6.6,
    servo_Ki=0.16,
)


def fuel(satellite: Any) -> Tensor:
    """Return the remaining velocity change in the tank, m/s [N]; bsk_rl: lambda sat: sat.fsw.dv_available if ... else 0.0."""
    if hasattr(satellite.fsw, "dv_available"):
        return satellite.fsw.dv_available
    return torch.zeros_like(satellite.simulator.sim_time)


def make(
    num_envs: int = 1,
    sat_args: Sequence[dict[str, Any]] | None = None,
    n_inspectors: int = 1,
    **options: Any,
) -> ConstellationTasking:
    """Return ``num_envs`` episodes of the problem.

    ``sat_args`` of the RSO and of each inspector replace what would be drawn, ``options`` those of the problem.
    """
    names = [f"Inspector{k}" for k in range(1, n_inspectors + 1)]
    own = [{}] * (1 + n_inspectors) if sat_args is None else sat_args
    # bsk_rl: sat_arg_randomizer(satellites), a function that calls relative_to_chief(...)
    about = formations.relative_to_chief(
        CHIEF, EccentricOrbit(), {name: RelativeState() for name in names}
    )
    defaults = dict(
        scenario=SphericalRSO(
            n_points=100,
            radius=1.0,
            theta_max=math.radians(30),
            range_max=250,
            theta_solar_max=math.radians(60),
        ),
        rewarder=(
            RSOInspectionReward(completion_bonus=1.0, completion_threshold=0.90),
            # bsk_rl: np.random.uniform(0.0, 0.5)
            data.ResourceReward(resource_fn=fuel, reward_weight=rand.Uniform(0.0, 0.5)),
        ),
        sat_arg_randomizer=about if sat_args is None else None,
        sim_rate=5.0,
        time_limit=60000.0,
        orbit="integrated",  # bsk_rl: has no other
    )
    return ConstellationTasking(
        satellites=[
            RSO(CHIEF, sat_args=RSO_ARGS | own[0]),
            *(
                Inspector(name, sat_args=INSPECTOR_ARGS | given)
                for name, given in zip(names, own[1:], strict=True)
            ),
        ],
        num_envs=num_envs,  # bsk_rl: one episode
        **(defaults | options),
    )


def main() -> None:
    """Fly to random places near the RSO."""
    parser = argparse.ArgumentParser(
        description="Inspect a spacecraft from random nearby places."
    )
    parser.add_argument("--num-envs", type=int, default=4, help="episodes at once")
    parser.add_argument(
        "--time-limit", type=float, default=20000.0, help="length of an episode, s"
    )
    parser.add_argument("--backend", default="compiled", choices=["compiled", "eager"])
    parser.add_argument(
        "--figure",
        type=Path,
        help="file for a figure of the first episode; needs the extra viz",
    )
    options = parser.parse_args()
    torch.manual_seed(0)
    env = make(
        options.num_envs, time_limit=options.time_limit, backend=options.backend, seed=0
    )

    def visit(td: Any) -> Any:
        """Let the inspectors fly to random places, and the RSO keep its attitude."""
        rso, inspectors = (group.name for group in env.groups)
        # bsk_rl: {"RSO": 0, "Inspector1": np.array(..)}
        td[rso, "action"] = torch.zeros(options.num_envs, 1, dtype=torch.int64)
        rho, velocity = (
            500.0 * td[inspectors, "observation"][..., 2:5].double(),
            5.0 * td[inspectors, "observation"][..., 5:8],
        )
        place = torch.nn.functional.normalize(torch.randn_like(rho), dim=-1) * 60.0
        drift = torch.full_like(rho[..., :1], 1500.0)
        dv_H = (
            transfer(rho, place, torch.tensor(MEAN_MOTION), drift.squeeze(-1))
            - velocity
        )
        return td.set((inspectors, "action"), torch.cat([dv_H, drift], -1).float())

    if options.figure is not None:
        from bsk_torch.viz.episodes import draw, record
        from bsk_torch.wrappers.policies import WholePolicy

        draw(record(WholePolicy(visit), env, seed=0), options.figure, "random places")
    td = env.rollout(1000, visit, break_when_any_done=True)
    known, lit = (
        env.rewarder.inspected.sum(1).tolist(),
        env.rewarder.illuminated.sum(1).tolist(),
    )
    print(
        "inspected",
        known,
        "of lit",
        lit,
        "fuel",
        [round(left, 2) for left in env.satellites[1].fsw.dv_available.tolist()],
    )
    print(
        "steps",
        td.shape[1],
        "rewards",
        td["next", env.groups[1].name, "reward"].sum(1).flatten().tolist(),
    )


if __name__ == "__main__":
    main()
