"""The schedule of sites: flown times, the best sequence by brute force, equal decisions in every batch, returns."""

import itertools
import math

import pytest
import torch

import bsk_torch
from bsk_torch.rl.evaluation import evaluate
from bsk_torch.tasks.sites import Sites
from bsk_torch.tasks.sites.rules import commit
from bsk_torch.tasks.sites.schedule import AFTER_OPENING, Ahead, Judgment, Track, expected_worth, look_ahead, schedule, turn_times

pytestmark = pytest.mark.compiled


def make(**options):
    return bsk_torch.make("Sites-v1", **(dict(num_envs=3, seed=2) | options))


def test_images_are_taken_at_the_times_predicted():
    env = make(num_envs=16)
    rule, satellite, td, errors, waits = commit(env), env.satellite, env.reset(), [], []
    for _ in range(30):
        ahead, track, before, start = look_ahead(satellite, 32), Track.of(satellite), satellite.imaged, env.fleet.sim_time
        turn = turn_times(track.at(torch.zeros(16, 1)), satellite.fsw.c_hat_P.float().unsqueeze(1), ahead.place).squeeze(1)
        td = rule(td)
        action = td["action"].unsqueeze(1)
        turn, opens = turn.gather(1, action).squeeze(1), ahead.open.gather(1, action).squeeze(1)
        td = env.step(td)["next"]
        time = env.fleet.sim_time - start
        torch.testing.assert_close(
            track.at(time.float().unsqueeze(1)).squeeze(1).double() * 1e6, satellite.dynamics.r_BN_P, atol=3e3, rtol=0
        )
        taken = satellite.imaged > before
        errors.append((time - turn)[taken & (opens < 0.0)])
        waits.append((time - opens - AFTER_OPENING)[taken & (opens > turn + 20.0)])
    errors, waits = torch.cat(errors), torch.cat(waits)
    assert len(errors) > 100
    assert errors.median().abs() < 1.5
    assert (errors.abs() < 5.0).float().mean() > 0.7
    assert waits.median().abs() < 1.0


def test_expected_worth_of_sets_of_images():
    """Against the sum over all weathers."""
    scenario, clear = Sites(1, gain="convex"), torch.tensor([0.9, 0.5, 0.7])
    worth = expected_worth(scenario, clear, torch.tensor(5.0), torch.tensor(1.0))
    for chosen in range(8):
        total = 0.0
        for weather in itertools.product((0, 1), repeat=3):
            chance = torch.prod(torch.where(torch.tensor(weather) > 0, clear, 1.0 - clear))
            number = sum(weather[k] for k in range(3) if chosen >> k & 1)
            total += float(chance * (scenario.gain(torch.tensor((1 + number) / 5)) - scenario.gain(torch.tensor(0.2))))
        assert float(worth[chosen]) == pytest.approx(total, abs=1e-6)


def by_hand(sequence, ahead, track, aim, judgment):
    """What a sequence pays, and the rest of the two best sites half of the second; minus infinity if an image is late."""
    time, now, paid, taken = 0.0, aim.view(1, 1, 3), 0.0, [0] * 8
    opens, close, bit, same, worth = (x[0].tolist() for x in (ahead.open, ahead.close, ahead.bit, ahead.same, ahead.worth))
    for k in sequence:
        turn = turn_times(track.at(torch.tensor([[time]])), now, ahead.place)[0, 0, k]
        time = max(time + float(turn), opens[k] + AFTER_OPENING)
        if time + judgment.reserve >= close[k]:
            return -math.inf
        more = taken[k] | bit[k]
        paid += (worth[k][more] - worth[k][taken[k]]) * math.exp(-time / judgment.patience)
        taken = [more if same[k][j] else taken[j] for j in range(8)]
        line = ahead.place[0, k] - track.at(torch.tensor([[time]]))[0, 0]
        now = (line / line.norm()).view(1, 1, 3)
    hopes = [0.0, 0.0]
    for j in range(8):
        left = [i for i in range(8) if same[j][i] and not taken[i] & bit[i]]
        reach = [i for k, i in enumerate(left) if time + judgment.each * (k + 1) <= close[i]]
        if not any(same[j][:j]):
            last = max(time, opens[j]) + judgment.each * len(reach)
            rest = worth[j][taken[j] | sum(bit[i] for i in reach)] - worth[j][taken[j]]
            hopes.append(rest * math.exp(-last / judgment.patience))
    first, second = sorted(hopes)[:-3:-1]
    return paid + first + 0.5 * second


def test_wide_searches_find_the_best_sequence():
    """Of all sequences of up to three of eight images, one by one."""
    env, judgment = make(num_envs=4, gain="convex"), Judgment()
    td, rule = env.reset(), commit(env)
    for _ in range(12):
        td = env.step(rule(td))["next"]
    ahead, track = look_ahead(env.satellite, 8), Track.of(env.satellite)
    wide = schedule(env, width=512, depth=3, images=8, horizon=1e9, flown=0)
    td["action_mask"][:, 8:] = False
    chosen = wide(td)["action"]
    aim = env.satellite.fsw.c_hat_P.float()
    others = 0
    for n in range(4):
        one = Ahead(*(x[n : n + 1] for x in ahead)), Track(*(x[n : n + 1] for x in track)), aim[n]
        every = {sequence: by_hand(sequence, *one, judgment) for sequence in itertools.permutations(range(8), 3)}
        best = max(every.values())
        assert best > 0.0
        assert int(chosen[n]) in {sequence[0] for sequence, worth in every.items() if worth > best - 1e-4}
        others += int(chosen[n]) != int(rule(td.clone())["action"][n])
    assert others


@pytest.mark.parametrize("flown", [0, 3])
def test_decisions_do_not_depend_on_the_batch(flown):
    whole = make(env_ids=[0, 1, 2])
    td, policy, played = whole.reset(), schedule(whole, width=4, flown=flown), []
    for _ in range(5):
        td = policy(td)
        played.append(td["action"])
        td = whole.step(td)["next"]
    env = make(num_envs=1, env_ids=[1])
    td, policy = env.reset(), schedule(env, width=4, flown=flown)
    for action in played:
        td = policy(td)
        assert td["action"].tolist() == action[1:2].tolist()
        td = env.step(td)["next"]
    assert len(played) == 5


def test_schedules_return_more_than_rules_that_rank_images():
    env = make(num_envs=12, env_ids=[0] * 12, gain="convex", risk=0.0)
    hasty = evaluate(bsk_torch.rule("hasty", env), env, seeds=range(12)).returns.mean()
    assert evaluate(schedule(env, width=4, flown=2), env, seeds=range(12)).returns.mean() > 1.2 * hasty
