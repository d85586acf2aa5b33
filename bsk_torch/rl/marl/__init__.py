"""Training of constellations: MAPPO and IPPO, and policies that satellites share."""

import bsk_torch.rl.training  # noqa: F401  - first: it offers configure() and train() of this package, too
from bsk_torch.rl.marl.mappo import MAPPOConfig, MAPPOTraining
from bsk_torch.rl.marl.runs import ALGORITHMS, configure, read_config, training_of
from bsk_torch.rl.policies.shared_policy import SharedPolicy, member_view, shared, shared_baselines

__all__ = [
    "ALGORITHMS",
    "MAPPOConfig",
    "MAPPOTraining",
    "SharedPolicy",
    "configure",
    "member_view",
    "read_config",
    "shared",
    "shared_baselines",
    "training_of",
]
