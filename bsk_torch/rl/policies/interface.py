"""What a policy of another library expects of an environment, compared once with what the environment gives."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from math import prod
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import torch
from annotated_types import Interval
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from typing_extensions import NotRequired, TypedDict

from bsk_torch.env import SatelliteTasking, Tasking
from bsk_torch.env.action_forms import form
from bsk_torch.env.satellite_group import SatelliteGroup
from bsk_torch.rl.networks.plans import MEMORY
from bsk_torch.rl.policies.shared_policy import member_view
from bsk_torch.untrusted import MOST_JSON, Word, parse_json, read_bytes
from bsk_torch.wrappers.policies import Actor, FunctionPolicy
from bsk_torch.wrappers.spaces import flat, map_leaves

OBSERVATION, MASK = "observation", "action_mask"
"""Names of the observation vector and of the mask."""

REMEMBERED = "next.memory"
"""Name of the output of a recurrent network that is its input ``memory`` at the next decision."""

CONTRACT = "bsk_torch.contract"
"""Entry of a file with its contract, which may also be next to it, as ``FILE.json``."""

TRIED = 3
"""Rows of the trial of a policy: a size of batch that no exporter assumes."""


class Loaded(NamedTuple):
    """A policy that was read, for an environment to come.

    Attributes:
        fit: Returns the policy for an environment, called ``where`` in errors: for one satellite, one of each group, or all.
        library: Library that made it, and the version.
        card: Contents of the policy's file; empty for what has none.
    """

    fit: Callable[[Tasking, str], Actor]
    library: str
    card: Mapping[str, Any] = {}


class Quantity(TypedDict):
    """A quantity that a network observes, with its number of columns, or one of its actions."""

    name: Word
    width: NotRequired[Annotated[int, Interval(ge=1, le=2**20)]]


class Contract(TypedDict):
    """Quantities in the order in which a network observes them, its actions, and names of its inputs and outputs."""

    observation: NotRequired[list[Word | Quantity]]
    actions: NotRequired[list[Word | Quantity]]
    inputs: NotRequired[list[Quantity]]
    outputs: NotRequired[list[Quantity]]


@dataclass(frozen=True)
class Interface:
    """What a policy of another library expects, as far as its file tells.

    Attributes:
        title: The policy in messages.
        inputs: Lengths of what it observes, by name: the observation vector, or parts of a named observation; None if unknown.
        actions: Number of actions to choose from, or of real numbers; None if unknown.
        is_real: Whether it returns real numbers; None if unknown.
        contract: Names of observations and actions.
        memory: Shape of the memory of a recurrent policy, without the batch: a further input and result; empty without one.
    """

    title: str
    inputs: Mapping[str, int | None]
    actions: int | None = None
    is_real: bool | None = None
    contract: Contract | None = field(default=None)
    memory: tuple[int, ...] = ()

    def check(self, view: SatelliteTasking, where: str) -> list[str]:
        """Return the names of the environment's observations, in the order of :attr:`inputs`, for one satellite.

        ValueError, naming what is expected and what the environment ``where`` gives, if they differ.
        """
        satellite, sizes = view.satellite, lengths(view) | ({MEMORY: prod(self.memory)} if self.memory else {})
        builder, names = form(satellite), list(satellite.action_description or ())
        if self.is_real is not None and self.is_real != (builder is not None):
            kinds = ("chooses one of several actions", "returns real numbers")
            theirs = f"real numbers, {', '.join(builder.names)}" if builder else f"a choice of {len(names)}: {', '.join(names)}"
            raise ValueError(f"{self.title} {kinds[self.is_real]}; an action of {where} is {theirs}")
        count = int(builder.width) if builder else len(names)
        if self.actions is not None and self.actions != count:
            what = "real numbers" if builder else "actions"
            listed = ", ".join(builder.names if builder else names)
            raise ValueError(f"{self.title} has {self.actions} {what}; {where} has {count}: {listed}")
        order = self._matched(sizes, where)
        for name, key in zip(self.inputs, order, strict=True):
            expected = self.inputs[name]
            if expected is not None and expected != sizes[key]:
                listed = f": {', '.join(satellite.observation_description)}" if key == OBSERVATION else ""
                raise ValueError(f"{self.title} expects {expected} numbers as {name!r}; {where} gives {sizes[key]}{listed}")
        if self.contract is not None:
            if OBSERVATION in order:
                observed = satellite.observation_description
                self._check_names("number", self.contract.get("observation", observed), observed, where)
            self._check_names("action", self.contract.get("actions", names), names, where)
        return order

    def _matched(self, sizes: Mapping[str, int], where: str) -> list[str]:
        by_name = {name_of(key): key for key in sizes}
        order = [by_name.get(name_of(name)) for name in self.inputs]
        others = [key for key in sizes if key not in (MASK, MEMORY)]
        if len(others) == 1 and others[0] not in order and order.count(None) == 1:
            order[order.index(None)] = others[0]  # the only input left is the vector, whatever its name
        for name, key in zip(self.inputs, order, strict=True):
            if key is None:
                raise ValueError(
                    f"{self.title} observes {', '.join(self.inputs)}; {where} has no {name!r}, but {', '.join(sizes)}"
                )
        return [str(key) for key in order]

    def _check_names(self, what: str, expected: Sequence[str | Quantity], offered: Sequence[str], where: str) -> None:
        parts: list[Quantity] = [{"name": part} if isinstance(part, str) else part for part in expected]
        wanted = [part["name"].partition("[")[0] for part in parts for _ in range(part.get("width", 1))]
        for k, (theirs, ours) in enumerate(zip(wanted, (name.partition("[")[0] for name in offered), strict=False)):
            if theirs != ours:
                raise ValueError(f"{self.title} expects {what} {k} to be {theirs!r}; in {where}, it is {ours!r}")
        if len(wanted) != len(offered):
            raise ValueError(f"{self.title} expects {len(wanted)} of each {what} by name; {where} has {len(offered)}")

    def policy(self, env: Tasking, where: str, network: Callable[[list[Tensor], Tensor | None], object]) -> TensorDictModuleBase:
        """Return the policy of a satellite of ``env``, tried once.

        Args:
            env: The environment, of one satellite or several alike.
            where: Its name in errors.
            network: Returns what :class:`~bsk_torch.wrappers.policies.FunctionPolicy` takes, from the inputs [B, ...] in the
                order of :attr:`inputs`, and the mask [B, A], None for real actions; of a recurrent policy, this and the memory.
        """
        view = member_view(env)
        order, is_real = self.check(view, where), form(view.satellite) is not None

        def choose(observation: object, action_mask: Tensor | None = None, memory: Tensor | None = None) -> Any:
            parts = leaves(observation, action_mask) | ({} if memory is None else {MEMORY: memory})
            return network([parts[name] for name in order], action_mask)

        policy = FunctionPolicy(choose, view.satellite, not is_real, self.title)
        if self.memory:
            policy = RecurrentPolicy(choose, view.satellite, not is_real, self.title, self.memory)
        self.try_policy(policy, env, where)
        return policy

    def try_policy(self, policy: TensorDictModuleBase, env: Tasking, where: str) -> None:
        """Let the policy decide for zeros; ValueError if it cannot, before anything flies."""
        view = member_view(env)
        keys = [OBSERVATION] + [MASK] * (MASK in view.observation_spec.keys())  # noqa: SIM118
        situations = view.observation_spec.zero().select(*keys)[:1].expand(TRIED).clone()
        if MASK in keys:
            situations[MASK] = torch.ones_like(situations[MASK])
        try:
            with torch.no_grad():
                policy(situations)
        except Exception as error:  # networks of others may raise anything
            raise ValueError(f"{self.title} cannot decide in {where}: {type(error).__name__}: {error}") from error


class RecurrentPolicy(FunctionPolicy):
    """A network with a memory, which is passed on as that of :class:`~bsk_torch.rl.networks.plans.GRUPlan` is."""

    def __init__(
        self, network: Callable[..., Any], satellite: SatelliteGroup, with_mask: bool, title: str, shape: tuple[int, ...]
    ) -> None:
        """Call ``network`` with observation, mask or None, and memory [B, ``*shape``]; it returns scores and the next memory."""
        super().__init__(network, satellite, with_mask, title)
        self.shape = shape
        self.out_keys: list[NestedKey] = [*self.out_keys, ("next", MEMORY)]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write ``action``, the next memory, and the memory where an episode starts, zeros."""
        if MEMORY not in tensordict.keys():  # noqa: SIM118  - a tensordict
            tensordict[MEMORY] = torch.zeros(*tensordict.batch_size, *self.shape, device=tensordict.device, dtype=torch.float32)
        mask = tensordict[MASK] if self.with_mask else None
        scores, memory = self.function(tensordict[OBSERVATION], mask, tensordict[MEMORY])
        tensordict["next", MEMORY] = memory
        return tensordict.set("action", self._action(scores, tensordict))


def name_of(text: str) -> str:
    """Return the name of an input without what languages do not allow in names, and without a leading ``observation``."""
    name = re.sub(r"\W+", "_", text).removeprefix(f"{OBSERVATION}_")
    return {"obs": OBSERVATION, "mask": MASK, "action_masks": MASK}.get(name, name)


def leaves(observation: object, mask: Tensor | None) -> dict[str, Tensor]:
    """Return the observation vector, or the parts of a named observation by joined names, and the mask if there is one."""
    tree = map_leaves(observation, lambda part: part)
    parts = {OBSERVATION: tree} if isinstance(tree, Tensor) else flat(tree)
    return parts if mask is None else parts | {MASK: mask}


def lengths(view: SatelliteTasking) -> dict[str, int]:
    """Return how many numbers each part of the observation has, and the mask, if there is one."""
    one: TensorDictBase = view.observation_spec.zero()[0]
    return {name: prod(part.shape) for name, part in leaves(one[OBSERVATION], one.get(MASK, None)).items()}


def contract_of(path: Path, content: str | bytes | None) -> Contract | None:
    """Return the contract in a file, or next to it as ``FILE.json``; None if there is none. ValueError for anything else."""
    separate = path.with_name(f"{path.name}.json")
    if content is None:
        if not separate.is_file():
            return None
        content = read_bytes(separate, MOST_JSON)
    text = content.encode() if isinstance(content, str) else content
    try:
        whole = parse_json(text, dict[str, object])
        return parse_json(json.dumps({k: whole[k] for k in Contract.__annotations__ if k in whole}).encode(), Contract)
    except ValueError as error:
        raise ValueError(f"the contract of {str(path)!r} is damaged: {error}") from error
