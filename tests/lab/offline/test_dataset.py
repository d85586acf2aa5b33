"""Datasets: transitions are those of the episodes, and returns of actions those of other flights."""

import math

import pytest
import torch
from tensordict.nn import TensorDictModule
from torchrl.data import SliceSampler

import bsk_torch
from bsk_torch.env.seeds import SUITE_SEEDS
from bsk_torch.lab.offline import Behavior, open_dataset, write_dataset
from bsk_torch.lab.offline.behaviors import slug
from bsk_torch.lab.planners import planner
from bsk_torch.rl.evaluation.evaluate import evaluate
from bsk_torch.rl.policies.pretrained import pretrained
from bsk_torch.rl.policies.shared_policy import rule
from bsk_torch.rl.rules.baselines import LOT
from tests.lab.offline.conftest import LIMIT, recipe
from tests.lab.planners.conftest import always, scanning
from tests.support.refusals import check_refusals, refusal

pytestmark = pytest.mark.compiled


def contents(folder):
    """Bytes of all files by path."""
    return {path.relative_to(folder): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def test_the_bytes_do_not_depend_on_how_many_episodes_are_played_at_once(written, tmp_path):
    env = scanning(3, LIMIT)
    write_dataset(tmp_path / "other", env, recipe(env, minari=True))
    one, other = contents(written.folder), contents(tmp_path / "other")
    assert one.keys() == other.keys()
    assert not [str(path) for path in one if one[path] != other[path]]


def test_another_seed_gives_other_data(written, tmp_path):
    env = scanning(3, LIMIT)
    write_dataset(tmp_path / "other", env, recipe(env, seeds=range(14, 17), share=0.0, targets={}))
    other = open_dataset(tmp_path / "other")
    assert not torch.equal(written.transitions("random")["observation"][:5], other.transitions("random")["observation"][:5])
    check_refusals(
        refusal(lambda: other.starts(), ValueError, "targets"),
        refusal(lambda: other.counterfactuals("random"), ValueError, "random"),
    )


def test_transitions_are_the_episodes_one_after_the_other(written):
    data = written.transitions("pretrained")
    last = torch.nonzero(data["next", "done"].squeeze(-1)).squeeze(-1)
    assert (data["episode"][last].tolist(), last[-1]) == ([0, 1, 2], len(data) - 1)
    inner = torch.ones(len(data), dtype=torch.bool)
    inner[last] = False
    at = torch.nonzero(inner).squeeze(-1)
    for key in ("observation", "action_mask", "duration"):
        assert torch.equal(data["next", key][at], data[key][at + 1]), key
    assert not bool(data["done"].any())
    found = evaluate(pretrained("NadirScan-v1"), scanning(3, LIMIT), seeds=range(11, 14))
    returns = torch.zeros(3, dtype=torch.float64).index_add(0, data["episode"], data["next", "reward"].squeeze(-1).double())
    torch.testing.assert_close(returns, found.returns, atol=1e-6, rtol=0.0)
    assert torch.bincount(data["episode"]).tolist() == found.decisions.tolist()
    lengths = torch.zeros(3, dtype=torch.float64).index_add(0, data["episode"], data["next", "duration"].squeeze(-1).double())
    torch.testing.assert_close(lengths, found.seconds, atol=1e-3, rtol=0.0)


def test_probabilities_are_those_of_the_behavior(written):
    data = written.transitions("random")
    legal = data["action_mask"].sum(1).float()
    torch.testing.assert_close(data["action_log_prob"], -legal.log())
    assert len(data["action"].unique()) == 4
    assert bool((written.transitions("pretrained")["action_log_prob"] == 0.0).all())
    mixed = written.transitions("pretrained,random=0.4")
    preferred = pretrained("NadirScan-v1")(mixed.select("observation", "action_mask").clone())["action"] == mixed["action"]
    share = 0.4 / mixed["action_mask"].sum(1)
    torch.testing.assert_close(mixed["action_log_prob"].exp(), share + 0.6 * preferred)
    other = 1.0 - float(preferred.double().mean())  # 0.3 is expected with four legal actions
    assert 0.3 - 4.0 * math.sqrt(0.21 / len(mixed)) < other < 0.3 + 4.0 * math.sqrt(0.21 / len(mixed))


def flown_again(data, seed, decision, action, target):
    """Return of an episode from a decision on: played from the start by the actions in ``data``, ``action``, then ``target``."""
    env = bsk_torch.make("NadirScan-v1", num_envs=1, env_ids=[0], time_limit=LIMIT)
    env.reseed([seed])
    now, total = env.reset(), 0.0
    for number in range(10_000):
        if number < decision:
            now["action"] = data["action"][number].view(1)
        elif number == decision:
            now["action"] = torch.tensor([action])
            before = float(env.returns)
        else:
            now = target(now)
        now = env.step(now)["next"]
        if bool(now["done"]):
            return float(env.returns) - before
    return total


def test_values_of_actions_are_the_returns_of_flights_from_the_start(written):
    targets = {"pretrained": pretrained("NadirScan-v1"), "rule": rule("rule", scanning(1, LIMIT))}
    data, found = written.transitions("random"), written.counterfactuals("random")
    assert len(found) > 5
    assert torch.equal(data["observation"][found["index"]], found["observation"])
    assert torch.equal(data["action"][found["index"]], found["action"])
    for k in (1, len(found) - 1):
        episode, decision = int(found["episode"][k]), int(found["decision"][k])
        actions = data[data["episode"] == episode]
        for name, target in targets.items():
            values = found["action_value", name][k]
            assert torch.equal(values.isnan(), ~found["action_mask"][k])
            for action in torch.nonzero(found["action_mask"][k]).flatten().tolist():
                again = flown_again(actions, 11 + episode, decision, action, target)
                assert float(values[action]) == pytest.approx(again, abs=1e-12)


def test_values_of_the_target_are_the_rest_of_the_return_and_those_at_the_starts(written):
    data, found = written.transitions("pretrained"), written.counterfactuals("pretrained")
    assert torch.equal(found["target_action", "pretrained"], found["action"])
    for row in found:
        rest = (data["episode"] == row["episode"]) & (torch.arange(len(data)) >= row["index"])
        value = row["action_value", "pretrained"][row["action"]]
        assert float(value) == pytest.approx(float(data["next", "reward"][rest].double().sum()), abs=1e-6)
    starts = written.starts()
    assert starts["seed"].tolist() == [11, 12, 13]
    found = evaluate(rule("rule", scanning(3, LIMIT)), scanning(3, LIMIT), seeds=range(11, 14))
    torch.testing.assert_close(starts["action_value", "rule"], found.returns, atol=1e-12, rtol=0.0)
    first = written.transitions("random")["observation"][[0]]
    assert torch.equal(starts["observation"][:1], first)


def test_discounts_and_futures(tmp_path):
    env = scanning(2, 900.0)
    short = recipe(
        env, behaviors=[Behavior("rule", rule("rule", env))], gamma=0.999, futures=2, targets={"rule": rule("rule", env)}
    )
    write_dataset(tmp_path / "d", env, short)
    data = open_dataset(tmp_path / "d")
    rows, found = data.transitions(), data.counterfactuals()
    assert bool((found["standard_error", "rule"].nan_to_num() == 0.0).all())  # nothing in NadirScan-v1 is drawn later
    for row in found:
        rest = rows[(rows["episode"] == row["episode"]) & (torch.arange(len(rows)) >= row["index"])]
        after = 0.999 ** rest["next", "duration"].double().cumsum(0)
        value = row["action_value", "rule"][row["action"]]
        assert float(value) == pytest.approx(float((after * rest["next", "reward"]).sum()), abs=1e-6)
    whole = rows[rows["episode"] == 1]
    value = (0.999 ** whole["next", "duration"].double().cumsum(0) * whole["next", "reward"]).sum()
    assert float(data.starts()["action_value", "rule"][1]) == pytest.approx(float(value), abs=1e-6)


def test_sets_of_targets_and_planners_as_behaviors(tmp_path):
    env = bsk_torch.make("AEOS-v1", num_envs=2, env_ids=[0, 0], time_limit=300.0, as_set=True, n_targets=300)
    policy = pretrained("AEOS-v1")
    searching = planner("rollout", env, base=policy, horizon=120.0, budget=2)
    wanted = recipe(
        env, preset="AEOS-v1", behaviors=[Behavior("plan", searching, 0.2)], targets={"pretrained": policy}, share=0.5
    )
    write_dataset(tmp_path / "d", env, wanted)
    data = open_dataset(tmp_path / "d")
    rows, found = data.transitions(), data.counterfactuals()
    inner = ~rows["next", "done"].squeeze(-1)[:-1]
    after, then = rows["next", "observation"][:-1][inner], rows["observation"][1:][inner]
    assert bool((after == then).all())
    assert found["action_value", "pretrained"].shape == (len(found), 32)


def test_buffers_of_torchrl(written):
    sampler = SliceSampler(slice_len=4, traj_key="episode", strict_length=False)
    sample = written.replay_buffer(batch_size=16, sampler=sampler).sample()
    place = sample["index"].flatten()
    inner = (sample["episode"][1:] == sample["episode"][:-1]) & (place[1:] == place[:-1] + 1)
    assert bool(inner.any())
    assert torch.equal(sample["next", "observation"][:-1][inner], sample["observation"][1:][inner])
    buffer = written.replay_buffer("random", batch_size=8)
    assert buffer.sample().batch_size == (8,)
    check_refusals(refusal(lambda: buffer.extend(buffer.sample()), RuntimeError))
    assert written.transitions()["episode"].unique().tolist() == list(range(9))


def test_rejects_unknown_behaviors_and_folders(written, tmp_path):
    def holding(text):
        (tmp_path / "dataset.json").write_text(text)
        open_dataset(tmp_path)

    check_refusals(
        refusal(lambda: written.transitions("randm"), ValueError, "behavior", "'randm'", "'random'"),
        refusal(lambda: open_dataset(tmp_path), FileNotFoundError, tmp_path, "'dataset.json'"),
        refusal(lambda: holding("[1]"), ValueError, "dataset.json", "card"),
        refusal(lambda: holding('{"format": 2}'), ValueError, "dataset.json", "format 2", "format 1"),
    )


def test_rejects_wrong_recipes_behaviors_and_targets():
    env = scanning(1, LIMIT)
    wrong = lambda **changed: recipe(env, **changed)
    named = lambda *names: [Behavior(name, None, 1.0) for name in names]
    drawing = TensorDictModule(lambda lot: lot.long(), in_keys=[LOT], out_keys=["action"])
    check_refusals(
        refusal(lambda: wrong(seeds=[]), ValueError, "one behavior", "one seed"),
        refusal(lambda: wrong(behaviors=[]), ValueError, "one behavior", "one seed"),
        refusal(lambda: wrong(share=1.5), ValueError, "share", 1.5),
        refusal(lambda: wrong(gamma=0.0), ValueError, "gamma", 0.0),
        refusal(lambda: wrong(futures=0), ValueError, "futures=0"),
        refusal(lambda: wrong(seeds=[SUITE_SEEDS[3]]), ValueError, "seeds", SUITE_SEEDS[0], SUITE_SEEDS[-1], "suites"),
        refusal(lambda: wrong(behaviors=named("a,b", "a b")), ValueError, "behaviors", ["a-b", "a-b"], "names"),
        refusal(lambda: wrong(behaviors=named("starts")), ValueError, "behaviors", ["starts"], "names"),
        refusal(lambda: wrong(targets={"a/b": always(0)}), ValueError, "target", "'a/b'", "'a-b'"),
        refusal(lambda: wrong(targets={"random": drawing}), ValueError, "target", "'random'", "actions"),
    )
    env = scanning(1, LIMIT)
    check_refusals(
        refusal(lambda: Behavior("half", None, 0.5), ValueError, "random=0.5", "1"),
        refusal(lambda: Behavior("drawn", rule("random", env)), ValueError, "probabilities"),
        refusal(lambda: recipe(env, targets={"plan": planner("rollout", env)}), ValueError, "planner", "copies"),
    )
    remembering = TensorDictModule(
        lambda mask, memory: mask.long().argmax(1), in_keys=["action_mask", "hidden"], out_keys=["action"]
    )
    check_refusals(refusal(lambda: recipe(env, targets={"gru": remembering}).checked(env), ValueError, "'hidden'"))
    assert slug("pretrained,random=0.4") == "pretrained-random-0-4"


def test_rejects_environments_that_do_not_fit(tmp_path):
    def write(preset, **options):
        env = bsk_torch.make(preset, **({"num_envs": 2, "env_ids": [0, 0]} | options))
        wanted = recipe(env, preset=preset, targets={}, behaviors=[Behavior("random", None, 1.0)])
        write_dataset(tmp_path / "d", env, wanted)

    check_refusals(
        refusal(lambda: write("CWDocking-v1", backend="eager"), ValueError, "real numbers", "numbered"),
        refusal(lambda: write("NadirScan-v1", env_ids=[1, 2]), ValueError, "seeds", "environment 0"),
    )
    assert not list(tmp_path.iterdir())


def test_nothing_is_left_of_a_failure_and_nothing_is_replaced(tmp_path):
    env = scanning(2, LIMIT)
    calls = []

    def tired(mask):
        calls.append(mask)
        if len(calls) > 3:
            raise RuntimeError("out of memory")
        return mask.long().argmax(1)

    failing = Behavior("tired", TensorDictModule(tired, in_keys=["action_mask"], out_keys=["action"]))
    with pytest.raises(RuntimeError, match="out of memory"):
        write_dataset(tmp_path / "d", env, recipe(env, behaviors=[Behavior("random", None, 1.0), failing], targets={}))
    assert not list(tmp_path.iterdir())
    (tmp_path / "d").mkdir()
    check_refusals(
        refusal(lambda: write_dataset(tmp_path / "d", env, recipe(env)), ValueError, "new folder"),
        refusal(lambda: write_dataset(tmp_path / "no" / "d", env, recipe(env)), ValueError, "folder"),
    )
