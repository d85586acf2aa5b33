import numpy as np
import pytest
import torch

from bsk_torch import rand, scene

from .conftest import key, rows_of

X, Y, Z = [6.4e6, 0, 0], [0, 6.4e6, 0], [0, 0, -6.4e6]


@pytest.mark.parametrize("make", [list, np.array, torch.tensor, lambda rows: [torch.tensor(row) for row in rows]])
def test_the_same_for_all(begin, make):
    scenario = begin(scene.Targets(make([X, Y]), priority=[1, 2], names=["Quito", "Dhaka"]), 3)
    assert (scenario.r_LP_P.tolist(), scenario.priority.tolist()) == ([[X, Y]] * 3, [[1, 2]] * 3)
    assert scenario.available.all()
    assert scenario.target_names == ["Quito", "Dhaka"]
    assert all(len(value) == 1 for value in scenario.draw(key(5)).values())


def test_lists_are_copied_and_callables_asked_for_each_target():
    given = torch.tensor([X, Y]).double()
    scenario = scene.Targets(given)
    given.zero_()
    assert scenario.draw(key())["target_r_LP_P"].tolist() == [[X, Y]]
    calls = iter(range(10))
    scenario = scene.Targets([X, Y], lambda: next(calls))
    assert scenario.calls_user
    assert scenario.draw(key(2))["target_priority"].tolist() == [[0, 1], [2, 3]]


def test_each_environment_its_own(begin):
    places = torch.tensor([[X, Y], [Y, Z]]).double()
    scenario = begin(scene.Targets(rand.per_env(places), priority=rand.per_env([[1, 2], [3, 4]])), 2)
    assert torch.equal(scenario.r_LP_P, places)
    assert (scenario.priority.tolist(), scenario.target_names) == ([[1, 2], [3, 4]], ["tgt-0", "tgt-1"])
    alone = scenario.draw(rows_of(key(2, episode=5), [1]))
    assert torch.equal(alone["target_r_LP_P"], places[1:])
    assert alone["target_priority"].tolist() == [[3, 4]]


def test_lists_and_priorities_of_each_environment(begin):
    scenario = begin(scene.Targets(rand.per_env([[Y], [X, Y, Z]]), priority=rand.per_env([[5], [1, 2, 3]])), 2)
    assert scenario.r_LP_P.tolist() == [[Y, Y, Y], [X, Y, Z]]
    assert scenario.available.tolist() == [[True, False, False], [True, True, True]]
    assert scenario.priority.tolist() == [[5, 0, 0], [1, 2, 3]]
    scenario = begin(scene.Targets([X, Y], rand.per_env([[1, 2], [3, 4]])), 2)
    assert (scenario.priority.tolist(), scenario.r_LP_P.tolist()) == ([[1, 2], [3, 4]], [[X, Y]] * 2)


def test_priorities_of_padding_are_zero_however_they_are_given(begin):
    places = rand.per_env([[Y], [X, Y, Z]])
    assert begin(scene.Targets(places), 2).priority.tolist() == [[1, 0, 0], [1, 1, 1]]
    assert begin(scene.Targets(places, [4, 5, 6]), 2).priority.tolist() == [[4, 0, 0], [4, 5, 6]]
    assert begin(scene.Targets(places, rand.per_env([2, 3])), 2).priority.tolist() == [[2, 0, 0], [3, 3, 3]]
    drawn = begin(scene.Targets(places, rand.Uniform(1, 2)), 2).priority
    assert (drawn[0, 1:].tolist(), len(set(drawn.flatten().tolist()))) == ([0, 0], 5)
