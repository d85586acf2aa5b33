"""Episodes under one of torch's default types, written to a file: every tensor that they show or keep, by its name.

Run as a program, with the type, the file and the cases, because kernels are traced once in a process.
"""

import sys
from collections import Counter
from collections.abc import Iterator, Mapping
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torch.utils import _pytree
from torch.utils._python_dispatch import TorchDispatchMode

import bsk_torch

STEPS = 4

SHORT = torch.float16, torch.bfloat16
"""Types that nothing in an environment has."""

LIMITED: dict[str, Any] = {"time_limit": 3000.0, "max_step_duration": 400.0, "failure_penalty": -0.1}
"""Short steps, and a penalty that no short type holds."""

CASES: dict[str, tuple[str, dict[str, Any]]] = {
    "scanning": ("NadirScan-v1", {}),
    "scanning, eager": ("NadirScan-v1", {"backend": "eager", "max_step_duration": 15.0}),
    "scanning, integrated": ("NadirScan-v1", {"orbit": "integrated"}),
    "scanning, mixed precision": ("NadirScan-v1", {"sim_dtype": torch.float32}),
    "imaging": ("AEOSPower-v1", {"n_targets": 100}),
    "clouds": ("CloudyAEOS-v1", {"n_targets": 100}),
    "constellation": ("Constellation-v1", {"n_satellites": 3, "n_planes": 1, "phasing": 0, "n_targets": 100}),
    "inspection": ("RSOInspection-v1", {}),
    "crew": ("MultiInspection-v1", {}),
}
"""Presets and their options."""


class Made(TorchDispatchMode):
    """Counts operations that make tensors of a type from none of it, by the line of the package."""

    def __init__(self, dtype: torch.dtype) -> None:
        super().__init__()
        self.dtype, self.found = dtype, Counter[str]()

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        result = func(*args, **(kwargs or {}))
        if self._has(result) and not self._has((args, kwargs)):
            line = line_of_package(1)
            if line is not None:
                self.found[f"{line}: {func}"] += 1
        return result

    def _has(self, tree: Any) -> bool:
        return any(isinstance(leaf, Tensor) and leaf.dtype == self.dtype for leaf in _pytree.tree_leaves(tree))


def line_of_package(depth: int) -> str | None:
    """The line of the package, None for what TorchRL makes in between, such as the blank values of specs."""
    frame: Any = sys._getframe(depth + 1)
    while frame is not None:
        file = frame.f_code.co_filename
        if "/torchrl/" in file or "/tensordict/" in file:
            return None
        if "/bsk_torch/" in file:
            return f"{file.rpartition('/bsk_torch/')[2]}:{frame.f_lineno}"
        frame = frame.f_back
    return None


def chosen(env: Any, td: TensorDictBase, number: int) -> TensorDictBase:
    """Actions that depend on masks, and on the number of the step."""
    for key in env.action_keys:
        where = key[:-1] if isinstance(key, tuple) else ()
        mask = td.get((*where, "action_mask"), None)
        if mask is None:
            low, high = (side.cpu().double() for side in env.full_action_spec[key].space)
            share = (0.37 * (number + torch.arange(low.numel(), dtype=torch.float64))).view(low.shape) % 1.0
            td[key] = (low + share * (high - low)).to(env.full_action_spec[key].dtype)
        else:
            order = (torch.arange(mask.shape[-1]) + number) % mask.shape[-1]
            td[key] = torch.where(mask, order, -1).argmax(-1)
    return td


def windows(env: Any) -> Iterator[tuple[str, Tensor]]:
    """Windows of all kinds of places beyond the end of the episodes."""
    for k, satellite in enumerate(env.satellites):
        access = satellite.simulator.access
        for kind in () if access is None else access.kinds:
            for name, table in satellite.find_windows(3e4, kind)._asdict().items():
                yield f"{kind} of {k}, {name}", table


def played(preset: str, options: Mapping[str, Any]) -> dict[str, Tensor]:
    """Every tensor of some steps of a few episodes."""
    env: Any = bsk_torch.make(preset, num_envs=3, seed=1, dtype=torch.float64, **{**LIMITED, **options})
    td, found = env.reset(), {}
    for number in range(STEPS):
        shown = env.step(chosen(env, td, number))
        found |= {f"step {number}, {key}": value.clone() for key, value in shown.items(True, True)}
        td = shown["next"]
        if bool(td["done"].any()):
            td = env.reset()
    found |= {f"state, {key}": value for key, value in env.get_state().items(True, True)}
    return found | dict(windows(env))


if __name__ == "__main__":
    _, type_name, path, *names = sys.argv
    torch.set_default_dtype(getattr(torch, type_name))
    results: dict[str, Any] = {}
    for case in names:
        if torch.get_default_dtype() not in SHORT:
            results[case] = played(*CASES[case])
            continue
        with Made(torch.get_default_dtype()) as made:
            results[case] = played(*CASES[case])
        results[case]["made"] = dict(made.found)
    torch.save(results, path)
