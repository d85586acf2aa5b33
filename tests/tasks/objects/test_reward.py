"""Rewards for images of resident space objects (RSO)."""

from __future__ import annotations

import random

import pytest
import torch

from bsk_torch.act import image_target
from bsk_torch.tasks.objects import ImageRSO, RSOImageReward, RSOPriorityEvent
from bsk_torch.tasks.objects.reward import NONE, _Images
from tests.tasks.objects.objects import Imager, catalog, environment, play

CHARGE, DOWNLINK, FIRST = 0, 1, 2


@pytest.mark.compiled
def test_acquisition_and_delivery_pay_once():
    seen = {}

    def taken(record, target):
        seen.update(record._asdict())
        return 0.5 * target.priority + 0.0 * record.quality

    env = environment(rewarder=RSOImageReward(taken, quality_threshold=0.0, cooldown_s=400.0))
    env.reset()
    reward = play(env, FIRST)
    assert reward[next(iter(env.group_map))]["reward"].flatten().tolist() == [1.0, 1.0]  # object 1 has the priority 2
    assert torch.equal(seen["capture_time"][:, 0], env.fleet.sim_time)
    assert seen["size_bits"].flatten().tolist() == [1e6, 1e6]
    assert torch.isnan(seen["delivery_time"]).all()
    assert env.rewarder.last_reward_components["acquisition"].flatten().tolist() == [1.0, 1.0]
    assert env.rewarder.counts()["captured"].flatten().tolist() == [1, 1]
    captured = env.fleet.sim_time.clone()
    total = torch.zeros(2, dtype=torch.float64)
    for _ in range(3):
        play(env, DOWNLINK)
        total += env.rewarder.last_reward_components["delivery"].sum(1)
    assert total.tolist() == [2.0, 2.0]
    assert env.scenario.pending[0].tolist() == [0, 0, 0, 0]
    assert torch.equal(env.scenario.cooldown_until[:, 1], captured + 400.0)
    ready = env.fleet.sim_time >= captured + 400.0
    assert torch.equal(env.scenario.eligible[:, 1], ready)
    assert env.rewarder.counts()["delivered"].flatten().tolist() == [1, 1]


class Fixed(Imager):
    action_spec = (ImageRSO(3, 150.0, 5.0, require_illumination_during_hold=False, variable_duration_imaging=False),)


@pytest.mark.compiled
@pytest.mark.parametrize(("mode", "each"), [("shared", 1.0), ("per_imager", 2.0)])
def test_images_of_one_step_share_their_reward_or_do_not(mode, each):
    """Steps of a fixed duration end with images of both imagers; the target has the priority 2."""
    rewarder = RSOImageReward(lambda record, target: target.priority, quality_threshold=0.0, multi_imager_credit=mode)
    env = environment(imagers=2, kind=Fixed, rewarder=rewarder)
    env.reset()
    play(env, image_target(1), image_target(1))
    assert env.scenario.pending[:, 1].tolist() == [2, 2]
    assert env.rewarder.last_reward_components["acquisition"].tolist() == [[each, each]] * 2


@pytest.mark.compiled
def test_later_images_of_a_service_earn_nothing():
    rewarder = RSOImageReward(lambda record, target: target.priority, quality_threshold=0.0, multi_imager_credit="shared")
    env = environment(imagers=2, rewarder=rewarder, block_pending_targets=False)
    env.reset()
    paid = []
    while int(env.scenario.pending[0, 1]) < 3:
        play(env, image_target(1), image_target(1))
        paid.append(env.rewarder.last_reward_components["acquisition"][0].sum().item())
    assert sum(paid) == 2.0
    assert paid[-1] == 0.0


def fifo(products, gone):
    """Products of a partition, oldest first, after data have gone; and those that are complete."""
    done = []
    for product in products:
        bits = min(product["left"], gone)
        product["left"] -= bits
        gone -= bits
        if product["left"] <= 1e-6:
            done.append(product)
    return [product for product in products if product not in done], done


@pytest.mark.compiled
def test_products_are_delivered_in_the_order_of_their_capture():
    """Against lists, with random images and downlinks of several imagers."""
    env = environment(imagers=2)
    env.reset()
    rewarder, numbers = env.rewarder, random.Random(3)
    known = [[[[] for _ in range(4)] for _ in range(2)] for _ in range(2)]
    for step in range(60):
        there = torch.tensor([[numbers.random() < 0.5 for _ in range(2)] for _ in range(2)])
        target = torch.tensor([[numbers.randrange(4) for _ in range(2)] for _ in range(2)])
        size = torch.tensor([[float(numbers.randrange(1, 9)) for _ in range(2)] for _ in range(2)], dtype=torch.float64)
        time = torch.full((2, 2), float(step), dtype=torch.float64)
        imager = torch.arange(2).expand(2, 2)
        rewarder._keep(_Images(there, target, imager, time, time, time, torch.full_like(target, NONE)), size)
        gone = torch.zeros(2, 2, 4, dtype=torch.float64)
        wanted = set()
        for e in range(2):
            for a in range(2):
                if there[e, a]:
                    known[e][a][int(target[e, a])].append({"left": float(size[e, a]), "time": float(step)})
                for g in range(4):
                    held = sum(product["left"] for product in known[e][a][g])
                    bits = float(numbers.randrange(0, int(held) + 1)) if numbers.random() < 0.6 else 0.0
                    gone[e, a, g] = bits
                    known[e][a][g], done = fifo(known[e][a][g], bits)
                    wanted |= {(e, a, g, product["time"]) for product in done}
        found = rewarder._deliver(gone)
        rows = torch.nonzero(found.there).tolist()
        assert {(e, int(found.imager[e, k]), int(found.target[e, k]), float(found.time[e, k])) for e, k in rows} == wanted
        left = rewarder.memory["rso_product_left"].where(rewarder.memory["rso_product_target"] != NONE, 0.0).sum(1)
        for e in range(2):
            for a in range(2):
                assert left[e, a].item() == sum(product["left"] for part in known[e][a] for product in part)


@pytest.mark.compiled
def test_priorities_of_rewards_are_those_before_the_changes_of_the_step():
    events = (RSOPriorityEvent(1.0, (("object 1", 50.0),)),)
    rewarder = RSOImageReward(lambda record, target: target.priority, quality_threshold=0.0)
    env = environment(catalog=catalog(priority_events=events), rewarder=rewarder)
    env.reset()
    play(env, FIRST)
    assert env.rewarder.last_reward_components["acquisition"].flatten().tolist() == [2.0, 2.0]
    assert env.scenario.priority[0, 1].item() == 50.0
