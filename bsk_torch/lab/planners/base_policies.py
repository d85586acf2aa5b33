"""Base policies of planners, by name or as modules."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import TypeAlias

from tensordict.nn import TensorDictModuleBase

from bsk_torch.env import Tasking
from bsk_torch.rl.policies.loading import load_policy
from bsk_torch.rl.policies.shared_policy import as_policy, baseline, shared
from bsk_torch.rl.rules.baselines import BASELINES
from bsk_torch.sim.arguments.values import nearest
from bsk_torch.wrappers.policies import Actor

Base: TypeAlias = "Actor | str | Path | None"
"""What :func:`~bsk_torch.rl.policies.as_policy` takes, the name or the file of a policy, or None for
the first applicable rule of :data:`USUAL`."""

USUAL = ("cooperative", "hasty", "rule", "survey", "drift", "random")
"""Rules, the best first."""


def base_of(base: Base, env: Tasking) -> TensorDictModuleBase:
    """Return the base policy of a planner for all agents of ``env``.

    Args:
        base: What :func:`~bsk_torch.load_policy` or :func:`~bsk_torch.rl.policies.as_policy` takes, such as ``"hasty"`` or a run
            folder; or None for the first applicable rule of :data:`USUAL`.
        env: The environment.

    Raises:
        TypeError: For anything else.
        ValueError: For an unknown name, or a policy for another environment.
    """
    if base is None:
        for name in USUAL:
            with suppress(KeyError, ValueError):
                return shared(baseline(name, env), env)
        raise ValueError("base=None: none of the rules fits the environment; give a policy")
    if not isinstance(base, str | Path):
        return as_policy(base, env)
    try:
        return load_policy(base, env)
    except FileNotFoundError as error:
        raise ValueError(f"base={str(base)!r} is no policy; {nearest(str(base), BASELINES)}") from error
    except ValueError as error:
        raise ValueError(f"base={str(base)!r}: {error}") from error
