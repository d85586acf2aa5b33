"""Checkpoints of RLlib's new API stack: of an algorithm, or of an ``RLModule``."""

from __future__ import annotations

from math import prod
from pathlib import Path

import torch
from torch import Tensor

from bsk_torch.env import Tasking
from bsk_torch.rl.policies.interface import MASK, OBSERVATION, Interface, Loaded
from bsk_torch.untrusted import MOST_JSON, parse_json, read_bytes
from bsk_torch.wrappers.policies import Actor

METADATA = ("rllib_checkpoint.json", "metadata.json")
"""Files in the folder of a checkpoint; the first one is that of an algorithm."""

MODULES = Path("learner_group", "learner", "rl_module")
"""Folder of the modules in the checkpoint of an algorithm."""

OBSERVATIONS = "observations"
"""Entry with the observation in those of RLlib's modules that take masks."""


def is_checkpoint(path: Path) -> bool:
    """Return whether a folder is a checkpoint of RLlib."""
    return any((path / name).is_file() for name in METADATA) and (path / "class_and_ctor_args.pkl").is_file()


def module_folder(path: Path) -> Path:
    """Return the folder of the only module in a checkpoint; ValueError for several, which have to be named."""
    folder = path / MODULES if (path / MODULES).is_dir() else path
    inner = sorted(part for part in folder.iterdir() if is_checkpoint(part))
    if len(inner) > 1:
        raise ValueError(f"{str(path)!r} has several modules; name one of {', '.join(map(str, inner))}")
    return inner[0] if inner else folder


def read_checkpoint(path: Path) -> Loaded:
    """Read the module of a checkpoint; ValueError for a damaged one. Unpickles it.

    Its most probable actions, or the means of real ones, are the policy. Connectors are not part of a module.
    """
    try:
        from ray.rllib.core.columns import Columns
        from ray.rllib.core.rl_module.rl_module import RLModule
    except ImportError as error:
        raise ModuleNotFoundError(
            "a checkpoint of RLlib needs Ray, which wants its own environment: pip install 'ray[rllib]==2.60.0'"
        ) from error
    about = next(path / name for name in METADATA if (path / name).is_file())
    try:
        release = parse_json(read_bytes(about, MOST_JSON), dict[str, object]).get("ray_version", "")
        module = RLModule.from_checkpoint(module_folder(path).absolute())
    except ValueError:
        raise
    except Exception as error:  # unpickling may raise anything
        raise ValueError(f"{str(path)!r} is no checkpoint of RLlib: {type(error).__name__}: {error}") from error
    space, action = module.observation_space, module.action_space
    parts = dict(space.spaces) if hasattr(space, "spaces") else {OBSERVATION: space}
    is_masked = parts.keys() == {OBSERVATIONS, MASK}
    names = {OBSERVATIONS: OBSERVATION} if is_masked else {}
    inputs: dict[str, int | None] = {names.get(name, name): prod(space.shape) for name, space in parts.items()}
    count = int(action.n) if hasattr(action, "n") else prod(action.shape)
    interface = Interface(f"the module {str(path)!r}", inputs, count, not hasattr(action, "n"))

    def act(observed: list[Tensor], mask: Tensor | None) -> Tensor:
        tensors = [part.float().cpu() for part in observed]
        batch = dict(zip(parts, tensors, strict=True)) if hasattr(space, "spaces") else tensors[0]
        output = module.forward_inference({Columns.OBS: batch})
        if Columns.ACTION_DIST_INPUTS not in output:
            return torch.as_tensor(output[Columns.ACTIONS])
        scores = output[Columns.ACTION_DIST_INPUTS]
        if hasattr(action, "n"):
            return scores if is_masked or bool(scores.isnan().any()) else scores.argmax(-1)
        low, high = torch.as_tensor(action.low), torch.as_tensor(action.high)
        return scores[:, :count].clamp(low, high)

    def fit(env: Tasking, where: str) -> Actor:
        return interface.policy(env, where, act)

    return Loaded(fit, f"ray {release}".strip() if str(release).isprintable() else "ray")
