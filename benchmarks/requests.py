"""What requests cost: satellites of two-line element sets choose among requests, in many environments.

Usage:
    python benchmarks/requests.py [--batches 64 1024] [--requests 2000] [--hours 6.0] [--steps 20] [--out FILE.json]

The 20 satellites of ``bsk_torch.formats.SAMPLES`` serve requests at random places, with releases over the whole episode and
windows of one hour, by random actions. CPU times are of one thread. Decisions are those of satellites that ask for a task.
"""

from __future__ import annotations

import math
import time
from typing import Any

import harness
import torch

from bsk_torch import ConstellationTasking, act, data, obs, rand, sats, scene
from bsk_torch.env.agents import AGENTS
from bsk_torch.formats import SAMPLES
from bsk_torch.rl.policies.shared_policy import rule

HOUR = 3600.0

COLUMNS = {
    "environments": "{batch:,}",
    "satellites": "{satellites}",
    "requests": "{requests:,}",
    "reset, CPU s": "{reset:.1f}",
    "decisions/s": "{rate:,.0f}",
    "peak memory, GB": "{peak:.2f}",
}


class Server(sats.RequestSatellite):
    """A satellite that chooses among the next 16 requests."""

    observation_spec = (
        obs.OpportunityProperties(
            dict(prop="priority"),
            dict(prop="opportunity_open", norm=600.0),
            dict(prop="opportunity_close", norm=600.0),
            dict(prop="look_duration", norm=60.0),
            dict(prop="target_angle", norm=math.pi),
            n_ahead_observe=16,
        ),
    )
    action_spec = (act.ImageRequest(n_ahead_image=16), act.Drift(duration=60.0))


def make(batch: int, requests: int, hours: float) -> ConstellationTasking:
    """The environment."""
    window = HOUR
    served = scene.Requests(
        scene.UniformTargets(requests, priority_distribution=rand.Uniform(1.0, 10.0)),
        release=rand.Uniform(-window, HOUR * hours),
        window=window,
        duration=rand.Choice([10.0, 20.0, 30.0]),
        max_off_nadir=math.radians(35.0),
    )
    satellites = Server.from_tle(SAMPLES / "earth_observation.tle", {"imageTargetMinimumElevation": math.radians(20.0)})
    world = {"utc_init": "2026-04-14T00:00:00Z"}
    return ConstellationTasking(
        satellites, served, data.RequestReward(), num_envs=batch, world_args=world, time_limit=HOUR * hours, seed=0
    )


def measure(_: int, batch: int, requests: int, hours: float, steps: int) -> dict[str, Any]:
    """Row of a batch."""
    torch.set_num_threads(1)
    env = make(batch, requests, hours)
    begin = time.process_time()
    td = env.reset()
    reset = time.process_time() - begin
    policy, decisions = rule("random", env), 0
    begin = time.process_time()
    for _ in range(steps):
        decisions += int((~td[AGENTS, "action_mask"][..., -1]).sum())
        td = env.step_and_maybe_reset(policy(td))[1]
    rate = decisions / (time.process_time() - begin)
    size = {"batch": batch, "satellites": len(env.fleet.names), "requests": requests, "decisions": decisions}
    return size | {"reset": reset, "rate": rate, "peak": harness.peak() / 1e9}


def main() -> None:
    """Measure and print a table."""
    arguments = harness.parser(__doc__, batches=[64, 1024], requests=2000, hours=6.0, steps=20)
    options, described = harness.begin(arguments)
    rows = []
    for batch in options.batches:
        rows += harness.in_processes(1, measure, batch, options.requests, options.hours, options.steps)
        harness.write(options, described, rows=rows)
    print(harness.table(COLUMNS, rows))


if __name__ == "__main__":
    main()
