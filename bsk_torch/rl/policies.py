"""Masked categorical actors, critics, and policies that are kept in a file."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch import nn
from torchrl.data import Composite
from torchrl.modules import MLP, MaskedCategorical, ProbabilisticActor, ValueOperator

from bsk_torch.env import SatelliteTasking
from bsk_torch.rl.attention import Encoder, SetActor, SetCritic
from bsk_torch.rl.sight import MASK, OWN, ROWS, SetSight, Sight, VectorSight
from bsk_torch.rl.targets import image_actions
from bsk_torch.sim.params import nearest

INITIAL_LOGITS = 0.01
"""Factor on the last layer's initial weights, so that an untrained actor is nearly uniform."""

HEAD = 32
"""Width of an attention head."""


@dataclass(frozen=True)
class Networks:
    """What sees, what acts and what judges."""

    sight: Sight
    actor: ProbabilisticActor
    critic: ValueOperator

    @property
    def policy(self) -> TensorDictSequential:
        """Writes ``action`` into a tensordict with ``observation`` and ``action_mask``."""
        return TensorDictSequential(self.sight, self.actor)

    def to(self, device: torch.device | str) -> Networks:
        """The networks, moved to a device."""
        return Networks(self.sight.to(device), self.actor.to(device), self.critic.to(device))


@dataclass(frozen=True)
class MLPPlan:
    """Sizes of plain networks for observation vectors."""

    n_observed: int
    n_actions: int
    hidden: tuple[int, ...]

    @classmethod
    def of(cls, env: SatelliteTasking, hidden: Sequence[int]) -> MLPPlan:
        """For an environment; ValueError unless it observes one vector."""
        spec = env.observation_spec["observation"]
        if isinstance(spec, Composite):
            raise ValueError("network='mlp' needs the observation as one vector; build the satellite with obs_type=torch.Tensor")
        return cls(spec.shape[-1], env.satellite.actions.n_actions, tuple(hidden))

    def build(self) -> Networks:
        """Fresh networks."""
        actor, critic = (self._layers(n) for n in (self.n_actions, 1))
        with torch.no_grad():
            actor[-1].weight.mul_(INITIAL_LOGITS)
        return Networks(VectorSight(self.n_observed), _actor(actor, [OWN]), ValueOperator(critic, in_keys=[OWN]))

    def _layers(self, n_out: int) -> MLP:
        return MLP(in_features=self.n_observed, out_features=n_out, num_cells=list(self.hidden), activation_class=nn.Tanh)


@dataclass(frozen=True)
class AttentionPlan:
    """Sizes of attention networks for observations with one set of targets, and where to find that set.

    ``images`` are the first and the end of the actions that image the targets of the first rows.
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
        """For an environment; ValueError unless it observes one set, of at least as many targets as can be chosen."""
        leaves = _leaves(env)
        sets = [key[:-1] for key in leaves if key[-1] == "rows" and (*key[:-1], "mask") in leaves]
        if len(sets) != 1:
            raise ValueError(
                f"network='attention' needs one observation with as_set=True and the satellite's obs_type=dict; found {len(sets)}"
            )
        n_rows, n_features = leaves[(*sets[0], "rows")][-2:]
        images = image_actions(env)
        if len(images) > n_rows:
            raise ValueError(f"network='attention': {len(images)} targets can be chosen, but only {n_rows} are observed")
        own = {key: shape[1:].numel() for key, shape in leaves.items() if key[:-1] != sets[0]}
        n_actions = env.satellite.actions.n_actions
        return cls(sets[0], tuple(own), sum(own.values()), n_features, n_actions, (images.start, images.stop), tuple(hidden))

    def __post_init__(self) -> None:
        """ValueError for widths that cannot be shared out among heads."""
        if not self.hidden or len(set(self.hidden)) > 1 or self.hidden[0] % HEAD:
            raise ValueError(f"hidden={self.hidden}: blocks of attention need equal widths, multiples of {HEAD}")

    def build(self) -> Networks:
        """Fresh networks."""
        width, keys = self.hidden[0], [OWN, ROWS, MASK]
        actor = SetActor(self._encoder(len(self.hidden)), width, self.n_actions, range(*self.images), INITIAL_LOGITS)
        critic = SetCritic(self._encoder(0), width)
        sight = SetSight(self.set_key, self.own_keys, self.n_own, self.n_features)
        return Networks(sight, _actor(actor, keys), ValueOperator(critic, in_keys=keys))

    def _encoder(self, blocks: int) -> Encoder:
        width = self.hidden[0]
        return Encoder(self.n_own, self.n_features, width, width // HEAD, blocks)


Plan = MLPPlan | AttentionPlan

PLANS: dict[str, type[MLPPlan] | type[AttentionPlan]] = {"mlp": MLPPlan, "attention": AttentionPlan}
"""Kinds of networks by name."""


def check_network(network: str) -> None:
    """ValueError, with the nearest name, unless ``network`` is one of :data:`PLANS`."""
    if network not in PLANS:
        raise ValueError(f"network={network!r} must be one of {sorted(PLANS)}; {nearest(network, PLANS)}")


def _leaves(env: SatelliteTasking) -> dict[tuple[str, ...], torch.Size]:
    """Shapes of the parts of a nested observation, by key; empty for a vector."""
    spec = env.observation_spec["observation"]
    if not isinstance(spec, Composite):
        return {}
    keys = [key if isinstance(key, tuple) else (key,) for key in spec.keys(True, True)]
    return {("observation", *key): spec[key].shape for key in keys}


def _actor(network: nn.Module, in_keys: list[Any]) -> ProbabilisticActor:
    """Categorical distribution over the legal actions, by a network that gives logits [..., A]."""
    return ProbabilisticActor(
        TensorDictModule(network, in_keys=in_keys, out_keys=["logits"]),
        in_keys={"logits": "logits", "mask": "action_mask"},
        out_keys=["action"],
        distribution_class=MaskedCategorical,
        return_log_prob=True,
    )


def save_policy(path: Path, plan: Plan, networks: Networks) -> None:
    """Write what :func:`load_policy` needs."""
    kind = next(name for name, known in PLANS.items() if isinstance(plan, known))
    kept = {"sight": networks.sight.state_dict(), "actor": networks.actor.state_dict()}
    torch.save({"network": kind, "plan": dataclasses.asdict(plan), **kept}, path)


def load_policy(path: Path, device: torch.device | str = "cpu") -> TensorDictSequential:
    """The policy of a file that training has written."""
    kept = torch.load(path, weights_only=True, map_location=device)
    networks = PLANS[kept["network"]](**kept["plan"]).build().to(device)
    networks.sight.load_state_dict(kept["sight"])
    networks.actor.load_state_dict(kept["actor"])
    return networks.policy
