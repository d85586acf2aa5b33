"""Python objects of episodes as part of the state: reset, copied, saved and restored with the tensors."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from typing_extensions import override

from bsk_torch.sim.state import StateTable

LENGTH, BYTES = "length", "bytes"
"""Names in saved states: number of bytes of each object, and the bytes, padded with zeros."""


class ObjectTable(StateTable):
    """One object for each episode, made when it is first asked for.

    Copied and saved objects are bytes until they are asked for. An object that is as at the start of its episode has none: it is
    made again.
    """

    def __init__(
        self,
        num_envs: int,
        device: torch.device,
        make: Callable[[int], Any],
        dump: Callable[[Any], bytes],
        load: Callable[[int, bytes], Any],
        check: Callable[[bytes], None],
    ) -> None:
        """Prepare for ``num_envs`` objects.

        Args:
            num_envs: Number of episodes.
            device: Device of the state.
            make: Returns the object of an episode that begins, by its number.
            dump: Returns an object as bytes; none if it is as at the start.
            load: Returns the object of an episode from bytes.
            check: Raises ValueError for bytes that ``load`` would not read.
        """
        super().__init__(num_envs, 1, device)
        self.make, self.dump, self.load, self.check_bytes = make, dump, load, check
        self.entries: list[Any] = [b""] * num_envs

    def of(self, env: int) -> Any:
        """Return the object of episode ``env``."""
        entry = self.entries[env]
        if isinstance(entry, bytes):
            entry = self.entries[env] = self.load(env, entry) if entry else self.make(env)
        return entry

    def saved(self, env: int) -> bytes:
        """Return the object of an episode as bytes."""
        entry = self.entries[env]
        return entry if isinstance(entry, bytes) else self.dump(entry)

    @override
    def reset(self, envs: Tensor) -> None:
        for env in envs.tolist():
            self.entries[env] = b""
        self.touch()

    @override
    def copy_rows(self, envs: Tensor, other: StateTable, source: Tensor) -> None:
        assert isinstance(other, ObjectTable)
        for env, entry in zip(envs.tolist(), [other.saved(env) for env in source.tolist()], strict=True):
            self.entries[env] = entry
        self.touch()

    @override
    def to_tensordict(self) -> TensorDict:
        values = self._gathered(torch.arange(self.num_envs))
        return TensorDict(values, [self.num_envs], device=self.device)

    def _gathered(self, envs: Tensor) -> dict[str, Any]:
        rows = [torch.frombuffer(bytearray(entry), dtype=torch.uint8) if entry else torch.zeros(0, dtype=torch.uint8)
                for entry in map(self.saved, envs.tolist())]  # fmt: skip
        table = torch.nn.utils.rnn.pad_sequence(rows, batch_first=True)
        length = torch.tensor([len(row) for row in rows])
        return {LENGTH: length.to(self.device), BYTES: table.to(self.device)}

    def over(self, saved: Mapping[str, Any] | TensorDictBase) -> ObjectTable:
        """See :meth:`StateTable.over`; KeyError for what is no saved table of objects, ValueError for bytes of others."""
        if set(saved.keys()) != {LENGTH, BYTES}:
            raise KeyError(f"the saved state has {sorted(saved.keys())} instead of objects; it was saved by another environment")
        lengths, table = saved[LENGTH].tolist(), saved[BYTES].cpu().numpy()
        other = ObjectTable(len(lengths), self.device, self.make, self.dump, self.load, self.check_bytes)
        other.entries = [row[:length].tobytes() for row, length in zip(table, lengths, strict=True)]
        for entry in set(other.entries):
            self.check_bytes(entry)
        return other
