"""Policies that come with the package, one for each preset that has been trained, and how they were made."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import Any

import torch
from tensordict.nn import TensorDictSequential

from bsk_torch.rl.policies import load_policy
from bsk_torch.sim.params import nearest

FOLDER = Path(__file__).with_name("policies")
"""Where ``PRESET.pt`` lie, and ``policies.json``, which ``scripts/publish_policy.py`` writes."""


@cache
def makings() -> dict[str, dict[str, Any]]:
    """How each policy was made and what it is worth, by preset.

    ``command``, ``seed``, ``frames``, ``seconds`` and ``machine`` of the training; ``score``, the mean ``return`` with the half
    width of its 95 % interval and the ``survival`` in ``episodes`` fresh episodes; and ``first``, the returns of the first few.
    """
    return json.loads((FOLDER / "policies.json").read_text())


def pretrained_file(preset: str) -> Path:
    """File of the policy for ``preset``; ValueError, with the nearest name, where there is none."""
    if preset not in makings():
        names = sorted(makings())
        raise ValueError(f"there is no pretrained policy for {preset!r}; there are {', '.join(names)}; {nearest(preset, names)}")
    return FOLDER / f"{preset}.pt"


def pretrained(preset: str, device: torch.device | str = "cpu") -> TensorDictSequential:
    """The policy for ``preset``: writes ``action`` into what its environment gives.

    It wants the environment as it was made for: ``read_card(pretrained_file(preset))["options"]`` says how, such as
    ``as_set=True``. Policies of constellations decide for one satellite; :class:`~bsk_torch.rl.crew.Crew` asks them for all.
    """
    return load_policy(pretrained_file(preset), device)
