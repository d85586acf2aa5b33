"""Rewards of a team of imagers that know different images."""

from __future__ import annotations

import copy
import random

import pytest
import torch

from bsk_torch import comm
from bsk_torch.constants import MU_EARTH
from bsk_torch.tasks.objects import RSOTargets, RSOTeamReward
from bsk_torch.tasks.objects.reward import NONE, _Images
from tests.tasks.objects.objects import RADIUS, catalog, environment, play

CHARGE, DOWNLINK, FIRST = 0, 1, 2

NAMES = ["Imager0", "Imager1"]


def targets(**options):
    return RSOTargets(catalog(), options.pop("names", NAMES), **({"knowledge": "own"} | options))


def team(rewarder=None, **options):
    given = RSOTeamReward(quality_threshold=0.0, cooldown_s=400.0) if rewarder is None else rewarder
    return environment(imagers=2, **({"scenario": targets(), "rewarder": given} | options))


def ids(env, imager, count=4):
    return env.scenario.candidate_ids(env.satellites[0], imager, count)


@pytest.mark.compiled
@pytest.mark.parametrize("told", [False, True])
def test_candidates_follow_from_what_an_imager_knows(told):
    """Imager 0 takes object 1. Imager 1 has it among its candidates until it is told."""
    env = team(communicator=comm.FreeCommunication() if told else None)
    env.reset()
    assert ids(env, 0)[0] == "object 1"
    while env.rewarder.counts()["captured"][0, 0] == 0:
        play(env, FIRST, CHARGE)
    assert "object 1" not in ids(env, 0)
    assert ("object 1" in ids(env, 1)) != told
    assert env.scenario.satisfied[0, :, 1].tolist() == [True, told]
    assert env.scenario.pending[0].tolist() == [0, 1, 0, 0]
    assert torch.equal(env.satellites[0].action_mask()[1, FIRST:].sum(), torch.tensor(3))


@pytest.mark.compiled
def test_delivery_share_splits_the_priority_between_capture_and_delivery():
    env = team(RSOTeamReward(delivery_share=0.25, quality_threshold=0.0, cooldown_s=400.0))
    env.reset()
    total = 0.0
    while env.rewarder.counts()["captured"][0, 0] == 0:
        total += play(env, FIRST, CHARGE)[next(iter(env.group_map))]["reward"].sum().item()
    assert total == 2 * 0.75 * 2.0  # two environments, priority 2
    while env.rewarder.counts()["delivered"][0, 0] == 0:
        total += play(env, DOWNLINK, CHARGE)[next(iter(env.group_map))]["reward"].sum().item()
    assert total == 2 * 2.0
    assert env.rewarder.counts()["services"].tolist() == [[1, 0]] * 2
    assert env.rewarder.coverage["delivery"].tolist() == [0.25, 0.25]
    captured = env.scenario.records.capture[0, 0].item()
    assert bool(env.scenario.satisfied[0, 0, 1]) == (captured + 400.0 > env.fleet.sim_time[0].item())
    while env.fleet.sim_time[0] < captured + 400.0:
        assert "object 1" not in ids(env, 0)
        play(env, CHARGE, CHARGE)
    assert "object 1" in ids(env, 0)


@pytest.mark.compiled
def test_the_cooldown_is_two_periods_by_default():
    env = team(RSOTeamReward())
    env.reset()
    period = 2.0 * torch.pi * (RADIUS**3 / MU_EARTH) ** 0.5
    assert env.scenario.service_time.tolist() == pytest.approx([2.0 * period] * 2, rel=1e-12)


@pytest.mark.compiled
def test_an_imager_that_learns_of_an_image_requires_another_task():
    """Both begin to image object 2 at different times; the later one is told, and has wasted its time."""
    env = team(communicator=comm.FreeCommunication())
    env.reset()
    stay = 5
    play(env, FIRST, FIRST)
    play(env, FIRST, FIRST)
    began = env.fleet.sim_time[0].item()
    assert ids(env, 0)[0] == ids(env, 1)[0] == "object 2"
    play(env, stay, FIRST)
    took = env.fleet.sim_time[0].item()
    assert env.satellites[0].task.requires_retasking.tolist() == [True] * 4
    counts = env.rewarder.counts()
    assert counts["captured"][0].sum() == 4
    assert counts["duplicate_attempts"][0].tolist() == [0, 0]
    loser = 1 - int(env.scenario.records.source[0, 3])
    before = env.rewarder.wasted_time[0, loser].item()
    play(env, CHARGE, CHARGE)
    wasted = env.rewarder.wasted_time[0, loser].item() - before
    assert 0.0 < wasted <= took
    if loser == 1:
        assert wasted == pytest.approx(took - began)


@pytest.mark.compiled
def test_without_messages_imagers_do_the_same_work_twice():
    env = team()
    env.reset()
    for _ in range(12):
        play(env, FIRST, FIRST)
    counts = env.rewarder.counts()
    assert counts["captured"][0].sum() == counts["acquisitions"][0].sum() + counts["duplicate_attempts"][0].sum()
    assert counts["duplicate_attempts"][0].sum() > 0
    assert env.rewarder.wasted_time[0].sum() > 0.0


def ledger(images, last, cooldown, tolerance, share, priority):
    """Rewards of images, dictionaries, one group of simultaneous images of a target after the other."""
    paid, late = [0.0] * len(images), [False] * len(images)
    for target in range(4):
        left = sorted((k for k, i in enumerate(images) if i["there"] and i["target"] == target), key=lambda k: images[k]["time"])
        while left:
            first = images[left[0]]["time"]
            group = [k for k in left if images[k]["time"] <= first + tolerance]
            left = [k for k in left if k not in group]
            good = [k for k in group if images[k]["quality"] >= 0.5]
            if first < last[target] + cooldown:
                for k in group:
                    late[k] = True
            elif good:
                last[target] = first
                for k in good:
                    paid[k] = share * priority[target] / len(good)
    return paid, late


@pytest.mark.compiled
@pytest.mark.parametrize("stage", ["acquisition", "delivery"])
def test_the_ledger_is_that_of_lists(stage):
    """With random images of a step, also several groups of a target in one step."""
    env = team(RSOTeamReward(delivery_share=0.3, cooldown_s=10.0, same_time_s=1.0))
    env.reset()
    rewarder, numbers = env.rewarder, random.Random(5)
    last = [[-1e30] * 4 for _ in range(2)]
    for step in range(80):
        images = [
            [
                dict(
                    there=numbers.random() < 0.8,
                    target=numbers.randrange(4),
                    time=3.0 * step + numbers.choice([0.0, 0.5, 1.0, 2.0, 11.0]),
                    quality=numbers.choice([0.4, 0.5, 1.0]),
                )
                for _ in range(2)
            ]
            for _ in range(2)
        ]
        columns = {name: torch.tensor([[i[name] for i in row] for row in images]) for name in images[0][0]}
        imager = torch.arange(2).expand(2, 2)
        time, quality = columns["time"].double(), columns["quality"].double()
        batch = _Images(columns["there"], columns["target"], imager, time, quality, time, torch.full_like(imager, NONE))
        rewarder._credit(stage, rewarder.delivery_reward_fn, batch, time, time)
        share = 0.7 if stage == "acquisition" else 0.3
        for e in range(2):
            paid, _ = ledger(images[e], last[e], 10.0, 1.0, share, [1.0, 2.0, 3.0, 4.0])
            assert rewarder.last_reward_components[stage][e].tolist() == pytest.approx(paid)
    name = "acquisitions" if stage == "acquisition" else "services"
    assert env.rewarder.counts()[name].sum() > 20


@pytest.mark.compiled
def test_episodes_do_not_depend_on_the_batch_and_continue_from_saved_states():
    few, many = team(communicator=comm.FreeCommunication()), team(communicator=comm.FreeCommunication(), num_envs=5)
    for env in (few, many):
        env.reset()
        for _ in range(5):
            play(env, FIRST, FIRST)
    for name in ("target", "capture", "known", "received"):
        assert torch.equal(few.scenario.records[name], many.scenario.records[name][:2])
    other = team(communicator=comm.FreeCommunication(), seed=4)
    other.reset()
    other.restore(few.get_state())
    branch = copy.deepcopy(few)
    for env in (few, other, branch):
        for _ in range(4):
            play(env, FIRST, FIRST)
    for env in (other, branch):
        assert torch.equal(few.scenario.records.known, env.scenario.records.known)
        assert torch.equal(few.rewarder.wasted_time, env.rewarder.wasted_time)
        assert ids(few, 1) == ids(env, 1)
