"""Names of quantities that users write: hints for wrong ones, and those of earlier releases."""

from __future__ import annotations

import difflib
import warnings
from collections.abc import Iterable

RENAMED = {
    "r": "r_BN_N",
    "v": "v_BN_N",
    "sigma": "sigma_BN",
    "omega": "omega_BN_B",
    "Omega": "Omega_WB_B",
    "motor_torque": "motor_torque_B",
    "motor_torque_command": "motor_torque_command_B",
    "control_integral": "control_integral_B",
    "dump_momentum": "dump_momentum_B",
    "sun_sigma": "sun_sigma_BR",
    "location_sigma": "location_sigma_BR",
    "target_r_P": "r_LP_P",
    "target_N": "r_LN_N",
    "r_sun": "r_SN_N",
    "v_sun": "v_SN_N",
    "pole": "EN",
    "sky": "ephemeris",
    "sky_tau": "ephemeris_tau",
    "inertia": "inertia_B",
    "disturbance_torque": "disturbance_torque_B",
    "panel_normal": "panel_normal_B",
    "instrument_axis": "instrument_axis_B",
    "station_positions": "station_positions_P",
}
"""Fields of the state, parameters and messages of a tick that release 0.1 called otherwise; the old names go with 0.3."""


def current_name(name: str) -> str:
    """Return the present name of a quantity, with a DeprecationWarning for one of an earlier release."""
    if name not in RENAMED:
        return name
    warnings.warn(f"{name!r} is now called {RENAMED[name]!r}; the old name goes with release 0.3", DeprecationWarning, 3)
    return RENAMED[name]


def nearest(name: str, known: Iterable[str]) -> str:
    """Return a hint that names the valid names closest to a wrong one."""
    by_lower = {str(k).lower(): str(k) for k in known}
    close = [by_lower[k] for k in difflib.get_close_matches(name.lower(), by_lower, n=3, cutoff=0.5)]
    return f"did you mean {' or '.join(map(repr, close))}?" if close else f"valid names: {', '.join(sorted(by_lower.values()))}"
