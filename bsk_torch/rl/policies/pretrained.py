"""Policies included in the package, one for each trained preset, and how they were trained."""

from __future__ import annotations

from pathlib import Path

import torch
from tensordict.nn import TensorDictModuleBase

from bsk_torch._listed import makings, no_policy
from bsk_torch.rl.policies.files import policy_of_file

FOLDER = Path(__file__).parent
"""Folder of the policies, ``PRESET.pt``, and their metadata."""

INDEX = "policies.json"
"""Metadata file, written by ``scripts/tools/publish_policy.py``; :func:`~bsk_torch._listed.makings` reads it."""


def pretrained_file(preset: str) -> Path:
    """Return the path of the policy for ``preset``; ValueError, with what to do, if there is none."""
    if preset not in makings():
        raise ValueError(no_policy(preset))
    return FOLDER / f"{preset}.pt"


def pretrained(preset: str, device: torch.device | str = "cpu") -> TensorDictModuleBase:
    """Return the pretrained policy for ``preset``, a module that writes ``action`` into the environment's tensordict.

    The environment needs the options used in training, ``read_card(pretrained_file(preset))["options"]``, such as
    ``as_set=True``, but policies with attention choose among any number of targets, ``n_ahead`` in presets. Policies for
    constellations act for one satellite; :func:`~bsk_torch.rl.policies.shared_policy.shared` applies them to all.
    """
    return policy_of_file(pretrained_file(preset), device)
