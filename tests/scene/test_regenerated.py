"""Targets that a subclass makes environment by environment, in bsk_rl's ``regenerate_targets``."""

import logging

import numpy as np
import pytest
import torch

from bsk_torch import rand, scene
from bsk_torch.scene.targets import Target
from bsk_torch.sim import hooks
from tests.support.refusals import check_refusals, refusal

from .conftest import key, rows_of


class CloudTargets(scene.UniformTargets):
    """As in bsk_rl's cloud example."""

    mu_data = 0.6740208166434426

    def regenerate_targets(self) -> None:
        super().regenerate_targets()
        for target in self.targets:
            target.true_cloud_cover = np.clip(np.random.uniform(0.0, self.mu_data * 2), 0.0, 1.0)
            target.direction = np.random.normal(size=2)
            target.region = "north" if target.r_LP_P[2] > 0.0 else "south"


class Three(scene.UniformTargets):
    """Makes all of its targets."""

    def regenerate_targets(self):
        self.targets = [Target(f"site-{k}", [7e6, 0.0, k], self.priority_distribution()) for k in range(3)]


def test_attributes_that_are_numbers_become_drawn_values():
    values = CloudTargets((2, 6)).draw(key(3))
    assert values["target_true_cloud_cover"].shape == values["target_exists"].shape == (3, 5)
    assert values["target_direction"].shape == (3, 5, 2)
    assert set(values) == {f"target_{n}" for n in ("exists", "r_LP_P", "priority", "true_cloud_cover", "direction", "key")}
    cover = values["target_true_cloud_cover"][values["target_exists"].bool()]
    assert ((cover > 0.0) & (cover <= 1.0)).all()
    assert len(cover.unique()) > 3


def test_targets_of_hooks_are_those_of_the_base_class_and_more(begin):
    mine, plain = CloudTargets((2, 6)).draw(key(4)), scene.UniformTargets((2, 6)).draw(key(4))
    exists = plain["target_exists"].bool()
    assert torch.equal(mine["target_exists"].bool(), exists)
    for name in ("target_r_LP_P", "target_priority"):
        assert torch.equal(mine[name][exists], plain[name][exists])
    scenario = begin(Three(1, rand.Uniform(1.0, 2.0)), 2)
    assert scenario.most_targets == 3
    assert (scenario.priority >= 1.0).all()
    assert (len(scenario.priority.unique()), scenario.names(0)) == (6, ["site-0", "site-1", "site-2"])


def test_draws_depend_on_the_key_alone():
    scenario, whole = CloudTargets(4), key(5)
    np.random.seed(1)
    before = np.random.get_state()[1].copy()
    all_at_once = scenario.draw(whole)
    assert (np.random.get_state()[1] == before).all()  # the user's stream is left alone
    some = CloudTargets(4).draw(rows_of(whole, [3, 1]))
    for name, value in all_at_once.items():
        assert torch.equal(value[[3, 1]], some[name]), name
    other = CloudTargets(4).draw(key(5, episode=1))["target_direction"]
    assert not (other == all_at_once["target_direction"]).any()


def test_targets_are_made_again_as_they_were(begin):
    """After a restored state, when the objects are asked for outside of a draw; functions of priorities draw the same, too."""
    scenario = begin(CloudTargets(4, np.random.rand), 2)
    scenario.__dict__.pop("_made")
    for row in range(2):
        again = scenario.target_objects(row)
        assert [target.priority for target in again] == scenario.priority[row].tolist()
        assert [target.true_cloud_cover for target in again] == scenario.target_attribute("true_cloud_cover")[row].tolist()


def test_objects_are_those_that_the_hook_made(begin):
    scenario = begin(CloudTargets(4), 2)
    targets = scenario.target_objects(1)
    assert [target.region in ("north", "south") for target in targets] == [True] * 4
    assert scenario.target_objects(1)[0] is targets[0]
    assert torch.equal(
        scenario.target_attribute("true_cloud_cover")[1], torch.tensor([t.true_cloud_cover for t in targets]).double()
    )
    assert scenario.names(1) == [target.name for target in targets]
    index = torch.tensor([[2, 0], [1, 1]])
    assert torch.equal(scenario.look_up("priority", index), scenario.priority.gather(1, index))
    with pytest.raises(AttributeError, match=r"have no attribute 'cloud_cover', .* did you mean 'true_cloud_cover'"):
        scenario.target_attribute("cloud_cover")


def test_objects_of_targets_that_are_drawn_in_batches(begin):
    scenario = begin(scene.CloudyTargets(scene.UniformTargets((1, 5))), 3)
    for row in range(3):
        targets = scenario.target_objects(row)
        assert len(targets) == int(scenario.drawn("target_exists")[row].sum())
        assert [t.cloud_cover for t in targets] == scenario.cloud_cover[row, : len(targets)].tolist()
        assert (targets[0].r_LP_P == scenario.r_LP_P[row, 0].numpy()).all()


class Growing(scene.UniformTargets):
    def regenerate_targets(self):
        self.targets = [Target("one", [7e6, 0.0, 0.0], 1.0)] * (1 + int(self.regenerated_key.episode))


class Words(scene.UniformTargets):
    def regenerate_targets(self):
        self.targets = ["Boulder"]


class Uneven(scene.UniformTargets):
    def regenerate_targets(self):
        super().regenerate_targets()
        self.targets[0].cover = 0.5


def test_rejects_targets_that_cannot_be_used():
    growing = Growing(1)
    growing.draw(key(1))
    check_refusals(
        refusal(lambda: Words(1).draw(key(2)), TypeError, "Words.regenerate_targets()", "'Boulder'", "scene.Target"),
        refusal(lambda: Uneven(2).draw(key(2)), TypeError, "Target(tgt-1)", "'cover'"),
        refusal(lambda: growing.draw(key(1, episode=2)), ValueError, "3 targets", "environment 0", "n_targets=(1, 4)"),
        refusal(lambda: CloudTargets(2).regenerate_targets(), RuntimeError, "regenerate_targets()", "environments"),
    )


def test_one_note_says_that_it_is_slow(caplog):
    hooks._noted.clear()
    with caplog.at_level(logging.WARNING, logger="bsk_torch"):
        scenario = CloudTargets(2)
        scenario.draw(key(2))
        scenario.draw(key(2, episode=1))
    assert [r.message for r in caplog.records if "CloudTargets.regenerate_targets()" in r.message] == [caplog.records[0].message]
    assert "places(key)" in caplog.records[0].message
