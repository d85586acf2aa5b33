"""Sites: draws, rewards by hand, hidden weather, states, masks, observations, the rule."""

import math

import pytest
import torch

import bsk_torch
from bsk_torch import scene
from bsk_torch.constants import R_EARTH
from bsk_torch.rand import Key, first_key
from bsk_torch.rl.evaluation import evaluate
from bsk_torch.rl.policies.shared_policy import member_view, shared
from bsk_torch.rl.rules.targets import TargetReader
from bsk_torch.rl.training import configure
from bsk_torch.tasks.sites import Sites
from bsk_torch.tasks.sites.rules import CommitRule, commit
from bsk_torch.tasks.sites.scene import BEGUN
from tests.support.refusals import check_refusals, refusal

pytestmark = pytest.mark.compiled

COLUMNS = ("priority", "site_size", "site_done", "site_left", "site_ago", "risk", "site_chance", "site_step", "site_finish")


def make(name="Sites-v1", **options):
    return bsk_torch.make(name, **(dict(num_envs=3, seed=2) | options))


def play(env, steps, policy="commit", td=None):
    """Observations and rewards of a rule."""
    rule, td, played = bsk_torch.rule(policy, env), env.reset() if td is None else td, []
    for _ in range(steps):
        td = env.step(rule(td))["next"]
        played.append(td.select("observation", "reward").clone())
    return td, torch.stack(played, 1)


def seen(env, td):
    """Properties of the images observed, [N, 32] each."""
    reader = TargetReader.of(env)
    return {name: reader.read(td["observation"], name) for name in COLUMNS}


def test_sites_are_grids_of_three_to_six_images():
    values = Sites(200, spacing=50e3, latitude=9.0).draw(first_key(2))
    exists = values["target_exists"].view(2, 200, 6)
    assert torch.equal(exists.sum(2), values["site_size"])
    assert set(values["site_size"].unique().tolist()) == {3.0, 4.0, 5.0, 6.0}
    place = values["target_r_LP_P"].view(2, 200, 6, 3)
    torch.testing.assert_close(place.norm(dim=-1), torch.full((2, 200, 6), R_EARTH, dtype=torch.float64))
    middle = place.mean(2)
    latitude = torch.rad2deg(torch.asin(middle[..., 2] / middle.norm(dim=-1)))
    assert latitude.abs().max() < 9.01
    assert latitude.abs().max() > 8.5
    apart = (place[:, :, [1, 2, 4, 5, 3, 4, 5]] - place[:, :, [0, 1, 3, 4, 0, 1, 2]]).norm(dim=-1)
    torch.testing.assert_close(apart, torch.full_like(apart, 50e3), rtol=1e-4, atol=0.0)  # sphere and chord: (50 / 6378)^2 / 12
    value = values["target_priority"].view(2, 200, 6)
    assert torch.equal(value, value[..., :1] * exists)
    assert value[exists > 0].min() >= 0.2


def test_forecasts_are_probabilities():
    values = Sites(20_000, risk=0.5).draw(first_key(1))
    risk, cloudy = values["image_risk"][0], 1.0 - values["image_clear"][0]
    assert float(risk.max()) <= 0.5
    for low, high in ((0.0, 0.05), (0.05, 0.2), (0.2, 0.5)):
        part = (risk >= low) & (risk < high)
        wide = 4.0 * float((risk[part] * (1.0 - risk[part])).mean() / part.sum()) ** 0.5  # four standard errors
        assert abs(float(cloudy[part].mean() - risk[part].mean())) < wide
    clear = Sites(50, risk=0.0).draw(first_key(1))
    assert clear["image_clear"].all()


def test_gains():
    part = torch.tensor([0.0, 0.2, 0.4, 0.55, 0.7, 0.85, 1.0], dtype=torch.float64)
    convex = torch.tensor([0.0, 0.05, 0.1, 0.25, 0.4, 0.7, 1.0], dtype=torch.float64)
    torch.testing.assert_close(Sites(1, gain="convex").gain(part), convex)
    assert Sites(1).gain(part).tolist() == [0.0] * 6 + [1.0]


def linked(gain, size, clear, satellites=1):
    """A rewarder of an environment with two sites whose first has ``size`` images, of value 0.5, in the weather ``clear``."""
    name, more = ("SitesTeam-v1", {"n_satellites": satellites}) if satellites > 1 else ("Sites-v1", {})
    env = make(name, num_envs=1, scenario=Sites(2, gain=gain), **more)
    env.reset()
    state = env.fleet.scenario_state
    state["site_size"][0, 0] = size
    state["target_exists"][0, :6] = (torch.arange(6) < size).double()
    state["target_priority"][0, :6] = 0.5 * (torch.arange(6) < size)
    state["image_clear"][0, :6] = torch.tensor(clear, dtype=torch.float64)
    env.scenario.begin_episodes(torch.tensor([0]))
    return env


@pytest.mark.parametrize(
    ("gain", "pays"),
    [("convex", [0.5 * 4 * 0.0625, 0.0, 0.5 * 4 * (0.2 - 0.0625), 0.5 * 4 * (0.5 - 0.2)]), ("complete", [0.0, 0.0, 0.0, 0.0])],
)
def test_images_pay_what_they_add(gain, pays):
    """Four images, the second under clouds: by hand, gain(1/4) = 0.0625, gain(1/2) = 0.2, gain(3/4) = 0.5."""
    env = linked(gain, 4, [1, 0, 1, 1, 0, 0])
    reward = env.rewarder
    taken = torch.tensor([[True]])
    got = [float(reward.value(torch.tensor([[k]]), taken)) for k in range(4)]
    torch.testing.assert_close(torch.tensor(got), torch.tensor(pays))
    assert float(reward.value(torch.tensor([[0]]), taken)) == 0.0  # a second image of the same place
    assert int(reward.counts()["cloudy"]) == 1
    assert env.scenario.done[0, 0] == 3.0
    assert env.scenario.memory[BEGUN][0].tolist() == [0.0, -1.0]


def test_complete_sites_pay_all_at_the_last_image():
    reward = linked("complete", 3, [1] * 6).rewarder
    got = [float(reward.value(torch.tensor([[k]]), torch.tensor([[True]]))) for k in range(3)]
    assert got == [0.0, 0.0, 1.5]
    assert reward.measures()["sites_complete"].tolist() == [1.0]


def test_satellites_share_what_any_of_them_adds():
    env = linked("convex", 4, [1] * 6, satellites=3)
    reward = env.rewarder
    taken = torch.ones(1, 3, dtype=torch.bool)
    got = reward.value(torch.tensor([[0, 0, 1]]), taken)  # two of four images, the first of them by two satellites
    torch.testing.assert_close(got, torch.full((1, 3), 0.4 / 3.0, dtype=torch.float64))
    assert not env.scenario.open[0, :2].any()
    assert env.scenario.open[0, 2:4].all()
    assert not env.rewarder.selectable()[0, :, 0].any()


def test_sites_close_when_they_cannot_pay_or_are_late():
    env = linked("complete", 4, [1, 0, 1, 1, 0, 0])
    taken = torch.tensor([[True]])
    assert env.scenario.open[0, :6].tolist() == [True] * 4 + [False] * 2
    env.rewarder.value(torch.tensor([[0]]), taken)
    assert env.scenario.open[0, :4].tolist() == [False, True, True, True]
    env.scenario.memory[BEGUN][0, 0] = -0.5 - env.scenario.within
    assert not env.scenario.open[0, :4].any()
    env.scenario.memory[BEGUN][0, 0] = 0.0
    env.rewarder.value(torch.tensor([[1]]), taken)  # clouds: it can never be complete
    assert not env.scenario.open[0, :4].any()


def test_redrawn_weather_keeps_what_has_shown_itself():
    env = make(num_envs=2, scenario=Sites(300, risk=0.9))
    play(env, 30)
    scenario, rows = env.scenario, torch.tensor([1])
    before, shot = scenario.drawn("image_clear").clone(), scenario.shot[1]
    assert 10 < int(shot.sum()) < 31
    draws = torch.cat(
        [
            scenario.redraw(rows, Key(torch.tensor([k]), *[torch.zeros(1, dtype=torch.int64)] * 2), torch.zeros(1))["image_clear"]
            for k in range(200)
        ]
    )
    assert torch.equal(draws[:, shot], before[1, shot].expand(200, -1))
    other = ~shot
    torch.testing.assert_close(1.0 - draws[:, other].mean(0), scenario.drawn("image_risk")[1, other], atol=0.17, rtol=0.0)
    scenario.draw_again(rows, Key(torch.tensor([5]), *[torch.zeros(1, dtype=torch.int64)] * 2), env.fleet.sim_time[rows])
    after = scenario.drawn("image_clear")
    assert torch.equal(after[0], before[0])
    assert not torch.equal(after[1], before[1])
    assert torch.equal(after[1, shot], before[1, shot])


def test_episodes_do_not_depend_on_the_batch():
    several, alone = make(num_envs=4), make(num_envs=1)
    (_, many), (_, one) = play(several, 25), play(alone, 25)
    assert all(torch.equal(many[key][:1], one[key]) for key in ("observation", "reward"))
    assert (many["reward"] > 0.0).any()
    assert not torch.equal(several.scenario.drawn("image_risk")[0], several.scenario.drawn("image_risk")[1])


def test_restored_states_go_on_alike():
    env = make()
    td, _ = play(env, 12)
    state = env.get_state()
    _, first = play(env, 8, td=td.clone())
    env.restore(state)
    _, again = play(env, 8, td=td.clone())
    assert torch.equal(first["observation"], again["observation"])
    assert torch.equal(first["reward"], again["reward"])
    assert env.scenario.shot.any()


def test_observations_tell_what_is_known():
    env = make(num_envs=2)
    td, _ = play(env, 20)
    see = seen(env, td)
    opportunities = env.satellite.find_next_opportunities(32, "target")
    exists, image, scenario = opportunities.mask, opportunities.place, env.scenario
    site = image // 6
    for name, table in (("site_size", scenario.drawn("site_size")), ("site_done", scenario.done)):
        torch.testing.assert_close(see[name], table.gather(1, site).float())
    torch.testing.assert_close(see["risk"], scenario.drawn("image_risk").gather(1, image).float())
    assert (see["site_left"][exists] >= 1.0).all()
    assert (see["site_done"] + see["site_left"] <= see["site_size"]).all()
    assert (see["site_finish"] >= see["site_step"] - 1e-5).all()
    ago = env.fleet.sim_time.unsqueeze(1) - scenario.memory[BEGUN].gather(1, site)
    begun = scenario.memory[BEGUN].gather(1, site) >= 0.0
    torch.testing.assert_close(see["site_ago"], torch.where(begun, ago, 0.0).float(), atol=1e-3, rtol=1e-5)
    assert not scenario.shot.gather(1, image)[exists].any()
    rule = CommitRule.of(env)
    best = TargetReader.of(env).read(td["observation"], "commit_worth").argmax(1)
    assert torch.equal(rule.decide(td["observation"], td["action_mask"]), best)
    code = TargetReader.of(env).rows(td["observation"])[..., -8:]
    same = (site.unsqueeze(2) == site.unsqueeze(1)) & exists.unsqueeze(1) & exists.unsqueeze(2)
    match = (code.unsqueeze(2) * code.unsqueeze(1)).sum(-1)
    assert (match[same] == 8.0).all()
    assert (match[~same & exists.unsqueeze(1)] < 8.0).float().mean() > 0.9


def test_images_left_are_those_with_windows_to_come():
    """Also if they are far behind those observed."""
    env = make(num_envs=2, scenario=Sites(300, risk=0.0))
    td, _ = play(env, 20)
    see, far = seen(env, td), env.satellite.find_next_opportunities(200, "target")
    to_come = torch.zeros(2, 1800, dtype=torch.bool).scatter(1, far.place, far.mask)
    soon = env.satellite.find_next_opportunities(32, "target").place
    counted = to_come.unflatten(1, (-1, 6)).sum(2).gather(1, soon // 6).float()
    assert torch.equal(see["site_left"], counted)


def test_margins_and_places_of_the_others_that_are_left():
    """By hand, image by image: the k-th of the others to close must be taken k times 21.4 s after this one."""
    env = make(num_envs=2)
    td, _ = play(env, 20)
    reader, satellite = TargetReader.of(env), env.satellite
    margin, others = reader.read(td["observation"], "site_margin"), reader.read_vector(td["observation"], "site_others")
    near, far = satellite.find_next_opportunities(32, "target"), satellite.find_next_opportunities(64, "target")
    aims, places = satellite.aims(near, None), satellite.aims(far, None)[..., :3]
    assert (margin < 0.0).any()
    assert (margin > 0.0).any()
    for n in range(2):
        now, windows = float(env.fleet.sim_time[n]), list(zip(far.place[n].tolist(), far.close[n].tolist(), strict=True))
        for i, place in enumerate(near.place[n].tolist()):
            taken = max(float(near.open[n, i]), now + 60.0 * float(aims[n, i, 3]) ** 0.5)
            left = [k for k, (other, _) in enumerate(windows) if other // 6 == place // 6]
            closes = [windows[k][1] for k in left if windows[k][0] != place]
            latest = min([float(near.close[n, i]), *(close - 21.4 * (k + 1) for k, close in enumerate(closes))])
            assert margin[n, i] == pytest.approx(latest - taken, abs=1e-3)
            torch.testing.assert_close(others[n, i].double(), places[n, left].mean(0) - aims[n, i, :3], rtol=1e-5, atol=0.1)


def test_the_rule_finishes_more_sites_than_rules_that_rank_images():
    found = {}
    for name in ("commit", "hasty", "random"):
        env = make(num_envs=8, env_ids=[0] * 8)
        found[name] = evaluate(bsk_torch.rule(name, env), env, seeds=range(8))
    assert found["commit"].measures["sites_complete"].mean() > 1.3 * found["hasty"].measures["sites_complete"].mean()
    assert found["hasty"].mean_return.mean > 5.0 * found["random"].mean_return.mean
    with_set = make(num_envs=8, env_ids=[0] * 8, as_set=True)
    assert torch.equal(evaluate(bsk_torch.rule("commit", with_set), with_set, seeds=range(8)).returns, found["commit"].returns)


def test_teams_know_all_images():
    env = make("SitesTeam-v1", num_envs=2, seed=1)
    td, rule = env.reset(), bsk_torch.rule("commit", env)
    total = torch.zeros(2)
    for _ in range(25):
        td = env.step(rule(td))["next"]
        total += td["agents", "reward"].sum((1, 2))
    assert td["agents", "observation"].shape == (2, 2, 1165)
    images = env.satellites[0].find_next_opportunities(32, "target")
    assert not env.scenario.shot.repeat_interleave(2, 0).gather(1, images.place)[images.mask].any()
    size, done = env.scenario.drawn("site_size"), env.scenario.done
    value = env.scenario.drawn("target_priority")[:, ::6]
    torch.testing.assert_close(total, (value * size * env.scenario.gain(done / size)).sum(1).float())


def test_teams_observe_what_others_can_take_and_are_about_to():
    """Counted satellite by satellite, image by image, in an episode of each of two teams of three."""
    env = make("SitesTeam-v1", num_envs=2, seed=1, n_satellites=3)
    td, rule = env.reset(), bsk_torch.rule("commit", env)
    for _ in range(20):
        td = env.step(rule(td))["next"]
    satellite, reader = env.satellites[0], TargetReader.of(member_view(env))
    ahead, task = satellite.find_next_opportunities(64, "target"), satellite.task
    windows = [
        dict(list(zip(places, closes, strict=True))[:n])
        for places, closes, n in zip(ahead.place.tolist(), ahead.close.tolist(), ahead.found.tolist(), strict=True)
    ]
    aims = [None if free else int(aim) for free, aim in zip(task.requires_retasking, satellite.latest_target, strict=True)]
    risk, now = env.scenario.drawn("image_risk"), env.fleet.sim_time.tolist()
    for row in range(6):
        team, place = row // 3, ahead.place[row, :32].tolist()
        others = [k for k in range(3 * team, 3 * team + 3) if k != row]
        left = [set().union(*(windows[k] for k in (row, *others))) & set(range(p // 6 * 6, p // 6 * 6 + 6)) for p in place]
        last = [max(windows[k].get(p, -1.0) for k in (row, *others) for p in site) for site in left]
        expected = {
            "claimed": [sum(aims[k] == p for k in others) for p in place],
            "site_claims": [sum(aims[k] is not None and aims[k] // 6 == p // 6 for k in others) for p in place],
            "later": [max(0.0, *(windows[k].get(p, now[team]) - now[team] for k in others)) for p in place],
            "team_left": [len(site) for site in left],
            "team_chance": [math.prod(1.0 - float(risk[team, p]) for p in site) for site in left],
            "team_close": [x - now[team] for x in last],
        }
        for name, values in expected.items():
            seen_values = reader.read(td["agents", "observation"][team, row % 3].unsqueeze(0), name)[0]
            torch.testing.assert_close(seen_values, torch.tensor(values).float(), atol=1e-3, rtol=1e-5)
    assert (reader.read(td["agents", "observation"], "site_claims") > 0.0).any()


def test_coordinated_rules_leave_images_to_others():
    env = make("SitesTeam-v1", num_envs=8, seed=3)
    view, td, rule = member_view(env), env.reset(), bsk_torch.rule("commit", env)
    reader, alone = TargetReader.of(view), shared(commit(view, coordinated=False), env)
    doubled = [0, 0]
    for _ in range(25):
        td = env.step(rule(td))["next"]
        agents = td["agents"]
        deciding, claimed = agents["requires_retasking"].squeeze(-1), reader.read(agents["observation"], "claimed")
        best = reader.read(agents["observation"], "commit_worth").argmax(-1)
        for k, policy in enumerate((rule, alone)):
            choice = policy(td.clone())["agents", "action"]
            doubled[k] += int((claimed.gather(-1, choice.clamp(max=31).unsqueeze(-1)).squeeze(-1) > 0.0)[deciding].sum())
            if k == 0:
                assert torch.equal(choice[deciding], best[deciding])
    assert doubled[0] == 0
    assert doubled[1] > 5


def test_trainings_without_options_use_the_recipe():
    one, team = configure("Sites-v1"), configure("SitesTeam-v1")
    assert (one.network, one.imitate, one.options) == ("attention", "commit", {"as_set": True})
    assert (team.network, team.imitate, team.algorithm) == ("attention", "commit", "mappo")
    assert configure("NadirScan-v1").network == "mlp"


def test_refusals():
    check_refusals(
        refusal(lambda: Sites(0), ValueError, "n_sites", 0),
        refusal(lambda: Sites(3, spacing=0.0), ValueError, "spacing"),
        refusal(lambda: Sites(3, latitude=91.0), ValueError, "latitude", 91.0),
        refusal(lambda: Sites(3, risk=1.5), ValueError, "risk", 1.5),
        refusal(lambda: Sites(3, gain="convx"), ValueError, "gain", "convx", "convex"),
        refusal(lambda: Sites(3, within=-1.0), ValueError, "within", -1.0),
        refusal(lambda: make(scenario=scene.UniformTargets(9)), ValueError, "CompletionReward", "UniformTargets"),
        refusal(lambda: bsk_torch.rule("commit", bsk_torch.make("AEOS-v1")), ValueError, "site"),
    )
