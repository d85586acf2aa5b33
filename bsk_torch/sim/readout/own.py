"""Properties and user functions, written on tensors, as observables.

Such a function is called once with satellites whose properties are batches of values of a kernel
(:class:`bsk_torch.codegen.arrays.Batch`); what it computes of them is then part of the kernel of observables. It may read what
follows from the present: observables, fields, arguments, Sun and Earth, and constants. One that does more stays on tensors.

What users write need not be pure. A function is traced only if every global, enclosing and class variable that it names is a
function, a module of torch, NumPy or the package, or a value that cannot change; they are compared at every reading, and one that
has been bound to something else ends the use of the kernel.
"""

from __future__ import annotations

import functools
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from types import BuiltinFunctionType, FrameType, FunctionType, ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor

from bsk_torch.codegen.arrays import Batch
from bsk_torch.codegen.ir import UntraceableError
from bsk_torch.codegen.kept import PACKAGE
from bsk_torch.codegen.trace import Proxy
from bsk_torch.sim.readout.surroundings import World
from bsk_torch.vec3 import Mat3, Vec3

if TYPE_CHECKING:
    from bsk_torch.sim.readout.observables import Now

FIXED_MODULES = {"torch", "numpy", "math", PACKAGE}
"""Packages whose functions follow from their arguments, apart from random numbers, which two traces tell."""

LIBRARIES = FIXED_MODULES | sys.stdlib_module_names

PLAIN = (int, float, str, bytes, bool, type(None), torch.dtype, torch.device)

CODE = FunctionType, BuiltinFunctionType, type, property, classmethod, staticmethod, np.ufunc

WORLD: dict[str, Callable[[Now], object]] = {
    "r_SN_N": lambda now: now.r_SN_N,
    "sun_direction_N": lambda now: now.r_SN_N.unit(),
    "PN": lambda now: now.PN,
    "omega_PN_N": lambda now: now.omega_PN_N,
}
"""Properties of the world that kernels know."""

Watched = list[tuple[Callable[..., object], str, object]]
"""Variables of a function: how one is read, its name, and its value when the function was traced."""


class OwnFunction:
    """A user's function of satellites on tensors, as a function of the present for kernels."""

    def __init__(self, function: object, of: object, satellite: Any, on_tensors: Callable[[], Tensor], name: str) -> None:
        """Trace ``function`` of a model ``of`` satellites, or of the satellites themselves if None; ``on_tensors`` calls it."""
        self.function, self.of, self.satellite, self.on_tensors, self.__name__ = function, of, satellite, on_tensors, name
        self.watched: Watched = []  # variables that it reads; see unchanged

    def __call__(self, now: Now) -> object:
        """Return what the function computes of the present, planes of a kernel; UntraceableError for what no kernel can."""
        if not isinstance(self.function, FunctionType):
            raise UntraceableError(f"it is a {type(self.function).__name__}, not a function")
        satellite = _satellite(self.satellite, now)
        owner = satellite if self.of is None else satellite.fsw if self.of is self.satellite.fsw else satellite.dynamics
        try:
            with _watching(self.function, self.satellite) as self.watched:
                return _planes(self.function(owner))
        except UntraceableError:
            raise
        except Exception as error:
            raise UntraceableError(f"{type(error).__name__}: {str(error).partition(chr(10))[0]}") from error

    @property
    def unchanged(self) -> bool:
        """Whether all variables that it reads still have the values that it was traced with."""
        return all(read(name, None) is value for read, name, value in self.watched)


# -- what it reads -----------------------------------------------------------------------------------------------------------


def _batch(value: object) -> object:
    """Return a value of the present as tensors have it: [N], [N, width] or [N, 3, 3]."""
    if isinstance(value, Mat3):
        return Batch(np.stack([_batch(row).cells for row in value]))  # type: ignore[attr-defined]
    if isinstance(value, tuple):
        cells = np.empty(len(value), dtype=object)
        cells[:] = value
        return Batch(cells)
    return Batch(value) if isinstance(value, Proxy) else value


class _Reading:
    """Reads some attributes by functions; UntraceableError for others."""

    def __init__(self, title: str, **members: Any) -> None:
        self.__dict__.update(members, _title=title)

    def __getattr__(self, name: str) -> Any:
        raise UntraceableError(f"it reads {self._title}.{name}, which no kernel has")


class _Arguments:
    """Arguments of the episodes, as ``sat_args`` has them."""

    def __init__(self, now: Now, shapes: dict[str, tuple[int, ...]]) -> None:
        self._now, self._shapes = now, shapes

    def __getitem__(self, name: str) -> object:
        value = getattr(self._now.args, name)
        if name not in self._shapes:
            return value
        batch: Any = _batch(value)
        return Batch(batch.cells.reshape(self._shapes[name]))


def _satellite(whole: Any, now: Now) -> Any:
    """Return satellites of the classes of ``whole`` that read the present of a kernel: methods of classes run on them."""
    arguments = _Arguments(now, whole.simulator.state.arguments.shapes)
    read: Callable[[str], object] = lambda name: _batch(getattr(now, name))  # noqa: E731
    state = _Reading("simulator.state", read=read, argument=arguments.__getitem__, constants=whole.simulator.state.constants)
    observer = _Reading("simulator.observer", now=_Present(now))
    own = {"state": state, "read": read, "argument": arguments.__getitem__, "world": _world(whole, now), "observer": observer}
    simulator = _Reading("simulator", **own)
    satellite = object.__new__(type(whole))
    for name in ("dynamics", "fsw"):
        model = object.__new__(type(getattr(whole, name)))
        model.__dict__.update(
            simulator=simulator, satellite=satellite, state=read, observed=lambda function: _batch(function(now))
        )
        satellite.__dict__[name] = model
    satellite.__dict__.update(simulator=simulator, sat_args=arguments)
    return satellite


class _Present:
    """The present, with batches in the place of the planes of a kernel."""

    def __init__(self, now: Now) -> None:
        self._now = now

    def __getattr__(self, name: str) -> object:
        return _of_batches(getattr(self._now, name))


def _of_batches(value: Any) -> Any:
    if isinstance(value, tuple):
        parts = map(_of_batches, value)
        return type(value)(*parts) if hasattr(value, "_fields") else tuple(parts)
    return Batch(value) if isinstance(value, Proxy) else value


class _World(_Reading):
    _now: Now

    def __init__(self, now: Now) -> None:
        super().__init__("world")
        self.__dict__["_now"] = now

    def __getattr__(self, name: str) -> object:
        return _batch(WORLD[name](self._now)) if name in WORLD else super().__getattr__(name)


def _world(whole: Any, now: Now) -> object:
    own = [name for name in WORLD if getattr(type(whole.simulator.world), name, None) is not getattr(World, name)]
    return _Reading("world") if own else _World(now)


def _planes(value: object) -> object:
    """Return what the function has computed, a number, numbers or a matrix for a row, as kernels write it."""
    cells = value.cells if isinstance(value, Batch) else np.asarray(value, dtype=object) if isinstance(value, Proxy) else None
    if cells is None or not all(isinstance(cell, Proxy) and cell.dtype == torch.float64 for cell in cells.flat):
        raise UntraceableError("it does not return a float64 tensor that follows from the present")
    if cells.shape == (3, 3):
        return Mat3(*(Vec3(*row) for row in cells))
    if cells.ndim > 1:
        raise UntraceableError(f"it returns [N, {', '.join(map(str, cells.shape))}]; kernels write [N], [N, width] and [N, 3, 3]")
    return tuple(cells) if cells.ndim else cells.item()


# -- what it names -----------------------------------------------------------------------------------------------------------


def _packaged(cls: type) -> bool:
    return cls is object or cls.__module__.partition(".")[0] in (*FIXED_MODULES, "typing", "collections")


def _fixed(value: object) -> bool:
    """Return whether a value stays as it is as long as a variable is bound to it."""
    if isinstance(value, tuple):
        return all(map(_fixed, value))
    if isinstance(value, ModuleType):
        return value.__name__.partition(".")[0] in FIXED_MODULES
    return isinstance(value, (*PLAIN, *CODE, Batch, Proxy))


@contextmanager
def _watching(function: FunctionType, satellite: Any) -> Iterator[Watched]:
    """Collect the variables of all users' functions that run, those of the classes of ``satellite`` and its models included.

    UntraceableError for one whose value may change unnoticed.
    """
    watched: Watched = []
    codes: dict[Any, dict[str, object]] = {}

    def note(frame: FrameType, event: str, _: object) -> None:
        if event == "call" and str(frame.f_globals.get("__name__")).partition(".")[0] not in LIBRARIES:
            codes[frame.f_code] = frame.f_globals
            for name in frame.f_code.co_freevars:
                if name in frame.f_locals:
                    _require_fixed(name, frame.f_locals[name])

    previous = sys.getprofile()
    sys.setprofile(note)
    try:
        yield watched
    finally:
        sys.setprofile(previous)
    for name, cell in zip(function.__code__.co_freevars, function.__closure__ or (), strict=True):
        watched.append((functools.partial(_content, cell), name, cell.cell_contents))
    for code, variables in codes.items():
        for name in code.co_names:
            _watch(watched, name, variables)
    names = {name for code in codes for name in code.co_names}
    for part in (satellite, satellite.dynamics, satellite.fsw):
        own = vars(part)
        for cls in type(part).__mro__:
            for name in () if _packaged(cls) else names.intersection(vars(cls)):
                if name in own:
                    raise UntraceableError(f"it reads {name!r}, an attribute of an instance, which may change")
                _watch(watched, name, vars(cls))
                watched.append((own.get, name, None))


def _watch(watched: Watched, name: str, variables: Mapping[str, object]) -> None:
    if name in variables:
        value = variables[name]
        _require_fixed(name, value)
        if isinstance(value, Tensor):
            watched.append((functools.partial(_version, value), name, value._version))
        watched.append((variables.get, name, value))


def _require_fixed(name: str, value: object) -> None:
    if not _fixed(value) and not (isinstance(value, Tensor) and not value.requires_grad):
        raise UntraceableError(f"it reads {name!r}, a {type(value).__name__}, which may change")


def _content(cell: Any, *_: object) -> object:
    return cell.cell_contents


def _version(value: Tensor, *_: object) -> int:
    return value._version
