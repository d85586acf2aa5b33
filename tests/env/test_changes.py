"""Changes of ``sat_args`` and ``world_args`` between episodes."""

import pickle

import pytest
import torch

import bsk_torch
from bsk_torch import ConstellationTasking, SatelliteTasking, act, obs, rand, sats
from bsk_torch.astro.ephemeris import parse_utc
from bsk_torch.env.changes import Change, episodes, remembered
from bsk_torch.rand import Key
from bsk_torch.sim import dyn
from tests.support.episodes import begun
from tests.support.refusals import check_refusals, refusal


class Battery(sats.Satellite):
    observation_spec = (obs.Time(),)
    action_spec = (act.Drift(duration=60.0),)


class Store(sats.ImagingSatellite):
    observation_spec = (obs.Time(),)
    action_spec = (act.Drift(duration=60.0),)
    dyn_type = dyn.GroundStationDynModel


class Brief(Battery):
    action_spec = (act.Drift(duration=3.0),)


OPTIONS = {"backend": "eager", "time_limit": 120.0, "seed": 3}


def build(args=None, n=4, **options) -> SatelliteTasking:
    return SatelliteTasking(satellite=Battery("EO1", args or {}), num_envs=n, **OPTIONS | options)


def key(n: int, episode: int = 0) -> Key:
    return Key(torch.full((n,), 3), torch.arange(n), torch.full((n,), episode))


def drawn(env, n: int = 4) -> dict:
    return env.builder.draw(env.fleet, key(n))[0].values[0]


@pytest.fixture(scope="module")
def fresh():
    """An environment whose arguments no test changes."""
    return build()


def test_a_change_takes_effect_at_the_next_reset_of_its_rows_and_builds_nothing():
    env = build({"oe": rand.random_orbit(i=45.0)})
    env.reset()
    runners, tick = env.simulator.runners, env.simulator.tick
    env.set_sat_args({"storedCharge_Init": 1e4}, envs=[1, 3])
    present = env.satellite.sat_args["storedCharge_Init"].clone()
    env.reset()
    now = env.satellite.sat_args["storedCharge_Init"]
    assert now[[1, 3]].tolist() == [1e4, 1e4]
    assert (present > 1e4).all()
    assert (now[[0, 2]] > 1e4).all()
    assert env.simulator.runners is runners
    assert env.simulator.tick is tick
    assert env.satellite.dynamics.battery_charge[[1, 3]].tolist() == pytest.approx([1e4, 1e4], rel=1e-2)


def test_rows_take_constants_distributions_functions_and_give_them_back():
    env = build()
    env.set_sat_args({"storedCharge_Init": rand.Uniform(1e4, 2e4), "sigma_init": [0.1, 0.2, 0.3]}, envs=torch.tensor([0, 1]))
    env.set_sat_args({"storedCharge_Init": lambda: 5e4}, envs=torch.tensor([False, True, True, False]))
    values = drawn(env)
    charge = values["storedCharge_Init"]
    assert 1e4 <= charge[0] <= 2e4
    assert charge[1:3].tolist() == [5e4, 5e4]
    assert charge[3] > 5e4
    assert charge[0] == rand.Uniform(1e4, 2e4).draw(key(4).named("storedCharge_Init"))[0]
    assert values["sigma_init"][:2].tolist() == [[0.1, 0.2, 0.3]] * 2
    env.set_sat_args({"storedCharge_Init": 7e4})
    assert drawn(env)["storedCharge_Init"].tolist() == [7e4] * 4


def test_rows_that_are_not_changed_draw_what_they_drew_before(fresh):
    env = build()
    env.set_sat_args({"storedCharge_Init": 1e4, "oe": [7e6, 0.0, 0.1, 0.2, 0.3, 0.4]}, envs=[2])
    mine, theirs = drawn(env), drawn(fresh)
    for name in ("storedCharge_Init", "oe", "sigma_init"):
        assert torch.equal(mine[name][[0, 1, 3]], theirs[name][[0, 1, 3]])
    assert torch.equal(drawn(env, 3)["oe"], mine["oe"][:3])
    ids = torch.tensor([7, 7, 8])
    assert (episodes([0, 1], 3, ids)[1], episodes([2], 3, ids)[1]) == ((7, 7), (8,))
    check_refusals(refusal(lambda: episodes([0], 3, ids), ValueError, "env_ids"))


def test_a_difficulty_for_each_environment():
    env = build()
    env.set_sat_args({"storedCharge_Init": rand.per_env(torch.tensor([1e4, 2e4, 3e4, 4e4]))})
    assert drawn(env)["storedCharge_Init"].tolist() == [1e4, 2e4, 3e4, 4e4]
    env = build({"batteryStorageCapacity": rand.per_env([288e3] * 4)})
    tick = env.simulator.tick
    env.set_sat_args({"batteryStorageCapacity": 1e6}, envs=[1])
    env.set_sat_args({"batteryStorageCapacity": 2e6})
    assert env.simulator.tick is tick
    assert drawn(env)["batteryStorageCapacity"].tolist() == [2e6] * 4
    values = rand.per_env(torch.ones(8, dtype=torch.float64))
    options = {"num_envs": 2, "backend": "eager", "time_limit": 600.0, "sat_args": {"panelArea": values}}
    bsk_torch.make("NadirScan-v1", env_ids=[3, 7], **options).reset()
    check_refusals(refusal(lambda: bsk_torch.make("NadirScan-v1", env_ids=[3, 8], **options), ValueError, "per_env", "8"))


def test_a_tensor_of_difficulties_may_be_written_into():
    charge = torch.full((4,), 1e4, dtype=torch.float64)
    args = {"storedCharge_Init": rand.per_env(charge)}
    env = build(args)
    env.set_sat_args({"storedCharge_Init": 5e4}, envs=[2])
    charge[1] = 2e4
    env.set_sat_args(args, envs=[1, 2])
    assert drawn(env)["storedCharge_Init"].tolist() == [1e4, 2e4, 1e4, 1e4]
    assert not env.simulator.type.arguments.sat_args._of_envs[0]


def test_constants_that_are_not_changed_are_kept():
    env = build()
    kept = env.simulator.type.arguments.sat_args.draw(key(4))["mass"]
    env.set_sat_args({"storedCharge_Init": 1e4}, envs=[0])
    again = [env.simulator.type.arguments.sat_args.draw(key(4))["mass"] for _ in range(2)]
    assert again[0] is again[1]
    assert torch.equal(again[0], kept)
    assert len(again[0]) == 1


def test_a_parameter_that_was_one_constant_gets_a_tick_in_which_it_differs_once():
    env = build()
    env.reset()
    tick, charge = env.simulator.tick, env.satellite.dynamics.battery_charge_fraction.clone()
    env.set_sat_args({"batteryStorageCapacity": 1e6}, envs=[1])
    changed = env.simulator.tick
    assert changed is not tick
    assert torch.equal(env.satellite.dynamics.battery_charge_fraction, charge)
    env.reset()
    assert env.satellite.sat_args["batteryStorageCapacity"].tolist() == [288e3, 1e6, 288e3, 288e3]
    env.set_sat_args({"batteryStorageCapacity": 2e6}, envs=[2])
    assert env.simulator.tick is changed


def test_episodes_in_flight_keep_their_parameters():
    """The tick is built again between two steps: nothing changes until the next reset."""
    still, env = (SatelliteTasking(satellite=Brief("EO1", {}), num_envs=2, **OPTIONS) for _ in range(2))
    action = torch.zeros(2, dtype=torch.int64)
    for other in (still, env):
        other.reset()
        other.play(action)
    env.set_sat_args({"batteryStorageCapacity": 1e6, "mass": 100.0})
    for other in (still, env):
        other.play(action)
    for name in ("battery_charge", "r_BN_N", "sigma_BN"):
        assert torch.equal(getattr(env.satellite.dynamics, name), getattr(still.satellite.dynamics, name)), name


def test_arguments_of_the_world():
    env = build()
    env.set_world_args({"utc_init": "2018-06-27T12:00:00"}, envs=[0])
    env.set_world_args({"baseDensity": rand.Uniform(1e-12, 2e-12)})
    values = drawn(env)
    assert values["utc_init"][0] == parse_utc("2018-06-27T12:00:00")
    assert (values["utc_init"][1:] != values["utc_init"][0]).all()
    assert len(values["baseDensity"].unique()) == 4


def test_prepared_episodes_are_drawn_anew():
    env = build(n=33)
    assert env.pool is not None
    env.reset()
    env.set_sat_args({"storedCharge_Init": 1e4}, envs=[5])
    env.set_sat_args({"batteryStorageCapacity": 5e5})
    env.reset()
    args = env.satellite.sat_args
    assert args["storedCharge_Init"][5] == 1e4
    assert (args["batteryStorageCapacity"] == 5e5).all()
    env.set_sat_args({"storedCharge_Init": lambda: 2e4})
    env.reset()
    assert (args["storedCharge_Init"] == 2e4).all()


def test_satellites_are_changed_by_name_or_all():
    satellites = [Battery("A", {}), Battery("B", {}), Battery("C", {"mass": 100.0})]
    env = ConstellationTasking(satellites, num_envs=2, **OPTIONS)
    env.set_sat_args({"B": {"storedCharge_Init": 1e4}, "C": {"storedCharge_Init": 2e4}}, envs=[1])
    env.set_sat_args({"mass": 150.0})
    values = env.builder.draw(env.fleet, key(2))[0].values[0]
    charge = values["storedCharge_Init"].view(2, 3)
    assert (charge[0] > 2e4).all()
    assert charge[1, 0] > 2e4
    assert (charge[1, 1:].tolist(), values["mass"].tolist()) == ([1e4, 2e4], [150.0] * 6)
    with pytest.raises(ValueError, match="'D' is no satellite"):
        env.set_sat_args({"B": {"mass": 1.0}, "D": {"mass": 1.0}})
    with pytest.raises(TypeError, match=r"belongs to \['A', 'B', 'C'\]; env.set_sat_args"):
        env.satellites[0].sat_args_generator["mass"] = 3.0


def test_writing_into_the_generator_dictionaries_works():
    env = build()
    generator = env.satellite.sat_args_generator
    assert (generator["mass"], generator["K"]) == (330, 7.0)
    generator["storedCharge_Init"] = 1e4
    generator.update(dragCoeff=2.5)
    env.world_args_generator["utc_init"] = "2018 JUN 27"
    values = drawn(env)
    assert values["storedCharge_Init"].tolist() == [1e4] * 4
    assert (values["dragCoeff"].tolist(), generator["storedCharge_Init"]) == ([2.5] * 4, 1e4)
    assert env.world_args_generator["utc_init"] == "2018 JUN 27"
    with pytest.raises(TypeError, match="cannot be deleted"):
        del generator["mass"]
    check_refusals(
        refusal(lambda: generator.__setitem__("masss", 1.0), KeyError, "'mass'"),
        refusal(lambda: generator["masss"], KeyError, "'mass'"),
    )


def test_the_generator_of_a_satellite_has_all_arguments_and_is_taken_as_it_is_when_an_environment_is_built():
    satellite = Battery("EO1", {"mass": 100.0})
    satellite.sat_args_generator["K"] = 6.0
    assert (satellite.sat_args_generator["mass"], satellite.sat_args_generator["P"]) == (100.0, 35.0)
    check_refusals(refusal(lambda: satellite.sat_args_generator.__setitem__("masss", 1.0), KeyError, "'mass'"))
    env = SatelliteTasking(satellite, num_envs=1, **OPTIONS)
    satellite.sat_args_generator["K"] = 5.0
    assert drawn(env, 1)["K"].tolist() == [6.0]


def test_changes_survive_pickling_and_states_are_exchanged():
    env = build(n=2)
    env.set_sat_args({"batteryStorageCapacity": 1e6, "storedCharge_Init": 1e4}, envs=[1])
    env.set_world_args({"utc_init": "2018 JUN 27"})
    env.reset()
    other = pickle.loads(pickle.dumps(env))
    assert torch.equal(other.fingerprint, env.fingerprint)
    env.restore(other.get_state())
    for each in (env, other):
        each.reset()
    for name in ("batteryStorageCapacity", "storedCharge_Init", "utc_init", "oe"):
        assert torch.equal(env.satellite.sat_args[name], other.satellite.sat_args[name])


def test_states_of_before_a_change_that_built_nothing_can_be_restored():
    env = build(n=2)
    env.reset()
    before, charge = env.get_state(), env.satellite.dynamics.battery_charge.clone()
    env.set_sat_args({"storedCharge_Init": 1e4})
    env.reset()
    env.restore(before)
    assert torch.equal(env.satellite.dynamics.battery_charge, charge)


def test_changes_are_remembered_as_long_as_they_mean_something():
    def change(value, envs=None, name="mass", satellite=0):
        return Change(satellite, name, value, envs)

    kept = remembered([change(1.0), change(2.0, (0, 1)), change(3.0, (2,)), change(9.0, name="K")], [change(4.0, (1, 2))])
    assert kept == [change(1.0), change(2.0, (0,)), change(9.0, name="K"), change(4.0, (1, 2))]
    assert remembered(kept, [change(5.0)]) == [change(9.0, name="K"), change(5.0)]
    value = rand.per_env([1.0, 2.0, 3.0])
    assert remembered([change(value), change(1.0, (0,))], [change(value, (0, 2))]) == [change(value)]


def test_rejects_wrong_changes_which_change_nothing(fresh):
    rows, before, tick = torch.tensor([True]), drawn(fresh), fresh.simulator.tick
    change = fresh.set_sat_args
    check_refusals(
        refusal(lambda: change({"masss": 1.0}), KeyError, "'mass'"),
        refusal(lambda: change({"mass": -1.0}), ValueError, "mass=-1 kg"),
        refusal(lambda: change({"mass": -1.0}, [2]), ValueError, "mass=-1 kg"),
        refusal(lambda: change({"storedCharge_Init": 3e5}, [3]), ValueError, "batteryStorageCapacity"),
        refusal(lambda: change({"rN": [7e6, 0.0, 0.0]}), (ValueError, KeyError), "rN"),
        refusal(lambda: change({"oe": None}, [0]), ValueError, "oe", "environments"),
        refusal(lambda: change({"mass": 100.0}, [4]), IndexError, "0 to 3"),
        refusal(lambda: change({"mass": 100.0}, rows), IndexError, "mask of shape"),
        refusal(lambda: change(3), TypeError, "dictionary"),
    )
    after = drawn(fresh)
    assert fresh.simulator.tick is tick
    assert all(torch.equal(after[name], value) for name, value in before.items() if isinstance(value, torch.Tensor))


def test_rejects_changes_of_what_decides_what_is_built():
    env = SatelliteTasking(Store("EO1", {}), num_envs=2, **OPTIONS)
    check_refusals(
        refusal(lambda: env.set_world_args({"gsMinimumElevation": 0.5}), ValueError, "world_args", "gsMinimumElevation"),
        refusal(lambda: env.set_sat_args({"storageInit": 100.0}), ValueError, "storageInit", "components"),
        refusal(lambda: env.set_world_args({"baseDensit": 0.5}), KeyError, "'baseDensit'", "'baseDensity'"),
    )


ROWS = 4


def rows_of(good, bad, at=3):
    return rand.per_env([bad if k == at else good for k in range(ROWS)])


@pytest.mark.compiled
def test_rejects_wrong_rows_when_they_are_given():
    """Arguments of satellites and of the world that fit the first two environments of four, but not all."""
    options = {"num_envs": ROWS, "seed": 0, "time_limit": 600.0}
    dates = rows_of("2020-01-01T00:00:00", "2020-13-01T00:00:00")
    make = lambda **more: bsk_torch.make("NadirScan-v1", **options, **more)
    env, other, table = begun(make()), begun(make()), []
    for args, *names in (
        ({"panelArea": rand.per_env(torch.ones(2, dtype=torch.float64))}, "panelArea", "2 rows"),
        ({"panelArea": rows_of(1.0, -1.0)}, "panelArea=-1 m"),
        ({"panelArea": rows_of(1.0, [1.0, 2.0])}, "panelArea=", "real number", "list"),
        ({"batteryStorageCapacity": rows_of(3e8, 1.0)}, "storedCharge_Init=", "above"),
    ):
        table.append(refusal(lambda args=args: make(sat_args=args), ValueError, *names))
        table.append(refusal(lambda args=args: env.set_sat_args(args), ValueError, *names))
    for epochs, *names in ((dates, "utc_init"), (rand.per_env(["2020-01-01T00:00:00"]), "utc_init", "1 rows")):
        world = {"utc_init": epochs}
        table.append(refusal(lambda world=world: make(world_args=world), ValueError, *names))
        table.append(refusal(lambda world=world: env.set_world_args(world), ValueError, *names))
    check_refusals(table)
    assert (env.reset() == other.reset()).all()
    assert dict(env.satellite.sat_args_generator) == dict(other.satellite.sat_args_generator)
