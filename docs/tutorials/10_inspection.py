"""
.. _tutorial-inspection:

Inspect a spacecraft
====================

Fly around another spacecraft with velocity changes until its surface has been seen in sunlight: rules, figures, and training.

The inspected spacecraft, the RSO (resident space object), is a sphere with 100 points. An inspector starts some hundred meters
away, with fuel for 10 m/s. To inspect a point, it must be closer than 250 m and within 30 degrees of the point's normal, with the
Sun within 60 degrees.
"""

# %%
# Result
# ------
#
# One inspector flies from waypoint to waypoint by a rule: of 96 transfers, the rule chooses the one with the largest number of
# newly seen points minus costs of fuel and time.
import torch

import bsk_torch
from bsk_torch.viz.episodes import draw, record

# sphinx_gallery_thumbnail_path = "_static/readme/RSOInspection-v1.png"
EPISODES = 64
SECONDS = 57_000.0
FRAMES, NUM_ENVS = 8_192, 64

torch.set_num_threads(1)
env = bsk_torch.make(
    "RSOInspection-v1", num_envs=1, actions="waypoints", time_limit=SECONDS
)
episode = record(bsk_torch.rule("survey", env), env, seed=2)
path = draw(episode, "inspection.png", "survey by waypoints")
print(episode.outcome)

# %%
# The paths are drawn in the RSO's Hill frame (radial, along-track and normal to the orbit), which rotates once per orbit. The map
# shows the inspection time of the points; gray points were lit but not inspected. Points that never see the Sun do not count: the
# inspection is complete when 90 percent of the lit points are inspected.
#
# Change the velocity
# -------------------
#
# By default, actions are continuous, as in bsk_rl: a velocity change in the Hill frame, in m/s, and the drift time, in s. Steps
# end when an inspector finishes its drift. The RSO is also an agent, but it has only one action:
env = bsk_torch.make("RSOInspection-v1", num_envs=2, seed=0, time_limit=SECONDS)
td = env.reset()
for group, agents in env.group_map.items():
    print(
        group,
        agents,
        list(env.action_spec[group, "action"].shape),
        list(td[group, "observation"].shape),
    )

rso, inspector = env.group_map
td[rso, "action"] = torch.zeros(2, 1, dtype=torch.int64)
td[inspector, "action"] = torch.tensor(
    [[[0.0, 0.1, 0.0, 600.0]], [[0.0, 0.0, 0.2, 300.0]]]
)
td = env.step(td)["next"]
print("seconds  ", td["duration"].flatten().tolist())
print("reward   ", td[inspector, "reward"].flatten().tolist())
print("fuel, m/s", env.satellites[1].fsw.dv_available.tolist())

# %%
# The reward is the fraction of newly inspected points, minus 0.1 per m/s, plus 1 for completing the inspection.
# ``env.rewarder.inspected`` and ``env.rewarder.illuminated`` are tables ``[N, 100]`` of the points inspected and lit so far.
#
# Compare rules
# -------------
#
# *Drift* never thrusts: a small difference in orbital period carries the inspector away, and it dies 1000 m from the RSO.
# *Circumnavigate* cancels this difference every ten minutes and flies around the RSO, but at its initial distance. *Survey*
# approaches the RSO and searches for points that are not inspected yet.
from bsk_torch.rl.evaluation import evaluate

env = bsk_torch.make("RSOInspection-v1", num_envs=EPISODES, time_limit=SECONDS)
for rule in ("drift", "circumnavigate", "survey"):
    result = evaluate(bsk_torch.rule(rule, env), env, seed=1)
    complete, points = (
        env.rewarder.bonus_reward_yielded.double().mean(),
        env.rewarder.inspected.sum(1).double().mean(),
    )
    spent = 10.0 - env.satellites[1].fsw.dv_available.mean()
    print(
        f"{rule:15} return {result.mean_return}, {points:3.0f} points,",
        f"{complete:4.0%} complete, {spent:.1f} m/s",
    )

# %%
# Fuel-efficient circumnavigation
# ~~~~~~~~~~~~~~~~~~~~~~~~~~~~~~~
# Near a circular orbit, relative motion follows the Clohessy-Wiltshire equations. Relative to the RSO, an orbit with the same
# period is an ellipse that is twice as long along the track as it is in the radial direction. Since the RSO's orbit is not quite
# circular, small corrections are needed:
env = bsk_torch.make("RSOInspection-v1", num_envs=1, time_limit=min(SECONDS, 17_100.0))
episode = record(bsk_torch.rule("circumnavigate", env), env, seed=6)
path = draw(episode, "circumnavigation.png", "natural motion")

# %%
# Three inspectors
# ----------------
# In ``MultiInspection-v1``, points are shared, so the inspection is complete earlier. Inspectors that come within 4 m of each
# other die. With waypoints, transfers that pass close to the predicted path of another inspector are masked.
env = bsk_torch.make(
    "MultiInspection-v1", num_envs=1, actions="waypoints", time_limit=SECONDS
)
episode = record(bsk_torch.rule("survey", env), env, seed=4)
path = draw(episode, "three.png", "three inspectors")

# %%
# Train
# -----
# With ``actions="waypoints"``, a policy chooses among the 96 transfers, and unsafe ones are masked. ``configure`` returns the
# settings of a training run. This run is far too short to learn the task and only demonstrates how to start:
import tempfile
from pathlib import Path

from bsk_torch.rl.marl import configure, training_of
from bsk_torch.rl.training.log import LOG, read_log
from bsk_torch.viz.figures.curves import learning_curve

settings = dict(
    num_envs=NUM_ENVS,
    rollout=16,
    hidden=(128, 128),
    gamma=0.9999,
    epochs=4,
    minibatch=1024,
)
options = dict(actions="waypoints", time_limit=SECONDS)
folder = Path(tempfile.mkdtemp()) / "inspection"
config = configure(
    "RSOInspection-v1",
    frames=FRAMES,
    evaluate_every=0,
    options=options,
    **settings,
)
policy = training_of(config, folder).run()
path = learning_curve(read_log(folder / LOG), Path("curve.png"), {}, "RSOInspection-v1")

# %%
# The discount is per second: rewards one hour ahead are multiplied by ``0.9999 ** 3600``, about 0.7. The full training takes ten
# minutes on two cores. It compares the policy with random actions and the rule, and plots an episode:
#
# .. code-block:: text
#
#     bsk-torch train RSOInspection-v1 --minutes 10 options.actions=waypoints \
#         num_envs=256 rollout=16 'hidden=[128,128]' gamma=0.9999 epochs=4 \
#         minibatch=1024 learning_rate=1e-3 entropy=0.01 evaluate_every=50000
#
# Next steps
# ----------
#
# - :ref:`tutorial-constellations`: groups of agents, and shared knowledge.
# - :ref:`tutorial-evaluating`: evaluate and publish policies.
# - :ref:`tutorial-torchrl`: parts of a training loop.
