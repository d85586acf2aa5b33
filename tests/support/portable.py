"""Hashes of episodes and of a trained policy, to be compared with those of other processors, threads and times.

Usage: BSK_TORCH_PORTABLE=1 python -m tests.support.portable [THREADS]
"""

import bsk_torch  # noqa: I001  - first, before NumPy and torch choose their instructions
import hashlib
import json
import sys
from collections.abc import Iterable
from pathlib import Path
from tempfile import TemporaryDirectory

import torch
from torch import Tensor

from tests.support.choices import legal_actions

PRESETS = ("NadirScan-v1", "AEOS-v1", "RSOInspection-v1", "Constellation-v1")

STEPS = 4


def digest(tensors: Iterable[Tensor]) -> str:
    """Return a hash of all bits."""
    return hashlib.sha256(b"".join(tensor.contiguous().numpy().tobytes() for tensor in tensors)).hexdigest()[:16]


def episodes(preset: str) -> str:
    """Hash the state of some episodes after a few decisions."""
    env = bsk_torch.make(preset, num_envs=5, seed=3, time_limit=3000.0)
    td = env.reset()
    for step in range(STEPS):
        td = env.step(legal_actions(td, env.action_keys, step))["next"]
    state = env.get_state().flatten_keys(".")
    return digest(state[name] for name in sorted(state.keys()))


def weights() -> str:
    """Hash a policy of NadirScan-v1 after 8 updates of 64 by 64 weights, each by 1,024 decisions."""
    from bsk_torch.rl.training.config import PPOConfig
    from bsk_torch.rl.training.trainer import Training

    config = PPOConfig(
        frames=4096, num_envs=128, rollout=16, minibatch=1024, epochs=2, evaluate_every=0, options={"time_limit": 3000.0}
    )
    with TemporaryDirectory() as folder:
        return digest(Training(config, Path(folder) / "run").run(bar=False).state_dict().values())


if __name__ == "__main__":
    torch.set_num_threads(int(sys.argv[1]) if len(sys.argv) > 1 else 1)
    print(json.dumps({preset: episodes(preset) for preset in PRESETS} | {"weights": weights()}))  # noqa: T201
