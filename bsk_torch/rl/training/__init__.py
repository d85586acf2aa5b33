"""Training with PPO."""

from typing import TYPE_CHECKING

from bsk_torch._deprecated import deprecated_names
from bsk_torch.rl.training.config import PPOConfig, load_config, override, save_config
from bsk_torch.rl.training.recipes import RECIPES, configure
from bsk_torch.rl.training.trainer import Training, resume, train

__all__ = ["RECIPES", "PPOConfig", "Training", "configure", "load_config", "override", "resume", "save_config", "train"]

if not TYPE_CHECKING:
    __getattr__ = deprecated_names(__name__)
