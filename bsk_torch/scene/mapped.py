"""Scenarios of one episode, such as bsk_rl's, run for each environment of a batch."""

from __future__ import annotations

import copy
from typing import Any, Protocol

from bsk_torch.scene.target import Target
from bsk_torch.scene.uniform import UniformTargets
from bsk_torch.sim.hooks import is_of_package

NOT_CALLED = (
    "after_step", "link_satellites", "reset_during_sim_init", "reset_overwrite_previous", "reset_post_sim_init",
    "reset_pre_sim_init", "validate_satellite_names",
)  # fmt: skip
"""Hooks of scenarios of one episode that have no counterpart here."""


class OneTargets(Protocol):
    """Targets of one episode: the hook is that of ``bsk_torch.bsk_rl.scene.UniformTargets``."""

    _n_targets: Any
    n_targets: int
    radius: float
    targets: list[Any]

    def regenerate_targets(self) -> None:
        """Fill ``self.targets``."""


class PerEnvironmentTargets(UniformTargets):
    """Lets a scenario of one episode make the targets of each environment; see :func:`bsk_torch.per_environment`.

    Attributes:
        given: The scenario of one episode; a deep copy of it makes the targets of an episode.
    """

    def __init__(self, given: OneTargets) -> None:
        """Run copies of ``given``; TypeError for one with hooks that would not be called."""
        super().__init__(given._n_targets, radius=given.radius)
        own = sorted(name for name in NOT_CALLED if not is_of_package(getattr(type(given), name)))
        if own:
            raise TypeError(
                f"per_environment({type(given).__name__}(...)): {', '.join(own)} would not be called; regenerate_targets() is"
            )
        self.given = given

    def regenerate_targets(self) -> None:
        """See :meth:`UniformTargets.regenerate_targets`; attributes of targets are kept."""
        one = copy.deepcopy(self.given)
        one.targets, one.n_targets = [], self.n_targets
        one.regenerate_targets()
        self.targets = []
        for theirs in one.targets:
            target = Target(theirs.name, theirs.r_LP_P, theirs.priority)
            target.__dict__.update({name: value for name, value in vars(theirs).items() if name not in vars(target)})
            self.targets.append(target)
