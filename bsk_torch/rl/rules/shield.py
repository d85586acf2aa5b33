"""Shields: rules that remove dangerous actions before a policy chooses, during and after training.

Source: M. Alshiekh et al., "Safe reinforcement learning via shielding", AAAI 2018; for spacecraft, A. Harris and H. Schaub,
"Spacecraft command and control with safety guarantees using shielded deep reinforcement learning", AIAA SciTech 2020.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from tensordict.nn import TensorDictModule, TensorDictModuleBase, TensorDictSequential
from torch import Tensor

from bsk_torch.act import allow_only
from bsk_torch.env import SatelliteTasking
from bsk_torch.own_objects import import_object
from bsk_torch.rl.rules.baselines import Columns
from bsk_torch.sim.arguments.values import nearest

Rule = Callable[[Columns, Sequence[str]], Tensor]
"""Function from the observed columns and the names of the actions to a mask of allowed actions, [N, A] booleans."""


@dataclass(frozen=True)
class SafeRule:
    """Allows only desaturation with a fast wheel, only charging with a nearly empty battery, and otherwise all actions.

    For satellites that observe ``wheel_speeds_fraction`` and ``battery_charge_fraction`` and can desaturate and charge. The
    defaults were found empirically in NadirScan-v1, with a trained policy, random actions, and permanent scanning. With less
    charge or faster wheels (which need more power), more satellites die; with more charge, the trained policy earns less.

    Args:
        low: Battery charge, as a fraction of the capacity, below which only charging is allowed.
        fast: Wheel speed, as a fraction of the maximum, above which only desaturation is allowed.
    """

    low: float = 0.06
    fast: float = 0.2

    def __call__(self, see: Columns, actions: Sequence[str]) -> Tensor:
        """Return the mask of allowed actions."""
        fast = see.all("wheel_speeds_fraction").abs().amax(-1) > self.fast
        low = ~fast & (see["battery_charge_fraction"] < self.low)
        return allow_only(actions, "action_charge", where=low) & allow_only(actions, "action_desat", where=fast)


@dataclass(frozen=True)
class ImagerRule:
    """Allows only a downlink with a full store, only charging with little charge, and otherwise all actions.

    For imagers that observe ``storage_level_fraction`` and ``battery_charge_fraction``, such as those of Services-v1. The
    defaults are those of the study from which that preset is taken.

    Args:
        full: Data in the store, as a fraction of the capacity, above which only a downlink is allowed.
        low: Battery charge, as a fraction of the capacity, below which only charging is allowed.
    """

    full: float = 0.99
    low: float = 0.2

    def __call__(self, see: Columns, actions: Sequence[str]) -> Tensor:
        """Return the mask of allowed actions."""
        full = see["storage_level_fraction"] > self.full
        low = ~full & (see["battery_charge_fraction"] < self.low)
        return allow_only(actions, "action_downlink", where=full) & allow_only(actions, "action_charge", where=low)


RULES: dict[str, Rule] = {"safe": SafeRule(), "imager": ImagerRule()}
"""Rules by name."""


def shield(rule: Rule, env: SatelliteTasking) -> TensorDictModule:
    """Return a module that restricts ``action_mask`` to the actions allowed by ``rule``, unless none would be left.

    Raises:
        KeyError: For an observation missing in the environment.
        ValueError: For an action missing in the environment, or a rule that does not return a mask of the actions.
    """
    description, actions = env.satellite.observation_description, env.satellite.action_description

    def narrow(observation: object, action_mask: Tensor) -> Tensor:
        legal = action_mask & rule(Columns(observation, description), actions)
        return torch.where(legal.any(-1, keepdim=True), legal, action_mask)

    zero = env.observation_spec.zero()
    if "action_mask" not in zero.keys():  # noqa: SIM118  - a tensordict
        raise ValueError(f"a shield masks numbered actions; those of {env.satellite.name} are real numbers")
    allowed = rule(Columns(zero["observation"], description), actions)
    if not isinstance(allowed, Tensor) or (allowed.dtype, allowed.shape) != (torch.bool, zero["action_mask"].shape):
        result = f"{allowed.dtype} {list(allowed.shape)}" if isinstance(allowed, Tensor) else repr(allowed)
        shape = list(zero["action_mask"].shape)
        raise ValueError(f"the rule of a shield gives {result}; it must give booleans {shape}, one for each of {actions}")
    return TensorDictModule(narrow, in_keys=["observation", "action_mask"], out_keys=["action_mask"])


def shielded(policy: TensorDictModuleBase, rule: Rule, env: SatelliteTasking) -> TensorDictSequential:
    """Return the policy with a :func:`shield`: it learns and acts as if forbidden actions were illegal."""
    return TensorDictSequential(shield(rule, env), policy)


def find_rule(name: str) -> Rule:
    """Return one of :data:`RULES` by name, or a user function, ``"package.module:function"`` or ``"file.py:function"``.

    ValueError for an unknown rule; the message contains the nearest name.
    """
    if ":" not in name:
        if name not in RULES:
            raise ValueError(f"shield={name!r} is no rule; {nearest(name, RULES)}; your own is named package.module:function")
        return RULES[name]
    rule = import_object(name, "shield")
    if not callable(rule):
        raise ValueError(f"shield={name!r} is a {type(rule).__name__}; it must be a function")
    try:
        inspect.signature(rule).bind(None, None)
    except TypeError as error:
        raise ValueError(f"shield={name!r} must take the observed columns and the names of the actions: {error}") from error
    except ValueError:  # a function without a signature
        pass
    return rule
