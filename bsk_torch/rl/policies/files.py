"""Policy files: weights, the plan of the networks, and the environment used for training."""

from __future__ import annotations

import dataclasses
import logging
from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor, nn

from bsk_torch import __version__
from bsk_torch.env import Tasking
from bsk_torch.env.agents import AGENTS
from bsk_torch.rl.networks.plans import ACTOR, NORMALISER, PLANS, AttentionPlan, Networks, Plan, check_network
from bsk_torch.rl.policies.checksummed import load_checksummed, save_checksummed
from bsk_torch.rl.policies.shared_policy import member_views, of_groups
from bsk_torch.untrusted import one_line

logger = logging.getLogger(__name__)

POLICY = "policy.pt"
"""Name of the policy file in a run folder."""

CARD = {"bsk_torch", "preset", "options"}
"""Entries of such a file in addition to :data:`NETWORK`, or :data:`GROUPS` for several groups of satellites."""

NETWORK = {"network", "plan", NORMALISER, ACTOR}
"""Entries that describe the networks of one group."""

SAME_EPISODES = ("0.1.0", "0.2.0", "0.3.0")
"""Releases with equal preset results: a policy trained with one performs equally with the others."""

LOGS = ("log_level", "log_dir", "log_envs")
"""Options neither written to files nor read from them, so that a file cannot choose where its reader writes."""

MACHINE = ("backend", "device")
"""Options that belong to a machine, and are not written to files."""

UNFIT = (AttributeError, IndexError, KeyError, RuntimeError, TypeError, ValueError)
"""What a plan of others may raise."""

LARGEST, MOST_PARTS = 2**20, 2**12
"""Largest size in the plan of a file, and the most numbers and names in one of its lists."""

TRAINING: dict[str, float] = {"decisions": 1e15, "core_seconds": 1e12, "tuning_runs": 1e9}
"""Entries of the optional ``training`` of a file, what the training has cost, with their largest values."""

OBJECTS = "objects"
"""Optional entry: names of the options of the training that are objects of a program, which files do not keep."""

GROUPS = "groups"
"""Entry with a dictionary like :data:`NETWORK` for each of several groups, by name."""


def save_policy(
    path: Path,
    plan: Plan | Mapping[str, Plan],
    networks: Networks | Mapping[str, Networks],
    preset: str,
    options: Mapping[str, object],
    training: Mapping[str, int | float] | None = None,
) -> None:
    """Write a policy for :func:`policy_of_file`, with the environment used for training.

    Args:
        path: The file.
        plan: Plan of the networks; for several groups of satellites, plans by name.
        networks: The networks; for several groups, by name.
        preset: Name of the environment.
        options: Changed options of the environment; only plain values are saved.
        training: What the training has cost, with the entries :data:`TRAINING`; None if unknown.
    """
    card: dict[str, object] = {"bsk_torch": __version__, "preset": preset, "options": plain(options)}
    if lost := objects_in(options):
        card[OBJECTS] = lost
    if training is not None:
        card["training"] = dict(training)
    if isinstance(plan, Mapping):
        assert isinstance(networks, Mapping)
        card |= {GROUPS: {group: _described(plan[group], part) for group, part in networks.items()}}
    else:
        assert isinstance(networks, Networks)
        card |= _described(plan, networks)
    save_checksummed(path, card)


def _described(plan: Plan, networks: Networks) -> dict[str, object]:
    kind = next(name for name, cls in PLANS.items() if type(plan) is cls)
    described = dataclasses.asdict(plan)
    if not described.get("bounds", True):
        del described["bounds"]  # files of discrete actions remain as they were before
    return {"network": kind, "plan": described} | networks.policy_state()


def networks_of(card: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
    """Return the entries :data:`NETWORK` of each group; a single group has the default name."""
    return card.get(GROUPS, {AGENTS: card})


def plain(options: Mapping[str, object]) -> dict[str, Any]:
    """Return the options that are numbers, strings, or lists and dictionaries of these; not devices, back ends and logs."""
    return {name: value for name, value in options.items() if name not in (*MACHINE, *LOGS) and _is_plain(value)}


def objects_in(options: Mapping[str, object]) -> list[str]:
    """Return the names of the options that files do not keep, because they are objects of a program."""
    return sorted(options.keys() - plain(options).keys() - {*MACHINE, *LOGS})


def _is_plain(value: object, levels: int = 4) -> bool:
    if isinstance(value, Mapping):
        return levels > 0 and all(isinstance(key, str) and _is_plain(part, levels - 1) for key, part in value.items())
    if isinstance(value, list | tuple):
        return levels > 0 and all(_is_plain(part, levels - 1) for part in value)
    return isinstance(value, bool | int | float | str)


def read_card(path: Path | str, device: torch.device | str = "cpu") -> dict[str, Any]:
    """Read a policy file, given by its path or its run folder: ``preset``, ``options``, ``network``, ``plan`` and weights.

    With several groups of satellites, the last three are under ``groups`` and the name of the group.

    Files of release 0.1, which have no checksum, are read with a warning.

    Raises:
        ValueError: For a damaged file, or one that is not a policy of this package; the message names it.
        FileNotFoundError: If the file does not exist.
    """
    path = Path(path)
    path = path / POLICY if path.is_dir() else path
    if not path.is_file():
        raise FileNotFoundError(f"there is no policy {str(path)!r}; training leaves {POLICY} in its folder")
    card = load_checksummed(path, "policy", device)
    if not _is_card(card):
        raise ValueError(
            f"{str(path)!r} is no policy of this version of bsk_torch ({__version__}); train it again. For weights of another "
            "network, name a function that returns it: module:function"
        )
    for name in LOGS:
        if name in card["options"]:
            raise ValueError(f"{str(path)!r} has the option {name!r}, which is not taken from files")
    for part in networks_of(card).values():
        check_network(part["network"])
        try:
            _checked_plan(part)
        except UNFIT as error:
            raise ValueError(
                f"{str(path)!r} is no policy of this version of bsk_torch ({__version__}): {one_line(str(error))}"
            ) from error
    return card


def _is_card(card: Mapping[str, object]) -> bool:
    """Return whether a dictionary has the entries of a policy's file, of the right types and sizes."""
    parts = networks_of(card)
    if CARD - card.keys() or not isinstance(parts, dict) or not isinstance(card["preset"], str):
        return False
    options = card["options"]
    if (
        not isinstance(options, dict)
        or not isinstance(card["bsk_torch"], str)
        or not all(isinstance(key, str) for key in options)
    ):
        return False
    if "training" in card and not _is_training(card["training"]):
        return False
    objects = card.get(OBJECTS, [])
    if not isinstance(objects, list) or not all(isinstance(name, str) and name.isidentifier() for name in objects):
        return False
    if options.keys() - plain(options).keys() - set(LOGS) - {name for name in MACHINE if isinstance(options.get(name), str)}:
        return False  # options of other types than those written
    return bool(parts) and all(isinstance(name, str) and _is_network(part) for name, part in parts.items())


def _is_training(value: object) -> bool:
    """Return whether an object has the entries :data:`TRAINING`, within their bounds."""
    return (
        isinstance(value, dict)
        and value.keys() == TRAINING.keys()
        and all(type(value[name]) in (int, float) and 0 <= value[name] <= most for name, most in TRAINING.items())
    )


def _is_network(part: object) -> bool:
    """Return whether an object has the entries :data:`NETWORK`; weights are looked at once their shapes are right."""
    if not isinstance(part, dict) or NETWORK - part.keys() or not isinstance(part["network"], str):
        return False
    states = [part[NORMALISER], part[ACTOR]]
    return _is_plan(part["plan"]) and all(
        isinstance(state, dict) and all(isinstance(value, torch.Tensor) for value in state.values()) for state in states
    )


def _is_plan(value: object, levels: int = 3) -> bool:
    """Return whether an object may be the arguments of a plan: sizes within bounds, names, numbers, and lists of these."""
    if isinstance(value, list | tuple | dict):
        parts = list(value.values()) if isinstance(value, dict) else value
        return levels > 0 and len(parts) <= MOST_PARTS and all(_is_plan(part, levels - 1) for part in parts)
    if isinstance(value, int):
        return 0 <= value <= LARGEST
    return isinstance(value, str) or (isinstance(value, float) and isfinite(value))


def origin_of(card: Mapping[str, Any]) -> str:
    """Return preset and options of the training of a policy."""
    return " ".join([card["preset"], *(f"{name}={value!r}" for name, value in card["options"].items())])


def check_fits(card: Mapping[str, object], env: Tasking, preset: str | None = None) -> None:
    """Raise ValueError, naming both sides, unless the observations and actions of ``card`` fit ``env``, a ``preset``.

    The number of targets to choose from may differ for attention networks.
    """
    parts, views, where = networks_of(card), member_views(env), preset or "this environment"
    trained = origin_of(card)
    if len(parts) == len(views) == 1:
        views = dict(zip(parts, views.values(), strict=True))  # one group may have any name
    if parts.keys() != views.keys():
        theirs, ours = (", ".join(names) for names in (parts, views))
        raise ValueError(f"the policy was trained for {trained} with groups {theirs}; {where} has {ours}")
    for group, part in parts.items():
        kind, plan = PLANS[part["network"]], part["plan"]
        needed = kind.of(views[group], plan["hidden"])
        match needed, plan.get("images"):
            case AttentionPlan(), (int(first), int(end)):
                needed = needed.with_images(end - first)
        expected = dataclasses.asdict(needed)
        stored = {name: plan.get(name, ()) for name in expected}
        differing = [name for name in expected if _listed(expected[name]) != _listed(stored[name])]
        if differing:
            theirs, ours = (", ".join(f"{name}={values[name]}" for name in differing) for values in (stored, expected))
            of_group = f" in group {group}" if len(parts) > 1 else ""
            raise ValueError(f"the policy was trained for {trained} with {theirs}{of_group}; {where} has {ours}")
    if card["bsk_torch"] not in SAME_EPISODES:
        logger.warning("the policy is of bsk_torch %s; this is %s", card["bsk_torch"], __version__)


def _listed(value: object) -> object:
    return [_listed(part) for part in value] if isinstance(value, list | tuple) else value


def policy_of_file(path: Path | str, device: torch.device | str = "cpu") -> TensorDictModuleBase:
    """Return the policy of a file or run folder, as :func:`build_policy` does; for errors, see :func:`read_card`."""
    return build_policy(read_card(path, device), device)


def build_policy(card: Mapping[str, object], device: torch.device | str = "cpu") -> TensorDictModuleBase:
    """Return the policy of a card; ValueError if its weights do not fit its plan.

    The result is a policy for one satellite, or :class:`~bsk_torch.rl.policies.shared_policy.GroupPolicies` for several groups.
    """
    policies = {}
    for group, part in networks_of(card).items():
        try:
            plan = _checked_plan(part)
            networks = plan.build().to(device)
            networks.load_policy_state(part)
        except UNFIT as error:
            raise ValueError(f"the policy of {card['preset']} does not fit this version of bsk_torch: {error}") from error
        policies[group] = networks.policy
        policies[group].register_forward_pre_hook(Origin(origin_of(card), plan))
    return of_groups(policies)


@dataclass(frozen=True)
class Origin:
    """A hook of a policy for one satellite, called before it decides: tells where it was trained if it does not fit.

    Attributes:
        trained: Preset and options of the training.
        plan: Plan of the networks.
    """

    trained: str
    plan: Plan

    def __call__(self, policy: nn.Module, arguments: tuple[object, ...]) -> None:
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


def _checked_plan(part: Mapping[str, Any]) -> Plan:
    """Return the plan of a file; ValueError if its weights have other shapes or types, or are not finite."""
    plan = PLANS[part["network"]](**part["plan"])
    with torch.device("meta"):  # takes no memory, whatever the plan asks for
        planned = plan.build().policy_state()
    for name in (NORMALISER, ACTOR):
        expected, stored = (
            {key: (tuple(value.shape), value.dtype) for key, value in state[name].items()} for state in (planned, part)
        )
        for key in dict.fromkeys((*expected, *stored)):
            if expected.get(key) != stored.get(key):
                raise ValueError(f"{name}.{key} has shape and type {stored.get(key)}, its plan {expected.get(key)}")
        for key, value in part[name].items():
            if not bool(value.isfinite().all()):
                raise ValueError(f"{name}.{key} has numbers that are not finite")
    return plan
