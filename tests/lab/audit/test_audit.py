"""Audits: regrets are what other flights return more, and their summaries are right."""

import json

import pytest
import torch

import bsk_torch
from bsk_torch.env.rollout import play_episodes
from bsk_torch.lab.audit.audit import Audit, audit
from bsk_torch.rl.evaluation.evaluate import evaluate, start_episodes
from tests.lab.planners.conftest import always, scanning

pytestmark = pytest.mark.compiled


def four_decisions(**changed):
    """An audit by hand: two episodes, two decisions each, three actions."""
    nan = torch.nan
    values = torch.tensor([[1.0, 3.0, nan], [2.0, 2.0, 2.0], [0.0, 1.0, 9.0], [5.0, 4.0, nan]], dtype=torch.float64)
    given = dict(
        seeds=[7, 9],
        returns=torch.tensor([3.0, 4.0], dtype=torch.float64),
        episode=torch.tensor([0, 0, 1, 1]),
        time=torch.tensor([0.0, 60.0, 0.0, 90.0], dtype=torch.float64),
        agent=torch.tensor([0, 0, 0, 0]),
        action=torch.tensor([0, 1, 1, 0]),
        values=values.unsqueeze(1),
        situation={"battery": torch.tensor([0.1, 0.5, 0.2, 0.9], dtype=torch.float64)},
        kinds=[["charge", "scan", "scan"]],
    )
    return Audit(**(given | changed))


def test_regret_and_its_summaries_of_an_audit_by_hand():
    found = four_decisions()
    assert found.regret.tolist() == [2.0, 0.0, 8.0, 0.0]
    assert found.best.tolist() == [1, 1, 2, 0]
    assert found.regret_of_episodes.mean == 5.0
    assert found.share_of_worst(0.25) == 0.8
    assert found.worst(2).tolist() == [2, 0]
    scan, charge = found.by_action()
    assert (scan.chosen, scan.decisions, scan.regret, scan.share, scan.better) == ("scan", 2, 4.0, 0.8, "scan")
    assert (charge.chosen, charge.decisions, charge.regret, charge.share, charge.better) == ("charge", 2, 1.0, 0.2, "scan")
    (battery,) = found.by_situation()
    assert battery.regret == (5.0, 0.0, 0.0)
    kept = json.loads(json.dumps(found.to_dict(), allow_nan=False))
    assert kept["decisions"]["values"][0] == [1.0, 3.0, None]


def test_futures_that_are_noise_give_no_regret_on_average():
    generator = torch.Generator().manual_seed(0)
    values = torch.randn(4000, 8, 5, generator=generator, dtype=torch.float64)
    n = len(values)
    zeros = torch.zeros(n, dtype=torch.int64)
    found = four_decisions(
        seeds=[0], returns=torch.zeros(1, dtype=torch.float64), episode=zeros, agent=zeros, action=zeros, values=values,
        time=torch.zeros(n, dtype=torch.float64), situation={}, kinds=[list("abcde")],
    )  # fmt: skip
    biased = float((values.mean(1).amax(1) - values.mean(1)[:, 0]).mean())
    assert biased > 0.3
    assert abs(float(found.regret.mean())) < 0.03  # about three standard errors


def test_a_flight_is_audited_as_it_is_flown():
    env = scanning(2)
    found = audit(env, "rule", seeds=[3, 4, 5])
    plain = evaluate(bsk_torch.rule("rule", env), env, seeds=[3, 4, 5])
    assert torch.equal(found.returns, plain.returns)
    assert found.episode.bincount().tolist() == plain.decisions.tolist()
    assert bool((found.regret >= 0.0).all())
    assert set(found.situation) == {"battery", "data store", "fastest wheel", "legal actions", "seconds since reset"}
    first = found.values[found.time == 0.0].mean(1)
    chosen = found.action[found.time == 0.0]
    assert torch.allclose(first.gather(1, chosen.unsqueeze(1)).squeeze(1), found.returns, rtol=0.0, atol=1e-12)


def test_the_largest_regret_is_earned_by_the_better_action():
    env = scanning(1)
    found = audit(env, always(1), seeds=[3])
    decision = int(found.worst(1)[0])
    assert float(found.regret[decision]) > 0.0
    now, steps = start_episodes(env, [3]), int((found.time < found.time[decision]).sum())
    for k in range(steps + 1):
        now["action"] = found.best[[decision]] if k == steps else torch.tensor([1])
        now = env.step(now)["next"]
    for _ in play_episodes(env, always(1), now):
        pass
    assert float(env.returns[0] - found.returns[0]) == pytest.approx(float(found.regret[decision]), abs=1e-12)


def test_rows_do_not_matter():
    one, two = (audit(scanning(n), "random", seeds=[3, 4, 5], horizon=300.0) for n in (1, 2))
    assert torch.equal(one.values.nan_to_num(), two.values.nan_to_num())
    assert torch.equal(one.time, two.time)


def test_agents_of_a_team_have_their_own_decisions():
    crew = bsk_torch.make("AEOSConstellation-v1", num_envs=1, env_ids=[0], time_limit=300.0, n_targets=(5000, 5001))
    found = audit(crew, "greedy", seeds=[0], horizon=60.0, budget=2)
    assert set(found.agent.tolist()) == {0, 1, 2}
    assert len(found.kinds) == 3
    assert not bool(found.situation["battery"].isnan().any())
