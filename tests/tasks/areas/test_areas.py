"""Areas as a task: draws, states, observations, rewards, refusals."""

import itertools

import numpy as np
import pytest
import torch

import bsk_torch
from bsk_torch import data, obs, rand, scene
from bsk_torch.presets.nadir_scan import ScanningSatellite, scanning_args
from bsk_torch.rand import first_key
from bsk_torch.rl.policies.shared_policy import baseline
from bsk_torch.sim.environment.world import DEFAULT_STATIONS
from bsk_torch.tasks.areas import AreaOutlook, AreaProperties, AreaReward, Areas, cap, random_caps
from bsk_torch.tasks.areas.preset import AreaScanner, area_args, round_areas
from bsk_torch.tasks.areas.rules import AreaRule
from bsk_torch.tasks.areas.scene import RECORDED
from bsk_torch.viz.episodes import draw, record
from tests.support.refusals import check_refusals, refusal

pytestmark = pytest.mark.compiled

PROPS = ("opens", "closes", "weight", "remaining", "gain", "offset", "pays", "opens_soon", "closes_soon")


def make(**options):
    return bsk_torch.make("Areas-v1", **(dict(num_envs=3, seed=2) | options))


def scan(env, steps, td=None):
    """Observations and rewards of scans, after the reset or a decision."""
    td, played = env.reset() if td is None else td, []
    for _ in range(steps):
        td = env.step(td.set("action", torch.zeros(env.num_envs, dtype=torch.int64)))["next"]
        played.append(td.select("observation", "reward").clone())
    return td, torch.stack(played, 1)


def test_the_preset_plays():
    env = make()
    td, played = scan(env, 3)
    assert torch.equal(torch.isfinite(played["observation"]), torch.ones_like(played["observation"], dtype=torch.bool))
    assert played["observation"].shape == (3, 3, 96)
    assert played["observation"].dtype == torch.float32
    names = env.satellite.observation_description[12:]
    assert names[36:] == [f"outlook.{name}[{k}]" for name in ("worth", "in_view") for k in range(24)]
    assert names[:36] == [f"areas.areas_{k}.{name}" for k in range(4) for name in PROPS]
    areas = played["observation"][..., 12:48].unflatten(-1, (4, len(PROPS)))
    assert ((areas >= 0.0) & (areas <= 1.0))[..., :5].all()
    assert (areas[..., 5].abs() <= 1.0).all()
    assert (areas[..., 4] <= areas[..., 3]).all()
    torch.testing.assert_close(areas[..., 6], areas[..., 2] * areas[..., 4])
    torch.testing.assert_close(areas[..., 7:], torch.exp(-areas[..., :2] * (5700.0 / 240.0)), rtol=1e-4, atol=1e-6)
    assert td["action_mask"].all()
    assert make(revisit=600.0).scenario.revisit == 600.0
    assert env.scenario.memory[RECORDED].shape == (3, 500, max(len(area.share) for area in round_areas()))


def test_thresholds_of_the_rule_can_be_tuned():
    tuned = bsk_torch.tune(AreaRule(), make(time_limit=600.0), {"lead": (60.0, 600.0)}, settings=2, episodes=1, rounds=1, fresh=2)
    assert 60.0 <= tuned.thresholds["lead"] <= 600.0


def test_episodes_do_not_depend_on_the_batch():
    several, alone = make(num_envs=4), make(num_envs=1)
    _, many = scan(several, 12)
    _, one = scan(alone, 12)
    assert all(torch.equal(many[key][:1], one[key]) for key in ("observation", "reward"))
    assert torch.equal(several.scenario.memory[RECORDED][0], alone.scenario.memory[RECORDED][0])
    assert (several.scenario.memory[RECORDED] >= 0).any()
    assert not torch.equal(several.scenario.index[0], several.scenario.index[1])


def test_restored_episodes_go_on_alike():
    env = make(
        scenario=Areas(round_areas(), 300e3, 100, weights=rand.Uniform(), revisit=900.0),
        rewarder=AreaReward(at_end=True),
        time_limit=1500.0,
    )
    td, _ = scan(env, 12)
    saved, td = env.get_state(), td.clone()
    assert (env.scenario.memory[RECORDED] >= 0).any()
    _, first = scan(env, 13, td.clone())
    env.restore(saved)
    _, again = scan(env, 13, td.clone())
    other = make(scenario=env.scenario, rewarder=AreaReward(at_end=True), time_limit=1500.0, seed=5)
    other.reset()
    other.restore(env, envs=[2, 0], source=[0, 2])
    assert all(torch.equal(first[key], again[key]) for key in ("observation", "reward"))
    assert torch.equal(other.scenario.memory[RECORDED][[2, 0]], env.scenario.memory[RECORDED][[0, 2]])


def test_new_episodes_begin_without_recorded_cells():
    env = make(time_limit=600.0)
    td, _ = scan(env, 10)
    before = env.scenario.memory[RECORDED].clone()
    env.reset(td.empty().set("_reset", torch.tensor([[True], [False], [False]])))
    assert (env.scenario.memory[RECORDED][0] == -1).all()
    assert torch.equal(env.scenario.memory[RECORDED][1:], before[1:])


def test_the_reward_at_the_end_is_the_sum():
    at_once, late = make(time_limit=900.0), make(time_limit=900.0, rewarder=AreaReward(at_end=True))
    _, first = scan(at_once, 15)
    _, second = scan(late, 15)
    total = first["reward"].sum(1)
    assert (second["reward"][:, :-1] == 0.0).all()
    torch.testing.assert_close(second["reward"][:, -1], total)
    assert (total > 0.0).any()
    worth = (at_once.scenario.weight * at_once.scenario.covered()).sum(1)
    torch.testing.assert_close(worth.float().unsqueeze(-1), total)
    measured = at_once.rewarder.measures()["area_covered"]
    torch.testing.assert_close(measured, worth / at_once.scenario.weight.sum(1))


def test_draws():
    library = [cap(f"a{k}", 0.0, 10.0 * k, 200e3, 100e3, weight=float(k)) for k in range(6)]
    key = first_key(500)
    drawn = Areas(library, 1e5, 2).draw(key)
    assert drawn["area_index"].shape == (500, 2)
    assert (drawn["area_index"][:, 0] != drawn["area_index"][:, 1]).all()
    counts = torch.bincount(drawn["area_index"].long().flatten(), minlength=6)
    assert (counts.double() - 1000 / 6).abs().max() < 5.0 * (1000 / 6 * 5 / 6) ** 0.5  # five standard deviations
    assert torch.equal(drawn["area_weight"], drawn["area_index"])
    whole = Areas(library, 1e5).draw(key)
    assert whole["area_index"].tolist() == [[0.0, 1.0, 2.0, 3.0, 4.0, 5.0]]
    assert Areas(library, 1e5, weights=2.0).draw(key)["area_weight"].tolist() == [[2.0] * 6]


def test_what_a_scan_is_expected_to_record_is_recorded():
    """Gain and offset of windows ahead, against the flight of a satellite that scans all the time."""
    env = make(num_envs=4, seed=1, dtype=torch.float64, n_areas=500, sat_args=dict(storageInit=0.0, dataStorageCapacity=1e13))
    td, ahead = scan(env, 3)[0], {}
    with env.record(("r_BN_P",), every=10) as recording:
        for _ in range(30):
            areas, time = td["observation"][:, 12:48].unflatten(-1, (4, len(PROPS))), env.satellite.simulator.sim_time
            place = env.satellite.find_next_opportunities(4, "area").place
            for e, k in ((areas[..., 0] > 0.0) & (areas[..., 1] < 1.0)).nonzero().tolist():  # not open yet, and within an orbit
                _, closes, _, _, gain, offset, *_ = areas[e, k].tolist()
                ahead[e, int(place[e, k])] = gain, offset, 5700.0 * closes + float(time[e])
            td, _ = scan(env, 1, td)
    scenario, end = env.scenario, float(env.satellite.simulator.sim_time[0])
    over = [(at, *values[:2]) for at, values in ahead.items() if values[2] < end - 30.0]
    found = [float(scenario.covered()[at]) for at, *_ in over]
    gains, offsets = (np.array(column) for column in list(zip(*over, strict=True))[1:])
    # the track is no great circle: a row of cells more or less, of areas of 3 to 50 cells
    assert len(over) > 25
    assert np.abs(gains - found).mean() < 0.02
    assert np.corrcoef(gains, found)[0, 1] > 0.99
    flown = []
    for (e, area), *_ in over:
        r, index = recording.of(e)["r_BN_P"].numpy(), scenario.index[e, area]
        center, reach = scenario.center[index].numpy(), float(scenario.reach[index])
        k = int((r @ center / np.linalg.norm(r, axis=1))[1:-1].argmax()) + 1
        left = np.cross(r[k - 1], r[k + 1])
        flown.append(left @ center / np.linalg.norm(left) / reach)
    assert np.abs(offsets - flown).max() < 0.02


def test_the_outlook_spreads_what_windows_bring():
    """Integrals by intervals, against sums over the windows themselves."""
    spec = (AreaProperties(n_ahead_observe=9), AreaOutlook((60.0, 500.0, 1500.0), n_areas=9))
    satellite = type("Watcher", (AreaScanner,), {"observation_spec": spec})("A", area_args(), may_see_nothing=True)
    drawn = Areas(round_areas(), 300e3, 500, weights=rand.Uniform())
    env = bsk_torch.SatelliteTasking(satellite, scenario=drawn, rewarder=AreaReward(), num_envs=8, seed=2)
    td = scan(env, 12)[0]
    pays = td["observation"][:, :81].unflatten(-1, (9, len(PROPS)))[..., 6].tolist()
    now, stations = float(env.satellite.simulator.sim_time[0]), env.satellite.find_next_opportunities(6, "ground_station")
    areas, edges = env.satellite.find_next_opportunities(9, "area"), (0.0, 60.0, 560.0, 2060.0)
    overlap = lambda low, high, opens, closes: max(0.0, min(high, closes - now) - max(low, opens - now))
    for e in range(8):
        for k, (low, high) in enumerate(itertools.pairwise(edges)):
            windows = zip(pays[e], areas.open[e].tolist(), areas.close[e].tolist(), strict=True)
            worth = sum(pay * overlap(low, high, opens, closes) / (closes - max(opens, now)) for pay, opens, closes in windows)
            windows = zip(stations.open[e].tolist(), stations.close[e].tolist(), stations.mask[e].tolist(), strict=True)
            in_view = sum(overlap(low, high, opens, closes) for opens, closes, exists in windows if exists) / (high - low)
            assert float(td["observation"][e, 81 + k]) == pytest.approx(worth, abs=1e-5)
            assert float(td["observation"][e, 84 + k]) == pytest.approx(min(in_view, 1.0), abs=1e-5)
    assert (td["observation"][:, 81:] > 0.0).any(0).all()


def test_gain_counts_what_lies_ahead():
    env = make(num_envs=16, seed=3, dtype=torch.float64)
    td, _ = scan(env, 6)
    areas = td["observation"][:, 12:48].unflatten(-1, (4, len(PROPS)))
    inside = areas[..., 0] == 0.0
    assert inside.any()
    for _ in range(2):
        td = env.step(td.set("action", torch.ones(16, dtype=torch.int64)))["next"]  # charging records nothing
        after = td["observation"][:, 12:48].unflatten(-1, (4, len(PROPS)))
    same = (env.satellite.find_next_opportunities(4, "area").place >= 0) & (after[..., 2] == areas[..., 2]) & inside
    assert (after[..., 4] <= areas[..., 4])[same].all()


def test_the_rule_is_better_than_scanning_all_the_time():
    env = make(num_envs=16, time_limit=5700.0)
    policy = baseline("areas", env)
    played = env.rollout(95, policy, break_when_any_done=False, auto_reset=True)
    assert not played["next", "terminated"].any()
    always = scan(make(num_envs=16, time_limit=5700.0), 95)[1]["reward"].sum(1).mean()
    assert played["next", "reward"].sum(1).mean() > 1.3 * always


def test_satellites_that_record_the_same_cells_are_paid_alike():
    listed = random_caps(400, 1e5)
    args = area_args() | dict(oe=rand.random_orbit(a=6900.0), sigma_init=[0.1, 0.2, 0.3], omega_init=[0.0] * 3)
    same = {name: rand.per_env(value.draw(first_key(2))) for name, value in args.items() if isinstance(value, rand.Distribution)}
    team = [AreaScanner(name, args | same, may_see_nothing=True) for name in ("A", "B")]
    env = bsk_torch.ConstellationTasking(
        team, scenario=Areas(listed, 4e5), rewarder=AreaReward(), num_envs=2, seed=0, time_limit=3000.0
    )
    td, total = env.reset(), 0.0
    for _ in range(12):
        td["agents", "action"] = torch.zeros(2, 2, dtype=torch.int64)
        td = env.step(td)["next"]
        assert torch.equal(td["agents", "reward"][:, 0], td["agents", "reward"][:, 1])
        assert torch.equal(td["agents", "observation"][:, 0, 12:], td["agents", "observation"][:, 1, 12:])
        total = total + td["agents", "reward"][:, 0, 0]
    torch.testing.assert_close(total, (env.scenario.weight * env.scenario.covered()).sum(1).float())
    assert (total > 0.0).any()


def team_downlinks(**options):
    """Levels of the stores, [60, 4, 3] bit, of teams that downlink for an hour."""
    env = bsk_torch.make("AreasTeam-v1", num_envs=4, seed=2, env_ids=[0] * 4, sat_args={"storageInit": 2e10}, **options)
    td, levels = env.reset(), []
    for _ in range(60):
        td["agents", "action"] = torch.full((4, 3), 2)
        td = env.step(td)["next"]
        levels.append(env.fleet.each(lambda satellite: satellite.dynamics.storage_level))
    return torch.stack(levels)


def test_a_team_is_paid_once_for_a_cell_and_contends_for_antennas():
    env = bsk_torch.make("AreasTeam-v1", num_envs=4, seed=2)
    assert env.satellites[0].observation_description == make().satellite.observation_description  # policies fit both
    td, total = env.reset(), 0.0
    for _ in range(30):
        td["agents", "action"] = torch.zeros(4, 3, dtype=torch.int64)
        td = env.step(td)["next"]
        total = total + td["agents", "reward"].clamp(min=0.0).sum((1, 2))
    assert (total > 0.0).any()
    torch.testing.assert_close(total, (env.scenario.weight * env.scenario.covered()).sum(1).float())
    many = team_downlinks(world_args={"groundStationsData": [station | {"antennas": 3} for station in DEFAULT_STATIONS]})
    one = team_downlinks()
    assert (one >= many).all()
    assert (one > many + 1e9).any()


def test_a_rule_teaches_satellites_of_which_some_are_dead():
    trained = bsk_torch.train(
        "AreasTeam-v1", num_envs=4, rollout=4, frames=96, imitate="areas", imitation=1.0, episodes=0, quiet=True,
        evaluate_every=0, options={"sat_args": {"storedCharge_Init": rand.Uniform(1.0, 3000.0)}},
    )  # fmt: skip
    assert all(bool(torch.isfinite(weight).all()) for weight in trained.policy.parameters())


def test_the_figure_tells_which_cells_were_recorded(tmp_path):
    env = make(num_envs=1, time_limit=1800.0, n_areas=800)
    episode = record(bsk_torch.rule("areas", env), env, seed=1)
    done = torch.isfinite(episode.recorded_at)
    assert episode.outcome.startswith(f"{int(done.sum())} of {len(done)} cells recorded")
    assert int(done.sum()) == int((env.scenario.memory[RECORDED] >= 0).sum()) > 0
    assert draw(episode, tmp_path / "areas.png").stat().st_size > 10_000


def test_wrong_arguments_are_refused():
    listed = random_caps(3, 1e5)
    plain = ScanningSatellite("A", scanning_args())
    imager = lambda *spec: type("Own", (AreaScanner,), {"observation_spec": spec})("A", area_args())
    ground, seen = scene.UniformNadirScanning(), Areas(listed, 1e5)
    tasking = lambda satellite, scenario, rewarder: bsk_torch.SatelliteTasking(satellite, scenario=scenario, rewarder=rewarder)
    check_refusals(
        refusal(lambda: Areas([], 1e5), ValueError, "areas=[]", "random_caps"),
        refusal(lambda: Areas("x", 1e5), ValueError, "areas='x'"),
        refusal(lambda: Areas(listed, 0.0), ValueError, "swath=0.0", "m"),
        refusal(lambda: Areas(listed, 1e5, 4), ValueError, "n_areas=4", "1 to 3"),
        refusal(lambda: Areas(listed, 1e5, weights=-1.0), ValueError, "weights", "-1"),
        refusal(lambda: Areas(listed, 1e5, revisit=0.0), ValueError, "revisit=0.0", "s"),
        refusal(lambda: AreaReward(at_end=3), ValueError, "at_end=3"),
        refusal(lambda: AreaProperties(dict(prop="gains")), ValueError, "gains", "gain"),
        refusal(lambda: tasking(plain, seen, AreaReward()), ValueError, "AreaScanFSWModel", "ContinuousImagingFSWModel"),
        refusal(lambda: tasking(plain, ground, AreaReward()), ValueError, "Areas", "UniformNadirScanning"),
        refusal(lambda: tasking(imager(AreaProperties()), ground, data.NoReward()), ValueError, "areas", "Areas"),
        refusal(lambda: tasking(imager(AreaOutlook()), ground, data.NoReward()), ValueError, "outlook", "Areas"),
        refusal(lambda: AreaOutlook([60.0, 0.0]), ValueError, "widths=0.0", "s"),
        refusal(lambda: AreaOutlook(n_areas=0), ValueError, "n_areas=0"),
    )  # fmt: skip
    assert tasking(imager(obs.Time()), seen, AreaReward()).reset()["observation"].shape == (1, 1)
