"""Where a policy was trained, told to those who use it in another environment."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from tensordict import TensorDictBase
from torch import Tensor, nn

from bsk_torch.rl.networks.plans import AttentionPlan, Plan


@dataclass(frozen=True)
class Origin:
    """A hook of a policy for one satellite, called before it decides.

    Attributes:
        trained: Preset and options of the training.
        plan: Plan of the networks.
    """

    trained: str
    plan: Plan

    def __call__(self, policy: nn.Module, arguments: tuple[Any, ...]) -> None:
        """Raise ValueError, naming the training, for a tensordict with other observations or actions."""
        if not arguments or not isinstance(arguments[0], TensorDictBase):
            return
        fault = self.fault(arguments[0])
        if fault:
            raise ValueError(f"this policy was trained for {self.trained}; {fault}")

    def fault(self, situations: TensorDictBase) -> str | None:
        """Return what does not fit; None if all does."""
        plan, observation = self.plan, situations.get("observation", None)
        if observation is None:
            return "in a constellation, bsk_torch.rl.marl.shared(policy, env) lets it decide for each satellite"
        if isinstance(plan, AttentionPlan):
            rows = situations.get((*plan.set_key, "rows"), None) if isinstance(observation, TensorDictBase) else None
            return None if rows is not None and rows.shape[-1] == plan.n_features else "this environment has other observations"
        if not isinstance(observation, Tensor) or observation.shape[-1] != plan.n_observed:
            numbers = f"{observation.shape[-1]} numbers" if isinstance(observation, Tensor) else "named parts"
            return f"it observes {plan.n_observed} numbers, and this environment has {numbers}"
        mask = situations.get("action_mask", None)
        if mask is not None and mask.shape[-1] != plan.n_actions:
            return f"it chooses among {plan.n_actions} actions, and this environment has {mask.shape[-1]}"
        return None
