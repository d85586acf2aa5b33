"""Error messages with replacements for Gymnasium's methods and attributes."""

from __future__ import annotations

from typing import NoReturn

from tensordict import TensorDictBase

VIEW = "bsk_torch.wrappers.GymEnv(env), or gymnasium.make('bsk_torch/...'), is Gymnasium's view of one episode"

ATTRIBUTES = {
    "observation_space": f"read env.observation_spec; {VIEW}",
    "action_space": f"read env.action_spec, whose rand() draws actions for all episodes; {VIEW}",
    "single_observation_space": "read env.observation_spec; GymVectorEnv(env) is Gymnasium's view of the batch",
    "single_action_space": "read env.action_spec; GymVectorEnv(env) is Gymnasium's view of the batch",
    "unwrapped": "it is not wrapped: use env itself (below TorchRL's transforms: env.base_env)",
    "np_random": "draws are counter-based: env.set_seed(1) seeds them",
    "spec": "read env.specs",
    "get_satellite": "env.satellites has the satellite of each type, whose names tell which episodes' satellites it stands for; "
    "the Gymnasium and PettingZoo views have get_satellite(name)",
    "latest_step_duration": "read 'duration' in what env.step(td) returns",
    "world_args": "they are options of the constructor; env.default_world_args() lists them",
    "sim_rate": "read env.options.sim_rate",
    "possible_agents": "env.agents names all agents; the PettingZoo view has possible_agents",
}
"""Attributes of Gymnasium's and PettingZoo's environments, and their replacements."""

RESET = {
    "seed": "env.set_seed(seed), then env.reset(): the next episodes are then the first of that seed; GymEnv.reset takes a seed",
    "options": "env.reset() without it; env.reset(TensorDict({'state': state}, env.batch_size), set_state=True) restores a state",
}
"""Arguments of Gymnasium's ``reset``, and their replacements."""


def check_reset(kind: str, arguments: dict[str, object]) -> None:
    """Raise TypeError for arguments not accepted by ``reset`` of the class ``kind``."""
    for name in arguments:
        advice = f"write {RESET[name]}" if name in RESET else "it takes a tensordict and set_state"
        raise TypeError(f"{kind}.reset({name}=...) is not an argument of TorchRL's reset; {advice}")


def given_action(tensordict: TensorDictBase, *key: str) -> object:
    """Return the action in a tensordict, a tensor or its parts; KeyError if it is missing."""
    action = tensordict.get(key if len(key) > 1 else key[0], None)
    if action is None:
        name = ", ".join(map(repr, key))
        raise KeyError(
            f"step got a tensordict without the action td[{name}]; set it: td[{name}] = actions, such as those of "
            f"env.action_spec.rand(); it has {sorted(map(str, tensordict.keys()))}"
        )
    return action


def reject_call(kind: str, key: str, received: object, batch: list[int], shape: list[int]) -> NoReturn:
    """Raise an error for an argument of ``step`` or ``reset`` of the class ``kind`` other than a tensordict [*batch].

    Args:
        kind: Name of the class of the environment.
        key: Key of its actions.
        received: The argument.
        batch: Batch size of the environment.
        shape: Shape of its actions.

    Raises:
        ValueError: For a tensordict of another batch size.
        TypeError: For anything else.
    """
    if isinstance(received, TensorDictBase):
        raise ValueError(
            f"{kind} got a tensordict of batch size {list(received.batch_size)}; step and reset need {batch}, with actions "
            f"td[{key}] of shape {shape}"
        )
    raise TypeError(
        f"{kind} is an environment of TorchRL, whose step and reset take a tensordict, not {received!r}: td = env.reset(); "
        f"td[{key}] = actions; td = env.step(td)['next']. For observation, reward, terminated, truncated, "
        f"info = env.step(action): {VIEW}"
    )
