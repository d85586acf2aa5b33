"""Observables: quantities of satellites at a decision boundary, computed for all environments in one call.

An :func:`observable` is a property of a model written on planes, as the tick is. Those that an environment reads at every
step are computed together, by one kernel where there is one; any of them can be read at any time.
"""

from __future__ import annotations

import functools
import logging
import operator
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple, cast
from weakref import WeakSet

import torch
from torch import Tensor

from bsk_torch.astro.attitude import mrp_to_dcm
from bsk_torch.astro.ephemeris import EARTH_ROTATION_RATE
from bsk_torch.astro.orbit import Elements, hill_frame, hill_rate, rv_to_elements
from bsk_torch.codegen.ir import Loop, UntraceableError
from bsk_torch.codegen.kept import Kept, of_package
from bsk_torch.codegen.kernel import Kernel
from bsk_torch.codegen.passes import live_values
from bsk_torch.codegen.trace import Proxy, Tracer
from bsk_torch.sim.component import Bus, MissingMessageError, neighbours
from bsk_torch.sim.environment.ephemeris import EPHEMERIS_TRACK, ephemeris_at
from bsk_torch.sim.orbit.arcs import Arcs
from bsk_torch.sim.readout.own import OwnFunction
from bsk_torch.sim.satellite_state import SatelliteState
from bsk_torch.vec3 import Mat3, Vec3

logger = logging.getLogger(__name__)

Function = Callable[["Now"], Any]


class Arguments:
    """Arguments of the current episodes by name, planes or vectors."""

    def __init__(self, read: Callable[[str], object]) -> None:
        self._read = read

    def __getattr__(self, name: str) -> Any:
        """Return the argument ``name``; AttributeError if there is none, which ``copy`` and ``hasattr`` rely on."""
        if name.startswith("__"):
            raise AttributeError(name)
        try:
            value = self._read(name)
        except KeyError as error:
            raise AttributeError(error.args[0], name=name, obj=self) from error
        setattr(self, name, value)
        return value


class Now:
    """The satellite and its world at a decision boundary: fields of the state as attributes, and quantities derived from them.

    ``args`` holds the drawn arguments. Vectors are :class:`Vec3`, matrices :class:`Mat3`; frames are N (inertial), B (body),
    P (Earth-fixed) and H (Hill).
    """

    def __init__(self, args: Arguments, ephemeris: Callable[[], Bus]) -> None:
        """Read arguments and ephemeris on demand; :meth:`Layout.put` adds the state."""
        self.args, self._ephemeris = args, ephemeris

    @functools.cached_property
    def ephemeris(self) -> Bus:
        """Sun and Earth."""
        return self._ephemeris()

    def __getattr__(self, name: str) -> Any:
        raise MissingMessageError(f"the satellite has no state {name!r}", name=name)

    @functools.cached_property
    def BN(self) -> Mat3:
        """DCM from N to B."""
        return mrp_to_dcm(self.sigma_BN)

    @functools.cached_property
    def HN(self) -> Mat3:
        """DCM from N to H."""
        return hill_frame(self.r_BN_N, self.v_BN_N)

    @functools.cached_property
    def PN(self) -> Mat3:
        """DCM from N to P."""
        x, y, z = self.ephemeris.EN
        cos, sin = self.ephemeris.cos_earth, self.ephemeris.sin_earth
        return Mat3(x * cos + y * sin, y * cos - x * sin, z)

    @functools.cached_property
    def omega_HN_H(self) -> Vec3:
        """Rate of the Hill frame, rad/s in H."""
        rate = hill_rate(self.r_BN_N, self.v_BN_N)
        zero = torch.zeros_like(rate)
        return Vec3(zero, zero, rate)

    @functools.cached_property
    def elements(self) -> Elements:
        """Osculating elements, angles in rad."""
        return rv_to_elements(self.r_BN_N, self.v_BN_N, self.args.mu)

    @property
    def omega_PN_N(self) -> Vec3:
        """Rate of the Earth, rad/s in N."""
        return self.ephemeris.EN.z * EARTH_ROTATION_RATE

    @property
    def r_SN_N(self) -> Vec3:
        """Sun relative to the Earth, m in N."""
        return self.ephemeris.r_SN_N


class observable(property):  # noqa: N801  - a decorator
    """A property of a model, written as a function of :class:`Now` that returns a plane [N], a :class:`Vec3` or a :class:`Mat3`.

    Read as an attribute it is a tensor [N], [N, 3] or [N, 3, 3], float64.
    """

    def __init__(self, function: Function) -> None:
        super().__init__(operator.methodcaller("observed", function))
        self.function, self.__name__ = function, function.__name__
        self.__doc__ = function.__doc__  # otherwise a subclass of property has the docstring of the class


class vital(observable):  # noqa: N801  - a decorator
    """An aliveness check of a model, written as a function of :class:`Now` that returns a mask; see ``aliveness_checker``."""

    is_aliveness_checker = True

    def __init__(self, function: Function) -> None:
        """Decorate ``function``; read as an attribute it is a method without arguments."""
        super().__init__(function)
        property.__init__(self, lambda model: functools.partial(model.observed, function))
        self.__doc__ = function.__doc__


def as_tensor(value: Any) -> Tensor:
    """Return an observable as users get it: never a view of the state, which the next step changes."""
    if isinstance(value, Mat3):
        return value.stack()
    if isinstance(value, tuple):
        return torch.stack(list(value), -1)
    return value.clone() if value._is_view() else value


KERNELS: Kept[ObserverKernel] = Kept(32)  # kernels of observables of the package
TOLD: WeakSet[Function] = WeakSet()  # user functions whose reason for running in torch has been logged
ROUNDING = 1e-6  # difference between a kernel and torch that counts as rounding, absolute and relative to the largest value


class Observer:
    """Reads observables of a simulation, each at most once between two changes of its state."""

    def __init__(self, state: SatelliteState, arcs: Arcs, backend: str) -> None:
        self.state, self.arcs, self.kernels = state, arcs, backend == "compiled" and state.device.type == "cpu"
        self.wanted: tuple[Function, ...] = ()  # read at every step, together where a kernel can compute them
        self.missed: dict[Function, None] = {}  # computed on tensors, one by one
        self._kernel: ObserverKernel | None = None
        self._table: Tensor | None = None
        self._values: dict[Function, Tensor] = {}
        self._now: Now | None = None
        self._version = -1  # of the state from which values were read
        self._own: tuple[OwnFunction, ...] = ()  # users' functions of tensors in the kernel

    def want(self, functions: Iterable[Function]) -> None:
        """Add functions to those read at every step, which one kernel then computes together."""
        self.wanted, self._kernel = tuple(dict.fromkeys((*self.wanted, *functions))), None
        self._values, self._table = {}, None

    def _forget_the_past(self) -> None:
        self._values, self._table, self._now, self._version = {}, None, None, self.state.version

    def read(self, function: Function) -> Tensor:
        """Return an observable, [N] or [N, 3] float64."""
        if self._version != self.state.version:
            self._forget_the_past()
        if function in self._own:
            self._leave_changed()
        value = self._values.get(function)
        if value is None:
            kernel = (self._kernel or self._built()) if self.kernels and function in self.wanted else None
            if kernel is None or function not in kernel.layout:
                if isinstance(function, OwnFunction):
                    return function.on_tensors()
                self.missed[function] = None
                value = as_tensor(function(self.now))
            else:
                value = kernel.column(self._present(kernel), function)
            self._values[function] = value
        return value

    def read_together(self, functions: tuple[Function, ...], kind: type = float) -> Tensor | None:
        """Return observables side by side, [N, W] numbers, or bool of the ``kind`` bool; matrices row by row.

        This is faster than one :meth:`read` for each. None unless the kernel computes all of them, and all are of that kind.
        """
        if any(function in self._own for function in functions):
            self._leave_changed()
        kernel = (self._kernel or self._built()) if self.kernels and functions else None
        columns = None if kernel is None else kernel.columns(functions, kind)
        if kernel is None or columns is None:
            return None
        columns_read = self._present(kernel)[:, columns]
        return columns_read > 0.5 if kind is bool else columns_read

    def table(self) -> tuple[Tensor, ObserverKernel] | None:
        """Return all that the kernel computes, [N, W], and the kernel, which knows the columns; None without a kernel."""
        kernel = (self._kernel or self._built()) if self.kernels and self.wanted else None
        return None if kernel is None else (self._present(kernel), kernel)

    def _present(self, kernel: ObserverKernel) -> Tensor:
        """Return all that the kernel computes, [N, W]."""
        if self._version != self.state.version:
            self._forget_the_past()
        if self._table is None:
            self._table = kernel(self.state, self.arcs)
        return self._table

    @property
    def now(self) -> Now:
        """The present on tensors."""
        if self._version != self.state.version:
            self._forget_the_past()
        if self._now is None:
            self._now = now_on_tensors(self.state, self.arcs)
        return self._now

    def _built(self) -> ObserverKernel | None:
        if self._kernel is None:
            functions = tuple(function for function in self.wanted if of_package([function]) or self.has_kernel(function))
            try:
                self._kernel = ObserverKernel.of(self.state, functions) if functions else None
                if self._kernel is not None and (same := self._agreeing(self._kernel)) != functions:
                    self._kernel = ObserverKernel.of(self.state, same) if same else None
            except UntraceableError as error:
                logger.warning("%s; observations are computed on tensors instead, which is slower", error)
                self._kernel = None
            self.kernels = self._kernel is not None
            layout = () if self._kernel is None else self._kernel.layout
            self._own = tuple(function for function in layout if isinstance(function, OwnFunction))
        return self._kernel

    def _leave_changed(self) -> None:
        """Compute functions whose variables have changed since they were traced on tensors from now on."""
        changed = [function for function in self._own if not function.unchanged]
        if changed:
            for function in changed:
                _tell(function, "a variable that it reads has changed")
            self.wanted = tuple(function for function in self.wanted if function not in changed)
            self.want(())
            self._own = ()

    def has_kernel(self, function: Function) -> bool:
        """Return whether a kernel can compute a user's function; otherwise a sentence in the log names the reason."""
        try:
            one, two = (ObserverProgram(self.state, [function]).text for _ in range(2))
        except UntraceableError as error:
            _tell(function, str(error))
            return False
        if one != two:
            _tell(function, "two calls compute different things, but it must follow from the present alone")
        return one == two

    def _agreeing(self, kernel: ObserverKernel) -> tuple[Function, ...]:
        """Return the functions of a kernel without those of users that torch computes differently; the log names them."""
        table = kernel(self.state, self.arcs)
        same = []
        for function in kernel.layout:
            if isinstance(function, OwnFunction):
                exact: Tensor | None = function.on_tensors()
            else:
                exact = None if of_package([function]) else as_tensor(function(self.now))
            if exact is None or _alike(exact, kernel.column(table, function)):
                same.append(function)
            else:
                _tell(function, "a kernel computes other values than torch, but it must follow from the present alone")
        return tuple(same)


def _alike(exact: Tensor, traced: Tensor) -> bool:
    """Return whether a kernel's values are torch's but for rounding, which angles between parallel vectors magnify."""
    if exact.shape != traced.shape or exact.dtype != traced.dtype:
        return False
    scale = float(exact.double().abs().nan_to_num(0.0, 0.0, 0.0).amax()) if exact.numel() else 0.0
    return bool(torch.isclose(traced.double(), exact.double(), 0.0, ROUNDING * (1.0 + scale), equal_nan=True).all())


def _tell(function: Function, why: str) -> None:
    """Log once why a user's function is computed on tensors."""
    if function not in TOLD:
        TOLD.add(function)
        own, name = isinstance(function, OwnFunction), getattr(function, "__name__", repr(function))
        logger.log(
            logging.INFO if own else logging.WARNING,
            "%s %r is computed on tensors, which is slower: %s",
            "property" if own else "observable",
            name,
            why,
        )


class Moments(NamedTuple):
    """Satellites at times of the current episodes."""

    rows: Tensor  # the satellites, [M], which may repeat
    time: Tensor  # seconds since reset, [M]
    planes: Tensor  # fields of the state then, [C, M]


def now_on_tensors(state: SatelliteState, arcs: Arcs, moments: Moments | None = None) -> Now:
    """Return the present of satellites, or what was at some ``moments``, on tensors [N]."""

    def read(name: str) -> object:
        value = state.argument(name)
        if not isinstance(value, Tensor):
            return value
        value = value if moments is None else value[moments.rows]
        return Vec3.of(value) if value.ndim == 2 and value.shape[1] == 3 else value

    def sky() -> Bus:
        samples, rows = arcs.ephemeris_samples, torch.arange(state.rows, device=state.device)
        time = state.sim_time
        if moments is not None:
            rows, time = moments.rows, moments.time
        records, tau = neighbours(EPHEMERIS_TRACK, samples.table, rows, time - samples.start[rows])
        return ephemeris_at(records.flatten(1).unbind(-1), tau)

    now = Now(Arguments(read), sky)
    state.layout.put(now, (state.planes if moments is None else moments.planes).unbind(0))
    return now


class ObserverProgram:
    """Observables traced into one program."""

    def __init__(self, state: SatelliteState, functions: Sequence[Function]) -> None:
        """Trace the functions; UntraceableError for one that does something else than kernels can."""
        self.tracer = program = Tracer()
        self.arguments: list[str] = []  # those read, in the order of the planes
        widths: dict[str, int] = {}

        def read(name: str) -> object:
            value = state.argument(name)
            if not isinstance(value, Tensor):
                return value
            width = value.reshape(state.rows, -1).shape[1]
            first = sum(widths.values())
            widths[name] = width
            self.arguments.append(name)
            planes = [cast(Tensor, program.input("own", first + k)) for k in range(width)]
            return planes[0] if width == 1 else Vec3(*planes) if width == 3 else tuple(planes)

        records = [program.input("track", 1, k) for k in range(EPHEMERIS_TRACK.count * EPHEMERIS_TRACK.width)]
        tau = program.input("tau", 1)
        now = Now(Arguments(read), lambda: ephemeris_at(records, tau))
        state.layout.put(now, [program.input("state", k) for k in range(state.layout.size)])
        self.values = [_traced(function(now)) for function in functions]

    @property
    def planes(self) -> list[Any]:
        """Values of all functions, one after the other."""
        return [plane for value in self.values for plane in _planes(value)]

    @property
    def loop(self) -> Loop:
        """The loop of one tick that writes the values."""
        return Loop(self.tracer, [], (EPHEMERIS_TRACK,), self.planes, clock="start")

    @property
    def text(self) -> list[object]:
        """What is computed, for comparisons."""
        live = [(v.index, v.op, [arg.index for arg in v.args], repr(v.attr), v.dtype) for v in live_values(self.loop)]
        return [self.arguments, live, [plane.index for plane in self.planes]]


def _planes(value: object) -> list[object]:
    return [plane for part in value for plane in _planes(part)] if isinstance(value, tuple) else [value]


def _traced(value: object) -> object:
    if not all(isinstance(plane, Proxy) for plane in _planes(value)):
        raise UntraceableError(f"it returns {type(value).__name__}, which does not follow from the present")
    return value


class ObserverKernel:
    """The kernel that computes several observables at once."""

    @classmethod
    def of(cls, state: SatelliteState, functions: tuple[Function, ...]) -> ObserverKernel:
        """Return the kernel of some functions, a kept one if they are the package's; see :mod:`bsk_torch.codegen.kept`."""
        if not of_package(functions):
            return cls(state, functions)
        arguments = repr((state.arguments.places, state.constants))
        key = functions, tuple(state.layout.fields.values()), arguments
        return KERNELS.get(key, lambda: cls(state, functions))

    def __init__(self, state: SatelliteState, functions: Sequence[Function]) -> None:
        """Build the kernel; UntraceableError for a function that has none."""
        program = ObserverProgram(state, functions)
        self.arguments = tuple(program.arguments)
        self.layout = _layout(functions, program.values)
        self.width = len(program.planes)
        self.kernel = Kernel("observation", program.loop)
        self._columns: dict[tuple[tuple[Function, ...], type], slice | Tensor | None] = {}

    def __call__(self, state: SatelliteState, arcs: Arcs) -> Tensor:
        """Return the observables side by side, [N, width]; see :meth:`column`."""
        written = torch.empty(state.rows, 1, self.width, dtype=torch.float64)
        self.kernel(
            state.planes,
            1,
            [arcs.ephemeris_samples],
            own=state.argument_planes(self.arguments),
            ticks=state.ticks,
            nanoseconds=state.h_ns,
            written=written,
        )
        return written.squeeze(1)

    def column(self, table: Tensor, function: Function) -> Tensor:
        """Return an observable of a table of all, [N], [N, width] or [N, 3, 3]."""
        at, kind = self.layout[function]
        values = table[:, at]
        return values > 0.5 if kind is bool else values.unflatten(1, (3, 3)) if kind is Mat3 else values

    @functools.lru_cache(4)  # noqa: B019  - kernels are few, and kept
    def places(self, functions: tuple[Function, ...]) -> Tensor:
        """Return the columns of truth values or numbers, [F]."""
        return torch.tensor([self.layout[function][0] for function in functions])

    def columns(self, functions: tuple[Function, ...], kind: type) -> slice | Tensor | None:
        """Return the columns of several observables; None for one without a kernel, or of another kind: numbers or bool."""
        key = functions, kind
        if key not in self._columns:
            places = [self.layout.get(function, (0, type(None))) for function in functions]
            alike = all((place_kind is bool) == (kind is bool) and place_kind is not type(None) for _, place_kind in places)
            wide = (list(range(self.width))[at if isinstance(at, slice) else slice(at, at + 1)] for at, _ in places)
            self._columns[key] = _run([column for part in wide for column in part]) if alike else None
        return self._columns[key]


def _run(columns: list[int]) -> slice | Tensor:
    """Return columns as a slice if they are neighbors, which needs no copy, else as indices."""
    first, last = columns[0], columns[-1]
    return slice(first, last + 1) if columns == list(range(first, last + 1)) else torch.tensor(columns)


def _layout(functions: Sequence[Function], values: Sequence[Any]) -> dict[Function, tuple[int | slice, type]]:
    """Return the columns of each observable, and what it is: a truth value, a matrix, or else numbers."""
    layout: dict[Function, tuple[int | slice, type]] = {}
    first = 0
    for function, value in zip(functions, values, strict=True):
        wide, end = isinstance(value, tuple), first + len(_planes(value))
        kind = Mat3 if isinstance(value, Mat3) else bool if not wide and value.dtype == torch.bool else float
        layout[function] = slice(first, end) if wide else first, kind
        first = end
    return layout
