"""Base of all scenarios."""

from __future__ import annotations

from typing import TYPE_CHECKING

from torch import Tensor

if TYPE_CHECKING:
    from bsk_torch.rand import Key
    from bsk_torch.sim.fleet import Fleet


class Scenario:
    """What is asked of the satellites. The base class asks for nothing.

    What differs between episodes comes from :meth:`draw` and from the time, and from nothing else: a scenario keeps no state of
    its own. So environments can prepare, save and restore episodes without asking it.
    """

    @property
    def calls_user(self) -> bool:
        """Whether :meth:`draw` calls functions of the user, which should be asked only for episodes that begin now."""
        return False

    def draw(self, key: Key) -> dict[str, Tensor]:
        """What the episodes of the key's environments depend on, by name: float64 tensors [n or 1, ...] on the CPU.

        The environment keeps them with leading dimension N, once for all satellites of an episode; names must differ from those
        of ``sat_args`` and ``world_args``. Draw with ``key.named(...)``; see :class:`bsk_torch.rand.Key`.
        """
        return {}

    def link(self, fleet: Fleet) -> None:
        """Called once, when the environment is built, with its satellites; raises where they do not fit."""

    def reset(self, rows: Tensor) -> None:
        """Called after what was drawn for the episodes ``rows``, indices [n], has changed: at a reset, or at a restored state."""

    def after_step(self, sim_time: Tensor) -> None:
        """Move on to ``sim_time`` [N] s, after the reward of a step and before the next observation."""
