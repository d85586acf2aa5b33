"""Draws of copies, stored once per episode."""

import pytest
import torch

from bsk_torch.sim.draw_table import DrawTable

EPISODES, PLACES = 3, 5


@pytest.fixture
def drawn():
    table = DrawTable(EPISODES)
    table.declare("place", None, PLACES)
    table.declare("time", None)
    table.place[:] = torch.arange(EPISODES * PLACES, dtype=torch.float64).view(EPISODES, PLACES)
    table.time[:] = torch.tensor([10.0, 11.0, 12.0])
    return table


def room(rows):
    table = DrawTable(rows)
    table.declare("place", None, PLACES)
    table.declare("time", None)
    return table


def test_copies_of_few_episodes_store_draws_once_and_read_like_any_table(drawn):
    source = torch.tensor([2, 0, 2, 0, 2, 2, 0, 0])
    order = torch.tensor([7, 1, 0, 6, 5, 2, 3, 4])
    copies, place = room(8), torch.tensor([[1, 4]]).expand(8, 2)
    copies.copy_rows(order, drawn, source)
    of_row = torch.empty(8, dtype=torch.long).index_copy(0, order, source)
    assert len(copies.shared("place")[0]) == 2
    assert torch.equal(copies.look_up("place", place), drawn.place[of_row].gather(1, place))
    assert torch.equal(copies.of_envs("time", torch.tensor([3, 3, 0])), drawn.time[of_row[[3, 3, 0]]])
    assert len(copies.shared("place")[0]) == 2
    assert torch.equal(copies.place, drawn.place[of_row])
    assert torch.equal(copies["time"], drawn.time[of_row])


def test_copies_of_copies_and_of_single_rows(drawn):
    copies, again = room(8), room(8)
    copies.copy_rows(torch.arange(8), drawn, torch.tensor([2, 0, 2, 0, 2, 2, 0, 0]))
    again.copy_rows(torch.arange(8), copies, torch.tensor([0, 1, 0, 1, 0, 1, 0, 1]))
    assert len(again.shared("place")[0]) == 2
    again.copy_rows(torch.tensor([6]), drawn, torch.tensor([1]))
    assert torch.equal(again.time, torch.tensor([12.0, 10.0, 12.0, 10.0, 12.0, 10.0, 11.0, 10.0], dtype=torch.float64))
    assert torch.equal(again.place[6], drawn.place[1])


def test_copied_draws_are_stored_once_and_saved_for_each_episode(drawn):
    copies = room(8)
    copies.copy_rows(torch.arange(8), drawn, torch.zeros(8, dtype=torch.long))
    copies["time"][3] = -1.0
    assert (copies.time.tolist(), drawn.time[0]) == ([10.0] * 3 + [-1.0] + [10.0] * 4, 10.0)
    assert torch.equal(copies.place, drawn.place[:1].expand(8, PLACES))
    copies = room(8)
    copies.copy_rows(torch.arange(8), drawn, torch.ones(8, dtype=torch.long))
    saved = copies.to_tensordict()
    assert saved["place"].shape == (8, PLACES)
    assert torch.equal(copies.over(saved).time, torch.full((8,), 11.0, dtype=torch.float64))
