"""Record episodes of ``inspection_v0`` of AFRL's safe-autonomy-sims: python record_afrl_inspection.py inspection.npz.

See record_afrl_docking.py for what it needs. The observation has the direction of a cluster of points; its k-means starts at
random points, so its starts and results are recorded, too.
"""

import argparse

import numpy as np
from safe_autonomy_sims.gym.inspection import InspectionEnv
from sklearn import cluster

FITS = []
"""Data, start and centers of each call of k-means."""


def fit(self, points):
    """Fit, and keep start and result."""
    start = np.array(self.init)
    result = FIT(self, points)
    FITS.append((np.array(points), start, np.array(self.cluster_centers_)))
    return result


FIT = cluster.KMeans.fit
cluster.KMeans.fit = fit


def tour(env, _):
    """Circle the chief at 60 m, out of the orbit plane."""
    r, v = env.deputy.position, env.deputy.velocity
    away = r / np.linalg.norm(r)
    axis = np.array([0.3, 0.2, 0.93])
    wish = 0.25 * np.cross(axis, away) + 0.01 * (60.0 - np.linalg.norm(r)) * away
    return np.clip(2.0 * (wish - v), -1.0, 1.0)


def dive(env, _):
    """Fly into the chief."""
    return np.clip(2.0 * (-0.3 * env.deputy.position / np.linalg.norm(env.deputy.position) - env.deputy.velocity), -1.0, 1.0)


def leave(env, _):
    """Fly away from the chief."""
    return np.sign(env.deputy.position)


def noise(_, rng):
    """Weak random forces."""
    return rng.uniform(-0.02, 0.02, 3)


def chase(env, _):
    """Fly toward the observed cluster of points, at 50 m."""
    goal = 50.0 * env._get_obs_kept[8:11]
    return np.clip(1.5 * (0.008 * (goal - env.deputy.position) - env.deputy.velocity), -1.0, 1.0)


CASES = {"tour": tour, "dive": dive, "leave": leave, "noise": noise, "chase": chase}


def episode(control, seed):
    """Return the entries of one episode."""
    env, rng = InspectionEnv(), np.random.default_rng(seed)
    observation, info = env.reset(seed=seed)
    points = env.chief.inspection_points.points
    states, seen, actions, rewards, flags, known = [env.deputy.state], [observation], [], [], [], []
    done = False
    while not done:
        env._get_obs_kept = observation
        action = control(env, rng).astype(np.float32)
        known.append([bool(point.inspected) for point in points.values()])
        observation, reward, terminated, truncated, info = env.step(action)
        done = terminated or truncated
        states.append(env.deputy.state)
        seen.append(observation)
        actions.append(action)
        rewards.append(reward)
        flags.append((terminated, truncated))
    known.append([bool(point.inspected) for point in points.values()])
    table = np.array([point.position for point in points.values()])
    return table, states, seen, actions, rewards, flags, known, info["status"]


def main(path):
    """Write the recording."""
    found = {}
    for k, (name, control) in enumerate(CASES.items()):
        points, states, seen, actions, rewards, flags, known, status = episode(control, 200 + k)
        print(name, status, len(actions), sum(rewards), np.sum(known[-1]))
        rows = np.arange(0, len(states), 1 if len(states) < 200 else 8)
        rows = np.unique(np.r_[rows, len(states) - 1])
        found |= {
            f"{name}/actions": np.array(actions, dtype=np.float32),
            f"{name}/rewards": np.array(rewards, dtype=np.float64),
            f"{name}/flags": np.array(flags)[-1],
            f"{name}/rows": rows,
            f"{name}/states": np.array(states)[rows],
            f"{name}/observations": np.array(seen)[rows],
            f"{name}/inspected": np.packbits(np.array(known)[rows], axis=1),
            f"{name}/sun": np.array(float(seen[0][6])),
            f"{name}/status": np.array(status),
        }
        found["points"] = points
    some = FITS[:: max(1, len(FITS) // 60)]
    for k, (data, start, centers) in enumerate(some):
        found |= {f"fit{k}/data": data, f"fit{k}/start": start, f"fit{k}/centers": centers}
    np.savez_compressed(path, **found)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("path", help="file to write, such as those in tests/tasks/safe_autonomy/recordings")
    main(parser.parse_args().path)
