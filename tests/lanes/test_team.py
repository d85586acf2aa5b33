"""Teams: their rows end in the tick in which the first of them stops, and are what they would be without the others."""

from __future__ import annotations

from functools import cache

import pytest
import torch

from bsk_torch.lanes.expr import ALWAYS, DOUBLE, SINGLE, TICK, Program
from bsk_torch.lanes.loop import Entry, Loop, Samples
from bsk_torch.lanes.team import SPARE, in_groups
from bsk_torch.sim.component import Field, Track

ISAS = ["", "avx2", "default"] if torch.backends.cpu.get_cpu_capability() in ("AVX2", "AVX512") else ["", "default"]
TEAMS = [1, 2, 3, 7, 12, 40]
LONGEST = 40
MODES = 3
PAIR = Track("pair", 3.0, (Field("x"), Field("y")), count=2, before=0)
NANOSECONDS = 400_000_000


@cache
def walkers(isa: str, mixed: bool = False, stops: bool = True) -> Loop:
    """Rows that do something of everything, and stop when their fuse is down to zero.

    What is not needed any more when a tick ends, what no tick reads, what comes as another kind than it is read as, planes that
    trade places, and what lasts as long as the call or a record, of one row or of all.
    """
    program = Program()
    kind = SINGLE if mixed else DOUBLE
    x, _, rounded, left, right, still, fuse = (program.input(("state", k), kind if k == 2 else DOUBLE, TICK) for k in range(7))
    gain, offset = (program.input(("shared", k), DOUBLE, ALWAYS) for k in range(2))
    push = program.input(("own", 0), kind, ALWAYS).to(torch.float64)
    on = program.input(("flag", 0), DOUBLE, ALWAYS) > 0.5
    before, _, after, _ = (program.input(("track", 1, k), DOUBLE, 1) for k in range(4))
    slope = (after - before) * (1.0 / 3.0)
    height = before + slope * program.input(("tau", 1), DOUBLE, TICK)
    fuse = fuse - 1.0
    (pushed,) = on.only(lambda: [x * (gain * gain) + push * push], [x - offset / gain])
    moved = pushed + height * 1e-3 + rounded.to(torch.float64) * 1e-2
    rounded = moved.sin() + still
    ticks = program.input(("ticks", "now"), DOUBLE, TICK)
    outputs = [moved, ticks, rounded, right, left, still, fuse, offset * 2.0, (fuse > 3.0)]
    with pytest.MonkeyPatch.context() as patch:
        if isa:
            patch.setenv("BSK_TORCH_ISA", isa)
        kernel = Loop("test of teams", program, outputs, (PAIR,), stop=fuse == 0.0 if stops else None, team=2)
        assert kernel.alone.width == (kernel.together.width if stops else kernel.alone.width)
        return kernel


class Teams:
    """Random teams."""

    def __init__(self, teams: int, team: int) -> None:
        """Fuses end before, with and after the number of ticks, or never; some teams have no tick to run."""
        n = teams * team
        self.team, self.n = team, n
        counts = torch.where(torch.rand(teams) < 0.15, 0, torch.randint(0, LONGEST, (teams,)))
        self.counts = counts.repeat_interleave(team)
        far = torch.randint(-3, LONGEST * max(1, team // 2), (n,))
        self.fuse = torch.where(torch.rand(n) < 0.1, self.counts, far).double()
        self.state = torch.rand(9, n).double()
        self.state[6] = self.fuse
        self.ticks = torch.randint(0, 20, (teams,)).repeat_interleave(team)
        self.mode = torch.randint(0, MODES, (n,))
        records = torch.randn(n, 20, 2, dtype=torch.float64)
        self.track = Samples(records, torch.rand(n, dtype=torch.float64))
        self.options = dict(
            shared=torch.tensor([0.99, 0.3], dtype=torch.float64),
            own=torch.rand(1, n).double(),
            flags=torch.tensor([[0.0, 1.0, 1.0]], dtype=torch.float64),
            nanoseconds=NANOSECONDS,
        )

    @property
    def ends(self) -> torch.Tensor:
        """How many ticks each row should run."""
        burnt = torch.where((self.fuse >= 1.0) & (self.fuse <= self.counts), self.fuse.long(), self.counts)
        return burnt.view(-1, self.team).amin(1).repeat_interleave(self.team)

    def after(self, kernel: Loop, counts: torch.Tensor, **options) -> tuple[torch.Tensor, torch.Tensor]:
        """State and numbers of ticks."""
        state = self.state.clone()
        options = dict(mode=self.mode, ticks=self.ticks) | self.options | options
        return state, kernel(state, counts, (self.track,), **options)

    def check(self, kernel: Loop, tolerance: float = 0.0, **options) -> None:
        """Rows are, bit for bit unless there is a tolerance, what they are if each runs by itself until its team's end."""
        state, ran = self.after(kernel, self.counts, team=self.team, **options)
        expected, alone = self.after(kernel, self.ends)
        assert torch.equal(ran, self.ends)
        assert torch.equal(alone, self.ends)
        if tolerance:
            torch.testing.assert_close(state, expected, rtol=tolerance, atol=tolerance)
        else:
            assert torch.equal(state.view(torch.int64), expected.view(torch.int64))


# -- ends -------------------------------------------------------------------------------------------------------------------


@pytest.mark.compiled
@pytest.mark.parametrize("team", TEAMS)
@pytest.mark.parametrize("mixed", [False, True], ids=["double", "mixed"])
@pytest.mark.parametrize("isa", ISAS)
def test_rows_of_a_team_end_with_the_first_that_stops(isa, mixed, team):
    """In plain C++, the compiler does not fuse the same products with sums in both libraries: a rounding in a few ticks."""
    tolerance = 0.0 if isa != "default" else 1e-5 if mixed else 1e-12
    for _ in range(30):
        Teams(int(torch.randint(1, 60, ())), team).check(walkers(isa, mixed), tolerance)


@pytest.mark.compiled
@pytest.mark.parametrize("team", TEAMS)
def test_without_modes(team):
    teams = Teams(20, team)
    teams.mode[:] = 0
    expected, _ = teams.after(walkers(""), teams.ends)
    state, ran = teams.after(walkers(""), teams.counts, team=team)
    assert torch.equal(ran, teams.ends)
    assert torch.equal(state, expected)


@pytest.mark.compiled
@pytest.mark.parametrize("team", TEAMS)
def test_several_threads(team):
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        for _ in range(5):
            Teams(300, team).check(walkers(""))
    finally:
        torch.set_num_threads(before)


@pytest.mark.compiled
@pytest.mark.parametrize("team", TEAMS)
def test_the_expected_order_changes_nothing(team):
    for teams in (1, 5, 70):
        rows = Teams(teams, team)
        for order in (rows.ends, torch.randint(0, LONGEST, (rows.n,)), torch.zeros(rows.n, dtype=torch.int64)):
            rows.check(walkers(""), order=order)


@pytest.mark.compiled
@pytest.mark.parametrize("last", [False, True])
@pytest.mark.parametrize("tick", [1, 2, 9, 10])
def test_a_team_may_stop_in_its_first_and_in_its_last_tick(tick, last):
    """Whichever row stops, in whichever block."""
    teams = Teams(3, 40)
    teams.counts[:] = 10
    teams.fuse[:] = teams.state[6] = 99.0
    teams.fuse[-1 if last else 40] = teams.state[6, -1 if last else 40] = tick
    assert teams.ends.view(3, 40)[:, 0].tolist() == ([10, 10, tick] if last else [10, tick, 10])
    teams.check(walkers(""))


@pytest.mark.compiled
def test_several_rows_may_stop_at_once_and_one_after_another():
    teams = Teams(4, 12)
    teams.counts[:], teams.fuse[:] = 30, 99.0
    teams.fuse[[0, 5, 11]], teams.fuse[[12, 20]], teams.fuse[[24, 25]] = 7.0, 7.0, torch.tensor([8.0, 9.0]).double()
    teams.state[6] = teams.fuse
    assert teams.ends[::12].tolist() == [7, 7, 8, 30]
    teams.check(walkers(""))


@pytest.mark.compiled
def test_rows_without_time_are_untouched():
    """Bit for bit, even where they hold no numbers."""
    teams = Teams(30, 7)
    still = teams.counts == 0
    teams.state[0, still] = torch.nan
    state, _ = teams.after(walkers(""), teams.counts, team=7)
    assert still.any()
    assert torch.equal(state[:, still].view(torch.int64), teams.state[:, still].view(torch.int64))
    assert (state[0, ~still] != teams.state[0, ~still]).all()


@pytest.mark.compiled
def test_groups_end_with_their_last_team():
    """A bound of a million years costs nothing where all teams stop."""
    teams = Teams(20, 12)
    teams.counts[:], teams.state[6], teams.state[6, ::12] = 2**62, 30.0, 7.0
    _, ran = teams.after(walkers(""), teams.counts, team=12)
    assert (ran == 7).all()


@pytest.mark.compiled
def test_counts_are_not_changed():
    teams = Teams(20, 12)
    before = teams.counts.clone()
    teams.after(walkers(""), teams.counts, team=12)
    assert torch.equal(teams.counts, before)


@pytest.mark.compiled
def test_all_may_have_the_same_number_of_ticks():
    teams = Teams(20, 12)
    teams.counts[:] = 9
    state, ran = teams.after(walkers(""), teams.counts, team=12)
    again, alike = teams.after(walkers(""), 9, team=12)
    assert torch.equal(ran, alike)
    assert torch.equal(state, again)


@pytest.mark.compiled
def test_who_does_not_stop_has_no_team():
    teams, kernel = Teams(5, 12), walkers("", stops=False)
    state, ran = teams.after(kernel, teams.counts, team=12)
    expected, _ = teams.after(kernel, teams.counts)
    assert ran is teams.counts
    assert torch.equal(state, expected)
    assert "together" not in vars(kernel)
    with pytest.raises(ValueError, match="test of teams has no stop: its rows cannot end together"):
        _ = kernel.together


@pytest.mark.compiled
def test_no_team_and_no_row():
    teams = Teams(0, 12)
    _, ran = teams.after(walkers(""), teams.counts, team=12)
    assert len(ran) == 0


@pytest.mark.compiled
def test_libraries_are_built_when_they_are_needed(monkeypatch):
    built = []
    monkeypatch.setattr("bsk_torch.lanes.loop.Entry.of", lambda source, name, signature: built.append(name) or Entry(8, None))
    program = Program()
    x = program.input(("state", 0), DOUBLE, TICK)
    make = lambda **options: Loop("tick", program, [x + 1.0], (), stop=x > 3.0, **options)
    one, many = make(), make(team=5)
    assert built == ["tick", "tick of teams"]
    for kernel in (one, many, one, many):
        assert kernel.alone.width == kernel.together.width == 8
    assert sorted(built) == ["tick", "tick", "tick of teams", "tick of teams"]


# -- groups -----------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("width", [2, 4, 8, 16])
@pytest.mark.parametrize("team", [2, 3, 7, 12, 40, 100, 1001])
@pytest.mark.parametrize("teams", [1, 2, 9, 300])
def test_groups_hold_whole_teams(teams, team, width):
    counts = torch.randint(0, 9, (teams,)).repeat_interleave(team)
    groups = in_groups(counts, counts, torch.randint(0, 3, (teams * team,)), team, width)
    assert groups.rows.shape == groups.teams.shape == (groups.size[0], groups.size[1] * width)
    real = groups.teams < teams
    assert torch.equal(groups.rows[real].sort().values, torch.arange(teams * team))
    assert torch.equal(groups.rows[real] // team, groups.teams[real])
    assert torch.equal(groups.ends, torch.cat([counts[::team], torch.zeros(1, dtype=torch.int64)]))
    homes = [set(row.unique().tolist()) - {teams} for row in groups.teams]
    assert sum(len(home) for home in homes) == teams == len(set().union(*homes))
    if teams == 300:
        full = groups.teams[0]
        assert (full == teams).sum() <= SPARE * (full < teams).sum()


@pytest.mark.parametrize("team", [2, 3, 12, 64])
def test_groups_are_of_like_durations_and_blocks_of_like_modes(team):
    teams, width = 1000, 8
    counts = torch.randperm(teams).repeat_interleave(team)
    mode = torch.randint(0, MODES, (teams * team,))
    groups = in_groups(counts, counts, mode, team, width)
    real = groups.teams < teams
    ends = groups.ends[groups.teams]
    assert (torch.where(real, ends, 0).amax(1)[:-1] < torch.where(real, ends, teams).amin(1)[1:]).all()
    modes = torch.where(real, mode[groups.rows], 0)[:-1].view(-1, width)
    assert (modes.amin(1) == modes.amax(1)).float().mean() > 0.4


# -- refusals ---------------------------------------------------------------------------------------------------------------


@pytest.mark.compiled
def test_teams_that_do_not_fit_are_refused():
    teams = Teams(4, 6)
    with pytest.raises(ValueError, match="team=7 must divide the number of rows, 24"):
        teams.after(walkers(""), teams.counts, team=7)
    teams.counts[:] = 5
    teams.counts[14] = 3
    with pytest.raises(ValueError, match=r"counts of team 2 are \[3, 5\]; rows of a team must have the same number of ticks"):
        teams.after(walkers(""), teams.counts, team=6)


@pytest.mark.compiled
def test_teams_do_not_write():
    teams = Teams(4, 6)
    with pytest.raises(ValueError, match="written must be None where team=6"):
        teams.after(walkers(""), teams.counts, team=6, written=torch.zeros(24, LONGEST, 1, dtype=torch.float64))
