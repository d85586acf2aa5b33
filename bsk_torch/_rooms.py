"""Rooms of the package that an installation may lack, and entries of tables that live in them.

This module imports neither torch nor a room. The core names what rooms contribute (presets, rules, recipes) by ``"module:name"``,
and imports it when it is asked for.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, MutableMapping
from importlib import import_module
from pathlib import Path
from typing import Any, Generic, TypeVar

PACKAGE = Path(__file__).parent

T = TypeVar("T")


class RoomAbsentError(ImportError):
    """A room of the package is not installed."""


def absent_room(path: str) -> str:
    """Return the folder that an installation lacks for ``path``, "module" or "module:function"; an empty string if none."""
    parts = path.partition(":")[0].split(".")[1:]
    depth = 2 if parts[0] in ("tasks", "lab") else 1
    folder = PACKAGE.joinpath(*parts[:depth])
    return "" if folder.exists() or folder.with_suffix(".py").exists() else "/".join(["bsk_torch", *parts[:depth]])


def resolve(path: str) -> Any:
    """Return the object at "module:name"; RoomAbsentError if its room is not installed."""
    if folder := absent_room(path):
        raise RoomAbsentError(f"{path.partition(':')[2]} is not installed: this copy of bsk_torch has no folder {folder}")
    module, _, name = path.partition(":")
    return getattr(import_module(module), name)


class Entries(MutableMapping[str, T], Generic[T]):
    """Entries by name, some of which are given as "module:name" and imported when they are read.

    Names whose room is not installed are left out; :attr:`absent` has their folders.
    """

    def __init__(self, entries: Mapping[str, T | str]) -> None:
        """Hold ``entries``, in their order."""
        folders = {name: absent_room(entry) for name, entry in entries.items() if isinstance(entry, str)}
        self.absent = {name: folder for name, folder in folders.items() if folder}
        self._entries = {name: entry for name, entry in entries.items() if name not in self.absent}

    def __getitem__(self, name: str) -> T:
        entry = self._entries[name]
        if isinstance(entry, str):
            entry = self._entries[name] = resolve(entry)
        return entry

    def __setitem__(self, name: str, entry: T) -> None:
        self._entries[name] = entry

    def __delitem__(self, name: str) -> None:
        del self._entries[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._entries)

    def __len__(self) -> int:
        return len(self._entries)
