"""
.. _tutorial-imaging:

Choose targets with an agile satellite
======================================

Targets, windows and opportunities, a rule based on value and angle, and the parts of a custom environment.

An agile satellite points its camera at targets near its ground track. Each target has a priority, the reward for its first image,
and windows, the times at which the satellite is high enough above the target's horizon. Slews take time, so choosing one target
means skipping others.
"""

# %%
# Result
# ------
#
# This is one orbit with the pretrained policy and 1,000 targets:
import torch

import bsk_torch
from bsk_torch.rl.policies import pretrained
from bsk_torch.viz.episodes import draw, record

# sphinx_gallery_thumbnail_path = "_static/readme/AEOS-v1.png"
EPISODES = 128
ORBIT = 5700.0

torch.set_num_threads(1)
world = dict(n_targets=1000, time_limit=ORBIT)
env = bsk_torch.make("AEOS-v1", as_set=True, **world)
episode = record(pretrained("AEOS-v1"), env, seed=3)
path = draw(episode, "trained.png", "trained policy")

# %%
# The map shows all targets and the ground track. The panel below shows the ten minutes with the most images: lines connect the
# satellite's positions to the targets imaged from there, and the size of a target shows its priority. The last panel shows the
# decisions, with the priority of the chosen target as height, and the sum of rewards.
#
# Observations
# ------------
# The preset ``AEOS-v1`` observes the satellite and the next 32 targets, in the order in which their windows close. Imaged targets
# are excluded.
env = bsk_torch.make("AEOS-v1", num_envs=EPISODES, **world)
env.set_seed(0)
td = env.reset()
names = env.satellite.observation_description
print(td["observation"].shape)
for name, value in zip(names[:20], td["observation"][0, :20].tolist(), strict=True):
    print(f"{name:40} {value:7.3f}")

# %%
# Values are normalized: the angle between camera and target is divided by pi, and the seconds until a window opens and closes by
# 300. If a window is already open, the time until it opens is negative.
#
# Action ``k`` images the ``k``-th of these targets. The step ends when the image is taken, when the target's window closes, or
# after 300 s, so the duration of decisions varies:
td["action"] = torch.zeros(EPISODES, dtype=torch.int64)
td = env.step(td)["next"]
print("seconds ", td["duration"][:5].flatten().tolist())
print("rewards ", td["reward"][:5].flatten().tolist())
print("images  ", td["counts", "imaged"][:5].flatten().tolist())

# %%
# Windows and opportunities
# -------------------------
# An opportunity is one window of one target. The satellite object lists all upcoming opportunities, including those that are not
# observed:
ahead = env.satellite.find_next_opportunities(6)
now = env.simulator.sim_time
for k in range(6):
    target = int(ahead.place[0, k])
    start, end = (float(time[0, k] - now[0]) for time in (ahead.open, ahead.close))
    worth = float(env.scenario.priority[0, target])
    print(
        f"target {target:3}: {start:6.1f} to {end:6.1f} s from now, priority {worth:.2f}"
    )

# %%
# ``place`` is the index of the target; ``env.scenario.priority`` and ``env.scenario.r_LP_P`` are tables of all targets in all
# episodes. An action may also select a target directly, whether or not it is in view, with ``bsk_torch.act.image_target``:
from bsk_torch import act

best = env.scenario.priority.gather(1, ahead.place).argmax(1, keepdim=True)
td["action"] = act.image_target(ahead.place.gather(1, best).squeeze(1))
td = env.step(td)["next"]
print("imaged after", td["duration"][:5].flatten().tolist(), "s")

# %%
# Write a custom rule
# -------------------
#
# The most valuable target is often far away, and the nearest one often has a low priority. This rule divides the priority by a
# power of the time needed for the image: the slew time, or the time until the window opens if that is longer. The agile satellite
# of the presets slews by 1 rad in about a minute, and slew time grows with the square root of the angle.
from tensordict.nn import TensorDictModule

from bsk_torch.rl.rules import Columns

TURN = 58.0  # s for 1 rad
SETTLE = 20.0  # s added to each image


def decide(observation, action_mask):
    """Observations [N, 269] and legal actions [N, 32] to actions [N]."""
    see = Columns(observation, names)
    angle = see.all("target_angle_normd").clamp(min=0.0) * torch.pi
    wait = see.all("opportunity_open_normd") * 300.0
    close = see.all("opportunity_close_normd") * 300.0
    seconds = torch.maximum(TURN * angle.sqrt(), wait)
    value = see.all("priority") / (SETTLE + seconds) ** 3
    return value.masked_fill((seconds > close) | ~action_mask, -1.0).argmax(1)


mine = TensorDictModule(
    decide, in_keys=["observation", "action_mask"], out_keys=["action"]
)

# %%
# The rule plays the same episodes as the baselines. *Greedy* chooses the most valuable target, *nearest* the target whose window
# closes next, and *hasty* discounts the value by the time needed for the image.
from bsk_torch.rl.evaluation import compare, comparison_table

print(comparison_table(compare({"mine": mine}, env, seed=0)))

# %%
# This rule flies the same orbit as above:
env = bsk_torch.make("AEOS-v1", **world)
episode = record(mine, env, seed=3)
path = draw(episode, "mine.png", "by value and angle")

# %%
# Change the targets
# ------------------
#
# The scenario defines the targets. ``scene.Targets`` takes places and priorities, ``scene.CityTargets`` uses cities,
# ``scene.CloudyTargets`` adds clouds observed only as forecasts, and ``scene.ChangingTargets`` supports targets that appear and
# vanish. The satellite does not change.
from bsk_torch import scene


def on_ground(latitude, longitude):
    """Degrees [T] to Earth-fixed positions, [T, 3] m, on a sphere."""
    lat, lon = (torch.deg2rad(x) for x in (latitude, longitude))
    return 6371e3 * torch.stack(
        [lat.cos() * lon.cos(), lat.cos() * lon.sin(), lat.sin()], -1
    )


torch.manual_seed(0)
grid = torch.cartesian_prod(
    torch.linspace(-40, 40, 9), torch.linspace(-180, 170, 36)
).double()
places = on_ground(grid[:, 0], grid[:, 1])
env = bsk_torch.make(
    "AEOS-v1", scenario=scene.Targets(places, torch.rand(len(places))), time_limit=ORBIT
)
path = draw(record(mine, env, seed=3), "grid.png", "a grid of targets")

# %%
# Define a satellite
# ------------------
#
# As in BSK-RL, an environment is composed of parts: a satellite has observations, actions, dynamics and flight software; the
# environment adds a scenario and a rewarder. A new type of satellite is compiled on first use, which takes up to a minute.
# ``backend="eager"`` runs without compilation; it is slow, but sufficient for a few steps.
import math

from bsk_torch import SatelliteTasking, data, dyn, fsw, obs, sats

STEPS = 4


class Imager(sats.ImagingSatellite):
    """Images one of the next four targets, or charges for half a minute."""

    observation_spec = [
        obs.SatProperties(dict(prop="battery_charge_fraction"), dict(prop="c_hat_P")),
        obs.OpportunityProperties(
            dict(prop="priority"),
            dict(prop="target_angle", norm=math.pi),
            dict(prop="opportunity_open", norm=300.0),
            n_ahead_observe=4,
        ),
    ]
    action_spec = [act.Image(n_ahead_image=4), act.Charge(duration=30.0)]
    dyn_type = dyn.ImagingDynModel
    fsw_type = fsw.SteeringImagerFSWModel


agile = dict(
    imageAttErrorRequirement=0.01,
    u_max=0.4,
    K1=0.5,
    omega_max=math.radians(5.0),
    servo_P=30.0,
)
env = SatelliteTasking(
    Imager("EO1", sat_args=agile),
    scenario=scene.UniformTargets(5000),
    rewarder=data.UniqueImageReward(),
    max_step_duration=60.0,
    time_limit=ORBIT,
    num_envs=2,
    seed=0,
    backend="eager",
)
print(env.satellite.action_description)
rollout = env.rollout(STEPS)
print("actions", rollout["action"].tolist())
print("rewards", rollout["next", "reward"].squeeze(-1).tolist())
print("seconds", rollout["next", "duration"].squeeze(-1).tolist())

# %%
# Next steps
# ----------
#
# - :ref:`tutorial-constellations`: let many satellites share the targets.
# - :ref:`tutorial-sb3`: train with action masks.
# - :ref:`tutorial-curriculum`: change the environment during training.
