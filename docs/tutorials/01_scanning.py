"""
.. _tutorial-scanning:

Scan the ground with one satellite
==================================

Observations, actions and rewards of the BSK-RL paper's satellite, a hand-written policy, and plots of an episode.

The satellite flies around the Earth for five orbits (28,500 s) and records data of the ground below. Its battery must not run
empty, its wheels must not reach their maximum speed, and data that exceed its buffer are lost. It makes a decision every one to
three minutes.
"""

# %%
# Result
# ------
#
# This is one episode with the pretrained policy:
import torch

import bsk_torch
from bsk_torch.rl.policies import pretrained
from bsk_torch.viz.episodes import draw, record

# sphinx_gallery_thumbnail_path = "_static/readme/NadirScan-v1.png"
EPISODES = 256
SECONDS = 28_500.0

torch.set_num_threads(1)
env = bsk_torch.make("NadirScan-v1", num_envs=1, time_limit=SECONDS)
episode = record(pretrained("NadirScan-v1"), env, seed=7)
path = draw(episode, "trained.png", "trained policy")

# %%
# The bar at the top shows the decisions. The panels below show the battery, the data buffer and the three wheels. In the gray
# bands (eclipses), the solar panel produces no power. The green bands are passes over a ground station, the only times at which
# the satellite can downlink data. The policy scans most of the time, charges when necessary, and waits for passes to downlink.
#
# Batched episodes
# ----------------
#
# ``bsk_torch.make`` returns a TorchRL environment that plays ``num_envs`` independent episodes at once. Every value is a tensor
# whose first dimension is the episode.
env = bsk_torch.make("NadirScan-v1", num_envs=EPISODES, time_limit=SECONDS)
env.set_seed(0)
td = env.reset()
print(td)

# %%
# Observations
# ------------
#
# The observation is a vector. ``observation_description`` names its entries:
names = env.satellite.observation_description
for name, value in zip(names, td["observation"][0].tolist(), strict=True):
    print(f"{name:55} {value:7.3f}")

# %%
# Battery charge, buffer level and wheel speeds are fractions of their limits. The two errors are angles divided by pi: the angle
# between the instrument and the direction to the ground below, and the angle between the panel and the direction to the Sun. The
# times until the start and end of the next pass and the next eclipse are divided by 5700 s, about one orbit; the time until the
# start is 0 or negative during a pass. The last entry is the time since the start of the episode, as a fraction of its length.
#
# Actions
# ------------
#
# There are four actions. They last 180, 120, 60 and 60 s:
for number, name in enumerate(env.satellite.action_description):
    print(number, name)

# %%
# Episodes do not wait for each other: in each ``step``, every episode finishes its own action. ``duration`` is the simulated
# time.
td["action"] = torch.arange(EPISODES) % 4
td = env.step(td)["next"]
print("duration", td["duration"][:4].flatten().tolist())
print("reward  ", td["reward"][:4].flatten().tolist())

# %%
# Rewards
# -------
# The reward is the time spent recording, as a fraction of the episode's 28,500 s: an episode that always records returns 1. The
# instrument records only while it points at the ground, so a scan that starts with a slew earns less than 180 / 28,500 = 0.0063,
# and a full buffer earns nothing. If the satellite dies, the reward is -1 and the episode is ``terminated``.
#
# Write a policy by hand
# ----------------------
#
# A TorchRL policy reads a tensordict and writes ``action``. This policy checks the most urgent condition first: fast wheels, a
# low battery, then data to downlink during a pass. ``Columns`` finds entries of the observation by the end of their names.
from tensordict.nn import TensorDictModule

from bsk_torch.rl.rules import Columns

SCAN, CHARGE, DOWNLINK, DESAT = range(4)


def decide(observation):
    """Observations [N, 12] to actions [N]."""
    see = Columns(observation, names)
    action = torch.full(observation.shape[:1], SCAN)
    passing = see["opportunity_open_normd"] <= 0.0
    action[passing & (see["storage_level_fraction"] > 0.3)] = DOWNLINK
    action[see["battery_charge_fraction"] < 0.25] = CHARGE
    action[see.all("wheel_speeds_fraction").abs().amax(-1) > 0.7] = DESAT
    return action


mine = TensorDictModule(decide, in_keys=["observation"], out_keys=["action"])

# %%
# ``evaluate`` plays one full episode in each environment. With the same ``seed``, every policy gets the same episodes, so
# policies can be compared episode by episode. ``bsk_torch.rule`` returns the baselines: random actions and a more careful rule.
from bsk_torch.rl.evaluation import evaluate

policies = {
    "mine": mine,
    "random": bsk_torch.rule("random", env),
    "rule": bsk_torch.rule("rule", env),
    "trained": pretrained("NadirScan-v1"),
}
results = {name: evaluate(policy, env, seed=1) for name, policy in policies.items()}
for name, result in results.items():
    print(f"{name:8} return {result.mean_return}, survival {result.survival:6.1%}")
print(
    "gain of the trained policy over mine:",
    results["trained"].gain_over(results["mine"]),
)

# %%
# The output shows 95 % confidence intervals. The next figure is an episode with the hand-written policy:
env = bsk_torch.make("NadirScan-v1", num_envs=1, time_limit=SECONDS)
episode = record(mine, env, seed=7)
path = draw(episode, "mine.png", "mine")

# %%
# The map shows the same episode in the same colors. The track is thick where a reward was earned, and shaded in eclipse:
from pathlib import Path

from bsk_torch.viz.figures.timeline import track_map

path = track_map(episode, Path("map.png"), "mine")

# %%
# Use Gymnasium
# -------------
# Importing ``bsk_torch`` registers the environment with Gymnasium, as a single or a vector environment. ``info`` contains the
# mask of legal actions and the duration of the step.
import gymnasium

single = gymnasium.make("bsk_torch/NadirScan-v1")
observation, info = single.reset(seed=7)
observation, reward, terminated, truncated, info = single.step(SCAN)
print(observation.shape, f"{reward:.5f}", terminated, truncated, info)

# %%
# Next steps
# ----------
#
# - :ref:`tutorial-imaging`: choose among targets, and build your own environment.
# - :ref:`tutorial-torchrl`: train a policy for this satellite.
# - :ref:`tutorial-evaluating`: evaluate and publish a policy.
