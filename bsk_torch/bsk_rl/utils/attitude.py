"""Initial attitudes and spins; counterpart of ``bsk_rl.utils.attitude``; random ones come from NumPy's global generator."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from bsk_torch.astro.relative import aligned_with_hill, rv2HN
from bsk_torch.initial import AXES, SPIN
from bsk_torch.sim.component import UserArguments


def random_tumble(maxSpinRate: float = 0.001) -> tuple[np.ndarray, np.ndarray]:
    """Return an attitude sigma_BN [3], MRPs in [0, 1), and a rate omega_BN_B [3] of components up to ``maxSpinRate``, rad/s."""
    sigma_BN = np.random.uniform(0, 1.0, [3])
    return sigma_BN, np.random.uniform(-maxSpinRate, maxSpinRate, [3])


def hill_frame_attitude(
    r_N: Iterable[float], v_N: Iterable[float], spin_config: Mapping[str, object] | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Return attitude sigma_BN [3] and rate omega_BN_B [3], rad/s, of a spinning body aligned with the Hill frame.

    Args:
        r_N: Position, m [3].
        v_N: Velocity, m/s [3].
        spin_config: ``type`` ``"fixed"`` with ``rate``, or ``"uniform"`` with ``low`` and ``high``, degrees per second; ``axis``
            ``"radial"``, ``"tangential"``, ``"normal"``, ``"velocity"``, ``"random"``, or a vector in the Hill frame. No spin
            unless given.

    Raises:
        ValueError: For vectors of another shape, an orbit without Hill frame, or a wrong spin.
    """
    r, v = np.asarray(r_N, dtype=float), np.asarray(v_N, dtype=float)
    if r.shape != (3,) or v.shape != (3,):
        raise ValueError(f"r_N and v_N have shapes {r.shape} and {v.shape}; both must be three-element vectors")
    if np.isclose(np.linalg.norm(r), 0.0) or np.isclose(np.linalg.norm(np.cross(r, v)), 0.0):
        raise ValueError("r_N and v_N must span a Hill frame; they are zero or parallel")
    spin = {**SPIN, **(spin_config or {})}
    if unknown := set(spin) - {"type", "rate", "low", "high", "axis"}:
        raise ValueError(f"spin_config has unknown entries {sorted(unknown)}; there are type, rate, low, high and axis")
    rate = _rate(spin)  # drawn before the axis, as in bsk_rl
    axis = _axis(spin["axis"], r, v)
    sigma, hill_rate, _ = aligned_with_hill(r, v)
    return sigma.numpy(), hill_rate.numpy() + np.radians(rate) * axis


def _rate(spin: UserArguments) -> float:
    if spin["type"] == "fixed":
        return float(spin["rate"])
    if spin["type"] != "uniform":
        raise ValueError(f"Unknown spin type {spin['type']!r}; it must be 'fixed' or 'uniform'")
    if not ("low" in spin and "high" in spin and spin["low"] <= spin["high"]):
        raise ValueError(f"spin_config={dict(spin)} needs 'low' <= 'high', degrees per second")
    return float(np.random.uniform(spin["low"], spin["high"]))


def _axis(axis: object, r: np.ndarray, v: np.ndarray) -> np.ndarray:
    if isinstance(axis, str):
        if axis == "random":
            axis = np.random.normal(size=3)
        elif axis == "velocity":
            axis = rv2HN(r, v) @ v
        elif axis in AXES:
            axis = AXES[axis]
        else:
            raise ValueError(f"Unknown spin axis {axis!r}; it must be one of {[*AXES, 'velocity', 'random']}, or three numbers")
    vector = np.asarray(axis, dtype=float)
    if vector.shape != (3,) or np.isclose(np.linalg.norm(vector), 0.0):
        raise ValueError(f"spin_config['axis']={axis!r} must be a nonzero vector of three numbers")
    return vector / np.linalg.norm(vector)
