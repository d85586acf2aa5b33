"""Several instruments of a satellite, of which an action chooses one.

Components know one instrument. Those with arguments in which instruments differ prepare their parameters for each; a component
before all others puts those of the chosen instrument in place in every tick.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from bsk_torch._checks import no_gradient, parts, text
from bsk_torch.rand import Distribution, as_value
from bsk_torch.sim.component import Arg, Bus, Component, Field, Layout, Values
from bsk_torch.sim.faults.declared import Fault
from bsk_torch.sim.names import check_unique, nearest
from bsk_torch.vec3 import Vec3, select

SLOT, INDEX = "instruments", "instrument_index"

LIMITS = (
    "imageTargetMinimumElevation",
    "imageTargetMaximumRange",
    "imageTargetMinimumSunElevation",
    "imageTargetMaximumSunElevation",
)
"""Arguments on which the windows of targets depend."""

Given = float | Sequence[float] | Distribution | Callable[[], object] | None
"""A value of an argument, what it is drawn from, or None."""


@dataclass(frozen=True)
class Instrument:
    """One of several instruments of a satellite: its name, and the arguments in which it differs from ``sat_args``.

    Each argument may be drawn, as in ``sat_args``; None stands for the value there. Its name in ``env.satellite.sat_args``, and
    for faults, is ``instruments.<name>.<argument>``.

    Raises:
        ValueError: For a name that is not a string.

    Attributes:
        name: Name by which actions and observations refer to it.
        inst_pHat_B: Its axis in B, of any length.
        imageAttErrorRequirement: Largest attitude error, MRP norm, ``tan(a / 4)`` of the angle a between axis and line of sight,
            or of half the angle of a field of view.
        imageRateErrorRequirement: Largest rate error, rad/s.
        imageTargetMinimumElevation: Least elevation of the satellite above the target, rad.
        imageTargetMaximumRange: Longest range to the target, m, also in windows; no limit where negative. The target of a scan
            is the Earth's center.
        imageTargetMinimumSunElevation: Least elevation of the Sun at the target, rad.
        imageTargetMaximumSunElevation: Largest elevation of the Sun at the target, rad.
        instrumentBaudRate: Data of one image, bit; of a scan, in each second, bit/s.
        instrumentPowerDraw: Power while imaging, W, negative; the other instruments are off.
    """

    name: str
    inst_pHat_B: Given = None
    imageAttErrorRequirement: Given = None
    imageRateErrorRequirement: Given = None
    imageTargetMinimumElevation: Given = None
    imageTargetMaximumRange: Given = None
    imageTargetMinimumSunElevation: Given = None
    imageTargetMaximumSunElevation: Given = None
    instrumentBaudRate: Given = None
    instrumentPowerDraw: Given = None

    def __post_init__(self) -> None:
        title = f"Instrument({text('Instrument: name', self.name)!r})"
        for field in dataclasses.fields(self):
            value = as_value(no_gradient(f"{title}: {field.name}", getattr(self, field.name)))
            object.__setattr__(self, field.name, tuple(value) if isinstance(value, list) else value)

    @property
    def own(self) -> dict[str, object]:
        """The arguments in which it differs, by name."""
        values = {field.name: getattr(self, field.name) for field in dataclasses.fields(self) if field.name != "name"}
        return {name: value for name, value in values.items() if value is not None}

    def argument(self, name: str) -> str:
        """Return the name of the argument that it has in place of ``name``."""
        return f"{SLOT}.{self.name}.{name}" if name in self.own else name

    @property
    def has_own_windows(self) -> bool:
        """Whether it has other windows of targets than the satellite."""
        return any(name in self.own for name in LIMITS)


INSTRUMENTS = Component(
    slot=SLOT,
    after="faults",
    args=(Arg(SLOT, None, "-", "several instruments, a list of dyn.Instrument; None: one with inst_pHat_B", "constant"),),
)
"""One instrument, unless the arguments describe several: :func:`with_instruments`."""

NO_INSTRUMENTS = Component(slot=SLOT, after="faults")
"""Nothing in the slot: for models whose instrument neither images places nor scans."""


def described_instruments(arguments: Mapping[str, object], table: Mapping[str, Arg]) -> tuple[Instrument, ...]:
    """Return the instruments that arguments as given, with entries in a ``table``, describe; none for that of ``inst_pHat_B``.

    ValueError for entries that are not instruments, equal names, and arguments that the satellite does not have.
    """
    listed = _listed(arguments)
    check_unique([part.name for part in listed], "instruments")
    for part in listed:
        for name in part.own:
            if name not in table:
                raise ValueError(f"instrument {part.name!r} has {name}, but the satellite does not image places on the ground")
    return listed


def _listed(arguments: Mapping[str, object]) -> tuple[Instrument, ...]:
    what = "a list of instruments, such as [dyn.Instrument('wide'), dyn.Instrument('narrow', instrumentBaudRate=2e6)]"
    listed = arguments.get(SLOT)
    return () if listed is None else parts("sat_args: instruments", listed, Instrument, what)


def instrument_args(listed: Sequence[Instrument], table: Mapping[str, Arg]) -> dict[str, Arg]:
    """Return the entries of the arguments in which instruments differ."""
    return {
        part.argument(name): replace(table[name], name=part.argument(name), default=value, doc=f"{part.name}: {table[name].doc}")
        for part in listed
        for name, value in part.own.items()
    }


def number_of(listed: Sequence[Instrument], instrument: str | int | None, title: str) -> int:
    """Return the number of an instrument that a user has named, by name or number.

    ValueError for an unknown one, or none if there are several; ``title`` names who asks.
    """
    names = [part.name for part in listed]
    if not names:
        raise ValueError(
            f"{title} has instrument={instrument!r}, but the satellite has a single one; describe several in sat_args: "
            "instruments=[dyn.Instrument(...), ...]"
        )
    if instrument is None:
        if len(names) == 1:
            return 0
        raise ValueError(f"{title} names no instrument; give instrument= one of {names}")
    if isinstance(instrument, int) and not isinstance(instrument, bool) and 0 <= instrument < len(names):
        return instrument
    if instrument not in names:
        raise ValueError(f"{title} has instrument={instrument!r}, which the satellite lacks; {nearest(str(instrument), names)}")
    return names.index(instrument)


def each_value(args: Values, name: str) -> Iterator[Tensor]:
    """Yield the values of an argument of all instruments, or of the single one."""
    return (args[name if part is None else part.argument(name)] for part in _listed(args) or (None,))


def differs(arguments: Mapping[str, object], name: str) -> bool:
    """Return whether an instrument has an argument that is not None, in arguments as given."""
    listed = arguments.get(SLOT)
    parts = listed if isinstance(listed, Sequence) else ()
    return arguments[name] is not None or any(name in part.own for part in parts if isinstance(part, Instrument))


def argument_now(state: Any, name: str) -> Tensor:
    """Return an argument of the instrument chosen last, [rows, ...], or of the single one."""
    value: Tensor = state.argument(name)
    for k, part in enumerate(state.constants.get(SLOT) or ()):
        if name in part.own:
            here = state.read(INDEX) == k
            value = torch.where(here.view(-1, *[1] * (value.ndim - 1)), state.argument(part.argument(name)), value)
    return value


def axis_now(now: Any) -> Vec3:
    """Return the axis of the instrument chosen last, in B, of length one."""
    axis: Vec3 = now.args.inst_pHat_B.unit()
    for k, part in enumerate(now.args.instruments or () if hasattr(now, INDEX) else ()):
        if "inst_pHat_B" in part.own:
            axis = select(now.instrument_index == float(k), getattr(now.args, part.argument("inst_pHat_B")).unit(), axis)
    return axis


def with_instruments(parts: Iterable[Component], listed: tuple[Instrument, ...]) -> tuple[Component, ...]:
    """Return the parts, whose structure is final, with parameters for each instrument and the component that selects them."""
    parts = tuple(parts)
    if not listed:
        return parts
    differing = {name for part in listed for name in part.own}
    own_arguments = tuple(part.argument(name) for part in listed for name in part.own)
    parts = tuple(replace(p, reads=(*p.reads, *own_arguments)) if differing.intersection(p.arguments) else p for p in parts)
    several = [part for part in parts if part.params and differing & {arg.name for arg in part.args}]
    table = {arg.name: arg for part in parts for arg in part.args}
    choice = Component(
        slot=SLOT,
        after="faults",
        update=choose_among(len(listed), tuple(field for part in several for field in part.params)),
        args=(*INSTRUMENTS.args, *instrument_args(listed, table).values()),
        state=(Field(INDEX, 1, "-", "number of the instrument that the action has chosen", exact=True, limit=len(listed) - 1.0),),
    )
    slots = {part.slot for part in several}
    return tuple(choice if part.slot == SLOT else _of_each(part, listed) if part.slot in slots else part for part in parts)


def _table_of(field: Field) -> str:
    return f"{field.name}_of_instruments"


@functools.cache
def choose_among(count: int, fields: tuple[Field, ...]) -> Callable[[Bus], None]:
    """Return the update that puts the parameters ``fields`` of one of ``count`` instruments in place."""

    def choose(bus: Bus) -> None:
        """Put the parameters of the instrument that the action has chosen in place."""
        for field in fields:
            planes, width = getattr(bus, _table_of(field)), field.width
            chosen = planes[:width]
            for k in range(1, count):
                here = bus.instrument_index == float(k)
                part_planes = planes[k * width : (k + 1) * width]
                chosen = tuple(torch.where(here, new, old) for new, old in zip(part_planes, chosen, strict=True))
            Layout((field,)).put(bus, chosen)

    return choose


def _of_each(part: Component, listed: tuple[Instrument, ...]) -> Component:
    def values(args: Values, instrument: Instrument) -> Values:
        return {**args, **{name: args[instrument.argument(name)] for name in instrument.own}}

    def prepare(args: Values) -> dict[str, Tensor]:
        parameters = [part.prepare(values(args, instrument)) for instrument in listed]  # type: ignore[misc]
        tables = {}
        for field in part.params:
            columns = [part_parameters[field.name].reshape(-1, field.width) for part_parameters in parameters]
            rows = max(map(len, columns))
            tables[_table_of(field)] = torch.cat([column.expand(rows, -1) for column in columns], -1)
        return tables

    def check(args: Values) -> None:
        for instrument in listed:
            try:
                part.check(values(args, instrument))  # type: ignore[misc]
            except ValueError as error:
                raise ValueError(f"instrument {instrument.name!r}: {error}") from None

    params = (
        replace(f, name=_table_of(f), width=len(listed) * f.width, many=True, vectors=False, matrix=False) for f in part.params
    )
    return replace(part, params=tuple(params), prepare=prepare, check=part.check and check)


def check_faults(listed: Sequence[Instrument], faults: Iterable[Fault]) -> None:
    """Raise ValueError for faults of arguments that do not hold for some instruments."""
    for fault in faults:
        for name in fault.arguments:
            apart = [part for part in listed if name in part.own and part.argument(name) not in fault.arguments]
            if apart:
                raise ValueError(
                    f"fault {fault.name!r} changes {name}, but instrument {apart[0].name!r} has its own; change "
                    f"{apart[0].argument(name)!r}, too, or instead"
                )
