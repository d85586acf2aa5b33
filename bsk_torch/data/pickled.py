"""Objects of users as plain data in saved states: JSON, not Python's pickle.

A state may come from a stranger, so reading one imports nothing and calls no constructor and no function of its choice. An object
is the name of its class and its attributes. Its class is looked up among those that the reading environment lists, it is made by
``object.__new__``, and its attributes are set without a call. The interface is that of the classes in :mod:`pickle`.
"""

from __future__ import annotations

import json
from base64 import b64decode, b64encode
from collections import Counter, OrderedDict, defaultdict, deque
from collections.abc import Callable, Collection, Iterable, Mapping
from copyreg import _slotnames  # type: ignore[attr-defined]
from datetime import date, datetime, time, timedelta
from enum import Enum
from io import BytesIO
from math import isfinite, prod
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from bsk_torch.untrusted import TORCH_TYPES, Json, one_line, parse_json


def _text(content: bytes | bytearray) -> str:
    return b64encode(content).decode()


class Atom(NamedTuple):
    """A type without parts, and how it becomes JSON and is read from it."""

    kind: type
    write: Callable[[Any], Any]
    read: Callable[[Any], Any]


ATOMS = {
    "int": Atom(int, hex, lambda text: int(text, 16)),
    "float": Atom(float, float.hex, float.fromhex),
    "complex": Atom(complex, lambda z: [z.real.hex(), z.imag.hex()], lambda parts: complex(*map(float.fromhex, parts))),
    "bytes": Atom(bytes, _text, b64decode),
    "bytearray": Atom(bytearray, _text, lambda text: bytearray(b64decode(text))),
    "range": Atom(range, lambda r: [r.start, r.stop, r.step], lambda parts: range(*parts)),
    "slice": Atom(slice, lambda s: [s.start, s.stop, s.step], lambda parts: slice(*parts)),
    "datetime": Atom(datetime, datetime.isoformat, datetime.fromisoformat),
    "date": Atom(date, date.isoformat, date.fromisoformat),
    "time": Atom(time, time.isoformat, time.fromisoformat),
    "timedelta": Atom(timedelta, lambda t: [t.days, t.seconds, t.microseconds], lambda parts: timedelta(*parts)),
}
"""Types that JSON has not: large and infinite numbers, bytes, ranges and times."""

ATOM_OF = {atom.kind: name for name, atom in ATOMS.items()}

SEQUENCES: dict[str, Any] = {kind.__name__: kind for kind in (list, tuple, set, frozenset, deque)}
MAPPINGS: dict[str, Any] = {kind.__name__: kind for kind in (dict, OrderedDict, Counter, defaultdict)}
FACTORIES: dict[str, Any] = {kind.__name__: kind for kind in (list, dict, set, int, float, str)}
"""Containers, and default values of a ``defaultdict``, by name."""

BASES: tuple[Any, ...] = (tuple, frozenset, list, set, deque, OrderedDict, dict)
"""Containers of which a class of the user may be a subclass; others are rejected."""

ARRAYS = "biufcSUMm"
"""Kinds of numbers, texts and times of NumPy."""


def name_of_class(kind: type) -> str:
    """Return the name of a class in a state."""
    return f"{kind.__module__}.{kind.__qualname__}"


class Pickler:
    """Writes objects; TypeError for one of another class, whose message names the attribute."""

    def __init__(self, file: BytesIO, classes: Collection[type], name_of: Callable[[Any], object]) -> None:
        """Write to ``file`` objects of ``classes``; ``name_of`` names those that are found again, None for others."""
        self.file, self.classes, self.name_of = file, classes, name_of

    def dump(self, value: object) -> None:
        """Write an object."""
        self._parts: list[Any] = []
        self._numbers: dict[int, int] = {}
        self._kept: list[object] = []  # an id may be given again once its object is gone
        self._path: list[str] = []
        root = self._part(value)
        try:
            content = json.dumps([root, self._parts], ensure_ascii=False, allow_nan=False, separators=(",", ":")).encode()
        except UnicodeEncodeError as error:
            raise TypeError(f"a text cannot be encoded: {error}") from None
        self.file.write(content)

    def _part(self, value: Any, name: object = None) -> Any:
        """Return a value as JSON: itself, or a list with the number of its part."""
        kind = type(value)
        plain = (
            value is None or kind in (bool, str) or (kind is int and abs(value) < 2**63) or (kind is float and isfinite(value))
        )
        if plain:
            return value
        number = self._numbers.get(id(value))
        if number is None:
            number = self._numbers[id(value)] = len(self._parts)
            self._kept.append(value)
            self._parts.append(None)
            if name is not None:
                self._path.append(str(name))
            self._parts[number] = self._described(value)
            if name is not None:
                self._path.pop()
        return [number]

    def _described(self, value: Any) -> list[Any]:
        kind = type(value)
        name = self.name_of(value)
        if name is not None:
            return ["name", name]
        if kind in ATOM_OF:
            return [ATOM_OF[kind], ATOMS[ATOM_OF[kind]].write(value)]
        if kind is Tensor:
            array = value.detach().cpu().contiguous().reshape(-1).view(torch.uint8).numpy()
            return ["tensor", str(value.dtype), list(value.shape), _text(array.tobytes())]
        if isinstance(value, np.ndarray | np.generic) and value.dtype.kind in ARRAYS:
            return [
                "array" if isinstance(value, np.ndarray) else "scalar",
                value.dtype.str,
                list(value.shape),
                _text(value.tobytes()),
            ]
        if kind in SEQUENCES.values():
            return [kind.__name__, [self._part(item) for item in value], *([value.maxlen] if kind is deque else [])]
        if kind in MAPPINGS.values():
            return [kind.__name__, self._items(value), *([self._factory(value)] if kind is defaultdict else [])]
        if kind not in self.classes:
            where = ".".join(self._path)
            raise TypeError(f"{where or 'it'} is {value!r:.80}, of {name_of_class(value if isinstance(value, type) else kind)}")
        if isinstance(value, Enum):
            return ["enum", name_of_class(kind), value.name]
        try:
            _new(kind)
        except TypeError as error:
            raise TypeError(f"{'.'.join(self._path) or 'it'} is of {name_of_class(kind)}, {error}") from None
        return ["object", name_of_class(kind), self._content(value), self._items(_attributes(value))]

    def _items(self, values: Mapping[Any, Any]) -> list[Any]:
        return [[self._part(key), self._part(part, key if isinstance(key, str) else None)] for key, part in values.items()]

    def _factory(self, value: defaultdict[Any, Any]) -> str | None:
        factory: Any = value.default_factory
        if factory is not None and factory not in FACTORIES.values():
            raise TypeError(f"{'.'.join(self._path)} is a defaultdict of {factory!r}; it may be one of {', '.join(FACTORIES)}")
        return None if factory is None else factory.__name__

    def _content(self, value: Any) -> Any:
        """Return the content of an object whose class is derived from a container; None for others."""
        base = _base(type(value))
        if base is None:
            return None
        return self._items(value) if issubclass(base, dict) else [self._part(item) for item in base.__iter__(value)]


def _base(kind: type) -> Any:
    """Return the container that a class is derived from; None if it is derived from ``object`` alone."""
    return next((base for base in BASES if issubclass(kind, base)), None)


def _new(kind: type, content: Iterable[Any] = ()) -> Any:
    """Return an object without attributes, of a class of the user, whose code does not run; TypeError for other bases."""
    base = _base(kind) or object
    return base.__new__(kind, content) if base in (tuple, frozenset) else base.__new__(kind)


def _attributes(value: object) -> dict[str, Any]:
    slots = {name: getattr(value, name) for name in _slotnames(type(value)) if hasattr(value, name)}
    return slots | getattr(value, "__dict__", {})


class Unpickler:
    """Reads objects; ValueError for anything but plain data and objects of the given classes."""

    def __init__(self, file: BytesIO, classes: Collection[type], find: Callable[[Any], object]) -> None:
        """Read from ``file`` objects of ``classes``; ``find`` returns an object by its name."""
        self.file, self.find = file, find
        self.classes = {name_of_class(kind): kind for kind in classes}

    def load(self) -> Any:
        """Return the object."""
        root, self._parts = self._content()
        self._made: dict[int, Any] = {}
        self._begun: set[int] = set()
        try:
            return self._part(root)
        except Exception as error:  # also of comparisons of the user's objects, whose attributes may be any
            raise ValueError(
                f"the state holds objects that cannot be made: {one_line(str(error)) or type(error).__name__}"
            ) from error

    def check(self) -> None:
        """Raise ValueError for what :meth:`load` would not read, without making any object."""
        for part in self._content()[1]:
            if part[0] in ("object", "enum"):
                self._class(part[1])

    def _content(self) -> tuple[Any, list[list[Any]]]:
        """Return the JSON: the value, and the parts that it refers to, whose kinds are known."""
        content: Any = parse_json(self.file.read(), Json)
        if not isinstance(content, list) or len(content) != 2 or not isinstance(content[1], list):
            raise ValueError("the state holds no objects of this version")
        for part in content[1]:
            if not isinstance(part, list) or len(part) < 2 or not isinstance(part[0], str) or part[0] not in READERS:
                raise ValueError(f"the state holds {str(part)[:80]!r}, which is not a kind of object")
        return content[0], content[1]

    def _class(self, name: object) -> Any:
        """Return a class by its name."""
        kind = self.classes.get(name) if isinstance(name, str) else None
        if kind is None:
            raise ValueError(
                f"the state holds an object of {str(name)[:80]!r}, neither plain data nor of a class of {sorted(self.classes)}"
            )
        return kind

    def _part(self, value: Any) -> Any:
        if not isinstance(value, list):
            return value
        (number,) = value
        if not isinstance(number, int) or not 0 <= number < len(self._parts):
            raise ValueError(f"there is no part {number!r:.40}")
        if number not in self._made:
            if number in self._begun:
                raise ValueError("a tuple or a frozen set contains itself")
            self._begun.add(number)
            part = self._parts[number]
            made = READERS[part[0]](self, number, *part[1:])
            self._made.setdefault(number, made)
        return self._made[number]

    # -- kinds of parts; containers are noted before they are filled, since they may contain themselves -----------------------

    def _name(self, number: int, name: Any) -> Any:
        return self.find(name)

    def _tensor(self, number: int, dtype: str, shape: list[int], text: str) -> Tensor:
        kind, content = TORCH_TYPES[dtype], bytearray(b64decode(text))
        if prod(shape) * kind.itemsize != len(content):
            raise ValueError(f"a tensor of shape {shape} has {len(content)} bytes")
        return torch.frombuffer(content, dtype=kind).view(shape) if content else torch.empty(shape, dtype=kind)

    def _array(self, number: int, dtype: str, shape: list[int], text: str) -> Any:
        kind, content = np.dtype(dtype), b64decode(text)
        if kind.kind not in ARRAYS or prod(shape) * kind.itemsize != len(content):
            raise ValueError(f"an array of {dtype} of shape {shape} has {len(content)} bytes")
        return np.frombuffer(content, kind).reshape(shape).copy() if content else np.empty(shape, kind)

    def _scalar(self, number: int, dtype: str, shape: list[int], text: str) -> Any:
        return self._array(number, dtype, [], text)[()]

    def _sequence(self, number: int, values: list[Any], kind: Any, *size: Any) -> Any:
        if kind in (tuple, frozenset):
            return kind(map(self._part, values))
        made = self._made[number] = kind((), *size)
        self._fill(made, values, kind)
        return made

    def _mapping(self, number: int, items: list[Any], kind: Any, *factory: Any) -> Any:
        made = self._made[number] = kind(*(None if name is None else FACTORIES[name] for name in factory))
        self._fill(made, items, kind)
        return made

    def _object(self, number: int, name: str, content: Any, attributes: list[Any]) -> Any:
        kind = self._class(name)
        base = _base(kind)
        fixed = base in (tuple, frozenset)
        made = self._made[number] = _new(kind, map(self._part, content) if fixed else ())
        if base is not None and not fixed:
            self._fill(made, content, base)
        slots = _slotnames(kind)
        for key, value in attributes:
            if not isinstance(key, str) or (key.startswith("__") and key.endswith("__")):
                raise ValueError(f"an object has no attribute {key!r:.80}")
            if key in slots:
                object.__setattr__(made, key, self._part(value))
            else:
                made.__dict__[key] = self._part(value)
        return made

    def _fill(self, made: Any, content: list[Any], base: Any) -> None:
        """Add items by the methods of a container of Python, not those of a class of the user."""
        if issubclass(base, dict):
            for key, value in content:
                base.__setitem__(made, self._part(key), self._part(value))
        else:
            add = base.add if base is set else base.append
            for value in content:
                add(made, self._part(value))

    def _enum(self, number: int, name: str, member: str) -> Any:
        return self._class(name).__members__[member]


def _of_atom(atom: Atom) -> Callable[..., Any]:
    return lambda reader, number, content: atom.read(content)


def _of_sequence(kind: type) -> Callable[..., Any]:
    return lambda reader, number, values, *size: reader._sequence(number, values, kind, *size)


def _of_mapping(kind: type) -> Callable[..., Any]:
    return lambda reader, number, items, *factory: reader._mapping(number, items, kind, *factory)


READERS: dict[str, Callable[..., Any]] = {
    "name": Unpickler._name,
    "tensor": Unpickler._tensor,
    "array": Unpickler._array,
    "scalar": Unpickler._scalar,
    "object": Unpickler._object,
    "enum": Unpickler._enum,
    **{name: _of_atom(atom) for name, atom in ATOMS.items()},
    **{name: _of_sequence(kind) for name, kind in SEQUENCES.items()},
    **{name: _of_mapping(kind) for name, kind in MAPPINGS.items()},
}
"""How the kinds of parts are read."""
