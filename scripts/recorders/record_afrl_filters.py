"""Record forces filtered by AFRL's run-time-assurance: python record_afrl_filters.py filters.npz.

Needs Python 3.10 with run-time-assurance 1.18.6 and what it requires. It computes in float64 here. States are random, some of
them close to the limits of the constraints.
"""

import argparse
import warnings

import jax

jax.config.update("jax_enable_x64", True)

import numpy as np  # noqa: E402
from run_time_assurance.zoo.cwh.docking_3d import (  # noqa: E402
    Docking3dExplicitOptimizationRTA,
    Docking3dExplicitSwitchingRTA,
    Docking3dImplicitSwitchingRTA,
)
from run_time_assurance.zoo.cwh.inspection_1v1 import Inspection1v1RTA  # noqa: E402

DOCKING = {"v0": 0.2, "v1_coef": 2, "v0_distance": 0.5}
INSPECTION = {"v0": 0.2, "v1_coef": 2, "v0_distance": 15, "chief_radius": 7.5, "deputy_radius": 7.5, "r_max": 800}
COUNT = 200


def states(rng, near, far):
    """Return random positions, and velocities of up to 1.2 times the safe speed."""
    away = rng.normal(size=(COUNT, 3))
    r = away / np.linalg.norm(away, axis=1, keepdims=True) * np.exp(rng.uniform(np.log(near), np.log(far), (COUNT, 1)))
    limit = 0.2 + 2 * 0.001027 * (np.linalg.norm(r, axis=1, keepdims=True) - (0.5 if near < 1.0 else 15.0))
    direction = rng.normal(size=(COUNT, 3)) - 0.7 * r / np.linalg.norm(r, axis=1, keepdims=True)
    speed = np.minimum(limit, 1.7) * rng.uniform(0.3, 1.2, (COUNT, 1))
    return np.hstack([r, direction / np.linalg.norm(direction, axis=1, keepdims=True) * speed])


def filtered(module, rows, wishes, step):
    """Return the forces that a module makes of wishes, and whether its solver found any."""
    forces, solved = [], []
    for row, wish in zip(rows, wishes, strict=True):
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            forces.append(np.array(module.filter_control(row, step, wish)))
        solved.append(not any("Solver" in str(w.category) for w in caught))
        module.reset()
    return np.array(forces), np.array(solved)


def main(path):
    """Write the recording."""
    rng = np.random.default_rng(0)
    wishes = rng.uniform(-1.0, 1.0, (COUNT, 3))
    found, rows = {"wishes": wishes}, states(rng, 0.3, 300.0)
    modules = {
        "asif": Docking3dExplicitOptimizationRTA(**DOCKING),
        "simplex": Docking3dExplicitSwitchingRTA(**DOCKING),
        "implicit_simplex": Docking3dImplicitSwitchingRTA(**DOCKING),
    }
    found["docking/states"] = rows
    for name, module in modules.items():
        found[f"docking/{name}"], solved = filtered(module, rows, wishes, 1.0)
        print(name, np.mean(np.abs(found[f"docking/{name}"] - wishes).max(1) > 1e-6), solved.mean())
    rows, angles = states(rng, 15.5, 790.0), rng.uniform(0.0, 2.0 * np.pi, COUNT)
    module = Inspection1v1RTA(**INSPECTION)
    # the angle of its Sun decreases, so that its direction is (cos, sin, 0); the fuel used does not matter here
    known = np.hstack([rows, -angles[:, None], np.zeros((COUNT, 1))])
    forces, solved = filtered(module, known, wishes, 10.0)
    print("inspection", np.mean(np.abs(forces - wishes).max(1) > 1e-6), solved.mean())
    found |= {"inspection/states": rows, "inspection/angles": angles, "inspection/asif": forces, "inspection/solved": solved}
    values = []
    for row in known:
        state = module._get_state(row)
        values.append([float(c(state, module.params[k])) for k, c in module.constraints.items()])
    found["inspection/constraints"] = np.array(values)
    print(list(module.constraints), (np.array(values) < 0).mean(0))
    np.savez_compressed(path, **found)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("path", help="file to write, such as those in tests/tasks/safe_autonomy/recordings")
    main(parser.parse_args().path)
