"""Access to observed values by name."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from tensordict import TensorDictBase
from torch import Tensor

from bsk_torch.sim.arguments.values import nearest


class Columns:
    """Observed values by the end of their names."""

    def __init__(self, observation: Tensor | TensorDictBase, description: Sequence[str]) -> None:
        """Read ``observation``, a vector [..., F] with the entries ``description``, or a tensordict with these parts."""
        self.observation, self.description = observation, description

    def all(self, name: str) -> Tensor:
        """Return the entries named ``name`` or ``name[k]``, [..., width]; KeyError if there is none."""
        indices = [k for k, entry in enumerate(self.description) if _last(entry) == name]
        if not indices:
            raise KeyError(f"{name!r} is not observed; {nearest(name, map(_last, self.description))}")
        observation = self.observation
        if isinstance(observation, Tensor):
            return observation[..., indices]
        parts = [observation[path] for path in dict.fromkeys(_path(self.description[k]) for k in indices)]
        return torch.cat(
            [part.unsqueeze(-1) if part.ndim == observation.ndim else part.flatten(observation.ndim) for part in parts], -1
        )

    def __getitem__(self, name: str) -> Tensor:
        """Return the first entry of that name, [...]."""
        return self.all(name)[..., 0]


def _path(entry: str) -> tuple[str, ...]:
    """Return the key of the part of a nested observation to which an entry of its vector belongs."""
    return tuple(entry.split("[")[0].split("."))


def _last(entry: str) -> str:
    return _path(entry)[-1]
