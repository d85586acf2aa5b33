"""Initial speeds of reaction wheels; counterpart of ``bsk_rl.utils.actuator_primitives``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NoReturn

import numpy as np


class WheelTriad(Sequence[object]):
    """Three entries, of which the last are wheel speeds, rpm; reading the others, Basilisk's objects, raises TypeError."""

    def __init__(self, speeds: object) -> None:
        self.speeds = speeds

    def __len__(self) -> int:
        return 3

    def __getitem__(self, index: object) -> Any:
        """Return the speeds for 2 or -1."""
        if index in (2, -1):
            return self.speeds
        raise TypeError(
            "balancedHR16Triad(...)[0] and [1] are Basilisk's wheel effector and factory; dyn.BasicDynamicsModel has three "
            "wheels of this kind. Write sat_args=dict(wheelSpeeds=balancedHR16Triad(...)[2])"
        )


def balancedHR16Triad(
    useRandom: bool = False,
    randomBounds: tuple[float, float] = (-400, 400),
    wheelSpeeds: Sequence[float] = (500, 500, 500),
) -> WheelTriad:
    """Return initial speeds of three wheels, rpm, as the last of three entries.

    Args:
        useRandom: Whether they are drawn, uniform within ``randomBounds``, from NumPy's global generator.
        randomBounds: Bounds, rpm.
        wheelSpeeds: Those that are not drawn, rpm.
    """
    return WheelTriad(np.random.uniform(randomBounds[0], randomBounds[1], 3) if useRandom else list(wheelSpeeds))


def idealMonarc1Octet() -> NoReturn:
    """Raise ImportError: the eight thrusters are part of the simulation."""
    raise ImportError(
        "idealMonarc1Octet makes thrusters for Basilisk; dyn.BasicDynamicsModel has these eight, which act.Desat fires"
    )
