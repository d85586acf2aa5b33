"""Several rewards at once, and rewards for resources."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from bsk_torch.data.base import GlobalReward, Log

if TYPE_CHECKING:
    from bsk_torch.sats.satellite import Satellite
    from bsk_torch.scene.base import Scenario
    from bsk_torch.sim.fleet import Fleet


class ComposedReward(GlobalReward):
    """The sum of several rewards; ``terms`` holds what each of them paid for the last step, [N, S] each, by name."""

    def __init__(self, *rewarders: GlobalReward) -> None:
        """Add up ``rewarders``; ValueError without any."""
        if not rewarders:
            raise ValueError("rewarders is empty; ComposedReward needs at least one, such as data.UniqueImageReward()")
        for rewarder in rewarders:
            if not isinstance(rewarder, GlobalReward):
                raise ValueError(f"rewarders holds {rewarder!r}, which is no rewarder; write data.NoReward(), with parentheses")
        self.rewarders: Sequence[GlobalReward] = rewarders
        self.terms: dict[str, Tensor] = {}

    def __copy__(self) -> ComposedReward:
        """A copy whose parts are copies, as every environment makes them."""
        return ComposedReward(*(copy.copy(rewarder) for rewarder in self.rewarders))

    def __getattr__(self, name: str) -> Any:
        """Only reached for what the sum itself does not have: the first part that has it answers."""
        for rewarder in self.__dict__.get("rewarders", ()):
            if hasattr(rewarder, name):
                return getattr(rewarder, name)
        raise AttributeError(f"none of the rewarders has {name!r}")

    @property
    def names(self) -> list[str]:
        """Name of each term: its class, numbered where there are several."""
        names: list[str] = []
        for rewarder in self.rewarders:
            name = type(rewarder).__name__
            count = sum(other == name or other.startswith(f"{name}_") for other in names)
            names.append(f"{name}_{count + 1}" if count else name)
        return names

    def link(self, scenario: Scenario, fleet: Fleet) -> None:
        """See :meth:`GlobalReward.link`."""
        super().link(scenario, fleet)
        for rewarder in self.rewarders:
            rewarder.link(scenario, fleet)

    def read_log(self) -> Log:
        """Logs of all parts."""
        return {f"{k}.{name}": value for k, part in enumerate(self.rewarders) for name, value in part.read_log().items()}

    def calculate_reward(self, before: Log, after: Log) -> Tensor:
        """See :meth:`GlobalReward.calculate_reward`."""
        for k, (name, part) in enumerate(zip(self.names, self.rewarders, strict=True)):
            mine = f"{k}."
            logs = ({key[len(mine) :]: value for key, value in log.items() if key.startswith(mine)} for log in (before, after))
            self.terms[name] = part.calculate_reward(*logs)
        return torch.stack(list(self.terms.values())).sum(0)

    def share(self, links: Tensor) -> None:
        """See :meth:`GlobalReward.share`."""
        for part in self.rewarders:
            part.share(links)

    def counts(self) -> dict[str, Tensor]:
        """See :meth:`GlobalReward.counts`."""
        return {name: count for part in self.rewarders for name, count in part.counts().items()}

    def is_terminated(self) -> Tensor:
        """See :meth:`GlobalReward.is_terminated`."""
        return torch.stack([part.is_terminated() for part in self.rewarders]).any(0)

    def is_truncated(self) -> Tensor:
        """See :meth:`GlobalReward.is_truncated`."""
        return torch.stack([part.is_truncated() for part in self.rewarders]).any(0)


class ResourceReward(GlobalReward):
    """Pays for the growth of a resource, and charges for what is used up: weight times its change over the step."""

    def __init__(self, resource_fn: Callable[[Satellite], Tensor], reward_weight: float = 1.0) -> None:
        """``resource_fn`` gives the resource of a satellite, such as ``lambda sat: sat.dynamics.battery_charge_fraction``."""
        if not callable(resource_fn):
            raise TypeError(f"resource_fn={resource_fn!r} must be a function of the satellite")
        self.resource_fn, self.reward_weight = resource_fn, float(reward_weight)

    def read_log(self) -> Log:
        """The resource."""
        return {"resource": self.fleet.each(lambda satellite: self.resource_fn(satellite).double().clone())}

    def calculate_reward(self, before: Log, after: Log) -> Tensor:
        """See :meth:`GlobalReward.calculate_reward`."""
        return self.reward_weight * (after["resource"] - before["resource"])
