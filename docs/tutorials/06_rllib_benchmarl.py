"""
.. _tutorial-marl:

Train with BenchMARL and RLlib
==============================

Train a constellation with BenchMARL's IPPO, and a single satellite with RLlib.

Install BenchMARL without its dependencies, because it declares an older TorchRL: ``pip install --no-deps benchmarl==1.5.2``.
RLlib requires an older Gymnasium and therefore a separate virtual environment; the code of the RLlib section is shown but not
executed.
"""

# %%
# Result
# ------
#
# Three satellites in one plane learn to share 1,000 targets in half a minute. ``ConstellationTask`` converts a preset to a
# BenchMARL task; everything else is BenchMARL's standard configuration.
import tempfile

import torch

import bsk_torch
from bsk_torch.rl.evaluation import comparison_table, evaluate

# import this first: it makes BenchMARL compatible with newer versions of TorchRL
from bsk_torch.rl.marl.benchmarl import ConstellationTask

# isort: split
from benchmarl.algorithms import IppoConfig
from benchmarl.experiment import Experiment, ExperimentConfig
from benchmarl.models.mlp import MlpConfig

# sphinx_gallery_thumbnail_path = "_static/readme/RelayConstellation-v1.png"
ITERATIONS = 20
NUM_ENVS, ROLLOUT = 64, 32
EPISODES = 64
SECONDS = 2850.0

torch.set_num_threads(1)
world = dict(n_satellites=3, n_planes=1, n_targets=1000, time_limit=SECONDS)

settings = ExperimentConfig.get_from_yaml()
settings.gamma, settings.lr = 0.99, 1e-3
settings.max_n_iters, settings.max_n_frames = ITERATIONS, None
settings.on_policy_n_envs_per_worker = NUM_ENVS
settings.on_policy_collected_frames_per_batch = NUM_ENVS * ROLLOUT
settings.on_policy_minibatch_size, settings.on_policy_n_minibatch_iters = 1024, 4
settings.evaluation = settings.render = settings.create_json = False
settings.loggers, settings.save_folder = ["csv"], tempfile.mkdtemp()

algorithm, model = IppoConfig.get_from_yaml(), MlpConfig.get_from_yaml()
algorithm.entropy_coef, model.num_cells = 0.01, [256, 256]

experiment = Experiment(
    task=ConstellationTask.CONSTELLATION.get_task({"options": world}),
    algorithm_config=algorithm,
    model_config=model,
    seed=0,
    config=settings,
)
env = experiment.task.get_env_fun(EPISODES, False, 0, "cpu")()
untrained = evaluate(experiment.policy, env, seed=1)
experiment.run()

# %%
# The experiment's policy writes the actions of all agents into a tensordict, so it can be evaluated like any other policy:
results = {"IPPO": evaluate(experiment.policy, env, seed=1), "untrained": untrained}
results |= {
    name: evaluate(bsk_torch.rule(name, env), env, seed=1)
    for name in ("random", "nearest")
}
print(comparison_table(results))

# %%
# The next figure is an episode of the trained constellation:
from bsk_torch.viz.episodes import draw, record

alone = bsk_torch.make("Constellation-v1", num_envs=1, **world)
path = draw(record(experiment.policy, alone, seed=4), "ippo.png", "IPPO of BenchMARL")

# %%
# ``MappoConfig`` trains a critic that observes all satellites. ``ConstellationTask.AEOS_CONSTELLATION`` and
# ``ConstellationTask.RELAY_CONSTELLATION`` are the other tasks. bsk_torch also provides MAPPO and IPPO, with a discount per
# second and attention over the targets:
#
# .. code-block:: text
#
#     bsk-torch train Constellation-v1 --algorithm ippo --minutes 4 --time-limit 5700
#
# RLlib
# -----
# The code below is part of ``examples/ppo_rllib.py``. ``scripts/test.sh --rllib`` tests it in a separate virtual environment. To
# create one:
#
# .. code-block:: text
#
#     python -m venv .venv-rllib
#     .venv-rllib/bin/pip install -e . 'ray[rllib]==2.60.0'
#     .venv-rllib/bin/python examples/ppo_rllib.py
#
# RLlib steps batches of episodes through Gymnasium's vector entry point, and expects the mask of legal actions next to the
# observation. A wrapper adds it:
#
# .. literalinclude:: /../examples/ppo_rllib.py
#     :pyobject: MaskedObservations
#
# RLlib's environment is one batched simulation:
#
# .. literalinclude:: /../examples/ppo_rllib.py
#     :pyobject: make_vector
#
# Register this function under a name, and select the name with the entry point. The network is RLlib's module for masked actions:
#
# .. literalinclude:: /../examples/ppo_rllib.py
#     :pyobject: make_algorithm
#
# Wrap the trained module as a policy for ``evaluate``:
#
# .. literalinclude:: /../examples/ppo_rllib.py
#     :pyobject: as_policy
#
# RLlib stores episodes as Python objects, one decision after the other, and discounts per decision. For several agents that
# decide at different times, RLlib needs connectors; :ref:`sphx_glr_gallery_bsk_rl_async_multiagent_training.py` uses a mask
# instead.
#
# Next steps
# ----------
#
# - :ref:`sphx_glr_gallery_mappo_benchmarl.py` and :ref:`sphx_glr_gallery_ppo_rllib.py`: both trainings as programs with options.
# - :ref:`tutorial-constellations`: groups, masks and communication.
# - :ref:`tutorial-evaluating`: evaluate and publish policies.
