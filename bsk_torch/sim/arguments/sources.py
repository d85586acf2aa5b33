"""What users give for arguments: values, functions that return one value, and functions that return a dictionary of them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from bsk_torch._checks import no_gradient
from bsk_torch.rand import Distribution, as_value, first_key, seeded
from bsk_torch.sim.names import nearest

DRAW_ORDER = (
    "planetRadius baseDensity scaleHeight utc_init groundStationsData groundLocationPlanetRadius gsMinimumElevation "
    "gsMaximumRange hs_min maxCounterValue thrMinFireTime desatAttitude controlAxes_B thrForceSign K Ki P K1 K3 omega_max "
    "servo_Ki servo_P imageAttErrorRequirement imageRateErrorRequirement inst_pHat_B batteryStorageCapacity "
    "storedCharge_Init disturbance_vector dragCoeff panelArea imageTargetMinimumElevation imageTargetMaximumRange "
    "instrumentBaudRate instrumentPowerDraw losMaximumRange basePowerDraw wheelSpeeds maxWheelSpeed u_max rwBasePower "
    "rwMechToElecEfficiency rwElecToMechEfficiency panelEfficiency nHat_B mass width depth height sigma_init omega_init rN "
    "vN oe mu min_orbital_radius dataStorageCapacity bufferNames storageUnitValidCheck storageInit thrusterPowerDraw "
    "transmitterBaudRate transmitterNumBuffers transmitterPacketSize transmitterPowerDraw"
)
"""Arguments in the order in which they are drawn: of the world, of flight software, of dynamics.

Functions that share state or NumPy's generator depend on it.
"""

RANKS = {name: rank for rank, name in enumerate(DRAW_ORDER.split())}

Answers = dict[Any, Any]
"""What the user functions returned for one episode: by owner ("world", or the number of the satellite) and argument."""


@dataclass(frozen=True)
class Member:
    """One argument of a function that returns a dictionary."""

    function: Callable[[], Mapping[str, object]]
    name: str
    trial: object = field(compare=False)  # its value in the call that told the names
    names: frozenset[str] = field(compare=False)  # names that the function sets

    def __call__(self) -> object:
        """Return the value of a call of the function for this argument alone."""
        return self.ask("the function")[self.name]

    def ask(self, title: str) -> dict[str, object]:
        """Return the values of a call; ValueError if it sets other arguments than the first one."""
        values = _called(self.function, title)
        if values.keys() != self.names:
            raise ValueError(
                f"{title}={self.function!r} sets {sorted(values)}, but {sorted(self.names)} at its first call; it must set "
                "the same arguments in all episodes"
            )
        return values


def in_order(names: Iterable[str]) -> list[str]:
    """Return names of arguments in the order of draws, followed by those that it does not list."""
    return sorted(names, key=lambda name: RANKS.get(name, len(RANKS)))


OPTIONAL = {
    **dict.fromkeys(
        (
            *("PMatrix", "walkBounds", "crossTrans", "crossAtt", "RNGSeed"),
            *("navigationBias", "navigationNoise", "navigationStart"),
        ),
        "dyn.NavigationErrorsDynModel",
    ),
    **dict.fromkeys(("torqueBars", "barAxes_B", "barMaxDipoles"), "dyn.TorqueBarsDynModel"),
    "barGain": "fsw.MagneticUnloadingFSWModel",
    "instruments": "dyn.ImagingDynModel",
}
"""Arguments of optional models, and these models."""


def hint(name: str, names: Iterable[str]) -> str:
    """Return what to do about a name of an argument that does not exist: a model to add, or the nearest names."""
    if name in OPTIONAL:
        return f"it belongs to {OPTIONAL[name]}; add that to {OPTIONAL[name][:3]}_type"
    return nearest(name, names)


GAINS = {"feedback": ("K", "P"), "steering": ("K1", "K3")}
"""Arguments that only the control laws have, by the names of the laws in :mod:`bsk_torch.craft`."""


def unknown(title: str, name: str, names: Iterable[str]) -> str:
    """Return the message about a name of an argument that does not exist."""
    if name == "utc_init":
        return f"{title}['utc_init'] is unknown; give it in world_args: the epoch of the world is that of all satellites"
    for law, gains in GAINS.items():
        if name in gains and not {*gains} & {*names} and any({*others} & {*names} for others in GAINS.values()):
            other = next(other for other in GAINS if other != law)
            return f"{title}[{name!r}] is unknown: a gain of law={law!r}; functions of craft take law={other!r} for this fsw_type"
    return f"{title}[{name!r}] is unknown; {hint(str(name), names)}"


def is_function(value: object) -> bool:
    """Return whether a value is a user function, called for each episode."""
    return callable(value) and not isinstance(value, Distribution)


def _called(function: Callable[[], object], title: str) -> dict[str, object]:
    answer = function()
    if not isinstance(answer, Mapping):
        raise TypeError(f"the function {title} returned {answer!r}; it must return a dictionary of arguments, {{name: value}}")
    values = {name: value() if is_function(value) else value for name, value in answer.items()}
    return no_gradient(title, values)


def expand(arguments: Mapping[str, object] | Callable[[], Mapping[str, object]] | None, title: str) -> dict[str, Any]:
    """Return given arguments by name; a function is called once to learn the names that it sets.

    Raises:
        TypeError: For anything but a dictionary or a function that returns one.
        ValueError: For a tensor that requires a gradient.
    """
    if arguments is None:
        return {}
    if isinstance(arguments, Mapping):
        return {name: no_gradient(f"{title}[{name!r}]", as_value(value)) for name, value in arguments.items()}
    if not is_function(arguments):
        raise TypeError(
            f"{title}={arguments!r} must be a dictionary of arguments, or a function without arguments that returns one"
        )
    with seeded(first_key(1).named(title)) as rows:
        next(rows)
        trial = _called(arguments, title)
    names = frozenset(trial)
    return {name: Member(arguments, name, value, names) for name, value in trial.items()}


class Given(dict[str, object]):
    """Given arguments; reading another one returns its default. Wrong names raise KeyError."""

    def __init__(self, arguments: Mapping[str, object], defaults: Mapping[str, object], title: str) -> None:
        """Keep the ``arguments`` arguments alongside the ``defaults`` of all; ``title`` is what the user calls the dictionary."""
        super().__init__()
        self.defaults, self.title = defaults, title
        for name, value in arguments.items():
            self[name] = value

    def __reduce__(self) -> tuple[object, ...]:
        """Pickle and copy without the table of defaults being looked up item by item."""
        return Given, (dict(self), self.defaults, self.title)

    def __setitem__(self, name: str, value: object) -> None:
        if name not in self.defaults:
            raise KeyError(unknown(self.title, name, self.defaults))
        super().__setitem__(name, no_gradient(f"{self.title}[{name!r}]", as_value(value)))

    def __missing__(self, name: str) -> object:
        if name not in self.defaults:
            raise KeyError(unknown(self.title, name, self.defaults))
        return self.defaults[name]
