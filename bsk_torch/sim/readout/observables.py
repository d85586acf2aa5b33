"""Observables: quantities of satellites at a decision boundary, computed for all environments in one call.

An :func:`observable` is a property of a model written on planes, as the tick is. Those that an environment reads at every
step are computed together, by one kernel where there is one; any of them can be read at any time.
"""

from __future__ import annotations

import functools
import logging
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import torch
from torch import Tensor

from bsk_torch.astro.attitude import mrp_to_dcm
from bsk_torch.astro.ephemeris import EARTH_ROTATION_RATE
from bsk_torch.astro.orbit import Elements, hill_frame, hill_rate, rv_to_elements
from bsk_torch.codegen.ir import Loop, UntraceableError
from bsk_torch.codegen.kept import Kept, of_package
from bsk_torch.codegen.kernel import Kernel
from bsk_torch.codegen.trace import Tracer
from bsk_torch.sim.component import Bus, MissingMessageError, neighbours
from bsk_torch.sim.environment.ephemeris import EPHEMERIS_TRACK, ephemeris_at
from bsk_torch.sim.orbit.arcs import Arcs
from bsk_torch.sim.satellite_state import SatelliteState
from bsk_torch.vec3 import Mat3, Vec3

logger = logging.getLogger(__name__)

Function = Callable[["Now"], Any]


class Arguments:
    """Arguments of the current episodes by name, planes or vectors."""

    def __init__(self, read: Callable[[str], object]) -> None:
        """Look arguments up with ``read``."""
        self._read = read

    def __getattr__(self, name: str) -> Any:
        """Return the argument ``name``."""
        value = self._read(name)
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
        """Raise a MissingMessageError: the state has no field ``name``."""
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
    """A property of a model, written as a function of :class:`Now` that returns a plane [N] or a :class:`Vec3`.

    Read as an attribute it is a tensor [N] or [N, 3], float64.
    """

    def __init__(self, function: Function) -> None:
        """Decorate ``function``."""
        super().__init__(lambda model: model.observed(function))
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


def _tensor(value: Any) -> Tensor:
    """Return an observable as users get it: never a view of the state, which the next step changes."""
    if isinstance(value, tuple):
        return torch.stack(list(value), -1)
    return value.clone() if value._is_view() else value


KERNELS: Kept[ObserverKernel] = Kept(32)
"""Kernels of observables of the package."""


class Observer:
    """Reads observables of a simulation, each at most once between two changes of its state."""

    def __init__(self, state: SatelliteState, arcs: Arcs, backend: str) -> None:
        """Read the ``state`` of satellites on ``arcs``."""
        self.state, self.arcs, self.kernels = state, arcs, backend == "compiled" and state.device.type == "cpu"
        self.wanted: tuple[Function, ...] = ()
        self._kernel: ObserverKernel | None = None
        self._values: dict[Function, Tensor] = {}
        self._now: Now | None = None
        self._version = -1  # of the state from which values were read

    def want(self, functions: Iterable[Function]) -> None:
        """Add functions to those read at every step, which one kernel then computes together."""
        self.wanted, self._kernel = tuple(dict.fromkeys((*self.wanted, *functions))), None
        self._values = {}

    def _forget_the_past(self) -> None:
        """Drop the values read before the state changed."""
        self._values, self._now, self._version = {}, None, self.state.version

    def read(self, function: Function) -> Tensor:
        """Return an observable, [N] or [N, 3] float64."""
        if self._version != self.state.version:
            self._forget_the_past()
        if function not in self._values:
            if self.kernels and function in self.wanted:
                self._values.update(self._compute())
            else:
                self._values[function] = _tensor(function(self.now))
        return self._values[function]

    @property
    def now(self) -> Now:
        """The present on tensors."""
        if self._version != self.state.version:
            self._forget_the_past()
        if self._now is None:
            self._now = now_on_tensors(self.state, self.arcs)
        return self._now

    def _compute(self) -> dict[Function, Tensor]:
        if self._kernel is None:
            try:
                self._kernel = ObserverKernel.of(self.state, self.wanted)
            except UntraceableError as error:
                logger.warning("%s; observations are computed on tensors instead, which is slower", error)
                self.kernels = False
                return {function: _tensor(function(self.now)) for function in self.wanted}
        return self._kernel(self.state, self.arcs)


def now_on_tensors(state: SatelliteState, arcs: Arcs) -> Now:
    """Return the present of satellites on tensors [N]."""

    def read(name: str) -> Any:
        value = state.argument(name)
        return Vec3.of(value) if isinstance(value, Tensor) and value.ndim == 2 and value.shape[1] == 3 else value

    def sky() -> Bus:
        samples, rows = arcs.ephemeris_samples, torch.arange(state.rows, device=state.device)
        records, tau = neighbours(EPHEMERIS_TRACK, samples.table, rows, state.sim_time - samples.start)
        return ephemeris_at(records.flatten(1).unbind(-1), tau)

    now = Now(Arguments(read), sky)
    state.layout.put(now, state.planes.unbind(0))
    return now


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
        program = Tracer()
        self.arguments: list[str] = []
        widths: dict[str, int] = {}

        def read(name: str) -> Any:
            value = state.argument(name)
            if not isinstance(value, Tensor):
                return value
            width = value.reshape(state.rows, -1).shape[1]
            first = sum(widths.values())
            widths[name] = width
            self.arguments.append(name)
            planes: list[Any] = [program.input("own", first + k) for k in range(width)]
            return planes[0] if width == 1 else Vec3(*planes) if width == 3 else tuple(planes)

        records = [program.input("track", 1, k) for k in range(EPHEMERIS_TRACK.count * EPHEMERIS_TRACK.width)]
        tau = program.input("tau", 1)
        now = Now(Arguments(read), lambda: ephemeris_at(records, tau))
        state.layout.put(now, [program.input("state", k) for k in range(state.layout.size)])
        values = [function(now) for function in functions]
        self.layout = _layout(functions, values)
        planes = [p for value in values for p in (value if isinstance(value, tuple) else (value,))]
        self.kernel = Kernel("observation", Loop(program, [], (EPHEMERIS_TRACK,), planes, clock="start"))
        self.width = len(planes)

    def __call__(self, state: SatelliteState, arcs: Arcs) -> dict[Function, Tensor]:
        """Return the observables by function."""
        written = torch.empty(state.rows, 1, self.width, dtype=torch.float64)
        self.kernel(
            state.planes,
            1,
            [arcs.ephemeris_samples],
            own=state.argument_planes(tuple(self.arguments)),
            ticks=state.ticks,
            nanoseconds=state.h_ns,
            written=written,
        )
        found = written.squeeze(1)
        return {f: found[:, at] > 0.5 if is_mask else found[:, at] for f, (at, is_mask) in self.layout.items()}


def _layout(functions: Sequence[Function], values: Sequence[Any]) -> dict[Function, tuple[int | slice, bool]]:
    """Return the columns of each observable, and whether it is a mask."""
    layout: dict[Function, tuple[int | slice, bool]] = {}
    first = 0
    for function, value in zip(functions, values, strict=True):
        wide = isinstance(value, tuple)
        end = first + (len(value) if wide else 1)
        layout[function] = slice(first, end) if wide else first, not wide and value.dtype == torch.bool
        first = end
    return layout
