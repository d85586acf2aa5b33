"""What can be read off a satellite at a decision boundary, computed for all environments in one call.

An :func:`observable` is a property of a model that is written on planes, as the tick is. Those that an environment reads at every
step are computed together, by one kernel where there is one; any of them can be read at any time.
"""

from __future__ import annotations

import functools
import logging
from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from bsk_torch.astro.attitude import mrp_to_dcm
from bsk_torch.astro.ephemeris import EARTH_ROTATION_RATE
from bsk_torch.astro.orbit import Elements, hill_frame, hill_rate, rv_to_elements
from bsk_torch.lanes import expr
from bsk_torch.lanes.expr import UntraceableError
from bsk_torch.lanes.loop import Loop
from bsk_torch.sim.component import Bus, neighbours
from bsk_torch.sim.sky import SKY, sky_at
from bsk_torch.vec3 import Mat3, Vec3

if TYPE_CHECKING:
    from bsk_torch.sim.simulator import Simulator

logger = logging.getLogger(__name__)

Function = Callable[["Now"], Any]


class Arguments:
    """Arguments of the present episodes by name, planes or vectors."""

    def __init__(self, read: Callable[[str], Any]) -> None:
        """Look arguments up with ``read``."""
        self._read = read

    def __getattr__(self, name: str) -> Any:
        """The argument ``name``."""
        value = self._read(name)
        setattr(self, name, value)
        return value


class Now:
    """The satellite and its world at a decision boundary: fields of the state as attributes, and what follows from them.

    ``args`` holds the drawn arguments. Vectors are :class:`Vec3`, matrices :class:`Mat3`; frames are N (inertial), B (body),
    P (Earth-fixed) and H (Hill).
    """

    def __init__(self, args: Arguments, sky: Callable[[], Bus]) -> None:
        """Add the state with :meth:`Layout.put`."""
        self.args, self._sky = args, sky

    @functools.cached_property
    def sky(self) -> Bus:
        """Sun and Earth."""
        return self._sky()

    def __getattr__(self, name: str) -> Any:
        """Only reached for what the satellite does not have."""
        raise AttributeError(f"the satellite has no state {name!r}")

    @functools.cached_property
    def BN(self) -> Mat3:
        """DCM from N to B."""
        return mrp_to_dcm(self.sigma)

    @functools.cached_property
    def HN(self) -> Mat3:
        """DCM from N to H."""
        return hill_frame(self.r, self.v)

    @functools.cached_property
    def PN(self) -> Mat3:
        """DCM from N to P."""
        x, y, z = self.sky.pole
        cos, sin = self.sky.cos_earth, self.sky.sin_earth
        return Mat3(x * cos + y * sin, y * cos - x * sin, z)

    @functools.cached_property
    def omega_HN_H(self) -> Vec3:
        """Rate of the Hill frame, rad/s in H."""
        rate = hill_rate(self.r, self.v)
        zero = torch.zeros_like(rate)
        return Vec3(zero, zero, rate)

    @functools.cached_property
    def elements(self) -> Elements:
        """Osculating elements, angles in rad."""
        return rv_to_elements(self.r, self.v, self.args.mu)

    @property
    def omega_PN_N(self) -> Vec3:
        """Rate of the Earth, rad/s in N."""
        return self.sky.pole.z * EARTH_ROTATION_RATE

    @property
    def r_sun(self) -> Vec3:
        """Sun relative to the Earth, m in N."""
        return self.sky.r_sun


class observable(property):  # noqa: N801  - a decorator
    """A property of a model, written as a function of :class:`Now` that returns a plane [N] or a :class:`Vec3`.

    Read as an attribute it is a tensor [N] or [N, 3], float64.
    """

    def __init__(self, function: Function) -> None:
        """Decorate ``function``."""
        super().__init__(lambda model: model.simulator.observer.read(function), doc=function.__doc__)
        self.function, self.__name__ = function, function.__name__


class vital(observable):  # noqa: N801  - a decorator
    """An aliveness check of a model, written as a function of :class:`Now` that returns a mask; see ``aliveness_checker``."""

    is_aliveness_checker = True

    def __init__(self, function: Function) -> None:
        """Decorate ``function``; read as an attribute it is a method without arguments."""
        super().__init__(function)
        property.__init__(self, lambda model: functools.partial(model.simulator.observer.read, function), doc=function.__doc__)


def _tensor(value: Any) -> Tensor:
    """What users get: never a view of the state, which the next step changes."""
    if isinstance(value, tuple):
        return torch.stack(list(value), -1)
    return value.clone() if value._is_view() else value


class Observer:
    """Reads observables of a simulation, each at most once between two changes of its state."""

    def __init__(self, simulator: Simulator, backend: str) -> None:
        """Read from ``simulator``."""
        self.simulator, self.kernels = simulator, backend == "compiled" and simulator.device.type == "cpu"
        self.wanted: tuple[Function, ...] = ()
        self._kernel: ObserverKernel | None = None
        self._values: dict[Function, Tensor] = {}
        self._now: Now | None = None
        self.version = 0  # of the state

    def want(self, functions: Iterable[Function]) -> None:
        """Name what will be read at every step."""
        self.wanted, self._kernel = tuple(dict.fromkeys(functions)), None
        self.forget()

    def forget(self) -> None:
        """Called when the simulation's state has changed."""
        self._values, self._now = {}, None
        self.version += 1

    def read(self, function: Function) -> Tensor:
        """An observable, [N] or [N, 3]."""
        if function not in self._values:
            if self.kernels and function in self.wanted:
                self._values.update(self._compute())
            else:
                self._values[function] = _tensor(function(self.now))
        return self._values[function]

    @property
    def now(self) -> Now:
        """The present on tensors."""
        if self._now is None:
            self._now = now_on_tensors(self.simulator)
        return self._now

    def _compute(self) -> dict[Function, Tensor]:
        if self._kernel is None:
            try:
                self._kernel = ObserverKernel(self.simulator, self.wanted)
            except UntraceableError as error:
                logger.warning("%s; observations are computed on tensors instead, which is slower", error)
                self.kernels = False
                return {function: _tensor(function(self.now)) for function in self.wanted}
        return self._kernel(self.simulator)


def now_on_tensors(simulator: Simulator) -> Now:
    """The present of a simulation on tensors [N]."""

    def read(name: str) -> Any:
        value = simulator.argument(name)
        return Vec3.of(value) if isinstance(value, Tensor) and value.ndim == 2 and value.shape[1] == 3 else value

    def sky() -> Bus:
        samples = simulator.arcs.sky_samples
        records, tau = neighbours(SKY, samples.table, simulator.all_rows, simulator.sim_time - samples.start)
        return sky_at(records.flatten(1).unbind(-1), tau)

    now = Now(Arguments(read), sky)
    simulator.tick.state.put(now, simulator.pack.unbind(0))
    return now


class ObserverKernel:
    """The kernel that computes several observables at once."""

    def __init__(self, simulator: Simulator, functions: Sequence[Function]) -> None:
        """Build the kernel; UntraceableError for a function that has none."""
        program = expr.Program()
        self.arguments: list[str] = []
        widths: dict[str, int] = {}

        def read(name: str) -> Any:
            value = simulator.argument(name)
            if not isinstance(value, Tensor):
                return value
            width = value.reshape(simulator.size, -1).shape[1]
            first = sum(widths.values())
            widths[name] = width
            self.arguments.append(name)
            planes: list[Any] = [program.input(("own", first + k), expr.DOUBLE, expr.ALWAYS) for k in range(width)]
            return planes[0] if width == 1 else Vec3(*planes) if width == 3 else tuple(planes)

        state, sky = simulator.tick.state, SKY.count * SKY.width
        records = [program.input(("track", 1, k), expr.DOUBLE, 1) for k in range(sky)]
        tau = program.input(("tau", 1), expr.DOUBLE, expr.TICK)
        now = Now(Arguments(read), lambda: sky_at(records, tau))
        state.put(now, [program.input(("state", k), expr.DOUBLE, expr.TICK) for k in range(state.size)])
        values = [function(now) for function in functions]
        self.layout = _layout(functions, values)
        planes = [p for value in values for p in (value if isinstance(value, tuple) else (value,))]
        self.kernel = Loop("observation", program, [], (SKY,), planes, clock="start")
        self.width = len(planes)

    def __call__(self, simulator: Simulator) -> dict[Function, Tensor]:
        """Observables by function."""
        written = torch.empty(simulator.size, 1, self.width, dtype=torch.float64)
        self.kernel(
            simulator.pack,
            1,
            [simulator.arcs.sky_samples],
            own=simulator.argument_pack(tuple(self.arguments)),
            ticks=simulator.ticks,
            nanoseconds=simulator.h_ns,
            written=written,
        )
        found = written.squeeze(1)
        return {f: found[:, at] > 0.5 if is_mask else found[:, at] for f, (at, is_mask) in self.layout.items()}


def _layout(functions: Sequence[Function], values: Sequence[Any]) -> dict[Function, tuple[int | slice, bool]]:
    """Columns of each observable, and whether it is a mask."""
    layout: dict[Function, tuple[int | slice, bool]] = {}
    first = 0
    for function, value in zip(functions, values, strict=True):
        wide = isinstance(value, tuple)
        end = first + (len(value) if wide else 1)
        layout[function] = slice(first, end) if wide else first, not wide and value.kind == expr.MASK
        first = end
    return layout
