"""Masked categorical actors, critics, and policies that are kept in a file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
from tensordict.nn import TensorDictModule, TensorDictModuleBase, TensorDictSequential
from torch import nn
from torchrl.data import Composite
from torchrl.envs import ObservationNorm, VecNormV2
from torchrl.modules import MLP, MaskedCategorical, ProbabilisticActor, ValueOperator

from bsk_torch.env import SatelliteTasking

NORMALISED = "observation_normalised"
"""Key of what the networks see."""

INITIAL_LOGITS = 0.01
"""Factor on the last layer's initial weights, so that an untrained actor is nearly uniform."""

FLOOR = 1e-4
"""Least standard deviation that observations are divided by."""


def sizes(env: SatelliteTasking) -> tuple[int, int]:
    """Width of the observation vector and number of actions; ValueError unless the observation is one vector."""
    spec = env.observation_spec["observation"]
    if isinstance(spec, Composite):
        raise ValueError("the networks need the observation as one vector; build the satellite with obs_type=torch.Tensor")
    return spec.shape[-1], env.satellite.actions.n_actions


def make_normaliser() -> VecNormV2:
    """Running mean and deviation of all observations [N, F], as a transform of the environment."""
    return VecNormV2(in_keys=["observation"], out_keys=[NORMALISED], decay=1.0, eps=FLOOR, reduce_batch_dims=True)


def make_actor(n_observed: int, n_actions: int, hidden: Sequence[int]) -> ProbabilisticActor:
    """Observation to a categorical distribution over the legal actions.

    Args:
        n_observed: Width of the observation.
        n_actions: Number of actions.
        hidden: Width of every hidden layer.
    """
    network = MLP(in_features=n_observed, out_features=n_actions, num_cells=list(hidden), activation_class=nn.Tanh)
    with torch.no_grad():
        network[-1].weight.mul_(INITIAL_LOGITS)
    return ProbabilisticActor(
        TensorDictModule(network, in_keys=[NORMALISED], out_keys=["logits"]),
        in_keys={"logits": "logits", "mask": "action_mask"},
        out_keys=["action"],
        distribution_class=MaskedCategorical,
        return_log_prob=True,
    )


def make_critic(n_observed: int, hidden: Sequence[int]) -> ValueOperator:
    """Observation to expected discounted return; see :func:`make_actor`."""
    network = MLP(in_features=n_observed, out_features=1, num_cells=list(hidden), activation_class=nn.Tanh)
    return ValueOperator(network, in_keys=[NORMALISED])


def make_policy(actor: ProbabilisticActor, loc: torch.Tensor, scale: torch.Tensor) -> TensorDictSequential:
    """An actor that reads ``observation`` itself, normalised with fixed mean ``loc`` [F] and deviation ``scale`` [F]."""
    fixed = ObservationNorm(
        loc=loc.clone(), scale=scale.clone(), in_keys=["observation"], out_keys=[NORMALISED], standard_normal=True
    )
    return TensorDictSequential(fixed, actor)


def save_policy(path: Path, policy: TensorDictSequential, hidden: Sequence[int]) -> None:
    """Write what :func:`load_policy` needs."""
    fixed, actor = policy[0], policy[1]
    logits: Any = actor[0].module
    shape = {"n_observed": logits.in_features, "n_actions": logits.out_features, "hidden": list(hidden)}
    torch.save({"shape": shape, "loc": fixed.loc, "scale": fixed.scale, "actor": actor.state_dict()}, path)


def load_policy(path: Path, device: torch.device | str = "cpu") -> TensorDictModuleBase:
    """The policy of a file that training has written."""
    kept = torch.load(path, weights_only=True, map_location=device)
    actor = make_actor(**kept["shape"]).to(device)
    actor.load_state_dict(kept["actor"])
    return make_policy(actor, kept["loc"], kept["scale"])
