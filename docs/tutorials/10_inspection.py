"""
.. _tutorial-inspection:

Inspect a spacecraft
====================

Fly about another spacecraft by changes of velocity, until its surface has been seen in sunlight: rules, pictures, and training.

The inspected spacecraft, the RSO (resident space object), is a sphere with 100 points. An inspector starts some hundred metres
away, with fuel for 10 m/s. It inspects a point from less than 250 m, within 30 degrees of its normal, with the Sun within 60.
"""

# %%
# The result
# ----------
#
# One inspector that flies from waypoint to waypoint, by a rule: of 96 transfers it takes the one that shows the most points,
# less fuel and time.
import torch

import bsk_torch
from bsk_torch.rl.marl import shared_baseline
from bsk_torch.viz.episodes import draw, record

EPISODES = 64
SECONDS = 57_000.0
FRAMES, NUM_ENVS = 8_192, 64

torch.set_num_threads(1)
env = bsk_torch.make("RSOInspection-v1", num_envs=1, actions="waypoints", time_limit=SECONDS)
episode = record(shared_baseline("survey", env), env, seed=2)
path = draw(episode, "inspection.png", "survey by waypoints")
print(episode.outcome)

# %%
# The paths are drawn in the RSO's Hill frame: radial, along the track and normal to the orbit, which turns once in an orbit. The
# map shows the points by the time when they were inspected; grey ones were lit, but not inspected. Points that never see the Sun
# do not count: the inspection is complete when 90 percent of those that were lit are inspected.
#
# Changes of velocity
# -------------------
#
# By default actions are real numbers, as in bsk_rl: a change of velocity in the Hill frame, m/s, and the time to drift, s.
# Steps end when an inspector has finished its drift. The RSO is an agent, too, and has nothing to decide:
env = bsk_torch.make("RSOInspection-v1", num_envs=2, seed=0, time_limit=SECONDS)
td = env.reset()
for group, agents in env.group_map.items():
    print(group, agents, list(env.action_spec[group, "action"].shape), list(td[group, "observation"].shape))

rso, inspector = env.group_map
td[rso, "action"] = torch.zeros(2, 1, dtype=torch.int64)
td[inspector, "action"] = torch.tensor([[[0.0, 0.1, 0.0, 600.0]], [[0.0, 0.0, 0.2, 300.0]]])
td = env.step(td)["next"]
print("seconds  ", td["duration"].flatten().tolist())
print("reward   ", td[inspector, "reward"].flatten().tolist())
print("fuel, m/s", env.satellites[1].fsw.dv_available.tolist())

# %%
# The reward is the fraction of points not inspected before, less 0.1 for each m/s, and 1 for completing the
# inspection. ``env.rewarder.inspected`` and ``illuminated`` are tables ``[N, 100]`` of what is known.
#
# Three rules
# -----------
#
# *Drift* never thrusts: a small difference of the orbits' periods carries the inspector away, and it dies 1000 m from the RSO.
# *Circumnavigate* cancels that difference every ten minutes, and flies around the RSO, but at the distance at which it started.
# *Survey* comes near, and looks for points that are missing.
from bsk_torch.rl.evaluation import evaluate

env = bsk_torch.make("RSOInspection-v1", num_envs=EPISODES, time_limit=SECONDS)
for rule in ("drift", "circumnavigate", "survey"):
    result = evaluate(shared_baseline(rule, env), env, seed=1)
    complete, points = env.rewarder.bonus_reward_yielded.double().mean(), env.rewarder.inspected.sum(1).double().mean()
    spent = 10.0 - env.satellites[1].fsw.dv_available.mean()
    print(f"{rule:15} return {result.mean_return}, {points:3.0f} points, {complete:4.0%} complete, {spent:.1f} m/s")

# %%
# Around the RSO with little fuel
# ~~~~~~~~~~~~~~~~~~~~~~~~~~~~~~~
#
# Near a circular orbit, relative motion follows the equations of Clohessy and Wiltshire. An orbit of the same period is, seen
# from the RSO, an ellipse that is twice as long as it is high. Since the RSO's orbit is not quite circular, small corrections
# are needed:
env = bsk_torch.make("RSOInspection-v1", num_envs=1, time_limit=min(SECONDS, 17_100.0))
episode = record(shared_baseline("circumnavigate", env), env, seed=6)
path = draw(episode, "circumnavigation.png", "natural motion")

# %%
# Three inspectors
# ----------------
#
# In ``MultiInspection-v1`` points are shared, so the inspection is complete earlier. Inspectors die that come within 4 m of each
# other. With waypoints, those transfers are illegal that would come near another inspector if it drifted on.
env = bsk_torch.make("MultiInspection-v1", num_envs=1, actions="waypoints", time_limit=SECONDS)
episode = record(shared_baseline("survey", env), env, seed=4)
path = draw(episode, "three.png", "three inspectors")

# %%
# Train
# -----
#
# With ``actions="waypoints"`` a policy chooses among the 96 transfers, with a mask of those that are safe. ``configure_run``
# returns the settings of a training; this one is far too short to learn the task, and shows how it begins:
import tempfile
from pathlib import Path

from bsk_torch.rl.marl import configure_run, training_of
from bsk_torch.rl.training.log import LOG, read_log
from bsk_torch.viz.figures.curves import learning_curve

settings = dict(num_envs=NUM_ENVS, rollout=16, hidden=(128, 128), gamma=0.9999, epochs=4, minibatch=1024)
options = dict(actions="waypoints", time_limit=SECONDS)
folder = Path(tempfile.mkdtemp()) / "inspection"
config = configure_run("RSOInspection-v1", frames=FRAMES, seconds=None, evaluate_every=0, options=options, **settings)
policy = training_of(config, folder).run()
path = learning_curve(read_log(folder / LOG), Path("curve.png"), {}, "RSOInspection-v1")

# %%
# The discount is per second: after an hour the future counts ``0.9999 ** 3600``, about 0.7. The full training takes ten minutes
# on two cores. It compares the policy with chance and with the rule, and draws an episode:
#
# .. code-block:: text
#
#     bsk-torch train RSOInspection-v1 --minutes 10 options.actions=waypoints num_envs=256 rollout=16 \
#         'hidden=[128,128]' gamma=0.9999 epochs=4 minibatch=1024 learning_rate=1e-3 entropy=0.01 evaluate_every=50000
#
# Next
# ----
#
# - :ref:`tutorial-constellations`: groups of agents, and what they know.
# - :ref:`tutorial-evaluating`: compare policies, and pass one on.
# - :ref:`tutorial-torchrl`: what a training consists of.
#
# sphinx_gallery_thumbnail_number = 1
