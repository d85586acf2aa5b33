from __future__ import annotations

import math

import pytest
import torch

from bsk_torch.sim.run import FEWEST_ROWS, SHORTEST_CUT, loops, pulse_reaches, run

SECOND = 1_000_000_000


def lengths(n: int, longest: int) -> list[int]:
    return sorted(torch.randint(0, longest + 1, (n,)).tolist(), reverse=True)


CASES = [
    [1],
    [0, 0],
    [60] * 5,
    [180, 120, 60, 60, 0],
    [181, 180, 179, 61, 60, 59, 11, 10, 9, 1],
    [500, 3],
    [7, 6, 5, 4, 3, 2, 1],
]


def pieces(counts: list[int], longest: int) -> list[tuple[int, int, int]]:
    """Loops of all segments of a step, as the run goes through them: only with the rows that are running."""
    found = []
    for first in range(0, counts[0], longest):
        running = [count for count in counts if count > first]
        found += loops(running, first, longest)
    return found


@pytest.mark.parametrize("longest", [1, 7, 60])
@pytest.mark.parametrize("counts", CASES, ids=str)
def test_every_tick_is_covered_once(counts, longest):
    covered = [0] * len(counts)
    previous_end, previous_rows = 0, len(counts)
    for start, end, rows in pieces(counts, longest):
        assert start == previous_end
        assert start < end
        assert start // longest == (end - 1) // longest  # inside one segment
        assert 0 < rows <= previous_rows
        assert all(count <= start for count in counts[rows:])  # rows left out have nothing left
        assert counts[rows - 1] > start  # rows kept have
        for row in range(rows):
            covered[row] += max(0, min(end, counts[row]) - start)
        previous_end, previous_rows = end, rows
    assert covered == counts
    assert previous_end == max(counts)


@pytest.mark.parametrize("n", [1, 3, 200])
def test_many_random_lengths(n):
    counts = lengths(n, 300)
    found = pieces(counts, 60)
    assert sum(end - start for start, end, _ in found) == counts[0]
    # loops are no shorter than SHORTEST_CUT but at the end of a segment: few loops even for many different ends
    assert all(end - start >= SHORTEST_CUT for start, end, _ in found if end % 60 and end != counts[0])
    assert len(found) <= 5 * (60 // SHORTEST_CUT)


class Counter:
    """A step that counts its calls in every row, and what the segment maker was asked for."""

    def __init__(self, n: int) -> None:
        self.asked, self.sizes, self.clocks = [], [], []
        self.ticks = torch.zeros(n, dtype=torch.int64)

    def make(self, rows, start):
        self.asked.append((rows.tolist(), start))
        return torch.zeros(1, len(rows)), rows.double().unsqueeze(0), self.ticks[rows]

    def step(self, state, shared, own, flags, segment, clock, row):
        assert state.shape[1] == own.shape[1] == flags.shape[1] == segment.shape[1] == row.shape[1] >= FEWEST_ROWS
        assert torch.equal(own[0], segment[0])  # parameters and segments belong to the same rows
        self.sizes.append(state.shape[1])
        self.clocks.append(clock.clone())
        changed = torch.stack([state[0] + 1, state[1] * 1.0000001 + clock[0], state[2]])
        return torch.where(clock[1] <= row[0], changed, state)


def fly(ticks: list[int], h: float = 1.0):
    n = len(ticks)
    counter = Counter(n)
    state = torch.stack([torch.zeros(n), torch.randn(n), torch.arange(n)]).double()
    own = torch.arange(n).double().unsqueeze(0)
    args = counter.step, state, torch.zeros(0, 1), own, counter.make, torch.tensor(ticks), round(h * SECOND)
    before = state.clone()
    result = run(*args)
    assert torch.equal(state, before)  # the argument is not modified
    return counter, state, result


@pytest.mark.parametrize("ticks", [[3], [0], [5, 0, 200, 61, 60, 1], [0, 0, 0], [120, 120]], ids=str)
def test_every_row_runs_its_ticks_and_stays_in_its_place(ticks):
    _, state, result = fly(ticks)
    assert result[0].tolist() == ticks
    assert result[2].tolist() == state[2].tolist()


def test_rows_without_time_are_untouched():
    _, state, result = fly([10, 0, 35, 0])
    assert torch.equal(result[:, [1, 3]], state[:, [1, 3]])
    assert (result[1, [0, 2]] != state[1, [0, 2]]).all()


def test_rows_are_bit_identical_to_rows_that_ran_alone():
    """What a row sees never depends on when others end."""
    ticks = [60, 13, 1, 47, 0, 200, 61]
    torch.manual_seed(5)
    _, state, together = fly(ticks)
    for row, count in enumerate(ticks):
        value = state[1, row]
        for k in range(count):
            value = value * 1.0000001 + float(k % 60 + 1)  # the clock restarts with every segment of a minute
        assert torch.equal(together[1, row], value)


def test_work_shrinks_with_the_rows():
    counter, *_ = fly([180] + [60] * 9)
    assert counter.sizes == [10] * 60 + [FEWEST_ROWS] * 120


def test_segments_start_every_minute_with_the_rows_that_run():
    counter, *_ = fly([150, 20, 320], h=0.5)
    assert counter.asked == [([2, 0, 1], 0.0), ([2, 0], 60.0), ([2, 2], 120.0)]


@pytest.mark.parametrize(("h", "longest"), [(0.1, 600), (1.0, 60), (7.0, 8), (60.0, 1)])
def test_segments_last_a_minute_at_most(h, longest):
    counter, *_ = fly([1300], h)
    starts = [start for _, start in counter.asked]
    assert starts == pytest.approx([k * longest * h for k in range(len(starts))])
    assert counter.clocks[0].tolist() == pytest.approx([h, 1.0], rel=1e-15)


MISSED = (14, 28, 57, 114, 228, 456, 912, 1825, 3650, 7301, 14602, 29205)
"""Ticks of 1 s at whose pulses Basilisk's rounding puts the end before the stage (measured on Basilisk)."""


def test_missed_pulses_of_one_second():
    """A pulse written at tick t is latched at t + 1 and compared with the stage at t + 1."""
    reaches = pulse_reaches(torch.tensor([0]), 30_000, SECOND)[:, 0]
    latched = torch.nonzero(reaches == 0.0).squeeze(-1) + 1
    assert (latched - 1).tolist() == list(MISSED)


def test_missed_pulses_of_a_tenth_of_a_second():
    """22 % of the first 2000 s; the share goes up and down with the exponent of the clock."""
    reaches = pulse_reaches(torch.tensor([0]), 20_000, SECOND // 10)
    assert 1.0 - reaches.mean().item() == pytest.approx(0.22, abs=0.005)


def test_missed_pulses_follow_the_clock_of_each_row():
    whole = pulse_reaches(torch.tensor([0]), 300, SECOND)[:, 0]
    rows = pulse_reaches(torch.tensor([0, 13, 100]), 50, SECOND)
    assert rows.shape == (50, 3)
    for column, first in enumerate((0, 13, 100)):
        assert torch.equal(rows[:, column], whole[first : first + 50])


def test_missed_pulses_by_python_floats():
    """The comparison in plain doubles, for ticks of half and of two seconds."""
    for h_ns in (SECOND // 2, 2 * SECOND):
        reaches = pulse_reaches(torch.tensor([0]), 5000, h_ns)[:, 0].tolist()
        expected = [h_ns * 1e-9 + (k * h_ns) * 1e-9 >= ((k + 1) * h_ns) * 1e-9 for k in range(5000)]
        assert reaches == expected
        assert math.isclose(sum(reaches), 5000, rel_tol=0.01)
        assert not all(expected)
