"""
.. _tutorial-sb3:

Train with Stable-Baselines3
============================

Train sb3-contrib's MaskablePPO on many episodes in one simulation, without subprocesses, and compare the result with rules.

This page needs ``pip install 'bsk_torch[sb3]'``. Any other algorithm of Stable-Baselines3 for discrete actions works in the
same way; MaskablePPO also uses the mask of legal actions.
"""

# %%
# The result
# ----------
#
# ``SB3VecEnv`` is a ``VecEnv`` over the batched environment: its name and the number of episodes are all it needs. ``VecMonitor``
# notes the returns of episodes, ``VecNormalize`` standardises observations.
import time

import torch
from sb3_contrib import MaskablePPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecMonitor, VecNormalize

from bsk_torch.wrappers.stable_baselines3 import SB3VecEnv

NUM_ENVS, ROLLOUT = 256, 32
STEPS = 60 * NUM_ENVS * ROLLOUT
EPISODES = 128
SECONDS = 28_500.0

torch.set_num_threads(1)


class Returns(BaseCallback):
    """Notes the mean return of the last episodes at each update."""

    def _on_training_start(self):
        self.steps, self.means = [], []

    def _on_rollout_end(self):
        if self.model.ep_info_buffer:
            returns = [episode["r"] for episode in self.model.ep_info_buffer]
            self.steps.append(self.num_timesteps)
            self.means.append(sum(returns) / len(returns))

    def _on_step(self):
        return True


world = dict(time_limit=SECONDS)
env = VecNormalize(VecMonitor(SB3VecEnv("NadirScan-v1", NUM_ENVS, **world)), norm_reward=False)
model = MaskablePPO(
    "MlpPolicy",
    env,
    learning_rate=lambda left: 2.5e-3 * max(0.05, left),
    n_steps=ROLLOUT,
    batch_size=2048,
    n_epochs=8,
    gamma=0.999,
    ent_coef=0.01,
    stats_window_size=NUM_ENVS,
    policy_kwargs=dict(net_arch=[64, 64]),
    device="cpu",
    seed=0,
)
history = Returns()
begin = time.perf_counter()
model.learn(STEPS, callback=history)
print(f"{model.num_timesteps} decisions in {time.perf_counter() - begin:.0f} s")

# %%
import matplotlib.pyplot as plt

figure, panel = plt.subplots(figsize=(8, 3), layout="constrained")
panel.plot(history.steps, history.means, color="#2f6db3")
panel.set_xlabel("decisions")
panel.set_ylabel("return while training")
panel.grid(axis="y", alpha=0.3)

# %%
# Discounts
# ---------
#
# Stable-Baselines3 discounts per decision: a step of a minute counts as much as one of three. A decision lasts 160 s
# in the mean, so 0.999 per decision is about 0.999994 per second. :ref:`tutorial-torchrl` discounts per second.
#
# Evaluate
# --------
#
# ``evaluate`` and ``compare`` play policies of TorchRL, which read a tensordict and write ``action``. A few lines turn the model
# into one: it sees normalised observations, and chooses its most probable legal action.
from tensordict.nn import TensorDictModule

import bsk_torch
from bsk_torch.rl.evaluation import compare, comparison_table


def choose(observation, action_mask):
    """Observations [N, 12] and legal actions [N, 4] to actions [N]."""
    seen = env.normalize_obs(observation.numpy())
    actions, _ = model.predict(seen, deterministic=True, action_masks=action_mask.numpy())
    return torch.as_tensor(actions)


policy = TensorDictModule(choose, in_keys=["observation", "action_mask"], out_keys=["action"])
judge = bsk_torch.make("NadirScan-v1", num_envs=EPISODES, **world)
print(comparison_table(compare({"MaskablePPO": policy}, judge, seed=0)))

# %%
# An episode of it:
from bsk_torch.viz.episodes import draw, record

alone = bsk_torch.make("NadirScan-v1", num_envs=1, **world)
path = draw(record(policy, alone, seed=7), "sb3.png", "MaskablePPO")

# %%
# What Stable-Baselines3 sees
# ---------------------------
#
# ``infos`` has for each episode the mask and the duration, and where an episode has ended its last observation. ``core`` is the
# TorchRL environment of the other tutorials.
env = SB3VecEnv("NadirScan-v1", 2, **world)
observations = env.reset()
observations, rewards, dones, infos = env.step([0, 1])
print(rewards, dones, infos[0])
print(env.action_masks())
print(type(env.core).__name__, env.core.satellite.action_description)

# %%
# Next
# ----
#
# - :ref:`sphx_glr_gallery_ppo_sb3.py`: the same as a program with options, logged metrics, and the model on disk.
# - :ref:`tutorial-marl`: RLlib and BenchMARL.
# - :ref:`tutorial-evaluating`: how good a policy is.
#
# sphinx_gallery_thumbnail_number = 1
