"""Interface of the solvers of arcs."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import torch
from torch import Tensor

from bsk_torch.astro.earth_rotation import Earth
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
    earth: Earth  # model of the Earth's rotation

    def begin(self, et: Tensor, r: Tensor, v: Tensor, ephemeris: Tensor, nodes: int) -> Solution:
        """Both arcs from the epoch on: positions [n, LEAD_NODES + nodes, 3], and planned ones [n, 2 nodes - 1, 3].

        ET at the epoch is [n], position and velocity in N are [n, 3], m and m/s, and records of Sun and Earth from the epoch on
        [n, H, 16]; nodes lie a minute apart: whole hours and one.
        """

    def extend(self, et: Tensor, tail: Tensor, start: Tensor, ephemeris: Tensor, flown: Tensor) -> Solution:
        """The next hour: flown positions with it, [n, Q + 60, 3], and planned ones of that hour, [n, 120, 3].

        ``tail`` [n, T] is what the last call left, ``start`` [n] the time of the first node and of the first record [n, H, 16]
        of Sun and Earth, s since the epoch, and ``flown`` [n, Q, 3] are the nodes so far, of which ``LEAD_NODES`` before
        ``start``.
        """

    def accelerations(self, nodes: Tensor, ephemeris: Samples) -> Tensor:
        """Return the accelerations, [n, K, 3] m/s^2 in N, at nodes of flown arcs, [n, K, 3] m, a minute apart.

        ``ephemeris`` holds the records of Sun and Earth of each arc; its times count from the first of the nodes.
        """
