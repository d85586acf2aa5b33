"""
.. _tutorial-sb3:

Train with Stable-Baselines3
============================

Train sb3-contrib's MaskablePPO with many episodes in one simulation, without subprocesses, and compare it with rules.

Run ``pip install 'bsk_torch[sb3]'`` first. Other Stable-Baselines3 algorithms for discrete actions work in the same way;
MaskablePPO also uses the mask of legal actions.
"""

# %%
# Result
# ------
#
# ``SB3VecEnv`` wraps the batched environment as a ``VecEnv``, given its name and the number of episodes. ``VecMonitor`` records
# the returns of episodes, and ``VecNormalize`` standardizes observations.
import time

import torch
from sb3_contrib import MaskablePPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecMonitor, VecNormalize

from bsk_torch.rl.stable_baselines3 import DiscountPerSecond
from bsk_torch.wrappers.stable_baselines3 import SB3VecEnv

# sphinx_gallery_thumbnail_path = "_static/readme/AEOSPower-v1.png"
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
env = VecNormalize(
    VecMonitor(SB3VecEnv("NadirScan-v1", NUM_ENVS, **world)), norm_reward=False
)
model = MaskablePPO(
    "MlpPolicy",
    env,
    learning_rate=lambda left: 2.5e-3 * max(0.05, left),
    n_steps=ROLLOUT,
    batch_size=2048,
    n_epochs=8,
    gamma=1.0,  # DiscountPerSecond discounts
    ent_coef=0.01,
    stats_window_size=NUM_ENVS,
    policy_kwargs=dict(net_arch=[64, 64]),
    device="cpu",
    seed=0,
)
history = Returns()
begin = time.perf_counter()
model.learn(STEPS, callback=[history, DiscountPerSecond(0.99999)])
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
# Stable-Baselines3 discounts per decision: a step of one minute is discounted as much as one of three minutes. The callback
# ``DiscountPerSecond`` replaces advantages and value targets by those with a discount of 0.99999 per second (see
# :doc:`/how_to/other_learners`).
#
# Evaluate
# --------
# ``evaluate`` and ``compare`` accept TorchRL policies, which read a tensordict and write ``action``. A few lines wrap the model:
# the wrapper normalizes observations and returns the most probable legal action.
from tensordict.nn import TensorDictModule

import bsk_torch
from bsk_torch.rl.evaluation import compare, comparison_table


def choose(observation, action_mask):
    """Observations [N, 12] and legal actions [N, 4] to actions [N]."""
    seen = env.normalize_obs(observation.numpy())
    actions, _ = model.predict(
        seen, deterministic=True, action_masks=action_mask.numpy()
    )
    return torch.as_tensor(actions)


policy = TensorDictModule(
    choose, in_keys=["observation", "action_mask"], out_keys=["action"]
)
judge = bsk_torch.make("NadirScan-v1", num_envs=EPISODES, **world)
print(comparison_table(compare({"MaskablePPO": policy}, judge, seed=0)))

# %%
# The next figure is an episode with this policy:
from bsk_torch.viz.episodes import draw, record

alone = bsk_torch.make("NadirScan-v1", num_envs=1, **world)
path = draw(record(policy, alone, seed=7), "sb3.png", "MaskablePPO")

# %%
# Contents of infos
# -----------------
#
# For each episode, ``infos`` contains the mask, the duration and, at the end of an episode, its last observation. ``core`` is the
# TorchRL environment used in the other tutorials.
env = SB3VecEnv("NadirScan-v1", 2, **world)
observations = env.reset()
observations, rewards, dones, infos = env.step([0, 1])
print(rewards, dones, infos[0])
print(env.action_masks())
print(type(env.core).__name__, env.core.satellite.action_description)

# %%
# Next steps
# ----------
# - :ref:`sphx_glr_gallery_ppo_sb3.py`: a complete program with options, logged metrics, and a saved model.
# - :ref:`tutorial-marl`: RLlib and BenchMARL.
# - :ref:`tutorial-evaluating`: evaluate and publish a policy.
