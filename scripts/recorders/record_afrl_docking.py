"""Record episodes of ``docking_v0`` of AFRL's safe-autonomy-sims: python record_afrl_docking.py docking.npz.

Needs Python 3.10 with safe-autonomy-simulation 2.2.1 and safe-autonomy-sims of commit 6d71f7e (March 2025), in which the price
of thrust is no longer that of release 4.2.3. Each episode follows one of the controllers
below, so that the episodes end in every possible way.
"""

import argparse

import numpy as np
from safe_autonomy_sims.gym.docking import DockingEnv

KEPT = 40
"""Steps recorded at the beginning and at the end of an episode."""


def braking(gain, share):
    """Return a controller: fly to the chief at a share of the safe speed."""

    def control(env, _):
        r, v = env.deputy.position, env.deputy.velocity
        limit = 0.2 + 2.0 * 0.001027 * (np.linalg.norm(r) - 0.5)
        return np.clip(gain * (-share * limit * r / np.linalg.norm(r) - v), -1.0, 1.0)

    return control


def noise(env, rng):
    """Random forces."""
    return rng.uniform(-1.0, 1.0, 3)


def away(env, _):
    """Fly away from the chief."""
    return np.sign(env.deputy.position)


def still(env, _):
    """Counteract velocity, so that time runs out."""
    return np.clip(-6.0 * env.deputy.velocity, -1.0, 1.0)


CASES = {
    "dock": (braking(6.0, 0.6), {}),
    "dock quickly": (braking(12.0, 0.9), {}),
    "crash": (braking(12.0, 1.004), {}),
    "noise": (noise, {}),
    "away": (away, {"max_v_violation": 10**9}),
    "still": (still, {}),
}


def episode(control, options, seed):
    """Return states [T + 1, 6], observations [T + 1, 8], actions [T, 3], rewards [T], flags [T, 2] and the status."""
    env, rng = DockingEnv(**options), np.random.default_rng(seed)
    observation, info = env.reset(seed=seed)
    states, seen, actions, rewards, flags = [env.deputy.state], [observation], [], [], []
    done = False
    while not done:
        action = control(env, rng).astype(np.float32)
        observation, reward, terminated, truncated, info = env.step(action)
        done = terminated or truncated
        states.append(env.deputy.state)
        seen.append(observation)
        actions.append(action)
        rewards.append(reward)
        flags.append((terminated, truncated))
    return states, seen, actions, rewards, flags, info["status"]


def main(path):
    """Write the recording."""
    found = {}
    for k, (name, (control, options)) in enumerate(CASES.items()):
        states, seen, actions, rewards, flags, status = episode(control, options, 100 + k)
        rows = np.unique(np.r_[: min(KEPT, len(states)), max(0, len(states) - KEPT) : len(states)])
        print(name, status, len(actions), sum(rewards))
        found |= {
            f"{name}/actions": np.array(actions, dtype=np.float32),
            f"{name}/rewards": np.array(rewards),
            f"{name}/flags": np.array(flags)[-1],
            f"{name}/rows": rows,
            f"{name}/states": np.array(states)[rows],
            f"{name}/observations": np.array(seen)[rows],
            f"{name}/status": np.array(status),
        }
    np.savez_compressed(path, **found)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("path", help="file to write, such as those in tests/tasks/safe_autonomy/recordings")
    main(parser.parse_args().path)
