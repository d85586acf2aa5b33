"""Ticks are repeated until each row's own end, whichever other rows there are."""

import dataclasses
import math

import pytest
import torch

import bsk_torch
from bsk_torch.codegen.kernel import Samples
from bsk_torch.sim.component import Component, Field, vec
from bsk_torch.sim.environment.ephemeris import ephemeris_records
from bsk_torch.sim.orbit.grid import ARC_SEGMENT
from bsk_torch.sim.tick.loop import Tick
from bsk_torch.sim.tick.runners import Runners, TickLoop, make_runners
from bsk_torch.vec3 import Vec3, only
from tests.sim.run.runs import Start, start_of
from tests.support.refusals import check_refusals, refusal

CPU = torch.device("cpu")
H_NS = 500_000_000
HOURS = 3

COUNTS = [
    [3],
    [0],
    [5, 0, 200, 61, 60, 1],
    [0, 0, 0],
    [120, 120],
    [1] * 9,
    [500, 3],
    [7, 6, 5, 4, 3, 2, 1, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9],
]


def play(bus) -> None:
    """Something of everything: state, shared and own parameters, flags, the number of the tick, and the ephemeris."""
    bus.count = bus.count + 1.0
    bus.seen, bus.tau = bus.ticks, bus.ephemeris_tau
    push = Vec3(bus.own_rate, bus.sun_on, bus.ephemeris[0].earth_angle * 1e-6)
    bus.x = only(bus.control_on > 0.0, lambda: bus.x * bus.shared_gain + push * bus.h, bus.x - push)


def note(bus) -> None:
    """What a part of the world does."""
    bus.noted = bus.ephemeris[0].earth_angle + bus.ephemeris_tau


TOYS = (
    Component("eclipse", note, state=(Field("noted", exact=True),), at_start=True),
    Component(
        slot="toy",
        after="hub",
        update=play,
        state=(Field("count"), Field("seen", exact=True), Field("tau", exact=True), vec("x")),
        params=(Field("shared_gain"), Field("own_rate")),
    ),
)


FLAGS = ("control_on", "sun_on")


def toy_tick(dtype: torch.dtype = torch.float64, toys: tuple[Component, ...] = TOYS, stops: bool = False) -> Tick:
    return Tick(toys, {"shared_gain"}, H_NS, on_arc=False, dtype=dtype, opaque_field=False, stops=stops, flags=FLAGS)


def test_ticks_are_equal_where_they_compute_the_same():
    alike, one = toy_tick(), toy_tick()
    assert one.identity == alike.identity
    world, toy = TOYS
    assert one.identity == toy_tick(toys=(world, dataclasses.replace(toy, state=list(toy.state)))).identity
    others = [
        toy_tick(torch.float32),
        toy_tick(toys=(world,)),
        toy_tick(toys=(world, dataclasses.replace(toy, update=lambda bus: play(bus)))),
        toy_tick(toys=(dataclasses.replace(world, at_start=False), toy)),
        toy_tick(toys=(world, dataclasses.replace(toy, state=(*toy.state, Field("more"))))),
        Tick(TOYS, {"own_rate"}, H_NS, on_arc=False, dtype=torch.float64, opaque_field=False),
        Tick(TOYS, {"shared_gain"}, 2 * H_NS, on_arc=False, dtype=torch.float64, opaque_field=False),
    ]
    assert one.identity not in [other.identity for other in others]


@pytest.fixture(scope="module")
def runners(backend) -> Runners:
    return make_runners(toy_tick(), backend, CPU)


def flight(n: int) -> Start:
    """Random rows in different modes at different times of their episodes."""
    state = torch.randn(7, n, dtype=torch.float64)
    state[1] = 0.0
    shared, own = torch.full((1, 1), 0.999, dtype=torch.float64), torch.rand(1, n, dtype=torch.float64)
    flags = torch.zeros(len(FLAGS), 3, dtype=torch.float64)
    flags[FLAGS.index("control_on"), 1:], flags[FLAGS.index("sun_on"), 2] = 1.0, 1.0
    ticks = torch.randint(0, round((HOURS - 1) * ARC_SEGMENT * 1e9 / H_NS) - 500, (n,))
    sky = Samples(ephemeris_records(1e8 * torch.rand(n, dtype=torch.float64), HOURS), torch.zeros(n, dtype=torch.float64))
    return Start(state, shared, own, torch.randint(0, 3, (n,)), flags, ticks, (sky,), H_NS)


def part(whole: Start, rows: torch.Tensor) -> Start:
    """A flight of some rows."""
    tracks = tuple(Samples(track.table[rows], track.start[rows]) for track in whole.tracks)
    return dataclasses.replace(
        whole,
        state=whole.state[:, rows].contiguous(),
        own=whole.own[:, rows].contiguous(),
        mode=whole.mode[rows],
        ticks=whole.ticks[rows],
        tracks=tracks,
    )


def after(runners: Runners, start: Start, counts: torch.Tensor) -> torch.Tensor:
    """State of a flight after its run; the flight itself stays as it is."""
    copy = dataclasses.replace(start, state=start.state.clone())
    copy.run(runners.run, counts)
    return copy.state


@pytest.mark.parametrize("counts", COUNTS, ids=str)
def test_every_row_runs_its_ticks_and_stays_in_its_place(counts, runners):
    start, counts = flight(len(counts)), torch.tensor(counts)
    state = after(runners, start, counts)
    moved = counts > 0
    assert torch.equal(state[1], counts.double())
    last = (start.ticks + counts).double()
    assert torch.equal(state[2, moved], last[moved])
    # rounding of the clock
    torch.testing.assert_close(state[3, moved], (last * H_NS * 1e-9 % ARC_SEGMENT)[moved], rtol=0, atol=1e-11)


@pytest.mark.parametrize("counts", COUNTS, ids=str)
def test_rows_without_time_are_untouched(counts, runners):
    """Bit for bit, even where they hold no numbers."""
    start, counts = flight(len(counts)), torch.tensor(counts)
    still = counts == 0
    start.state[4, still] = math.nan
    state = after(runners, start, counts)
    assert torch.equal(state[:, still].view(torch.int64), start.state[:, still].view(torch.int64))
    assert (state[4, ~still] != start.state[4, ~still]).all()


@pytest.mark.parametrize("counts", COUNTS, ids=str)
def test_rows_are_bit_identical_to_rows_that_ran_alone(counts, runners):
    """What a row sees never depends on when others end."""
    start, counts = flight(len(counts)), torch.tensor(counts)
    together = after(runners, start, counts)
    assert together.shape[1] == len(counts) > 0
    for row in range(len(counts)):
        index = torch.tensor([row])
        assert torch.equal(after(runners, part(start, index), counts[index]), together[:, index])


def test_runs_in_parts_and_without_stops_are_whole_runs(runners):
    start, counts = flight(20), torch.randint(0, 150, (20,))
    first = (counts * torch.rand(20)).long()
    between = after(runners, start, first)
    later = dataclasses.replace(start, state=between, ticks=start.ticks + first)
    assert torch.equal(after(runners, later, counts - first), after(runners, start, counts))
    counts = torch.tensor([3, 0, 70])
    ones = torch.ones(3, dtype=torch.int64)
    assert torch.equal(flight(3).run(runners.run, counts), counts)
    assert torch.equal(flight(3).run(runners.first_tick, ones), ones)
    start, counts = flight(12), torch.randint(0, 50, (12,))
    copy = dataclasses.replace(start, state=start.state.clone(), lockstep=4)
    assert torch.equal(copy.run(runners.run, counts), counts)
    assert torch.equal(copy.state, after(runners, start, counts))


def test_a_tick_is_what_the_components_say(runners):
    """By hand, for every mode."""
    start = flight(6)
    start.mode[:] = torch.tensor([0, 1, 2, 0, 1, 2])
    state = after(runners, start, torch.ones(6, dtype=torch.int64))
    angle = start.tracks[0].table[torch.arange(6), ((start.ticks + 1) * H_NS * 1e-9 / ARC_SEGMENT).long(), 6]
    push = torch.stack([start.own[0], (start.mode == 2).double(), angle * 1e-6])
    expected = torch.where(start.mode > 0, start.state[4:] * 0.999 + push * 0.5, start.state[4:] - push)
    torch.testing.assert_close(state[4:], expected, rtol=1e-15, atol=1e-15)  # a rounding, or one less where fused


@pytest.mark.compiled
@pytest.mark.parametrize("dtype", [torch.float64, torch.float32])
def test_kernels_and_loops_agree(dtype):
    """Fused multiply-adds round once instead of twice, in every tick."""
    tick, start = toy_tick(dtype), flight(30)
    counts = torch.randint(0, 100, (30,))
    eager, compiled = (after(make_runners(tick, backend, CPU), start, counts) for backend in ("eager", "compiled"))
    assert torch.equal(eager[:4], compiled[:4])
    torch.testing.assert_close(eager, compiled, rtol=100 * torch.finfo(dtype).eps, atol=100 * torch.finfo(dtype).eps)
    assert (eager[1] == counts).all()


def test_waking_runs_the_world_only(runners):
    """Basilisk's tick at time zero: messages of the world, at the time of the flight, without a step."""
    start = flight(11)
    start.ticks[:] = 0
    expected = start.state.clone()
    expected[0] = start.tracks[0].table[:, 0, 6]
    start.run(runners.first_tick, torch.ones(11, dtype=torch.int64))
    assert torch.equal(start.state, expected)


def halt(bus) -> None:
    """End the run after a few ticks; what rows go on computing after their end asks for it again and again."""
    bus.stop = bus.count >= bus.own_rate * 200.0


STOPPING = (*TOYS, Component("halt", halt, stops=True, after="navigation"))


@pytest.fixture(scope="module")
def stopping(backend) -> Runners:
    return make_runners(toy_tick(toys=STOPPING, stops=True), backend, CPU)


def stops(start: Start, counts: torch.Tensor) -> torch.Tensor:
    """How many ticks each row runs: at least the one in which it sees that it should stop."""
    return torch.minimum(counts, (start.own[0] * 200.0).ceil().long().clamp(min=1))


@pytest.mark.parametrize("n", [1, 2, 3, 17, 64])
def test_rows_that_stop_are_as_if_they_had_been_to_run_that_long(n, stopping, runners):
    """Bit for bit, and whatever the order of the blocks; in blocks with rows that run no tick, too."""
    for longest in (20, 64, 65, 500):
        start, counts = flight(n), torch.randint(0, longest, (n,))
        expected = stops(start, counts)
        state = after(runners, start, expected)
        for order in (None, expected, torch.randint(0, longest, (n,))):
            copy = dataclasses.replace(start, state=start.state.clone(), expected_ticks=order)
            assert torch.equal(copy.run(stopping.run, counts), expected)
            assert torch.equal(copy.state, state)


@pytest.mark.parametrize("tick", [1, 64, 65, 129])
def test_rows_may_stop_in_their_first_and_in_their_last_tick(tick, stopping, runners):
    start, counts = flight(4), torch.tensor([tick, tick + 1, 300, 0])
    start.own[0] = tick / 200.0
    copy = dataclasses.replace(start, state=start.state.clone())
    assert copy.run(stopping.run, counts).tolist() == [tick, tick, tick, 0]
    assert torch.equal(copy.state, after(runners, start, torch.tensor([tick, tick, tick, 0])))


def test_stops_are_heeded_only_where_the_tick_stops(backend):
    start, counts = flight(5), torch.full((5,), 250)
    deaf, mute = toy_tick(toys=STOPPING), toy_tick(stops=True)
    for tick in (deaf, mute):
        copy = dataclasses.replace(start, state=start.state.clone())
        assert torch.equal(copy.run(make_runners(tick, backend, CPU).run, counts), counts)


@pytest.mark.parametrize(("longest", "questions"), [(1, 0), (64, 0), (65, 1), (128, 1), (129, 2), (100_000, 4)])
def test_loops_seldom_ask_whether_all_rows_have_ended(longest, questions, monkeypatch):
    """Rows end in tick 200 at the latest: loops notice it in tick 256, whatever the bound."""
    asked, ran, tick = [], [], toy_tick(toys=STOPPING, stops=True)

    def step(*tensors):
        ran.append(None)
        return tick.step(*tensors)

    start = flight(3)
    start.own[0] = torch.tensor([0.01, 0.2, 1.0])
    real = torch.Tensor.any
    monkeypatch.setattr(torch.Tensor, "any", lambda x: asked.append(x) or real(x))
    start.run(TickLoop(step, stops=True), torch.full((3,), longest))
    assert (len(asked), len(ran)) == (questions, min(longest, 256))


def in_teams(episodes: int, team: int, longest: int) -> tuple[Start, torch.Tensor, torch.Tensor]:
    """Rows of the same clock, numbers of ticks for them, and how many they will run."""
    start = flight(episodes * team)
    ticks = start.ticks[::team].repeat_interleave(team)
    counts = torch.where(torch.rand(episodes) < 0.2, 0, torch.randint(0, longest, (episodes,))).repeat_interleave(team)
    ends = stops(start, counts).view(episodes, team).amin(1).repeat_interleave(team)
    return dataclasses.replace(start, ticks=ticks, lockstep=team), counts, ends


@pytest.mark.parametrize("team", [1, 2, 3, 7, 12, 40])
def test_teams_end_with_the_first_row_that_stops(team, stopping, runners):
    """Bit for bit as if all rows had been to run that long."""
    for episodes, longest in ((1, 20), (3, 64), (20, 65), (9, 300)):
        start, counts, ends = in_teams(episodes, team, longest)
        for order in (None, ends):
            copy = dataclasses.replace(start, state=start.state.clone(), expected_ticks=order)
            assert torch.equal(copy.run(stopping.run, counts), ends)
            assert torch.equal(copy.state, after(runners, start, ends))


@pytest.mark.parametrize("tick", [1, 64, 65, 129])
def test_teams_may_stop_in_their_first_and_in_their_last_tick(tick, stopping, runners):
    start, counts = flight(12), torch.tensor([tick, tick + 1, 300, 0]).repeat_interleave(3)
    start.own[0], start.ticks[:] = 2.0, start.ticks[0]
    start.own[0, 1::3] = tick / 200.0
    copy = dataclasses.replace(start, state=start.state.clone(), lockstep=3)
    ends = torch.tensor([tick, tick, tick, 0]).repeat_interleave(3)
    assert torch.equal(copy.run(stopping.run, counts), ends)
    assert torch.equal(copy.state, after(runners, start, ends))


def test_rejects_wrong_back_ends_and_stops_that_are_no_masks():
    halts = Component("halt", lambda bus: setattr(bus, "stop", bus.count), stops=True, after="navigation")
    tick, start, mask = toy_tick(toys=(*TOYS, halts), stops=True), flight(2), ("bus.stop", "torch.float64", "mask")
    check_refusals(
        refusal(lambda: make_runners(toy_tick(), "fast", CPU), ValueError, "backend='fast'", "['compiled', 'eager']"),
        refusal(lambda: tick.kernel(), TypeError, *mask),
        refusal(lambda: start.run(TickLoop(tick.step), start.ticks + 1), TypeError, *mask),
    )


@pytest.fixture(scope="module")
def scanners():
    """A compiled environment whose rows are in all modes, at different times."""
    env = bsk_torch.make("NadirScan-v1", num_envs=64, seed=4, backend="compiled", dtype=torch.float64)
    td = env.reset()
    for _ in range(3):
        td = env.step(td.select("observation").set("action", torch.randint(0, 4, (64,))))["next"]
    assert len(env.simulator.mode.unique()) == 4
    return env.simulator


MIXED = [180, 0, 60, 61, 1, 120, 179, 60]


@pytest.mark.compiled
@pytest.mark.parametrize("rows", [[0], [5, 40, 7], list(range(8)), list(range(20, 29)), list(range(63, -1, -1))], ids=len)
def test_satellites_are_bit_identical_in_every_batch(rows, scanners):
    """Whatever the batch's size, composition and order: one row, part of a block, a block, a row more, all backwards."""
    start, counts, rows = start_of(scanners), torch.tensor(MIXED * 8), torch.tensor(rows)
    whole, some = after(scanners.runners, start, counts), after(scanners.runners, part(start, rows), counts[rows])
    assert torch.equal(some, whole[:, rows])
    assert torch.equal(whole[:, counts == 0], start.state[:, counts == 0])


@pytest.mark.compiled
def test_satellites_fly_in_parts_as_in_one(scanners):
    start, counts = start_of(scanners), torch.tensor(MIXED * 8)
    first = torch.minimum(counts, torch.randint(0, 180, (64,)))
    between = after(scanners.runners, start, first)
    later = dataclasses.replace(start, state=between, ticks=start.ticks + first)
    assert torch.equal(after(scanners.runners, later, counts - first), after(scanners.runners, start, counts))


@pytest.mark.compiled
@pytest.mark.parametrize("dtype", [torch.float64, torch.float32])
@pytest.mark.nightly("dtype1")
def test_satellites_of_a_team_are_bit_identical_to_lonely_ones(dtype):
    """In all modes, where images end runs: whatever the team, each is as if it had been to fly that long."""
    env = bsk_torch.make("AEOS-v1", num_envs=84, n_targets=300, seed=4, backend="compiled", sim_dtype=dtype)
    runners, flights = env.simulator.runners, []

    def run(state: torch.Tensor, counts: torch.Tensor, tracks: tuple[Samples, ...], **parts) -> torch.Tensor:
        given = {name: value for name, value in parts.items() if name != "written"}
        flights.append((Start(state.clone(), tracks=tracks, **given), runners.run(state, counts, tracks, **parts)))
        return flights[-1][1]

    env.simulator.runners = runners._replace(run=run)
    env.step(env.reset().set("action", torch.randint(0, 32, (84,))))
    (start, flown), early = flights[0], 0
    start.mode[::7] = torch.randint(0, start.flags.shape[1], (12,))
    for team in (2, 3, 12, 42):
        counts = flown.view(-1, team).amax(1).repeat_interleave(team) + torch.randint(0, 2, (84 // team,)).repeat_interleave(team)
        lonely = dataclasses.replace(start, state=start.state.clone())
        ends = lonely.run(runners.run, counts).view(-1, team).amin(1).repeat_interleave(team)
        together = dataclasses.replace(start, state=start.state.clone(), lockstep=team)
        assert torch.equal(together.run(runners.run, counts), ends)
        assert torch.equal(together.state, after(runners, start, ends))
        early += int((ends < counts).sum())
    assert early > 20
