"""Declared tensors take part in resets, copies of rows, and saved states, and tensors that are not declared are refused."""

import pytest
import torch

import bsk_torch
from bsk_torch.constants import NANO
from bsk_torch.sim.state import StateTable, entries, widened
from tests.support.refusals import check_refusals, refusal


@pytest.fixture
def memory() -> StateTable:
    """Of four environments: the last target, images of three places, whether any was taken, and a matrix."""
    made = StateTable(4)
    made.declare("target", -1)
    made.declare("images", 0, 3)
    made.declare("taken_any", False, dtype=torch.bool)
    made.declare("value", 0.5, 2, 2, dtype=torch.float64)
    return made


def test_names_start_with_their_initial_values_and_keep_their_types(memory):
    assert list(memory) == ["target", "images", "taken_any", "value"]
    assert torch.equal(memory["target"], torch.full((4,), -1))
    assert torch.equal(memory["images"], torch.zeros(4, 3, dtype=torch.int64))
    assert torch.equal(memory["taken_any"], torch.zeros(4, dtype=torch.bool))
    assert torch.equal(memory["value"], torch.full((4, 2, 2), 0.5, dtype=torch.float64))
    memory["target"] = torch.tensor([3.0, 2.0, 1.0, 0.0])
    memory["taken_any"] = torch.tensor([0, 1, 0, 1])
    assert torch.equal(memory["target"], torch.tensor([3, 2, 1, 0]))
    assert torch.equal(memory["taken_any"], torch.tensor([False, True, False, True]))
    check_refusals(
        refusal(lambda: memory["targets"], KeyError), refusal(lambda: memory.__setitem__("targets", torch.zeros(4)), KeyError)
    )
    assert "targets" not in list(memory)


def test_rejects_names_and_shapes_that_are_not_declared(memory):
    known = "'images', 'taken_any', 'target'"
    check_refusals(
        refusal(lambda: memory.declare("taken_any", 0), ValueError, "name='taken_any'", known),
        refusal(lambda: memory.declare("version", 0), ValueError, "name='version'", known),
        refusal(lambda: memory.declare("rows", 0), ValueError, "name='rows'", known),
        refusal(lambda: memory.declare("reset", 0), ValueError, "name='reset'", known),
        refusal(lambda: memory.__setattr__("charge", torch.zeros(4)), AttributeError, "'charge'", "declare('charge', ...)"),
        refusal(lambda: memory.charge, AttributeError, "'charge'", known),
        refusal(lambda: memory.__setitem__("images", torch.zeros(4)), ValueError, "'images'", "[4, 3]", "[4]"),
    )


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


def test_rows_are_copied_from_tables_of_other_sizes_and_fields(memory):
    other = memory.taken(torch.tensor([3, 1, 0, 2, 2, 1]))
    other["images"], other["target"] = torch.arange(18).view(6, 3), torch.arange(6)
    memory.copy_rows(torch.tensor([0, 2, 3]), other, torch.tensor([5, 5, 1]))
    assert memory["images"].tolist() == [[15, 16, 17], [0, 0, 0], [15, 16, 17], [3, 4, 5]]
    assert memory["target"].tolist() == [5, -1, 5, 1]
    memory["images"], other = torch.ones(4, 3), StateTable(4)
    other.declare("target", -1)
    memory.copy_rows(torch.tensor([1, 2]), other, torch.tensor([0, 0]))
    assert memory["images"].sum(1).tolist() == [3, 0, 0, 3]


def nested(n: int) -> StateTable:
    """Episodes of two satellites each, with a table that grows, one of planes, and one that its owner writes."""
    root, part = StateTable(n), StateTable(n, 2)
    root.declare("returns", 0.0)
    part.declare("planes", None, 3, planes=True)
    part.declare("windows", float("inf"), 1, grows=True)
    part.declare("tail", None, 2)
    root.add("satellites", part)
    part.planes.copy_(torch.arange(6.0 * n).view(3, 2 * n))
    part.tail.copy_(torch.arange(4.0 * n).view(2 * n, 2))
    part.windows = torch.arange(2.0 * n * n).view(2 * n, n)
    root.returns = torch.arange(float(n)).double()
    return root


def test_saved_states_put_episodes_first_and_restore_any_rows_of_them():
    mine, saved = nested(3), nested(5).to_tensordict()
    assert saved["satellites", "planes"].shape == (5, 2, 3)
    assert saved["satellites", "windows"].shape == (5, 2, 5)
    before = mine.to_tensordict()
    for given in (saved, saved.to_dict()):
        mine.copy_rows(torch.tensor([2, 0]), mine.over(given), torch.tensor([4, 4]))
        after = mine.to_tensordict()
        for row, source in ((0, saved[4]), (2, saved[4])):
            assert (after[row] == source).all()
        assert torch.equal(after["satellites", "windows"][1, :, :3], before["satellites", "windows"][1])
        assert torch.isinf(after["satellites", "windows"][1, :, 3:]).all()
        assert torch.equal(after["satellites", "planes"][1], before["satellites", "planes"][1])


def test_rejects_saved_states_that_do_not_fit():
    table, saved = nested(4), nested(4).to_tensordict().to_dict()
    returns, single, satellites = saved["returns"], saved["returns"].float(), saved["satellites"]
    short = satellites | {"tail": satellites["tail"][..., :1]}
    check_refusals(
        refusal(lambda: table.over({"satellites": satellites}), KeyError, "['returns']", "[]"),
        refusal(lambda: table.over(saved | {"more": returns}), KeyError, "[]", "['more']"),
        refusal(lambda: table.over(saved | {"returns": single}), ValueError, "'returns'", "torch.float32", "torch.float64"),
        refusal(lambda: table.over(saved | {"returns": returns[:2]}), ValueError, "[2, 4]", "episodes"),
        refusal(lambda: table.over(saved | {"satellites": short}), ValueError, "'tail'", "[4, 2, 1]", "[N, 2, 2]"),
    )


def test_tables_and_growing_fields_are_widened():
    table = torch.zeros(2, 3)
    assert widened(table, 2, 1.0) is widened(table, 3, 1.0) is table
    assert widened(torch.tensor([[1, 2]]), 3, 0).tolist() == [[1, 2, 0]]
    assert widened(torch.zeros(1, 1, 2), 2, 5.0).tolist() == [[[0.0, 0.0], [5.0, 5.0]]]

    def written(rows: list[int], *new: list[float]) -> list[list[float]]:
        table = StateTable(2)
        table.declare("times", float("inf"), 2, grows=True)
        table.times.copy_(torch.tensor([[1.0, 2.0], [3.0, 4.0]]))
        table.write_rows("times", torch.tensor(rows), torch.tensor(new, dtype=torch.float64))
        return table.times.tolist()

    inf = float("inf")
    assert written([1], [9.0]) == [[1.0, 2.0], [9.0, inf]]  # what was there before is gone
    assert written([1], [7.0, 8.0, 9.0]) == [[1.0, 2.0, inf], [7.0, 8.0, 9.0]]
    assert written([1, 0], [5.0], [6.0]) == [[6.0, inf], [5.0, inf]]


def test_every_change_is_a_new_version_that_leaves_the_old_one(memory):
    """Queries that depend on the memory ask again after each."""
    versions = [memory.version]
    for change in (
        lambda: memory.__setitem__("target", torch.zeros(4)),
        memory.touch,
        lambda: memory.reset(torch.tensor([1])),
        lambda: memory.copy_rows(torch.tensor([1]), memory.taken(torch.tensor([0])), torch.tensor([0])),
    ):
        change()
        versions.append(memory.version)
    assert versions == sorted(set(versions))
    memory["taken_any"], list(memory)
    assert memory.version == versions[-1]
    # An observation made of it stays as it was.
    images = memory["images"]
    before = images.clone()
    memory["images"] = torch.ones(4, 3)
    ones = memory["images"]
    memory.reset(torch.arange(4))
    memory.copy_rows(torch.tensor([0]), memory.taken(torch.tensor([1])), torch.tensor([0]))
    assert torch.equal(images, before)
    assert torch.equal(ones, torch.ones(4, 3, dtype=torch.int64))


def test_the_time_follows_the_ticks_however_they_change():
    env = bsk_torch.make("NadirScan-v1", num_envs=3, seed=0, backend="eager", max_step_duration=5.0)
    env.reset()
    state = env.simulator.state

    def right():
        return torch.equal(state.sim_time, state.sim_time_ns.double() * NANO) and env.simulator.sim_time is state.sim_time

    assert right()
    state.ticks = state.ticks + 3
    assert right()
    state.ticks[0] += 5
    assert right()
    state.sim_time.mul_(2.0)
    assert right()
    with torch.inference_mode():
        state.ticks = state.ticks + 1
        assert torch.equal(state.sim_time, state.sim_time_ns.double() * NANO)
    assert torch.equal(state.sim_time, state.sim_time_ns.double() * NANO)
    env.reset()
    assert right()


@pytest.mark.parametrize("shape", [(5, 7), (5, 7, 3)])
def test_entries_of_a_table_are_those_of_two_indices(shape):
    table = torch.arange(5 * 7 * 3, dtype=torch.float64)[: torch.Size(shape).numel()].view(shape)
    row, column = torch.tensor([[4], [0], [3], [3]]), torch.randint(0, 7, (4, 6))
    assert torch.equal(entries(table, row, column), table[row, column])
    assert torch.equal(entries(table.flip(0), row[:, 0], column[:, 0]), table.flip(0)[row[:, 0], column[:, 0]])
    assert entries(table, row[:0], column[:0]).shape == (0, 6, *shape[2:])
