"""Vectors and matrices whose components are separate tensors.

Inside the simulation a vector is three tensors of one shape, not one tensor with a trailing three: the compiler then fuses
a whole tick into a single loop over the batch. The operators keep equations readable: ``omega_BR_B = omega_BN_B - omega_RN_B``
and ``r_P = PN @ r_N``. A scalar is always on the right of ``*``.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

import torch
from torch import Tensor

__all__ = ["Mat3", "Vec3", "only", "select", "times"]

T = TypeVar("T")

Scalar = Tensor | float
"""A factor: a tensor that broadcasts with the components, or a number."""


class Vec3(NamedTuple):
    """A vector of three equally shaped tensors."""

    x: Tensor
    y: Tensor
    z: Tensor

    def __add__(self, other: Vec3) -> Vec3:  # type: ignore[override]
        """Sum of two vectors."""
        return Vec3(self.x + other.x, self.y + other.y, self.z + other.z)

    def __sub__(self, other: Vec3) -> Vec3:
        """Difference of two vectors."""
        return Vec3(self.x - other.x, self.y - other.y, self.z - other.z)

    def __neg__(self) -> Vec3:
        """Opposite vector."""
        return Vec3(-self.x, -self.y, -self.z)

    def __mul__(self, factor: Scalar) -> Vec3:  # type: ignore[override]
        """Vector times scalar."""
        return Vec3(self.x * factor, self.y * factor, self.z * factor)

    def __truediv__(self, divisor: Scalar) -> Vec3:
        """Vector over scalar."""
        return self * (1.0 / divisor)

    def scale(self, other: Vec3) -> Vec3:
        """Product component by component, as of a diagonal matrix with a vector."""
        return Vec3(self.x * other.x, self.y * other.y, self.z * other.z)

    def dot(self, other: Vec3) -> Tensor:
        """Scalar product."""
        return self.x * other.x + self.y * other.y + self.z * other.z

    def cross(self, other: Vec3) -> Vec3:
        """Vector product."""
        return Vec3(
            self.y * other.z - self.z * other.y,
            self.z * other.x - self.x * other.z,
            self.x * other.y - self.y * other.x,
        )

    def norm(self) -> Tensor:
        """Euclidean length."""
        return torch.sqrt(self.dot(self))

    def unit(self) -> Vec3:
        """Vector of length one; NaN for the zero vector."""
        return self / self.norm()

    def map(self, function: Callable[..., Tensor], *others: Vec3) -> Vec3:
        """Apply ``function`` to each component (and to those of ``others`` alongside it)."""
        return Vec3(*map(function, self, *others))

    def to(self, dtype: torch.dtype) -> Vec3:
        """The vector in another type."""
        return Vec3(self.x.to(dtype), self.y.to(dtype), self.z.to(dtype))

    def stack(self) -> Tensor:
        """The vector as one tensor ``[..., 3]``."""
        return torch.stack((self.x, self.y, self.z), -1)

    @staticmethod
    def of(tensor: Tensor) -> Vec3:
        """The vector from one tensor ``[..., 3]``."""
        return Vec3(*tensor.unbind(-1))

    @staticmethod
    def zeros_like(component: Tensor) -> Vec3:
        """The zero vector, shaped like ``component``."""
        zero = torch.zeros_like(component)
        return Vec3(zero, zero, zero)


class Mat3(NamedTuple):
    """A 3 x 3 matrix of three row vectors; ``XY`` maps Y components to X components."""

    x: Vec3
    y: Vec3
    z: Vec3

    def __matmul__(self, v: Vec3) -> Vec3:
        """Matrix times vector."""
        return Vec3(self.x.dot(v), self.y.dot(v), self.z.dot(v))

    def __add__(self, other: Mat3) -> Mat3:  # type: ignore[override]
        """Sum of two matrices."""
        return Mat3(self.x + other.x, self.y + other.y, self.z + other.z)

    def __sub__(self, other: Mat3) -> Mat3:
        """Difference of two matrices."""
        return Mat3(self.x - other.x, self.y - other.y, self.z - other.z)

    def solve(self, v: Vec3) -> Vec3:
        """Return x with ``M x = v`` by Cramer's rule; not finite where the matrix is singular.

        ``M^-1 = [y x z, z x x, x x y] / (x . (y x z))`` of the rows x, y and z.
        """
        columns = self.y.cross(self.z), self.z.cross(self.x), self.x.cross(self.y)
        inverse = 1.0 / self.x.dot(columns[0])
        return (columns[0] * v.x + columns[1] * v.y + columns[2] * v.z) * inverse

    @staticmethod
    def diagonal(v: Vec3) -> Mat3:
        """Return the matrix with the components of ``v`` on its diagonal, zeros elsewhere."""
        zero = torch.zeros_like(v.x)
        return Mat3(Vec3(v.x, zero, zero), Vec3(zero, v.y, zero), Vec3(zero, zero, v.z))

    @staticmethod
    def outer(a: Vec3, b: Vec3) -> Mat3:
        """Return the outer product ``a b^T``."""
        return Mat3(b * a.x, b * a.y, b * a.z)

    @property
    def mT(self) -> Mat3:
        """Transposed matrix."""
        return Mat3(*map(Vec3, *self))

    def to(self, dtype: torch.dtype) -> Mat3:
        """The matrix in another type."""
        return Mat3(*(row.to(dtype) for row in self))

    def stack(self) -> Tensor:
        """The matrix as one tensor ``[..., 3, 3]``."""
        return torch.stack([row.stack() for row in self], -2)

    @staticmethod
    def of(tensor: Tensor) -> Mat3:
        """The matrix from one tensor ``[..., 3, 3]``."""
        return Mat3(*(Vec3.of(row) for row in tensor.unbind(-2)))


def select(condition: Tensor, yes: Vec3, no: Vec3) -> Vec3:
    """``yes`` where ``condition`` holds, else ``no``."""
    return Vec3(torch.where(condition, yes.x, no.x), torch.where(condition, yes.y, no.y), torch.where(condition, yes.z, no.z))


def times(matrix: Vec3 | Mat3, v: Vec3) -> Vec3:
    """Return the product of a matrix with a vector; a diagonal matrix may be given as the vector of its diagonal."""
    return matrix.scale(v) if isinstance(matrix, Vec3) else matrix @ v


def only(mask: Tensor, compute: Callable[[], T], otherwise: T) -> T:
    """``compute()`` where ``mask`` holds, else ``otherwise``; both are a tensor, a vector or a tuple of such.

    Compiled kernels skip ``compute`` where no environment of a block needs it, so ``compute`` must only compute.
    """
    if isinstance(mask, Tensor):
        return _rebuilt(otherwise, [torch.where(mask, a, b) for a, b in zip(_leaves(compute()), _leaves(otherwise), strict=True)])
    return _rebuilt(otherwise, mask.only(lambda: _leaves(compute()), _leaves(otherwise)))


def _leaves(tree: object) -> list[Any]:
    return [leaf for part in tree for leaf in _leaves(part)] if isinstance(tree, tuple) else [tree]


def _rebuilt(like: object, leaves: list[object]) -> Any:
    """Return the ``leaves``, consuming them, in the shape of ``like``."""
    if not isinstance(like, tuple):
        return leaves.pop(0)
    parts = [_rebuilt(part, leaves) for part in like]
    return type(like)(*parts) if hasattr(like, "_fields") else tuple(parts)
