"""Draws, default arguments and orbits agree with what the real bsk_rl gives under the same seed (tests/bsk_rl/data)."""

import inspect
import json
import math
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from bsk_torch.bsk_rl.defaults import sat_defaults, world_defaults
from bsk_torch.bsk_rl.scene import UniformTargets
from bsk_torch.bsk_rl.utils import attitude, orbital
from bsk_torch.bsk_rl.utils.actuator_primitives import balancedHR16Triad
from bsk_torch.sim import dyn, fsw, world
from bsk_torch.sim.assembly.composition import compose
from bsk_torch.tasks import inspection, objects
from tests.support.core_arguments import SPACECRAFT

RECORDED = json.loads((Path(__file__).parent / "data" / "recorded.json").read_text())

OWN = {"conjunction_exact"} | SPACECRAFT
"""Arguments of the core's components that bsk_rl lacks."""


def plain(value):
    if inspect.isfunction(value):
        return "drawn"
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    if hasattr(value, "Omega"):
        return {name: float(getattr(value, name)) for name in ("a", "e", "i", "Omega", "omega", "f")}
    if isinstance(value, dict):
        return {name: plain(entry) for name, entry in value.items()}
    return [plain(entry) for entry in value] if isinstance(value, list | tuple) else value


def assert_close(found, wanted, rel=1e-13):
    """Compare nested lists, dictionaries, words and numbers."""
    if isinstance(wanted, dict):
        assert list(found) == list(wanted)
        for name, value in wanted.items():
            assert_close(found[name], value, rel)
    elif isinstance(wanted, list):
        assert len(found) == len(wanted)
        for one, other in zip(found, wanted, strict=True):
            assert_close(one, other, rel)
    elif isinstance(wanted, float):
        assert found == pytest.approx(wanted, rel=rel, abs=1e-12)
    else:
        assert found == wanted


def drawn(draw):
    np.random.seed(RECORDED["seed"])
    value = plain(draw())
    return value, np.random.rand()


def generate(defaults):
    return {name: value() if callable(value) else value for name, value in defaults.items()}


def composed(names, module, base):
    places = (module, inspection, objects)
    return compose([next(getattr(place, name) for place in places if hasattr(place, name)) for name in names], base)


# -- default arguments -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("pair", RECORDED["pairs"])
def test_arguments_of_satellites_are_those_of_bsk_rl_in_order_and_draws(pair):
    wanted = RECORDED["pairs"][pair]
    models = composed(wanted["dyn"], dyn, dyn.DynamicsModel), composed(wanted["fsw"], fsw, fsw.FSWModel)
    found = {name: value for name, value in sat_defaults(*models).items() if name not in OWN}
    assert_close(list(map(list, plain(found).items())), wanted["defaults"], rel=0.0)
    values, left = drawn(lambda: generate(found))
    assert left == wanted["drawn"]["left"]
    assert_close(values, wanted["drawn"]["value"])
    assert isinstance(found.get("nHat_B", np.zeros(3)), np.ndarray)


@pytest.mark.parametrize("name", RECORDED["worlds"])
def test_arguments_of_worlds_are_those_of_bsk_rl_in_order_and_draws(name):
    wanted = RECORDED["worlds"][name]
    found = world_defaults(composed(wanted["world"], world, world.WorldModel))
    assert_close(list(map(list, plain(found).items())), wanted["defaults"], rel=0.0)
    values, left = drawn(lambda: generate(found))
    assert left == wanted["drawn"]["left"]
    assert_close(values, wanted["drawn"]["value"])


def test_defaults_are_not_shared():
    first, second = (sat_defaults(dyn.BasicDynamicsModel, fsw.BasicFSWModel) for _ in range(2))
    first["nHat_B"][0] = first["controlAxes_B"][0] = 5.0
    assert second["nHat_B"][0] == 0.0
    assert second["controlAxes_B"][0] == 1.0


def test_arguments_of_own_components_follow_behind():
    from bsk_torch.sim.component import Arg, Component

    class Warm(dyn.BasicDynamicsModel):
        components = (Component(slot="heater", args=(Arg("heaterPower", 3.0, "W", "power"),), after="base_power"),)

    found = [item for item in sat_defaults(Warm, fsw.BasicFSWModel).items() if item[0] not in OWN]
    assert found[-1] == ("heaterPower", 3.0)


# -- draws -----------------------------------------------------------------------------------------------------------------------


def named(*names):
    args = {"mu": orbital.orbitalMotion.MU_EARTH * 1e9}
    # namespaces cannot be keys of a dictionary; classes can
    return [type(name, (), {"name": name, "sat_args_generator": args}) for name in names]


def targets(n_targets, **options):
    scenario = UniformTargets(n_targets, **options)
    scenario.link_satellites([])
    scenario.reset_overwrite_previous()
    scenario.reset_pre_sim_init()
    return [(target.name, target.r_LP_P, target.priority) for target in scenario.targets]


def walker(**options):
    satellites = named(*(f"Sat{k}" for k in range(6)))
    return [args["oe"] for args in orbital.walker_delta_args(**options)(satellites).values()]


def formation():
    satellites = named("Deputy1", "Chief", "Deputy2")
    states = {
        "Deputy1": lambda: np.concatenate((np.random.uniform(-500, 500, 3), np.random.uniform(-1, 1, 3))),
        "Deputy2": [0.0, 1000.0, -200.0, 0.1, 0.0, -0.2],
    }
    args = orbital.relative_to_chief("Chief", orbital.random_orbit, states)(satellites)
    return [(satellite.name, args[satellite]["oe"]) for satellite in satellites]


def hill(spin):
    return attitude.hill_frame_attitude([7e6, 1e5, 2e5], [100.0, 7000.0, 2000.0], spin)


DRAWS = {
    "random_unit_vector": orbital.random_unit_vector,
    "random_orbit": orbital.random_orbit,
    "random_orbit_given": partial(orbital.random_orbit, i=30.0, a=7000.0, e=0.1, omega=12.0),
    "random_circular_orbit": partial(orbital.random_circular_orbit, alt=600.0),
    "random_epoch": orbital.random_epoch,
    "random_epoch_years": partial(orbital.random_epoch, 2010, 2012),
    "random_tumble": partial(attitude.random_tumble, 0.01),
    "hill_random": partial(hill, {"type": "uniform", "low": 0.1, "high": 2.0, "axis": "random"}),
    "hill_velocity": partial(hill, {"rate": 1.0, "axis": "velocity"}),
    "wheels": lambda: balancedHR16Triad(useRandom=True, randomBounds=(-300, 200))[2],
    "targets": partial(targets, 5),
    "targets_range": partial(targets, (3, 9), priority_distribution=lambda: np.random.uniform(1, 2), radius=6.4e6),
    "walker": partial(walker, n_planes=3, rel_phasing=0.3, altitude=600, inc=60.0),
    "walker_clusters": partial(walker, n_planes=2, clustersize=3, clusterspacing=2.0, randomize_lan=False),
    "formation": formation,
}


def test_all_recorded_draws_are_compared():
    assert DRAWS.keys() == RECORDED["draws"].keys()


@pytest.mark.parametrize("name", RECORDED["draws"])
def test_draws_are_those_of_bsk_rl(name):
    wanted = RECORDED["draws"][name]
    value, left = drawn(DRAWS[name])
    assert left == wanted["left"], "another number of draws"
    if name == "formation":  # the argument of periapsis of a near-circular orbit is sensitive to rounding
        found, recorded = (
            [orbital.elem2rv(3.98600436e14, SimpleNamespace(**oe)) for _, oe in pairs] for pairs in (value, wanted["value"])
        )
        np.testing.assert_allclose(found, recorded, rtol=1e-9, atol=1e-5)
        return
    assert_close(value, wanted["value"])


def test_points_of_a_sphere_are_those_of_bsk_rl():
    np.testing.assert_allclose(orbital.fibonacci_sphere(7), RECORDED["fibonacci"], atol=1e-15)


# -- look-ahead ------------------------------------------------------------------------------------------------------------------


def test_orbits_ahead_are_those_of_bsk_rl():
    wanted = RECORDED["trajectory"]
    elements = orbital.ClassicElements(**wanted["elements"])
    flown = orbital.TrajectorySimulator(RECORDED["epoch"], oe=elements, mu=orbital.orbitalMotion.MU_EARTH * 1e9)
    assert flown.sim_time == 0.0
    np.testing.assert_allclose([flown.next_eclipse(t) for t in wanted["asked"]], wanted["eclipses"])
    assert flown.sim_time == wanted["sim_time"]
    np.testing.assert_allclose(flown.r_BN_N(wanted["times"]), wanted["r_BN_N"], rtol=0.0, atol=0.2)
    np.testing.assert_allclose(flown.r_BP_P(wanted["times"]), wanted["r_BP_P"], rtol=0.0, atol=0.2)


@pytest.mark.parametrize("wanted", RECORDED["trajectory_steps"], ids=lambda wanted: str(wanted["dt"]))
def test_orbits_ahead_in_other_steps(wanted):
    """Positions differ by the error of bsk_rl's integration, which grows with the fourth power of the step."""
    elements = orbital.ClassicElements(**RECORDED["trajectory"]["elements"])
    options = dict(oe=elements, mu=orbital.orbitalMotion.MU_EARTH * 1e9, dt=wanted["dt"])
    flown = orbital.TrajectorySimulator(RECORDED["epoch"], **options)
    np.testing.assert_allclose([flown.next_eclipse(t) for t in wanted["asked"]], wanted["eclipses"])
    assert flown.sim_time == wanted["sim_time"]
    for name in ("r_BN_N", "r_BP_P"):
        bound = (wanted["dt"] / 20.0) ** 4  # m in two orbits
        np.testing.assert_allclose(getattr(flown, name)(wanted["times"]), wanted[name], rtol=0.0, atol=bound)


def test_orbits_ahead_do_not_depend_on_the_questions():
    elements = orbital.ClassicElements(**RECORDED["trajectory"]["elements"])
    once, often = (orbital.TrajectorySimulator(RECORDED["epoch"], oe=elements, mu=3.98600436e14) for _ in range(2))
    once.extend_to(12_000.0)
    for t in (100.0, 3_700.0, 7_300.0, 12_000.0):
        often.extend_to(t)
    assert np.array_equal(once.times, often.times)
    assert len(once.times) == 401
    np.testing.assert_array_equal(once.r_BN_N(11_999.0), often.r_BN_N(11_999.0))


def test_an_orbit_may_be_given_by_position_and_velocity():
    r, v = orbital.elem2rv(3.98600436e14, orbital.ClassicElements(7e6, 0.0, 1.0, 0.0, 0.0, 0.0))
    flown = orbital.TrajectorySimulator(RECORDED["epoch"], rN=r, vN=v)
    assert flown.r_BN_N(0.0) == pytest.approx(r)
    period = 2 * math.pi * math.sqrt(7e6**3 / 3.98600436e14)
    flown.extend_to(period)
    assert 10e3 < np.linalg.norm(flown.r_BN_N(period) - r) < 100e3  # the Earth's oblateness
    for wrong in ({"rN": r}, {"rN": r, "vN": v, "oe": 1.0, "mu": 1.0}, {}):
        with pytest.raises(ValueError, match="an orbit is given by"):
            orbital.TrajectorySimulator(RECORDED["epoch"], **wrong)
    with pytest.raises(ValueError, match=r"dt=0\.0 s must be a positive number"):
        orbital.TrajectorySimulator(RECORDED["epoch"], rN=r, vN=v, dt=0.0)
