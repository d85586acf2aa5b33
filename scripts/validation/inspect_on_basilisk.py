"""Fly an inspector trained in bsk_torch on Basilisk itself, driven through bsk_rl, and compare episode by episode.

    python scripts/validation/inspect_on_basilisk.py runs/inspection --seeds 0:8 --out inspection.json

The episode of seed s is that of ``reset(seed=s)`` of one environment of RSOInspection-v1. On each side the policy decides by what
it observes there, and by the transfers to waypoints that start from where the inspector is there. bsk_rl has no waypoints: it
takes the change of velocity in the RSO's Hill frame and the time to drift that the transfer stands for, as
``ImpulsiveThrustHill``. The extra ``basilisk`` is needed, as for ``fly_on_basilisk.py``.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from flight_comparison import Pair, findings, kept, table
from flight_policy import policy_pilot
from fly_on_basilisk import seeds_of, versions
from rich.console import Console
from tensordict import TensorDict

import bsk_torch
from bsk_torch.astro.relative import fibonacci_sphere
from bsk_torch.env import ConstellationTasking
from bsk_torch.env.rollout import play_episodes
from bsk_torch.lab.basilisk.flight import Array, Flight, Pilot, absent_data, lacking, plain
from bsk_torch.rand import Key
from bsk_torch.rl.evaluation.evaluate import start_episodes
from bsk_torch.rl.policies.files import policy_of_file
from bsk_torch.rl.policies.pretrained import pretrained
from bsk_torch.rl.policies.shared_policy import GroupPolicies, baseline
from bsk_torch.sim.dyn.hub import initial_orbit
from bsk_torch.tasks.inspection.preset import CHIEF, FUEL, LONGEST_THRUST, NEAR, ORBIT, REGIONS, SLOW, names_of

PRESET = "RSOInspection-v1"

PRETRAINED = "pretrained"
"""Name of the policy that comes with the package."""

RULE = "survey"
"""Rule that can fly in the place of a policy."""

PENALTY = -1.0
"""Reward of who dies."""


def environment(num_envs: int, backend: str, **options: Any) -> ConstellationTasking:
    """Return the preset with bsk_rl's errors, orbits integrated as there, and float64 outputs."""
    where = dict(num_envs=num_envs, env_ids=[0] * num_envs, dtype=torch.float64, compat="bsk_rl", orbit="integrated")
    return bsk_torch.make(PRESET, actions="waypoints", backend=backend, **where, **options)


def pilot_of(policy: str) -> Pilot:
    """Return the pilot of inspectors by a policy's file, the package's one, or the rule; ValueError for what is none of these."""
    env = environment(1, "eager")
    found = baseline(RULE, env) if policy == RULE else pretrained(PRESET) if policy == PRETRAINED else policy_of_file(policy)
    if not isinstance(found, GroupPolicies):
        raise ValueError(f"{policy!r} has no policy for each group of satellites; it is not one of {PRESET}")
    return policy_pilot(found.policies[inspectors(env).name])


def inspectors(env: ConstellationTasking) -> Any:
    """Return the group of agents that are inspectors."""
    return next(group for group in env.groups if CHIEF not in group.agents)


# -- in bsk_torch --------------------------------------------------------------------------------------------------------------


def starts_of(env: ConstellationTasking, seeds: Sequence[int]) -> list[dict[str, Any]]:
    """Return what episodes start from, as bsk_rl takes it: arguments of the RSO and of the inspector, epoch and time limit."""
    key = Key(torch.tensor(seeds), env.env_ids.cpu(), env.episode.cpu())
    epochs = env.simulator.type.arguments.world_args.given["utc_init"].draw(key.named("utc_init"))
    satellites = []
    for group, described in zip(env.satellites, env.builder.satellites, strict=True):
        state, given = group.simulator.state, group.simulator.type.arguments.sat_args
        names = [name for name in given.table if name not in ("oe", "rN", "vN", "mu")]
        drawn = {name: plain(state.arguments[name]) for name in names if name in given.random and name in state.arguments}
        fixed = {name: given.given[name] for name in described.sat_args_generator if name in names and name not in drawn}
        r, v = (plain(x) for x in initial_orbit(state.all_arguments))
        rows = range(len(seeds))
        satellites.append(
            [fixed | {n: each[k] for n, each in drawn.items()} | {"oe": None, "rN": r[k], "vN": v[k]} for k in rows]
        )
    limits = env.time_limit.tolist()
    return [{"sats": [rows[k] for rows in satellites], "utc_init": epochs[k], "time_limit": limits[k]} for k in range(len(seeds))]


def fly_here(env: ConstellationTasking, pilot: Pilot, seeds: Sequence[int]) -> tuple[list[dict[str, Any]], list[Flight]]:
    """Return what the episodes of the seeds start from, and how they went in bsk_torch.

    Episodes end with the inspection on both sides: in bsk_rl, and here by its rules, satellites stay until the time limit.
    """
    start, group, chief = start_episodes(env, seeds), inspectors(env).name, next(g for g in env.groups if CHIEF in g.agents).name
    starts, log = starts_of(env, seeds), [(start[group, "observation"][:, 0].numpy(),)]
    seconds, count = torch.zeros(len(seeds), dtype=torch.float64), torch.zeros(len(seeds), dtype=torch.int64)

    complete, dead = torch.zeros(len(seeds), dtype=torch.bool), torch.zeros(len(seeds), 2, dtype=torch.bool)

    def policy(now: TensorDict) -> TensorDict:
        seen = TensorDict({name: now[group, name][:, 0] for name in ("observation", "action_mask")}, [len(seeds)])
        seen["action_mask"] = seen["action_mask"][:, :-1]
        action, logits = pilot(seen, seeds, len(log))
        now[group, "action"], now["logits"] = action.unsqueeze(1), logits
        now[chief, "action"] = (~now[chief, "action_mask"][..., 0]).long()
        return now

    for playing, step in play_episodes(env, policy, start):
        after, reward = step["next"], torch.stack([step["next", g.name, "reward"].flatten(1).sum(1) for g in env.groups]).sum(0)
        seen = after[group, "observation"][:, 0]
        log.append(tuple(x.numpy() for x in (seen, step[group, "action"][:, 0], step["logits"], reward)))
        moves = playing & ~complete
        seconds += torch.where(moves, after["duration"].squeeze(-1), 0.0)
        count += moves
        dead = torch.where(moves.unsqueeze(1), env.dead, dead)
        complete = env.rewarder.bonus_reward_yielded
        if bool(complete.all()):
            break
    names = [CHIEF, *names_of(1)]
    flights = []
    for row, seed in enumerate(seeds):
        k = int(count[row])
        observations = np.stack([entry[0][row] for entry in log[: k + 1]])
        actions, logits, rewards = (np.stack([entry[part][row] for entry in log[1 : k + 1]]) for part in (1, 2, 3))
        deaths = tuple(name for name, died in zip(names, dead[row].tolist(), strict=True) if died)
        time = round(float(seconds[row]), 9)
        flights.append(Flight(seed, actions, observations, logits, rewards, time, PENALTY * len(deaths), deaths, float("nan")))
    return starts, flights


# -- on Basilisk ---------------------------------------------------------------------------------------------------------------


class Navigator:
    """Transfers of an inspector from where it is on Basilisk: an environment of bsk_torch that is put into that state."""

    def __init__(self) -> None:
        """Build the environment; it never flies."""
        self.env = environment(1, "eager")
        self.env.reset()
        groups = self.env.satellites
        self.simulators = [group.simulator for group in groups]
        self.entry = groups[-1].actions.entries[0]

    def look(self, satellites: Sequence[Any]) -> Any:
        """Return the legal transfers of bsk_rl's inspector, the second of the satellites."""
        one = torch.ones(1, dtype=torch.bool)
        for simulator, satellite in zip(self.simulators, satellites, strict=True):
            for name in ("r_BN_N", "v_BN_N"):
                simulator.write(name, one, torch.tensor(np.array(getattr(satellite.dynamics, name))).unsqueeze(0))
        left = torch.tensor([satellites[1].fsw.dv_available], dtype=torch.float64)
        self.simulators[1].write("dv_available", one, left)
        return self.entry.options

    def manoeuvre(self, action: int) -> Array:
        """Return the change of velocity, m/s in the RSO's Hill frame, and the time to drift, s, of a transfer, [4]."""
        ahead, entry = self.entry.options.ahead, self.entry
        dv = ahead.manoeuvre(torch.tensor([action]))[0].numpy()
        reached = bool(ahead.cost.flatten(1)[0, action] <= entry.most_dv[0])
        whole = reached and not bool(entry.options.stuck[0])
        drift = float(entry.durations[action % len(entry.durations)]) if whole else entry.shortest
        return np.array([*dv, drift])


def build_there(env: ConstellationTasking, start: dict[str, Any]) -> Any:
    """Return bsk_rl's environment of an episode."""
    sys.path.insert(0, str(Path(__file__).parents[1] / "recorders"))
    from bsk_rl import ConstellationTasking as Tasking
    from bsk_rl import act, data, obs, scene
    from bsk_rl.obs.relative_observations import rso_imaged_regions
    from bsk_rl.utils.orbital import rv2HN
    from record_inspection import RSO, Inspector, fuel_of, sun_hat_chief

    def by_sun(function: Any) -> Any:
        """Return a vector of the chief in the Hill frame of the Earth's motion about the Sun."""

        def rotated(_: Any, chief: Any) -> Array:
            world = chief.simulator.world
            sun = world.gravFactory.spiceObject.planetStateOutMsgs[world.sun_index].read()
            HN = rv2HN(-np.array(sun.PositionVector), -np.array(sun.VelocityVector))
            return HN @ function(np.array(chief.dynamics.r_BN_N), np.array(chief.dynamics.v_BN_N))

        return rotated

    mu = bsk_torch.constants.MU_EARTH
    spec = [
        obs.SatProperties(dict(prop="dv_available", norm=FUEL)),
        obs.ResourceRewardWeight(),
        obs.RelativeProperties(
            dict(prop="r_DC_Hc", norm=NEAR),
            dict(prop="v_DC_Hc", norm=SLOW),
            dict(prop="rso_imaged_regions", fn=rso_imaged_regions),
            dict(prop="imaged_regions", fn=partial(rso_imaged_regions, region_centers=fibonacci_sphere(REGIONS))),
            dict(prop="sun_hat_Hc", fn=sun_hat_chief),
            dict(
                prop="eccentricity_Hs",
                fn=by_sun(lambda r, v: np.cross(v, np.cross(r, v)) / mu - r / np.linalg.norm(r)),
                norm=0.04184,
            ),
            dict(prop="h_Hs", fn=by_sun(lambda r, v: np.cross(r, v)), norm=5e10),
            dict(prop="r_Hs", fn=by_sun(lambda r, v: r), norm=7e6),
            chief_name=CHIEF,
        ),
        obs.Eclipse(norm=ORBIT),
        obs.Time(),
    ]
    thrust = act.ImpulsiveThrustHill(CHIEF, max_dv=LONGEST_THRUST, max_drift_duration=2 * ORBIT, fsw_action="action_inspect_rso")
    kind = type("Surveyor", (Inspector,), {"observation_spec": spec, "action_spec": [thrust]})
    rso, inspector = start["sats"]
    points, price = env.scenario, 0.1
    return Tasking(
        satellites=[RSO(CHIEF, sat_args=rso), kind(names_of(1)[0], sat_args=inspector)],
        scenario=scene.SphericalRSO(
            n_points=points.n_points,
            radius=points.radius,
            theta_max=points.theta_max,
            range_max=points.range_max,
            theta_solar_max=points.theta_solar_max,
        ),
        rewarder=(
            data.RSOInspectionReward(completion_bonus=1.0),
            data.ResourceReward(resource_fn=fuel_of, reward_weight=price),
        ),
        world_args=dict(utc_init=start["utc_init"]),
        time_limit=start["time_limit"],
        sim_rate=env.simulator.h,
        failure_penalty=PENALTY,
        log_level="CRITICAL",
    )


def fly_there(env: ConstellationTasking, start: dict[str, Any], pilot: Pilot, seed: int) -> Flight:
    """Return the course of an episode on Basilisk."""
    there, navigator = build_there(env, start), Navigator()
    name = names_of(1)[0]
    seen, info = there.reset(seed=0)
    there.action_space(name)
    begin = there.simulator.sim_time
    observations, steps, ended = [np.array(seen[name])], [], False
    while not ended:
        legal = navigator.look(there.satellites).legal
        vector = torch.as_tensor(observations[-1]).unsqueeze(0)
        action, logits = pilot(TensorDict({"observation": vector, "action_mask": legal}, [1]), [seed], len(steps))
        given = {name: navigator.manoeuvre(int(action[0]))}
        if info[CHIEF]["requires_retasking"]:
            given[CHIEF] = 0
        seen, reward, terminated, truncated, info = there.step(given)
        observations.append(np.array(seen[name]))
        steps.append((int(action[0]), logits[0].numpy(), float(sum(reward.values()))))
        ended = terminated[name] or truncated[name] or not there.agents
    deaths = tuple(satellite.name for satellite in there.satellites if not satellite.is_alive())
    actions, found, rewards = (np.array(part) for part in zip(*steps, strict=True))
    seconds = round(there.simulator.sim_time - begin, 9)
    there.close()
    return Flight(seed, actions, np.array(observations), found, rewards, seconds, PENALTY * len(deaths), deaths, float("nan"))


def main(given: list[str] | None = None) -> None:
    """Fly and print; end with a message where something is missing or wrong."""
    parser = argparse.ArgumentParser(description=f"Fly a policy of {PRESET} on Basilisk, and compare.")
    parser.add_argument(
        "policy", metavar="POLICY", help=f"folder of a training, its policy.pt, {PRETRAINED!r}, or the rule {RULE!r}"
    )
    parser.add_argument("--seeds", type=seeds_of, default=range(8), metavar="A:B", help="episodes A to B - 1 (default: 0:8)")
    parser.add_argument("--time-limit", type=float, help="length of an episode, s, instead of the preset's")
    parser.add_argument("--backend", choices=["compiled", "eager"], default="compiled", help="of bsk_torch")
    parser.add_argument("--out", type=Path, help="JSON file for the results, episode by episode")
    options = parser.parse_args(given)
    torch.set_num_threads(1)
    console = Console(soft_wrap=True, highlight=False)
    if missing := lacking():
        sys.exit(missing)
    if warning := absent_data(os.environ.get("BSK_SUPPORT_DATA_CACHE")):
        console.print(warning)
    try:
        pilot = pilot_of(options.policy)
    except (ValueError, FileNotFoundError) as error:
        sys.exit(str(error.args[0]))
    limit = {} if options.time_limit is None else {"time_limit": options.time_limit}
    env = environment(len(options.seeds), options.backend, **limit)
    starts, here = fly_here(env, pilot, options.seeds)
    pairs = []
    for start, flight in zip(starts, here, strict=True):
        pairs.append(Pair(flight, fly_there(env, start, pilot, flight.seed)))
        console.print(f"seed {flight.seed}: same actions {pairs[-1].same}, {flight.decisions} decisions")
    console.print(table(pairs, f"{options.policy} in {PRESET}: the same {len(pairs)} episodes in bsk_torch and in Basilisk"))
    group = inspectors(env)
    satellite = env.satellites[group.types[0]]
    for line in findings(pairs, satellite.observation_description, satellite.action_description):
        console.print(line)
    if options.out is not None:
        name = f"{PRESET}.pt" if options.policy == PRETRAINED else Path(options.policy).name
        about = {"policy": name, "preset": PRESET, "script": Path(__file__).name, "versions": versions()}
        options.out.write_text(json.dumps(about | kept(pairs)) + "\n")


if __name__ == "__main__":
    main()
