"""Learning in constellations: who decides, what is learned from, what death ends, and runs from end to end."""

import dataclasses

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torchrl.modules import ValueOperator

import bsk_torch
from bsk_torch import comm
from bsk_torch.rl.evaluation.evaluate import evaluate
from bsk_torch.rl.marl.mappo import ALIVE, ConstellationCritic, MAPPOConfig, MAPPOTraining, team_advantages, team_batch
from bsk_torch.rl.networks.normaliser import MASK, OWN, ROWS
from bsk_torch.rl.policies.shared_policy import SharedPolicy
from bsk_torch.rl.rules.baselines import BASELINES
from bsk_torch.rl.training.advantages import FINAL
from bsk_torch.rl.training.collect import make_collector
from bsk_torch.rl.training.loss import clipped_loss
from tests.support.values import Unscaled

WORLD = {"as_set": True, "n_targets": 2000, "n_satellites": 3, "n_planes": 1, "phasing": 0, "time_limit": 900.0}

FLOAT32_SUMS = dict(atol=5e-5, rtol=1e-5)
"""A dozen numbers of order one, each good to 1e-7 of the largest, multiplied and added up in float32 in another order."""


def situation(decides):
    """What agents see, [N, S] each, when those of ``decides`` need a task; legal are actions 1 and 2 of 0 ... 2."""
    free = torch.tensor(decides)
    legal = torch.stack([torch.zeros_like(free), free, free, ~free], -1)
    agents = TensorDict({"observation": torch.rand(*free.shape, 2), "action_mask": legal}, free.shape)
    return TensorDict({"agents": agents}, free.shape[:1])


def last_legal(action_mask):
    assert action_mask.shape[1:] == (3,)
    return (action_mask * torch.arange(3)).argmax(1)


def test_only_those_who_need_a_task_are_asked():
    crew = SharedPolicy(TensorDictModule(last_legal, in_keys=["action_mask"], out_keys=["action"]))
    told = crew(situation([[True, False, True], [False, False, False]]))
    assert told["agents", "action"].tolist() == [[2, 3, 2], [3, 3, 3]]


@pytest.mark.compiled
@pytest.mark.parametrize("name", ["random", "greedy", "hasty"])
def test_steps_after_which_nobody_needs_a_task(name):
    env = bsk_torch.make("Constellation-v1", num_envs=2, seed=0, **WORLD)
    now = env.reset()
    going_on = now["agents", "action_mask"].shape[-1] - 1
    now["agents", "action_mask"] = (torch.arange(going_on + 1) == going_on).expand(2, 3, -1)
    assert bool((bsk_torch.rule(name, env)(now)["agents", "action"] == going_on).all())


@pytest.mark.compiled
@pytest.mark.parametrize("name", ["greedy", "nearest", "hasty"])
def test_rules_earn_the_same_in_a_constellation_of_one_as_alone(name):
    orbit = bsk_torch.rand.random_orbit(a=7171.0, i=45.0)
    world = {"num_envs": 4, "seed": 0, "n_targets": 2000, "time_limit": 1500.0, "as_set": True, "sat_args": {"oe": orbit}}
    world["max_step_duration"] = 1500.0  # after shorter steps only the satellite alone would choose again
    alone = bsk_torch.make("AEOS-v1", **world)
    crew = bsk_torch.make("AEOSConstellation-v1", n_satellites=1, sat_arg_randomizer=None, **world)
    expected = evaluate(BASELINES[name](alone, 0), alone, seed=3)
    found = evaluate(bsk_torch.rule(name, crew), crew, seed=3)
    assert float(expected.returns.min()) > 0.0
    assert torch.equal(found.returns, expected.returns)
    assert torch.equal(found.decisions, expected.decisions)
    assert torch.equal(found.counts["imaged"], expected.counts["imaged"])


def decisions(n, steps, satellites, deaths):
    """Random batch [N, T] as the collector gives it; ``deaths`` are (episode, step, satellite), and dead ones stay dead."""
    torch.manual_seed(1)
    alive = torch.ones(n, steps + 1, satellites, dtype=torch.bool)
    for episode, step, satellite in deaths:
        alive[episode, step + 1 :, satellite] = False
    free = (torch.rand(n, steps, satellites) < 0.4) & alive[:, :-1]
    legal = torch.cat([free.unsqueeze(-1).expand(-1, -1, -1, 4), ~free.unsqueeze(-1)], -1)
    seconds = torch.randint(1, 60, (n, steps, 1, 1)).float().expand(-1, -1, satellites, -1)

    def seen():
        return {"own": torch.randn(n, steps, satellites, 2), "rows": torch.randn(n, steps, satellites, 4, 3),
                "mask": torch.rand(n, steps, satellites, 4) < 0.7}  # fmt: skip

    done = torch.zeros(n, steps, 1, dtype=torch.bool)
    done[0, 3] = True
    shape = [n, steps, satellites]
    here = {"seen": seen(), "action_mask": legal, "action": torch.where(free, 1, 4), "mask": alive[:, :-1]}
    then = {"seen": seen(), "reward": torch.randn(*shape, 1), "duration": seconds, "mask": alive[:, 1:]}
    agents, following = (TensorDict(x, shape) for x in (here | {"action_log_prob": torch.zeros(shape)}, then))
    for name, after in following["seen"].items():
        # what follows a step is what the next one sees, unless the episode ends
        over, now = done[:, :-1].view(n, -1, *[1] * (after.ndim - 2)), agents["seen", name]
        now[:, 1:] = torch.where(over, now[:, 1:], after[:, :-1])
    following = TensorDict({"agents": following, "done": done, "terminated": done, "truncated": done, FINAL: done}, [n, steps])
    return TensorDict({"agents": agents, "next": following}, [n, steps], names=[None, "time"])


def critic(sees_all=True):
    return ValueOperator(ConstellationCritic(2, 3, 8, sees_all), in_keys=[OWN, ROWS, MASK, ALIVE])


def brute_force(reward, seconds, removed, value, following, gamma, lmbda):
    """Targets [T] by the definition: with g = gamma^t, A = g (r + V') - V + g lambda A', cut where one is removed; A + V."""
    advantage, targets = 0.0, []
    for r, t, d, v, w in reversed(list(zip(reward, seconds, removed, value, following, strict=True))):
        discount = gamma**t
        advantage = discount * (r + w * (not d)) - v + discount * lmbda * advantage * (not d)
        targets.append(advantage + v)
    return torch.tensor(targets[::-1])


@pytest.mark.parametrize("sees_all", [True, False])
def test_values_are_discounted_by_elapsed_time_and_end_with_death(sees_all):
    gamma, lmbda, judge = 0.99, 0.9, critic(sees_all)
    team = team_batch(decisions(2, 9, 3, deaths=[(0, 1, 2), (1, 5, 0)]))
    team_advantages(team, judge, gamma, lmbda, Unscaled())
    with torch.no_grad():
        value, following = (judge(x.select("seen"))["state_value"].squeeze(-1) for x in (team, team["next"]))
    for episode, satellite in torch.cartesian_prod(torch.arange(2), torch.arange(3)).tolist():
        row = [team["next", key][episode, :, satellite, 0].double().tolist() for key in ("reward", "duration", "removed")]
        of = [x[episode, :, satellite].tolist() for x in (value, following)]
        expected = brute_force(*row, *of, gamma, lmbda).float()
        torch.testing.assert_close(team["value_target"][episode, :, satellite, 0], expected, **FLOAT32_SUMS)
    # the last step of a satellite is worth what it brings, whatever the critic expects of the dead
    last = 0.99 ** team["next", "duration"][1, 5, 0, 0] * team["next", "reward"][1, 5, 0, 0]
    torch.testing.assert_close(team["value_target"][1, 5, 0, 0], last, **FLOAT32_SUMS)


def test_advantages_are_standardised_over_decisions():
    team = team_batch(decisions(4, 30, 3, deaths=[(2, 8, 1)]))
    team_advantages(team, critic(), 0.99, 0.9, Unscaled())
    chosen = team["advantage"][team["decides"]]
    assert float(chosen.mean()) == pytest.approx(0.0, abs=1e-5)
    assert float(chosen.std()) == pytest.approx(1.0, abs=1e-4)


def test_a_death_is_no_decision_of_the_others():
    one, other = (team_batch(decisions(1, 9, 3, deaths=deaths)) for deaths in ([], [(0, 5, 0)]))
    judge = critic(sees_all=False)
    for team in (one, other):
        team_advantages(team, judge, 0.99, 0.9, Unscaled())
    assert torch.equal(one["value_target"][:, :, 1:], other["value_target"][:, :, 1:])
    assert not torch.equal(one["value_target"][:, :, 0], other["value_target"][:, :, 0])


def test_only_the_central_critic_looks_at_others():
    seen = team_batch(decisions(1, 4, 3, deaths=[(0, 0, 2)])).select("seen")
    changed = seen.clone()
    changed["seen", "own"][:, :, 1:] += 1.0
    for sees_all in (True, False):
        judge = critic(sees_all)
        before, after = (judge(x.clone())["state_value"][:, :, 0] for x in (seen, changed))
        assert torch.equal(before, after) is not sees_all
    dead = seen.clone()
    dead["seen", "own"][:, 1, 2] += 1.0
    judge = critic()
    assert torch.equal(judge(dead.clone())["state_value"][:, 1, :2], judge(seen.clone())["state_value"][:, 1, :2])


@pytest.fixture(scope="module", params=["mappo", "ippo"])
def learned(request, tmp_path_factory):
    """A learner and the batch, as it was seen before the first gradient step, of one iteration."""
    config = MAPPOConfig(algorithm=request.param, seconds=5.0, num_envs=4, rollout=24, minibatch=32, epochs=4, options=WORLD)
    training = MAPPOTraining(config, tmp_path_factory.mktemp(request.param))
    collector = make_collector(config, training.env, training.actor, None)
    batch = next(iter(collector))
    collector.shutdown()
    report = training.learner.learn(batch)
    team = team_batch(batch)
    learner = training.learner.groups["agents"]
    team_advantages(team, learner.critic, config.gamma, learner.lmbda, learner.value_norm)
    return learner, team, report


@pytest.mark.compiled
def test_an_iteration_improves_the_surrogate(learned):
    learner, team, report = learned
    objective = float(losses(learner, team)[0])
    # before it the ratio is 1, and the objective minus the mean advantage, which is 0
    assert objective < -0.005
    assert 0.0 < report["kl_approx"] < 0.2
    assert 0.0 < report["entropy"] <= float(torch.tensor(16.0).log())


def losses(learner, team):
    sample = team.reshape(-1).clone()
    found = clipped_loss(learner.acting, learner.critic, sample, learner.config.clip, sample["decides"])
    return torch.stack([found.objective, found.loss_critic, found.entropy]).detach()


@pytest.mark.compiled
def test_nothing_is_learned_from_those_who_decide_nothing(learned):
    learner, team, _ = learned
    rest = ~team["decides"]
    assert 0.2 < float(rest.float().mean()) < 0.9
    before = losses(learner, team)
    changed = team.clone()
    for key in ("advantage", "value_target"):
        changed[key][rest] += 100.0
    assert torch.equal(losses(learner, changed), before)
    changed["advantage"][~rest] += 100.0
    assert not torch.equal(losses(learner, changed), before)


@pytest.mark.compiled
def test_the_loss_is_that_of_decisions_alone(learned):
    learner, team, _ = learned
    with torch.no_grad():
        log_prob = learner.acting.get_dist(team.reshape(-1)).log_prob(team["action"].reshape(-1, 3))
    ratio = torch.exp(log_prob - team["action_log_prob"].reshape(-1, 3))
    advantage = team["advantage"].reshape(-1, 3)
    gain = torch.minimum(ratio * advantage, ratio.clamp(0.8, 1.2) * advantage)[team["decides"].reshape(-1, 3)]
    torch.testing.assert_close(losses(learner, team)[0], -gain.mean(), **FLOAT32_SUMS)


@pytest.mark.compiled
def test_evaluation_adds_up_the_team_and_repeats_itself():
    world = WORLD | {"communicator": comm.FreeCommunication()}
    env = bsk_torch.make("Constellation-v1", num_envs=3, seed=0, **world)
    first, again = (evaluate(bsk_torch.rule("hasty", env), env, seed=5) for _ in range(2))
    assert torch.equal(first.returns, again.returns)
    assert torch.equal(first.seconds, torch.full((3,), 900.0, dtype=torch.float64))
    assert first.survival == 1.0
    assert bool((first.counts["imaged"] >= first.returns).all())  # priorities are below one
    assert bool((first.decisions >= first.counts["imaged"]).all())
    assert float(first.returns.min()) > 1.0


@pytest.mark.compiled
def test_an_interrupted_training_goes_on_as_if_nothing_had_happened(tmp_path):
    sizes = dict(
        num_envs=2, rollout=16, minibatch=16, seconds=None, learning_rate_schedule="constant", entropy_schedule="constant"
    )
    config = MAPPOConfig(frames=128, options=WORLD | {"n_targets": 500}, **sizes)
    whole = MAPPOTraining(config, tmp_path / "whole").run().state_dict()
    MAPPOTraining(dataclasses.replace(config, frames=64), tmp_path / "parts").run()
    parts = MAPPOTraining(config, tmp_path / "parts", resume=True).run().state_dict()
    assert whole.keys() == parts.keys()
    for name, value in whole.items():
        assert torch.equal(parts[name], value), name
