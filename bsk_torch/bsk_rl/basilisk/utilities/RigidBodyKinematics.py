"""Conversions between representations of an attitude, with Basilisk's names: ``MRP2C``, ``C2EP``, ``euler3212MRP``.

There is every conversion ``A2B`` between these: direction cosine matrices ``C`` [3, 3], Euler parameters ``EP`` [4], scalar
first, MRPs ``MRP`` [3], principal rotation vectors ``PRV`` [3], Gibbs vectors [3] (``gibbs2B``, ``A2Gibbs``) and Euler
angles of the twelve sequences [3] (``euler3212B``, ``A2Euler321``). Angles are in radians, first and third angles found in
[-pi, pi]; results are arrays. The matrix of an attitude sigma_BN is [BN], which takes components in N to components in B.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from bsk_torch.sim.names import nearest

M_PI = math.pi

Convert = Callable[[ArrayLike], np.ndarray]


def v3Tilde(vector: ArrayLike) -> np.ndarray:
    """Return the matrix [3, 3] of the cross product with a vector [3]."""
    x, y, z = np.asarray(vector, dtype=float).reshape(3)
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def MRPswitch(q: ArrayLike, s2: float) -> np.ndarray:
    """Return the shadow set of MRPs [3] whose squared norm exceeds ``s2``, and others unchanged."""
    sigma = np.asarray(q, dtype=float)
    square = sigma @ sigma
    return -sigma / square if square > s2 else sigma


def MRP2EP(q1: ArrayLike) -> np.ndarray:
    """Return Euler parameters [4] of MRPs [3]; the scalar is negative for MRPs longer than one."""
    sigma = np.asarray(q1, dtype=float).reshape(3)
    square = sigma @ sigma
    return np.concatenate(([1.0 - square], 2.0 * sigma)) / (1.0 + square)


def EP2MRP(q1: ArrayLike) -> np.ndarray:
    """Return MRPs [3] of Euler parameters [4], of norm one at most."""
    q = np.asarray(q1, dtype=float).reshape(4)
    q = -q if q[0] < 0.0 else q
    return q[1:] / (1.0 + q[0])


def addEP(b1: ArrayLike, b2: ArrayLike) -> np.ndarray:
    """Return Euler parameters [4] of the rotation ``b1`` followed by ``b2``."""
    (p, *u), (q, *v) = np.asarray(b1, dtype=float), np.asarray(b2, dtype=float)
    return np.concatenate(([q * p - np.dot(v, u)], q * np.asarray(u) + p * np.asarray(v) - np.cross(v, u)))


def subEP(b1: ArrayLike, b2: ArrayLike) -> np.ndarray:
    """Return Euler parameters [4] of the rotation that leads from ``b2`` to ``b1``."""
    return addEP(np.asarray(b2, dtype=float) * [1.0, -1.0, -1.0, -1.0], b1)


def addMRP(q1: ArrayLike, q2: ArrayLike) -> np.ndarray:
    """Return MRPs [3], of norm one at most, of the rotation ``q1`` followed by ``q2``."""
    return EP2MRP(addEP(MRP2EP(q1), MRP2EP(q2)))


def subMRP(q1: ArrayLike, q2: ArrayLike) -> np.ndarray:
    """Return MRPs [3], of norm one at most, of the rotation that leads from ``q2`` to ``q1``."""
    return EP2MRP(subEP(MRP2EP(q1), MRP2EP(q2)))


def BmatMRP(q: ArrayLike) -> np.ndarray:
    """Return the matrix [3, 3] that takes a rate omega_BN_B to four times the derivative of MRPs [3]."""
    sigma = np.asarray(q, dtype=float).reshape(3)
    return (1.0 - sigma @ sigma) * np.eye(3) + 2.0 * v3Tilde(sigma) + 2.0 * np.outer(sigma, sigma)


def BinvMRP(q: ArrayLike) -> np.ndarray:
    """Return the inverse [3, 3] of :func:`BmatMRP`."""
    sigma = np.asarray(q, dtype=float)
    return BmatMRP(sigma).T / (1.0 + sigma @ sigma) ** 2


def dMRP(q: ArrayLike, w: ArrayLike) -> np.ndarray:
    """Return the derivative, 1/s [3], of MRPs [3] under a rate omega_BN_B, rad/s [3]."""
    return 0.25 * BmatMRP(q) @ np.asarray(w, dtype=float)


def dMRP2Omega(q: ArrayLike, dq: ArrayLike) -> np.ndarray:
    """Return the rate omega_BN_B, rad/s [3], of MRPs [3] and their derivative, 1/s [3]."""
    return 4.0 * BinvMRP(q) @ np.asarray(dq, dtype=float)


def EP2C(q: ArrayLike) -> np.ndarray:
    """Return the direction cosine matrix [3, 3] of Euler parameters [4]."""
    scalar, *vector = np.asarray(q, dtype=float).reshape(4)
    return Rotation.from_quat([*vector, scalar]).as_matrix().T


def C2EP(C: ArrayLike) -> np.ndarray:
    """Return Euler parameters [4], with a scalar that is not negative, of a direction cosine matrix [3, 3]."""
    x, y, z, w = Rotation.from_matrix(np.asarray(C, dtype=float).T).as_quat(canonical=True)
    return np.array([w, x, y, z])


def _gibbs2EP(vector: ArrayLike) -> np.ndarray:
    q = np.asarray(vector, dtype=float).reshape(3)
    return np.concatenate(([1.0], q)) / math.sqrt(1.0 + q @ q)


def _EP2PRV(q: ArrayLike) -> np.ndarray:
    scalar, *vector = np.asarray(q, dtype=float).reshape(4)
    sine = math.hypot(*vector)
    return np.asarray(vector) * (2.0 * math.atan2(sine, scalar) / sine if sine > 0.0 else 2.0)


def _PRV2EP(vector: ArrayLike) -> np.ndarray:
    rotation = np.asarray(vector, dtype=float).reshape(3)
    angle = math.hypot(*rotation)
    return np.concatenate(([math.cos(angle / 2.0)], 0.5 * np.sinc(angle / (2.0 * math.pi)) * rotation))


def _angles(sequence: str) -> tuple[Convert, Convert]:
    """Return the conversions of Euler angles of a sequence such as ``"321"`` to and from Euler parameters."""
    axes = [int(axis) - 1 for axis in sequence]

    def given(angles: ArrayLike) -> np.ndarray:
        first, second, third = (
            _PRV2EP(angle * np.eye(3)[axis]) for axis, angle in zip(axes, np.asarray(angles, dtype=float), strict=True)
        )
        return addEP(addEP(first, second), third)

    def found(q: ArrayLike) -> np.ndarray:
        return Rotation.from_matrix(EP2C(q).T).as_euler("".join("XYZ"[axis] for axis in axes))

    return given, found


SEQUENCES = ["".join(s) for s in itertools.product("123", repeat=3) if s[0] != s[1] != s[2]]
"""The twelve sequences of Euler angles."""


def _gibbs(q: ArrayLike) -> np.ndarray:
    scalar, *vector = np.asarray(q, dtype=float)
    return np.asarray(vector) / scalar


def _as_array(q: ArrayLike) -> np.ndarray:
    return np.array(q, dtype=float)


TO_EP: dict[str, Convert] = {"EP": _as_array, "C": C2EP, "MRP": MRP2EP, "PRV": _PRV2EP, "gibbs": _gibbs2EP}
"""Conversions to Euler parameters by the first name in ``A2B``."""

FROM_EP: dict[str, Convert] = {"EP": _as_array, "C": EP2C, "MRP": EP2MRP, "PRV": _EP2PRV, "Gibbs": _gibbs}
"""Conversions from Euler parameters by the second name in ``A2B``."""

for _sequence in SEQUENCES:
    TO_EP[f"euler{_sequence}"], FROM_EP[f"Euler{_sequence}"] = _angles(_sequence)

CONVERSIONS = {f"{a}2{b}": (TO_EP[a], FROM_EP[b]) for a in TO_EP for b in FROM_EP if a.lower() != b.lower()}


def __getattr__(name: str) -> Convert:
    if name not in CONVERSIONS:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}; {nearest(name, __dir__())}")
    first, second = CONVERSIONS[name]

    def convert(attitude: ArrayLike) -> np.ndarray:
        return second(first(attitude))

    convert.__name__ = convert.__qualname__ = name
    return convert


def __dir__() -> Sequence[str]:
    return [name for name in globals() if name[0] != "_" and name[0].isalpha()] + list(CONVERSIONS)
