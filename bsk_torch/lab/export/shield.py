"""Shields that exported policies contain: rules of which each condition leaves one action."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor

from bsk_torch.rl.rules.shield import ImagerRule, Rule, SafeRule


class Only(NamedTuple):
    """Only ``action`` is allowed if one of the numbers ``columns`` of the observation is beyond a threshold.

    Attributes:
        columns: Positions in the vector of all observed numbers.
        absolute: Whether absolute values are compared.
        sign: ``">"`` or ``"<"``.
        threshold: The number they are compared with.
        action: Number of the action.
    """

    columns: tuple[int, ...]
    absolute: bool
    sign: str
    threshold: float
    action: int


def conditions(rule: Rule, name: str, places: Sequence[Mapping[str, Any]], actions: Sequence[str]) -> tuple[Only, ...]:
    """Return what a rule asks, in order: the first condition that holds counts.

    Args:
        rule: A rule of :mod:`bsk_torch.rl.rules.shield`.
        name: Its name, for messages.
        places: Observed quantities, see :func:`~bsk_torch.lab.export.contract.places_of`.
        actions: Name of each action.

    Raises:
        ValueError: For another rule, a function of Python, and for an observation or action that is missing.
    """
    match rule:
        case SafeRule(low=low, fast=fast):
            table = [("wheel_speeds_fraction", True, ">", fast, "action_desat")]
            table += [("battery_charge_fraction", False, "<", low, "action_charge")]
        case ImagerRule(full=full, low=low):
            table = [("storage_level_fraction", False, ">", full, "action_downlink")]
            table += [("battery_charge_fraction", False, "<", low, "action_charge")]
        case _:
            raise ValueError(f"shield={name!r} is a function of Python, which is not exported; 'safe' and 'imager' are")
    asked = []
    for quantity, absolute, sign, threshold, action in table:
        matches = [place for place in places if place["name"].split(".")[-1] == quantity]
        columns = tuple(place["vector"] + j for place in matches for j in range(place["width"]))
        for what, exists in ((quantity, bool(columns)), (action, action in actions)):
            if not exists:
                raise ValueError(f"shield={name!r} needs {what!r}, which the environment does not have")
        asked.append(Only(columns, absolute, sign, threshold, actions.index(action)))
    return tuple(asked)


def narrowed(only: Sequence[Only], observed: Tensor, legal: Tensor) -> Tensor:
    """Return the actions of ``legal`` [N, A] that remain for observed numbers [N, D]: all where none would remain."""
    allowed, earlier = torch.ones_like(legal), torch.zeros_like(legal[:, 0])
    numbers = torch.arange(legal.shape[-1], device=legal.device)
    for one in only:
        values = observed[:, list(one.columns)]
        values = values.abs() if one.absolute else values
        holds = (values > one.threshold if one.sign == ">" else values < one.threshold).any(-1) & ~earlier
        allowed = allowed & (~holds.unsqueeze(-1) | (numbers == one.action))
        earlier = earlier | holds
    remaining = legal & allowed
    return torch.where(remaining.any(-1, keepdim=True), remaining, legal)
