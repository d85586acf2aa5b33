"""A target as an object, for reading; environments store targets as tensors."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bsk_torch._checks import number, text


class Target:
    """A point on the ground with a priority.

    Further attributes may be set. Numbers, and arrays of numbers of equal shape, become drawn values of the episodes; see
    :meth:`bsk_torch.scene.TargetScenario.target_attribute`.

    Attributes:
        name: Name, which need not be unique.
        r_LP_P: Earth-fixed position, [3] m.
        priority: Value of an image.
    """

    def __init__(self, name: str, r_LP_P: Sequence[float] | np.ndarray, priority: float) -> None:
        """See the attributes; ValueError unless position and priority are finite numbers."""
        try:
            self.r_LP_P = np.asarray(r_LP_P, dtype=float)
        except (TypeError, ValueError, OverflowError) as error:
            raise ValueError(f"r_LP_P={r_LP_P!r} must be three numbers, m: {error}") from error
        if self.r_LP_P.shape != (3,) or not np.isfinite(self.r_LP_P).all():
            raise ValueError(f"r_LP_P={r_LP_P!r} must be three finite numbers, m")
        self.name, self.priority = text("name", name), number("priority", priority)

    _place: tuple[int, int] | None = None
    """Environment and index of a target in an environment, used for comparison."""

    def __eq__(self, other: object) -> bool:
        return self is other if self._place is None else getattr(other, "_place", None) == self._place

    def __hash__(self) -> int:
        return id(self) if self._place is None else hash(self._place)

    @property
    def id(self) -> str:
        """Name and number of the object: unique."""
        return f"{self.name}_{id(self)}"

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.name})"
