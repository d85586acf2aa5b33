"""Trainings, comparisons and rules in environments that are no presets."""

import pytest
import torch

import bsk_torch
from bsk_torch.presets import PRESETS
from bsk_torch.presets.nadir_scan import ScanningSatellite
from bsk_torch.rl.marl.runs import configure
from bsk_torch.rl.training.config import PPOConfig, override
from bsk_torch.rl.training.imitation import enter_teacher, find_teacher
from tests.support.refusals import check_refusals, refusal

pytestmark = pytest.mark.compiled

TINY = dict(num_envs=4, rollout=4, frames=16, epochs=1, evaluate_every=0, quiet=True)


def scanner(num_envs):
    return bsk_torch.make("NadirScan-v1", num_envs=num_envs, time_limit=180.0)


def careful(observation, *, low=0.4):
    return (observation[:, 1] < low).long()


FILE = """
from tests.rl.test_one_call import careful, scanner
broken = None
"""


def weights(trained):
    return torch.cat([part.detach().flatten() for part in trained.policy.parameters()])


@pytest.fixture
def file(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    path = tmp_path / f"mine_{tmp_path.name}.py"
    path.write_text(FILE)
    return path


def test_a_function_and_what_it_makes_are_trained_alike(tmp_path):
    of_function = bsk_torch.train(scanner, episodes=4, folder=tmp_path / "run", **TINY)
    of_env = bsk_torch.train(scanner(2), episodes=0, **TINY)
    assert torch.equal(weights(of_function), weights(of_env))
    assert (of_function.folder, of_env.folder) == (tmp_path / "run", None)
    assert (of_env.evaluation, of_env.results) == (None, {})
    assert [*of_function.results] == ["random", "rule", "cautious", "untrained", "trained"]
    judge = scanner(4)
    assert torch.equal(of_function.evaluation.returns, bsk_torch.evaluate(of_function.policy, judge).returns)
    assert not bsk_torch.evaluate(tmp_path / "run", judge, seed=3).returns.isnan().any()


def test_options_replace_arguments_that_the_function_does_not_take():
    made = bsk_torch.presets.own.OwnEnvironment(scanner, "mine")(num_envs=3, time_limit=60.0, seed=5, env_ids=[4, 4, 1])
    assert (made.num_envs, made.env_ids.tolist()) == (3, [4, 4, 1])
    made.reset()
    again = scanner(3).remade(num_envs=3, time_limit=60.0, seed=5, env_ids=[4, 4, 1])
    again.reset()
    assert made.time_limit.tolist() == [60.0] * 3
    assert torch.equal(made.simulator.read("r_BN_N"), again.simulator.read("r_BN_N"))
    assert torch.equal(made.simulator.read("r_BN_N")[0], made.simulator.read("r_BN_N")[1])


def test_a_run_of_an_own_environment_continues_as_if_uninterrupted(tmp_path):
    env = scanner(1)
    once = bsk_torch.train(env, episodes=0, **(TINY | {"frames": 32, "learning_rate_schedule": "constant"}))
    out = tmp_path / "run"
    bsk_torch.train(env, episodes=0, folder=out, **(TINY | {"learning_rate_schedule": "constant", "entropy": 0.0}))
    again = bsk_torch.train(env, episodes=0, folder=out, resume=True, frames=32, quiet=True)
    assert again.config.frames == 32
    assert not torch.equal(weights(again), weights(once))  # the entropy schedule differs
    assert PRESETS[again.config.preset].source is env


def test_rules_of_ones_own_teach(file):
    """A training that only imitates learns the function, given as itself or by the name of its file."""
    long = TINY | dict(frames=256, epochs=8, imitation=1.0, learning_rate=1e-2)
    trained = bsk_torch.train(scanner, episodes=4, imitate=f"{file}:careful", options={"time_limit": 120.0}, **long)
    start = scanner(8).reset()
    agrees = trained.policy(start.clone())["action"] == careful(start["observation"])
    assert float(agrees.double().mean()) > 0.9
    assert f"{file}:careful" in trained.results
    network = torch.nn.Linear(12, 4)
    names = [enter_teacher(teacher) for teacher in (network, torch.nn.Linear(12, 4), network)]
    assert names[0] == names[2] != names[1]
    assert (
        find_teacher(names[0], scanner(1))(start.clone())["action"].tolist() == network(start["observation"]).argmax(-1).tolist()
    )
    assert PPOConfig(imitate=careful).imitate == "tests.rl.test_one_call:careful"


def test_configurations_name_functions_without_calling_them(file):
    assert PPOConfig(imitate="nobody:knows").imitate == "nobody:knows"
    assert override(PPOConfig(), [f"imitate={file}:careful"]).imitate == f"{file}:careful"
    check_refusals(
        refusal(lambda: find_teacher("nobody:knows", scanner(1)), ValueError, "imitate='nobody:knows'", "again"),
        refusal(lambda: bsk_torch.make("nobody:knows"), ValueError, "'nobody:knows'", "--preset", "bsk_torch.train"),
    )


def chooser(num_envs):
    return bsk_torch.make("AEOS-v1", num_envs=num_envs, n_targets=50, as_set=True, time_limit=200.0)


def test_attention_trains_whatever_observes_a_set():
    trained = bsk_torch.train(chooser, episodes=0, hidden=(32,), **TINY)
    assert trained.config.network == "attention"
    assert bsk_torch.evaluate(trained.policy, chooser(2)).returns.shape == (2,)
    check_refusals(
        refusal(lambda: bsk_torch.train(scanner, network="attention", **TINY), ValueError, "'attention'", "Scanner1", "'mlp'"),
    )


def test_comparisons_name_policies_and_print_paired_gains():
    env = scanner(4)
    results = bsk_torch.compare([careful, "random", careful, torch.nn.Linear(12, 4)], env, rules=False)
    assert [*results] == ["careful", "random", "careful 2", "Linear"]
    assert str(results["careful"].gain_over(results["random"])) in str(results)
    assert torch.equal(results["careful"].returns, bsk_torch.evaluate(careful, env).returns)
    assert [*bsk_torch.compare([careful], env)] == ["careful", "random", "rule", "cautious"]


def test_rejects_what_is_no_environment_and_settings_that_do_not_fit(file, tmp_path):
    train = lambda env, **more: bsk_torch.train(env, **(TINY | more))
    named = lambda name: train(f"{file}:{name}")
    check_refusals(
        refusal(lambda: train(3), TypeError, "3", "num_envs"),
        refusal(lambda: train(ScanningSatellite), TypeError, "the class ScanningSatellite", "num_envs"),
        refusal(lambda: train(lambda n: scanner(n)), TypeError, "(n)", "num_envs"),
        refusal(lambda: train(lambda num_envs: None), TypeError, "nothing", "num_envs"),
        refusal(lambda: train(lambda num_envs: scanner(7)), ValueError, "7", "num_envs=1"),
        refusal(lambda: train("NadirScan-v2"), ValueError, "'NadirScan-v2'", "'NadirScan-v1'"),
        refusal(lambda: named("scaner"), ValueError, "'scaner'", "'scanner'"),
        refusal(lambda: named("broken"), TypeError, "None", "num_envs"),
        refusal(lambda: train("nobody.py:f"), ValueError, "nobody.py:f", "no file"),
        refusal(lambda: train("nobody:f"), ValueError, "nobody:f", "ModuleNotFoundError"),
        refusal(lambda: train(scanner, learning_rat=1.0), ValueError, "'learning_rat'", "'learning_rate'"),
        refusal(lambda: train(scanner, imitate="hasty"), ValueError, "imitate='hasty'", "Scanner1"),
        refusal(lambda: train(scanner, imitate=lambda observation: observation[:, 0].long() + 5), ValueError, "illegal", 5),
        refusal(lambda: train(scanner, episodes=-1), ValueError, "episodes=-1"),
        refusal(lambda: bsk_torch.train(scanner, resume=True), ValueError, "resume", "folder"),
        refusal(lambda: train(scanner, resume=True, folder=tmp_path), ValueError, "resume", "num_envs"),
        refusal(lambda: bsk_torch.compare("random", scanner(2)), TypeError, "policies='random'", "list"),
        refusal(lambda: bsk_torch.evaluate("randm", scanner(2)), ValueError, "'randm'", "'random'"),
        refusal(lambda: configure("NadirScan-v1", imitate="nobody.py:f"), ValueError, "imitate='nobody.py:f'", "no file"),
    )
