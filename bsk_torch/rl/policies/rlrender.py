r"""Factories for ``rlrender``, TorchRL's command that films policies from their files.

For example, in a shell::

    factories=bsk_torch.rl.policies.rlrender
    rlrender --ckpt runs/scan/policy.pt --no-auto-load-policy \
        --env $factories:make_env --policy $factories:make_policy --out scan.gif

The environment is the one of the training; ``--env-kwargs '{"time_limit": 1200.0}'`` changes its options, and ``--seed`` selects
the episodes. Frames are those of :meth:`bsk_torch.env.Tasking.render`, one for each step; ``--max-steps`` limits them.
"""

from __future__ import annotations

from tensordict.nn import TensorDictModuleBase
from torchrl.render import RenderConfig

from bsk_torch.env import Tasking
from bsk_torch.presets import make
from bsk_torch.rl.policies.files import build_policy, check_fits, read_card
from bsk_torch.rl.policies.shared_policy import shared

__all__ = ["make_env", "make_policy"]


def make_env(config: RenderConfig) -> Tasking:
    """Return the environment, with one row, in which the policy of ``config.ckpt`` was trained.

    Raises:
        ValueError: For a file that is not a policy, and for options that the environment does not have.
    """
    card = read_card(config.ckpt)
    options = {**card["options"], "device": str(config.env_device or config.device), **config.env_kwargs}
    return make(card["preset"], num_envs=1, **options)


def make_policy(config: RenderConfig, env: Tasking) -> TensorDictModuleBase:
    """Return the policy of ``config.ckpt``, which acts for all satellites of an environment with its most probable actions.

    Raises:
        ValueError: For a policy that does not fit the environment.
    """
    base = getattr(env, "base_env", env)
    card = read_card(config.ckpt)
    check_fits(card, base)
    return shared(build_policy(card, str(config.policy_device or config.device)), base)
