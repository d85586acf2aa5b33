"""Rules for imaging, on observations made by hand, and in the environments that they are for."""

import math

import pytest
import torch
from tensordict import TensorDict

import bsk_torch
from bsk_torch import obs
from bsk_torch.obs.base import ObservationBuilder
from bsk_torch.rl.evaluation.evaluate import evaluate
from bsk_torch.rl.rules.baselines import BASELINES
from bsk_torch.rl.rules.imaging import (
    FORESIGHT,
    SLEW,
    TOUR,
    ImagingRule,
    by_closing,
    by_discounted_priority,
    by_priority,
    by_tour,
)
from bsk_torch.rl.rules.targets import TargetReader, image_actions, read
from tests.support.refusals import check_refusals, refusal

# priority, position (3 columns), angle / rad, opening and closing / 300 s
TARGETS = [
    [0.5, 0.0, 0.0, 0.0, 0.1, -0.1, 0.1],  # 30 s left: about 18 s of slew
    [0.9, 0.0, 0.0, 0.0, 1.0, -0.1, 0.1],  # 30 s left: too far to turn to
    [0.8, 0.0, 0.0, 0.0, 0.1, 0.5, 1.0],  # opens in 150 s
    [0.8, 0.0, 0.0, 0.0, 0.1, 0.5, 1.0],  # padding, if there is a mask
]
ENTRIES = (
    dict(prop="priority"),
    dict(prop="r_LB_H", norm=800e3),
    dict(prop="target_angle"),
    dict(prop="opportunity_open", norm=300.0),
    dict(prop="opportunity_close", norm=300.0),
)
HOUSEKEEPING = ["action_charge", "action_downlink", "action_desat"]
IMAGES = [f"action_image_{k}" for k in range(4)]


def described(level, opens, as_set):
    """One observation as the environment gives it, [1], the description of its vector, and the entry that wrote it."""
    rows = torch.tensor([TARGETS])
    if as_set:
        seen = {"rows": rows, "mask": torch.tensor([[1.0, 1.0, 1.0, 0.0]])}
    else:
        names = [entry["prop"] + "_normd" * ("norm" in entry) for entry in ENTRIES]
        columns = dict(zip(names, [(0, 1), (1, 4), (4, 5), (5, 6), (6, 7)], strict=True))
        seen = {f"target_{k}": {name: rows[:, k, a:b].squeeze(-1) for name, (a, b) in columns.items()} for k in range(4)}
    values = {
        "sat_props": {"storage_level_fraction": torch.tensor([level])},
        "target": seen,
        "ground_station": {"ground_station_0": {"opportunity_open_normd": torch.tensor([opens])}},
    }
    entry = obs.OpportunityProperties(*ENTRIES, n_ahead_observe=4, as_set=as_set)
    return values, ObservationBuilder.describe(values), entry


def decide(worth, legal, *, nested=False, as_set=False, level=0.5, opens=1.0, actions=(*HOUSEKEEPING, *IMAGES)):
    """The action that a rule takes."""
    return ranked(worth, legal, nested, as_set, level, opens, actions)[0]


def ranked(worth, legal, nested=False, as_set=False, level=0.5, opens=1.0, actions=(*HOUSEKEEPING, *IMAGES)):
    """The action that a rule takes, and its ranking of the actions by name, without those that it does not rank."""
    values, description, entry = described(level, opens, as_set)
    first = len(actions) - len(IMAGES)
    rule = ImagingRule(TargetReader(entry, description), range(first, len(actions)), worth, description, list(actions))
    observation = TensorDict(values, [1]) if nested else ObservationBuilder.vector(values, torch.float32)
    mask = torch.tensor([[name in legal for name in actions]])
    action, ranking = rule.decide(observation, mask)
    return actions[int(action)], {
        name: value for name, value in zip(actions, ranking[0].tolist(), strict=True) if not math.isnan(value)
    }


FORMS = pytest.mark.parametrize(("nested", "as_set"), [(False, False), (False, True), (True, True)])
ALL = {*HOUSEKEEPING, *IMAGES}


@FORMS
@pytest.mark.parametrize(("worth", "expected"), [(by_priority, 1), (by_closing, 0), (by_discounted_priority, 0), (by_tour, 0)])
def test_rules_choose_what_they_are_named_after(nested, as_set, worth, expected):
    assert decide(worth, ALL, nested=nested, as_set=as_set) == f"action_image_{expected}"


@FORMS
@pytest.mark.parametrize(("worth", "expected"), [(by_priority, 2), (by_closing, 2), (by_discounted_priority, 2), (by_tour, 2)])
def test_rules_choose_among_legal_images_and_the_first_of_equals(nested, as_set, worth, expected):
    legal = {"action_charge", "action_image_2", "action_image_3"}
    assert decide(worth, legal, nested=nested, as_set=as_set) == f"action_image_{expected}"


@FORMS
def test_rules_do_what_the_shield_leaves(nested, as_set):
    assert decide(by_priority, {"action_desat"}, nested=nested, as_set=as_set) == "action_desat"


def test_targets_that_exist_are_ranked_and_imaged():
    assert decide(by_priority, {"action_charge", "action_image_3"}, nested=True, as_set=True) == "action_charge"
    legal = {"action_charge", "action_image_0", "action_image_2", "action_image_3"}
    action, ranking = ranked(by_priority, legal, as_set=True)
    assert action == "action_image_2"
    assert ranking == {"action_image_0": 0.5, "action_image_2": pytest.approx(0.8)}
    assert decide(by_priority, set(IMAGES), actions=tuple(IMAGES), level=0.99, opens=-0.1) == "action_image_1"
    values, description, entry = described(0.5, 1.0, True)
    seen = TargetReader(entry, description).read(TensorDict(values, [1]), "opportunity_close")
    torch.testing.assert_close(seen, torch.tensor([[30.0, 30.0, 300.0, 300.0]]))


@FORMS
@pytest.mark.parametrize(
    ("level", "opens", "legal", "expected"),
    [
        (0.99, -0.1, ALL, "action_downlink"),
        (0.5, -0.1, ALL, "action_image_1"),
        (0.99, 0.1, ALL, "action_image_1"),
        (0.99, -0.1, ALL - {"action_downlink"}, "action_image_1"),
    ],
)
def test_a_full_store_is_emptied_in_view_of_a_station(nested, as_set, level, opens, legal, expected):
    assert decide(by_priority, legal, nested=nested, as_set=as_set, level=level, opens=opens) == expected


def tours(rows):
    """Worth of each of the targets, row by row and tour by tour, as the rule is described."""

    def turn(one, other):
        a, b = one[1:4], other[1:4]
        cosine = sum(x * y for x, y in zip(a, b, strict=True)) / math.dist(a, [0] * 3) / math.dist(b, [0] * 3)
        return SLEW * math.sqrt(math.acos(min(cosine, 1.0)))

    def onward(k, left):
        """The best that follows target k, as of its image."""
        best = 0.0
        for j, row in enumerate(rows) if left else ():
            moment = max(arrivals[k] + turn(rows[k], row), row[5] * 300.0)
            if row[1:4] != rows[k][1:4] and moment <= row[6] * 300.0:
                best = max(best, math.exp((arrivals[k] - moment) / FORESIGHT) * (row[0] + onward(j, left - 1)))
        return best

    arrivals = [max(row[5] * 300.0, SLEW * math.sqrt(row[4])) for row in rows]
    return [
        math.exp(-arrival / FORESIGHT) * (row[0] + onward(k, TOUR)) if arrival <= row[6] * 300.0 else -arrival
        for k, (arrival, row) in enumerate(zip(arrivals, rows, strict=True))
    ]


def test_tours_are_worth_what_their_images_are():
    drawn = torch.rand(6, 8, 7, generator=torch.Generator().manual_seed(3), dtype=torch.float64)
    rows = drawn * torch.tensor([1.0, 2.0, 2.0, 1.0, 1.0, 0.4, 0.6]) - torch.tensor([0.0, 1.0, 1.0, -0.5, 0.0, 0.2, 0.0])
    rows[:, 7, 1:] = rows[:, 6, 1:]  # the same place
    entry = obs.OpportunityProperties(*ENTRIES, n_ahead_observe=8, as_set=True)
    see = TargetReader(entry, [f"target.rows[{k}]" for k in range(8 * 7)])
    mask = torch.ones(6, 8, dtype=torch.float64)
    mask[:, 5] = 0.0
    found = by_tour(see, TensorDict({"target": {"rows": rows, "mask": mask}}, [6]))
    there = [k for k in range(8) if k != 5]
    expected = torch.tensor([tours([row[k] for k in there]) for row in rows.tolist()], dtype=torch.float64)
    torch.testing.assert_close(found[:, there], expected)
    assert bool((expected < 0.0).any())
    assert bool((expected > rows[:, there, 0]).any())


@pytest.mark.compiled
@pytest.mark.parametrize("preset", ["AEOS-v1", "AEOSPower-v1"])
def test_rules_act_the_same_on_vectors_and_sets(preset):
    options = {"num_envs": 16, "seed": 0, "n_targets": 200}
    vector, nested = (bsk_torch.make(preset, as_set=as_set, **options) for as_set in (False, True))
    one, other = vector.reset(), nested.reset()
    for name in ("greedy", "nearest", "hasty", "farsighted"):
        actions = BASELINES[name](vector, 0)(one)["action"]
        assert torch.equal(actions, BASELINES[name](nested, 0)(other)["action"])
        assert len(set(actions.tolist())) > (name != "nearest")


@pytest.mark.compiled
def test_rules_earn_in_the_order_that_is_expected():
    env = bsk_torch.make("AEOS-v1", num_envs=32, seed=0, n_targets=3000, time_limit=1500.0)
    # recorded: 2.3, 7.4, 14.9, 20.8 and 21.0 with seed 3
    results = [evaluate(BASELINES[name](env, 0), env, seed=3) for name in ("random", "greedy", "nearest", "hasty", "farsighted")]
    means = [result.mean_return.mean for result in results]
    assert means == sorted(means)
    assert all(float(result.counts["imaged"].double().mean()) > 1.0 for result in results)


def test_rejects_what_is_not_observed():
    values, description, entry = described(0.5, 1.0, False)
    seen = ObservationBuilder.vector(values, torch.float32)
    env = bsk_torch.make("NadirScan-v1", num_envs=1, backend="eager")
    several = obs.OpportunityProperties(dict(fn=by_priority), n_ahead_observe=2, as_set=True)
    columns = lambda: TargetReader(several, [f"target.rows[{k}]" for k in range(4)])
    angle = lambda: TargetReader(entry, description).read(seen, "target_angle_rate")
    level, rules = "sat_props.storage_level", ("greedy", "nearest", "hasty", "farsighted")
    check_refusals(
        refusal(angle, KeyError, "'target_angle_rate'", "'target_angle'"),
        refusal(lambda: read(seen, description, level), KeyError, level),
        *(refusal(lambda name=name: BASELINES[name](env, 0), ValueError, "Scanner1", "targets") for name in rules),
        refusal(lambda: image_actions(env), ValueError, "Scanner1", "targets", "action_nadir_scan"),
        refusal(columns, ValueError, "'target'", "2 columns", 1),
    )
