"""States that no environment has written: every tensor of a saved one, spoilt in turn, restored and stepped.

Run as a program, with the names of presets, because a crash of the process is one of the things that must not happen.
"""

import json
import math
import signal
import sys
from collections import Counter
from collections.abc import Iterator
from typing import Any

import torch
from tensordict import TensorDict

import bsk_torch

PRESETS: dict[str, dict[str, Any]] = {
    "NadirScan-v1": {},
    "AEOS-v1": {"n_targets": 120},
    "AEOSPower-v1": {"n_targets": 120},
    "Constellation-v1": {"n_satellites": 3, "n_targets": 120},
}

INTEGERS = (-(2**63), -1, 2**63 - 1, 2**31, 2**53)
FLOATS = (math.nan, math.inf, -1.0, 1e300, -math.inf, -1e300, 1e12)
"""Numbers to put in; the first ones are tried in any case."""

REFUSALS = (KeyError, TypeError, ValueError)

SECONDS = 20
"""A spoilt state must not keep a step busy for longer."""


def spoilt(state: TensorDict, columns: int) -> Iterator[tuple[tuple[str, ...], str, TensorDict]]:
    """Yield the key of a tensor, what is wrong with it, and the state with it.

    Numbers are put into all places at once, and one after the other into up to ``columns`` columns of the first episode; with no
    more than one column, only some numbers.
    """
    few = columns <= 1
    generator = torch.Generator().manual_seed(0)
    for key in state.keys(True, True):
        path, tensor = key if isinstance(key, tuple) else (key,), state[key]
        if tensor.dtype == torch.bool:
            yield path, "flipped", state.clone(recurse=False).set(key, ~tensor)
            continue
        numbers: tuple[float, ...] = INTEGERS if tensor.dtype == torch.int64 else FLOATS
        for value in numbers[: len(numbers) // 2 + 1] if few else numbers:
            yield path, f"all {value}", state.clone(recurse=False).set(key, torch.full_like(tensor, value))
            width = tensor[0].numel()
            for column in torch.randperm(width, generator=generator)[:columns].tolist() if width > 1 else ():
                one = tensor.clone(memory_format=torch.contiguous_format)
                one.view(len(one), -1)[0, column] = value
                yield path, f"{value} in column {column}", state.clone(recurse=False).set(key, one)
    for path, tensor in ((path if isinstance(path, tuple) else (path,), state[path]) for path in state.keys(True, True)):
        for what, other in (
            ("another type", tensor.float() if tensor.dtype != torch.float32 else tensor.double()),
            ("a dimension more", tensor.unsqueeze(-1)),
            ("twice as wide", torch.cat([tensor, tensor], -1) if tensor.ndim > 1 else torch.stack([tensor, tensor], 1)),
            ("empty", tensor[..., :0] if tensor.ndim > 1 else tensor.unsqueeze(1)[:, :0]),
        ):
            if path[-1] != "made_by":
                yield path, what, state.clone(recurse=False).set(path, other)


def same(one: TensorDict, two: TensorDict) -> bool:
    """Whether two states are equal, but for longer tables of the second one."""
    for key in one.keys(True, True):
        a, b = one[key], two[key]
        if a.shape != b.shape:
            columns = [slice(0, n) for n in a.shape]
            b = b[tuple(columns)] if key[-1] != "planned" else a
        if not torch.equal(a, b):
            return False
    return True


def legal(env: Any, td: TensorDict) -> TensorDict:
    """The first legal action of everybody."""
    for key in env.action_keys:
        mask = td[(*key[:-1], "action_mask")] if isinstance(key, tuple) else td["action_mask"]
        td = td.set(key, mask.long().argmax(-1))
    return td


def finite(td: TensorDict) -> bool:
    """Whether all numbers are."""
    return all(bool(torch.isfinite(leaf).all()) for leaf in td.values(True, True) if leaf.is_floating_point())


def judged(env: Any, td: TensorDict, before: TensorDict, path: tuple[str, ...], bad: TensorDict) -> str:
    """What became of a state: "refused", "played" or "failed in words"; AssertionError for anything else."""
    try:
        env.restore(bad if len(path) % 2 else bad.to_dict())
    except REFUSALS as error:
        words = str(error)
    else:
        return flown(env, td)
    named = path[-1] in words or path[-1] in ("planes", "values") or path == ("made_by",)
    assert named or "satellites_0" in words, f"{words} does not name {path}"
    assert same(before, env.get_state()), "half restored"
    return "refused"


def flown(env: Any, td: TensorDict) -> str:
    """How two steps end."""
    for _ in range(2):
        try:
            td = env.step(legal(env, td.clone()))["next"]
        except FloatingPointError:
            return "failed in words"
        except RuntimeError as error:
            if "comes into view" not in str(error):
                raise
            return "failed in words"
        assert finite(td), "outputs are not finite"
        td = td.exclude("reward")
    return "played"


def attack(name: str, columns: int) -> dict[str, Any]:
    """Try all spoilt states of a preset; return how many came to which end, and what went wrong."""
    env = bsk_torch.make(name, num_envs=2, seed=3, time_limit=2400.0, **PRESETS[name])
    td = env.reset()
    for _ in range(3):
        td = env.step(legal(env, td))["next"].exclude("reward")
    good, ends, wrong = env.get_state(), Counter(), []
    before = good
    for path, what, bad in spoilt(good, columns):
        signal.alarm(SECONDS)
        try:
            end = judged(env, td, before, path, bad)
        except Exception as error:
            end = "wrong"
            wrong.append(f"{'.'.join(path)}, {what}: {type(error).__name__}: {error!s:.200}")
            env.reset()
        ends[end] += 1
        if end != "refused":
            env.restore(good)
            before = env.get_state()
    signal.alarm(0)
    return {"ends": dict(ends), "wrong": wrong}


if __name__ == "__main__":
    torch.set_num_threads(1)
    sys.stdout.write(json.dumps({name: attack(name, int(sys.argv[1])) for name in sys.argv[2:]}) + "\n")
