"""Policies of other libraries as TorchRL policies: torch modules, functions, and models of Stable-Baselines3."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from math import isfinite
from typing import Any, Protocol, TypeAlias, runtime_checkable

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor, nn
from torchrl.envs.utils import ExplorationType, exploration_type

from bsk_torch.env.action_forms import form
from bsk_torch.env.satellite_group import SatelliteGroup
from bsk_torch.wrappers.spaces import flat, flat_rows, map_leaves


@runtime_checkable
class Model(Protocol):
    """A model of Stable-Baselines3."""

    observation_space: object

    def predict(self, observation: Any, *args: Any, **kwargs: Any) -> tuple[Any, Any]:
        """Return actions, and the state of a recurrent model."""


Actor: TypeAlias = "TensorDictModuleBase | nn.Module | Model | Callable[..., Any]"
"""What chooses actions; see :func:`policy_of_one`."""

WHOLE = ("tensordict", "td")
"""Names of the argument of functions that write actions into a tensordict, as :data:`bsk_torch.env.rollout.Policy` does."""

MOST_SHOWN = 16
"""Most numbers of an observation in a message."""

WRITE = (
    "write, for example:\n"
    "    from tensordict.nn import TensorDictModule\n"
    '    policy = TensorDictModule(network, in_keys=["observation"], out_keys=["action"])'
)
"""Advice for what is not a policy."""


class DecisionError(ValueError):
    """A policy of the user's returns no action."""


def policy_of_one(actor: Actor, satellite: SatelliteGroup) -> TensorDictModuleBase:
    """Return what chooses actions as a policy for one satellite, a module of tensordicts.

    Args:
        actor: A module of tensordicts, which is returned unchanged; a torch module or function of the observation [B, F], which
            may take the action mask [B, A] second; a model of Stable-Baselines3 or sb3-contrib; or a function of a tensordict,
            whose argument is called ``tensordict`` or ``td``. Modules and functions return the numbers of the actions, [B], or a
            score of each action, [B, A], of which the highest legal one counts; or real actions, [B, A]. They observe named
            observations as nested dictionaries.
        satellite: The satellite that acts.

    Raises:
        TypeError: For anything else, with what to write.
    """
    if isinstance(actor, TensorDictModuleBase):
        return actor
    if isinstance(actor, str):
        raise TypeError(f"policy={actor!r} is a name; bsk_torch.rule({actor!r}, env) makes the policy of a rule")
    if isinstance(actor, Model):
        return ModelPolicy(actor, satellite)
    parameters = None if isinstance(actor, type) or not callable(actor) else positional(actor)
    if parameters is None or not 1 <= len(parameters) <= 2:
        raise TypeError(
            f"policy is {described(actor)}; it must be a module of tensordicts, a torch module or function of the observation "
            f"(and the action mask), or a model of Stable-Baselines3; {WRITE}"
        )
    return WholePolicy(actor) if parameters[0] in WHOLE else FunctionPolicy(actor, satellite, len(parameters) == 2)


def positional(actor: Callable[..., Any]) -> list[str]:
    """Return the names of the arguments that a call must give by position; one for functions without a signature."""
    function = actor.forward if isinstance(actor, nn.Module) else actor
    try:
        parameters = inspect.signature(function).parameters.values()
    except ValueError:  # of a function that is not written in Python
        return ["observation"]
    kinds = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)
    names = [p.name for p in parameters if p.kind in kinds and (p.default is p.empty or p.name == "action_mask")]
    return names or [p.name for p in parameters if p.kind is p.VAR_POSITIONAL]


def described(actor: object) -> str:
    """Return what an object is, without its address."""
    name = getattr(actor, "__qualname__", None)
    return f"the {'class' if isinstance(actor, type) else 'function'} {name}" if name else f"a {type(actor).__name__}"


class WholePolicy(TensorDictModuleBase):
    """A function of a tensordict as a module."""

    def __init__(self, function: Callable[[TensorDictBase], TensorDictBase]) -> None:
        super().__init__()
        self.function = function
        self.in_keys: list[str] = []
        self.out_keys = ["action"]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the actions."""
        return self.function(tensordict)


class FunctionPolicy(TensorDictModuleBase):
    """A torch module or function of the observation as a module of tensordicts."""

    def __init__(
        self, function: Callable[..., Any], satellite: SatelliteGroup, with_mask: bool, title: str | None = None
    ) -> None:
        """Call ``function``, in messages ``title``, for ``satellite``, ``with_mask`` as its second argument or not."""
        super().__init__()
        self.function, self.title, self.is_real = function, title or described(function), form(satellite) is not None
        self.observed = satellite.observation_description
        if with_mask and self.is_real:
            raise TypeError(f"{self.title} takes two arguments; real actions of {satellite.name} have no action mask")
        self.n_actions = int(form(satellite).width) if self.is_real else satellite.actions.n_actions  # type: ignore[union-attr]
        self.with_mask = with_mask
        self.in_keys, self.out_keys = ["observation", *([] if self.is_real else ["action_mask"])], ["action"]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write ``action``, [B] or [B, A]; ValueError for results of another shape."""
        inputs = self._inputs(tensordict["observation"])
        mask = [tensordict["action_mask"]] if self.with_mask else []
        return tensordict.set("action", self._action(self._result(inputs, *mask), tensordict))

    def _result(self, inputs: Any, *mask: Tensor) -> object:
        return self.function(inputs, *mask)

    def _inputs(self, observation: Any) -> object:
        """Return the observation in the type of a module's weights."""
        weights = next(self.function.parameters(), None) if isinstance(self.function, nn.Module) else None
        return map_leaves(observation, lambda part: part if weights is None else part.to(weights))

    def _action(self, result: object, tensordict: TensorDictBase) -> Tensor:
        shape, device = tuple(tensordict.batch_size), tensordict.device
        try:
            action = torch.as_tensor(result, device=device)
        except (TypeError, ValueError, RuntimeError) as error:
            raise TypeError(f"{self.title} returns {described(result)}; it must return a tensor of actions") from error
        if action.is_floating_point() and action.shape[:1] == shape[:1] and bool(action.isnan().any()):
            row = int(action.reshape(len(action), -1).isnan().any(-1).nonzero()[0])
            raise DecisionError(f"{self.title} returns NaN for the observation {self._shown(tensordict['observation'], row)}")
        scores = (*shape, self.n_actions)
        if self.is_real and action.shape == scores:
            return action.to(torch.float32)
        if not self.is_real and action.is_floating_point() and action.shape == scores:
            return action.masked_fill(~tensordict["action_mask"], -torch.inf).argmax(-1)
        if not self.is_real and not action.is_floating_point() and action.shape in (shape, (*shape, 1)):
            return action.reshape(shape).long()
        allowed = (
            f"real numbers {list(scores)}" if self.is_real else f"numbers of actions {list(shape)}, or scores {list(scores)}"
        )
        raise DecisionError(f"{self.title} returns {action.dtype} {list(action.shape)}; it must return {allowed}")

    def _shown(self, observation: Any, row: int) -> str:
        """Return an observation with its names, those of numbers that are not finite first."""
        parts = [observation] if isinstance(observation, Tensor) else flat(map_leaves(observation, lambda part: part)).values()
        values = torch.cat([part[row].reshape(-1).double() for part in parts]).tolist()
        names = self.observed if isinstance(observation, Tensor) else [""] * len(values)
        pairs = sorted(zip(names, values, strict=False), key=lambda pair: isfinite(pair[1]))
        listed = ", ".join(f"{name}={value:.4g}" if name else f"{value:.4g}" for name, value in pairs[:MOST_SHOWN])
        return listed + ", ..." * (len(pairs) > MOST_SHOWN)


class ModelPolicy(FunctionPolicy):
    """A model of Stable-Baselines3 as a module of tensordicts; models of sb3-contrib that take masks get them."""

    def __init__(self, model: Model, satellite: SatelliteGroup) -> None:
        masked = "action_masks" in inspect.signature(model.predict).parameters
        title = f"the model {type(model).__name__}"
        super().__init__(model.predict, satellite, masked and form(satellite) is None, title)

    def _inputs(self, observation: Any) -> object:
        """Return the observation as :class:`~bsk_torch.wrappers.stable_baselines3.SB3VecEnv` does."""
        if isinstance(observation, Tensor):
            return observation.cpu().numpy()
        return flat_rows(map_leaves(observation, lambda part: part.cpu().numpy()), len(observation.batch_size))

    def _result(self, inputs: Any, *mask: Tensor) -> object:
        masks = {"action_masks": mask[0].cpu().numpy()} if mask else {}
        action, state = self.function(inputs, deterministic=exploration_type() is not ExplorationType.RANDOM, **masks)
        if state is not None:
            raise TypeError(f"{self.title} has a memory, which is not passed on between decisions; {WRITE}")
        return action
