"""
.. _tutorial-constellations:

Constellations and communication
================================

Several satellites share the targets of one episode: groups of agents, masks, who knows what, and what communication is worth.

Two satellites that image the same target waste one image. Each knows its own images; of those of others it knows what has been
communicated to it, and leaves those targets out.
"""

# %%
# The result
# ----------
#
# Twelve satellites in three planes for one orbit, with the policy that comes with the package. It was trained to decide for one
# satellite at a time, and ``shared`` lets it decide for all of them:
import torch

import bsk_torch
from bsk_torch import comm
from bsk_torch.rl.marl import shared, shared_baseline
from bsk_torch.rl.policies import pretrained
from bsk_torch.viz.episodes import draw, record

SATELLITES, TARGETS = 12, 3000
EPISODES = 8
SECONDS = 5700.0

torch.set_num_threads(1)
world = dict(n_satellites=SATELLITES, n_targets=TARGETS, time_limit=SECONDS, as_set=True)
env = bsk_torch.make("Constellation-v1", num_envs=1, **world)
policy = shared(pretrained("Constellation-v1"), env)
path = draw(record(policy, env, seed=2), "constellation.png", "twelve satellites")

# %%
# The map has the ground tracks, the images, and the satellites with their contacts at the moment of most contacts. Below, each
# satellite has a row: its images over time, and bars where it was in contact with another one.
#
# Groups of agents
# ----------------
#
# ``group_map`` says which agents belong together. Agents that are alike are one group, with tensors ``[N, S, ...]`` for ``N``
# episodes and ``S`` satellites. Here all are alike:
env = bsk_torch.make("Constellation-v1", num_envs=EPISODES, **(world | dict(as_set=False)))
env.set_seed(0)
td = env.reset()
print(env.group_map)
for name in ("observation", "action_mask", "mask", "requires_retasking"):
    print(f"{name:20}", list(td["agents", name].shape))

# %%
# ``mask`` says which agents are alive, ``requires_retasking`` which ones need a new task. The observation of each satellite is
# that of ``AEOS-v1``, of its own next 16 targets.
#
# A step lasts until the first satellite has finished its task; the others go on with theirs. ``action_mask`` then allows busy
# satellites only the last action, which continues:
td["agents", "action"] = td["agents", "action_mask"].int().argmax(-1)  # the first legal action of each
td = env.step(td)["next"]
first = 0
print("seconds", float(td["duration"][first]))
print("needs a task    ", td["agents", "requires_retasking"][first].flatten().int().tolist())
print("actions to choose", td["agents", "action_mask"][first].sum(-1).tolist())
print("rewards          ", [round(reward, 2) for reward in td["agents", "reward"][first].flatten().tolist()])

# %%
# Shared knowledge
# ----------------
#
# After each step the communicator decides which satellites share what they know. ``comm.LOSCommunication``, which this preset
# has, connects those that see each other past the Earth; ``env.links[n, s, r]`` says that ``s`` has told ``r`` in the last step.
# ``env.rewarder.known[n, s, t]`` says that satellite ``s`` knows target ``t`` to have been imaged.
rule = shared_baseline("hasty", env, 0)
for _ in range(40):
    td = env.step(rule(td))["next"]
told = [f"EO{s + 1} -> EO{r + 1}" for s, r in env.links[first].nonzero().tolist()]
print("links in the last step:", ", ".join(told))
print("targets imaged    ", int(env.rewarder.imaged[first].sum()))
print("known to satellite", env.rewarder.known[first].sum(-1).tolist())

# %%
# Value of communication
# ----------------------
#
# The same rule in the same episodes, with and without communication. The reward of an image that was in vain is 0, and the time
# that it took is lost. (``comm.FreeCommunication`` connects all satellites, ``comm.LOSMultiCommunication`` passes messages on.)
from bsk_torch.rl.evaluation import evaluate

METHODS = {
    "none": comm.NoCommunication(),
    "line of sight": comm.LOSCommunication(),
}
results = {}
for name, communicator in METHODS.items():
    env = bsk_torch.make("Constellation-v1", num_envs=EPISODES, communicator=communicator, **world)
    results[name] = evaluate(shared_baseline("nearest", env, 0), env, seed=1)

for name, result in results.items():
    images, wasted = (float(result.counts[key].double().mean()) for key in ("imaged", "duplicates"))
    gain = result.gain_over(results["none"])
    print(f"{name:14} return {result.mean_return}, {images:4.0f} images, {wasted:3.0f} in vain, gain {gain}")

# %%
import matplotlib.pyplot as plt

wasted = {name: float(result.counts["duplicates"].double().mean()) for name, result in results.items()}
returns = {name: result.mean_return for name, result in results.items()}
figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3), layout="constrained")
left.bar(returns.keys(), [r.mean for r in returns.values()], yerr=[r.half_width for r in returns.values()], color="#2f6db3")
left.set_ylabel("return of the team")
right.bar(wasted.keys(), wasted.values(), color="#c1476b")
right.set_ylabel("images in vain")

# %%
# A ``CommunicationMethod`` of your own returns ``[N, S, S]`` from ``communication_pairs()``: who tells whom. Communication may
# also be an action: in ``RelayConstellation-v1`` four low imagers cannot see each other, and two high relays pass on what they
# hear, when they choose to. Its agents are of two kinds, so there are two groups:
env = bsk_torch.make("RelayConstellation-v1", num_envs=2, time_limit=600.0)
td = env.reset()
for group, agents in env.group_map.items():
    print(group, agents, list(td[group, "observation"].shape), list(td[group, "action_mask"].shape))

# %%
# Other views
# -----------
#
# PettingZoo gets one episode, with dictionaries by agent; ``bsk_torch/GeneralSatelliteTasking-v1`` of Gymnasium has one agent
# that commands all satellites.
from bsk_torch.wrappers.pettingzoo import parallel_env

parallel = parallel_env("AEOSConstellation-v1", n_targets=200, time_limit=600.0)
observations, infos = parallel.reset(seed=0)
actions = {agent: 0 for agent in parallel.agents if infos[agent]["requires_retasking"]}
observations, rewards, terminations, truncations, infos = parallel.step(actions)
print({agent: round(float(reward), 3) for agent, reward in rewards.items()})

# %%
# Next
# ----
#
# - :ref:`tutorial-marl`: train constellations with BenchMARL.
# - :ref:`tutorial-evaluating`: pass a policy on.
# - :ref:`tutorial-film`: watch what a constellation does.
#
# sphinx_gallery_thumbnail_number = 1
