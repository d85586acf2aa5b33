"""Gradient steps in bfloat16, and devices that have no such arithmetic."""

from pathlib import Path

import pytest
import torch

from bsk_torch.rl.marl import MAPPOConfig, MAPPOTraining
from bsk_torch.rl.networks import precision
from bsk_torch.rl.networks.precision import has_bfloat16
from bsk_torch.rl.training.config import PPOConfig
from bsk_torch.rl.training.ppo import Learner
from bsk_torch.rl.training.trainer import Training

pytestmark = pytest.mark.compiled

TINY = dict(frames=48, seconds=None, num_envs=4, rollout=12, minibatch=48, epochs=1)
CPU = torch.device("cpu")

ROUNDING = 2.0**-8
"""Relative rounding of bfloat16."""


def small(network, **changes):
    if network == "attention":
        options = {"as_set": True, "n_targets": 200, "time_limit": 1200.0}
        return PPOConfig("AEOSPower-v1", network=network, hidden=(32,), imitate="hasty", options=options, **(TINY | changes))
    return PPOConfig(network=network, hidden=(16, 16), options={"time_limit": 900.0}, **(TINY | changes))


@pytest.fixture
def everywhere(monkeypatch):
    """Lets any processor have bfloat16: it then converts to float32 and back, which only takes longer."""
    monkeypatch.setattr(precision, "has_bfloat16", lambda device: True)


def first_step(config):
    """Return the actor's gradient in the first update of a training, and the report."""
    torch.manual_seed(0)
    env = config.make_env()
    learner = Learner(config, env)
    learner.anneal(0.0)
    torch.manual_seed(1)
    batch = env.rollout(config.rollout, learner.policy, auto_reset=True, break_when_any_done=False)
    report = learner.learn(batch)
    assert all(weight.dtype is weight.grad.dtype is torch.float32 for weight in learner.weights[0])
    return torch.cat([weight.grad.flatten() for weight in learner.weights[0]]), report


@pytest.mark.parametrize("network", ["mlp", "gru", "attention"])
def test_a_step_differs_by_the_rounding_of_bfloat16(network, everywhere):
    exact, told = first_step(small(network))
    rounded, told_rounded = first_step(small(network, precision="bfloat16"))
    assert not torch.equal(exact, rounded)
    assert torch.nn.functional.cosine_similarity(exact, rounded, dim=0) > 0.98  # sums of products, each rounded to 2**-8
    assert told_rounded["entropy"] == pytest.approx(told["entropy"], rel=ROUNDING)
    assert told_rounded["kl_approx"] == pytest.approx(told["kl_approx"], abs=ROUNDING)


def test_a_constellation_learns_in_bfloat16(everywhere, tmp_path):
    """Among the satellites of a step are some that do not decide, whose logits are filled in."""
    options = {"as_set": True, "n_targets": 500, "time_limit": 900.0, "n_satellites": 2, "n_planes": 1, "phasing": 0}
    sizes = dict(hidden=(32,), evaluate_episodes=2, frames=48, seconds=None, num_envs=2, rollout=12, minibatch=48, epochs=1)
    config = MAPPOConfig("Constellation-v1", network="attention", options=options, precision="bfloat16", **sizes)
    training = MAPPOTraining(config, tmp_path / "run")
    training.run()
    weights = torch.cat([weight.detach().flatten() for weight in training.learner.groups["agents"].weights[0]])
    assert weights.isfinite().all()


def test_a_processor_without_bfloat16_is_named(monkeypatch, tmp_path):
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: {"avx2": True, "avx512_bf16": False})
    with pytest.raises(ValueError, match=r"precision='bfloat16': the processor has no bfloat16 .*'float32'"):
        Training(small("mlp", precision="bfloat16"), tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_capabilities_are_those_of_the_system():
    try:
        flags = Path("/proc/cpuinfo").read_text().split()
    except OSError:
        pytest.skip("only Linux lists what the processor can do")
    assert has_bfloat16(CPU) == bool({"avx512_bf16", "amx_bf16", "bf16"} & set(flags))
