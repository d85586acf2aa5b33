"""Kernels and Picard iteration find the same arcs. Both are compared with Basilisk in test_orbit.py."""

import math
from functools import cache

import pytest
import torch

from bsk_torch import SatelliteTasking, act, dyn, fsw, obs, sats
from bsk_torch.constants import R_EARTH
from bsk_torch.sim.access.visibility.planned import PlannedOrbits
from bsk_torch.sim.orbit.arcs import Arcs
from bsk_torch.sim.orbit.flown_arc import MULTISTEP_ORDER, MULTISTEP_STEP
from bsk_torch.sim.orbit.grid import LEAD_NODES, NODE_SPACING, PLAN_STEP
from bsk_torch.sim.orbit.kernel_solver import KernelSolver, make_solver
from bsk_torch.sim.orbit.picard import COLUMN_BLOCK, PicardSolver, padded
from tests.sim.orbit.arcs import above, flown

CPU = torch.device("cpu")
HOURS = 8

# perigee, m, eccentricity, inclination and true anomaly, rad; then bounds in m and m/s; measured beside
ORBITS = {
    "500 km": ((5e5, 0.0, 0.9, 2.0), 2e-5, 1e-7),  # 8e-6, 1e-8
    "polar": ((4e5, 0.01, 1.7, 0.0), 5e-5, 1e-7),  # 2.1e-5, 3e-8
    "200 km": ((2e5, 0.0, 0.9, 2.0), 1e-4, 2e-7),  # 5e-5, 5e-8
    "1200 km": ((1.2e6, 0.05, 2.5, 1.0), 5e-5, 1e-7),  # 1.3e-5, 2e-8
    "from perigee": ((3.5e5, 0.2, 1.0, 0.0), 5e-5, 2e-7),  # 1.8e-5, 7e-8
    "from apogee": ((3.5e5, 0.2, 1.0, math.pi), 2e-5, 3e-7),  # 5e-6, 1.3e-7
    "retrograde": ((3.5e5, 0.1, 2.5, 1.0), 2e-5, 1e-7),  # 3e-6, 2e-8
    "geostationary": ((42164e3 - R_EARTH, 0.0, 0.01, 2.0), 3e-4, 1e-7),  # 8e-5, 1e-8
    "transfer": ((3e5, 0.72, 0.5, 0.0), 4e-3, 5e-7),  # 1.9e-3: one digit of velocity at the perigee where it starts
    "half": ((3.5e5, 0.5, 1.0, -0.5), 5e-4, 1e-5),  # 1.7e-4, 3.3e-6 where it starts near perigee
}
NAMES = list(ORBITS)


@pytest.fixture(scope="module")
def both(solve_arcs):
    """Arcs and views of all orbits by Picard iteration and by kernels, for a tick of so many seconds."""
    initials = [above(*elements) for elements, _, _ in ORBITS.values()]
    return cache(lambda step: [solve_arcs(initials, HOURS, step, backend) for backend in ("eager", "compiled")])


def distance(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    return (a - b).norm(dim=-1)


@pytest.mark.compiled
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("step", [0.1, 1.0, 10.0])
def test_flown_arcs_agree(step, name, both):
    row, (_, metres, metres_per_second) = NAMES.index(name), ORBITS[name]
    (picard, _), (kernel, _) = both(step)
    assert distance(picard.flown[row], kernel.flown[row]).amax() < metres
    time = torch.arange(0.0, picard.length, 17.0, dtype=torch.float64)
    velocities = [flown(arcs, row, time)[1] for arcs in (picard, kernel)]
    assert distance(*velocities).amax() < metres_per_second


@pytest.mark.compiled
@pytest.mark.parametrize("name", NAMES)
def test_the_first_nodes_are_found_by_iteration(name, both):
    """Before the multistep method has its accelerations: measured 1e-9 to 3e-7 m."""
    row, nodes = NAMES.index(name), LEAD_NODES + 1 + math.ceil((MULTISTEP_ORDER - 2 * LEAD_NODES) * MULTISTEP_STEP / NODE_SPACING)
    (picard, _), (kernel, _) = both(1.0)
    assert distance(picard.flown[row, :nodes], kernel.flown[row, :nodes]).amax() < 1e-6


@pytest.mark.compiled
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("step", [1.0, 10.0])
def test_planned_arcs_agree(step, name, both):
    """Within 3 m: 7 m are the millisecond that windows may be off. Measured up to 1.1 m (200 km)."""
    row = NAMES.index(name)
    views: list[PlannedOrbits] = [view for _, view in both(step)]
    assert distance(*(view.samples.table[row] for view in views)).amax() < 3.0
    # what the plan adds to the flown arc is a hundred times more
    arcs: Arcs = both(step)[0][0]
    assert distance(arcs.flown[row, LEAD_NODES:], views[0].samples.table[row, ::2]).amax() > 80.0


@pytest.mark.compiled
def test_nearby_plans_drift_apart_smoothly(solve_arcs):
    """A tenth of a millimetre per second makes some metres in eight hours, without noise on the way."""
    first = above(5e5, 0.0, 0.9, 2.0)
    second = first | {"vN": [first["vN"][0] + 1e-4, *first["vN"][1:]]}
    _, view = solve_arcs([first, second], HOURS, backend="compiled")
    apart = distance(*view.samples.table)
    assert (apart[1:].diff().abs() < 0.1).all()
    assert 0.1 < apart[-1] < 30.0


def test_solvers_by_back_end_and_their_steps():
    assert isinstance(make_solver(1.0, "compiled", CPU), KernelSolver)
    assert isinstance(make_solver(1.0, "eager", CPU), PicardSolver)
    # Nodes of the flown arc are every second step, those of the plan every second sample.
    assert NODE_SPACING == 2.0 * MULTISTEP_STEP == 2.0 * PLAN_STEP
    # What is compiled for its shapes: powers of two of the block.
    sizes = {len(padded(count, CPU, few_sizes=True)) for count in range(1, 20 * COLUMN_BLOCK)}
    assert sizes == {COLUMN_BLOCK * blocks for blocks in (1, 2, 4, 8, 16, 32)}
    assert padded(50, CPU, few_sizes=True).tolist() == [*range(50), *[49] * (2 * COLUMN_BLOCK - 50)]


@pytest.mark.parametrize("count", [1, 47, 48, 49, 100])
def test_padding(count):
    rows = padded(count, CPU)
    assert len(rows) % COLUMN_BLOCK == 0
    assert len(rows) - count < COLUMN_BLOCK
    assert rows[:count].tolist() == list(range(count))
    assert (rows[count:] == count - 1).all()


@pytest.mark.parametrize("backend", ["eager", pytest.param("compiled", marks=pytest.mark.compiled)])
@pytest.mark.nightly("eager")
def test_the_degree_of_the_field_belongs_to_the_dynamics_model(backend):
    """Arcs and integrated orbits of degree 4 agree with each other, and differ from those of degree 10 by the missing terms."""
    model = type("Coarse", (dyn.DynamicsModel,), {"gravity_degree": 4})
    orbit = {"rN": [6.9e6, 0.0, 0.0], "vN": [0.0, 5.4e3, 5.4e3]}
    positions, duration = {}, 600.0 if backend == "compiled" else 240.0
    for name, dyn_type, options in (
        ("arc", model, {}),
        ("flown", model, {"orbit": "integrated"}),
        ("full", dyn.DynamicsModel, {}),
    ):
        satellite = type(
            "Mine", (sats.Satellite,), {"dyn_type": dyn_type, "fsw_type": fsw.FSWModel, "observation_spec": [obs.Time()]}
        )
        satellite.action_spec = [act.Drift(duration=duration)]
        env = SatelliteTasking(satellite("A", orbit), time_limit=duration, backend=backend, seed=0, **options)
        env.rollout(1)
        positions[name] = env.satellite.dynamics.r_BN_N
    torch.testing.assert_close(positions["arc"], positions["flown"], rtol=0, atol=1e-3)
    assert 0.01 < (positions["full"] - positions["arc"]).norm() < 1e3
    with pytest.raises(TypeError, match=r"Wrong.gravity_degree=11 must be 0 \(a point mass\) or from 2 to 10"):
        type("Wrong", (dyn.DynamicsModel,), {"gravity_degree": 11})
