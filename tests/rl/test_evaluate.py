"""Evaluation: which episodes are played, what is counted, and that neither depends on the batch."""

import gymnasium
import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule, TensorDictModuleBase

import bsk_torch
from bsk_torch.rl.evaluation.evaluate import Evaluation, evaluate
from bsk_torch.rl.rules.baselines import BASELINES, LOT, random_policy

pytestmark = pytest.mark.compiled

LIMIT = 3000.0
"""Length of the episodes, s: half an orbit, in which the store fills and passes come by."""


@pytest.fixture(scope="module")
def env():
    """Three episodes by seed at once."""
    return bsk_torch.make("NadirScan-v1", num_envs=3, env_ids=[0] * 3, time_limit=LIMIT)


def always(action):
    """A policy that knows one action."""
    return TensorDictModule(lambda mask: torch.full(mask.shape[:1], action), in_keys=["action_mask"], out_keys=["action"])


def evaluation(returns, **parts):
    """Results of as many episodes as there are ``returns``; none dies unless ``parts`` say so."""
    one = torch.ones(len(returns), dtype=torch.float64)
    return Evaluation(**(dict(returns=returns, collected=returns, survived=one, decisions=one, seconds=one, deaths={}) | parts))


def test_summaries_pair_gains():
    # every episode one better than the other: the difference is certain, though the returns are not
    returns = torch.randn(50)
    better, worse = (evaluation(x) for x in (returns + 1.0, returns))
    assert better.gain_over(worse).mean == pytest.approx(1.0, abs=1e-6)
    assert better.gain_over(worse).half_width < 1e-6
    assert better.mean_return.half_width > 0.1
    dead = torch.tensor([True, False, False, False])
    result = evaluation(torch.zeros(4), survived=~dead, deaths={"battery_valid": dead, "other_valid": dead & False})
    told = result.summary({"other": evaluation(torch.ones(4))})
    assert (told["episodes"], told["survival"], told["deaths"], told["fill"]) == (4, 0.75, {"battery_valid": 1}, None)
    assert told["survival_interval"][0] < 0.75 < told["survival_interval"][1]
    assert told["gain"] == {"other": {"mean": -1.0, "half_width": 0.0}}


def test_parts_are_joined_in_order_with_one_episode_per_row():
    parts = [
        evaluation(torch.tensor([x, x + 1.0]), fill=torch.tensor([x, 0.0]), counts={"imaged": torch.tensor([2, 3])})
        for x in (0.0, 5.0)
    ]
    whole = Evaluation.joined(parts)
    assert (whole.returns.tolist(), whole.fill.tolist()) == ([0.0, 1.0, 5.0, 6.0], [0.0, 0.0, 5.0, 0.0])
    assert whole.counts["imaged"].tolist() == [2, 3, 2, 3]
    assert Evaluation.joined([evaluation(torch.zeros(1))]).fill is None
    env = bsk_torch.make("NadirScan-v1", num_envs=3, seed=0, time_limit=LIMIT)
    first, again = (evaluate(BASELINES["rule"](env, 0), env, seed=5) for _ in range(2))
    assert first.returns.dtype == torch.float64
    assert torch.equal(first.returns, again.returns)
    assert (first.seconds.tolist(), first.survival, first.causes) == ([LIMIT] * 3, 1.0, {})


@pytest.mark.parametrize("name", ["random", "rule"])
def test_results_do_not_depend_on_the_batch(env, name):
    seeds = [4, 0, 9, 2, 2]  # two batches of three, the second with a row to spare
    one = bsk_torch.make("NadirScan-v1", num_envs=1, env_ids=[0], time_limit=LIMIT)
    many, few = (evaluate(BASELINES[name](e, 0), e, seeds=seeds) for e in (env, one))
    assert torch.equal(many.returns, few.returns)
    assert torch.equal(many.fill, few.fill)
    assert torch.equal(many.decisions, few.decisions)
    assert (many.returns[3], len(set(many.fill.tolist()))) == (many.returns[4], 4)


def test_seeds_start_what_gymnasium_starts(env):
    played = evaluate(BASELINES["rule"](env, 0), env, seeds=[11])
    alone = gymnasium.make("bsk_torch/NadirScan-v1", time_limit=LIMIT)
    rule, over, total = BASELINES["rule"](alone.unwrapped.core, 0), False, 0.0
    observation, _ = alone.reset(seed=11)
    while not over:
        seen = TensorDict({"observation": torch.as_tensor(observation).unsqueeze(0)}, [1])
        observation, reward, terminated, truncated, _ = alone.step(int(rule(seen)["action"]))
        over, total = terminated or truncated, total + reward
    assert total > 0.0
    assert float(played.returns) == pytest.approx(total, abs=1e-7)  # Gymnasium's rewards are float32
    assert float(played.fill) == pytest.approx(float(alone.unwrapped.core.satellite.dynamics.storage_level_fraction), abs=1e-12)


def test_seeds_are_those_of_environment_0_in_every_row_and_leave_the_rows_as_they_were():
    """32 rows, whose next episodes are prepared in bulk."""
    made = dict(num_envs=32, seed=0, time_limit=300.0)
    env, zero = bsk_torch.make("NadirScan-v1", **made), bsk_torch.make("NadirScan-v1", **made, env_ids=[0] * 32)
    begins = env.reset()["observation"]
    seeds = [0, 3, *range(32)]  # seed 0 has just begun in every row, with other episodes
    results = [evaluate("rule", each, seeds=seeds) for each in (env, zero)]
    assert torch.equal(*(torch.cat([result.returns, result.fill]) for result in results))
    env.set_seed(0)
    assert torch.equal(env.reset()["observation"], begins)


def test_the_cause_of_death_is_named():
    # desaturation takes 80 W, and more than the panel gives
    env = bsk_torch.make("NadirScan-v1", num_envs=2, seed=0, sat_args={"storedCharge_Init": 1000.0}, time_limit=LIMIT)
    result = evaluate(always(3), env, seed=0)
    assert (result.causes, result.survival) == ({"battery_valid": 2}, 0.0)
    assert (result.returns.tolist(), result.collected.tolist()) == ([-1.0, -1.0], [0.0, 0.0])
    assert float(result.seconds.max()) < LIMIT


def test_random_policy_takes_the_lots_that_it_is_given():
    mask = torch.tensor([[True, False, True, True]]).expand(3, 4)
    lots = torch.tensor([0.0, 0.5, 0.99], dtype=torch.float64)
    policy = random_policy(bsk_torch.make("NadirScan-v1", num_envs=3, time_limit=LIMIT), 0)
    assert policy(TensorDict({"action_mask": mask, LOT: lots}, [3]))["action"].tolist() == [0, 2, 3]


class Counting(TensorDictModuleBase):
    """Counts its decisions of an episode, and notes what it found."""

    in_keys = ("count",)
    out_keys = ("action", ("next", "count"))

    def __init__(self):
        super().__init__()
        self.found = []

    def forward(self, tensordict):
        count = tensordict.get("count", torch.zeros(tensordict.batch_size, dtype=torch.int64))
        self.found.append(count.tolist())
        return tensordict.update({"action": torch.zeros_like(count), "next": {"count": count + 1}})


def test_policies_see_what_they_write_and_nothing_else_that_is_old(env):
    policy = Counting()
    played = evaluate(policy, env, seeds=range(4))
    steps = int(played.decisions.max())
    assert steps == int(LIMIT // 180.0) + 1  # scans last 180 s
    assert policy.found == [[k] * 3 for _ in range(2) for k in range(steps)]
    seen, policy = [], always(0)
    policy.register_forward_pre_hook(lambda module, given: seen.append(set(given[0].keys())))
    evaluate(policy, env, seeds=[0])
    assert len(seen) > 1
    assert all("action" not in keys for keys in seen)
