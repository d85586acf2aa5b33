"""What episodes remember is set back by resets, row by row."""

from __future__ import annotations

import pytest
import torch

from bsk_torch.sim.memory import Memory

CPU = torch.device("cpu")


@pytest.fixture
def memory() -> Memory:
    """Of four environments: what was commanded last, how often three places have been imaged, and whether anything was."""
    made = Memory(4, CPU)
    made.add("target", -1)
    made.add("images", 0, 3)
    made.add("seen", False, dtype=torch.bool)
    made.add("value", 0.5, 2, 2, dtype=torch.float64)
    return made


def test_names_start_with_their_initial_values(memory):
    assert list(memory) == ["target", "images", "seen", "value"]
    assert torch.equal(memory["target"], torch.full((4,), -1))
    assert torch.equal(memory["images"], torch.zeros(4, 3, dtype=torch.int64))
    assert torch.equal(memory["seen"], torch.zeros(4, dtype=torch.bool))
    assert torch.equal(memory["value"], torch.full((4, 2, 2), 0.5, dtype=torch.float64))


def test_a_name_is_taken_once(memory):
    with pytest.raises(ValueError, match=r"name='seen' is already remembered; known are \['images', 'seen', 'target', 'value'\]"):
        memory.add("seen", 0)
    assert memory["seen"].dtype == torch.bool


def test_what_is_stored_keeps_its_type(memory):
    memory["target"] = torch.tensor([3.0, 2.0, 1.0, 0.0])
    memory["seen"] = torch.tensor([0, 1, 0, 1])
    assert torch.equal(memory["target"], torch.tensor([3, 2, 1, 0]))
    assert torch.equal(memory["seen"], torch.tensor([False, True, False, True]))


def test_names_that_are_not_remembered(memory):
    with pytest.raises(KeyError):
        memory["targets"]
    with pytest.raises(KeyError):
        memory["targets"] = torch.zeros(4)
    assert "targets" not in list(memory)


def test_resets_set_all_names_back_in_their_rows(memory):
    memory["target"] = torch.arange(4)
    memory["images"] = torch.arange(12).view(4, 3)
    memory["value"] = torch.ones(4, 2, 2)
    memory.reset(torch.tensor([2, 0]))
    assert memory["target"].tolist() == [-1, 1, -1, 3]
    assert memory["images"].tolist() == [[0, 0, 0], [3, 4, 5], [0, 0, 0], [9, 10, 11]]
    assert memory["value"][:, 0, 1].tolist() == [0.5, 1.0, 0.5, 1.0]
    memory.reset(torch.tensor([], dtype=torch.int64))
    assert memory["target"].tolist() == [-1, 1, -1, 3]


def test_restored_rows(memory):
    """Values of the other rows stay, whatever has been saved of them."""
    memory["images"] = torch.arange(12).view(4, 3)
    saved = memory["images"]
    memory["images"] = torch.zeros(4, 3)
    memory.restore("images", torch.tensor([3, 1]), saved)
    assert memory["images"].tolist() == [[0, 0, 0], [3, 4, 5], [0, 0, 0], [9, 10, 11]]
    assert memory["images"].dtype == torch.int64


def test_what_has_been_handed_out_does_not_change(memory):
    """An observation made of it stays as it was."""
    images = memory["images"]
    before = images.clone()
    memory["images"] = torch.ones(4, 3)
    ones = memory["images"]
    memory.reset(torch.arange(4))
    memory.restore("images", torch.tensor([0]), torch.full((4, 3), 7))
    assert torch.equal(images, before)
    assert torch.equal(ones, torch.ones(4, 3, dtype=torch.int64))


def test_every_change_is_a_new_version(memory):
    """Queries that depend on the memory ask again after each."""
    versions = [memory.version]
    for change in (
        lambda: memory.__setitem__("target", torch.zeros(4)),
        memory.touch,
        lambda: memory.reset(torch.tensor([1])),
        lambda: memory.restore("seen", torch.tensor([1]), torch.ones(4, dtype=torch.bool)),
    ):
        change()
        versions.append(memory.version)
    assert versions == sorted(set(versions))
    memory["seen"], list(memory)
    assert memory.version == versions[-1]
