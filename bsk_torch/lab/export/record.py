"""Decisions of a policy in flight, as inputs and outputs of its graph."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import cast

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from bsk_torch.env import Tasking
from bsk_torch.env.rollout import play_episodes
from bsk_torch.lab.export.graph import OBSERVATION, Path, PolicyGraph, flat
from bsk_torch.rl.evaluation.evaluate import start_episodes
from bsk_torch.rl.policies.shared_policy import of_groups, shared

STEPS, DECISIONS = 64, 64
"""Steps flown for a record, and the most decisions that it keeps."""


@dataclass(frozen=True)
class Record:
    """Decisions, n of them.

    Attributes:
        inputs: Inputs of the graph by key, [n, ...].
        outputs: Outputs of the graph by name, [n, ...].
        seconds: Durations of the environment's steps.
    """

    inputs: dict[Path, Tensor]
    outputs: dict[str, Tensor]
    seconds: Tensor

    def __len__(self) -> int:
        return len(self.outputs["action"])

    def vectors(self) -> Tensor:
        """Return all observed numbers side by side, [n, D], as the C code takes them."""
        return flat([value for path, value in self.inputs.items() if path[:1] == OBSERVATION])


@torch.no_grad()
def recorded(env: Tasking, policies: Mapping[str, TensorDictModuleBase], graphs: Mapping[str, PolicyGraph]) -> dict[str, Record]:
    """Fly the episodes of seeds 0, 1, ..., and return decisions of each group, evenly spread over the flight.

    Outputs are those of ``graphs``; without a shield, they must be what the ``policies`` decided.

    Raises:
        RuntimeError: If a graph does not choose the actions of its policy.
    """
    asked: dict[str, list[TensorDictBase]] = {name: [] for name in policies}

    def keep(name: str, decided: TensorDictBase) -> None:
        asked[name].append(decided.select(*graphs[name].paths, "action").clone())

    hooks = [
        policy.register_forward_hook(lambda module, inputs, decided, name=name: keep(name, decided))
        for name, policy in policies.items()
    ]
    seconds, n = [], env.batch_size[0]
    try:
        start = start_episodes(env, range(n))
        for k, (playing, step) in enumerate(play_episodes(env, shared(of_groups(policies), env), start)):
            seconds.append(step["next", "duration"].reshape(n, -1)[playing])
            if k + 1 == STEPS:
                break
    finally:
        for hook in hooks:
            hook.remove()
    records = {}
    for name, parts in asked.items():
        rows = cast(TensorDictBase, torch.cat(parts))
        some = rows[torch.linspace(0, len(rows) - 1, min(DECISIONS, len(rows)), dtype=torch.float32).long()]
        inputs = {path: some[path] for path in graphs[name].paths}
        outputs = dict(zip(graphs[name].outputs, graphs[name](*inputs.values()), strict=True))
        if not graphs[name].only and not torch.allclose(outputs["action"], some["action"], rtol=0.0, atol=1e-5):
            raise RuntimeError(f"the graph of group {name!r} does not choose the actions of its policy")
        records[name] = Record(inputs, outputs, torch.cat(seconds).reshape(-1))
    return records
