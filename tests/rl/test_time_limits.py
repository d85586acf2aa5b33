"""What learners expect after a time limit, what critics know of it, rewards of any scale, and warnings."""

import copy
import re

import pytest
import torch
from tensordict import TensorDict
from torchrl.modules import ValueOperator

import bsk_torch
from bsk_torch.rand import Uniform
from bsk_torch.rl.marl.mappo import MAPPOConfig, MAPPOTraining, team_batch
from bsk_torch.rl.networks.normaliser import OWN
from bsk_torch.rl.training.advantages import CUT, FINAL, final, make_value_norm, standardize, write_advantages
from bsk_torch.rl.training.advice import hardships
from bsk_torch.rl.training.collect import make_collector, merged, prepared
from bsk_torch.rl.training.config import PPOConfig
from bsk_torch.rl.training.ppo import Learner
from bsk_torch.rl.training.trainer import Training

GAMMA, LMBDA, VALUE = 0.99, 0.5, 10.0

ONE_ROUNDING = dict(rtol=1e-5, atol=1e-6)
"""Float32 sums of a few numbers."""


def three_steps(**ends):
    """One environment of three steps of 1 s with rewards 1, 2 and 3, the last of which ends as ``ends`` say."""
    flag = torch.tensor([False, False, True]).view(1, 3, 1)
    flags = {name: flag if ends.get(name) else torch.zeros_like(flag) for name in ("done", "terminated", "truncated", CUT)}
    following = flags | {
        "seen": {"own": torch.zeros(1, 3, 1)},
        "reward": torch.tensor([1.0, 2.0, 3.0]).view(1, 3, 1),
        "duration": torch.ones(1, 3, 1),
    }
    return TensorDict(
        {"seen": {"own": torch.zeros(1, 3, 1)}, "next": TensorDict(following, [1, 3])}, [1, 3], names=[None, "time"]
    )


def always(value):
    """A critic that gives every state the same value."""
    layer = torch.nn.Linear(1, 1)
    torch.nn.init.zeros_(layer.weight)
    torch.nn.init.constant_(layer.bias, value)
    return ValueOperator(layer, in_keys=[OWN])


LIMIT = dict(done=True, truncated=True)
LIMIT_THAT_TERMINATES = dict(done=True, truncated=True, terminated=True)
DEATH = dict(done=True, terminated=True)
CUT_BY_TRAINING = dict(done=True, truncated=True, cut=True)


@pytest.mark.parametrize(
    ("ends", "beyond_limit", "continues"),
    [
        (LIMIT, False, False),
        (LIMIT, True, True),
        (LIMIT_THAT_TERMINATES, False, False),
        (LIMIT_THAT_TERMINATES, True, False),
        (DEATH, False, False),
        (DEATH, True, False),
        (CUT_BY_TRAINING, False, True),
        (CUT_BY_TRAINING, True, True),
        ({}, False, True),  # the batch ends, the episode does not
    ],
)
def test_returns_of_episodes_that_end(ends, beyond_limit, continues):
    """By hand, with rewards at the end of steps of 1 s, gamma 0.99, lambda 0.5 and all values 10."""
    batch = three_steps(**ends)
    batch["next", FINAL] = final(batch, beyond_limit)
    write_advantages(batch, always(VALUE), GAMMA, LMBDA, terminated=FINAL)
    third = 0.99 * (3.0 + (10.0 if continues else 0.0)) - 10.0  # 2.87 or -7.03
    second = 0.99 * (2.0 + 10.0) - 10.0 + 0.99 * 0.5 * third
    first = 0.99 * (1.0 + 10.0) - 10.0 + 0.99 * 0.5 * second
    expected = torch.tensor([first, second, third])
    torch.testing.assert_close(batch["advantage"].flatten(), expected, **ONE_ROUNDING)
    torch.testing.assert_close(batch["value_target"].flatten(), expected + 10.0, **ONE_ROUNDING)


@pytest.mark.parametrize("scale", [1e-6, 1e-3, 1.0, 1e3, 1e6])
def test_targets_and_advantages_have_no_scale(scale):
    """Targets 1 ... 8 times the scale have the mean 4.5 and the deviation 5.25^0.5."""
    norm = make_value_norm()
    target = torch.arange(1.0, 9.0).view(8, 1) * scale
    batch = TensorDict({"advantage": target.clone(), "value_target": target.clone()}, [8])
    standardize(batch, norm)
    expected = (torch.arange(1.0, 9.0) - 4.5) / 5.25**0.5
    torch.testing.assert_close(batch["value_target"].flatten(), expected, rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(batch["advantage"].std(), torch.tensor(1.0), rtol=1e-4, atol=0.0)
    torch.testing.assert_close(norm.denormalize(batch["value_target"].double()).float(), target, rtol=1e-4, atol=0.0)


def test_without_rewards_there_is_nothing_to_gain():
    """An untrained critic must not teach anything before the first reward."""
    torch.manual_seed(0)
    batch, norm = three_steps(), make_value_norm()
    batch["seen", "own"] = torch.randn(1, 3, 1)
    batch["next", "reward"] = torch.zeros(1, 3, 1)
    write_advantages(batch, ValueOperator(torch.nn.Linear(1, 1), in_keys=[OWN]), GAMMA, LMBDA, value_norm=norm)
    standardize(batch, norm)
    assert float(batch["advantage"].abs().max()) < 1e-2


OPTIONS = {"time_limit": 400.0, "failure_penalty": 0.0}


def collected(config, training=Training, folder=None):
    """A learner and its first batch."""
    run = training(config, folder)
    collector = make_collector(config, run.env, run.actor, None)
    batch = merged(next(iter(collector)))
    collector.shutdown()
    return run.learner, batch


def settings(**changes):
    short = dict(seconds=None, frames=96, num_envs=6, rollout=8, minibatch=24, epochs=1, hidden=(8,), options=OPTIONS)
    return PPOConfig(**(short | changes))


@pytest.mark.compiled
@pytest.mark.parametrize("terminates", [True, False])
def test_a_return_ends_where_the_reported_one_does(terminates, tmp_path):
    learner, batch = collected(settings(options=OPTIONS | {"terminate_on_time_limit": terminates}), folder=tmp_path / "run")
    at_limit, cut = batch["next", "clock"][..., 0] == 0.0, batch["next", CUT].squeeze(-1)
    assert int(at_limit.sum()) >= 4
    assert int(cut.sum()) >= 4
    assert not bool((at_limit & cut).any())
    assert bool(batch["next", "truncated"].squeeze(-1)[at_limit | cut].all())
    learner.value_norm.update(torch.tensor([[5.0], [15.0]]).double())  # so that critics expect much
    learner.learn(batch)
    target = learner.value_norm.denormalize(batch["value_target"].double()).squeeze(-1)
    earned = (batch["next", "reward"].double() * 0.99999 ** batch["next", "duration"].double()).squeeze(-1)
    torch.testing.assert_close(target[at_limit], earned[at_limit], rtol=0.0, atol=1e-4)
    assert bool((target[cut] - earned[cut] > 1.0).all())


@pytest.mark.compiled
def test_beyond_the_limit_is_what_the_critic_expects(tmp_path):
    learner, batch = collected(
        settings(beyond_limit=True, options=OPTIONS | {"terminate_on_time_limit": False}), folder=tmp_path / "run"
    )
    at_limit = batch["next", "clock"][..., 0] == 0.0
    learner.value_norm.update(torch.tensor([[5.0], [15.0]]).double())
    learner.learn(batch)
    target = learner.value_norm.denormalize(batch["value_target"].double()).squeeze(-1)
    assert bool((target - batch["next", "reward"].squeeze(-1) > 1.0)[at_limit].all())
    assert float(batch["seen", "clock"].abs().max()) == 0.0


@pytest.mark.compiled
def test_critics_of_constellations_expect_a_return_beyond_the_limit(tmp_path):
    world = {"as_set": True, "n_targets": 200, "n_satellites": 2, "n_planes": 1, "phasing": 0, "time_limit": 300.0}
    config = MAPPOConfig(
        seconds=None, frames=96, num_envs=4, rollout=16, minibatch=32, options=world | {"terminate_on_time_limit": False}
    )
    learner, batch = collected(config, MAPPOTraining, tmp_path / "run")
    group = learner.groups["agents"]
    at_limit = batch["next", "clock"][..., 0] == 0.0
    assert int(at_limit.sum()) >= 4
    group.value_norm.update(torch.tensor([[5.0], [15.0]]).double())
    learner.learn(batch)
    team = team_batch(batch)
    assert bool(team["next", "satellite_terminated"][at_limit].all())
    assert not bool(team["next", "satellite_terminated"][batch["next", CUT].squeeze(-1)].any())
    assert torch.equal(team["seen", "clock"], batch["clock"].unsqueeze(2).expand(-1, -1, 2, -1))


@pytest.mark.compiled
@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_learning_does_not_depend_on_the_scale_of_rewards(scale, tmp_path):
    """Two batches of the same decisions, in float32; powers of two would be exact."""
    learned = []
    for factor in (1.0, scale):
        learner, batch = collected(settings(), folder=tmp_path / str(factor))
        batch["next", "reward"] *= factor
        for _ in range(3):
            torch.manual_seed(0)
            learner.learn(copy.deepcopy(batch))
        learned.append(torch.cat([weight.flatten() for weight in learner.networks.actor.parameters()]).detach())
    begin = Learner(settings(), bsk_torch.make("NadirScan-v1", num_envs=1, seed=0, **OPTIONS)).networks.actor.parameters()
    assert float((learned[0] - torch.cat([weight.flatten() for weight in begin]).detach()).abs().max()) > 1e-3
    torch.testing.assert_close(*learned, rtol=0.0, atol=2e-4)


@pytest.mark.compiled
def test_the_clock_shows_what_is_left_of_each_episode():
    config = settings(stagger=False, options=OPTIONS | {"time_limit": Uniform(200.0, 7200.0)})
    env = config.make_env()
    played = prepared(env, config, None)
    now = played.reset()
    assert torch.equal(now["clock"][:, 0], torch.ones(6))
    torch.testing.assert_close(10.0 ** now["clock"][:, 1] * 3600.0, env.time_limit.float())
    now = played.rand_step(now)["next"]
    expected = 1.0 - now["duration"].squeeze(-1) / env.time_limit
    torch.testing.assert_close(now["clock"][:, 0], expected.clamp(min=0.0).float())
    played.check_env_specs()


@pytest.mark.compiled
def test_without_a_limit_the_clock_stands_still():
    config = settings(options=OPTIONS | {"time_limit": float("inf")})
    played = prepared(config.make_env(), config, None)
    now = played.rand_step(played.reset())
    for part in (now, now["next"]):
        assert torch.equal(part["clock"], torch.tensor([1.0, 0.0]).expand(6, 2))


def warned(reward=0.01, **changes):
    """What is said of a first batch of decisions of 60 s with a reward each."""
    config = settings(**({"evaluate_every": 48, "frames": 9600} | changes))
    env = config.make_env()
    env.reset()
    said = hardships(config, env, torch.full((6, 8), reward), torch.full((6, 8), 60.0))
    return "\n".join(said)


TRUNCATES = OPTIONS | {"terminate_on_time_limit": False}


@pytest.mark.compiled
@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"evaluate_every": 0}, "evaluate_every=0: the last policy is kept"),
        ({"gamma": 0.97}, r"after which 0\.2 is left; gamma=0\.999492 is 0\.97 per decision"),
        ({"frames": 36}, r"frames=36 are 6 decisions .* about 360 s of an episode of 400 s: no episode ends"),
        ({"reward": 0.0}, "first 48 decisions brought no reward"),
        ({"reward": 1e-4, "options": OPTIONS | {"failure_penalty": -1.0}}, r"failure_penalty=-1 is 1\.5e\+03 times"),
        ({"beyond_limit": True, "options": TRUNCATES}, r"looks 1e\+05 s ahead: .* time limit of 400 s"),
        ({"beyond_limit": True, "gamma": 0.995, "options": TRUNCATES}, "Scanner1 observes the time"),
    ],
)
def test_hard_choices_are_named(changes, message):
    assert len(warned(**changes).splitlines()) == (2 if changes.get("beyond_limit") and "gamma" not in changes else 1)
    assert re.search(message, warned(**changes))


@pytest.mark.compiled
@pytest.mark.parametrize("options", [OPTIONS, TRUNCATES])
def test_good_settings_are_not_warned_of(options):
    assert not warned(options=options)
    assert not warned(options=options, reward=0.0, imitate="rule")


@pytest.mark.compiled
def test_warnings_reach_the_user(tmp_path, caplog):
    Training(settings(frames=48), tmp_path / "run").run()
    assert "evaluate_every=0" in caplog.text
