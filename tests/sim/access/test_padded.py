import math

import pytest
import torch

from bsk_torch.sim.access.windows.padded import tabulate

INF = math.inf


def times(*values: float) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float64)


def test_events_are_sorted_into_rows():
    row, place = torch.tensor([2, 0, 2, 0, 2]), torch.tensor([5, 6, 7, 8, 9])
    time, where, length = tabulate(row, times(3.0, 8.0, 1.0, 4.0, 2.0), 4, place, times(30.0, 80.0, 10.0, 40.0, 20.0))
    assert time.tolist() == [[4.0, 8.0, INF], [INF] * 3, [1.0, 2.0, 3.0], [INF] * 3]
    assert where.tolist() == [[8, 6, 0], [0] * 3, [7, 9, 5], [0] * 3]
    assert length.tolist() == [[40.0, 80.0, INF], [INF] * 3, [10.0, 20.0, 30.0], [INF] * 3]
    assert where.dtype == torch.int64
    row, time = torch.randint(0, 20, (500,)), torch.rand(500, dtype=torch.float64)
    table, index = tabulate(row, time, 20, torch.arange(500))
    assert table.shape[1] == torch.bincount(row).max()
    for k in range(20):
        expected = sorted(time[row == k].tolist())
        assert table[k].tolist() == expected + [INF] * (table.shape[1] - len(expected))
        assert torch.equal(time[index[k, : len(expected)]], table[k, : len(expected)])


@pytest.mark.parametrize("n", [0, 1, 3])
def test_without_events_there_is_one_column(n):
    none = torch.zeros(0, dtype=torch.int64)
    time, place = tabulate(none, times(), n, none)
    assert (time.tolist(), place.tolist()) == ([[INF]] * n, [[0]] * n)
