"""Common faults. Further keyword arguments of all of them are those of Fault: ``at``, ``lasts``, ``over`` and ``name``."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from bsk_torch.sim.faults.declared import Fault

NOTHING = 1e-12  # limit of a torque, N m, or thrust, N, that is lost: zero would mean that there is no limit


def _named(title: str, part: int | str | None, given: dict[str, object]) -> dict[str, Any]:
    return {"name": title if part is None else f"{title}{'_' * isinstance(part, str)}{part}"} | given


def wheel_torque(wheel: int | None = None, torque: object = NOTHING, **given: object) -> Fault:
    """Return the fault of a wheel whose motor gives at most ``torque``, N m; by default it is lost. None: all wheels."""
    return Fault("u_max", value=torque, index=wheel, **_named("wheel_torque", wheel, given))


def wheel_power(wheel: int | None = None, power: object = 1.0, **given: object) -> Fault:
    """Return the fault of a wheel whose mechanical power is at most ``power``, W."""
    return Fault("rwPMax", value=power, index=wheel, **_named("wheel_power", wheel, given))


def wheel_friction(wheel: int | None = None, coulomb: object = 2e-3, viscous: object = 1e-5, **given: object) -> Fault:
    """Return the fault of a wheel with Coulomb friction, N m, and viscous friction, N m s; ``over`` lets both grow."""
    names = ("rwFCoulomb", "rwCViscous")
    return Fault(names, value=(coulomb, viscous), index=wheel, **_named("wheel_friction", wheel, given))


def wheel_unavailable(wheel: int, **given: object) -> Fault:
    """Return the fault of a wheel that the flight software no longer commands; the wheel itself keeps turning."""
    return Fault("rwAvailable", value=0.0, index=wheel, **_named("wheel_unavailable", wheel, given))


def panel(share: object = 0.0, panel: int | None = None, **given: object) -> Fault:
    """Return the fault of solar panels, or of one of several ``panels``, that give only a share of their power."""
    return Fault("panelEfficiency", factor=share, index=panel, **_named("panel", panel, given))


def stuck_panel(normal: Sequence[float] | object = None, panel: int | None = None, **given: object) -> Fault:
    """Return the fault of a panel that no longer points where the flight software expects it.

    Args:
        normal: Normal in B of the default panel, or of a fixed one of several ``panels``, from then on; the flight software
            points the usual direction to the Sun. None for a panel that turns: it stays where it is.
        panel: Number of the panel among ``panels``; None for the single one.
        **given: Further arguments of Fault.

    Raises:
        ValueError: For the normal zero, and for neither a normal nor a panel.
    """
    named = _named("stuck_panel", panel, given)
    if normal is None:
        if panel is None:
            raise ValueError("faults.stuck_panel needs a normal in B, or the number panel= of a panel that turns and shall stop")
        return Fault("panelRates", value=0.0, index=panel, **{"only": "panel"} | named)
    if isinstance(normal, Sequence) and not any(normal):
        raise ValueError(f"faults.stuck_panel: normal={normal!r} must be three numbers, not all zero, such as [0, 0, 1]")
    argument = "nHat_B" if panel is None else "panelNormals_B"
    return Fault(argument, value=normal, index=panel, **{"only": "panel"} | named)


def transmitter(share: object = 0.0, **given: object) -> Fault:
    """Return the fault of a transmitter with a share of its data rate; its power is drawn all the same."""
    return Fault("transmitterBaudRate", factor=share, **_named("transmitter", None, given))


def instrument(share: object = 0.0, instrument: str | None = None, **given: object) -> Fault:
    """Return the fault of an instrument with a share of its data rate; its power is drawn all the same.

    Of several ``instruments``, ``instrument`` names one that has its own ``instrumentBaudRate``.
    """
    name = "instrumentBaudRate" if instrument is None else f"instruments.{instrument}.instrumentBaudRate"
    return Fault(name, factor=share, **{"only": "instrument"} | _named("instrument", instrument, given))


def battery(share: object, **given: object) -> Fault:
    """Return the fault of a battery that holds a share of its capacity; charges are still compared with all of it."""
    return Fault("batteryStorageCapacity", factor=share, **{"only": "battery"} | _named("battery", None, given))


def thruster(thruster: int, thrust: object = NOTHING, **given: object) -> Fault:
    """Return the fault of a thruster with another thrust, N, by default none; the flight software does not know of it."""
    return Fault("thrusterMaxThrust", value=thrust, index=thruster, **{"only": "thrusters"} | _named("thruster", thruster, given))


def navigation(bias: object = None, noise: object = None, **given: object) -> Fault:
    """Return the fault of a navigation with constant errors, or with more noise; for ``dyn.NavigationErrorsDynModel``.

    Args:
        bias: Constant errors, 18 numbers, such as ``dyn.navigation_numbers(attitude=1e-3)``; ``over`` lets them grow.
        noise: Factor of the standard deviations in ``PMatrix``.
        **given: See the module.

    Raises:
        ValueError: For both, or neither; two faults have both.
    """
    if (bias is None) == (noise is None):
        raise ValueError(f"faults.navigation has bias={bias!r} and noise={noise!r}; give one of them, or declare two faults")
    if bias is not None:
        return Fault("navigationBias", value=bias, **_named("navigation", None, given))
    return Fault("navigationNoise", value=noise, **_named("navigation", None, given))


READY: dict[str, Callable[..., Fault]] = {
    function.__name__: function
    for function in (
        wheel_torque,
        wheel_power,
        wheel_friction,
        wheel_unavailable,
        panel,
        stuck_panel,
        transmitter,
        instrument,
        battery,
        thruster,
        navigation,
    )
}
"""The functions of this module by name."""
