"""Antennas of ground stations, for which the satellites of a constellation contend."""

import math
from collections.abc import Sequence
from typing import Any

import pytest
import torch
from torch import Tensor

from bsk_torch import NO_ACTION, ConstellationTasking, act, formations, obs
from bsk_torch.presets.nadir_scan import ScanningSatellite, scanning_args
from tests.support.refusals import check_refusals, refusal

pytestmark = pytest.mark.compiled

DRIFT, DOWNLINK = 1, 2
LONGITUDES = range(0, 360, 45)  # of stations at the equator, so far apart that a satellite sees one at a time
ANTENNAS = (1, 2, 1, 1, None, 1, 3, 1)


WAIT = obs.OpportunityProperties(
    *(dict(prop=name) for name in ("antenna_wait", "opportunity_open", "opportunity_close")),
    type="ground_station",
    n_ahead_observe=1,
)
SPECS: dict[str, Any] = dict(
    observation_spec=(WAIT,),
    action_spec=(act.Charge(duration=170.0), act.Drift(duration=40.0), act.Downlink(duration=110.0)),
)


class OtherScanner(ScanningSatellite):
    """Another type."""


KINDS = (ScanningSatellite, OtherScanner, ScanningSatellite, OtherScanner, ScanningSatellite)


def build(antennas: Sequence[float | None], num_envs: int = 4, **options: Any) -> ConstellationTasking:
    """A train of five satellites of two types, 3 degrees apart, over the stations."""
    stations = [{"lat": 0.0, "long": x, "antennas": k} for x, k in zip(LONGITUDES, antennas, strict=True)]
    satellites = [kind(f"S{k}", scanning_args(), **SPECS) for k, kind in enumerate(KINDS)]
    world = dict(groundStationsData=stations, gsMinimumElevation=math.radians(25.0))
    orders = dict(world_args=world, sat_arg_randomizer=formations.train_args(3.0, inc=3.0), time_limit=6000.0, num_envs=num_envs)
    return ConstellationTasking(satellites, **{**orders, "failure_penalty": 0.0, "seed": 4, **options})


def flown(env: ConstellationTasking, actions: Tensor) -> tuple[list[Tensor], list[Tensor], list[Tensor]]:
    """Play actions [K, N, S] while satellites need some; return tick by tick whether a station serves, whether the satellite
    transmits, [N, M, S], and the nearest station, from which other stations are out of view.
    """
    env.reset()
    with env.record(("station_access", "r_BN_P")) as recording:
        sending = []
        for action in actions:
            orders = torch.where(env.requires_retasking, action, NO_ACTION)
            env.play([orders[:, 0::2], orders[:, 1::2]], torch.ones(env.num_envs, dtype=torch.bool))
            modes = env.fleet.joined([s.simulator.mode == s.simulator.mode_names.index("downlink") for s in env.satellites])
            sending.append((env.fleet.ticks.clone(), modes))
    data = recording.data
    serves, transmits, near = [], [], []
    for k in range(env.num_envs):
        rows = data[data["env"] == k]
        rows = rows[rows["tick"] > 0]
        last = torch.stack([ticks[k] for ticks, _ in sending])
        step = torch.searchsorted(last, rows["tick"])
        transmits.append(torch.stack([modes[k] for _, modes in sending])[step])
        serves.append(rows["station_access"] > 0.5)
        r = rows["r_BN_P"]
        longitude = torch.rad2deg(torch.atan2(r[..., 1], r[..., 0]))
        near.append(torch.round(longitude / 45.0).long() % len(LONGITUDES))
    return serves, transmits, near


def served_in_turn(view: Tensor, transmits: Tensor, near: Tensor, antennas: Sequence[float | None]) -> Tensor:
    """Return who is served in each tick, [M, S], by satellites that keep antennas, and others that wait in line."""
    served, holders = torch.zeros_like(view), set[int]()
    asked: dict[int, tuple[int, int, int]] = {}
    opened: dict[int, int] = {}
    for k in range(len(view)):
        for s in range(view.shape[1]):
            opened[s] = opened.get(s, k) if view[k, s] else k + 1
            if not (view[k, s] and transmits[k, s]):
                holders.discard(s)
                asked.pop(s, None)
            else:
                asked.setdefault(s, (k, opened[s], s))
        for s in sorted(asked, key=asked.__getitem__):
            station = int(near[k, s])
            others = sum(int(near[k, other]) == station for other in holders - {s})
            if s not in holders and others < (antennas[station] or len(LONGITUDES)):
                holders.add(s)
        served[k, list(holders)] = True
    return served


@pytest.mark.parametrize(
    ("backend", "episodes", "steps", "least"), [("eager", [13], 2, 30), ("compiled", [0, 1, 2, 13], 90, 1000)]
)
def test_antennas_are_kept_and_passed_on_as_in_a_queue(backend: str, episodes: list[int], steps: int, least: int) -> None:
    some: dict[str, Any] = dict(num_envs=len(episodes), env_ids=episodes, backend=backend)
    generator = torch.Generator().manual_seed(1)
    actions = torch.tensor([0, DRIFT, DOWNLINK, DOWNLINK, DOWNLINK])[
        torch.randint(5, (steps, len(episodes), 5), generator=generator)
    ]
    view, transmits, near = flown(build((None,) * 8, **some), actions)
    serves, again, _ = flown(build(ANTENNAS, **some), actions)
    waits = 0
    for k in range(len(episodes)):
        assert torch.equal(transmits[k], again[k])
        expected = served_in_turn(view[k], transmits[k], near[k], ANTENNAS)
        assert torch.equal(serves[k] & transmits[k], expected)
        waits += int((view[k] & transmits[k] & ~expected).sum())
    assert waits > least


@pytest.mark.parametrize(("last", "checked"), [(DOWNLINK, slice(4, 5)), (DRIFT, slice(0, 4))])
def test_observed_waits_are_those_until_satellites_are_served(last: int, checked: slice) -> None:
    """Of one that would begin to downlink now, and of others, which go on to downlink."""
    env = build((1,) * 8, num_envs=2, env_ids=[13, 2])
    env.reset()

    def play(last: int) -> None:
        orders = torch.tensor([[*[DOWNLINK] * 4, last]]).expand(2, -1).where(env.requires_retasking, torch.tensor(NO_ACTION))
        env.play([orders[:, 0::2], orders[:, 1::2]], torch.ones(2, dtype=torch.bool))

    play(DRIFT)
    seen = env.fleet.joined([satellite.observations.get_vector(torch.float64) for satellite in env.satellites])
    now, (wait, opens, closes) = env.fleet.sim_time.unsqueeze(1), seen.unbind(2)
    begins = opens.clamp(min=0.0) + wait
    with env.record("station_access") as recording:
        for _ in range(12):
            play(last)
    waited = 0
    for k in range(2):
        data = recording.of(k)
        tick, serves = data["tick"].unsqueeze(1), data["station_access"] > 0.5
        served = torch.where(serves & (tick > now[k]), tick - 1.0, torch.inf).amin(0)  # access is that of the tick before
        soon = begins[k] < torch.minimum(closes[k], tick[-1] - now[k]) - 5.0
        late = served - (now + begins)[k]
        assert ((late - 0.5).abs() < 0.51)[checked][soon[checked]].all()
        waited += int((soon & (wait[k] > 10.0))[checked].sum())
    assert waited > 0


def test_numbers_of_antennas_are_whole_and_waits_those_for_stations() -> None:
    check_refusals(
        refusal(lambda: build((1.5, *[None] * 7)), ValueError, "antennas", "1.5", "whole number"),
        refusal(
            lambda: obs.OpportunityProperties(dict(prop="antenna_wait"), n_ahead_observe=1), ValueError, "antenna_wait", "target"
        ),
    )
