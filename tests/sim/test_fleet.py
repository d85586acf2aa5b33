"""Satellites of several types side by side: where their rows stand, what is drawn for them, how they fly together."""

from types import SimpleNamespace
from typing import ClassVar

import pytest
import torch

from bsk_torch import rand
from bsk_torch.rand import first_key
from bsk_torch.sats.bound import SatelliteFleet
from bsk_torch.sim import dyn, fsw
from bsk_torch.sim.draw_table import DrawTable
from bsk_torch.sim.fleet import Fleet, share
from bsk_torch.sim.state import StateTable
from tests.sim.simulators import make_simulator
from tests.support.refusals import check_refusals, refusal

N = 3


def part(*columns: int, n: int = N) -> SimpleNamespace:
    """A stand-in for the simulation of the satellites ``columns``."""
    tables = {"state": StateTable(n, len(columns)), "scenario_state": DrawTable(n)}
    alone = {"followed": {}, "records": False, "stops": False, "h": 1.0, "contended": False}
    return SimpleNamespace(num_envs=n, count=len(columns), columns=columns, device=torch.device("cpu"), **alone, **tables)


def fleet_of(*types: tuple[int, ...], n: int = N) -> SatelliteFleet:
    fleet = SatelliteFleet([part(*columns, n=n) for columns in types], [f"S{k}" for columns in types for k in columns])
    fleet.satellites = tuple(SimpleNamespace(**{f"own_{k}": rows_of(columns)}) for k, columns in enumerate(types))
    return fleet


def rows_of(columns: tuple[int, ...], n: int = N) -> torch.Tensor:
    """Rows of a type whose entries say which environment (tens) and satellite (ones) they belong to, [n * count, 2]."""
    named = torch.tensor([[10.0 * env + k for k in columns] for env in range(n)]).flatten()
    return torch.stack([named, -named], -1)


WHOLE = rows_of((0, 1, 2, 3)).view(N, 4, 2)
LAYOUTS = [((0, 1, 2, 3),), ((0, 1), (2, 3)), ((0, 2), (1, 3)), ((1, 2), (0,), (3,)), ((3,), (0, 1, 2))]


@pytest.mark.parametrize("types", LAYOUTS, ids=str)
def test_rows_of_types_and_tables_of_satellites(types):
    """By type and by satellite are two orders of the same."""
    fleet = fleet_of(*types)
    assert fleet.size == 4
    parts = [rows_of(columns) for columns in types]
    assert torch.equal(fleet.joined(parts), WHOLE)
    assert torch.equal(fleet.joined([rows[:, 0] for rows in parts]), WHOLE[..., 0])
    for k, rows in enumerate(parts):
        assert torch.equal(fleet.rows_of(k, WHOLE), rows)
        envs = torch.tensor([2, 0])
        assert torch.equal(rows[fleet.simulators[k].state.rows_of(envs)].view(2, -1, 2), rows.view(N, -1, 2)[envs])


def test_values_of_all_and_of_some_satellites():
    fleet = fleet_of((0, 2), (1, 3))
    values = [rows_of((0, 2)), rows_of((1, 3))]
    assert torch.equal(fleet.each(lambda part: values[fleet.satellites.index(part)]), WHOLE)
    # Types without it give the value for missing ones, in the shape and dtype of the others.
    fleet = fleet_of((0, 2), (1,), (3,))
    expected = torch.full_like(WHOLE, -1.0)
    expected[:, 1] = WHOLE[:, 1]
    assert torch.equal(fleet.each(lambda part: part.own_1, missing=-1.0), expected)
    expected = torch.zeros(N, 4, dtype=torch.int64)
    expected[:, [0, 2]] = WHOLE[:, [0, 2], 0].long()
    whole = fleet.each(lambda part: part.own_0[:, 0].long())
    assert torch.equal(whole, expected)
    assert whole.dtype == torch.int64
    flags = fleet.each(lambda part: part.own_2[:, 0] > -1.0, missing=False)
    assert flags.tolist() == [[False, False, False, True]] * N


def test_rejects_reading_what_nobody_has_and_hides_no_other_error():
    fleet = fleet_of((0, 2), (1, 3))
    check_refusals(
        refusal(lambda: fleet.each(lambda part: part.altitude), AttributeError, "'altitude'"),
        refusal(lambda: fleet.each(lambda part: 1 / 0), ZeroDivisionError),
    )


def test_share():
    """Satellites are numbered within their type, and values follow them; arguments of others are left out."""
    values = torch.arange(6.0).view(2, 3)
    given = {"mass": ([4, 0, 3], values), "K": ([1], values[:, :1])}
    mine = share(given, (3, 4, 5))
    assert list(mine) == ["mass"]
    within, which = mine["mass"]
    assert within.tolist() == [1, 0]
    assert torch.equal(which, values[:, [0, 2]])
    assert share(given, (2,)) == {}
    assert {name: within.tolist() for name, (within, _) in share(given, (0, 1)).items()} == {"mass": [0], "K": [1]}


@pytest.fixture(scope="module")
def drawing() -> Fleet:
    """Satellites 0 and 2 of one type and 1 of another, whose arguments, world and scenario are random."""
    args, world = {"K": rand.Uniform(1.0, 2.0)}, {"utc_init": rand.random_epoch()}
    options = {"num_envs": N, "dtype": torch.float64, "sim_rate": 1.0, "horizon": 0.0}
    scenario_state = DrawTable(N)
    scenario_state.declare("asked", None, 2)
    options |= {"backend": "eager", "scenario_state": scenario_state}
    models = dyn.BasicDynamicsModel, fsw.BasicFSWModel
    first = make_simulator(*models, args, world, columns=(0, 2), **options)
    second = make_simulator(*models, args, world, columns=(1,), **options)
    return Fleet([first, second], ["A", "B", "C"], lambda key: {"asked": key.named("asked").uniform(2)})


def test_draws_and_tables_are_shared_in_any_batch(drawing):
    """All satellites of an episode live in one world; each draws arguments of its own, as it would among satellites like it."""
    drawn = drawing.draw(first_key(N))
    assert torch.equal(drawn.scenario["asked"], first_key(N).named("asked").uniform(2))
    two, one = drawn.values
    assert len(one["utc_init"].unique()) == N
    assert torch.equal(two["utc_init"], one["utc_init"].repeat_interleave(2))
    k = drawing.joined([two["K"], one["K"]])
    u = first_key(N).of_satellites(torch.arange(3)).named("K").uniform(1)
    assert torch.equal(k, 1.0 + u.view(N, 3))
    assert "asked" not in two
    whole = drawing.draw(first_key(N))
    key = rand.Key(torch.zeros(1, dtype=torch.int64), torch.tensor([1]), torch.zeros(1, dtype=torch.int64))
    alone = drawing.draw(key)
    for count, some, every in zip((2, 1), alone.values, whole.values, strict=True):
        for name in ("utc_init", "K", "sigma_init", "oe"):
            assert torch.equal(some[name], every[name][count : 2 * count]), name
    first, second = drawing.simulators
    assert drawing.scenario_state is first.scenario_state is second.scenario_state
    assert drawing.state.tables["scenario"] is drawing.scenario_state
    assert drawing.scenario_state["asked"].shape == (N, 2)
    assert drawing.ticks.shape == drawing.sim_time.shape == (N,)


def test_arguments_are_set_for_all_satellites_together(drawing):
    """Satellites of both types, and some of one only."""
    masses = torch.tensor([[120.0, 110.0], [220.0, 210.0], [320.0, 310.0]])
    drawn = drawing.draw(first_key(N), {"mass": ([2, 1], masses), "hs_min": ([1], masses[:, 1:])})
    two, one = drawn.values
    default = float(drawing.simulators[0].type.arguments.sat_args.table["mass"].default)
    assert two["mass"].view(N, 2).tolist() == [[default, 120.0], [default, 220.0], [default, 320.0]]
    assert one["mass"].tolist() == one["hs_min"].tolist() == [110.0, 210.0, 310.0]
    assert len(two["hs_min"]) == 1


FAR = 10**6
ENDLESS = torch.full((N,), FAR)


class Clock(StateTable):
    """Ticks of one satellite in each episode, from 5 on."""

    def __init__(self) -> None:
        super().__init__(N)
        self.declare("ticks", 5)

    def of_env(self, table):
        return table


class Flyer:
    """Counts ticks, up to its event at tick ``event`` [N] if that ``stops`` it; ``flights`` are the ticks of its runs."""

    followed: ClassVar[dict[str, object]] = {}
    records = contended = False
    h = 1.0

    def __init__(self, column: int, event: list[int] | None = None, stops: bool = True) -> None:
        self.num_envs, self.count, self.columns, self.device = N, 1, (column,), torch.device("cpu")
        self.has_events, self.stops = event is not None, stops and event is not None
        self.ends_apart = self.has_events and not self.stops
        self.state, self.scenario_state, self.event = Clock(), StateTable(N), torch.tensor(event or [FAR] * N)
        self.flights: list[list[int]] = []

    @property
    def ticks(self):
        return self.state.ticks

    def events(self, rows=None):
        return (self.ticks >= self.event).long()

    def run(self, ticks, expected=None, may_rewind=False, trace=None, followed=None, rows=None):
        self.flights.append(ticks.tolist())
        left = self.event - self.ticks
        flown = torch.where((left > 0) & self.stops, torch.minimum(ticks, left), ticks)
        self.state.ticks = self.ticks + flown
        return flown

    def checkpoint(self, rows=None):
        return self.ticks.clone()

    def rewind(self, checkpoint, rows):
        self.state.ticks = torch.where(rows, checkpoint, self.ticks)


def fly(flyers, ticks, left=ENDLESS) -> list[list[bool] | None]:
    """Which had an event that was evaluated, None for types without; all must have flown as far."""
    fleet = Fleet(flyers, [f"S{k}" for k in range(len(flyers))])
    now = flyers[0].ticks
    result = fleet.run(torch.ones(N, dtype=torch.bool), now + torch.as_tensor(left), now + torch.tensor(ticks))
    assert all(torch.equal(flyer.ticks, now + result.ticks) for flyer in flyers)
    return [None if event is None else event.tolist() for event in result.events]


def test_all_types_fly_to_the_first_event_of_any():
    """The first type flies beyond the second one's event in one episode, and goes back there; the others are not flown again."""
    plain, first, second = Flyer(0), Flyer(1, [25, 105, 99]), Flyer(2, [99, 35, 99])
    seen = fly([plain, first, second], [60, 60, 7])
    assert (plain.ticks.tolist(), seen) == ([25, 35, 12], [None, [True, False, False], [False, True, False]])
    assert (first.flights, second.flights) == ([[60, 60, 7], [0, 30, 0]], [[20, 60, 7]])
    assert plain.flights == [[20, 30, 7]], "types that end no step fly last, and once"


def test_events_of_one_instant_are_all_seen_and_standing_episodes_have_none():
    flyers = [Flyer(0, [25, 25, 26]), Flyer(1, [25, 26, 25])]
    assert fly(flyers, [60] * 3) == [[True, True, False], [True, False, True]]
    assert flyers[0].ticks.tolist() == [25, 25, 25]
    flyers = [Flyer(0, [25, 25, 25]), Flyer(1, [15, 15, 15])]
    assert fly(flyers, [0, 60, 0]) == [[False] * 3, [False, True, False]]
    assert flyers[0].ticks.tolist() == [5, 15, 5]
    # Those before the end of the step, and at it, but not at the end of the episode.
    flyers = [Flyer(0, [15, 25, 25], stops=False), Flyer(1, [25, 25, 99])]
    assert fly(flyers, [60, 60, 20], [20, 60, 20]) == [[True, True, False], [False, True, False]]
    assert flyers[0].flights == [[19, 20, 19], [1, 0, 1]]


@pytest.mark.parametrize("others", [0, 1])
def test_the_end_of_an_episode_comes_before_an_event_of_that_instant(others):
    flyers = [Flyer(0, [25, 25, 25]), *(Flyer(1 + k, [90] * 3) for k in range(others))]
    assert fly(flyers, [20, 60, 20], [20, 21, 60])[0] == [False, True, True]
    assert flyers[0].ticks.tolist() == [25, 25, 25]
