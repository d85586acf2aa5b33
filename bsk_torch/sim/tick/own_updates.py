"""Checks of the updates of users' components, made once, when their tick is built.

A mistake in an update otherwise shows in another component, as a wrong number, or not at all: a misspelled message has no effect,
a mean over ``bus.power`` is one over all environments, and a number in the place of a vector raises an error where the vector is
read. Updates of the package are not checked.
"""

from __future__ import annotations

import copy
import difflib
from collections.abc import Callable, Collection
from types import SimpleNamespace

import torch
from torch import Tensor

from bsk_torch.codegen.ir import UntraceableError
from bsk_torch.codegen.kept import of_package
from bsk_torch.sim.component import Bus, Component, MissingMessageError
from bsk_torch.sim.hooks import SIMILAR
from bsk_torch.vec3 import Mat3, Vec3

ELEMENTWISE = (
    "an update computes element by element, with numbers and vectors that each stand for all environments: write "
    "torch.where(mask, a, b) in place of if, and torch's functions of numbers, such as torch.sqrt"
)
"""How to write an update."""

TOLERANCE = 1e-9
"""Relative difference of results that counts as rounding."""


class WatchedBus(Bus):
    """A bus that knows which messages users' components have written, and which of these have been read since."""

    unread: dict[str, str]
    """Slots of users' components by the messages that they have written and nothing has read."""

    def __getattribute__(self, name: str) -> object:
        attributes = object.__getattribute__(self, "__dict__")
        if name in attributes.get("unread", ()):
            del attributes["unread"][name]
        return object.__getattribute__(self, name)

    def watch(self) -> None:
        """Begin to watch."""
        self.__dict__["unread"] = {}


def update_checked(bus: WatchedBus, component: Component) -> None:
    """Run the update of a component, and check it if it is a user's.

    MissingMessageError for an update that reads what none writes, with the name and the component's slot. TypeError for one
    that fails, returns a value, writes a message of another kind than before, or in place, or depends on other environments.
    """
    update, slot = component.update, component.slot
    if update is None:
        return
    is_user_code = not of_package([update])
    messages = vars(bus)
    before = {name: value for name, value in messages.items() if name != "unread"}
    try:
        if is_user_code and isinstance(bus.ticks, Tensor):
            _compare(update, slot, bus)
        returned: object = update(bus)
    except MissingMessageError as error:
        title = f"the component in slot {slot!r} reads {error.name!r}, which no component writes before it"
        raise MissingMessageError(title, name=error.name) from None
    except UntraceableError:
        raise
    except (TypeError, RuntimeError, AttributeError, ValueError) as error:
        if not is_user_code or isinstance(error, UpdateError) or _raised_by_package(error):
            raise
        raise UpdateError(
            f"the update of the component in slot {slot!r} fails: {type(error).__name__}: {str(error).partition(chr(10))[0]}; "
            f"{ELEMENTWISE}"
        ) from error
    if not is_user_code:
        return
    if returned is not None:
        raise UpdateError(
            f"the update of the component in slot {slot!r} returns {returned!r}; it must return None, and write what it computes "
            "to the bus, as in bus.power = bus.power + power"
        )
    for name, value in messages.items():
        if name == "unread" or before.get(name) is value:
            continue
        _check_kind(slot, name, before.get(name), value)
        if name not in before:
            messages["unread"][name] = slot


def check_read(bus: WatchedBus, fields: Collection[str]) -> None:
    """Raise TypeError for a message of a user's component that nothing reads, if it is spelled almost like a ``fields`` one."""
    for name, slot in vars(bus)["unread"].items():
        others = [other for other in {*fields, *vars(bus)} if other not in (name, "unread")]
        for meant in [] if name in fields else difflib.get_close_matches(name, others, n=1, cutoff=SIMILAR):
            raise UpdateError(
                f"the component in slot {slot!r} writes bus.{name}, which no component reads; did you mean {meant!r}?"
            )


def _raised_by_package(error: BaseException) -> bool:
    """Return whether a check of the package has raised an error, whose message names the mistake."""
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    return trace is not None and str(trace.tb_frame.f_globals.get("__name__", "")).startswith("bsk_torch.sim.")


class UpdateError(TypeError):
    """An update that cannot be used."""


def _kind(value: object) -> str:
    if isinstance(value, Vec3):
        return "a Vec3"
    if isinstance(value, Mat3):
        return "a Mat3"
    if isinstance(value, tuple):
        return "a tuple"
    if value is None or isinstance(value, str | list | dict | set):
        return repr(value)
    return "a number"


def _check_kind(slot: str, name: str, old: object, new: object) -> None:
    """Raise TypeError for a message that becomes something else, or a tensor that is not one number of each environment."""
    title = f"the component in slot {slot!r} writes bus.{name}"
    if old is not None and _kind(old) != _kind(new):
        raise UpdateError(f"{title} = {_kind(new)}; it must be {_kind(old)}")
    if isinstance(old, Tensor) and isinstance(new, Tensor) and new.shape not in ((), (1,), old.shape):
        raise UpdateError(f"{title} of shape {list(new.shape)}; it must be a number of each environment")


def _mapped(value: object, function: Callable[[Tensor], Tensor]) -> object:
    if isinstance(value, Tensor):
        return function(value) if value.ndim else value
    if isinstance(value, tuple | list):
        return getattr(value, "_make", type(value))(_mapped(part, function) for part in value)
    if isinstance(value, SimpleNamespace | Bus):
        other = copy.copy(value)
        vars(other).update((name, _mapped(part, function)) for name, part in vars(value).items())
        return other
    return value


def _planes(value: object) -> list[Tensor]:
    if isinstance(value, Tensor):
        return [value]
    parts = value if isinstance(value, tuple | list) else vars(value).values() if isinstance(value, SimpleNamespace | Bus) else ()
    return [plane for part in parts for plane in _planes(part)]


def _compare(update: Callable[[Bus], None], slot: str, bus: Bus) -> None:
    """Raise TypeError unless an update gives the first environment the same numbers alone and next to another one."""
    alone, together = Bus.__new__(Bus), Bus.__new__(Bus)
    for copied, function in ((alone, _first), (together, lambda plane: _with_another(_first(plane)))):
        vars(copied).update((name, _mapped(value, function)) for name, value in vars(bus).items() if name != "unread")
    before = dict(vars(together))
    versions = [(name, plane, plane._version) for name, value in before.items() for plane in _planes(value)]
    for each in (alone, together):
        update(each)
    for name, plane, version in versions:
        if plane._version != version:
            raise UpdateError(
                f"the component in slot {slot!r} changes bus.{name} in place; write a new value, as in "
                f"bus.{name} = bus.{name} + x"
            )
    for name, value in vars(together).items():
        if before.get(name) is value:
            continue
        for one, first in zip(_planes(getattr(alone, name)), _planes(value), strict=True):
            again = (first[:1] if first.ndim else first).double()
            if not bool(torch.isclose(one.double(), again, rtol=TOLERANCE, atol=TOLERANCE, equal_nan=True).all()):
                raise UpdateError(
                    f"the component in slot {slot!r} gives an environment another bus.{name} next to a second environment; it "
                    f"must follow from the numbers of that environment, without random numbers: {ELEMENTWISE}"
                )


def _first(plane: Tensor) -> Tensor:
    """Return the number of the first environment, [1]; what follows from the empty tracks of a trial may be NaN."""
    return plane[:1].nan_to_num(0.5) if plane.is_floating_point() else plane[:1].clone()


def _with_another(first: Tensor) -> Tensor:
    other = first * 1.01 + 0.01 if first.is_floating_point() else ~first if first.dtype == torch.bool else first + 1
    return torch.cat([first, other])
