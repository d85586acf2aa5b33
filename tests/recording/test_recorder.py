import numpy as np
import pytest
import torch
from tensordict.nn import TensorDictModule

import bsk_torch
from bsk_torch.env.rollout import play_episodes
from bsk_torch.lab.planners import BeamSearch, Rollout, TreeSearch
from bsk_torch.recording import record
from bsk_torch.recording.recording import decode
from bsk_torch.recording.scenes import quantities
from bsk_torch.rl.policies.files import build_policy, read_card
from bsk_torch.rl.policies.pretrained import pretrained_file
from bsk_torch.rl.policies.shared_policy import rule, shared


def player(env, preset):
    card = read_card(pretrained_file(preset))
    return shared(build_policy(card), env)


def environment(preset, **options):
    return bsk_torch.make(preset, num_envs=1, env_ids=[0], **{**read_card(pretrained_file(preset))["options"], **options})


def plain(env, policy, seed, until):
    """Times, actions of the first group, rewards and final returns of a flight that is not recorded."""
    env.set_seed(seed)
    times, rewards = [0.0], []
    for _, step in play_episodes(env, policy, env.reset()):
        times.append(float(env.fleet.sim_time[0]))
        rewards.append(step["next", "reward"] if "reward" in step["next"] else step["next", "agents", "reward"])
        if times[-1] >= until:
            break
    return times, torch.stack(rewards), env.returns.clone()


@pytest.fixture(scope="module")
def scan():
    env = environment("NadirScan-v1")
    policy = player(env, "NadirScan-v1")
    return env, policy, record(env, policy, seed=3, until=6000.0, preset="NadirScan-v1", label="pretrained")


@pytest.fixture(scope="module")
def team():
    env = environment("Constellation-v1", n_targets=300)
    policy = player(env, "Constellation-v1")
    return env, policy, record(env, policy, seed=1, until=400.0, preset="Constellation-v1")


def hermite(track, times):
    """Positions [M, S, 3] of the satellites between the keyframes, as the page computes them."""
    keys, r, v = track.arrays["key_times"], track.arrays["r_N"].astype("f8"), track.arrays["v_N"].astype("f8")
    k = np.clip(np.searchsorted(keys, times, "right") - 1, 0, len(keys) - 2)
    h = (keys[k + 1] - keys[k])[:, None, None]
    u = (times - keys[k])[:, None, None] / h
    return (
        (1 + 2 * u) * (1 - u) ** 2 * r[k]
        + u * (1 - u) ** 2 * h * v[k]
        + u**2 * (3 - 2 * u) * r[k + 1]
        + u**2 * (u - 1) * h * v[k + 1]
    )


@pytest.mark.parametrize("kind", ["scan", "team"])
def test_recording_leaves_the_episode_as_it_is(kind, request):
    env, policy, recording = request.getfixturevalue(kind)
    track = recording.tracks[0]
    times, rewards, returns = plain(env, policy, recording.scenes[0].seed, track.duration)
    assert track.total == float(returns[0])
    assert times[-1] == track.duration
    assert set(track.arrays["decision_time"]) <= set(times)
    assert float(rewards.double().sum()) == pytest.approx(float(track.arrays["decision_reward"].astype("f8").sum()), abs=1e-5)


@pytest.mark.parametrize("kind", ["scan", "team"])
def test_positions_and_attitudes_between_keyframes(kind, request):
    env, policy, recording = request.getfixturevalue(kind)
    track = decode(recording.encode()).tracks[0]
    env.set_seed(recording.scenes[0].seed)
    with env.record(("r_BN_N", "sigma_BN"), rows=0) as ticks:
        for _ in play_episodes(env, policy, env.reset()):
            if float(env.fleet.sim_time[0]) >= track.duration:
                break
    flown, time = ticks.of(0), ticks.of(0)["time"].numpy()
    r_N, sigma = (flown[name].numpy().reshape(len(time), -1, 3) for name in ("r_BN_N", "sigma_BN"))
    assert np.diff(track.arrays["key_times"]).max() < 60.001
    assert np.linalg.norm(hermite(track, time) - r_N, axis=-1).max() < 1.0
    assert len(sigma) == len(track.arrays["sigma"])
    assert np.abs(track.arrays["sigma"] - sigma).max() < 0.51 / 32767.0


def test_resources_agree_with_the_simulator(scan):
    env, policy, recording = scan
    track = recording.tracks[0]
    env.set_seed(3)
    env.reset()
    seen = [quantities(env.fleet)]
    times = [0.0]
    for _ in play_episodes(env, policy, env.observe()):
        seen.append(quantities(env.fleet))
        times.append(float(env.fleet.sim_time[0]))
        if times[-1] >= track.duration:
            break
    at = np.searchsorted(track.arrays["series_times"], times)
    assert len(track.series) == 5
    for k, series in enumerate(track.series[:3]):
        expected = [float(now[series.name].abs().max()) for now in seen]
        assert np.allclose(track.arrays["series"][at, 0, k], expected, atol=3e-4)


def test_decisions_have_masks_probabilities_and_names(scan):
    _, _, recording = scan
    arrays, craft = recording.tracks[0].arrays, recording.satellites[0]
    chosen = arrays["decision_action"]
    assert np.allclose(arrays["decision_probability"].sum(1), 1.0, atol=1e-3)
    assert (arrays["decision_probability"].argmax(1) == chosen).all()
    assert arrays["decision_mask"][np.arange(len(chosen)), chosen].all()
    assert craft.actions == ["action_nadir_scan", "action_charge", "action_downlink", "action_desat"]
    assert arrays["observation"].shape == (len(chosen), len(craft.observation))
    assert not np.isnan(arrays["observation"]).any()


def told(env, policy, until=300.0):
    """Values of the actions of every decision, [D, A], with the masks."""
    arrays = record(env, policy, seed=2, until=until).tracks[0].arrays
    return arrays["decision_action_value"], arrays["decision_mask"].astype(bool), arrays["decision_action"]


@pytest.mark.parametrize("planner", [Rollout, BeamSearch, TreeSearch])
def test_values_that_a_planner_has_found_are_recorded(planner):
    env = bsk_torch.make("NadirScan-v1", num_envs=1, env_ids=[0], time_limit=600.0)
    values, mask, action = told(env, planner(env, "rule", horizon=200.0))
    assert np.isfinite(values).any(1).all()
    assert not np.isfinite(values[~mask]).any()
    best = np.nanmax(values, 1)
    assert values[np.arange(len(action)), action] == pytest.approx(best)


def test_values_of_a_planner_are_those_of_the_satellite_that_decides():
    env = bsk_torch.make("HeteroCluster-v1", num_envs=1, env_ids=[0], time_limit=300.0)
    planner = Rollout(env, horizon=120.0)
    env.set_seed(2)
    first = planner(env.reset())["action_value"][0]
    values, mask, _ = told(env, planner, 1.0)
    assert len(values) == 3 == len(first)
    assert np.isfinite(values).any(1).all()
    for row, found in zip(values, first, strict=True):
        assert row.tolist() == pytest.approx(found[: mask.shape[1]].tolist(), rel=1e-3, nan_ok=True)


def test_the_ranking_of_a_rule_and_values_of_a_users_policy_are_recorded():
    env = bsk_torch.make("AEOS-v1", num_envs=1, env_ids=[0], time_limit=600.0)
    values, mask, action = told(env, rule("greedy", env))
    ranked = np.isfinite(values).any(1)
    assert ranked.any()
    assert values[ranked][np.arange(ranked.sum()), action[ranked]] == pytest.approx(np.nanmax(values[ranked], 1))

    def decide(mask):
        worth = torch.arange(mask.shape[-1]).expand(mask.shape).float()
        return worth.masked_fill(~mask, -torch.inf).argmax(-1), worth

    policy = TensorDictModule(decide, in_keys=["action_mask"], out_keys=["action", "action_value"])
    values, mask, _ = told(env, policy)
    assert (values[mask] == np.broadcast_to(np.arange(mask.shape[1]), mask.shape)[mask]).all()
    assert np.isnan(values[~mask]).all()


def test_sun_and_earth(scan):
    env, _, recording = scan
    scene, track = recording.scenes[0], recording.tracks[0]
    world = env.fleet.simulators[0].world
    angle = scene.rate * track.duration
    turn = np.array([[np.cos(angle), np.sin(angle), 0.0], [-np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]])
    env.set_seed(3)
    policy = scan[1]
    for _ in play_episodes(env, policy, env.reset()):
        if float(env.fleet.sim_time[0]) >= track.duration:
            break
    assert np.abs(turn @ np.array(scene.PN0).reshape(3, 3) - world.PN[0].numpy()).max() < 1e-5
    assert np.abs(track.arrays["sun_N"][-1] - world.sun_direction_N[0].numpy()).max() < 1e-6


def test_images_are_events(team):
    recording = team[2]
    arrays, track = recording.tracks[0].arrays, recording.tracks[0]
    assert len(arrays["event_time"]) == track.counts["imaged"] > 0
    assert (arrays["decision_target"] >= 0).all()
    chosen = np.arange(len(arrays["decision_action"])), arrays["decision_action"]
    assert (arrays["decision_action_target"][chosen] == arrays["decision_target"]).all()
    paid = arrays["decision_reward"] > 0.0
    opened = arrays["decision_action_opens"][chosen] <= arrays["decision_end"]
    assert opened[paid].mean() > 0.8  # an image as a window closes is paid after the next decision, for the same target
    pairs = set(zip(arrays["decision_satellite"].tolist(), arrays["decision_target"].tolist(), strict=True))
    assert set(zip(arrays["event_satellite"].tolist(), arrays["event_target"].tolist(), strict=True)) <= pairs
    assert recording.scenes[0].arrays["targets_P"].shape == (300, 3)


def test_links_between_satellites(team):
    arrays = team[2].tracks[0].arrays
    assert len(arrays["link_start"])
    assert (arrays["link_a"] < arrays["link_b"]).all()
    assert (arrays["link_start"] <= arrays["link_end"]).all()


def test_death_and_its_cause():
    env = environment("NadirScan-v1")
    track = record(
        env, TensorDictModule(lambda mask: torch.zeros(len(mask), dtype=torch.int64), ["action_mask"], ["action"])
    ).tracks[0]
    assert len(track.deaths) == 1
    assert track.deaths[0].time == track.duration < track.limit
    assert set(track.deaths[0].causes) <= {"battery", "wheel speeds", "full buffer"}
    assert track.deaths[0].causes


@pytest.mark.parametrize(
    ("preset", "name", "places"),
    [
        ("RSOInspection-v1", "survey", "points"),
        ("Services-v1", "angle", "orbit"),
        ("CWInspection-v1", "seek", "points"),
        ("CWDocking-v1", "glide", "none"),
        ("HeteroCluster-v1", "cooperative", "ground"),
        ("AEOSBench-v1", "nearest_task", "ground"),
    ],
)
def test_every_kind_of_preset_is_recorded(preset, name, places):
    env = bsk_torch.make(preset, num_envs=1, env_ids=[0])
    recording = record(env, rule(name, env), seed=2, until=600.0 if preset != "AEOSBench-v1" else 60.0, preset=preset)
    read = decode(recording.encode())
    track = read.tracks[0]
    assert read.places == places
    assert len(track.arrays["decision_time"]) > 0
    assert np.isfinite(track.arrays["r_N"][:, : len(read.satellites)]).any()
    total = track.arrays["decision_reward"].astype("f8").sum()
    assert total == pytest.approx(track.total, abs=1e-4)
