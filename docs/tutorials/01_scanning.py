"""
.. _tutorial-scanning:

A satellite that scans the ground
=================================

What the satellite of the BSK-RL paper sees, does and is rewarded for; a policy written by hand; and how to draw an episode.

The satellite flies around the Earth for five orbits (28,500 s) and records data of the ground below it. Its battery must not
run empty, its wheels must not reach their largest speed, and what does not fit into its store is lost. It decides every one to
three minutes what to do next.
"""

# %%
# The result
# ----------
#
# This is one episode of the policy that comes with the package:
import torch

import bsk_torch
from bsk_torch.rl.policies import pretrained
from bsk_torch.viz.episodes import draw, record

EPISODES = 256
SECONDS = 28_500.0

torch.set_num_threads(1)
env = bsk_torch.make("NadirScan-v1", num_envs=1, time_limit=SECONDS)
episode = record(pretrained("NadirScan-v1"), env, seed=7)
path = draw(episode, "trained.png", "trained policy")

# %%
# The bar at the top shows the decisions. Below are what they did to the battery, to the store and to the three wheels. The grey
# bands are eclipses, in which the solar panel gives no power; the green ones are passes over a ground station, the only times at
# which the store can be emptied. The policy scans most of the time, charges when it has to, and waits for passes to downlink.
#
# One environment, many episodes
# ------------------------------
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
    print(f"{name:52} {value:7.3f}")

# %%
# Charge, store and wheel speeds are fractions of their limits. The two errors are angles over pi: how far the instrument is
# turned away from the ground below, and the panel away from the Sun. The times until the next pass and the next eclipse begin
# and end are divided by 5700 s, about one orbit; the time until a pass begins is 0 or less while it goes on. The last entry is
# the time since the beginning of the episode, as a fraction of its length.
#
# Actions
# ------------
#
# There are four actions. They last 180, 120, 60 and 60 s:
for number, name in enumerate(env.satellite.action_description):
    print(number, name)

# %%
# Episodes do not wait for each other: each ``step`` lets every episode finish its own action. ``duration`` says how long that
# took.
td["action"] = torch.arange(EPISODES) % 4
td = env.step(td)["next"]
print("duration", td["duration"][:4].flatten().tolist())
print("reward  ", td["reward"][:4].flatten().tolist())

# %%
# Rewards
# -------
#
# The reward is the time in which data were recorded, in terms of the 28,500 s of the episode: an episode that records all the
# time returns 1. The instrument records when it points at the ground, so a scan that begins with a turn gives less than 180 /
# 28,500 = 0.0063, and a full store gives nothing. If the satellite dies, the reward is -1 and the episode is ``terminated``.
#
# A policy written by hand
# ------------------------
#
# A policy of TorchRL reads a tensordict and writes ``action``. This one looks at the battery, the wheels and the store, in the
# order of what is most urgent. ``Columns`` finds entries of the observation by the end of their names.
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
# ``evaluate`` plays one episode in each row to its end. The same ``seed`` gives every policy the same episodes, so that gains
# can be compared episode by episode. ``BASELINES`` has random actions, and a rule with more care than ours.
from bsk_torch.rl.evaluation import evaluate
from bsk_torch.rl.rules import BASELINES

policies = {
    "mine": mine,
    "random": BASELINES["random"](env, 0),
    "rule": BASELINES["rule"](env, 0),
    "trained": pretrained("NadirScan-v1"),
}
results = {name: evaluate(policy, env, seed=1) for name, policy in policies.items()}
for name, result in results.items():
    print(f"{name:8} return {result.mean_return}, survival {result.survival:6.1%}")
print("gain of the trained policy over mine:", results["trained"].gain_over(results["mine"]))

# %%
# The intervals are those of 95 % confidence. An episode of our own policy:
env = bsk_torch.make("NadirScan-v1", num_envs=1, time_limit=SECONDS)
episode = record(mine, env, seed=7)
path = draw(episode, "mine.png", "mine")

# %%
# And on the map, in the same colours. The track is thick where a reward was earned and shaded in eclipse:
from pathlib import Path

from bsk_torch.viz.figures.track_map import track_map

path = track_map(episode, Path("map.png"), "mine")

# %%
# With Gymnasium
# --------------
#
# Importing ``bsk_torch`` registers the environment with Gymnasium, as one episode or as one vector environment. ``info`` holds
# the mask of legal actions and the duration of the step.
import gymnasium

single = gymnasium.make("bsk_torch/NadirScan-v1")
observation, info = single.reset(seed=7)
observation, reward, terminated, truncated, info = single.step(SCAN)
print(observation.shape, f"{reward:.5f}", terminated, truncated, info)

# %%
# Next
# ----
#
# - :ref:`tutorial-imaging`: a satellite that chooses among targets, and the parts of a problem of your own.
# - :ref:`tutorial-torchrl`: train a policy for this satellite.
# - :ref:`tutorial-evaluating`: how good a policy is, and how to pass it on.
#
# sphinx_gallery_thumbnail_number = 1
