"""
.. _tutorial-evaluating:

Evaluate and publish a policy
=============================

Compare policies on the same episodes, write a report, and publish a policy as one file with a checksum.

Episodes vary widely: a satellite that starts with a full battery earns more than one that starts with little charge. Policies are
therefore compared on the same episodes, and the differences are averaged.
"""

# %%
# Result
# ------
#
# The figure shows the gain of the pretrained policy over a rule in each episode:
import matplotlib.pyplot as plt
import torch

import bsk_torch
from bsk_torch.rl.evaluation import evaluate
from bsk_torch.rl.policies import pretrained

# sphinx_gallery_thumbnail_number = 1
EPISODES = 512
FRAMES = 65_536
SECONDS = 28_500.0

torch.set_num_threads(1)
env = bsk_torch.make("NadirScan-v1", num_envs=EPISODES, time_limit=SECONDS)
players = {"trained": pretrained("NadirScan-v1"), "rule": bsk_torch.rule("rule", env)}
results = {
    name: evaluate(player, env, seeds=range(EPISODES))
    for name, player in players.items()
}
trained, rule = results["trained"], results["rule"]

figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.4), layout="constrained")
left.plot([-1.2, 1], [-1.2, 1], color="#d9dde3")
left.plot(rule.returns, trained.returns, ".", color="#2f6db3", markersize=4, alpha=0.6)
left.set(xlabel="return of the rule", ylabel="return of the trained policy")
right.hist(
    (trained.returns - rule.returns).clamp(-0.5, 0.5).numpy(), bins=40, color="#2f6db3"
)
right.axvline(0.0, color="#333a45", linewidth=1)
right.set(xlabel="gain (ends of the axis: or more)", ylabel="episodes")

# %%
# Each dot is an episode; in those above the line, the trained policy is better. The confidence interval of the mean difference is
# narrower than with two different sets of episodes:
print("trained:", trained.mean_return, f"survival {trained.survival:.1%}")
print("rule:   ", rule.mean_return, f"survival {rule.survival:.1%}")
print("gain:   ", trained.gain_over(rule))
apart = (trained.mean_return.half_width**2 + rule.mean_return.half_width**2) ** 0.5
print(f"in different episodes the gain would be known to ± {apart:.3f}")

# %%
# All intervals are 95 % confidence intervals. An ``Evaluation`` also contains the causes of death, the lengths of episodes, the
# fill level of the data buffer at the end, and the environment's counters:
print(
    rule.causes,
    f"{trained.fill.mean():.0%} full,",
    f"{trained.decisions.double().mean():.0f} decisions",
)

# %%
# ``seeds`` selects single episodes: seed 7 is the episode started by ``gymnasium.make("bsk_torch/NadirScan-v1").reset(seed=7)``,
# on every machine and with every batch size. With ``seed`` instead of ``seeds``, one episode starts in each environment. Use
# different seeds for training and evaluation; ``compare`` does so by adding a constant, ``FRESH``, to the seed.
#
# Use the command line
# --------------------
#
# ``bsk-torch eval`` prints the same numbers for a run folder, a file, ``pretrained``, or a baseline. ``--shield`` adds a row for
# the policy with a shield; ``--out`` and ``--episodes-out`` save the numbers. The code below runs ``bsk-torch eval pretrained
# --preset NadirScan-v1 --seeds 0:200 --shield safe``:
from bsk_torch.cli import app

SEEDS, SHOWN = "0:200", "8"
LIMIT = []  # or another length of episodes: ["--time-limit", "5700"]


def bsk_torch_command(*arguments):
    """Do what the command does, in this process."""
    app(arguments, standalone_mode=False)


bsk_torch_command(
    "eval",
    "pretrained",
    "--preset",
    "NadirScan-v1",
    "--seeds",
    SEEDS,
    "--shield",
    "safe",
    *LIMIT,
)

# %%
# Write a report
# --------------
#
# ``bsk-torch report`` converts a run folder to one HTML page with learning curves, the evaluation table, causes of death, and the
# best, median and worst episodes, which the viewer also plays. This is the report of a short training run:
import tempfile
from pathlib import Path

from bsk_torch.rl.training import Training, configure

folder = Path(tempfile.mkdtemp()) / "scan"
short = dict(
    frames=FRAMES,
    num_envs=128,
    rollout=16,
    evaluate_every=0,
    options={"time_limit": SECONDS},
)
policy = Training(configure("NadirScan-v1", **short), folder).run()
bsk_torch_command("report", str(folder), "--episodes", SHOWN)

# %%
# The curves of a full training run, with values of the BSK-RL paper marked:
#
# .. image:: /../benchmarks/results/report.png
#    :alt: Return, survival, collected data and buffer level over training, with the paper's values marked
#
# Load a policy file
# ------------------
#
# ``policy.pt`` in the run folder is self-contained: it contains the weights, the network architecture, and the training
# environment. ``policy_of_file`` reads it on any machine, ``read_card`` returns its metadata, and ``check_fits`` raises an error
# for an environment with other observations or actions. ``bsk_torch.load_policy(file, env)`` does all three.
import shutil

from bsk_torch.rl.policies import check_fits, policy_of_file, read_card

file = shutil.copy(folder / "policy.pt", folder.parent / "elsewhere.pt")
card = read_card(file)
print(
    card["preset"],
    card["network"],
    card["bsk_torch"],
    f"{Path(file).stat().st_size / 1e3:.0f} kB",
)

env = bsk_torch.make(card["preset"], num_envs=4, **card["options"])
check_fits(card, env, card["preset"])
loaded = policy_of_file(file)
td = env.reset()
print(
    "the same actions:",
    bool((loaded(td.clone())["action"] == policy(td.clone())["action"]).all()),
)

# %%
# The file has a checksum, and reading it never executes code from the file. A damaged file raises an error:
damaged = bytearray(Path(file).read_bytes())
damaged[len(damaged) // 2] ^= 1
Path(file).write_bytes(damaged)
try:
    policy_of_file(file)
except ValueError as error:
    print(str(error).replace(str(folder.parent), "..."))

# %%
# In a clone, ``python scripts/tools/publish_policy.py RUN --folder FOLDER`` evaluates the policy of a run, copies it to the
# folder, and records the command, time, machine and score in ``policies.json``. So were the package's policies published:
from bsk_torch.rl.policies import makings

for preset, making in makings().items():
    score = making["score"]
    print(f"{preset:22} {score['return']:8.3f} in {score['episodes']} episodes")
print(makings()["NadirScan-v1"]["command"])

# %%
# Next steps
# ----------
#
# - :ref:`tutorial-film`: watch a policy.
# - :ref:`tutorial-curriculum`: shields.
# - :ref:`examples`: programs to copy.
