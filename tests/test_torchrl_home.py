"""At home in TorchRL: its GymEnv, its registration with Gymnasium, and configurations of recipes."""

import gymnasium
import pytest
import torch
from omegaconf import OmegaConf
from omegaconf.errors import MissingMandatoryValue
from torchrl.envs import GymEnv
from torchrl.envs.utils import check_env_specs

import bsk_torch
from bsk_torch.presets.config import PresetEnvConfig, make_env, register


@pytest.mark.compiled
def test_torchrls_gym_env_makes_presets():
    """It tries arguments such as frameskip, and expects a TypeError that names them."""
    env = GymEnv("bsk_torch/NadirScan-v1", time_limit=180.0)
    check_env_specs(env)
    assert env.rollout(1)["next", "observation"].shape == (1, 12)


def test_torchrls_registration_takes_environments():
    made = dict(entry_point=bsk_torch.make, name="NadirScan-v1", info_keys=["duration"])
    bsk_torch.SatelliteTasking.register_gym("bsk_torch/TorchRL-v1", backend="gymnasium", **made)
    env = gymnasium.make("bsk_torch/TorchRL-v1", disable_env_checker=True, backend="eager", time_limit=180.0)
    env.reset()
    _, _, _, truncated, info = env.unwrapped.step(torch.tensor([0]))
    assert bool(truncated)
    assert float(info["duration"]) == pytest.approx(180.0)
    gymnasium.registry.pop("bsk_torch/TorchRL-v1")


def test_a_configuration_names_a_preset():
    config = OmegaConf.merge(
        OmegaConf.structured(PresetEnvConfig),
        OmegaConf.create("{name: NadirScan-v1, num_envs: 2, seed: 3, backend: eager, options: {time_limit: 60.0}}"),
    )
    arguments = {key: value for key, value in OmegaConf.to_container(config).items() if not key.startswith("_")}
    env = make_env(**arguments)
    assert (env.num_envs, env.options.seed, env.options.time_limit) == (2, 3, 60.0)
    assert config["_target_"] == f"{make_env.__module__}.{make_env.__name__}"
    with pytest.raises(MissingMandatoryValue):
        OmegaConf.structured(PresetEnvConfig).name  # noqa: B018


def test_hydra_instantiates_it():
    hydra = pytest.importorskip("hydra", reason="needs pip install hydra-core")
    register()
    from hydra.core.config_store import ConfigStore

    node = ConfigStore.instance().load("env/bsk_torch.yaml").node
    config = OmegaConf.merge(node, {"name": "NadirScan-v1", "backend": "eager"})
    assert isinstance(hydra.utils.instantiate(config), bsk_torch.SatelliteTasking)


def test_without_hydra_registering_says_what_to_install(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "hydra.core.config_store", None)
    with pytest.raises(ImportError, match="pip install hydra-core"):
        register()
