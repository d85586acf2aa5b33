"""A target as an object, which bsk_rl's users write and people read; environments hold tensors instead."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


class Target:
    """A point on the ground and its worth.

    Further attributes may be set. Those that are numbers, or arrays of numbers of one shape, are drawn values of the episodes:
    see :meth:`bsk_torch.scene.TargetScenario.target_attribute`.

    Attributes:
        name: Name, which need not be unique.
        r_LP_P: Earth-fixed position, [3] m.
        priority: Worth.
    """

    def __init__(self, name: str, r_LP_P: Sequence[float] | np.ndarray, priority: float) -> None:
        """See the attributes."""
        self.name, self.r_LP_P, self.priority = name, np.asarray(r_LP_P, dtype=float), priority

    _place: tuple[int, int] | None = None
    """Environment and index, of targets of an environment, by which they are compared."""

    def __eq__(self, other: object) -> bool:
        """Whether both are the same target of the same environment; targets of no environment are compared by identity."""
        return self is other if self._place is None else getattr(other, "_place", None) == self._place

    def __hash__(self) -> int:
        """Agree with equality."""
        return id(self) if self._place is None else hash(self._place)

    @property
    def id(self) -> str:
        """Name and number of the object: unique."""
        return f"{self.name}_{id(self)}"

    def __repr__(self) -> str:
        """Return the name in parentheses."""
        return f"{type(self).__name__}({self.name})"
