"""Reading of datasets: tensordicts, and replay buffers of TorchRL."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDict
from torchrl.data import TensorDictReplayBuffer, TensorStorage
from torchrl.data.replay_buffers.writers import ImmutableDatasetWriter

from bsk_torch.lab.offline.layout import CARD, COUNTERFACTUALS, EPISODE, FORMAT, SEED, STARTS, TRANSITIONS
from bsk_torch.sim.names import nearest
from bsk_torch.untrusted import MOST_JSON, Count, Json, Word, parse_json, read_bytes, read_memmap


@dataclass
class BehaviorCard:
    """What a card must say of a behavior."""

    folder: str
    episodes: Count


@dataclass
class Card:
    """What the file :data:`~bsk_torch.lab.offline.layout.CARD` must say."""

    behaviors: dict[Word, BehaviorCard]
    targets: list[Word]
    share: float


@dataclass(frozen=True)
class OfflineDataset:
    """A dataset that :func:`~bsk_torch.lab.offline.write_dataset` has written.

    Tensors are mapped from files, and cannot be written.

    Attributes:
        folder: Its folder.
        card: Content of ``dataset.json``: preset, options, seeds, behaviors, targets, names of observations and actions.
    """

    folder: Path
    card: Mapping[str, Any]

    @property
    def behaviors(self) -> list[str]:
        """Names of the behaviors."""
        return list(self.card["behaviors"])

    def transitions(self, *behaviors: str) -> TensorDict:
        """Return the decisions of the ``behaviors`` (default: all) in TorchRL's TED layout, [T], one episode after the other.

        At the root are the observation, ``action_mask`` [T, A], ``action`` [T], ``action_log_prob`` [T], the logarithm of the
        probability of the action under the behavior, and ``episode`` [T]; under ``next`` also ``reward`` [T, 1] and ``duration``
        [T, 1] s of the decision. Those of one behavior are mapped; several are joined in memory, and have episodes of different
        numbers.

        Raises:
            ValueError: For an unknown behavior, with the nearest name.
        """
        names = self._names(behaviors)
        parts = [_load(self._path(name) / TRANSITIONS, EPISODE) for name in names]
        return parts[0] if len(parts) == 1 else _joined(parts, [self.card["behaviors"][name]["episodes"] for name in names])

    def counterfactuals(self, *behaviors: str) -> TensorDict:
        """Return the sampled decisions of the ``behaviors`` (default: all), [D].

        Next to the observation, ``action_mask``, ``action`` and ``action_log_prob`` of the behavior there are ``episode`` and
        ``decision``, the row ``index`` in the transitions of the behavior, and for every target
        ``("action_value", target)`` [D, A] float64, the returns of all legal actions from the decision on, followed by the target
        (NaN for illegal actions), ``("target_action", target)`` [D], and with several futures
        ``("standard_error", target)`` [D, A].

        Raises:
            ValueError: For an unknown behavior, with the nearest name, or without any sampled decision.
        """
        names = self._names(behaviors)
        folders = [self._path(name) / COUNTERFACTUALS for name in names]
        parts = [_load(folder, EPISODE) for folder in folders if folder.is_dir()]
        if not parts:
            raise ValueError(
                f"{str(self.folder)!r} has no sampled decisions of {', '.join(names)}; see share={self.card['share']}"
            )
        return parts[0] if len(parts) == 1 else _together(parts)

    def starts(self) -> TensorDict:
        """Return the first observations of the episodes, [E].

        ``seed`` [E] names them; ``("action_value", target)`` [E] float64 has the return of each target, and
        ``("target_action", target)`` [E] its first action.

        Raises:
            ValueError: For a dataset without targets.
        """
        if not self.card["targets"]:
            raise ValueError(f"{str(self.folder)!r} was written without targets, and has no returns of other policies")
        return _load(self.folder / STARTS, SEED)

    def replay_buffer(self, *behaviors: str, batch_size: int, **options: object) -> TensorDictReplayBuffer:
        """Return a replay buffer of TorchRL with the transitions of the ``behaviors`` (default: all), which cannot be extended.

        Args:
            *behaviors: Names of the behaviors.
            batch_size: Size of samples.
            **options: Further arguments of the buffer, such as ``sampler=SliceSampler(slice_len=8, traj_key="episode")``.
        """
        storage = TensorStorage(self.transitions(*behaviors))
        return TensorDictReplayBuffer(storage=storage, writer=ImmutableDatasetWriter(), batch_size=batch_size, **options)

    def target(self, name: str) -> str:
        """Return the name of a target; ValueError, with the nearest name, for an unknown one."""
        if name not in self.card["targets"]:
            raise ValueError(f"there is no target {name!r}; {nearest(name, self.card['targets'])}")
        return name

    def _names(self, behaviors: tuple[str, ...]) -> list[str]:
        for name in behaviors:
            if name not in self.behaviors:
                raise ValueError(f"there is no behavior {name!r}; {nearest(name, self.behaviors)}")
        return list(behaviors) or self.behaviors

    def _path(self, name: str) -> Path:
        folder = self.card["behaviors"][name]["folder"]
        path = self.folder / folder
        if path.name != folder or path.resolve().parent != self.folder.resolve():  # absolute paths, "..", links
            raise ValueError(f"{str(self.folder / CARD)!r}: folder={folder!r} of {name!r} must be a folder next to it")
        return path


def open_dataset(folder: Path | str) -> OfflineDataset:
    """Return the dataset in a folder; nothing is read into memory.

    Raises:
        FileNotFoundError: If the folder has no ``dataset.json``.
        ValueError: If it is not the card of a dataset, or one of a later version of the package.
    """
    path = Path(folder) / CARD
    if not path.is_file():
        raise FileNotFoundError(f"{str(folder)!r} is not a dataset: it has no file {CARD!r}")
    try:
        content = read_bytes(path, MOST_JSON)
        card = parse_json(content, dict[str, Json])
        if card.get("format") == FORMAT:
            parse_json(content, Card)
    except ValueError as error:
        raise ValueError(f"{str(path)!r} is not the card of a dataset: {error}") from None
    if card.get("format") != FORMAT:
        raise ValueError(f"{str(path)!r} has format {card.get('format')!r:.40}; this version of bsk_torch reads format {FORMAT}")
    return OfflineDataset(Path(folder), card)


def _load(folder: Path, number: str) -> TensorDict:
    """Return the tensordict of a folder; ValueError for other content than tensors, or without the ``number`` of every row."""
    rows = read_memmap(folder)
    numbers = rows.get(number, None)
    if rows.ndim != 1 or numbers is None or numbers.shape != rows.shape or numbers.dtype != torch.int64:
        raise ValueError(f"{str(folder)!r} is no folder of a dataset: it has no {number!r} of every row")
    return rows


def _together(parts: list[TensorDict]) -> TensorDict:
    """Return the rows of several behaviors; ValueError where they have different entries."""
    try:
        return torch.cat(parts)
    except (KeyError, RuntimeError) as error:
        raise ValueError(f"the behaviors have different entries: {str(error).splitlines()[0]}") from error


def _joined(parts: list[TensorDict], episodes: list[int]) -> TensorDict:
    """Return transitions of several behaviors with numbers of ``episodes``, so that no two have the same number."""
    table = _together(parts)
    first = torch.tensor(episodes).cumsum(0) - torch.tensor(episodes)
    sizes = torch.tensor([len(part) for part in parts])
    table[EPISODE] = table[EPISODE] + first.repeat_interleave(sizes)
    return table
