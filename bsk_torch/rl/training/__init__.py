"""Training with PPO."""

from bsk_torch.rl.training.config import PPOConfig, load_config, override, save_config
from bsk_torch.rl.training.recipes import RECIPES, configure
from bsk_torch.rl.training.trainer import Training, resume, train

__all__ = ["RECIPES", "PPOConfig", "Training", "configure", "load_config", "override", "resume", "save_config", "train"]
