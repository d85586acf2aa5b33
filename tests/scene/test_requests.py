"""Requests: windows, looks, sensors, and changes in flight."""

from __future__ import annotations

import functools
import math
from datetime import datetime, timedelta, timezone

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from bsk_torch import ConstellationTasking, SatelliteTasking, act, data, dyn, obs, rand, sats, scene
from bsk_torch.constants import R_EARTH
from bsk_torch.sim.access.windows.table import Windows
from bsk_torch.sim.fsw import LookFSWModel, MagicOrbitalManeuverFSWModel
from bsk_torch.sim.places.requested import NO_OFF_NADIR
from tests.support.refusals import check_refusals, refusal

LIMIT = 3000.0
ORBIT = {"oe": rand.random_orbit(alt=500.0, i=53.0)}


class Viewer(sats.RequestSatellite):
    observation_spec = (
        obs.OpportunityProperties(
            *({"prop": name} for name in ("opportunity_open", "time_to_release", "time_to_due", "look_duration", "look_slack")),
            {"prop": "priority"},
            {"prop": "sensors"},
            n_ahead_observe=4,
        ),
    )
    action_spec = (act.ImageRequest(4), act.Drift(duration=10.0))


def make(targets=None, n=2, carried=(("visible",), ("visible", "infrared")), sat_args=None, limit=LIMIT, compat=None, **requests):
    args = {"imageTargetMinimumElevation": math.radians(20.0)} | ORBIT | (sat_args or {})
    viewers = [Viewer(f"V{k}", args, sensor_types=types) for k, types in enumerate(carried)]
    known = isinstance(targets, scene.Requests)
    scenario = targets if known else scene.Requests(targets or scene.UniformTargets(400), **requests)
    return ConstellationTasking(viewers, scenario, data.RequestReward(), num_envs=n, time_limit=limit, seed=3, compat=compat)


LIMITED = {
    "release": rand.Uniform(0.0, 2000.0),
    "window": rand.Uniform(300.0, 2000.0),
    "min_elevation": rand.Uniform(0.0, math.radians(60.0)),
    "max_off_nadir": rand.Choice([math.radians(25.0), math.radians(40.0), NO_OFF_NADIR]),
    "sensors": {"visible": 0.7, "infrared": 0.3},
}


def drift(env):
    action = env.full_action_spec.zero()
    action["agents", "action"] += 4
    return env.step(action)["next"]


def seen_by_hand(env, r_BP_P, normal=None):
    """Which requests satellites at ``r_BP_P`` [N, S, 3] m can look at now, and the distance of angles from limits, rad."""
    scenario, time = env.scenario, env.fleet.sim_time.numpy()[:, None, None]
    r_B, r_L = r_BP_P.numpy()[:, :, None], scenario.r_LP_P.numpy()[:, None]
    line = r_L - r_B
    vertical = r_L / np.linalg.norm(r_L, axis=-1, keepdims=True) if normal is None else normal
    up = np.arcsin(-(line * vertical).sum(-1) / np.linalg.norm(line, axis=-1))
    down = np.arccos(-(line * r_B).sum(-1) / np.linalg.norm(line, axis=-1) / np.linalg.norm(r_B, axis=-1))
    least = np.maximum(math.radians(20.0), scenario.drawn("target_min_elevation").numpy())[:, None]
    most = scenario.drawn("target_max_off_nadir").numpy()[:, None]
    timely = (time >= scenario.release.numpy()[:, None]) & (time <= scenario.due.numpy()[:, None])
    margin = np.minimum(abs(up - least), abs(down - most))
    return (up >= least) & (down <= most) & timely, margin


def geodetic(count):
    """Places on the ellipsoid, and their normals, [count, 3]."""
    generator = np.random.default_rng(4)
    latitude, longitude = np.arcsin(generator.uniform(-1.0, 1.0, count)), generator.uniform(-math.pi, math.pi, count)
    normal = np.stack([np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude)], -1)
    return scene.Targets.from_geodetic(np.degrees(latitude), np.degrees(longitude)), normal


@pytest.mark.parametrize("ellipsoid", [False, True])
def test_windows_are_those_of_angles_and_times(ellipsoid):
    """Every 10 s, flown positions against windows; angles change by up to 0.013 rad/s, and windows are exact to 0.01 s."""
    targets, normal = geodetic(3000) if ellipsoid else (scene.UniformTargets(3000), None)
    env = make(targets, **LIMITED)
    env.reset()
    satellite, compared, visible = env.satellites[0], 0, 0
    windows = satellite.opportunities()
    for _ in range(40):
        drift(env)
        by_hand, margin = seen_by_hand(env, satellite.dynamics.r_BN_P.view(2, 2, 3), normal)
        now = env.fleet.sim_time.repeat_interleave(2).unsqueeze(1)
        inside = (windows.open <= now) & (now <= windows.close)
        table = torch.zeros(4, 3000, dtype=torch.long).scatter_add(1, windows.place, inside.long()).view(2, 2, 3000) > 0
        sure = margin > 1.5e-4
        assert (table.numpy() == by_hand)[sure].all()
        compared, visible = compared + sure.sum(), visible + by_hand.sum()
    assert compared > 400_000
    assert visible > 50


def test_off_nadir_on_eccentric_orbits():
    """The cone of 12 degrees about nadir, where the distance grows from 7000 to 14000 km."""
    orbit = {"oe": rand.random_orbit(alt=3500.0, e=0.3, i=53.0)}
    env = make(sat_args=orbit, max_off_nadir=math.radians(12.0))
    env.reset()
    satellite = env.satellites[0]
    windows = satellite.opportunities()
    for _ in range(30):
        drift(env)
        by_hand, margin = seen_by_hand(env, satellite.dynamics.r_BN_P.view(2, 2, 3))
        now = env.fleet.sim_time.repeat_interleave(2).unsqueeze(1)
        inside = (windows.open <= now) & (now <= windows.close)
        table = torch.zeros(4, 400, dtype=torch.long).scatter_add(1, windows.place, inside.long()).view(2, 2, 400) > 0
        sure = margin > 1.5e-4
        assert (table.numpy() == by_hand)[sure].all()


@functools.cache
def overhead():
    """The place that the satellite passes overhead after ten minutes, [1, 3] m."""
    first = make(scene.UniformTargets(1), 1, [()])
    first.reset()
    for _ in range(60):
        drift(first)
    place = first.satellites[0].dynamics.r_BN_P
    return R_EARTH * place / place.norm()


def below(**requests):
    """One satellite and one request that it passes overhead after ten minutes."""
    env = make(scene.Targets(overhead()), 1, [()], **requests)
    env.reset()
    return env


def completed(env, most=30):
    for _ in range(most):
        action = env.full_action_spec.zero()
        td = env.step(action)["next"]
        if env.rewarder.completed.max() >= 0.0 or td["done"].any():
            break
    return env.rewarder.completed[0, 0].item()


def test_looks_last_as_long_as_requested():
    """The image of a look of D s comes D s after that of a look of none, in whole ticks, and is recorded in the next tick."""
    at_once = completed(below())
    window = below().satellites[0].opportunities()
    assert window.open[0, 0] < at_once < window.open[0, 0] + 5.0
    assert completed(below(duration=37.2)) == pytest.approx(at_once + 38.0)
    release = math.ceil(at_once) + 20.5
    assert completed(below(release=release, duration=20.0)) == pytest.approx(release + 0.5 + 20.0 + 1.0)
    assert completed(below(due=at_once + 19.0, duration=20.0)) == pytest.approx(at_once + 20.0)
    assert completed(below(due=at_once + 18.0, duration=20.0)) == -1.0


def test_looks_that_cannot_be_completed_earn_nothing():
    window = below().satellites[0].opportunities()
    seconds = (window.close - window.open)[0, 0].item()
    assert below(duration=seconds + 1.0).satellites[0].opportunities().close.isinf().all()
    last = window.open[0, 0].item() + 30.0
    assert completed(below(due=last, duration=29.9)) == -1.0  # pointing begins two ticks after the window
    assert completed(below(due=last, duration=20.0)) > 0.0


def test_a_gap_begins_the_look_again():
    """A rate limit that the satellite exceeds near the culmination splits the pass."""
    whole = completed(below(duration=60.0))
    strict = {"imageRateErrorRequirement": 1e-12}
    env = below(duration=60.0, sat_args=strict)
    assert whole > 0.0
    assert completed(env) == -1.0


def test_mask_excludes_windows_too_short_for_the_rest_of_a_look():
    env = below(duration=100.0)
    mask = env.satellites[0].action_mask()
    assert mask[0, 0]
    close = env.satellites[0].opportunities().close[0, 0].item()
    while env.fleet.sim_time.item() < close - 100.0:
        assert env.satellites[0].action_mask()[0, 0]
        drift(env)
    assert not env.satellites[0].action_mask()[0, :4].any()


def test_sensors_decide_who_sees_requests():
    env = make(carried=[("visible",), ("infrared",), ("visible", "infrared"), ()], **LIMITED)
    env.reset()
    code = env.scenario.drawn("target_sensors")
    assert set(code.unique().tolist()) == {1.0, 2.0}
    shown = env.satellites[0].find_next_opportunities(400)
    kind = code.repeat_interleave(4, 0).gather(1, shown.place)
    kind = torch.where(shown.mask, kind, -1.0).view(2, 4, -1)
    assert set(kind[:, 0].unique().tolist()) == {2.0, -1.0}
    assert set(kind[:, 1].unique().tolist()) == {1.0, -1.0}
    assert set(kind[:, 2].unique().tolist()) == {1.0, 2.0, -1.0}
    assert set(kind[:, 3].unique().tolist()) == {-1.0}
    assert len(env.fleet.simulators) == 1


def test_observed_properties():
    env = make(duration=12.0, **LIMITED)
    observation = env.reset()["agents", "observation"].view(4, 4, 8)
    shown, scenario = env.satellites[0].find_next_opportunities(4), env.scenario
    of = {name: scenario.look_up(getattr(scenario, name), shown.place.view(2, -1)).view(4, 4) for name in ("release", "due")}
    columns = [shown.open, of["release"], of["due"].clamp(max=LIMIT), torch.full((4, 4), 12.0), shown.close - shown.open - 12.0]
    for k, column in enumerate(columns):
        torch.testing.assert_close(observation[..., k], column.float())
    code = scenario.look_up(scenario.drawn("target_sensors"), shown.place.view(2, -1)).view(4, 4)
    torch.testing.assert_close(observation[..., 6], (code == 1.0).float())
    torch.testing.assert_close(observation[..., 7], (code == 2.0).float())


def windows_of(env, place):
    """Windows of a target, [(open, close)] of each satellite."""
    table = env.satellites[0].opportunities()
    rows = [(table.place[k] == place) & table.close[k].isfinite() for k in range(len(table.place))]
    return [torch.stack([table.open[k][row], table.close[k][row]], -1) for k, row in enumerate(rows)]


@pytest.mark.parametrize("begin", [0.0, 700.0])
def test_inserted_requests_have_the_windows_of_listed_ones(begin):
    """Passes on the flown arc instead of the planned one, meters apart: edges within 0.05 s, where passes graze a limit."""
    requests = {"max_off_nadir": math.radians(45.0), "min_elevation": math.radians(25.0), "duration": 10.0}
    listed, live = make(n=2, limit=6000.0, **requests), make(n=2, limit=6000.0, spare=400, **requests)
    listed.reset(), live.reset()
    while float(live.fleet.sim_time[0]) < begin:
        drift(live)
    places = listed.scenario.r_LP_P
    column = live.scenario.insert([0, 1], places, **requests)
    assert column.tolist() == [list(range(400, 800))] * 2
    number = 0
    for k in range(400):
        for one, other in zip(windows_of(listed, k), windows_of(live, 400 + k), strict=True):
            one = one.clamp(min=begin)
            one = one[one[:, 1] - one[:, 0] >= 10.0]
            torch.testing.assert_close(one, other, rtol=0.0, atol=0.05)
            number += len(one)
    assert number > 100


def test_inserted_requests_are_observed_and_served():
    env = below(spare=2)
    place = env.scenario.r_LP_P[0, :1].clone()
    before = env.observe()["agents", "observation"]
    env.scenario.cancel([0], 0)
    column = env.scenario.insert([0], place, weight=7.0, duration=5.0, due=2000.0)
    after = env.observe()["agents", "observation"].view(4, -1)
    assert not torch.equal(after, before.view(4, -1))
    assert after[0, 5] == 7.0
    assert env.satellites[0].find_next_opportunities(1).place.item() == column.item() == 1
    env.scenario.reprioritize([0], "new-0", 9.0)
    assert env.observe()["agents", "observation"].view(4, -1)[0, 5] == 9.0
    assert completed(env) == -1.0
    assert env.rewarder.completed[0, 1] > 0.0
    assert env.returns.item() == 9.0
    assert env.rewarder.measures()["CR"].item() == 1.0


def test_images_of_canceled_requests_earn_nothing():
    """The second satellite ends the step of the first one, in mid-look; the request is canceled between the steps."""
    returns = {}
    for cancels in (False, True):
        env = make(scene.Targets(overhead()), 1, [(), ()], duration=40.0, sat_args={"oe": rand.random_orbit(alt=500.0, i=53.0)})
        env.reset()
        look = env.full_action_spec.zero()
        look["agents", "action"][0, 1] = 4
        td = env.step(look)["next"]
        if cancels:
            env.scenario.cancel([0], 0)
        while env.satellites[0].imaged.sum() == 0 and not td["done"].any():
            on = env.full_action_spec.zero()
            on["agents", "action"][0] = torch.tensor([5, 4])  # the first satellite continues
            td = env.step(on)["next"]
        assert env.satellites[0].imaged.tolist() == [1, 0]
        returns[cancels] = env.returns.item()
    assert returns == {False: 1.0, True: 0.0}


def changed(env, rows):
    """Insert, cancel and reprioritize in some rows of an environment, some steps after the reset."""
    env.reset()
    for _ in range(20):
        env.step(env.full_action_spec.zero())
    r_LP_P = rand.first_key(1)
    places = scene.UniformTargets(300).draw(r_LP_P)["target_r_LP_P"][0]
    env.scenario.insert(rows, places, duration=4.0, weight=2.0, sensors="visible", max_off_nadir=1.0)
    env.scenario.cancel(rows, [1, 2, 3, "tgt-5"])
    env.scenario.reprioritize(rows, [7, 8], [3.0, 4.0])
    steps = [env.step(env.full_action_spec.zero())["next"].clone() for _ in range(15)]
    return torch.stack(steps)


def test_changes_do_not_depend_on_the_batch():
    large = changed(make(n=5, spare=300, **LIMITED), [1, 3])
    small = changed(make(n=2, spare=300, **LIMITED), [1])
    assert torch.equal(large["agents", "observation"][:, 1], small["agents", "observation"][:, 1])
    assert torch.equal(large["agents", "reward"][:, 1], small["agents", "reward"][:, 1])
    assert torch.equal(large["agents", "observation"][:, 0], small["agents", "observation"][:, 0])


def test_changes_are_saved_restored_and_cleared():
    env = make(n=2, spare=300, **LIMITED)
    changed(env, [0, 1])
    saved, other = env.get_state(), make(n=2, spare=300, **LIMITED)
    other.reset()
    other.restore(saved)
    assert torch.equal(env.observe()["agents", "observation"], other.observe()["agents", "observation"])
    for _ in range(5):
        one, two = (each.step(each.full_action_spec.zero())["next"] for each in (env, other))
        assert torch.equal(one["agents", "observation"], two["agents", "observation"])
    assert env.scenario.inserted.tolist() == [300, 300]
    env.reset()
    assert not env.scenario.drawn("target_exists")[:, 400:].any()
    assert env.scenario.inserted.tolist() == [0, 0]
    env.scenario.insert([0], env.scenario.r_LP_P[0, :1])


FILE = """\
id,latitude,longitude,release,due,duration,sensors,weight,min_elevation,max_off_nadir
etna,37.75,14.99,2026-04-14T08:10:00Z,2026-04-14T08:40:00Z,20,infrared,5,30,
rome,41.90,12.50,,2000,10,visible|infrared,2,,30
"""


def test_files(tmp_path):
    read, path = scene.Requests.from_file, tmp_path / "requests.csv"
    path.write_text(FILE)
    for start in ("2026 APR 14 08:00:00.000 (UTC)", datetime(2026, 4, 14, 10, tzinfo=timezone(timedelta(hours=2)))):
        requests = read(path, start, spare=1)
        env = make(requests, carried=[("visible", "infrared")], n=1)
        env.reset()
        live, normal = env.scenario, np.radians([37.75, 14.99])
        assert live.names(0) == ["etna", "rome", "new-0"]
        assert live.vertical == "wgs84"
        assert live.release[0, :2].tolist() == [600.0, 0.0]
        assert live.due[0, :2].tolist() == [2400.0, 2000.0]
        assert live.duration[0, :2].tolist() == [20.0, 10.0]
        assert live.priority[0].tolist() == [5.0, 2.0, 0.0]
        assert live.drawn("target_sensors")[0].tolist() == [1.0, 3.0, 0.0]
        torch.testing.assert_close(live.drawn("target_min_elevation")[0, :2].rad2deg(), torch.tensor([30.0, 0.0]).double())
        torch.testing.assert_close(live.drawn("target_max_off_nadir")[0, :2].rad2deg(), torch.tensor([90.0, 30.0]).double())
        x, y, z = live.r_LP_P[0, 0].tolist()
        assert math.atan2(y, x) == pytest.approx(normal[1])
        assert math.atan2(z, math.hypot(x, y)) == pytest.approx(math.atan((1.0 - 6.69437999014e-3) * math.tan(normal[0])))
        live.cancel([0], "rome")
    check_refusals(
        refusal(lambda: scene.Requests.from_file(tmp_path / "requests.csv"), ValueError, "line 2", "release", "start="),
        refusal(
            lambda: scene.Requests.from_file(tmp_path / "requests.csv", "2026 APR 14 08:00:00 TDB"), ValueError, "TDB", "UTC"
        ),
    )


def test_refusals():
    targets = scene.UniformTargets(3)
    env, blank = make(n=2, spare=2), make(n=2, spare=2)
    env.reset()
    place, live = env.scenario.r_LP_P[0, :1].clone(), env.scenario
    check_refusals(
        refusal(lambda: scene.Requests(targets, due=1.0, window=2.0), ValueError, "due", "window"),
        refusal(lambda: scene.Requests(targets, duration=-1.0), ValueError, "duration", -1, "s"),
        refusal(lambda: scene.Requests(targets, max_off_nadir=30.0), ValueError, "max_off_nadir", 30, "1.5708", "rad"),
        refusal(lambda: scene.Requests(targets, release=[1.0]), ValueError, "release", 3),
        refusal(lambda: scene.Requests(targets, sensors=["a"]), ValueError, "sensors", 3),
        refusal(lambda: scene.Requests(targets, sensors={"a": 0.0}), ValueError, "sensors", "probability"),
        refusal(lambda: scene.Requests(targets, sensors=7), ValueError, "sensors", 7),
        refusal(lambda: scene.Requests(targets, spare=-1), ValueError, "spare", -1),
        refusal(lambda: make(release=10.0, due=5.0), ValueError, "due=5 s", "release=10 s", "target 0"),
        refusal(lambda: make(window=10.0, duration=11.0), ValueError, "duration=11 s", "10 s", "target 0"),
        refusal(lambda: make(carried=[["visual"]], **LIMITED), ValueError, "'infrared'", "visual"),
        refusal(lambda: Viewer("V", sensor_types="visible"), ValueError, "sensor_types", "visible"),
        refusal(lambda: scene.Requests(targets).insert([0], place), ValueError, "env.scenario"),
        refusal(lambda: blank.scenario.insert([1], place), ValueError, "environment 1", "reset"),
        refusal(lambda: live.insert([2], place), IndexError, "rows", "[2]", 1),
        refusal(lambda: live.insert([0, 0], place), IndexError, "rows", "[0, 0]"),
        refusal(lambda: live.insert([0], place.expand(3, 3)), ValueError, "environment 0", "2 more", "spare=2"),
        refusal(lambda: live.insert([0], place * 0.001), ValueError, "km"),
        refusal(lambda: live.insert([0], [1.0, 2.0]), ValueError, "r_LP_P", "[2]"),
        refusal(lambda: live.insert([0], place, due=-1.0), ValueError, "due=-1 s", "release=0 s"),
        refusal(lambda: live.insert([0], place, due=5.0, duration=6.0), ValueError, "duration=6 s", "5 s"),
        refusal(lambda: live.insert([0], place, weight=[1.0, 2.0]), ValueError, "weight", "[2]"),
        refusal(lambda: live.insert([0], place, weight=math.nan), ValueError, "weight", "nan"),
        refusal(lambda: live.insert([0], place, sensors={"visible": 1.0}), ValueError, "sensors", "visible"),
        refusal(lambda: live.insert([0], place, sensors="visable"), ValueError, "'visable'", "'visible'"),
        refusal(lambda: live.cancel([0], 400), ValueError, "request 400", "'new-0'", "environment 0"),
        refusal(lambda: live.cancel([0], 402), ValueError, "ids", 402, 401),
        refusal(lambda: live.cancel([0], "tgt-999"), ValueError, "'tgt-999'", "tgt-99"),
        refusal(lambda: live.cancel([0, 1], [[1], [2], [3]]), ValueError, "ids", "[3, 1]"),
        refusal(lambda: live.cancel([0, 1], [[1], [2, 3]]), ValueError, "ids", "equal length"),
        refusal(lambda: live.reprioritize([0], 1, "much"), ValueError, "weight", "much"),
    )
    assert env.scenario.inserted.tolist() == [0, 0]
    assert live.insert([], place).shape == (0, 1)
    live.cancel([0], 1)
    check_refusals(refusal(lambda: live.cancel([0, 1], 1), ValueError, "request 1", "environment 0", "canceled"))


def test_parts_that_do_not_fit():
    class Imager(sats.ImagingSatellite):
        observation_spec = (obs.Time(),)
        action_spec = (act.Image(3),)

    class Asker(Imager):
        action_spec = (act.ImageRequest(3),)

    class Watcher(Imager):
        observation_spec = (obs.OpportunityProperties({"prop": "time_to_due"}, n_ahead_observe=2),)

    class Ranged(Viewer):
        pass

    targets = scene.UniformTargets(30)

    def built(kind, scenario, rewarder=None, **sat_args):
        return lambda: ConstellationTasking([kind("V", sat_args)], scenario, rewarder)

    requests = scene.Requests(targets)
    ranged = {"instruments": [dyn.Instrument("far", imageTargetMaximumRange=1e6)]}
    fires = scene.Wildfires(30)
    check_refusals(
        refusal(built(Imager, requests), ValueError, "RequestSatellite", "Imager"),
        refusal(built(Asker, targets), ValueError, "RequestSatellite", "Asker"),
        refusal(built(Watcher, targets), ValueError, "'target'", "RequestSatellite", "Watcher"),
        refusal(built(Viewer, targets), ValueError, "scene.Requests", "Viewer"),
        refusal(built(Imager, targets, data.RequestReward()), ValueError, "RequestReward", "scene.Requests", "UniformTargets"),
        refusal(built(Viewer, scene.CloudyTargets(requests)), ValueError, "Requests must be the scenario itself"),
        refusal(built(Viewer, requests, **ranged), ValueError, "target@far", "imageTargetMaximumRange"),
        refusal(lambda: scene.Requests(fires, spare=2), ValueError, "spare=2", "Wildfires"),
        refusal(lambda: scene.Requests(requests), ValueError, "Requests already"),
        refusal(lambda: make(compat="bsk_rl"), ValueError, "compat"),
    )
    assert scene.Requests(fires).most_targets == 30


def test_single_satellites():
    env = SatelliteTasking(Viewer("V", ORBIT), scene.Requests(scene.UniformTargets(500)), data.RequestReward(), time_limit=900.0)
    td = env.reset()
    assert td["action_mask"].shape == (1, 5)
    assert env.step(td.set("action", torch.tensor([0])))["next", "reward"].isfinite().all()


def test_insertion_after_maneuvers():
    """Orbits that change: windows are those of requests that were there before."""

    class Mover(Viewer):
        fsw_type = (LookFSWModel, MagicOrbitalManeuverFSWModel)

    def moved(**requests):
        args = {"imageTargetMinimumElevation": math.radians(20.0), "dv_available_init": 1e3} | ORBIT
        scenario = scene.Requests(scene.UniformTargets(200), **requests)
        env = SatelliteTasking(Mover("M", args), scenario, data.RequestReward(), num_envs=2, time_limit=6000.0, seed=3)
        env.reset()
        for turn in range(4):
            env.step(TensorDict(action=torch.full((2,), 4), batch_size=[2]))
            if turn == 1:
                env.simulator.thrust(torch.tensor([False, True]), torch.full((2, 3), 30.0, dtype=torch.float64))
        return env

    listed, live = moved(), moved(spare=200)
    assert listed.simulator.arcs.restarts
    live.scenario.cancel([0, 1], list(range(200)))
    live.scenario.insert([0, 1], listed.scenario.r_LP_P)
    pairs = [env.satellite.find_windows(5000.0) for env in (listed, live)]
    closes = []
    for row in range(2):
        one, two = (Windows(*(table[row][windows.close[row].isfinite()] for table in windows)) for windows in pairs)
        one, two = (Windows(*(table[some.place.argsort(stable=True)] for table in some)) for some in (one, two))
        assert torch.equal(one.place, two.place - 200)
        torch.testing.assert_close(one.close, two.close, rtol=0.0, atol=0.05)
        torch.testing.assert_close(one.open.clamp(min=40.0), two.open, rtol=0.0, atol=0.05)
        closes.append(one.close)
    assert len(closes[0]) > 20
    assert closes[0][0] != closes[1][0]


def test_episodes_without_limit_do_not_depend_on_the_batch():
    """Look-ahead grows by segments as queries need it; rows search ahead together."""

    def played(n, rows):
        env = make(n=n, limit=math.inf, duration=rand.Uniform(0.0, 200.0), spare=4)
        td = env.reset()
        seen = [td["agents", "observation"][rows]]
        for k in range(30):
            action = env.full_action_spec.zero()
            action["agents", "action"] += (torch.arange(n).unsqueeze(1) + k) % 2 * 4  # rows advance differently
            if k == 12:
                env.scenario.insert([rows], env.scenario.r_LP_P[rows, :4].clone(), duration=30.0)
            seen.append(env.step(action)["next", "agents", "observation"][rows])
        return torch.stack(seen)

    assert torch.equal(played(5, 1), played(2, 1))
