"""
.. _tutorial-constellations:

Constellations and communication
================================

Several satellites share the targets of one episode: groups of agents, masks, shared knowledge, and the value of communication.

If two satellites image the same target, one image is wasted. Each satellite knows which targets it has imaged and which images
other satellites have communicated, and skips these targets.
"""

# %%
# Result
# ------
#
# Twelve satellites in three planes fly for one orbit with the pretrained policy. The policy was trained with a single satellite;
# ``shared`` applies it to all twelve:
import torch

import bsk_torch
from bsk_torch import comm
from bsk_torch.rl.marl import shared
from bsk_torch.rl.policies import pretrained
from bsk_torch.viz.episodes import draw, record

# sphinx_gallery_thumbnail_path = "_static/readme/Constellation-v1.png"
SATELLITES, TARGETS = 12, 3000
EPISODES = 8
SECONDS = 5700.0

torch.set_num_threads(1)
world = dict(
    n_satellites=SATELLITES, n_targets=TARGETS, time_limit=SECONDS, as_set=True
)
env = bsk_torch.make("Constellation-v1", num_envs=1, **world)
policy = shared(pretrained("Constellation-v1"), env)
path = draw(record(policy, env, seed=2), "constellation.png", "twelve satellites")

# %%
# The map shows the ground tracks and the images, and the satellites and their contacts at the time at which there are most
# contacts. Below the map, each satellite has a row that shows its images over time, with bars during contacts with other
# satellites.
#
# Groups of agents
# ----------------
# ``group_map`` lists the groups of agents. Agents with the same spaces form one group, with tensors ``[N, S, ...]`` for ``N``
# episodes and ``S`` satellites. Here, all agents are in one group:
env = bsk_torch.make(
    "Constellation-v1", num_envs=EPISODES, **(world | dict(as_set=False))
)
env.set_seed(0)
td = env.reset()
print(env.group_map)
for name in ("observation", "action_mask", "mask", "requires_retasking"):
    print(f"{name:20}", list(td["agents", name].shape))

# %%
# ``mask`` marks living agents, and ``requires_retasking`` marks agents that need a new task. Each satellite has the observation
# of ``AEOS-v1``, with its next 16 targets.
#
# A step lasts until the first satellite finishes its task; the others continue theirs. For busy satellites, ``action_mask``
# allows only the last action, which continues the task:
# the first legal action of each
td["agents", "action"] = td["agents", "action_mask"].int().argmax(-1)
td = env.step(td)["next"]
first = 0
print("seconds", float(td["duration"][first]))
print(
    "needs a task    ",
    td["agents", "requires_retasking"][first].flatten().int().tolist(),
)
print("actions to choose", td["agents", "action_mask"][first].sum(-1).tolist())
print(
    "rewards          ",
    [round(reward, 2) for reward in td["agents", "reward"][first].flatten().tolist()],
)

# %%
# Shared knowledge
# ----------------
# After each step, the communicator determines which satellites share their knowledge. This preset uses ``comm.LOSCommunication``,
# which links satellites with a line of sight. ``env.links[n, s, r]`` is True if satellite ``s`` sent its knowledge to satellite
# ``r`` in episode ``n`` in the last step. ``env.rewarder.known[n, s, t]`` is True if satellite ``s`` knows that target ``t`` has
# been imaged.
rule = bsk_torch.rule("hasty", env)
for _ in range(40):
    td = env.step(rule(td))["next"]
told = [f"EO{s + 1} -> EO{r + 1}" for s, r in env.links[first].nonzero().tolist()]
print("links in the last step:", ", ".join(told))
print("targets imaged    ", int(env.rewarder.imaged[first].sum()))
print("known to satellite", env.rewarder.known[first].sum(-1).tolist())

# %%
# Value of communication
# ----------------------
# Compare the same rule in the same episodes, with and without communication. A duplicate image earns 0, and the time spent on it
# is lost. (``comm.FreeCommunication`` links all satellites; ``comm.LOSMultiCommunication`` relays messages.)
from bsk_torch.rl.evaluation import evaluate

METHODS = {
    "none": comm.NoCommunication(),
    "line of sight": comm.LOSCommunication(),
}
results = {}
for name, communicator in METHODS.items():
    env = bsk_torch.make(
        "Constellation-v1", num_envs=EPISODES, communicator=communicator, **world
    )
    results[name] = evaluate(bsk_torch.rule("nearest", env), env, seed=1)

for name, result in results.items():
    images, wasted = (
        float(result.counts[key].double().mean()) for key in ("imaged", "duplicates")
    )
    gain = result.gain_over(results["none"])
    print(
        f"{name:14} return {result.mean_return}, {images:4.0f} images,",
        f"{wasted:3.0f} duplicates, gain {gain}",
    )

# %%
import matplotlib.pyplot as plt

wasted = {
    name: float(result.counts["duplicates"].double().mean())
    for name, result in results.items()
}
returns = {name: result.mean_return for name, result in results.items()}
figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3), layout="constrained")
left.bar(
    returns.keys(),
    [r.mean for r in returns.values()],
    yerr=[r.half_width for r in returns.values()],
    color="#2f6db3",
)
left.set_ylabel("return of the team")
right.bar(wasted.keys(), wasted.values(), color="#a52b5b")
right.set_ylabel("images in vain")

# %%
# The method ``communication_pairs()`` of a custom ``CommunicationMethod`` returns the links ``[N, S, S]``, indexed by episode,
# sender and receiver. Communication may also be an action: in ``RelayConstellation-v1``, four low imagers cannot see each other,
# and two high relays choose when to broadcast. There are two kinds of agents and therefore two groups:
env = bsk_torch.make("RelayConstellation-v1", num_envs=2, time_limit=600.0)
td = env.reset()
for group, agents in env.group_map.items():
    print(
        group,
        agents,
        list(td[group, "observation"].shape),
        list(td[group, "action_mask"].shape),
    )

# %%
# Use PettingZoo or Gymnasium
# ---------------------------
#
# The PettingZoo view plays one episode, with dictionaries whose keys are agents. Gymnasium's
# ``bsk_torch/GeneralSatelliteTasking-v1`` has one agent that commands all satellites.
from bsk_torch.wrappers.pettingzoo import parallel_env

parallel = parallel_env("AEOSConstellation-v1", n_targets=200, time_limit=600.0)
observations, infos = parallel.reset(seed=0)
actions = {agent: 0 for agent in parallel.agents if infos[agent]["requires_retasking"]}
observations, rewards, terminations, truncations, infos = parallel.step(actions)
print({agent: round(float(reward), 3) for agent, reward in rewards.items()})

# %%
# Next steps
# ----------
#
# - :ref:`tutorial-marl`: train constellations with BenchMARL.
# - :ref:`tutorial-evaluating`: evaluate and publish a policy.
# - :ref:`tutorial-film`: watch a constellation.
