"""Components of models, their arguments, their state and the tick parameters that follow from them.

A component is a table entry, not an object with state: it names the arguments that a user may set, the state that it carries
from tick to tick, how both are filled at reset, and one update. During a tick all components share a :class:`Bus`, on which
state, parameters and the messages of this tick are attributes; a component reads what earlier ones wrote, so the order of
components, see :mod:`bsk_torch.sim.schedule`, is Basilisk's order of modules, and a message of the previous tick is
simply one that has not been rewritten yet.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NoReturn, TypeVar

import torch
from torch import Tensor

from bsk_torch._checks import text, whole
from bsk_torch.constants import NANO
from bsk_torch.sim.schedule import SCHEDULE, Schedule
from bsk_torch.vec3 import Mat3, Vec3

__all__ = ["Arg", "Bus", "Component", "Field", "MissingMessageError", "Track", "vec"]

Values = Mapping[str, Any]
"""Arguments of the rows being reset: tensors with leading dimension n, or 1 where all environments agree."""

UserArguments = Mapping[str, Any]
"""Arguments as users give them: numbers, distributions, functions and other values that are not drawn yet."""

Computation = Callable[[Values], dict[str, Tensor]]  # returns fields of the state, or parameters, by name


class Own(dict[str, object]):
    """Arguments that the component in a slot reads, by name."""

    slot: str

    def __missing__(self, name: str) -> NoReturn:
        raise KeyError(
            f"the component in slot {self.slot!r} reads the argument {name!r}, which it does not list; declare it in args=, "
            "or, if another component declares it, name it in reads="
        )


class MissingMessageError(AttributeError):
    """A component reads a message, field or parameter that none has written."""


class Bus:
    """The values of one tick by name: state, parameters, flags of the flight mode and messages.

    ``h_ns`` and ``h`` are the length of the tick in nanoseconds and seconds, ``ticks`` is the number of this tick since reset,
    ``dtype`` the type of attitude and flight software, and ``opaque_field`` is True where the Earth's field is called as one
    operator. ``effectors`` are those of the components that run. ``gravity_degree`` is the degree of the Earth's field in which
    the hub integrates the orbit; None where the orbit was solved in advance.
    """

    effectors: tuple[Effector, ...] = ()

    def __init__(
        self, h_ns: int, dtype: torch.dtype = torch.float64, opaque_field: bool = False, gravity_degree: int | None = None
    ) -> None:
        """Start a tick of ``h_ns`` nanoseconds."""
        self.h_ns, self.h, self.dtype, self.opaque_field = h_ns, h_ns * NANO, dtype, opaque_field
        self.gravity_degree = gravity_degree

    def __getattr__(self, name: str) -> Any:
        raise MissingMessageError(f"no component has written {name!r} to the bus before it is read", name=name, obj=self)

    if TYPE_CHECKING:  # components write messages as attributes

        def __setattr__(self, name: str, value: Any) -> None: ...

    def has(self, name: str) -> bool:
        """Return whether some component has written ``name``."""
        return hasattr(self, name)


EXAMPLES = {
    "args": 'Arg("heaterPowerDraw", -20.0, "W", "power in shadow")',
    "state": 'Field("heater_energy", 1, "W s")',
    "params": 'Field("heater_power", 1, "W")',
    "flags": '"heater_on"',
    "resets": '("heater_energy", 0.0)',
}
"""Entries of the lists of a component, for messages."""

KIND_SHAPES: dict[str, tuple[int, ...]] = {"vector": (3,), "matrix": (9,), "orbit": (6,)}
"""Shapes of the values of arguments, by kind; of all others one number."""


@dataclass(frozen=True)
class Arg:
    """An argument that users set by name in ``sat_args`` or ``world_args``.

    ``kind`` is the form of its values: ``scalar``, ``vector`` (three numbers), ``matrix`` (nine numbers), ``choice``
    (one of ``choices``, kept as its index), ``utc``, ``orbit``, ``stations`` or ``constant`` (kept unchanged). ``shape`` is the
    shape of other values that are numbers, such as ``(4, 3)``; None in it stands for any size, such as ``(None, 3)``: the same
    for all satellites of a type, and fixed when the environment is built. Where it is ``spread``, one number stands for all of
    the shape; where it is ``diagonal``, a vector stands for the matrix with this diagonal. ``low`` and ``high`` bound every
    number (inclusive). Numbers must be finite unless infinity means something, such as no limit: where an argument is
    ``endless``, or infinite by default. ``whole`` ones have no fraction. ``missing`` stands for None. A ``shared`` one is the
    same for all environments. ``flown`` are wider bounds, of numbers that Basilisk takes though they mean little; they hold with
    ``compat="bsk_rl"`` and in :mod:`bsk_torch.bsk_rl`.
    """

    name: str
    default: Any
    unit: str
    doc: str
    kind: str = "scalar"
    low: float = float("-inf")
    high: float = float("inf")
    missing: float | None = None
    choices: tuple[object, ...] = ()
    shared: bool = False
    endless: bool = False
    whole: bool = False
    shape: tuple[int | None, ...] | None = None
    spread: bool = False
    diagonal: bool = False
    flown: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        if self.shape is None:
            return
        sizes = self.shape if isinstance(self.shape, tuple) else (0,)
        if not all(size is None or (isinstance(size, int) and size > 0) for size in sizes):
            raise ValueError(f"argument {self.name!r} has shape={self.shape!r}; it must be a tuple of sizes, such as (4, 3)")
        if self.kind != "scalar":
            raise ValueError(f"argument {self.name!r} has kind={self.kind!r} and shape={self.shape!r}; give one of them")
        if self.missing is not None and None in sizes:
            raise ValueError(f"argument {self.name!r} has missing={self.missing!r}, whose size shape={self.shape!r} leaves open")

    @property
    def dims(self) -> tuple[int | None, ...]:
        """Shape of a value: () for one number; None where any size is allowed."""
        return KIND_SHAPES.get(self.kind, ()) if self.shape is None else self.shape

    @property
    def may_be_infinite(self) -> bool:
        """Whether infinity is allowed."""
        return self.endless or (isinstance(self.default, float) and math.isinf(self.default)) or self.missing == math.inf

    @property
    def as_flown(self) -> Arg:
        """The argument with the bounds ``flown``."""
        return self if self.flown is None else replace(self, low=self.flown[0], high=self.flown[1])

    @property
    def allowed(self) -> str:
        """Allowed range of a number, for messages."""
        if (self.low, self.high) == (-math.inf, math.inf):
            return "be finite"
        begin = "[" if self.may_be_infinite or math.isfinite(self.low) else "("
        end = "]" if self.may_be_infinite or math.isfinite(self.high) else ")"
        return f"{'be a whole number' if self.whole else 'lie'} in {begin}{self.low:g}, {self.high:g}{end}"


@dataclass(frozen=True)
class Field:
    """A named quantity of ``width`` numbers: 1 is a plane, 3 is a :class:`Vec3`; others, and ``many``, are tuples of planes.

    ``vectors`` are tuples of :class:`Vec3`, one for every three of the numbers: the axes of four wheels have ``width=12``. Three
    of them are the rows of a :class:`Mat3` in a ``matrix``, whose width is 9.
    ``exact`` ones are float64 even where attitude and flight software run in float32: orbit, time and accumulators. ``limit`` is
    the largest magnitude in a restored state.
    """

    name: str
    width: int = 1
    unit: str = ""
    doc: str = ""
    many: bool = False
    exact: bool = False
    limit: float = 1e15
    vectors: bool = False
    matrix: bool = False

    def __post_init__(self) -> None:
        text("name of a Field", self.name)
        whole(f"field {self.name!r}: width", self.width, 1)


def vec(name: str, unit: str = "", doc: str = "", exact: bool = False) -> Field:
    """Return a field of three components."""
    return Field(name, 3, unit, doc, exact=exact)


@dataclass(frozen=True)
class Track:
    """Samples of quantities known in advance, a record of ``fields`` every ``spacing`` seconds.

    A tick reads, as ``bus.<name>``, ``count`` neighboring records, of which ``before`` lie before the last one that has passed,
    and the seconds since that one as ``bus.<name>_tau``.
    """

    name: str
    spacing: float
    fields: tuple[Field, ...]
    count: int = 2
    before: int = 0

    @functools.cached_property
    def width(self) -> int:
        """Numbers in a record."""
        return sum(field.width for field in self.fields)


def neighbours(track: Track, table: Tensor, rows: Tensor, elapsed: Tensor) -> tuple[Tensor, Tensor]:
    """Return records [m, count, width] of ``rows`` [m] around times ``elapsed`` [m] since the start of a table, and tau [m].

    The table is [N, R, width]; times and tau, the time since the last record, are in s.
    """
    index = torch.floor(elapsed * (1.0 / track.spacing)) - track.before
    index = index.clamp(0, table.shape[1] - track.count)
    steps = torch.arange(track.count, device=table.device)
    return table[rows.unsqueeze(-1), index.long().unsqueeze(-1) + steps], elapsed - (index + track.before) * track.spacing


@dataclass(frozen=True)
class Effector:
    """What the hub integrates together with itself over a tick, such as reaction wheels, or what exerts a force or torque on it.

    With inertia I and external torque L about the center of mass, and the body rate omega, the hub solves::

        (I - sum_i J_i) omega' = L - omega x (I omega) - sum_i loads_i,    y_i' = rates_i

    All members are optional; vectors are in B, and quantities that do not depend on the stage are read from the bus.

    Attributes:
        state: Fields of the state integrated with the hub, as on the bus: y.
        loads: ``loads(bus, omega_BN_B, y)`` yields torques, N m, that the hub exerts on the effector. They are subtracted one
            after another.
        inertia: ``inertia(bus)`` returns J, kg m^2, the part of I that does not turn with the hub about its own axes, a matrix or
            its diagonal.
        rates: ``rates(bus, omega_BN_B, omega_BN_B', y)`` returns y'.
        momentum: ``momentum(bus, omega_BN_B)`` returns the angular momentum about its own axes, N m s: relative to N, or to the
            hub where the rate is None.
        torque: ``torque(bus, stage)`` returns an external torque, N m, in stage 0 to 3 of the Runge-Kutta step; None for none.
        force: ``force(bus, v_BN_B)`` returns an external force, N, and its torque about B, N m, where the orbit is integrated.
        gradient: ``gradient(bus, r_CN_B)`` returns an external torque, N m, that depends on attitude and on the position of the
            center of mass, m from the Earth's center.
        ambient: ``ambient(bus, BN, r_BN_N)`` returns an external force, N, or None, and its torque about B, N m, that follow
            from the attitude and the position of B, m, as those of sunlight and magnetic fields. Where the orbit was solved in
            advance, the force only turns the body.
        thrust: ``thrust(bus, stage)`` returns the same as ``force`` for a force of stage 0 to 3, None for none; the orbit must be
            integrated.
    """

    state: tuple[str, ...] = ()
    loads: Callable[[Bus, Vec3, tuple[Any, ...]], Iterable[Vec3]] | None = None
    inertia: Callable[[Bus], Vec3 | Mat3] | None = None
    rates: Callable[[Bus, Vec3, Vec3, tuple[Any, ...]], tuple[Any, ...]] | None = None
    momentum: Callable[[Bus, Vec3 | None], Vec3] | None = None
    torque: Callable[[Bus, int], Vec3 | None] | None = None
    force: Callable[[Bus, Vec3], tuple[Vec3, Vec3]] | None = None
    gradient: Callable[[Bus, Vec3], Vec3] | None = None
    ambient: Callable[[Bus, Mat3, Vec3], tuple[Vec3 | None, Vec3]] | None = None
    thrust: Callable[[Bus, int], tuple[Vec3, Vec3] | None] | None = None


@dataclass(frozen=True)
class Allocation:
    """How the torque on the body that a control law asks for is distributed among actuators."""

    commands: tuple[str, ...]  # fields of the state that hold the commands to the actuators
    # `distribute(bus, torque_B)` returns their values for a torque on the body, N m in B
    distribute: Callable[[Bus, Vec3], tuple[object, ...]]


@dataclass(frozen=True)
class Component:
    """One part of a model; see the module docstring.

    ``slot`` is the name under which a subclass replaces it, and its place in the tick: a slot of the dynamics model's
    ``schedule``, unless ``after`` or ``before`` names the one next to which it runs. With
    ``at_start`` it takes part in the tick at time zero, whose length is zero; components of the world always do.

    ``initial`` and ``prepare`` compute, from the arguments of the rows being reset, the state and the tick parameters as float64
    tensors [n or 1] and [n or 1, width]; fields that ``initial`` leaves out start at zero. ``check`` raises for arguments that do
    not fit together, ``check_tick`` for those that do not fit the length of a tick, s, and returns words to be logged about those
    that hardly do. They get the arguments that the component declares, and those of other components that it ``reads``, if there
    are any. ``overwrites`` lists fields
    whose last value the update does not read, so that what a user writes into them is lost, each with advice what to do instead.
    ``integrated_only`` components run only where the orbit is integrated in the tick. ``fit`` returns the component to use, from
    the arguments as users gave them, defaults included, where its structure depends on them: it is called once, when the
    simulation is built. A component that ``mends`` an error of recordings does not run under ``compat="bsk_rl"``.

    ``records`` names fields of the state kept at every tick of a run, see :mod:`bsk_torch.sim.tick.trace`. ``follows``
    names a slot: the component reads, as ``bus.<slot>[0].<field>``, what the one satellite of the episode whose model has that
    slot records, at the end of the same tick.

    ``tracks`` are samples that the component reads as ``bus.<track>``; what knows them supplies them to the simulation, see
    :class:`bsk_torch.sim.tick.trace.TrackSource`.

    ``flags`` are what flight modes may switch on: ``bus.<flag>`` is 1 in the modes that list it, else 0. Those of ``idle_flags``
    are 1 before the first command, too. ``resets`` lists fields of the state with the values to which every command sets them.

    The hub integrates the ``effector`` of a component together with itself. Control laws ask the ``allocation`` of a component to
    distribute torques among actuators; see :mod:`bsk_torch.sim.fsw.allocation`.

    ``places`` returns the kinds of places that the component brings, as :class:`bsk_torch.sim.places.Places` by name, from the
    tables of a simulation (:class:`bsk_torch.sim.places.PlaceTables`).
    """

    slot: str
    update: Callable[[Bus], None] | None = None
    args: tuple[Arg, ...] = ()
    state: tuple[Field, ...] = ()
    params: tuple[Field, ...] = ()
    reads: tuple[str, ...] = ()
    initial: Computation | None = None
    prepare: Computation | None = None
    check: Callable[[Values], None] | None = None
    check_tick: Callable[[Values, float], str | None] | None = None
    overwrites: tuple[tuple[str, str], ...] = ()
    integrated_only: bool = False
    stops: bool = False
    after: str | None = None
    before: str | None = None
    at_start: bool = False
    fit: Callable[[UserArguments], Component] | None = None
    mends: bool = False
    records: tuple[str, ...] = ()
    follows: str | None = None
    tracks: tuple[Track, ...] = ()
    flags: tuple[str, ...] = ()
    idle_flags: tuple[str, ...] = ()
    resets: tuple[tuple[str, float], ...] = ()
    effector: Effector | None = None
    allocation: Allocation | None = None
    places: Callable[[Any], Mapping[str, object]] | None = None

    def __post_init__(self) -> None:
        text("slot of a Component", self.slot)
        for name, kind in (("args", Arg), ("state", Field), ("params", Field), ("flags", str), ("resets", tuple)):
            value = getattr(self, name)
            if not isinstance(value, tuple | list) or not all(isinstance(entry, kind) for entry in value):
                raise TypeError(
                    f"the component in slot {self.slot!r} has {name}={value!r:.200}; it must be a tuple of {kind.__name__}, "
                    f"such as {name}=({EXAMPLES[name]},)"
                )
        for name in ("initial", "prepare", "check"):
            value = getattr(self, name)
            if value is not None and not callable(value):
                raise TypeError(f"the component in slot {self.slot!r} has {name}={value!r}; it must be a function")

    @functools.cached_property
    def arguments(self) -> tuple[str, ...]:
        """Names of the arguments that the component reads: its own, and those of other components."""
        return (*(arg.name for arg in self.args), *self.reads)

    def extended(
        self,
        *,
        update: Callable[[Bus], None] | None = None,
        args: tuple[Arg, ...] = (),
        state: tuple[Field, ...] = (),
        params: tuple[Field, ...] = (),
        reads: tuple[str, ...] = (),
        initial: Computation | None = None,
        prepare: Computation | None = None,
        check: Callable[[Values], None] | None = None,
        flags: tuple[str, ...] = (),
        resets: tuple[tuple[str, float], ...] = (),
    ) -> Component:
        """Return the component with additions, in the same slot: a model that lists it has it in place of this one.

        Args:
            update: Runs after the component's update, in the same tick.
            args: Further arguments; one with the name of an argument of the component replaces it.
            state: Further fields of the state, likewise.
            params: Further parameters, likewise.
            reads: Further arguments of other components that the functions below read.
            initial: Values of the further fields at reset; those with the name of a field of the component replace its values.
            prepare: Values of the further parameters, likewise.
            check: Runs after the component's check.
            flags: Further flags.
            resets: Further resets.
        """
        own_fit = self.fit
        additions: dict[str, Any] = {"update": update, "args": args, "state": state, "params": params, "reads": reads}
        additions |= {"initial": initial, "prepare": prepare, "check": check, "flags": flags, "resets": resets}
        joined = {name: _JOINED[name](getattr(self, name), addition) for name, addition in additions.items()}
        if own_fit is not None:  # the structure that the given arguments need gets the same additions
            joined["fit"] = lambda arguments: own_fit(arguments).extended(**additions)
        return replace(self, **joined)


def asked(components: Iterable[Component], values: Values) -> list[tuple[Component, Values]]:
    """Return each component with those of the arguments that it reads."""
    pairs: list[tuple[Component, Values]] = []
    for component in components:
        part_values = Own({name: values[name] for name in component.arguments if name in values})
        part_values.slot = component.slot
        pairs.append((component, part_values))
    return pairs


Call = TypeVar("Call", bound=Callable[[Any], None])


def _one_after_the_other(first: Call | None, second: Call | None) -> Call | None:
    """Return a function that calls both; its docstring, which `bsk-torch schedule` shows, is that of the first."""
    if first is None or second is None:
        return first if second is None else second

    @functools.wraps(first)
    def both(argument: object) -> None:
        first(argument)
        second(argument)

    return both  # type: ignore[return-value]


def _united(first: Computation | None, second: Computation | None) -> Computation | None:
    if first is None or second is None:
        return first if second is None else second
    return lambda args: {**first(args), **second(args)}


Named = TypeVar("Named", bound=Arg | Field)


def _merged(first: tuple[Named, ...], second: tuple[Named, ...]) -> tuple[Named, ...]:
    replaced_by = {entry.name for entry in second}
    return (*(entry for entry in first if entry.name not in replaced_by), *second)


_JOINED: dict[str, Callable[[Any, Any], Any]] = {
    **dict.fromkeys(("update", "check"), _one_after_the_other),
    **dict.fromkeys(("args", "state", "params"), _merged),
    **dict.fromkeys(("initial", "prepare"), _united),
    **dict.fromkeys(("reads", "resets"), lambda first, second: (*first, *second)),
    "flags": lambda first, second: tuple(dict.fromkeys((*first, *second))),
}
"""How an entry of a component and an addition to it become one, see :meth:`Component.extended`."""


def collect(classes: Iterable[type], schedule: Schedule = SCHEDULE) -> tuple[Component, ...]:
    """Return the components of ``classes`` in the order of a schedule; a later class replaces the slots of an earlier one.

    Components with a place in the schedule of another dynamics model only come last.
    """
    listed = (component for cls in classes for component in vars(cls).get("components", ()))
    return schedule.listed(replaced(listed))


def replaced(components: Iterable[Component]) -> tuple[Component, ...]:
    """Return the last component of each slot."""
    return tuple({component.slot: component for component in components}.values())


def declared(*models: type) -> Iterator[Component]:
    """Yield all components that models and their bases list, base classes first, those that a subclass replaces too."""
    for model in models:
        for cls in reversed(model.__mro__):
            for attribute in ("components", "world_components"):
                yield from vars(cls).get(attribute, ())


class Layout:
    """Layout of fields in a pack of planes [C, N]."""

    def __init__(self, fields: Iterable[Field]) -> None:
        """Lay the fields out one after the other; equal names are one field."""
        self.fields = {f.name: f for f in fields}
        self.slices: dict[str, slice] = {}
        start = 0
        for f in self.fields.values():
            self.slices[f.name] = slice(start, start + f.width)
            start += f.width
        self.size = start

    def put(self, bus: Any, planes: Sequence[Any]) -> None:
        """Write every field to the bus from the planes of a pack."""
        for name, f in self.fields.items():
            part = tuple(planes[self.slices[name]])
            if f.vectors or f.matrix:
                part = tuple(Vec3(*part[k : k + 3]) for k in range(0, f.width, 3))
            part = Mat3(*part) if f.matrix else part
            single = not (f.many or f.vectors or f.matrix)
            setattr(bus, name, part[0] if single and f.width == 1 else Vec3(*part) if single and f.width == 3 else part)

    @property
    def exact(self) -> list[bool]:
        """True for each plane that is always float64."""
        return [f.exact for f in self.fields.values() for _ in range(f.width)]

    @property
    def limits(self) -> list[float]:
        """Largest magnitude of each plane."""
        return [f.limit for f in self.fields.values() for _ in range(f.width)]

    def gather(self, bus: Bus) -> list[Tensor]:
        """Return the planes of every field, read from the bus in the order of the pack."""
        planes: list[Tensor] = []
        for name, f in self.fields.items():
            value = getattr(bus, name)
            if f.vectors or f.matrix:
                value = [component for vector in value for component in vector]
            planes.extend((value,) if f.width == 1 and not f.many else value)
        return planes

    def rows(self, values: Mapping[str, Tensor], n: int) -> Tensor:
        """Return the pack [C, n] of named values [n or 1] or [n or 1, width]; ValueError if one is missing."""
        for name in self.fields:
            if name not in values:
                raise ValueError(
                    f"no component gives {name!r} a value when episodes start; return it from prepare= of the one that lists it "
                    "in params="
                )
        parts = [values[name].reshape(-1, f.width).mT.expand(-1, n) for name, f in self.fields.items()]
        return torch.cat(parts) if parts else torch.zeros(0, n, dtype=torch.float64)

    def view(self, pack: Tensor, name: str) -> Tensor:
        """Return a view of the field in the pack: [N] for one plane, else [width, N]."""
        part = pack[self.slices[name]]
        return part[0] if self.fields[name].width == 1 else part
