"""Descriptions of reaction wheels: :class:`Wheel`, and the types that Basilisk's rwFactory knows by name."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields

from bsk_torch._checks import number, vector
from bsk_torch.constants import RPM
from bsk_torch.sim.names import nearest


@dataclass(frozen=True)
class WheelType:
    """Numbers of a kind of reaction wheel.

    Attributes:
        maxMomentum: Momentum at the largest speed, N m s; one for each version.
        Omega_max: Largest speed, rpm.
        u_max: Largest motor torque, N m.
        u_min: Smallest motor torque, N m, with ``useMinTorque``.
        fCoulomb: Coulomb friction, N m, with ``useRWfriction``.
    """

    maxMomentum: tuple[float, ...]
    Omega_max: float
    u_max: float
    u_min: float
    fCoulomb: float


WHEEL_TYPES: dict[str, WheelType] = {
    "Honeywell_HR16": WheelType((100.0, 75.0, 50.0), 6000.0, 0.2, 1e-5, 5e-4),
    "Honeywell_HR14": WheelType((75.0, 50.0, 25.0), 6000.0, 0.2, 1e-5, 5e-4),
    "Honeywell_HR12": WheelType((50.0, 25.0, 12.0), 6000.0, 0.2, 1e-5, 5e-4),
    "BCT_RWP015": WheelType((0.015,), 6000.0, 0.004, 1e-5, 5e-5),
    "NanoAvionics_RW0": WheelType((0.02,), 6500.0, 0.0032, 4.923e-5, 5e-5),
}
"""Types of wheels by name: those of Basilisk's rwFactory. Programs may add others."""

CUSTOM = "custom"  # type of a wheel all of whose numbers are given

POSITIVE = ("maxMomentum", "Js", "Omega_max")


@dataclass(frozen=True)
class Wheel:
    """A balanced reaction wheel, with the arguments of Basilisk's ``rwFactory().create``.

    Raises:
        ValueError: For an unknown type, a number that is missing or not allowed, or an axis without direction.

    Attributes:
        type: A name in :data:`WHEEL_TYPES`, or ``"custom"``.
        axis: Spin axis in B, of any length.
        maxMomentum: Momentum at the largest speed, N m s; needed for types with several versions. ``Js`` follows from it.
        Js: Inertia about the spin axis, kg m^2, of a custom wheel, instead of ``maxMomentum``.
        Omega_max: Largest speed, rpm, from which on the wheel can only brake.
        u_max: Largest motor torque, N m; not positive for no limit.
        u_min: Smallest motor torque, N m; smaller commands become 0.
        P_max: Largest mechanical power, W; not positive for no limit.
        fCoulomb: Coulomb friction, N m.
        fStatic: Static friction, N m, of a wheel that starts from rest, see ``betaStatic``.
        betaStatic: Stribeck friction coefficient, rad/s; not positive without.
        cViscous: Viscous friction, N m s.
        useRWfriction: Whether the type's Coulomb friction acts; without it, ``fCoulomb`` is 0.
        useMinTorque: Whether the type's smallest torque acts; without it, ``u_min`` is 0.
        useMaxTorque: Whether the largest torque limits.
    """

    type: str
    axis: Sequence[float]
    maxMomentum: float | None = None
    Js: float | None = None
    Omega_max: float | None = None
    u_max: float | None = None
    u_min: float | None = None
    P_max: float = -1.0
    fCoulomb: float | None = None
    fStatic: float = 0.0
    betaStatic: float = -1.0
    cViscous: float = 0.0
    useRWfriction: bool = False
    useMinTorque: bool = False
    useMaxTorque: bool = True

    def __post_init__(self) -> None:
        if self.type not in (*WHEEL_TYPES, CUSTOM):
            raise ValueError(f"Wheel(type={self.type!r}) is unknown; {nearest(str(self.type), (*WHEEL_TYPES, CUSTOM))}")
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name not in ("type", "axis") and value is not None and not isinstance(value, bool):
                title, lowest = f"Wheel({self.type!r}): {field.name}", 0.0 if field.name in POSITIVE else -math.inf
                number(title, value, lowest, above=field.name in POSITIVE)
        object.__setattr__(self, "axis", vector(f"Wheel({self.type!r}): axis", self.axis))
        for name in ("Js", "Omega_max", "u_max"):
            if self._known(name) is None and not (name == "u_max" and not self.useMaxTorque):
                needed = "maxMomentum or Js" if name == "Js" else name
                versions = f", one of {list(WHEEL_TYPES[self.type].maxMomentum)} N m s" if self.type in WHEEL_TYPES else ""
                raise ValueError(f"Wheel({self.type!r}) needs {needed}{versions}")

    def _known(self, name: str) -> float | None:
        """Return a number that is given, or follows from the type; None for one that is missing."""
        if name == "Js":
            return self._inertia()
        value: float | None = getattr(self, name)
        if value is not None or self.type == CUSTOM:
            return value
        return float(getattr(WHEEL_TYPES[self.type], name))

    def _inertia(self) -> float | None:
        momentum = self.maxMomentum
        if self.type != CUSTOM:
            versions = WHEEL_TYPES[self.type].maxMomentum
            if self.Js is not None:
                raise ValueError(f"Wheel({self.type!r}): Js={self.Js:g} is for type 'custom'; give maxMomentum of {versions}")
            if momentum is None and len(versions) == 1:
                momentum = versions[0]
            if momentum is not None and momentum not in versions:
                raise ValueError(f"Wheel({self.type!r}): maxMomentum={momentum:g} N m s must be one of {list(versions)}")
        if self.Js is not None and momentum is not None:
            raise ValueError(f"Wheel({self.type!r}) has Js={self.Js:g} and maxMomentum={momentum:g}; give one of them")
        speed = self._known("Omega_max")
        return self.Js if momentum is None or speed is None else momentum / (speed * RPM)

    @property
    def arguments(self) -> dict[str, float | tuple[float, ...]]:
        """Its numbers by the names of ``sat_args``, as Basilisk's factory sets them."""
        size = math.hypot(*self.axis)
        friction = self._known("fCoulomb") if self.useRWfriction else 0.0
        least = self._known("u_min") if self.useMinTorque else 0.0
        values = {
            "rwAxes_B": tuple(x / size for x in self.axis),
            "rwJs": self._known("Js"),
            "rwOmegaMax": self._known("Omega_max"),
            "u_max": self._known("u_max") if self.useMaxTorque else -1.0,
            "rwUMin": least or 0.0,
            "rwPMax": self.P_max,
            "rwFCoulomb": friction or 0.0,
            "rwFStatic": self.fStatic,
            "rwBetaStatic": self.betaStatic,
            "rwCViscous": self.cViscous,
        }
        return {name: value for name, value in values.items() if value is not None}


def pyramid(height: float, count: int = 4) -> list[tuple[float, float, float]]:
    """Return axes of wheels on a pyramid about the third axis of B: ``(cos a, sin a, height)``, evenly from 45 degrees on.

    Args:
        height: Third component, for horizontal ones of length one.
        count: Number of wheels.
    """
    angles = [math.pi / 4.0 + 2.0 * math.pi * k / count for k in range(count)]
    return [(math.cos(a), math.sin(a), height) for a in angles]


TRIAD = tuple(Wheel("Honeywell_HR16", tuple(float(k == j) for j in range(3)), maxMomentum=50.0) for k in range(3))
"""The three default wheels."""
