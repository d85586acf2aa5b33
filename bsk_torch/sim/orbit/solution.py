"""Interface of the solvers of arcs."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import torch
from torch import Tensor

from bsk_torch.codegen.kernel import Samples


class Solution(NamedTuple):
    """Positions in N, m, and the values needed to continue from the arcs' ends, [n, T].

    Those of the flown arc lie a minute apart, those of the planned arc 30 s.
    """

    flown: Tensor
    planned: Tensor
    tail: Tensor


class Solver(Protocol):
    """Solves arcs of n satellites; ``tail`` is the number T of values needed to continue."""

    device: torch.device
    tail: int

    def begin(self, et: Tensor, r: Tensor, v: Tensor, ephemeris: Tensor, nodes: int) -> Solution:
        """Both arcs from the epoch on.

        Args:
            et: ET at the epoch, [n].
            r: Position in N, [n, 3] m.
            v: Velocity in N, [n, 3] m/s.
            ephemeris: Records [n, H, 16] of Sun and Earth from the epoch on.
            nodes: Number of nodes, a minute apart: whole hours and one.

        Returns:
            Positions [n, LEAD_NODES + nodes, 3], planned ones [n, 2 nodes - 1, 3] from the epoch on.
        """

    def extend(self, et: Tensor, tail: Tensor, start: Tensor, ephemeris: Tensor, flown: Tensor) -> Solution:
        """The next hour.

        Args:
            et: ET at the epoch, [n].
            tail: What the last call left, [n, T].
            start: Time of the first node and of the first record of the ephemeris, [n] s since the epoch.
            ephemeris: Records [n, H, 16] of Sun and Earth.
            flown: Flown nodes so far, [n, Q, 3], of which ``LEAD_NODES`` before ``start``.

        Returns:
            Flown positions with the next hour, [n, Q + 60, 3], and planned ones of that hour, [n, 120, 3].
        """

    def accelerations(self, nodes: Tensor, ephemeris: Samples) -> Tensor:
        """Return the accelerations, [n, K, 3] m/s^2 in N, at nodes of flown arcs, [n, K, 3] m, a minute apart.

        ``ephemeris`` holds the records of Sun and Earth of each arc; its times count from the first of the nodes.
        """
