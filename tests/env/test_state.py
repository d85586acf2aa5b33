"""The state of episodes: declared once, it takes part in resets, pools, saved states, copies of rows and pickles."""

import pickle
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import torch
from tensordict import TensorDict

import bsk_torch
from bsk_torch.sim.orbit.grid import ARC_SEGMENT, SAMPLES_PER_SEGMENT
from bsk_torch.sim.state import StateTable
from tests.support.episodes import begun, unchanged
from tests.support.refusals import check_refusals, refusal

N = 7
"""Number of environments; no other tensor has a dimension of this size, or of twice or thrice that, by chance."""

PACKAGE = str(Path(bsk_torch.__file__).parent)

SETUPS: dict[str, Any] = {
    "scan": lambda **options: bsk_torch.make("NadirScan-v1", **options),
    "imaging": lambda **options: bsk_torch.make("AEOS-v1", n_targets=120, **options),
    "constellation": lambda **options: bsk_torch.make("Constellation-v1", n_satellites=3, **options),
    "inspection": lambda **options: bsk_torch.make("RSOInspection-v1", **options),
}
"""One satellite that scans, one that images, three that talk, and one that manoeuvres about another."""

DIRECT = [setup for setup in SETUPS if setup != "inspection"]
"""Those whose satellites do not depend on one another within a tick, so that nothing is recorded."""

DERIVED = {
    "env_ids": "an argument",
    "links": "communication of the last step, for pictures and tests",
    "due": "episodes of the last communication",
    "since": "start of the present step",
    "all_envs": "indices",
    "seed": "prepared episodes: refilled where seeds differ",
    "episode": "prepared episodes",
    "filled": "prepared episodes",
    "_available": "computed from the scenario's draws",
    "_present": "computed from the scenario's draws and the time",
    "_values": "observables read since the last change",
    "_now": "the present on tensors",
    "_cache": "opportunities of the present decision",
    "_options": "transfers to waypoints from the present position",
    "_aims": "geometry of the present decision",
    "_clock": "seconds of the ticks",
    "_some_removed": "whether satellites have been removed",
    "_argument_planes": "arguments as kernels read them",
    "_table": "fixed commands of actions",
    "_all_legal": "a constant",
    "everywhere": "a constant",
    "_numbers": "numbers that all episodes share: seven, as many as there are episodes",
    "_norms": "norms of observed properties: seven numbers, as many as there are episodes",
    "terms": "rewards of the last step by rewarder",
}
"""Attributes that hold tensors of the batch without being state, and why: they follow from it, or from arguments."""


def make(setup: str, n: int = N, **options: Any) -> Any:
    return SETUPS[setup](num_envs=n, seed=3, time_limit=2400.0, **options)


def play(env: Any, td: TensorDict, steps: int, seed: int = 0) -> tuple[TensorDict, list[torch.Tensor]]:
    """Random legal actions that depend on the environment's row and the step only; the rewards of each step."""
    rewards = []
    for k in range(steps):
        generator = torch.Generator().manual_seed(seed + k)
        for key in env.action_keys:
            mask = td.get((*key[:-1], "action_mask") if isinstance(key, tuple) else "action_mask", None)
            if mask is None:  # changes of velocity of up to 0.1 m/s, and drifts of 60 to 600 s
                draw = torch.rand(env.full_action_spec[key].shape[1:], generator=generator)
                least, most = torch.tensor([[-0.05, -0.05, -0.05, 60.0], [0.05, 0.05, 0.05, 600.0]])
                td = td.set(key, (least + (most - least) * draw).expand(env.full_action_spec[key].shape).clone())
                continue
            draw = torch.rand(mask.shape[1:], generator=generator)
            td = td.set(key, torch.where(mask, draw, -1.0).argmax(-1))
        td = env.step(td)["next"]
        rewards.append(torch.cat([td[key].flatten(1) for key in env.reward_keys], 1))
    return td, rewards


def same(one: TensorDict, two: TensorDict) -> bool:
    """Whether two states are equal, but for the width of tables that grow."""
    for key in one.keys(include_nested=True, leaves_only=True):
        a, b = one[key], two[key]
        if a.shape != b.shape:
            width = min(a.shape[-1], b.shape[-1])
            a, b = a[..., :width], b[..., :width]
        if not torch.equal(a, b):
            return False
    return True


def now(env: Any) -> TensorDict:
    """The present of an environment, as a reset that puts its own state back gives it."""
    return env.reset(TensorDict({"state": env.get_state()}, env.batch_size), set_state=True)


@pytest.mark.compiled
@pytest.mark.parametrize("n", [N, 40], ids=["without pool", "with pool"])
def test_a_declared_field_takes_part_in_everything(n):
    """A dummy of each form, in each table: nothing but its declaration mentions it."""
    env, other = (make("constellation", n), make("constellation", 5))
    for each in (env, other):
        each.fleet.memory.declare("dummy", 1.5, 2)
        each.simulator.memory.declare("dummy", 2, dtype=torch.int64)
        each.simulator.lookahead.declare("dummy", float("inf"), 1, grows=True)
    before = env.bytes_per_env
    env.reset(), other.reset()
    tables = [(e.fleet.memory, e.simulator.memory, e.simulator.lookahead) for e in (env, other)]
    for (per_episode, per_satellite, growing), size in zip(tables, (n, 5), strict=True):
        per_episode["dummy"] = torch.arange(2.0 * size).view(size, 2)
        per_satellite["dummy"] = torch.arange(3 * size)
        growing.dummy = torch.arange(3.0 * size * size).view(3 * size, size)
    saved = pickle.loads(pickle.dumps(env.get_state()))
    assert saved["memory", "dummy"].tolist() == env.fleet.memory["dummy"].tolist()
    envs, source = torch.tensor([0, 4, 2]), torch.tensor([1, 1, 4])
    env.restore(other, envs, source)
    assert env.fleet.memory["dummy"][envs].tolist() == other.fleet.memory["dummy"][source].tolist()
    assert env.simulator.memory["dummy"].view(n, 3)[envs].tolist() == other.simulator.memory["dummy"].view(5, 3)[source].tolist()
    grown = env.simulator.lookahead.dummy.view(n, 3, -1)
    assert torch.equal(grown[envs, :, :5], other.simulator.lookahead.dummy.view(5, 3, 5)[source])
    assert torch.isinf(grown[envs, :, 5:]).all()
    assert torch.equal(env.fleet.memory["dummy"][5:], saved["memory", "dummy"][5:])
    env.reset(TensorDict({"_reset": torch.arange(n).unsqueeze(-1) == 4}, [n]))
    assert env.fleet.memory["dummy"][4].tolist() == [1.5, 1.5]
    assert env.simulator.memory["dummy"].view(n, 3)[4].tolist() == [2, 2, 2]
    assert env.fleet.memory["dummy"][0].tolist() == [2.0, 3.0]
    env.restore(saved)
    assert torch.equal(env.simulator.memory["dummy"], torch.arange(3 * n))
    assert env.bytes_per_env > before


def tensors_of(thing: Any, path: tuple[str, ...], known: set[int], declared: set[int]) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Tensors that are reachable from an object, by the names on the way there; those of tables are added to ``declared``."""
    if id(thing) in known or isinstance(thing, type | str | int | float | torch.dtype | torch.device):
        return
    known.add(id(thing))
    if isinstance(thing, torch.Tensor):
        yield path, thing
        return
    if isinstance(thing, StateTable):
        declared |= {thing[name].untyped_storage().data_ptr() for name in thing}
    if isinstance(thing, dict):
        parts = [(str(name), value) for name, value in thing.items()]
    elif isinstance(thing, list | tuple | set):
        parts = [("", value) for value in thing]
    elif type(thing).__module__.startswith(("bsk_torch", "tests")):
        parts = list(getattr(thing, "__dict__", {}).items())
    else:
        return
    for name, value in parts:
        yield from tensors_of(value, (*path, name) if name else path, known, declared)


def strays(env: Any) -> set[str]:
    """Tensors of the batch that are reachable from an environment, and neither declared nor derived."""
    declared: set[int] = set()
    parts = {name: value for name, value in vars(env).items() if not name.startswith(("_specs", "_arguments", "builder"))}
    parts |= {"scenario": env.scenario, "rewarder": env.rewarder, "communicator": env.communicator}
    found = list(tensors_of(parts, (), set(), declared))
    assert len(declared) > 30
    sizes = {N, N * env.simulator.count}
    return {
        ".".join(path)
        for path, tensor in found
        if {*tensor.shape[:1], *tensor.shape[-1:]} & sizes
        and tensor.untyped_storage().data_ptr() not in declared
        and not set(path) & set(DERIVED)
    }


@pytest.mark.compiled
@pytest.mark.parametrize("setup", SETUPS)
def test_tensors_of_the_batch_are_declared_or_derived(setup):
    env = make(setup)
    play(env, env.reset(), 3)
    assert not strays(env)


@pytest.mark.compiled
def test_a_tensor_that_is_not_declared_is_found():
    env = make("scan")
    env.reset()
    env.rewarder.stray, env.simulator.lookahead.arcs.solver.stray = torch.zeros(N, 2), torch.zeros(2, N)
    assert {name.split(".")[-1] for name in strays(env)} == {"stray"}


@pytest.mark.compiled
def test_nested_observations_after_a_restored_state_are_looked_through_for_nan():
    """Leaves of a set have the batch alone as their shape, too; the first step after a restored state looks at all of them."""
    env = bsk_torch.make("AEOS-v1", num_envs=2, n_targets=100, as_set=True, time_limit=600.0)
    env.reset()
    env.restore(env.get_state().to_dict(), torch.arange(2))
    following = env.play(torch.zeros(2, dtype=torch.int64), torch.ones(2, dtype=torch.bool))
    assert following["observation", "time"].shape == (2,)
    assert bool(torch.isfinite(following["observation", "target", "rows"]).all())


@pytest.mark.compiled
@pytest.mark.parametrize("form", ["tensordict", "dictionary", "file", "environment"])
@pytest.mark.parametrize("setup", SETUPS)
def test_restored_episodes_go_on_bit_for_bit(setup, form, tmp_path):
    """In another batch size, in any rows, and several times."""
    env, other = make(setup), make(setup, 4)
    td, _ = play(env, env.reset(), 4)
    other.reset()
    saved: Any = env.get_state()
    if form == "environment":
        saved = env
    elif form != "tensordict":
        saved = saved.to_dict()
    if form == "file":
        torch.save(saved, tmp_path / "state.pt")
        saved = torch.load(tmp_path / "state.pt")
    envs, source = torch.tensor([3, 0, 1]), torch.tensor([5, 5, 2])
    untouched = other.get_state()[2]
    other.restore(saved, envs, source)
    assert same(other.get_state()[2], untouched)
    ahead = now(other)
    for key in env.observation_keys:
        if "duration" not in key:  # of the last step, which a reset does not have
            assert torch.equal(ahead[key][envs], td[key][source]), key
    mine, theirs = env.get_state(), other.get_state()
    _, expected = play(env, td, 3, seed=100)
    _, rewards = play(other, ahead, 3, seed=100)
    for a, b in zip(expected, rewards, strict=True):
        assert torch.equal(b[envs], a[source])
    assert torch.equal(mine["returns"][source], theirs["returns"][envs])


def test_a_saved_state_stays_as_it_is_whatever_becomes_of_the_episodes():
    """TorchRL's partial resets write zeros into all that the tensordict of a restored state holds."""
    env = bsk_torch.make("NadirScan-v1", num_envs=2, time_limit=600.0, backend="eager")
    env.reset()
    saved = env.get_state()
    kept = saved.clone()
    td = env.reset(TensorDict({"state": saved}, env.batch_size), set_state=True)
    env.reset(td.set("_reset", torch.tensor([[True], [False]])))
    assert same(saved, kept)
    env.restore(saved)


@pytest.mark.compiled
def test_longer_arcs_are_met():
    """The shorter arcs of two environments are extended, and nothing of a saved state is written into."""
    long, short = make("scan"), SETUPS["scan"](num_envs=3, seed=8, time_limit=600.0)
    states = [env.reset() is not None and env.get_state() for env in (long, short)]
    copies = [state.clone() for state in states]
    lengths = [env.simulator.arcs.length for env in (long, short)]
    assert lengths[0] > lengths[1]
    one = torch.tensor([1])
    long.restore(states[1], torch.tensor([6]), one)
    short.restore(states[0], one, torch.tensor([2]))
    assert short.simulator.arcs.length == lengths[0]
    for state, kept in zip(states, copies, strict=True):
        assert (state == kept).all()
    r = [env.satellite.dynamics.r_BN_N for env in (long, short)]
    assert torch.equal(r[1][1], r[0][2])
    eclipses = [env.satellite.next_eclipse() for env in (long, short)]
    for a, b in zip(*eclipses, strict=True):
        assert a[2] == b[1]


@pytest.mark.compiled
def test_planned_hours_that_were_dropped_are_not_missed():
    """Arcs that grew dropped the first planned hour, searched by then, in states of earlier versions."""

    def seen(env: Any) -> torch.Tensor:
        windows = env.satellite.find_windows(8.0 * ARC_SEGMENT)
        return windows.place[1, windows.close[1].isfinite()]

    env, long, short = (make("imaging", 2) for _ in range(3))
    for each in (env, long, short):
        each.reset()
    lookahead = env.simulator.lookahead
    for each in (lookahead, long.simulator.lookahead):
        each.grow()
    lookahead.access.catch_up(lookahead.all_rows)
    saved, one = env.get_state(), torch.tensor([1])
    expected = seen(env)
    arcs = saved["satellites_0", "lookahead", "arcs"]
    arcs["planned"] = arcs["planned"][:, SAMPLES_PER_SEGMENT:]
    assert len(expected) > 40
    for each in (long, short):
        each.restore(saved, one, one)
        assert torch.equal(seen(each), expected)


@pytest.mark.compiled
def test_rejects_states_of_other_makes():
    wrong = [
        ("scan", {"sim_rate": 2.0}, "2000000000", "1000000000"),
        ("scan", {"backend": "eager"}, "satellites, world or back end"),
        ("scan", {"sat_args": {"mass": 200.0}}, "satellites, world or back end"),
        ("scan", {"compat": "bsk_rl"}, "satellites, world or back end"),
        ("imaging", {"sim_rate": 1.0}, "satellites, world or back end"),
    ]
    env, table = begun(SETUPS["scan"](num_envs=4, seed=1)), []
    rows = torch.tensor([0]), torch.tensor([1])
    for name, options, *names in wrong:
        other = begun(SETUPS[name](num_envs=3, **options))
        for state in (other, other.get_state()):
            table.append(refusal(lambda state=state: env.restore(state, *rows), ValueError, *names))
    with unchanged(env):
        check_refusals(table)


@pytest.mark.compiled
@pytest.mark.parametrize("setup", DIRECT)
def test_at_most_seven_frames_lie_between_a_step_and_its_kernel(setup):
    env = make(setup)
    td, ways = env.reset(), []

    def watch(frame: Any, event: str, _: Any) -> None:
        if event == "call" and frame.f_code.co_name == "call" and frame.f_code.co_filename.endswith("codegen/build.py"):
            names, at = [], frame
            while at is not None and at.f_code.co_name != "step":
                names += (
                    [getattr(at.f_code, "co_qualname", at.f_code.co_name)] if at.f_code.co_filename.startswith(PACKAGE) else []
                )
                at = at.f_back
            ways.append(names[::-1])

    for key in env.action_keys:
        td = td.set(key, env.full_action_spec[key].zero())
    sys.setprofile(watch)
    try:
        env.step(td)
    finally:
        sys.setprofile(None)
    flown = [way for way in ways if {"Simulator.run", "Simulator.fly"} & set(way) and "LookAhead.reach" not in way]
    assert flown
    assert all(len(way) <= 7 for way in flown), flown
