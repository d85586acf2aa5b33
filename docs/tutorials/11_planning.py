"""
.. _tutorial-planning:

Plan ahead and compute bounds
=============================

Simulate copies of an episode before deciding, compute an upper bound for any policy, and execute a mixed-integer schedule.

The task is agile imaging: one orbit with 3000 targets on Earth. A satellite observes the next 32 targets and chooses one at a
time; slews take most of the time.
"""

# %%
# Result
# ------
#
# The same episodes are played with random actions, a rule, the pretrained policy, and a planner:
import time

import torch
from matplotlib import pyplot

import bsk_torch
from bsk_torch.lab.bounds import ScheduledPolicy, imaging_bound, milp_schedule
from bsk_torch.lab.planners import Rollout
from bsk_torch.rl.evaluation import evaluate
from bsk_torch.rl.policies import pretrained

# sphinx_gallery_thumbnail_path = "_static/readme/AEOSCity-v1.png"
EPISODES = 8
SECONDS = 5700.0
TARGETS = 3000
LIMIT = 10.0
SEED = 1

torch.set_num_threads(1)
env = bsk_torch.make(
    "AEOS-v1", num_envs=EPISODES, n_targets=TARGETS, time_limit=SECONDS, as_set=True
)
results, spent = {}, {}


def fly(name, policy, before=0.0):
    """Play the episodes; ``before`` is the computation time before them, s."""
    begun = time.process_time()
    results[name] = evaluate(policy, env, seed=SEED)
    spent[name] = (before + time.process_time() - begun) / EPISODES
    print(
        f"{name:10} {results[name].mean_return}  {spent[name]:6.2f} s for each episode"
    )


fly("random", bsk_torch.rule("random", env))
fly("hasty", bsk_torch.rule("hasty", env))
fly("trained", pretrained("AEOS-v1"))
fly("planner", Rollout(env, "hasty", horizon=240.0, budget=8, gamma=0.997))

# %%
# Use a planner
# -------------
#
# ``Rollout`` copies every episode once for each of the rule's eight preferred targets, images the target in the copy, and
# continues with the rule, for 240 s in total. In the true episode, it then takes the action whose copy had the highest return. It
# repeats this at each decision. A planner is used like any other policy, and also counts the seconds of flight simulated per
# decision:
print(
    f"{float(results['planner'].simulated_per_decision):,.0f}",
    "simulated seconds per decision",
)
print("gain over the rule", results["planner"].gain_over(results["hasty"]))

# %%
# Compute an upper bound
# ----------------------
# No policy collects more than the bound of its episode. The bound solves an easier problem: every image lies within a window,
# each target counts once, and two images are separated by at least the shortest time found among a million recorded pairs at the
# same angle.
env.set_seed(SEED)
env.reset()
bound = imaging_bound(env, iterations=30)
for name, result in results.items():
    print(
        f"{name:10} {float(result.returns.sum() / bound.upper.sum()):.0%} of the bound"
    )
print(
    "no higher than all targets that come into view:",
    bool((bound.upper <= bound.in_view * (1.0 + 1e-9)).all()),
)

# %%
# Compute a schedule
# ------------------
#
# The BSK-RL paper compares learned policies with mixed-integer programs, which choose targets and times. They use typical times
# between images instead of the shortest ones. HiGHS solves one program per episode, with all targets known in advance. The
# schedule is executed in closed loop: if the satellite is late, images are taken later than scheduled, images that have become
# impossible are skipped, and the rule takes over after the end of the schedule.
begun = time.process_time()
env.set_seed(SEED)
env.reset()
schedule = milp_schedule(env, seconds=LIMIT)
seconds = time.process_time() - begun
fly(
    "schedule",
    ScheduledPolicy(env, schedule, bsk_torch.rule("hasty", env)),
    before=seconds,
)

# %%
# Compare return and computation
# ------------------------------
#
# The figure shows the return as a share of the bound over the computation time:
figure, axes = pyplot.subplots(figsize=(7.0, 3.2))
for name, result in results.items():
    share = float(result.returns.sum() / bound.upper.sum())
    axes.plot(max(spent[name], 1e-3), share, "o")
    axes.annotate(
        name, (max(spent[name], 1e-3), share), textcoords="offset points", xytext=(6, 4)
    )
axes.axhline(1.0, color="0.5", linewidth=0.8)
axes.set(
    xscale="log",
    xlabel="seconds of one core for each episode",
    ylabel="share of the bound",
)
figure.tight_layout()

# %%
# ``benchmarks/planners.py``, ``benchmarks/bounds.py`` and ``benchmarks/milp.py`` do this with hundreds of episodes and up to
# 10,000 targets; for results, see the studies of planners and of bounds. To use a planner on the command line, run
#
# .. code-block:: text
#
#     bsk-torch eval plan:rollout --preset AEOS-v1 --seeds 0:8 \
#         --plan base=hasty --plan horizon=240 --plan budget=8
#
# Next steps
# ----------
#
# - :ref:`tutorial-imaging`: the task and its rules.
# - :ref:`tutorial-evaluating`: evaluate and publish policies.
# - :doc:`/how_to/plan`: tree search, value networks, and planners for continuous actions.
