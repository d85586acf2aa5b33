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
"""Folder of the policies, ``PRESET.pt``, and of their notes."""

INDEX = "policies.json"
"""File of the notes, which ``bsk-torch publish`` writes."""


@cache
def makings() -> dict[str, dict[str, Any]]:
    """Return how each policy was trained and its score, by preset.

    ``command``, ``seed``, ``frames``, ``seconds`` and ``machine`` of the training; ``score``, the mean ``return`` with the half
    width of its 95 % interval and the ``survival`` in ``episodes`` fresh episodes; and ``first``, the returns of the first few.
    """
    return json.loads((FOLDER / INDEX).read_text())


def pretrained_file(preset: str) -> Path:
    """File of the policy for ``preset``; ValueError, with the nearest name, where there is none."""
    if preset not in makings():
        names = sorted(makings())
        raise ValueError(f"there is no pretrained policy for {preset!r}; there are {', '.join(names)}; {nearest(preset, names)}")
    return FOLDER / f"{preset}.pt"


def pretrained(preset: str, device: torch.device | str = "cpu") -> TensorDictModuleBase:
    """The policy for ``preset``: writes ``action`` into what its environment gives.

    It needs the options of its training environment, ``read_card(pretrained_file(preset))["options"]``, such as ``as_set=True``.
    Policies of constellations decide for one satellite; :func:`~bsk_torch.rl.policies.shared_policy.shared` applies them to all.
    """
    return load_policy(pretrained_file(preset), device)
