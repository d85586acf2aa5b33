"""Calls of a rewarder's hooks with checks of their results.

Environments and :class:`~bsk_torch.data.ComposedReward` call hooks only through these functions. A tensor of a wrong shape
therefore raises an error naming the hook, instead of being broadcast to a wrong reward. The checks read shapes and dtypes, and
values of users' rewarders only.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from bsk_torch._checks import no_gradient
from bsk_torch.data.base import GlobalReward, Log
from bsk_torch.sim.hooks import ChangeGuard, check_linked, check_tensor, is_of_package
from bsk_torch.sim.state import SHOWN

if TYPE_CHECKING:
    from bsk_torch.sats.fleet import SatelliteFleet
    from bsk_torch.scene.base import Scenario


REWARD_MEMORY = (
    "keep values that are reset with every episode in self.fleet.memory, where link(scenario, fleet) declares them: "
    "fleet.memory.declare(name, initial_value, fleet.size)"
)
"""Advice for rewarders that keep values of episodes themselves."""


def link(rewarder: GlobalReward, scenario: Scenario, fleet: SatelliteFleet) -> None:
    """Link a rewarder; TypeError if a subclass does not pass the call on to its base class."""
    rewarder.link(scenario, fleet)
    check_linked(rewarder, "link(scenario, fleet)", fleet)


def log(rewarder: GlobalReward) -> Log:
    """Return the log of the current state; TypeError unless it is a dictionary of tensors [N, S, ...]."""
    found, shape = rewarder.read_log(), rewarder.fleet.shape
    if not isinstance(found, dict):
        raise TypeError(f"{type(rewarder).__name__}.read_log() returns {found!r}; it must return a dictionary of tensors")
    for name, value in found.items():
        if not isinstance(value, Tensor) or value.shape[:2] != shape:
            check_tensor(f"{type(rewarder).__name__}.read_log()[{name!r}]", value, shape)
    return found


def reward(rewarder: GlobalReward, before: Log, after: Log) -> Tensor:
    """Return the reward of a step, [N, S].

    Raises:
        TypeError: For a wrong shape, or a dtype that is not floating-point.
        TypeError: For a user's rewarder with a public tensor attribute that changes; values of episodes belong in fleet.memory.
        ValueError: For a reward that requires a gradient.
        FloatingPointError: For a reward of a user's rewarder that is NaN or infinite.
    """
    with torch.enable_grad():  # so that a reward that depends on parameters can be told
        found = rewarder.calculate_reward(before, after)
    title = f"{type(rewarder).__name__}.calculate_reward()"
    check_tensor(title, found, rewarder.fleet.shape, torch.float64, torch.float32)
    if not is_of_package(type(rewarder)):
        rows = torch.nonzero(~torch.isfinite(found).all(1)).squeeze(-1).tolist()
        if rows:
            raise FloatingPointError(f"{title} is NaN or infinite for environments {rows[:SHOWN]} ({len(rows)} in all)")
        rewarder.__dict__.setdefault("_guard", ChangeGuard()).check(rewarder, REWARD_MEMORY)
    return no_gradient(title, found)


def terminated(rewarder: GlobalReward) -> Tensor:
    """Return the satellites whose episode the rewarder terminates, [N, S] bool; TypeError for a wrong shape or dtype."""
    found = rewarder.is_terminated()
    check_tensor(f"{type(rewarder).__name__}.is_terminated()", found, rewarder.fleet.shape, torch.bool)
    return found


def truncated(rewarder: GlobalReward) -> Tensor:
    """Return the satellites whose episode the rewarder truncates, [N, S] bool; TypeError for a wrong shape or dtype."""
    found = rewarder.is_truncated()
    check_tensor(f"{type(rewarder).__name__}.is_truncated()", found, rewarder.fleet.shape, torch.bool)
    return found


def share(rewarder: GlobalReward, links: Tensor) -> None:
    """Share knowledge along ``links`` [N, S, S] bool; TypeError if the hook returns a value, which would be lost."""
    if rewarder.share(links) is not None:  # type: ignore[func-returns-value]
        raise TypeError(f"{type(rewarder).__name__}.share(links) must return None; keep what it computes in fleet.memory")


def measures(rewarder: GlobalReward) -> dict[str, Tensor]:
    """Return the measures of a rewarder, [N] float64 each; TypeError for one with a wrong shape or dtype."""
    found = rewarder.measures()
    for name, value in found.items():
        check_tensor(f"{type(rewarder).__name__}.measures()[{name!r}]", value, rewarder.fleet.shape[:1], torch.float64)
    return found


def counts(rewarder: GlobalReward, taken: Collection[str] = ()) -> dict[str, Tensor]:
    """Return the counters of a rewarder, [N, S] int64 each.

    Raises:
        TypeError: For a counter with a wrong shape or dtype.
        ValueError: For a counter with a name already ``taken`` by the satellites.
    """
    found, shape = rewarder.counts(), rewarder.fleet.shape
    if not isinstance(found, dict):
        raise TypeError(f"{type(rewarder).__name__}.counts() returns {found!r}; it must return a dictionary of tensors")
    for name, value in found.items():
        check_tensor(f"{type(rewarder).__name__}.counts()[{name!r}]", value, shape, torch.int64)
        if name in taken:
            raise ValueError(f"{type(rewarder).__name__}.counts() has {name!r}, which the satellites count, too; rename it")
    return found
