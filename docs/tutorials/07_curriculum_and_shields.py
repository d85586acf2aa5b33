"""
.. _tutorial-curriculum:

Curriculum and shields
======================

Increase the difficulty when the satellite survives an episode, and mask actions that would lead to its death.

A curriculum changes the arguments of the satellite between episodes, separately for each environment. A shield is a rule that
restricts the mask of legal actions. Neither needs recompilation.
"""

# %%
# Result
# ------
#
# Each environment has a level from 0 to 1. At higher levels, the scanning satellite starts with less charge and faster wheels.
# When an episode ends, the level rises if the satellite survived, and falls otherwise. Here, a hand-written rule takes the place
# of a policy that learns.
import torch
from torchrl.envs.utils import step_mdp

import bsk_torch
from bsk_torch import rand

# sphinx_gallery_thumbnail_number = 1
NUM_ENVS = 128
STEPS = 1000
EPISODES = 256
SECONDS = 5700.0

SCAN, CHARGE, DOWNLINK, DESAT = range(4)
CAPACITY = 200 * 3600.0  # W s

torch.set_num_threads(1)
level = torch.zeros(NUM_ENVS, dtype=torch.float64)
charge = torch.full((NUM_ENVS,), 0.9 * CAPACITY, dtype=torch.float64)
wheels = torch.full((NUM_ENVS, 3), 500.0, dtype=torch.float64)  # rpm
arguments = {
    "storedCharge_Init": rand.per_env(charge),
    "wheelSpeeds": rand.per_env(wheels),
}
env = bsk_torch.make(
    "NadirScan-v1", num_envs=NUM_ENVS, sat_args=arguments, time_limit=SECONDS, seed=1
)


def harder(ended, survived):
    """Change the levels of the ended episodes [N], and the arguments that depend on them."""
    level.add_(torch.where(ended, torch.where(survived, 0.1, -0.2), 0.0)).clamp_(
        0.0, 1.0
    )
    charge.copy_((0.9 - 0.8 * level) * CAPACITY)
    wheels.copy_((500.0 + 5400.0 * level).unsqueeze(1) * torch.tensor([1.0, -1.0, 1.0]))
    env.set_sat_args(arguments, envs=ended)


def rule(satellite):
    """Slow down fast wheels, charge below 40 %, else scan; actions [N]."""
    state = satellite.dynamics
    action = torch.full((NUM_ENVS,), SCAN)
    action[state.storage_level_fraction > 0.9] = DOWNLINK
    action[state.wheel_speeds_fraction.abs().amax(-1) > 0.7] = DESAT
    action[state.battery_charge_fraction < 0.4] = CHARGE
    return action


td = env.reset()
levels = []
for _ in range(STEPS):
    td["action"] = rule(env.satellite)
    td = step_mdp(env.step(td))
    ended = td["done"].squeeze(-1)
    if ended.any():
        harder(ended, ~env.dead)
        td = env.maybe_reset(td)
    levels.append(level.clone())

# %%
import matplotlib.pyplot as plt

table = torch.stack(levels)
figure, panel = plt.subplots(figsize=(8, 3), layout="constrained")
for share, opacity in ((0.05, 0.15), (0.25, 0.3)):
    panel.fill_between(
        range(STEPS),
        table.quantile(share, 1),
        table.quantile(1 - share, 1),
        color="#2f6db3",
        alpha=opacity,
        linewidth=0,
    )
panel.plot(table.mean(1), color="#2f6db3")
panel.set(xlabel="steps", ylabel="level", ylim=(0, 1))
panel.grid(axis="y", alpha=0.3)

# %%
# The line is the mean; the dark band contains half of the environments, and the light band nine tenths. The levels converge to
# the point where the rule survives two thirds of the episodes, because a failure lowers the level by twice as much as a success
# raises it.
#
# Mechanism
# ---------
#
# - ``rand.per_env(tensor)`` is the value of an argument, with one row per environment. The tensor may be edited in place.
# - ``env.set_sat_args(arguments, envs=ended)`` gives the new values to the environments ``ended``. Large batches prepare their
#   next episodes in advance; the prepared episodes of ``ended`` are discarded.
# - ``env.maybe_reset`` starts the next episodes.
#
# Distributions can be changed in the same way, for all environments at once. From the next episodes on, all satellites start with
# 20 to 40 % of charge:
env.set_sat_args({"storedCharge_Init": rand.Uniform(0.2 * CAPACITY, 0.4 * CAPACITY)})
env.reset()
share = env.satellite.dynamics.battery_charge_fraction
print(f"charge from {share.min():.0%} to {share.max():.0%}")

# %%
# Shields
# -------
# A shield is a function that takes the observation and the action names and returns a mask ``[N, A]``. ``allow_only`` and
# ``forbid`` build masks from names. Combine masks with ``&``.
from bsk_torch.act import allow_only, forbid
from bsk_torch.rl.evaluation import evaluate
from bsk_torch.rl.rules import RULES, shielded


def careful(see, actions):
    """Charge at a low level, slow down fast wheels, and do not scan with a full buffer."""
    low = see["battery_charge_fraction"] < 0.1
    fast = ~low & (see.all("wheel_speeds_fraction").abs().amax(-1) > 0.6)
    full = see["storage_level_fraction"] > 0.95
    return (
        allow_only(actions, "action_charge", where=low)
        & allow_only(actions, "action_desat", where=fast)
        & forbid(actions, "action_nadir_scan", where=full)
    )


env = bsk_torch.make("NadirScan-v1", num_envs=EPISODES)
policy = bsk_torch.rule("random", env)
players = {
    "random": policy,
    "careful": shielded(policy, careful, env),
    "safe": shielded(policy, RULES["safe"], env),
}
results = {name: evaluate(player, env, seed=2) for name, player in players.items()}
for name, result in results.items():
    low, high = result.survival_interval
    print(
        f"{name:8} return {result.mean_return},",
        f"survival {result.survival:6.1%} ({low:.1%} to {high:.1%})",
    )

# %%
# ``RULES["safe"]`` is the shield of ``bsk-torch eval ... --shield safe``, with empirically chosen limits. If a shield would mask
# all actions, the mask is left unchanged.
#
# Train with a shield
# -------------------
#
# ``shielded`` restricts ``action_mask`` before the policy chooses. The method ``legal_actions`` of a satellite has the same
# effect for every library and algorithm, because the mask that it returns becomes the environment's ``action_mask``.
from bsk_torch import SatelliteTasking, data, scene
from bsk_torch.presets.nadir_scan import ScanningSatellite, scanning_args


class CarefulSatellite(ScanningSatellite):
    """The satellite of the preset, which has to charge when its battery is low."""

    def legal_actions(self):
        """Return [N, 4] booleans."""
        low = self.dynamics.battery_charge_fraction < 0.1
        return allow_only(self.action_description, "action_charge", where=low)


env = SatelliteTasking(
    CarefulSatellite(
        "Scanner1",
        sat_args=scanning_args()
        | dict(storedCharge_Init=rand.Uniform(0.05 * CAPACITY, 0.15 * CAPACITY)),
    ),
    scenario=scene.UniformNadirScanning(value_per_second=1 / 28_500.0),
    rewarder=data.ScanningTimeReward(),
    time_limit=28_500.0,
    failure_penalty=-1.0,
    num_envs=6,
    seed=0,
)
td = env.reset()
for fraction, mask in zip(
    env.satellite.dynamics.battery_charge_fraction.tolist(),
    td["action_mask"].tolist(),
    strict=True,
):
    print(f"charge {fraction:5.1%}, legal actions {[int(legal) for legal in mask]}")

# %%
# Next steps
# ----------
#
# - :ref:`sphx_glr_gallery_curriculum.py`: the curriculum as a program with options.
# - :ref:`sphx_glr_gallery_bsk_rl_training_with_shield.py`: BSK-RL's example, trained with a shield that masks unsafe actions and
#   with one that replaces them.
# - :ref:`tutorial-evaluating`: compare policies with and without a shield.
