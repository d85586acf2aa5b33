"""Record several deputies of AFRL's programs: python record_afrl_crews.py crews.npz.

Forces filtered by run-time-assurance 1.18.6 for three inspectors, and episodes of the PettingZoo environments of
safe-autonomy-sims with two deputies. See record_afrl_filters.py and record_afrl_docking.py for what these need.
"""

import argparse
import warnings

import jax

jax.config.update("jax_enable_x64", True)

import numpy as np  # noqa: E402
from run_time_assurance.zoo.cwh.inspection_3d import InspectionRTA  # noqa: E402
from safe_autonomy_sims.pettingzoo.docking.multidocking_v0 import MultiDockingEnv  # noqa: E402
from safe_autonomy_sims.pettingzoo.inspection.multi_inspection_v0 import MultiInspectionEnv  # noqa: E402

LIMITS = {"v0": 0.2, "v1_coef": 2, "v0_distance": 15, "chief_radius": 7.5, "deputy_radius": 7.5, "r_max": 800}
COUNT, CREW = 200, 3
KEPT = 30
"""Steps recorded at the beginning and at the end of an episode."""


def states(rng):
    """Return random positions and velocities of crews, [COUNT, CREW * 6], some close to each other."""
    away = rng.normal(size=(COUNT, 3))
    first = away / np.linalg.norm(away, axis=1, keepdims=True) * np.exp(rng.uniform(np.log(20.0), np.log(300.0), (COUNT, 1)))
    found = []
    for k in range(CREW):
        gap = rng.normal(size=(COUNT, 3))
        gap *= np.exp(rng.uniform(np.log(15.5), np.log(120.0), (COUNT, 1))) / np.linalg.norm(gap, axis=1, keepdims=True)
        r = first + (gap if k else 0.0)
        r *= np.maximum(1.0, 16.0 / np.linalg.norm(r, axis=1, keepdims=True))
        limit = 0.2 + 2 * 0.001027 * (np.linalg.norm(r, axis=1, keepdims=True) - 15.0)
        direction = rng.normal(size=(COUNT, 3))
        speed = limit * rng.uniform(0.1, 1.05, (COUNT, 1))
        found += [r, direction / np.linalg.norm(direction, axis=1, keepdims=True) * speed]
    return np.hstack(found)


def record_filter(found):
    """Add the forces of the first deputy of each crew."""
    rng = np.random.default_rng(0)
    rows, angles, wishes = states(rng), rng.uniform(0.0, 2.0 * np.pi, COUNT), rng.uniform(-1.0, 1.0, (COUNT, 3))
    module = InspectionRTA(num_deputies=CREW, **LIMITS)
    known = np.hstack([rows, -angles[:, None]])  # the angle of its Sun decreases
    forces, solved, values = [], [], []
    for row, wish in zip(known, wishes, strict=True):
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            forces.append(np.array(module.filter_control(row, 10.0, wish)))
        solved.append(not any("Solver" in str(w.category) for w in caught))
        module.reset()
        state = module._get_state(row)
        values.append([float(c(state, module.params[k])) for k, c in module.constraints.items()])
    print("filter", np.mean(np.abs(np.array(forces) - wishes).max(1) > 1e-6), np.mean(solved))
    print(list(module.constraints), (np.array(values) < 0).mean(0))
    found |= {"filter/states": rows, "filter/angles": angles, "filter/wishes": wishes, "filter/forces": np.array(forces)}
    found |= {"filter/solved": np.array(solved), "filter/values": np.array(values)}


def braking(gain, share):
    """Return a controller: fly to the chief at a share of the safe speed."""

    def control(_, r, v, __):
        limit = 0.2 + 2.0 * 0.001027 * (np.linalg.norm(r) - 0.5)
        return np.clip(gain * (-share * limit * r / np.linalg.norm(r) - v), -1.0, 1.0)

    return control


def noise(scale):
    """Return random forces."""
    return lambda rng, *_: rng.uniform(-scale, scale, 3)


def still(_, __, v, ___):
    """Counteract velocity."""
    return np.clip(-6.0 * v, -1.0, 1.0)


def away(_, r, __, ___):
    """Fly away from the chief."""
    return np.sign(r)


def tour(distance, axis, speed):
    """Return a controller: circle the chief."""

    def control(_, r, v, __):
        out = r / np.linalg.norm(r)
        wish = speed * np.cross(np.array(axis), out) + 0.01 * (distance - np.linalg.norm(r)) * out
        return np.clip(2.0 * (wish - v), -1.0, 1.0)

    return control


def meet(share):
    """Return a controller: fly to the other deputy."""

    def control(_, r, v, other):
        gap = other - r
        return np.clip(2.0 * (share * gap / np.linalg.norm(gap) - v), -1.0, 1.0)

    return control


def dive(_, r, v, __):
    """Fly into the chief."""
    return np.clip(2.0 * (-0.3 * r / np.linalg.norm(r) - v), -1.0, 1.0)


DOCKING = {
    "dock": (braking(6.0, 0.6), braking(6.0, 0.3)),
    "crash": (still, braking(12.0, 1.004)),
    "collide": (braking(6.0, 0.5), meet(0.4)),
    "fast": (noise(1.0), noise(1.0)),
    "late": (still, still),
}
INSPECTION = {
    "tour": (tour(60.0, (0.3, 0.2, 0.93), 0.25), tour(80.0, (0.9, 0.3, 0.3), 0.3)),
    "dive": (noise(0.02), dive),
    "leave": (away, tour(60.0, (0.3, 0.2, 0.93), 0.25)),
    "collide": (tour(60.0, (0.3, 0.2, 0.93), 0.1), meet(0.3)),
}


def episode(env, controls, seed):
    """Return the entries of one episode."""
    rng = np.random.default_rng(seed)
    observations, infos = env.reset(seed=seed)
    names, done = env.possible_agents, False

    def state():
        return [env.deputies[a].state for a in names]

    states, seen, actions, rewards = [state()], [[observations[a] for a in names]], [], []
    while not done:
        now = np.array(states[-1])
        acts = [c(rng, now[k, :3], now[k, 3:6], now[1 - k, :3]) for k, c in enumerate(controls)]
        acts = {a: act.astype(np.float32) for a, act in zip(names, acts, strict=True)}
        observations, reward, terminations, _, infos = env.step(acts)
        done = any(terminations.values())
        states.append(state())
        seen.append([observations[a] for a in names])
        actions.append([acts[a] for a in names])
        rewards.append([reward[a] for a in names])
    rows = np.arange(len(states))
    rows = rows[(rows < KEPT) | (rows >= len(rows) - KEPT) | (rows % 40 == 0)]
    return {
        "actions": np.array(actions),
        "rewards": np.array(rewards, dtype=np.float64),
        "rows": rows,
        "states": np.array(states)[rows],
        "observations": np.array(seen)[rows],
        "status": np.array([infos[a]["status"] for a in names]),
    }


def main(path):
    """Write the recording."""
    found = {}
    record_filter(found)
    for k, (name, controls) in enumerate(DOCKING.items()):
        case = episode(MultiDockingEnv(), controls, 300 + k)
        print("docking", name, case["status"], len(case["actions"]), case["rewards"].sum(0))
        found |= {f"docking {name}/{key}": value for key, value in case.items()}
    for k, (name, controls) in enumerate(INSPECTION.items()):
        # by default, it never ends in success: success_threshold=100 of its 99 points; the time is that of one deputy
        case = episode(MultiInspectionEnv(success_threshold=99, max_time=12236), controls, 400 + k)
        print("inspection", name, case["status"], len(case["actions"]), case["rewards"].sum(0))
        found |= {f"inspection {name}/{key}": value for key, value in case.items()}
    np.savez_compressed(path, **found)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("path", help="file to write, such as those in tests/tasks/safe_autonomy/recordings")
    main(parser.parse_args().path)
