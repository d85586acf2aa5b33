"""Functions of the user that give arguments: their order, what they share, and the random numbers that they draw."""

import random

import numpy as np
import pytest
import torch

from bsk_torch import SatelliteTasking, act, data, obs, rand, sats, scene
from bsk_torch.rand import Key, seeded
from bsk_torch.scene.draws import draw_numbers
from bsk_torch.sim import dyn
from tests.support.refusals import check_refusals, refusal


class Battery(sats.Satellite):
    observation_spec = (obs.Time(),)
    action_spec = (act.Drift(duration=60.0),)


class Imager(sats.ImagingSatellite):
    observation_spec = (obs.Time(),)
    action_spec = (act.Drift(duration=60.0),)


class Downlinker(Imager):
    dyn_type = dyn.GroundStationDynModel


def build(args=None, n=2, **options) -> SatelliteTasking:
    options = {"backend": "eager", "time_limit": 120.0, "seed": 3} | options
    return SatelliteTasking(satellite=Battery("EO1", args), num_envs=n, **options)


def key(n: int, seed: int = 3, episode: int = 0) -> Key:
    return Key(torch.full((n,), seed), torch.arange(n), torch.full((n,), episode))


def drawn(env: SatelliteTasking, *keys: Key) -> list[dict]:
    return [env.builder.draw(env.fleet, key)[0].values[0] for key in keys]


def numbers(n: int) -> list[tuple[float, float, float]]:
    with seeded(key(n)) as rows:
        return [(np.random.rand(), random.random(), float(torch.rand(()))) for _ in rows]


def test_global_generators_are_seeded_for_each_environment_and_put_back():
    np.random.seed(1), random.seed(1), torch.manual_seed(1)
    expected = np.random.rand(), random.random(), float(torch.rand(()))
    np.random.seed(1), random.seed(1), torch.manual_seed(1)
    four = numbers(4)
    assert ((np.random.rand(), random.random(), float(torch.rand(()))), numbers(8)[:4]) == (expected, four)
    assert len({number for row in four for number in row}) == 12
    np.random.seed(1)
    before = np.random.get_state()[1].copy()
    with pytest.raises(ZeroDivisionError), seeded(key(2)) as rows:
        raise ZeroDivisionError(next(rows))
    assert (np.random.get_state()[1] == before).all()
    assert isinstance(rand.random_orbit(), rand.RandomOrbit)


def test_the_outer_context_seeds():
    with seeded(key(1)) as rows:
        next(rows)
        first = np.random.rand()
        with seeded(key(1)) as inner:
            next(inner)
            second = np.random.rand()
    with seeded(key(1)) as rows:
        next(rows)
        assert np.random.rand(2).tolist() == [first, second]


def test_functions_that_use_numpy_do_not_depend_on_the_batch():
    env = build({"dragCoeff": lambda: np.random.uniform(1.0, 2.0), "mass": lambda: np.random.uniform(100.0, 200.0)})
    small, large, later = drawn(env, key(4), key(8), key(4, episode=1))
    for name in ("dragCoeff", "mass"):
        assert torch.equal(large[name][:4], small[name])
        assert len(torch.cat([large[name], later[name]]).unique()) == 12
    assert torch.equal(*(values["mass"] for values in drawn(env, key(4), key(4))))
    values = [draw_numbers("priority_distribution", lambda: np.random.rand(), key(n), 5) for n in (2, 4)]
    assert torch.equal(values[0], values[1][:2])
    assert len(values[1].unique()) == 20


def test_resets_with_one_seed_are_the_same():
    env = build({"mass": lambda: np.random.uniform(100.0, 200.0)}, time_limit=lambda: np.random.choice([60.0, 120.0, 180.0]))
    np.random.seed(7)
    env.reset()
    first = env.satellite.sat_args["mass"].clone(), env.time_limit.clone()
    env.set_seed(3)
    np.random.seed(8)
    env.reset()
    assert torch.equal(env.satellite.sat_args["mass"], first[0])
    assert torch.equal(env.time_limit, first[1])


def test_draws_of_a_scenario_that_calls_functions_do_not_depend_on_the_batch():
    def priority():
        return np.random.rand()

    satellite, targets = Imager("EO1", {}), scene.UniformTargets((2, 6), priority_distribution=priority)
    env = SatelliteTasking(satellite, targets, data.UniqueImageReward(), num_envs=2, backend="eager", time_limit=60.0)
    small, large = (env.builder.draw(env.fleet, key(n))[0].scenario for n in (2, 4))
    assert all(torch.equal(small[name], large[name][:2]) for name in small)
    assert len(small["target_priority"].unique()) > 2


def test_a_scenario_that_announces_its_use_of_numpy_is_seeded():
    class Hazy(scene.UniformTargets):
        calls_user = True

        def places(self, key):
            return super().places(key) | {"haze": torch.as_tensor(np.random.rand(len(key)))}

    env = SatelliteTasking(Imager("EO1", {}), Hazy(3), data.UniqueImageReward(), num_envs=2, backend="eager", time_limit=60.0)
    small, large = (env.builder.draw(env.fleet, key(n))[0].scenario["haze"] for n in (2, 4))
    assert torch.equal(small, large[:2])


def test_all_functions_of_an_environment_are_called_before_the_next_ones_and_in_the_order_of_bsk_rl():
    said: list[str] = []

    def tell(name, value):
        def function():
            said.append(name)
            return value

        return function

    def randomizer(satellites):
        said.append("randomizer")
        return {satellites[0]: {"mass": 200.0}}

    args = {"K": tell("K", 7.0), "mass": tell("mass", 300.0), "batteryStorageCapacity": tell("battery", 3e5)}
    world = {"utc_init": tell("utc_init", "2018 JUN 27"), "baseDensity": tell("density", 1e-12)}
    env = build(args, sat_arg_randomizer=randomizer, world_args=world, time_limit=tell("limit", 60.0))
    said.clear()
    (values,) = drawn(env, key(2))
    assert said == ["limit", "density", "utc_init", "randomizer", "K", "battery", "mass"] * 2
    assert values["mass"].tolist() == [200.0, 200.0]


def test_functions_that_share_state_give_pairs():
    class Pair:
        def capacity(self):
            self.value = np.random.uniform(1e5, 2e5)
            return self.value

        def charge(self):
            return 0.5 * self.value

    pair = Pair()
    (values,) = drawn(build({"storedCharge_Init": pair.charge, "batteryStorageCapacity": pair.capacity}), key(5))
    assert torch.equal(values["storedCharge_Init"], 0.5 * values["batteryStorageCapacity"])
    assert len(values["batteryStorageCapacity"].unique()) == 5


def test_one_function_for_all_arguments_is_called_once_for_each_environment():
    calls: list[int] = []

    def args():
        calls.append(1)
        capacity = np.random.uniform(1e5, 2e5)
        orbit = rand.random_orbit(i=45.0)
        orbit.f = 0.25
        return {"batteryStorageCapacity": capacity, "storedCharge_Init": capacity / 4, "oe": orbit, "K": rand.Uniform(6.0, 8.0)}

    def world():
        return {"utc_init": rand.random_epoch(2018, 2019), "baseDensity": lambda: 1e-12}

    env = build(args, world_args=world)
    calls.clear()
    (values,) = drawn(env, key(3))
    assert len(calls) == 3
    assert torch.equal(values["storedCharge_Init"], values["batteryStorageCapacity"] / 4)
    assert values["oe"][:, 5].tolist() == [0.25] * 3
    assert torch.equal(values["K"], 6.0 + 2.0 * key(3).named("K").uniform(1).squeeze(-1))
    assert len(values["utc_init"].unique()) == 3


def test_rejects_wrong_functions():
    class Careless(scene.UniformTargets):
        def places(self, key):
            return super().places(key) | {"haze": torch.as_tensor(np.random.rand(len(key)))}

    name = "mass"
    env = build(lambda: {name: 100.0})
    careless = lambda: SatelliteTasking(Imager("EO1", {}), Careless(3), backend="eager")
    name = "K"
    check_refusals(
        refusal(careless, TypeError, "Careless.draw(key)", "NumPy", "calls_user"),
        refusal(lambda: drawn(env, key(1)), ValueError, "sat_args", ["K"], ["mass"]),
        refusal(lambda: build(lambda: 3), TypeError, "sat_args", "returned 3", "dictionary"),
        refusal(lambda: build(lambda: {"masss": 1.0}), KeyError, "'masss'", "'mass'"),
        refusal(lambda: build(lambda: {"mass": -1.0}), ValueError, "mass=-1"),
        refusal(lambda: build(3), TypeError, "sat_args=3", "dictionary"),
        refusal(lambda: build({"utc_init": "2018 JUN 27"}), KeyError, "utc_init", "world_args"),
    )


def test_structural_arguments_are_taken_from_the_first_call():
    least = 0.3

    def world():
        return {"groundStationsData": [{"lat": 10.0, "long": 20.0}], "gsMinimumElevation": least, "baseDensity": 1e-12}

    satellite = Downlinker("EO1", {})
    env = SatelliteTasking(satellite, num_envs=2, backend="eager", time_limit=60.0, world_args=world)
    assert [len(env.world_args_generator["groundStationsData"]), env.world_args_generator["gsMinimumElevation"]] == [1, 0.3]
    assert drawn(env, key(2))[0]["baseDensity"].tolist() == [1e-12] * 2
    least = 0.4
    check_refusals(refusal(lambda: drawn(env, key(2)), ValueError, "gsMinimumElevation=0.4", "0.3"))


def test_random_orbit_is_drawn_within_functions_as_bsk_rl_draws_it():
    with seeded(key(1)) as rows:
        next(rows)
        orbit = rand.random_orbit(a=7000.0, e=0.01, Omega=90.0)
        epoch = rand.random_epoch(2018, 2019)
    with seeded(key(1)) as rows:
        next(rows)
        angles = np.random.uniform(-np.pi, np.pi), np.random.uniform(0, 2 * np.pi), np.random.uniform(0, 2 * np.pi)
    assert (orbit.a, orbit.e, orbit.Omega) == (7e6, 0.01, np.pi / 2)
    assert (orbit.i, orbit.omega, orbit.f) == angles
    assert epoch.startswith("2018 ")


def test_random_orbits_stand_for_their_distribution_in_old_forms_too(caplog):
    env = build({"oe": rand.random_orbit})
    assert not env.builder.calls_user
    assert torch.equal(drawn(env, key(3))[0]["oe"], rand.random_orbit().draw(key(3).named("oe")))
    assert rand.random_orbit(i=45.0, alt=600.0, r_body=6378.0) == rand.random_circular_orbit(45.0, 600.0, 6378.0)
    assert not caplog.records
    rand.random_orbit(a=7000.0, alt=600.0)
    assert "a=7000.0, e=0.0 and omega=None do not count" in caplog.text


def test_one_function_for_all_arguments_of_an_imaging_satellite():
    class Imager(sats.ImagingSatellite):
        observation_spec = (obs.Time(),)
        action_spec = (act.Charge(duration=30.0),)

    imager = Imager("EO1", lambda: dict(storedCharge_Init=np.random.uniform(1e5, 2e5), mass=100.0))
    assert imager.sat_args_generator["bufferNames"] == ["image_buffer"]
    env = SatelliteTasking(imager, num_envs=2, seed=0, backend="eager")
    env.reset()
    charge, mass = (env.satellite.sat_args[name] for name in ("storedCharge_Init", "mass"))
    assert charge[0] != charge[1]
    assert mass.tolist() == [100.0, 100.0]
