"""Faults as users declare them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch._checks import number
from bsk_torch.rand import Distribution, Key
from bsk_torch.sim.arguments.sources import is_function


@dataclass(frozen=True)
class Hazard(Distribution):
    """Times, s, of the first event of a Poisson process: ``t = -ln(1 - U) / rate``.

    Attributes:
        rate: Mean number of events per second, positive.
    """

    rate: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "rate", number("Hazard: rate", self.rate, 0.0, unit="1/s", above=True))

    @override
    def draw(self, key: Key) -> Tensor:
        return -torch.log1p(-key.uniform(1).squeeze(-1)) / self.rate


@dataclass(frozen=True)
class Sometimes(Distribution):
    """A time in a share of the episodes, and never in the others.

    Attributes:
        chance: Probability of the time, from 0 to 1.
        at: The time, s, a number or a distribution.
    """

    chance: float
    at: float | Distribution

    def __post_init__(self) -> None:
        object.__setattr__(self, "chance", number("Sometimes: chance", self.chance, 0.0, 1.0))
        if not isinstance(self.at, Distribution):
            object.__setattr__(self, "at", number("Sometimes: at", self.at, 0.0, unit="s"))

    def draw(self, key: Key) -> Tensor:
        """See :meth:`bsk_torch.rand.Distribution.draw`; infinity where it is never."""
        strikes = key.named(f"{key.name}: chance").uniform(1).squeeze(-1) < self.chance
        times = self.at.draw(key) if isinstance(self.at, Distribution) else self.at
        return torch.where(strikes, torch.as_tensor(times, dtype=torch.float64), torch.inf)


CHANGING = Distribution()
"""Stands for the value of an argument that a fault may change, where components choose their structure; none is drawn from it."""


def may_change(arguments: Mapping[str, object], *names: str) -> bool:
    """Return whether a fault may change one of the arguments; values are not looked at, so they do not become structural."""
    return any(value is CHANGING for key, value in arguments.items() if key in names)


@dataclass(frozen=True)
class Fault:
    """A change of arguments of a satellite from some time on.

    It acts in all components that compute parameters of a tick from these arguments, custom ones too, or in ``only`` some. Like
    an event of Basilisk it acts from the tick on that follows the first one to end at, or after, its time. What observations
    and rewards read, such as the capacity that a charge is compared with, keeps the value of the argument.

    Attributes:
        argument: Name in ``sat_args``, or names that change together.
        value: New value, in the unit of the argument; one for each of several arguments.
        factor: What the value is multiplied by, in place of ``value``.
        index: Number of the wheel, thruster, or other entry of the argument that changes; None for all of them.
        at: When it begins, s since reset: a number, a distribution such as :class:`Hazard`, or a function. None: only by
            ``env.inject``.
        lasts: After how many seconds all is as before; None for never.
        over: Seconds in which the change grows linearly; it acts at once if 0.
        only: Slots of the components that it acts in; None for all. ``"thrusters"`` changes thrusters, and not what the flight
            software knows of them.
        name: Its name; by default that of the argument, with the index.

    Raises:
        ValueError: For a time that is not finite, or neither a value nor a factor.
    """

    argument: str | Sequence[str]
    value: object = None
    factor: object = None
    index: int | None = None
    at: object = None
    lasts: object = None
    over: float = 0.0
    only: str | Sequence[str] | None = None
    name: str = ""

    def __post_init__(self) -> None:
        if not self.arguments or not all(isinstance(name, str) and name for name in self.arguments):
            raise ValueError(f"Fault(argument={self.argument!r}) must be the name of an argument in sat_args, or several")
        if not self.name:
            object.__setattr__(self, "name", "+".join(self.arguments) + ("" if self.index is None else str(self.index)))
        title = f"fault {self.name!r}"
        if (self.value is None) == (self.factor is None):
            raise ValueError(f"{title} has value={self.value!r} and factor={self.factor!r}; give one of them")
        if self.index is not None and (isinstance(self.index, bool) or not isinstance(self.index, int) or self.index < 0):
            raise ValueError(f"{title}: index={self.index!r} must be the number of a part, from 0 on, or None for all parts")
        several, numbers = len(self.arguments), self.factor if self.value is None else self.value
        if several > 1 and (not isinstance(numbers, Sequence) or len(numbers) != several):
            raise ValueError(f"{title} changes {list(self.arguments)}, so it needs {several} numbers; got {numbers!r}")
        for field, least in (("at", 0.0), ("lasts", 0.0)):
            when = getattr(self, field)
            if when is not None and not isinstance(when, Distribution) and not is_function(when):
                number(f"{title}: {field}", when, least, unit="s", none=True)
        object.__setattr__(self, "over", number(f"{title}: over", self.over, 0.0, unit="s"))
        for field in ("argument", "value", "factor", "only"):
            if isinstance(getattr(self, field), list):
                object.__setattr__(self, field, tuple(getattr(self, field)))

    @property
    def arguments(self) -> tuple[str, ...]:
        """Names of the arguments that change."""
        return (self.argument,) if isinstance(self.argument, str) else tuple(self.argument)

    @property
    def slots(self) -> tuple[str, ...] | None:
        """Slots of the components that it acts in; None for all."""
        return (self.only,) if isinstance(self.only, str) else None if self.only is None else tuple(self.only)

    def change(self, number_: int) -> Any:
        """Return the value, or the factor, of the argument of that number."""
        numbers: Any = self.factor if self.value is None else self.value
        return numbers if len(self.arguments) == 1 else numbers[number_]

    def drawn(self, what: str) -> str:
        """Return the name of the drawn argument that holds ``at``, ``lasts`` or the change of an argument."""
        return f"{self.name}.{what}"

    @property
    def ends(self) -> bool:
        """Whether it may end."""
        return self.lasts is not None


NEVER = 2.0**53  # number of a tick that does not come


def ticks_of(seconds: Tensor, h_ns: int) -> Tensor:
    """Return the number of the first tick that ends at or after a time, s; :data:`NEVER` for infinity."""
    return torch.ceil(torch.round(seconds.double() * 1e9) / h_ns).clamp(max=NEVER)
