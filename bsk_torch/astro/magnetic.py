"""The Earth's magnetic field as a centered dipole, as in Basilisk's module magneticFieldCenteredDipole."""

from __future__ import annotations

from bsk_torch.vec3 import Scalar, Vec3


def dipole_field(r_P: Vec3, dipole_P: Vec3, radius: Scalar) -> Vec3:
    """Return the magnetic field, T, in Earth-fixed axes.

    ``B = (R / |r|)^3 (3 (r^ . g) r^ - g)`` with ``g = (g11, h11, g10)``, the coefficients of degree one of the International
    Geomagnetic Reference Field (Alken et al., "International Geomagnetic Reference Field: the thirteenth generation", Earth,
    Planets and Space 73:49, 2021).

    Args:
        r_P: Position, m, from the Earth's center.
        dipole_P: g, T.
        radius: R, m.
    """
    distance = r_P.norm()
    up = r_P / distance
    ratio = radius / distance
    return (up * (3.0 * up.dot(dipole_P)) - dipole_P) * (ratio * ratio * ratio)
