"""Policies in files, and those that come with the package."""

from typing import TYPE_CHECKING

from bsk_torch._deprecated import deprecated_names
from bsk_torch.rl.policies.files import build_policy, check_fits, load_policy, read_card, save_policy
from bsk_torch.rl.policies.pretrained import makings, pretrained, pretrained_file

__all__ = ["build_policy", "check_fits", "load_policy", "makings", "pretrained", "pretrained_file", "read_card", "save_policy"]

if not TYPE_CHECKING:
    __getattr__ = deprecated_names(__name__)
