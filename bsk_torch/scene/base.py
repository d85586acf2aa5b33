"""Base of all scenarios."""

from __future__ import annotations

from typing import TYPE_CHECKING

from torch import Tensor

if TYPE_CHECKING:
    from bsk_torch.sats.satellite import Satellite


class Scenario:
    """What is asked of the satellites. The base class asks for nothing.

    Subclasses hold tensors with leading dimension N and override what they need.
    """

    def link_satellite(self, satellite: Satellite) -> None:
        """Called once, when the environment is built."""

    def reset(self, rows: Tensor) -> None:
        """Start anew for ``rows``, indices [n] of environments being reset."""

    def after_step(self, sim_time: Tensor) -> None:
        """Move on to ``sim_time`` [N] s, after the reward of a step and before the next observation."""
