"""Training with PPO, MAPPO and IPPO."""

from bsk_torch.rl.marl.runs import configure, resume, train
from bsk_torch.rl.training.config import PPOConfig, load_config, override, save_config
from bsk_torch.rl.training.recipes import RECIPES
from bsk_torch.rl.training.trainer import Training

__all__ = ["RECIPES", "PPOConfig", "Training", "configure", "load_config", "override", "resume", "save_config", "train"]
