"""Actors and critics for given sizes of observations and actions, with masked categorical or bounded normal distributions."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

import torch
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictModuleBase, TensorDictSequential
from torch import Tensor, nn
from torchrl.data import Composite
from torchrl.modules import MLP, GRUModule, MaskedCategorical, ProbabilisticActor, TanhNormal, ValueOperator

from bsk_torch.env import SatelliteTasking
from bsk_torch.env.action_forms import form
from bsk_torch.rl.networks.attention import Encoder, SetActor, SetCritic
from bsk_torch.rl.networks.normaliser import CLOCK, MASK, OWN, ROWS, ObservationNormaliser, SetNormaliser, VectorNormaliser
from bsk_torch.rl.networks.precision import float32_weights
from bsk_torch.rl.rules.continuous import Bounds, bounds_of
from bsk_torch.rl.rules.targets import image_actions
from bsk_torch.sim.arguments.values import nearest

NORMALISER, ACTOR = "sight", "actor"
"""Keys of weights in policy files and checkpoints, as in release 0.1."""

MEMORY, INIT = "memory", "is_init"
"""Keys of the hidden state of a recurrent policy, and of the first step of an episode."""

INITIAL_LOGITS = 0.01
"""Factor on the last layer's initial weights, so that an untrained actor is nearly uniform."""

HEAD = 32
"""Width of an attention head."""

MOST_LAYERS = 64
"""Largest number of hidden layers or blocks."""

CLOCKS = 2
"""Number of values of the clock observed by critics."""

INITIAL_SCALE = 0.5
"""Initial standard deviation of actions, before they are squashed into their bounds."""

SCALES = (0.01, 2.0)
"""Minimum and maximum standard deviation."""


@dataclass(frozen=True)
class Networks:
    """A normalizer of observations, an actor and a critic."""

    normaliser: ObservationNormaliser
    actor: ProbabilisticActor
    critic: ValueOperator

    @property
    def policy(self) -> TensorDictSequential:
        """Module that writes ``action`` into a tensordict with ``observation`` and ``action_mask``.

        A recurrent policy also writes ``("next", "memory")`` and reads it as ``memory`` at the next decision; ``step_mdp`` moves
        it there.
        """
        unit = self.unit
        return TensorDictSequential(*([] if unit is None else [Recall(unit.gru.hidden_size)]), self.normaliser, self.actor)

    @property
    def unit(self) -> GRUModule | None:
        """Recurrent unit of the actor; None for other networks."""
        return next((part for part in self.actor.modules() if isinstance(part, GRUModule)), None)

    def to(self, device: torch.device | str) -> Networks:
        """Return the networks on a device."""
        return Networks(self.normaliser.to(device), self.actor.to(device), self.critic.to(device))

    def policy_state(self) -> dict[str, Any]:
        """Return the weights of the normalizer and the actor, as saved in policy files."""
        return {NORMALISER: self.normaliser.state_dict(), ACTOR: self.actor.state_dict()}

    def load_policy_state(self, state: Mapping[str, object]) -> None:
        """Load the result of :meth:`policy_state`; RuntimeError if it does not fit."""
        self.normaliser.load_state_dict(state[NORMALISER])
        self.actor.load_state_dict(state[ACTOR])


@dataclass(frozen=True)
class MLPPlan:
    """Sizes of plain networks for observation vectors.

    Continuous actions have ``bounds``, and ``n_actions`` is 0.
    """

    n_observed: int
    n_actions: int
    hidden: tuple[int, ...]
    bounds: Bounds = ()

    def __post_init__(self) -> None:
        check_layers(self.hidden)

    @classmethod
    def of(cls, env: SatelliteTasking, hidden: Sequence[int]) -> MLPPlan:
        """Return the plan for an environment; ValueError unless it observes one vector, or for actions with infinite bounds."""
        spec = env.observation_spec["observation"]
        if isinstance(spec, Composite):
            raise ValueError(
                "networks 'mlp' and 'gru' need the observation as one vector; build the satellite with obs_type=torch.Tensor"
            )
        return cls(spec.shape[-1], env.satellite.actions.n_actions, tuple(hidden), bounds_of(env))

    @property
    def n_outputs(self) -> int:
        """Outputs of the actor's network: a logit of each action, or a mean of each real number."""
        return len(self.bounds) or self.n_actions

    @float32_weights()
    def build(self) -> Networks:
        """Return new networks."""
        actor = self._layers(self.n_observed, self.n_outputs)
        self._calm(cast(nn.Linear, actor[-1]))
        return Networks(
            VectorNormaliser(self.n_observed), actor_of(_parameters(actor, [OWN], self.bounds), self.bounds), self._critic()
        )

    def _critic(self) -> ValueOperator:
        return ValueOperator(Clocked(self._layers(self.n_observed + CLOCKS, 1)), in_keys=[OWN, CLOCK])

    def _calm(self, last: nn.Linear) -> None:
        """Initialize an actor to be nearly uniform, or with continuous actions near the middle of their bounds."""
        with torch.no_grad():
            last.weight.mul_(INITIAL_LOGITS)
            if self.bounds:
                last.bias.zero_()

    def _layers(self, n_in: int, n_out: int) -> MLP:
        return MLP(in_features=n_in, out_features=n_out, num_cells=list(self.hidden), activation_class=Tanh)


@dataclass(frozen=True)
class GRUPlan(MLPPlan):
    """Sizes of networks with a recurrent actor: its last hidden layer is a gated recurrent unit.

    The critic, used only in training, depends on the current observation only.
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.hidden) < 2:
            raise ValueError(f"hidden={self.hidden}: network='gru' needs a layer before its unit, such as (64, 64)")

    @float32_weights()
    def build(self) -> Networks:
        """Return new networks."""
        *before, last = self.hidden
        layers = MLP(self.n_observed, before[-1], num_cells=before[:-1], activation_class=Tanh, activate_last_layer=True)
        unit = GRUModule(before[-1], last, in_keys=["embedded", MEMORY, INIT], out_keys=["remembered", ("next", MEMORY)])
        head = nn.Linear(last, self.n_outputs)
        self._calm(head)
        parts = [TensorDictModule(layers, [OWN], ["embedded"]), unit, _parameters(head, ["remembered"], self.bounds)]
        actor = actor_of(TensorDictSequential(*parts), self.bounds)
        return Networks(VectorNormaliser(self.n_observed), actor, self._critic())


class _Tanh(torch.autograd.Function):
    """Hyperbolic tangent by way of the logistic function, which torch computes six times as fast on a CPU."""

    @staticmethod
    def forward(ctx: Any, x: Tensor) -> Tensor:
        """2 / (1 + exp(-2 x)) - 1."""
        y = torch.sigmoid(2.0 * x).mul_(2.0).sub_(1.0)
        ctx.save_for_backward(y)
        return y

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> Tensor:
        """The gradient times (1 - y^2)."""
        (y,) = ctx.saved_tensors
        return torch.ops.aten.tanh_backward(gradients[0], y)


class Tanh(nn.Module):
    """What ``torch.nn.Tanh`` computes, within 2e-7 in float32. It has no weights, so files of policies fit both."""

    def forward(self, x: Tensor) -> Tensor:
        """Hyperbolic tangent of each number."""
        return _Tanh.apply(x)


class NormalParameters(nn.Module):
    """Computes means and standard deviations of normal distributions; the deviations do not depend on the observation."""

    def __init__(self, network: nn.Module, width: int) -> None:
        """Use ``network`` for the ``width`` means."""
        super().__init__()
        self.network = network
        self.log_scale = nn.Parameter(torch.full((width,), math.log(INITIAL_SCALE), dtype=torch.float32))

    def forward(self, *inputs: Tensor) -> tuple[Tensor, Tensor]:
        """Return means and standard deviations, [..., A] each; float32, whatever the precision of the network."""
        loc = self.network(*inputs).float()
        low, high = map(math.log, SCALES)
        return loc, self.log_scale.clamp(low, high).exp().expand_as(loc)


class Clocked(nn.Module):
    """A critic that receives the clock as additional features of the satellite."""

    def __init__(self, network: nn.Module) -> None:
        """Wrap ``network``, whose first input is the satellite's features, [..., D]."""
        super().__init__()
        self.network = network

    def forward(self, satellite: Tensor, *others: Tensor) -> Tensor:
        """Return values [..., 1] of the inputs, of which the last is the clock [..., 2]."""
        *parts, clock = others
        return self.network(torch.cat([satellite, clock], -1), *parts)


class Recall(TensorDictModuleBase):
    """Clears the memory of a recurrent policy at the start of an episode, when it is missing or ``is_init`` is True."""

    def __init__(self, width: int) -> None:
        """Set the size of the memory."""
        super().__init__()
        self.width = width
        self.in_keys: list[str] = []
        self.out_keys = [MEMORY, INIT]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the initial memory where needed."""
        shape, on = tensordict.batch_size, {"device": tensordict.device}
        if MEMORY not in tensordict.keys():  # noqa: SIM118  - a tensordict
            tensordict[MEMORY] = torch.zeros(*shape, 1, self.width, dtype=torch.float32, **on)
        if INIT not in tensordict.keys():  # noqa: SIM118
            tensordict[INIT] = torch.zeros(*shape, 1, dtype=torch.bool, **on)
        return tensordict


@dataclass(frozen=True)
class AttentionPlan:
    """Sizes of attention networks for observations with one set of targets, and the keys of this set.

    ``images`` are the first and the exclusive end of the actions that image the targets of the first rows. The networks fit any
    number of rows and images, not only that of the plan.
    """

    set_key: tuple[str, ...]
    own_keys: tuple[tuple[str, ...], ...]
    n_own: int
    n_features: int
    n_actions: int
    images: tuple[int, int]
    hidden: tuple[int, ...]

    @classmethod
    def of(cls, env: SatelliteTasking, hidden: Sequence[int]) -> AttentionPlan:
        """Return the plan for an environment; ValueError unless it observes one set that includes all targets to choose from."""
        if form(env.satellite) is not None:
            raise ValueError(
                f"network='attention' chooses targets; the actions of {env.satellite.name} are real numbers: use 'mlp'"
            )
        leaves, sets = _leaves(env), observed_sets(env)
        if len(sets) != 1:
            raise ValueError(
                f"network='attention' needs one observation with as_set=True and the satellite's obs_type=dict; "
                f"{env.satellite.name} has {len(sets)} such sets: use network='mlp' for vectors"
            )
        rows_key = (*sets[0], "rows")
        n_rows, n_features = leaves[rows_key][-2:]
        images = image_actions(env)
        if len(images) > n_rows:
            raise ValueError(f"network='attention': {len(images)} targets can be chosen, but only {n_rows} are observed")
        widths = {key: shape[1:].numel() for key, shape in leaves.items() if key[:-1] != sets[0]}
        n_actions = env.satellite.actions.n_actions
        return cls(
            sets[0], tuple(widths), sum(widths.values()), n_features, n_actions, (images.start, images.stop), tuple(hidden)
        )

    def __post_init__(self) -> None:
        check_layers(self.hidden)
        if not self.hidden or len(set(self.hidden)) > 1 or self.hidden[0] % HEAD:
            raise ValueError(f"hidden={self.hidden}: blocks of attention need equal widths, multiples of {HEAD}")

    @float32_weights()
    def build(self) -> Networks:
        """Return new networks."""
        width, keys = self.hidden[0], [OWN, ROWS, MASK]
        actor = SetActor(self._encoder(self.n_own, len(self.hidden)), width, self.n_actions, range(*self.images), INITIAL_LOGITS)
        critic = Clocked(SetCritic(self._encoder(self.n_own + CLOCKS, 0), width))
        normaliser = SetNormaliser(self.set_key, self.own_keys, self.n_own, self.n_features)
        acting = actor_of(_parameters(actor, [*keys, "action_mask"], ()), ())
        return Networks(normaliser, acting, ValueOperator(critic, in_keys=[*keys, CLOCK]))

    def with_images(self, number: int) -> AttentionPlan:
        """Return the plan of the same networks for another number of images."""
        first, end = self.images
        return replace(self, n_actions=self.n_actions - (end - first) + number, images=(first, first + number))

    def _encoder(self, n_own: int, blocks: int) -> Encoder:
        width = self.hidden[0]
        return Encoder(n_own, self.n_features, width, width // HEAD, blocks)


Plan = MLPPlan | GRUPlan | AttentionPlan

PLANS: dict[str, type[MLPPlan] | type[GRUPlan] | type[AttentionPlan]] = {
    "mlp": MLPPlan,
    "gru": GRUPlan,
    "attention": AttentionPlan,
}
"""Kinds of networks by name."""


def check_layers(hidden: Sequence[int]) -> None:
    """Raise ValueError for more hidden layers than :data:`MOST_LAYERS`, each of which takes time when networks are made."""
    if len(hidden) > MOST_LAYERS:
        raise ValueError(f"hidden has {len(hidden):,} layers; at most {MOST_LAYERS} are allowed")


def check_network(network: str) -> None:
    """Raise ValueError, with the nearest name, unless ``network`` is one of :data:`PLANS`."""
    if network not in PLANS:
        raise ValueError(f"network={network!r} must be one of {sorted(PLANS)}; {nearest(network, PLANS)}")


def observed_sets(env: SatelliteTasking) -> list[tuple[str, ...]]:
    """Return the keys of the sets that a satellite observes."""
    leaves = _leaves(env)
    return [key[:-1] for key in leaves if key[-1] == "rows" and (*key[:-1], "mask") in leaves]


def _leaves(env: SatelliteTasking) -> dict[tuple[str, ...], torch.Size]:
    """Return the shapes of the parts of a nested observation by key; empty for a vector."""
    spec = env.observation_spec["observation"]
    if not isinstance(spec, Composite):
        return {}
    keys = [key if isinstance(key, tuple) else (key,) for key in spec.keys(True, True)]
    return {("observation", *key): spec[key].shape for key in keys}


def _parameters(network: nn.Module, in_keys: list[NestedKey], bounds: Bounds) -> TensorDictModule:
    if not bounds:
        return TensorDictModule(network, in_keys=in_keys, out_keys=["logits"])
    return TensorDictModule(NormalParameters(network, len(bounds)), in_keys=in_keys, out_keys=["loc", "scale"])


def actor_of(module: TensorDictModuleBase, bounds: Bounds) -> ProbabilisticActor:
    """Return an actor with a categorical distribution over the legal actions, or a normal one squashed into ``bounds``.

    The ``module`` writes ``logits`` [..., A]; for bounded continuous actions ``loc`` and ``scale``, [..., A] each.
    """
    if not bounds:
        return ProbabilisticActor(
            module,
            in_keys={"logits": "logits", "mask": "action_mask"},
            out_keys=["action"],
            distribution_class=MaskedCategorical,
            return_log_prob=True,
        )
    low, high = torch.tensor(bounds, dtype=torch.float32).unbind(-1)
    return ProbabilisticActor(
        module,
        in_keys=["loc", "scale"],
        out_keys=["action"],
        distribution_class=TanhNormal,
        distribution_kwargs={"low": low, "high": high},
        return_log_prob=True,
    )
