"""Small policies of NadirScan-v1, and one of Constellation-v1, as other libraries write them."""

import io
import json
from functools import cache
from pathlib import Path

import torch
from torch import nn

import bsk_torch
from bsk_torch.rl.networks.plans import PLANS
from bsk_torch.rl.policies.files import save_policy

OBSERVED, ACTIONS = 12, 4
"""Sizes of NadirScan-v1."""

TEAM = dict(n_satellites=3, n_planes=1, phasing=0, n_targets=100)
"""Options of the smaller Constellation-v1."""

MODULE = """
import torch

def best_legal(observation, action_mask):
    return action_mask.double()

network = torch.nn.Linear(12, 4)
torch.nn.init.zeros_(network.weight)
torch.nn.init.zeros_(network.bias)

def enter(preset, make):
    return make(), best_legal
"""


class Net(nn.Module):
    """Scores of the actions, or of another number of them."""

    def __init__(self, observed: int = OBSERVED, actions: int = ACTIONS) -> None:
        super().__init__()
        torch.manual_seed(0)
        self.layer = nn.Linear(observed, actions)

    def forward(self, observation):
        return self.layer(observation)


class MaskedNet(Net):
    """The most probable legal action."""

    def forward(self, observation, action_mask):
        return self.layer(observation).masked_fill(~action_mask, -torch.inf).argmax(-1)


def write_own(path: Path) -> Path:
    env = bsk_torch.make("NadirScan-v1", num_envs=1, backend="eager")
    plan = PLANS["mlp"].of(env, (8,))
    save_policy(path, plan, plan.build(), "NadirScan-v1", {})
    return path


@cache
def sb3_env(preset: str = "NadirScan-v1", **options):
    from bsk_torch.wrappers.stable_baselines3 import SB3VecEnv

    return SB3VecEnv(preset, num_envs=2, time_limit=300.0, **options)


def write_sb3(path: Path, name: str = "PPO", env=None, policy: str = "MlpPolicy", **settings) -> Path:
    import sb3_contrib
    import stable_baselines3

    kind = getattr(stable_baselines3, name, None) or getattr(sb3_contrib, name)
    settings = {"policy_kwargs": {"net_arch": [8]}} | settings
    kind(policy, env or sb3_env(), device="cpu", seed=0, **settings).save(path)
    return path


def exported(module: nn.Module, extra: dict | None = None, batch: int | None = None) -> bytes:
    """A program of torch.export; of a fixed size of batches if it is given."""
    width = module.layer.in_features
    inputs = (torch.zeros(batch or 2, width), torch.ones(batch or 2, module.layer.out_features, dtype=torch.bool))
    inputs = inputs[: 2 if isinstance(module, MaskedNet) else 1]
    shapes = None if batch else tuple({0: torch.export.Dim("N")} for _ in inputs)
    file = io.BytesIO()
    torch.export.save(torch.export.export(module, inputs, dynamic_shapes=shapes), file, extra_files=extra or {})
    return file.getvalue()


def onnx_model(
    weight: torch.Tensor, contract: object = None, batch: int | str = "N", operator: str = "Gemm", name: str = "observation"
) -> bytes:
    """An ONNX file of one layer without bias, whose output is ``logits``."""
    from onnx import TensorProto, helper, numpy_helper

    observed, actions = weight.shape
    node = helper.make_node(operator, [name, "w"], ["logits"], domain="" if operator == "Gemm" else "nobody")
    graph = helper.make_graph(
        [node],
        "policy",
        [helper.make_tensor_value_info(name, TensorProto.FLOAT, [batch, observed])],
        [helper.make_tensor_value_info("logits", TensorProto.FLOAT, [batch, actions])],
        [numpy_helper.from_array(weight.numpy(), "w")],
    )
    sets = [helper.make_opsetid("", 18)] + ([] if operator == "Gemm" else [helper.make_opsetid("nobody", 1)])
    model = helper.make_model(graph, opset_imports=sets, ir_version=10, producer_name="test")
    if contract is not None:
        helper.set_model_props(model, {"bsk_torch.contract": json.dumps(contract)})
    return model.SerializeToString()


def write_experiment(folder: Path, **settings) -> Path:
    """An experiment of BenchMARL with one checkpoint, by further ``settings`` of ``ExperimentConfig``."""
    from bsk_torch.rl.marl.benchmarl import ConstellationTask

    # isort: split
    from benchmarl.algorithms import MappoConfig
    from benchmarl.experiment import Experiment, ExperimentConfig
    from benchmarl.models.mlp import MlpConfig

    config, model = ExperimentConfig.get_from_yaml(), MlpConfig.get_from_yaml()
    model.num_cells = [8]
    changes = dict(
        max_n_iters=1,
        max_n_frames=None,
        on_policy_n_envs_per_worker=2,
        on_policy_collected_frames_per_batch=4,
        on_policy_minibatch_size=4,
        on_policy_n_minibatch_iters=1,
        evaluation=False,
        loggers=[],
        create_json=False,
        checkpoint_at_end=True,
        save_folder=str(folder),
    )
    for key, value in (changes | settings).items():
        setattr(config, key, value)
    task = ConstellationTask.CONSTELLATION.get_task({"options": TEAM | {"time_limit": 300.0}})
    experiment = Experiment(task=task, algorithm_config=MappoConfig.get_from_yaml(), model_config=model, seed=0, config=config)
    experiment.run()
    return Path(experiment.folder_name)


def write_rllib(folder: Path, preset: str = "NadirScan-v1") -> Path:
    """A checkpoint of the module that RLlib's PPO makes for a preset."""
    from ray.rllib.algorithms.ppo.torch.default_ppo_torch_rl_module import DefaultPPOTorchRLModule
    from ray.rllib.core.rl_module.default_model_config import DefaultModelConfig

    from bsk_torch.wrappers.gymnasium import GymEnv

    env = GymEnv(preset, backend="eager")
    module = DefaultPPOTorchRLModule(
        observation_space=env.observation_space,
        action_space=env.action_space,
        model_config=DefaultModelConfig(fcnet_hiddens=[8]),
    )
    module.save_to_path(folder)
    return folder
