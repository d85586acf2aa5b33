"""What an episode remembers beside the state of its simulation: what has been imaged, what was commanded last."""

from __future__ import annotations

from collections.abc import Iterator

import torch
from torch import Tensor


class Memory:
    """Named tensors [N, ...] that every reset sets back to their initial values."""

    def __init__(self, num_envs: int, device: torch.device) -> None:
        """Remember nothing yet."""
        self.num_envs, self.device = num_envs, device
        self.version = 0
        self._values: dict[str, Tensor] = {}
        self._initial: dict[str, float] = {}

    def add(self, name: str, initial: float, *shape: int, dtype: torch.dtype = torch.int64) -> None:
        """Remember ``name``, a tensor [N, *shape] that starts every episode with ``initial``; ValueError if it is taken."""
        if name in self._values:
            raise ValueError(f"name={name!r} is already remembered; known are {sorted(self._values)}")
        self._initial[name] = initial
        self._values[name] = torch.full((self.num_envs, *shape), initial, dtype=dtype, device=self.device)

    def __getitem__(self, name: str) -> Tensor:
        """The tensor ``name``."""
        return self._values[name]

    def __setitem__(self, name: str, value: Tensor) -> None:
        """Replace the tensor ``name``."""
        self._values[name] = value.to(self._values[name].dtype)
        self.version += 1

    def touch(self) -> None:
        """Say that something else that queries depend on has changed."""
        self.version += 1

    def __iter__(self) -> Iterator[str]:
        """Names."""
        return iter(self._values)

    @property
    def nbytes(self) -> int:
        """Bytes that the tensors take."""
        return sum(value.nbytes for value in self._values.values())

    def reset(self, rows: Tensor) -> None:
        """Start anew in ``rows`` [n]."""
        for name, value in self._values.items():
            fresh = value.clone()
            fresh[rows] = self._initial[name]
            self[name] = fresh

    def restore(self, name: str, rows: Tensor, saved: Tensor) -> None:
        """Put saved values [N, ...] back into ``rows`` [n]."""
        fresh = self._values[name].clone()
        fresh[rows] = saved[rows]
        self[name] = fresh
