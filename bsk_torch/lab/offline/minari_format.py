"""Datasets in Minari's format, written and read by Minari. Needs the extra minari."""

from __future__ import annotations

import os
import tempfile
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
from tensordict import TensorDict
from torch import Tensor

from bsk_torch.lab.offline.behaviors import Behavior, slug
from bsk_torch.lab.offline.layout import EPISODE, LOG_PROB
from bsk_torch.lab.offline.recipe import Recipe

ROOT = "MINARI_DATASETS_PATH"
"""Environment variable that names Minari's root folder."""

TRIAL = "bsk_torch/trial-v0"
"""Name of the dataset with which an installed version is tried."""


def minari_id(preset: str, behavior: str) -> str:
    """Return the name of a behavior's dataset for ``minari.load_dataset``, such as ``bsk_torch/NadirScan-v1/rule-v0``."""
    return f"bsk_torch/{preset}/{slug(behavior)}-v0"


def check_minari() -> None:
    """Write and read a dataset of two decisions, so that a version that cannot is found before hours are spent.

    Raises:
        ImportError: If Minari or h5py is missing, or the installed version does not read what it writes.
    """
    spaces = gymnasium.spaces.Box(-1.0, 1.0, (2,), np.float32), gymnasium.spaces.Discrete(2)
    observations, actions = np.array([[0.0, 0.5], [0.25, 0.0], [1.0, -1.0]], dtype=np.float32), np.array([1, 0])
    entries: dict[str, Any] = {"observations": observations, "actions": actions, "rewards": np.array([0.5, -1.0])}
    ends: dict[str, Any] = {
        "terminations": np.array([False, True]),
        "truncations": np.zeros(2, dtype=bool),
        "infos": {"duration": np.zeros(3)},
    }
    try:
        with tempfile.TemporaryDirectory() as folder, _root(Path(folder)) as minari:
            buffer = import_module("minari.data_collector").EpisodeBuffer(seed=7, **entries, **ends)
            minari.create_dataset_from_buffers(TRIAL, [buffer], observation_space=spaces[0], action_space=spaces[1])
            copy = next(iter(minari.load_dataset(TRIAL)))
            equal = all(np.array_equal(getattr(copy, name), value) for name, value in (entries | ends).items() if name != "infos")
    except ModuleNotFoundError as error:
        raise ImportError(f"Minari's format needs {error.name}; pip install 'bsk_torch[minari]'") from error
    except Exception as error:
        raise ImportError(f"{_installed()} cannot write and read a dataset ({error}); pip install 'bsk_torch[minari]'") from error
    if not equal:
        raise ImportError(f"{_installed()} does not read what it writes; pip install 'bsk_torch[minari]'")


def write_minari(root: Path, transitions: TensorDict, recipe: Recipe, behavior: Behavior) -> str:
    """Write the transitions [T] of a behavior as a dataset of Minari; return its name.

    The entries of Gymnasium's ``info`` at an observation are ``action_mask``, ``duration``, the time since the one before, and
    ``action_log_prob`` of the action before.

    Args:
        root: Minari's root folder.
        transitions: Decisions, one episode after the other.
        recipe: Settings of the dataset.
        behavior: The behavior.
    """
    spec = gymnasium.spec(f"bsk_torch/{recipe.preset}")
    spec.kwargs = {**spec.kwargs, **recipe.options}
    name = minari_id(recipe.preset, behavior.name)
    sizes = torch.bincount(transitions[EPISODE]).tolist()
    with _root(root) as minari:
        about = f"Episodes of {recipe.preset} of bsk_torch with the policy {behavior.name}."
        dataset = minari.create_dataset_from_buffers(
            name, [], env=spec, algorithm_name=behavior.name, description=about, requirements=["bsk_torch"]
        )
        dataset.storage.update_episodes(_buffers(transitions, sizes, recipe))
    return name


def _buffers(transitions: TensorDict, sizes: list[int], recipe: Recipe) -> Iterator[object]:
    buffer = import_module("minari.data_collector").EpisodeBuffer
    for k, (seed, episode) in enumerate(zip(recipe.seeds, transitions.split(sizes), strict=True)):
        yield buffer(
            id=k,
            seed=int(seed),
            observations=_with_last(episode, "observation"),
            actions=episode["action"].numpy(),
            rewards=_column(episode["next", "reward"]),
            terminations=_column(episode["next", "terminated"]),
            truncations=_column(episode["next", "truncated"]),
            infos={
                "action_mask": _with_last(episode, "action_mask").astype(np.int8),
                "duration": _with_last(episode, "duration").squeeze(1),
                LOG_PROB: np.concatenate([np.zeros(1, np.float32), episode[LOG_PROB].numpy()]),
            },
        )


def _with_last(episode: TensorDict, key: str) -> Any:
    """Return what is observed at the n decisions of an episode, and at its end, [n + 1]: an array, or a dictionary of arrays."""
    values = torch.cat([episode[key], episode["next", key][-1:]])
    return values.numpy() if isinstance(values, Tensor) else values.to_dict(convert_tensors=True)


def _column(value: Tensor) -> np.ndarray:
    return value.squeeze(1).numpy()


@contextmanager
def _root(folder: Path) -> Iterator[Any]:
    """Yield Minari, whose root folder is ``folder`` meanwhile; its hints about authors are not shown."""
    minari = import_module("minari")
    before = os.environ.get(ROOT)
    os.environ[ROOT] = str(folder.absolute())
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            yield minari
    finally:
        if before is None:
            os.environ.pop(ROOT)
        else:
            os.environ[ROOT] = before


def _installed() -> str:
    return f"Minari {import_module('minari').__version__}"
