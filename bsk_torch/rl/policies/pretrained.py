"""Policies included in the package, one for each trained preset, and how they were trained."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import Any

import torch
from tensordict.nn import TensorDictModuleBase

from bsk_torch.rl.policies.files import load_policy
from bsk_torch.sim.arguments.values import nearest

FOLDER = Path(__file__).parent
"""Folder of the policies, ``PRESET.pt``, and their metadata."""

INDEX = "policies.json"
"""Metadata file, written by ``bsk-torch publish``."""


@cache
def makings() -> dict[str, dict[str, Any]]:
    """Return the training and the score of each policy, by preset.

    Entries are ``command``, ``seed``, ``frames``, ``seconds`` and ``machine`` of the training; ``score`` with the mean
    ``return``, the half width of its 95 % interval and the ``survival`` in ``episodes`` unseen episodes; and ``first``, the
    returns of the first few episodes.
    """
    return json.loads((FOLDER / INDEX).read_text())


def pretrained_file(preset: str) -> Path:
    """Return the path of the policy for ``preset``; ValueError, with the nearest name, if there is none."""
    if preset not in makings():
        names = sorted(makings())
        raise ValueError(f"there is no pretrained policy for {preset!r}; there are {', '.join(names)}; {nearest(preset, names)}")
    return FOLDER / f"{preset}.pt"


def pretrained(preset: str, device: torch.device | str = "cpu") -> TensorDictModuleBase:
    """Return the pretrained policy for ``preset``, a module that writes ``action`` into the environment's tensordict.

    The environment needs the options used in training, ``read_card(pretrained_file(preset))["options"]``, such as
    ``as_set=True``, but policies with attention choose among any number of targets, ``n_ahead`` in presets. Policies for
    constellations act for one satellite; :func:`~bsk_torch.rl.policies.shared_policy.shared` applies them to all.
    """
    return load_policy(pretrained_file(preset), device)
