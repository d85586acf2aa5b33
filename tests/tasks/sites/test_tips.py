"""Tip and cue: draws, what is hidden, pay by hand, futures, the time limit, batches, the rule."""

import math

import pytest
import torch

import bsk_torch
from bsk_torch import scene
from bsk_torch.rand import Key, first_key
from bsk_torch.rl.evaluation import evaluate
from bsk_torch.rl.rules.targets import TargetReader
from bsk_torch.rl.training import configure
from bsk_torch.tasks.sites import Sites, Tips
from bsk_torch.tasks.sites.scene import BEGUN
from tests.support.refusals import check_refusals, refusal

pytestmark = pytest.mark.compiled

TAKEN = torch.tensor([[True]])


def make(**options):
    return bsk_torch.make("TipAndCue-v1", **(dict(num_envs=3, seed=2) | options))


def play(env, steps, td=None):
    """Observations and rewards of the rule."""
    rule, td, played = bsk_torch.rule("commit", env), env.reset() if td is None else td, []
    for _ in range(steps):
        td = env.step(rule(td))["next"]
        played.append(td.select("observation", "action_mask", "reward").clone())
    return td, torch.stack(played, 1)


def key(number):
    return Key(torch.tensor([number]), *[torch.zeros(1, dtype=torch.int64)] * 2)


def test_spots_are_active_with_the_probability_of_their_site():
    values = Tips(20_000, spread=80e3).draw(first_key(1))
    risk = values["image_risk"].view(-1, 20_000, 6)
    active = values["image_clear"].view(-1, 20_000, 6)
    assert torch.equal(risk, risk[..., :1].expand_as(risk))
    assert float(risk.min()) >= 0.1
    assert float(risk.max()) <= 0.9
    assert not active[..., 0].any()
    assert torch.equal(values["site_size"], active.sum(2).clamp(min=1.0))
    for low, high in ((0.1, 0.3), (0.3, 0.7), (0.7, 0.9)):
        part = (risk[..., 0] >= low) & (risk[..., 0] < high)
        off, expected = 1.0 - active[part][:, 1:], risk[part][:, 1:]
        wide = 4.0 * float((expected * (1.0 - expected)).mean() / off.numel()) ** 0.5  # four standard errors
        assert abs(float(off.mean() - expected.mean())) < wide
    place = values["target_r_LP_P"].view(-1, 20_000, 6, 3)
    away = (place - place[:, :, :1]).norm(dim=-1)
    assert float(away.max()) < 80e3 * math.sqrt(2.0)
    assert float(away.max()) > 75e3 * math.sqrt(2.0)


def linked(gain, active):
    """An environment with two sites of which the first, of value 0.5, has the active spots ``active``."""
    env = make(num_envs=1, scenario=Tips(2, gain=gain))
    env.reset()
    state = env.fleet.scenario_state
    state["image_clear"][0, 1:6] = torch.tensor(active, dtype=torch.float64)
    state["site_size"][0, 0] = sum(active)
    state["target_priority"][0, :6] = 0.5
    state.touch()
    return env


@pytest.mark.parametrize(
    ("gain", "pays"), [("complete", [0, 0, 0, 0.5 * 4]), ("convex", [0.5 * 4 * x for x in (0.0625, 0.2 - 0.0625, 0.3, 0.5)])]
)
def test_spots_pay_what_they_add(gain, pays):
    """Four active spots: by hand, gain(1/4) = 0.0625, gain(1/2) = 0.2, gain(3/4) = 0.5; the wide look pays nothing."""
    env = linked(gain, [1, 1, 0, 1, 1])
    reward, scenario = env.rewarder, env.scenario
    assert scenario.open[0, :6].tolist() == [True] + [False] * 5
    assert float(reward.value(torch.tensor([[0]]), TAKEN)) == 0.0
    assert scenario.open[0, :7].tolist() == [False, True, True, False, True, True, True]
    assert torch.equal(reward.selectable()[:, 0], scenario.open)
    got = [float(reward.value(torch.tensor([[k]]), TAKEN)) for k in (1, 2, 4)]
    assert scenario.open[0, :6].tolist() == [False] * 5 + [True]
    assert reward.measures()["sites_complete"].tolist() == [0.0]
    got.append(float(reward.value(torch.tensor([[5]]), TAKEN)))
    torch.testing.assert_close(torch.tensor(got), torch.tensor(pays, dtype=torch.float32))
    assert float(reward.value(torch.tensor([[5]]), TAKEN)) == 0.0
    assert reward.measures()["sites_complete"].tolist() == [1.0]
    assert reward.measures()["sites_begun"].tolist() == [1.0]


def test_sites_without_active_spots_pay_nothing():
    env = linked("complete", [0] * 5)
    env.fleet.scenario_state["site_size"][0, 0] = 1.0
    assert float(env.rewarder.value(torch.tensor([[0]]), TAKEN)) == 0.0
    assert not env.scenario.open[0, :6].any()
    assert env.rewarder.measures()["sites_complete"].tolist() == [0.0]


def test_spots_are_confirmed_in_time_only():
    """At the time zero, by the time of the wide look."""
    env = linked("complete", [1, 1, 0, 0, 0])
    scenario, reward = env.scenario, env.rewarder
    reward.value(torch.tensor([[0]]), TAKEN)
    scenario.memory[BEGUN][0, 0] = -scenario.within
    assert scenario.open[0, 1:3].all()
    assert float(reward.value(torch.tensor([[1]]), TAKEN)) == 0.0
    assert scenario.done[0, 0] == 1.0
    scenario.memory[BEGUN][0, 0] = -0.5 - scenario.within  # the look is taken half a second late
    assert not scenario.open[0, :6].any()
    assert float(reward.value(torch.tensor([[2]]), TAKEN)) == 0.0
    assert scenario.done[0, 0] == 1.0


def swapped(env, seed):
    """Draw the hidden values of all episodes again."""
    rows = torch.arange(env.num_envs)
    keys = Key(rows + seed, *[torch.zeros(env.num_envs, dtype=torch.int64)] * 2)
    env.scenario.draw_again(rows, keys, env.fleet.sim_time)


def test_nothing_tells_what_no_look_has_shown():
    """Two episodes that differ in spots not seen look alike to a policy, and to the rule, until a wide look shows them."""
    env, other = make(), make()
    td, _ = play(env, 15)
    play(other, 15)
    swapped(other, 7)
    hidden = other.scenario.drawn("image_clear") != env.scenario.drawn("image_clear")
    assert (hidden.sum(1) > 300).all()
    assert not (hidden & env.scenario.shown_sites.repeat_interleave(6, 1)).any()
    again = other.observe()
    for name in ("observation", "action_mask"):
        assert torch.equal(again[name], env.observe()[name])
    for known in ("size", "risks", "done", "open", "ends"):
        assert torch.equal(getattr(other.scenario, known), getattr(env.scenario, known))
    _, one = play(env, 12, td=td.clone())
    _, two = play(other, 12, td=td.clone())
    assert not torch.equal(one["observation"], two["observation"])


def test_a_wide_look_shows_the_active_spots():
    env = make()
    td, reader, rows = env.reset(), TargetReader.of(env), torch.arange(3)
    images = env.satellite.find_next_opportunities(32, "target")
    assert (images.place[images.mask] % 6 == 0).all()
    for _ in range(12):  # wide looks only
        wide = reader.read(td["observation"], "wide") > 0.5
        place = env.satellite.find_next_opportunities(32, "target").place
        action = reader.read(td["observation"], "commit_worth").masked_fill(~wide, -2.0).argmax(1)
        target = place[rows, action]
        td = env.step(td.set("action", action))["next"]
        seen = env.scenario.shown_sites[rows, target // 6]
        spots = env.scenario.open.unflatten(1, (-1, 6))[rows, target // 6]
        active = env.scenario.drawn("image_clear").unflatten(1, (-1, 6))[rows, target // 6] > 0.5
        assert torch.equal(spots[seen], active[seen])
        assert spots[~seen, 0].all()
        assert not spots[~seen, 1:].any()
        ahead = env.satellite.find_next_opportunities(64, "target")
        assert env.scenario.open.gather(1, ahead.place)[ahead.mask].all()
    assert int(env.scenario.shown_sites.sum()) > 12
    assert (env.scenario.open.unflatten(1, (-1, 6))[..., 1:].sum((1, 2)) > 3).all()


def test_futures_keep_what_has_been_seen():
    env = make(num_envs=2)
    play(env, 30)
    scenario, rows = env.scenario, torch.tensor([1])
    seen = scenario.shown_sites[1].repeat_interleave(6)
    assert 30 < int(seen.sum()) < 1500
    futures = [scenario.redraw(rows, key(k), torch.zeros(1)) for k in range(200)]
    active = torch.cat([future["image_clear"] for future in futures])
    assert torch.equal(active[:, seen], scenario.drawn("image_clear")[1, seen].expand(200, -1))
    spot = ~seen & (torch.arange(1800) % 6 > 0)
    torch.testing.assert_close(1.0 - active[:, spot].mean(0), scenario.drawn("image_risk")[1, spot], atol=0.17, rtol=0.0)
    size = torch.cat([future["site_size"] for future in futures])
    assert torch.equal(size, active.unflatten(1, (-1, 6)).sum(2).clamp(min=1.0))
    before = scenario.drawn("image_clear").clone()
    scenario.draw_again(rows, key(5), env.fleet.sim_time[rows])
    assert torch.equal(scenario.drawn("image_clear")[0], before[0])
    assert not torch.equal(scenario.drawn("image_clear")[1], before[1])


def test_observations_tell_what_is_known():
    env = make()
    td, _ = play(env, 20)
    reader, scenario = TargetReader.of(env), env.scenario
    names = ("wide", "site_size", "site_done", "site_left", "site_step", "site_finish", "site_ago", "risk", "waiting", "priority")
    see = {name: reader.read(td["observation"], name) for name in names}
    ahead = env.satellite.find_next_opportunities(64, "target")
    place, mask = ahead.place[:, :32], ahead.mask[:, :32]
    wide, site = place % 6 == 0, place // 6
    assert torch.equal(see["wide"][mask] > 0.5, wide[mask])
    mean = 5.0 * (1.0 - scenario.drawn("image_risk").gather(1, place))
    active = scenario.drawn("image_clear").unflatten(1, (-1, 6)).sum(2).gather(1, site)
    begun = scenario.memory[BEGUN].gather(1, site)
    now = env.fleet.sim_time.unsqueeze(1)
    expected = {
        "site_size": torch.where(wide, mean, active),
        "site_ago": torch.where(wide, 0.0, now - begun),
        "risk": torch.where(wide, 1.0 - mean / 5.0, 0.0),
        "waiting": ((ahead.place % 6 > 0) & ahead.mask).sum(1, keepdim=True).expand_as(mean),
    }
    for name, values in expected.items():
        torch.testing.assert_close(see[name][mask], values[mask].float(), atol=1e-3, rtol=1e-5)
    look, narrow = mask & wide, mask & ~wide
    assert look.any()
    assert narrow.any()
    assert torch.equal(see["site_left"][look], see["site_size"][look])
    torch.testing.assert_close(see["site_finish"][look], (see["priority"] * see["site_size"])[look])
    assert not see["site_step"][look].any()
    assert not see["site_done"][look].any()
    assert (see["site_done"] + see["site_left"] <= see["site_size"])[narrow].all()
    whole = (see["site_done"] + see["site_left"] == see["site_size"]).float()
    torch.testing.assert_close(see["site_finish"][narrow], (see["priority"] * see["site_size"] * whole)[narrow])
    best = reader.read(td["observation"], "commit_worth").argmax(1)
    assert torch.equal(bsk_torch.rule("commit", env)(td.clone())["action"], best)


def test_margins_end_with_the_time_to_confirm():
    env, shorter = make(), make(scenario=Tips(300, within=60.0))
    td, _ = play(env, 10)
    shorter.restore(env)
    reader = TargetReader.of(env)
    see = [reader.read(each.observe()["observation"], "site_margin") for each in (env, shorter)]
    ago, wide = (reader.read(td["observation"], name) for name in ("site_ago", "wide"))
    place = env.satellite.find_next_opportunities(32, "target").place
    left = (wide < 0.5) & (ago < 60.0) & shorter.scenario.open.gather(1, place)
    assert left.any()
    assert (see[1] <= see[0] + 1e-3)[left].all()
    assert (see[1][left] <= 60.0 - ago[left] + 1e-3).all()


def test_episodes_do_not_depend_on_the_batch():
    several, alone = make(num_envs=4), make(num_envs=1)
    (_, many), (_, one) = play(several, 25), play(alone, 25)
    assert all(torch.equal(many[name][:1], one[name]) for name in ("observation", "reward"))
    assert (many["reward"] > 0.0).any()


def test_the_rule_completes_more_sites_than_rules_that_rank_images():
    found = {}
    for name in ("commit", "hasty", "random"):
        env = make(num_envs=16, env_ids=[0] * 16, as_set=name == "commit")
        found[name] = evaluate(bsk_torch.rule(name, env), env, seeds=range(16)).mean_return.mean
    assert found["commit"] > 1.15 * found["hasty"]
    assert found["hasty"] > 5.0 * found["random"]


def test_trainings_without_options_use_the_recipe():
    configured = configure("TipAndCue-v1")
    assert (configured.network, configured.imitate, configured.options) == ("attention", "commit", {"as_set": True})


def test_refusals():
    check_refusals(
        refusal(lambda: Tips(0), ValueError, "n_sites", 0),
        refusal(lambda: Tips(3, spread=0.0), ValueError, "spread"),
        refusal(lambda: Tips(3, gain="convx"), ValueError, "gain", "convx", "convex"),
        refusal(lambda: make(scenario=Sites(9)), ValueError, "ConfirmationReward", "Sites"),
        refusal(lambda: make(scenario=scene.UniformTargets(9)), ValueError, "ConfirmationReward", "UniformTargets"),
    )
