"""Policy files and pretrained policies."""

from bsk_torch.rl.policies.files import build_policy, check_fits, policy_of_file, read_card, save_policy
from bsk_torch.rl.policies.network_files import read_exported, read_onnx
from bsk_torch.rl.policies.pretrained import makings, pretrained, pretrained_file
from bsk_torch.rl.policies.shared_policy import as_policy

__all__ = [
    "as_policy",
    "build_policy",
    "check_fits",
    "makings",
    "policy_of_file",
    "pretrained",
    "pretrained_file",
    "read_card",
    "read_exported",
    "read_onnx",
    "save_policy",
]
