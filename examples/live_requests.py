"""
Requests that arrive in flight
==============================

Eight satellites, half of them with infrared cameras, serve requests for images: each has a release and a due time, a look of
some seconds, a kind of camera, and a largest angle off nadir. Urgent requests arrive between decisions, and some of them are
withdrawn. A rule ranks requests by their weights and by how soon their looks can be complete.

On the command line::

    python examples/live_requests.py
    python examples/live_requests.py --num-envs 64 --steps 400
"""

from __future__ import annotations

import argparse
import math

import torch

from bsk_torch import ConstellationTasking, act, data, obs, rand, sats, scene
from bsk_torch.rl.policies.shared_policy import rule

HOUR = 3600.0


class Satellite(sats.RequestSatellite):
    """Looks at one of the next eight requests, or charges."""

    observation_spec = (
        obs.OpportunityProperties(
            dict(prop="priority", norm=10.0),
            dict(prop="opportunity_open", norm=600.0),
            dict(prop="opportunity_close", norm=600.0),
            dict(prop="look_duration", norm=60.0),
            dict(prop="time_to_due", norm=HOUR),
            dict(prop="target_angle", norm=math.pi),
            n_ahead_observe=8,
        ),
        obs.SatProperties(dict(prop="battery_charge_fraction")),
    )
    action_spec = (
        act.ImageRequest(n_ahead_image=8, max_duration=300.0),
        act.Charge(duration=120.0),
    )


def make(num_envs: int, seed: int = 0) -> ConstellationTasking:
    """Eight satellites on random orbits, and 300 requests for six hours, with room for 100 more."""
    args = {
        "oe": rand.random_orbit(alt=600.0, i=97.8),
        "imageTargetMinimumElevation": math.radians(20.0),
    }
    satellites = [
        Satellite(f"Sat{k}", args, sensor_types=["infrared" if k % 2 else "visible"])
        for k in range(8)
    ]
    requests = scene.Requests(
        scene.UniformTargets(300, priority_distribution=rand.Uniform(1.0, 10.0)),
        release=rand.Uniform(0.0, 4.0 * HOUR),
        window=rand.Uniform(0.5 * HOUR, 2.0 * HOUR),
        duration=rand.Choice([5.0, 15.0, 30.0]),
        sensors={"visible": 0.6, "infrared": 0.4},
        max_off_nadir=math.radians(35.0),
        spare=100,
    )
    return ConstellationTasking(
        satellites,
        requests,
        data.RequestReward(),
        num_envs=num_envs,
        time_limit=6.0 * HOUR,
        seed=seed,
    )


def arrive(env: ConstellationTasking, generator: torch.Generator) -> torch.Tensor:
    """Insert an urgent request in a quarter of the environments with room for it; return its index in each, -1 for none."""
    room = env.scenario.inserted < env.scenario.spare
    lot = torch.rand(env.num_envs, generator=generator) < 0.25
    rows = torch.nonzero(room & lot).squeeze(-1)
    inserted = torch.full((env.num_envs,), -1)
    if len(rows):
        place = torch.randn(len(rows), 1, 3, generator=generator, dtype=torch.float64)
        place = 6378137.0 * place / place.norm(dim=-1, keepdim=True)
        now = env.fleet.sim_time[rows].unsqueeze(-1)
        column = env.scenario.insert(
            rows, place, due=now + HOUR, duration=5.0, weight=20.0
        )
        inserted[rows] = column.squeeze(-1)
    return inserted


def main() -> None:
    """Serve requests by a rule, and print what has been served."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--num-envs", type=int, default=16, help="environments")
    parser.add_argument("--steps", type=int, default=100, help="decisions")
    parser.add_argument(
        "--seed", type=int, default=0, help="seed of episodes and arrivals"
    )
    options = parser.parse_args()

    torch.set_num_threads(1)
    env, generator = (
        make(options.num_envs, options.seed),
        torch.Generator().manual_seed(options.seed),
    )
    policy = rule("hasty", env)
    td = env.reset()
    total = withdrawn = 0
    for _ in range(options.steps):
        new = arrive(env, generator)
        total += int((new >= 0).sum())
        gone = torch.nonzero(
            (new >= 0) & (torch.rand(env.num_envs, generator=generator) < 0.2)
        ).squeeze(-1)
        if len(gone):
            env.scenario.cancel(gone, new[gone].unsqueeze(-1))
            withdrawn += len(gone)
        td = env.observe()  # with the requests of this moment
        td = env.step(policy(td))["next"]
        if bool(td["done"].all()):
            break
    measures = env.rewarder.measures()
    hours = float(env.fleet.sim_time.mean()) / HOUR
    print(
        f"{total} requests arrived and {withdrawn} were withdrawn in {hours:.1f} h of {options.num_envs} episodes"
    )
    served, weight, seconds = (
        float(measures[name].nanmean()) for name in ("CR", "WCR", "TAT")
    )
    print(
        f"served: {served:.1%} of the requests, {weight:.1%} of their weight, {seconds:.0f} s after release on average"
    )


if __name__ == "__main__":
    main()
