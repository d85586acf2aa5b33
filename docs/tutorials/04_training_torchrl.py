"""
.. _tutorial-torchrl:

Train with TorchRL
==================

Train a policy for the scanning satellite in two ways: with the package's trainer in two lines, and with a customizable PPO loop
built from TorchRL components.

Decisions of this satellite last one to three minutes. The discount is therefore defined per second: after a decision of ``t``
seconds, future rewards are multiplied by ``gamma ** t``.
"""

# %%
# Result
# ------
#
# ``configure`` returns recommended settings for a preset. ``Training`` collects experience, trains, and saves the policy, logs
# and a checkpoint in a folder. This run is less than a tenth of a full training:
import tempfile
from pathlib import Path

import torch

import bsk_torch
from bsk_torch.rl.evaluation import compare, comparison_table
from bsk_torch.rl.training import Training, configure

# sphinx_gallery_thumbnail_number = 1
NUM_ENVS, ROLLOUT = 256, 32
FRAMES = 32 * NUM_ENVS * ROLLOUT
LOOP_FRAMES = 32 * NUM_ENVS * ROLLOUT
EPISODES = 128
SECONDS = 28_500.0

torch.set_num_threads(1)
folder = Path(tempfile.mkdtemp()) / "scan"
config = configure(
    "NadirScan-v1",
    frames=FRAMES,
    num_envs=NUM_ENVS,
    rollout=ROLLOUT,
    evaluate_every=0,
    options={"time_limit": SECONDS},
)
trained = Training(config, folder).run()
print(sorted(path.name for path in folder.iterdir()))

# %%
# ``compare`` plays unseen episodes, which are the same for the policy and for every applicable baseline:
env = bsk_torch.make("NadirScan-v1", num_envs=EPISODES, time_limit=SECONDS)
results = compare({"trained": trained}, env, seed=config.seed)
print(comparison_table(results))

# %%
# The learning curve is plotted with the baselines as horizontal lines:
from bsk_torch.rl.training.log import LOG, read_log
from bsk_torch.viz.figures.curves import learning_curve

levels = {
    name: (r.mean_return.mean, r.mean_return.half_width) for name, r in results.items()
}
path = learning_curve(read_log(folder / LOG), Path("curve.png"), levels, "NadirScan-v1")

# %%
# The equivalent command is
#
# .. code-block:: text
#
#     bsk-torch train NadirScan-v1 --frames 262144 --out runs/scan \
#         num_envs=256 rollout=32 evaluate_every=0
#
# which also evaluates the policy and saves figures. To continue the run, use ``bsk-torch train runs/scan --resume
# frames=3000000``. A full training of three million decisions takes a few minutes.
#
# Write the training loop
# -----------------------
#
# The rest of this page is a PPO loop built from TorchRL components, which you can customize. First, create the environment.
torch.manual_seed(0)
env = bsk_torch.make("NadirScan-v1", num_envs=NUM_ENVS, seed=0, time_limit=SECONDS)
n_observed = env.observation_spec["observation"].shape[-1]
n_actions = env.action_spec.space.n

# %%
# Actor and critic have two hidden layers, and share a normalizer of observations. ``MaskedCategorical`` sets the probability of
# illegal actions to zero, using the environment's ``action_mask``.
from tensordict.nn import TensorDictModule
from torch import nn
from torchrl.modules import MLP, MaskedCategorical, ProbabilisticActor, ValueOperator

from bsk_torch.rl.networks import FeatureNormaliser

normalizer = FeatureNormaliser(n_observed)


def network(outputs):
    """Return a network [N, F] -> [N, outputs] on normalized observations."""
    net = MLP(n_observed, outputs, num_cells=[64, 64], activation_class=nn.Tanh)
    return nn.Sequential(normalizer, net)


actor = ProbabilisticActor(
    TensorDictModule(network(n_actions), in_keys=["observation"], out_keys=["logits"]),
    in_keys={"logits": "logits", "mask": "action_mask"},
    distribution_class=MaskedCategorical,
    return_log_prob=True,
)
critic = ValueOperator(network(1), in_keys=["observation"])

# %%
# The collector steps all episodes together. Finished episodes restart; their last observations are under ``next``.
from torchrl.collectors import Collector

batch_size = NUM_ENVS * ROLLOUT
collector = Collector(
    env,
    actor,
    frames_per_batch=batch_size,
    total_frames=LOOP_FRAMES,
    auto_register_policy_transforms=False,
)

# %%
# ``DurationGAE`` is TorchRL's advantage estimator with a discount per second: 0.99999 is a factor of 0.57 over ten orbits.
from torchrl.objectives import ClipPPOLoss

from bsk_torch.rl.durations import DurationGAE

advantages = DurationGAE(gamma=0.99999, lmbda=0.95, value_network=critic)
loss = ClipPPOLoss(
    actor, critic, clip_epsilon=0.2, entropy_coeff=0.01, normalize_advantage=True
)
optimiser = torch.optim.Adam(loss.parameters(), lr=2.5e-3, eps=1e-5)

# %%
# The loop collects data, estimates advantages, and makes eight passes over the batch. The learning rate decreases linearly. The
# normalizer is updated after the gradient steps, in place, so that the loss sees it (see :doc:`/how_to/other_learners`).
returns, running = [], torch.zeros(NUM_ENVS)
ended = []
for k, batch in enumerate(collector):
    optimiser.param_groups[0]["lr"] = 2.5e-3 * max(
        0.05, 1.0 - k * batch_size / LOOP_FRAMES
    )
    with torch.no_grad():
        advantages(batch)
    flat = batch.reshape(-1)
    for _ in range(8):
        for rows in torch.randperm(len(flat)).split(2048):
            losses = loss(flat[rows])
            optimiser.zero_grad()
            (
                losses["loss_objective"]
                + losses["loss_critic"]
                + losses["loss_entropy"]
            ).backward()
            nn.utils.clip_grad_norm_(loss.parameters(), 0.5)
            optimiser.step()
    normalizer.update(flat["observation"])
    for reward, done in zip(
        *(batch["next", key].squeeze(-1).unbind(1) for key in ("reward", "done")),
        strict=True,
    ):
        running = running + reward
        ended += running[done].tolist()
        running = running.masked_fill(done, 0.0)
    recent = ended[-NUM_ENVS:]
    returns.append(sum(recent) / len(recent) if recent else float("nan"))
collector.shutdown()

# %%
import matplotlib.pyplot as plt

figure, panel = plt.subplots(figsize=(8, 3), layout="constrained")
panel.plot(
    [(k + 1) * batch_size for k in range(len(returns))], returns, color="#2f6db3"
)
panel.axhline(
    results["rule"].mean_return.mean,
    color="#e8a628",
    linestyle="--",
    label="rule written by hand",
)
panel.set_xlabel("decisions")
panel.set_ylabel("return while training")
panel.grid(axis="y", alpha=0.3)
legend = panel.legend(frameon=False)

# %%
# Evaluate the most probable actions of the actor on the episodes of the table above:
judge = bsk_torch.make("NadirScan-v1", num_envs=EPISODES, time_limit=SECONDS)
print(comparison_table(compare({"by hand": actor}, judge, seed=0)))

# %%
# Next steps
# ----------
#
# - :ref:`tutorial-sb3`: the same task with Stable-Baselines3.
# - :ref:`tutorial-curriculum`: increase the difficulty during training, and mask dangerous actions.
# - :ref:`tutorial-evaluating`: evaluate and publish policies.
