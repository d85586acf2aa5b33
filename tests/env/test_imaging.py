"""Imaging environments: which target an action means, how its step ends, what is paid and counted, what agents see."""

import math

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import check_env_specs

import bsk_torch
from bsk_torch import SatelliteTasking, act, data, fsw, obs, rand, sats, scene
from bsk_torch.obs.base import ObservationBuilder
from bsk_torch.presets.aeos import agile_args
from bsk_torch.sim.access.windows.table import next_to_close
from tests.support.episodes import begun
from tests.support.refusals import check_refusals, refusal

pytestmark = pytest.mark.compiled

SEARCH_AHEAD = 6
TARGETS = 700


class Imager(sats.ImagingSatellite):
    observation_spec = (
        obs.SatProperties(dict(prop="storage_level_fraction")),
        obs.OpportunityProperties(
            dict(prop="priority"),
            dict(prop="opportunity_open"),
            dict(prop="opportunity_close"),
            dict(fn=lambda satellite, targets: targets.place, name="place"),
            n_ahead_observe=SEARCH_AHEAD,
        ),
        obs.Time(norm=1.0),
    )
    action_spec = (act.Charge(duration=60.0), act.Image(n_ahead_image=SEARCH_AHEAD))
    fsw_type = fsw.ImagingFSWModel


def varied(**attributes):
    return type("Varied", (Imager,), attributes)


def imager(num_envs=4, satellite=Imager, sat_args=None, targets=None, options=None, **settings):
    """Episodes of half an orbit over hundreds of targets."""
    args = agile_args() | dict(imageRateErrorRequirement=0.02, K=7.0, P=35.0) | (sat_args or {})
    args = {name: value for name, value in args.items() if name not in ("omega_max", "servo_P")}
    defaults = dict(time_limit=2850.0, seed=5, dtype=torch.float64, rewarder=data.UniqueImageReward())
    scenario = targets or scene.UniformTargets(TARGETS)
    return SatelliteTasking(satellite("EO", args, **(options or {})), scenario, num_envs=num_envs, **(defaults | settings))


def step(env, action):
    action = torch.as_tensor(action).expand(env.num_envs).clone()
    return env.step(TensorDict({"action": action}, env.batch_size))["next"]


def column(env, td, name, slot=0):
    return td["observation"][:, env.satellite.observation_description.index(f"target.target_{slot}.{name}")]


@pytest.fixture
def num_envs(monkeypatch):
    monkeypatch.setattr(SatelliteTasking, "num_envs", property(lambda env: env.batch_size[0]), raising=False)


pytestmark = [pytest.mark.compiled, pytest.mark.usefixtures("num_envs")]


def test_specs():
    check_env_specs(imager(2), break_when_any_done="both")
    check_env_specs(bsk_torch.make("AEOS-v1", num_envs=2, n_targets=(50, 90), as_set=True, time_limit=600.0))


def test_an_image_pays_its_priority_once_and_ends_the_step():
    """The step ends when the store has grown by one image; the target then disappears, and the counters move on."""
    env = imager(8)
    td = env.reset()
    paid = torch.zeros(8, dtype=torch.float64)
    for _ in range(12):
        worth, place, close = (column(env, td, name) for name in ("priority", "place", "opportunity_close"))
        before, level = env.satellite.imaged.clone(), env.satellite.dynamics.storage_level
        td = step(env, 1)
        taken = env.satellite.imaged > before
        assert torch.equal(env.satellite.dynamics.storage_level - level, taken * 8e6)
        assert torch.equal(td["reward"].squeeze(-1), torch.where(taken, worth, 0.0))
        duration = td["duration"].squeeze(-1)
        running = ~td["done"].squeeze(-1)
        assert (duration[taken & running] < close[taken & running]).all()
        assert torch.equal(duration[~taken & running], torch.ceil(close[~taken & running]))
        assert env.rewarder.imaged.gather(1, place.long().unsqueeze(-1)).squeeze(-1)[taken].all()
        seen = torch.stack([column(env, td, "place", k) for k in range(SEARCH_AHEAD)], 1)
        assert not (seen == place.unsqueeze(-1))[taken].any()
        paid += td["reward"].squeeze(-1)
        if not running.all():
            break
    env.check_finite()
    assert env.satellite.imaged.sum() > 8
    assert torch.equal(env.rewarder.imaged.sum(1), env.satellite.imaged)
    expected = (env.rewarder.imaged * env.scenario.priority).sum(1)
    torch.testing.assert_close(paid, expected, rtol=1e-12, atol=0)
    assert torch.equal(td["counts", "imaged"].squeeze(-1), env.satellite.imaged)


def test_entries_are_told_which_actions_ended_and_why():
    """The decision marks those that an image has ended as well as those that have run out of time."""
    calls = []

    class Noted(act.Image):
        def end(self, mask, decision, event):
            calls.append((mask, decision.retask, event))

    env = begun(imager(8, varied(action_spec=(act.Charge(duration=60.0), Noted(n_ahead_image=SEARCH_AHEAD)))))
    for _ in range(6):
        before = env.satellite.imaged.clone()
        step(env, 1)
        mask, retask, event = calls.pop()
        assert not calls
        assert torch.equal(event, env.satellite.imaged > before)
        assert torch.equal(mask, retask)
        assert mask[event].all()
    assert env.satellite.imaged.sum() > 0


def test_actions_changed_in_place_after_a_step_do_not_reach_the_episodes():
    env = begun(imager(2))
    action = torch.ones(2, dtype=torch.int64)
    env.step(TensorDict({"action": action}, [2]))
    carried_out = env.get_state()
    action.zero_()
    assert (env.get_state() == carried_out).all()


def test_rows_are_what_actions_mean():
    env = imager(4)
    td = env.reset()
    for slot in (3, 0, 5):
        place = column(env, td, "place", slot)
        td = step(env, 1 + slot)
        assert torch.equal(env.satellite.latest_target.double(), place)
        r_P = env.simulator.read("r_LP_P")
        torch.testing.assert_close(r_P, env.scenario.r_LP_P[torch.arange(4), place.long()], rtol=0, atol=0)


def test_missed_windows_are_counted():
    """With an attitude tolerance that is never met every window closes without an image."""
    env = begun(imager(3, sat_args=dict(imageAttErrorRequirement=0.0)))
    for k in range(3):
        td = step(env, 1)
        assert (td["reward"] == 0).all()
        assert env.satellite.missed.tolist() == [k + 1] * 3
    assert (env.satellite.imaged.tolist(), td["counts", "missed"].squeeze(-1).tolist()) == ([0] * 3, [3] * 3)


def test_the_same_target_again_only_waits_on():
    """The second action waits for the window to close: the controller has taken its one image."""
    env = begun(imager(6, rewarder=data.NoReward()))
    step(env, 4)
    once = env.satellite.imaged == 1
    assert once.sum() > 1
    target, begin = env.satellite.latest_target, env.simulator.sim_time
    close = env.satellite.window_of(target)[1]
    td = step(env, act.image_target(torch.where(once, target, env.satellite.find_next_opportunities(1).place.squeeze(1))))
    assert (env.satellite.imaged[once] == 1).all()
    torch.testing.assert_close(td["duration"].squeeze(-1)[once], (torch.ceil(close) - begin)[once], rtol=0, atol=1e-9)


def test_explicit_targets():
    env = imager(4)
    td = env.reset()
    place = column(env, td, "place", 2).long()
    other = begun(imager(4))
    one, two = step(env, act.image_target(place)), step(other, 3)
    for key in ("observation", "reward", "duration"):
        assert torch.equal(one[key], two[key])
    never = int((~torch.isfinite(env.satellite.next_opportunities("target")[1][0])).nonzero()[0])
    with pytest.raises(ValueError, match=f"environment 0 selects target {never}, which has already been imaged"):
        step(env, act.image_target(never))
    with pytest.raises(ValueError, match=f"-1 to -{TARGETS} for a target by its index"):
        step(env, -TARGETS - 1)


def test_longest_durations_and_time_limits_end_steps_without_an_image():
    env = begun(imager(4, satellite=varied(action_spec=(act.Image(SEARCH_AHEAD, max_duration=7.0),))))
    td = step(env, SEARCH_AHEAD - 1)
    assert (td["duration"] == 7.0).all()
    assert env.satellite.missed.tolist() == [0] * 4
    env = begun(imager(4, time_limit=30.0, options=dict(initial_generation_duration=1200.0)))
    td = step(env, SEARCH_AHEAD)
    assert td["truncated"].all()
    assert (td["duration"] == 30.0).all()
    assert env.satellite.missed.tolist() == [0] * 4


def test_equal_intervals():
    """Without variable intervals an image ends no step, but asks for a new task."""
    env = begun(imager(6, options=dict(variable_interval=False), max_step_duration=250.0))
    taken = torch.zeros(6, dtype=torch.bool)
    for _ in range(4):
        before = env.satellite.imaged.clone()
        td = step(env, 1)
        new = env.satellite.imaged > before
        assert (td["duration"] == 250.0).all()
        assert env.requires_retasking[new].all()
        taken |= new
    assert taken.any()


def test_mask_of_repeated_targets():
    spec = act.Charge(duration=60.0), act.Image(SEARCH_AHEAD, mask_repeated=True, mask_late=False)
    env = imager(3, satellite=varied(action_spec=spec),
                 targets=scene.UniformTargets(20), time_limit=600.0,
                 options=dict(max_generation_duration_beyond_initial=6000.0))  # fmt: skip
    td = env.reset()
    found = env.satellite.find_next_opportunities(SEARCH_AHEAD).found
    assert torch.equal(td["action_mask"].sum(1), 1 + found)
    assert (imager(3).reset()["action_mask"]).all()


def test_fewer_windows_than_slots_repeat_the_last():
    env = imager(5, targets=scene.UniformTargets(150), options=dict(max_generation_duration_beyond_initial=0.0))
    td = env.reset()
    ahead = env.satellite.find_next_opportunities(SEARCH_AHEAD)
    assert (ahead.found < SEARCH_AHEAD).any()
    for row in range(5):
        k = int(ahead.found[row])
        assert (ahead.place[row, k:] == ahead.place[row, k - 1]).all()
        assert ahead.mask[row].tolist() == [True] * k + [False] * (SEARCH_AHEAD - k)
    assert torch.equal(column(env, td, "place", SEARCH_AHEAD - 1).long(), ahead.place[:, -1])


def test_different_numbers_of_targets_in_a_batch():
    env = begun(imager(12, targets=scene.UniformTargets((40, 400))))
    exists = env.scenario.available
    assert len(set(exists.sum(1).tolist())) > 6
    windows = env.satellite.opportunities("target")
    known = torch.isfinite(windows.close)
    assert exists.gather(1, windows.place)[known].all()
    step(env, 2)


def test_one_alone_equals_one_of_many():
    """Bit for bit, whatever the others do, over resets and a pool."""
    plan = torch.randint(0, SEARCH_AHEAD + 1, (9, 40), generator=torch.Generator().manual_seed(1))
    many = imager(40, time_limit=900.0)
    td = many.reset()
    alone = {i: imager(1, time_limit=900.0, env_ids=[i]) for i in (0, 17)}
    ones = {i: env.reset() for i, env in alone.items()}
    assert len(plan) == 9
    for action in plan:
        td = many.step(TensorDict({"action": action}, [40]))["next"]
        for i, env in alone.items():
            ones[i] = env.step(TensorDict({"action": action[i : i + 1]}, [1]))["next"]
            for key in ("observation", "reward", "duration", "done"):
                assert torch.equal(ones[i][key][0], td[key][i]), (i, key)
        ends = td["done"]
        if ends.any():
            many.reset(TensorDict({"_reset": ends}, [40]))
            for i, env in alone.items():
                if ends[i]:
                    env.reset()


def test_saving_and_restoring():
    env = begun(imager(5))
    for action in (1, 2, 1):
        step(env, action)
    state = env.get_state()
    first = [step(env, action) for action in (1, 3, 1)]
    counts = env.satellite.imaged.clone(), env.rewarder.imaged.clone()
    other = begun(imager(5))
    other.reset(TensorDict({"state": state}, other.batch_size), set_state=True)
    second = [step(other, action) for action in (1, 3, 1)]
    for a, b in zip(first, second, strict=True):
        assert all(torch.equal(a[key], b[key]) for key in ("observation", "reward", "duration"))
    assert torch.equal(other.satellite.imaged, counts[0])
    assert torch.equal(other.rewarder.imaged, counts[1])


def test_partial_resets_keep_what_others_have_imaged():
    env = begun(imager(4))
    for _ in range(4):
        step(env, 1)
    imaged, counts = env.rewarder.imaged.clone(), env.satellite.imaged.clone()
    mask = torch.tensor([[True], [False], [False], [True]])
    env.reset(TensorDict({"_reset": mask}, [4]))
    assert env.rewarder.imaged[0].sum() == env.rewarder.imaged[3].sum() == 0
    assert torch.equal(env.rewarder.imaged[1:3], imaged[1:3])
    assert env.satellite.imaged.tolist() == [0, *counts[1:3].tolist(), 0]
    assert env.satellite.latest_target[[0, 3]].tolist() == [-1, -1]


def test_full_store():
    """A store that holds one image: the second action waits until its window closes, and pays nothing."""
    env = begun(imager(6, sat_args=dict(dataStorageCapacity=8e6)))
    paid = torch.stack([step(env, 1)["reward"].squeeze(-1) for _ in range(8)])
    assert (env.satellite.imaged <= 1).all()
    assert env.satellite.imaged.any()
    assert ((paid > 0).sum(0) == env.satellite.imaged).all()


def test_rolling_look_ahead_stays_bounded():
    """Without a time limit windows are generated as they are needed, and forgotten when they have closed."""
    env = begun(imager(3, time_limit=float("inf")))
    widths = []
    for _ in range(40):
        step(env, 1)
        widths.append(env.simulator.access.windows["target"].close.shape[1])
    assert float(env.simulator.sim_time.min()) > 3000.0
    assert max(widths) < 150
    assert (env.simulator.access.ready >= env.simulator.sim_time).all()


def test_queries():
    env = begun(imager(3))
    every, coming = env.satellite.opportunities("target"), env.satellite.upcoming_opportunities("target")
    assert torch.equal(every.close, coming.close)
    step(env, 1)
    now = env.simulator.sim_time
    coming = env.satellite.upcoming_opportunities("target")
    assert (coming.close[torch.isfinite(coming.close)] > 0).all()
    assert (coming.close >= now.unsqueeze(-1)).all()
    assert not env.rewarder.imaged.gather(1, coming.place)[torch.isfinite(coming.close)].any()
    opens, close = env.satellite.next_opportunities("target")
    first = env.satellite.find_next_opportunities(1)
    assert torch.equal(close.amin(1), first.close.squeeze(1))
    assert torch.equal(opens.gather(1, first.place), first.open)
    known = env.satellite.opportunities_dict(1, upcoming=True)
    assert sum(len(windows) for windows in known.values()) == int(torch.isfinite(coming.close[1]).sum())
    assert next_to_close(env.simulator.access.windows["target"], now, env.simulator.access.until, 1, None)[0].close.shape == (
        3,
        1,
    )
    check_refusals(refusal(lambda: env.satellite.find_next_opportunities(3, "targets"), ValueError, "'target'"))


def test_access_filters_of_users():
    """Only targets of the northern hemisphere."""
    env = imager(3)
    env.satellite.add_access_filter(lambda: env.scenario.r_LP_P[..., 2] > 0.0)
    env.reset()
    ahead = env.satellite.find_next_opportunities(SEARCH_AHEAD)
    assert (ahead.r_LP_P[..., 2] > 0.0).all()


def test_composed_rewards_keep_their_terms():
    """bsk_rl's composition loses the filter of imaged targets; here it stays."""
    drain = data.ResourceReward(-1.0, lambda satellite: satellite.dynamics.storage_level_fraction)
    env = begun(imager(4, rewarder=data.ComposedReward(data.UniqueImageReward(), drain)))
    for _ in range(4):
        td = step(env, 1)
        terms = env.rewarder.terms
        total = terms["UniqueImageReward"] + terms["ResourceReward"]
        torch.testing.assert_close(td["reward"], total, rtol=1e-12, atol=1e-15)
    assert env.satellite.imaged.any()
    assert torch.equal(env.rewarder.imaged.sum(1), env.satellite.imaged)
    assert td["counts", "duplicates"].sum() == 0


@pytest.mark.parametrize("compat", [None, "bsk_rl"])
def test_composed_rewards_lose_their_filter_in_bsk_rl(compat):
    rewards = data.ComposedReward(data.UniqueImageReward(), data.ResourceReward(0.0, lambda sat: sat.dynamics.storage_level))
    env = begun(imager(4, rewarder=rewards, compat=compat))
    for _ in range(4):
        step(env, 1)
    assert env.rewarder.imaged.any()
    allowed = env.satellite.allowed("target")  # None: all of them
    assert allowed is None if compat else torch.equal(allowed, ~env.rewarder.imaged)


def test_clouds_hide_what_is_below():
    """Of two equal targets one is overcast: only the clear one pays, and both disappear."""
    clouds = scene.CloudyTargets(scene.UniformTargets(TARGETS), cover=rand.Uniform(0.0, 1.0))
    env = begun(imager(8, targets=clouds, rewarder=data.CloudFreeImageReward(threshold=0.5)))
    paid = 0.0
    for _ in range(8):
        paid += float(step(env, 1)["reward"].sum())
    imaged, cover = env.rewarder.imaged, env.scenario.cloud_cover
    expected = float((imaged & (cover <= 0.5)).mul(env.scenario.priority).sum())
    assert paid == pytest.approx(expected, rel=1e-12)
    covered = env.rewarder.memory["covered"]
    assert torch.equal(covered, (imaged & (cover > 0.5)).sum(1, keepdim=True))
    assert covered.any()


def test_wildfires_pay_what_was_seen_at_the_decision():
    env = imager(6, targets=scene.Wildfires(600), options=dict(may_see_nothing=True))
    td = env.reset()
    for _ in range(6):
        worth = column(env, td, "priority")
        before = env.satellite.imaged.clone()
        td = step(env, 1)
        taken = env.satellite.imaged > before
        torch.testing.assert_close(td["reward"].squeeze(-1), torch.where(taken, worth, 0.0), rtol=0, atol=0)


def test_geometry_of_targets():
    """What presets say of a target, from definitions in the inertial frame."""
    names = ("r_LB_H", "target_angle", "target_angle_rate", "opportunity_mid", "opportunity_open", "opportunity_close", "r_LP_P")
    seen = obs.OpportunityProperties(*(dict(prop=name) for name in names), n_ahead_observe=3)
    env = begun(imager(4, satellite=varied(observation_spec=(seen,))))
    td = step(env, 1)
    description = env.satellite.observation_description
    model, world = env.satellite.dynamics, env.simulator.world
    c_N = (model.BN.mT @ torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)).squeeze(-1)
    for k in range(3):
        value = {
            n: td["observation"][:, [j for j, d in enumerate(description) if d.split("[")[0] == f"target.target_{k}.{n}"]]
            for n in names
        }
        r_LP_N = (world.PN.mT @ value["r_LP_P"].unsqueeze(-1)).squeeze(-1)
        rho = r_LP_N - model.r_BN_N
        hill = (model.HN @ rho.unsqueeze(-1)).squeeze(-1)
        torch.testing.assert_close(value["r_LB_H"], hill, rtol=0, atol=1e-3)  # m; the Earth's angle is rounded to 1e-11 rad
        angle = torch.acos((rho * c_N).sum(-1) / rho.norm(dim=-1))
        torch.testing.assert_close(value["target_angle"].squeeze(-1), angle, rtol=0, atol=1e-9)
        # the line of sight turns, seen from the turning Earth, because the satellite moves
        v = model.v_BN_N - torch.linalg.cross(world.omega_PN_N, model.r_BN_N)
        turn = -torch.linalg.cross(rho, v) / (rho * rho).sum(-1, keepdim=True)
        omega_BP_N = (model.BN.mT @ model.omega_BN_B.unsqueeze(-1)).squeeze(-1) - world.omega_PN_N
        rate = (omega_BP_N - turn).norm(dim=-1)
        torch.testing.assert_close(value["target_angle_rate"].squeeze(-1), rate, rtol=1e-8, atol=0)
        middle = 0.5 * (value["opportunity_open"] + value["opportunity_close"])
        torch.testing.assert_close(value["opportunity_mid"], middle, rtol=0, atol=1e-9)


def test_sets_and_vectors_say_the_same():
    options = dict(num_envs=3, n_targets=300, seed=2, time_limit=900.0, dtype=torch.float64)
    vector, rows = bsk_torch.make("AEOS-v1", **options), bsk_torch.make("AEOS-v1", as_set=True, **options)
    flat, nested = vector.reset()["observation"], rows.reset()["observation"]
    features = nested["target", "rows"].shape[-1]
    assert torch.equal(flat[:, 12 : 12 + 32 * features], nested["target", "rows"].flatten(1))
    assert nested["target", "mask"].shape == (3, 32)


@pytest.mark.parametrize("compat", [None, "bsk_rl"])
def test_more_targets_are_seen_above_the_horizon(compat):
    counts = []
    for limit in (0.0, 0.3):
        env = begun(imager(2, sat_args=dict(imageTargetMinimumElevation=limit), compat=compat))
        windows = env.satellite.find_windows(3000.0)
        counts.append(int(torch.isfinite(windows.close).sum()))
    assert counts[0] > counts[1] > 5


def test_satellites_that_may_see_nothing_wait():
    pole = scene.Targets([[0.0, 0.0, 6378136.6]], 1.0)
    options = dict(sat_args=dict(oe=rand.random_orbit(i=0.0)), options=dict(may_see_nothing=True))
    env = imager(
        3, targets=pole, satellite=varied(action_spec=(act.Charge(duration=60.0), act.Image(2, mask_repeated=True))), **options
    )
    td = env.reset()
    assert (td["observation"][:, 1:-1] == 0.0).all()
    assert td["action_mask"].tolist() == [[True, False, False]] * 3
    length = env.simulator.arcs.length
    for _ in range(3):
        td = step(env, 1)
        assert (td["duration"] == 600.0).all()
    assert (env.satellite.latest_target.tolist(), env.satellite.missed.tolist()) == ([-1] * 3, [0] * 3)
    assert env.simulator.arcs.length <= length + 3600.0


FEW = scene.Targets([[6378136.6, 0.0, 0.0], [0.0, 6378136.6, 0.0], [-6378136.6, 0.0, 0.0]], 1.0)
"""Places on the equator, of which most windows come after half an orbit."""


@pytest.mark.parametrize("settings", [{}, {"mask_late": False}, {"compat": "bsk_rl"}], ids=str)
def test_windows_after_the_time_limit_are_masked(settings, caplog):
    """Unless that is switched off; one warning for all environments of a kind says that most are late."""
    spec = (act.Charge(duration=60.0), act.Image(4, mask_late=settings.get("mask_late", True)))
    kind = varied(action_spec=spec, observation_spec=(obs.Time(),))
    env = imager(8, kind, targets=FEW, compat=settings.get("compat"))
    mask = env.reset()["action_mask"]
    late = env.satellite.find_next_opportunities(4).open >= 2850.0
    assert late.double().mean() > 0.5
    assert mask[:, 0].all()
    assert torch.equal(mask[:, 1:], torch.ones_like(late) if settings else ~late)
    env.reset()
    env.like(2, torch.arange(2)).reset()
    said = [record.getMessage() for record in caplog.records if "open after the time limit" in record.getMessage()]
    assert len(said) == ("compat" not in settings)
    assert all(("excludes" in words) == (not settings) for words in said)


def test_windows_before_the_time_limit_are_all_offered(caplog):
    assert imager(8).reset()["action_mask"].all()
    endless = imager(8, varied(observation_spec=(obs.Time(),)), targets=FEW, time_limit=math.inf)
    assert endless.reset()["action_mask"].all()
    assert not [record for record in caplog.records if "open after the time limit" in record.getMessage()]


def test_shield_forbids_what_is_dangerous():
    """Two batteries, one nearly empty: in sunlight only charging is legal there."""
    env = bsk_torch.make("AEOSPower-v1", num_envs=24, n_targets=300, seed=1, time_limit=1200.0,
                         sat_args=dict(storedCharge_Init=rand.per_env(torch.tensor([0.1, 0.9] * 12) * 576000.0)))  # fmt: skip
    td = env.reset()
    start, end = env.satellite.next_eclipse()
    sunlit = start < end
    mask = td["action_mask"]
    low = torch.arange(24) % 2 == 0
    assert (sunlit & low).any()
    assert torch.equal(mask[sunlit & low].sum(1), torch.ones_like(mask[sunlit & low].sum(1)))
    assert mask[sunlit & low][:, 0].all()
    fast = env.satellite.dynamics.wheel_speeds_fraction.abs().amax(1) > 0.7
    assert mask[~low & ~fast & sunlit].all()
    free = bsk_torch.make("AEOSPower-v1", num_envs=2, n_targets=300, shielded=False, time_limit=1200.0)
    assert free.reset()["action_mask"].all()


@pytest.mark.parametrize("as_set", [False, True])
def test_vectors_are_the_leaves_of_dictionaries_in_order(as_set):
    env = bsk_torch.make("AEOSPower-v1", num_envs=2, n_targets=300, as_set=as_set, obs_type=torch.Tensor, dtype=torch.float64)
    seen = env.reset()["observation"]
    values = env.satellite.observations.get_dict()
    assert torch.equal(seen, ObservationBuilder.vector(values, torch.float64))
    assert len(env.satellite.observation_description) == seen.shape[1]


def test_rejects_what_does_not_fit_targets():
    def blind(base, *entries, scenario=None):
        kind = type("Blind", (base,), dict(observation_spec=entries, action_spec=(act.Charge(duration=60.0),)))
        return SatelliteTasking(kind("B"), scenario, backend="eager")

    priority = obs.OpportunityProperties(dict(prop="priority"), n_ahead_observe=1)
    stations = lambda: obs.OpportunityProperties(dict(prop="priority"), type="ground_station", n_ahead_observe=1)
    elevated = lambda limit: imager(2, sat_args=dict(imageTargetMinimumElevation=limit), backend="eager")
    sightless = lambda: SatelliteTasking(varied(observation_spec=(obs.Time(),))("E"), backend="eager")
    nadir, targets, clouds = scene.UniformNadirScanning(), scene.UniformTargets(10), data.CloudFreeImageReward
    check_refusals(
        refusal(lambda: blind(sats.AccessSatellite, obs.Time(), scenario=targets), ValueError, "UniformTargets", "Blind"),
        refusal(lambda: imager(1, targets=nadir, backend="eager"), ValueError, "action_image", "EO", "scene.UniformTargets"),
        refusal(sightless, ValueError, "action_image", "E", "scene.UniformTargets"),
        refusal(lambda: blind(sats.Satellite, priority), ValueError, "type='target'", "sats.ImagingSatellite"),
        *(refusal(lambda e=e: elevated(e), ValueError, f"imageTargetMinimumElevation={e:g}") for e in (-0.1, math.pi / 2, 58.0)),
        refusal(lambda: act.Image(0), ValueError, "n_ahead_image=0"),
        refusal(lambda: act.Image(3, max_duration=-1.0), ValueError, "max_duration=-1"),
        refusal(stations, ValueError, "prop='priority'", "'ground_station'"),
        refusal(lambda: clouds(threshold=70), ValueError, "threshold=70"),
        refusal(lambda: imager(1, rewarder=clouds(), backend="eager"), ValueError, "CloudFreeImageReward", "scene.CloudyTargets"),
    )


def test_rejects_targets_that_a_satellite_never_sees():
    pole, equator = scene.Targets([[0.0, 0.0, 6378136.6]], 1.0), dict(oe=rand.random_orbit(i=0.0))
    out_of_reach = lambda: imager(2, targets=pole, sat_args=equator, backend="eager")
    check_refusals(refusal(out_of_reach, RuntimeError, "target", "environments [0]", "imageTargetMinimumElevation"))
