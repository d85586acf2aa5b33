"""Shields: rules that take dangerous actions away before a policy chooses, in training and after it.

Source: M. Alshiekh et al., "Safe reinforcement learning via shielding", AAAI 2018; of spacecraft, A. Harris and H. Schaub,
"Spacecraft command and control with safety guarantees using shielded deep reinforcement learning", AIAA SciTech 2020.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import import_module

import torch
from tensordict.nn import TensorDictModule, TensorDictModuleBase, TensorDictSequential
from torch import Tensor

from bsk_torch.act import allow_only
from bsk_torch.env import SatelliteTasking
from bsk_torch.rl.rules.baselines import Columns
from bsk_torch.sim.arguments.values import nearest

Rule = Callable[[Columns, Sequence[str]], Tensor]
"""Function of the observed columns and the names of the actions to a mask of allowed actions, [N, A] booleans."""


@dataclass(frozen=True)
class SafeRule:
    """Dump momentum when a wheel is fast, charge when the battery is nearly empty, else do anything.

    For satellites that observe ``wheel_speeds_fraction`` and ``battery_charge_fraction`` and can desaturate and charge. The
    defaults were found by trying on NadirScan-v1, with a trained policy, random actions, and scanning forever: with less charge
    or faster wheels (which take more power) more of these die, and with more charge the trained policy earns less.

    Args:
        low: Battery charge, fraction of its capacity, below which only charging is allowed.
        fast: Wheel speed, fraction of the largest, above which only desaturation is.
    """

    low: float = 0.06
    fast: float = 0.2

    def __call__(self, see: Columns, actions: Sequence[str]) -> Tensor:
        """See :data:`Rule`."""
        fast = see.all("wheel_speeds_fraction").abs().amax(-1) > self.fast
        low = ~fast & (see["battery_charge_fraction"] < self.low)
        return allow_only(actions, "action_charge", where=low) & allow_only(actions, "action_desat", where=fast)


RULES: dict[str, Rule] = {"safe": SafeRule()}
"""Rules by name."""


def shield(rule: Rule, env: SatelliteTasking) -> TensorDictModule:
    """Narrows ``action_mask`` to what ``rule`` allows; where that leaves nothing, to what it was.

    Raises:
        KeyError: For an observation that the environment does not have.
        ValueError: For an action that it does not have, or a rule that gives no mask of the actions.
    """
    description, actions = env.satellite.observation_description, env.satellite.action_description

    def narrow(observation: object, action_mask: Tensor) -> Tensor:
        left = action_mask & rule(Columns(observation, description), actions)
        return torch.where(left.any(-1, keepdim=True), left, action_mask)

    zero = env.observation_spec.zero()
    if "action_mask" not in zero.keys():  # noqa: SIM118  - a tensordict
        raise ValueError(f"a shield masks numbered actions; those of {env.satellite.name} are real numbers")
    allowed = rule(Columns(zero["observation"], description), actions)
    if not isinstance(allowed, Tensor) or (allowed.dtype, allowed.shape) != (torch.bool, zero["action_mask"].shape):
        given = f"{allowed.dtype} {list(allowed.shape)}" if isinstance(allowed, Tensor) else repr(allowed)
        wanted = list(zero["action_mask"].shape)
        raise ValueError(f"the rule of a shield gives {given}; it must give booleans {wanted}, one for each of {actions}")
    return TensorDictModule(narrow, in_keys=["observation", "action_mask"], out_keys=["action_mask"])


def shielded(policy: TensorDictModuleBase, rule: Rule, env: SatelliteTasking) -> TensorDictSequential:
    """The policy behind a :func:`shield`: it learns and acts as if forbidden actions were illegal."""
    return TensorDictSequential(shield(rule, env), policy)


def find_rule(name: str) -> Rule:
    """One of :data:`RULES` by name, or a function of the user's, ``"package.module:function"``.

    Raises:
        ValueError: Where there is no such rule; the message names the nearest.
    """
    module, colon, function = name.partition(":")
    if not colon:
        if name not in RULES:
            raise ValueError(f"shield={name!r} is no rule; {nearest(name, RULES)}; your own is named package.module:function")
        return RULES[name]
    try:
        rule = getattr(import_module(module), function, None)
    except (ImportError, TypeError, ValueError) as error:  # TypeError: a relative name
        raise ValueError(f"shield={name!r}: {error}") from error
    if not callable(rule):
        known = [key for key, value in vars(import_module(module)).items() if callable(value)]
        raise ValueError(f"shield={name!r}: {module!r} has no function {function!r}; {nearest(function, known)}")
    try:
        inspect.signature(rule).bind(None, None)
    except TypeError as error:
        raise ValueError(f"shield={name!r} must take the observed columns and the names of the actions: {error}") from error
    except ValueError:  # a function without a signature
        pass
    return rule
