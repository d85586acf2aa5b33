"""
.. _tutorial-evaluating:

Evaluate and publish a policy
=============================

Compare policies in the same episodes, write a report, and pass a policy on as one file with a checksum.

Episodes differ a lot: a satellite that starts with a full battery earns more than one that starts with little. Policies are
therefore compared in the same episodes, and the differences are averaged.
"""

# %%
# The result
# ----------
#
# What the policy of the package gains over a rule, episode by episode:
import matplotlib.pyplot as plt
import torch

import bsk_torch
from bsk_torch.rl.evaluation import evaluate
from bsk_torch.rl.policies import pretrained
from bsk_torch.rl.rules import BASELINES

EPISODES = 512
FRAMES = 65_536
SECONDS = 28_500.0

torch.set_num_threads(1)
env = bsk_torch.make("NadirScan-v1", num_envs=EPISODES, env_ids=[0] * EPISODES, time_limit=SECONDS)
players = {"trained": pretrained("NadirScan-v1"), "rule": BASELINES["rule"](env, 0)}
results = {name: evaluate(player, env, seeds=range(EPISODES)) for name, player in players.items()}
trained, rule = results["trained"], results["rule"]

figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.4), layout="constrained")
left.plot([-1.2, 1], [-1.2, 1], color="#d9dde3")
left.plot(rule.returns, trained.returns, ".", color="#2f6db3", markersize=4, alpha=0.6)
left.set(xlabel="return of the rule", ylabel="return of the trained policy")
right.hist((trained.returns - rule.returns).clamp(-0.5, 0.5).numpy(), bins=40, color="#2f6db3")
right.axvline(0.0, color="#333a45", linewidth=1)
right.set(xlabel="gain (ends of the axis: or more)", ylabel="episodes")

# %%
# Each dot is an episode; those above the line are better with the trained policy. The interval of the mean difference is narrower
# than it would be in two different sets of episodes:
print("trained:", trained.mean_return, f"survival {trained.survival:.1%}")
print("rule:   ", rule.mean_return, f"survival {rule.survival:.1%}")
print("gain:   ", trained.gain_over(rule))
apart = (trained.mean_return.half_width**2 + rule.mean_return.half_width**2) ** 0.5
print(f"in different episodes the gain would be known to ± {apart:.3f}")

# %%
# All intervals are those of 95 % confidence. An ``Evaluation`` also has the causes of deaths, the lengths of episodes, how full
# the store was at the end, and what the environment has counted:
print(rule.causes, f"{trained.fill.mean():.0%} full,", f"{trained.decisions.double().mean():.0f} decisions")

# %%
# ``seeds`` names single episodes: seed 7 is the one that ``gymnasium.make("bsk_torch/NadirScan-v1").reset(seed=7)`` starts, on
# every machine and in every batch size. ``seed`` instead starts as many episodes as the environment has rows. Seeds of training
# and evaluation should differ; ``FRESH`` is what ``compare`` adds.
#
# On the command line
# -------------------
#
# ``bsk-torch eval`` prints the same numbers for a folder of a run, a file, ``pretrained``, or a baseline. ``--shield`` adds the
# policy behind a shield, ``--out`` and ``--episodes-out`` keep the numbers. This is
# ``bsk-torch eval pretrained --preset NadirScan-v1 --seeds 0:200 --shield safe``:
from bsk_torch.cli import app
from bsk_torch.cli.shared import console

SEEDS, SHOWN = "0:200", "8"
LIMIT = []  # or another length of episodes: ["--time-limit", "5700"]


def bsk_torch_command(*arguments):
    """Do what the command does, in this process."""
    app(arguments, standalone_mode=False)


console.width = 120
bsk_torch_command("eval", "pretrained", "--preset", "NadirScan-v1", "--seeds", SEEDS, "--shield", "safe", *LIMIT)

# %%
# A report
# --------
#
# ``bsk-torch report`` turns the folder of a run into one HTML page: learning curves, the table of the evaluation, causes of
# death, the best, the median and the worst episode. Here for a short training:
import tempfile
from pathlib import Path

from bsk_torch.rl.training import Training, configure

folder = Path(tempfile.mkdtemp()) / "scan"
short = dict(frames=FRAMES, seconds=None, num_envs=128, rollout=16, evaluate_every=0, options={"time_limit": SECONDS})
policy = Training(configure("NadirScan-v1", **short), folder).run()
bsk_torch_command("report", str(folder), "--episodes", SHOWN)

# %%
# The curves of a report of a full training; the marks are figures of the BSK-RL paper:
#
# .. image:: /../benchmarks/results/report.png
#    :alt: Return, survival, collected data and fill of the store over training, with the paper's figures marked
#
# A policy is a file
# ------------------
#
# ``policy.pt`` in the folder of a run is all that is needed: weights, how the networks are built, and in which environment the
# policy was trained. ``load_policy`` reads it on another machine, ``read_card`` says what it is, and ``check_fits`` refuses an
# environment with other observations or actions.
import shutil

from bsk_torch.rl.policies import check_fits, load_policy, read_card

file = shutil.copy(folder / "policy.pt", folder.parent / "elsewhere.pt")
card = read_card(file)
print(card["preset"], card["network"], card["bsk_torch"], f"{Path(file).stat().st_size / 1e3:.0f} kB")

env = bsk_torch.make(card["preset"], num_envs=4, **card["options"])
check_fits(card, env, card["preset"])
loaded = load_policy(file)
td = env.reset()
print("the same actions:", bool((loaded(td.clone())["action"] == policy(td.clone())["action"]).all()))

# %%
# The file carries a checksum, and reading it executes nothing, whoever has written it. A file that is damaged is refused:
damaged = bytearray(Path(file).read_bytes())
damaged[len(damaged) // 2] ^= 1
Path(file).write_bytes(damaged)
try:
    load_policy(file)
except ValueError as error:
    print(str(error).replace(str(folder.parent), "..."))

# %%
# ``bsk-torch publish RUN --folder FOLDER`` evaluates the policy of a run, copies it, and notes command, time, machine and score
# alongside it in ``policies.json``. The policies of the package were published in this way:
from bsk_torch.rl.policies import makings

for preset, making in makings().items():
    score = making["score"]
    print(f"{preset:22} {score['return']:8.3f} in {score['episodes']} episodes, by {making['command']}")

# %%
# Next
# ----
#
# - :ref:`tutorial-film`: watch a policy.
# - :ref:`tutorial-curriculum`: shields.
# - :ref:`examples`: programs to copy.
#
# sphinx_gallery_thumbnail_number = 1
