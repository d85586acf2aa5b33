"""What bsk_rl observes, in the form in which a policy was trained. Nothing here needs Basilisk."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from tensordict import TensorDict
from torch import Tensor

TARGET = "target"
"""Name of the observation of targets."""


def as_sets(vector: Tensor, observed: Sequence[str]) -> TensorDict:
    """Return the observations of presets with ``as_set=True`` from the vector [n, F] of those without, whose entries are named.

    Targets become ``rows`` [n, T, features] with a ``mask`` [n, T], which is 0 for repetitions of the last target.
    """
    columns: dict[tuple[str, ...], list[int]] = {}
    for k, name in enumerate(observed):
        path = tuple(name.partition("[")[0].split("."))
        columns.setdefault((TARGET, "rows") if path[0] == TARGET else path, []).append(k)
    parts = TensorDict({}, vector.shape[:1])
    for path, where in columns.items():
        parts[path] = vector[:, where] if "[" in observed[where[0]] else vector[:, where[0]]
    if (TARGET, "rows") in columns:
        count = len({name.split(".")[1] for name in observed if name.startswith(f"{TARGET}.")})
        rows = vector[:, columns[TARGET, "rows"]].unflatten(1, (count, -1))
        new = (rows[:, 1:] != rows[:, :-1]).any(-1)
        parts[TARGET, "rows"], parts[TARGET, "mask"] = rows, torch.cat([new[:, :1] | True, new], 1).to(vector.dtype)
    return parts
