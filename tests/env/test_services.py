"""Services-v1: exposures, bookkeeping and penalties, against plain Python."""

from __future__ import annotations

import itertools
import pickle
from typing import Any

import pytest
import torch
from torchrl.envs.utils import step_mdp

import bsk_torch
from bsk_torch import act
from bsk_torch.constants import MU_EARTH
from bsk_torch.presets.nadir_scan import ScanningSatellite, scanning_args, scanning_environment
from bsk_torch.rl.policies.shared_policy import rule
from bsk_torch.tasks.objects import ImageRSO, RSOImageReward, RSOTargets, by_priority_per_second, by_priority_per_second_ahead
from bsk_torch.tasks.objects.candidates import Candidates
from bsk_torch.tasks.objects.outlook import coast
from bsk_torch.tasks.objects.preset import EPISODE, IMAGE, ServicingImager, servicing_catalog
from bsk_torch.tasks.objects.rules import ORDERS, WORTHS, whole_catalog
from bsk_torch.vec3 import Vec3
from tests.tasks.objects.objects import Imager, environment, play

pytestmark = pytest.mark.compiled

TARGETS, CHARGE, DOWNLINK, FIRST = 12, 0, 1, 3


def make(n=3, **options):
    return bsk_torch.make("Services-v1", num_envs=n, **(dict(n_targets=TARGETS, seed=2, dtype=torch.float64) | options))


def everything(env) -> Candidates:
    """All objects of the catalog."""
    number = torch.arange(env.scenario.n_targets).expand(env.num_envs, -1)
    return Candidates(number, torch.ones_like(number, dtype=torch.bool))


def test_the_task_is_that_of_the_study():
    env = bsk_torch.make("Services-v1", num_envs=64, seed=1)
    td = env.reset()
    assert td["observation"].shape == (64, 124)
    assert env.satellite.action_description == [
        *("action_charge", "action_downlink", "action_desat"),
        *(f"image_rso_{k}" for k in range(10)),
    ]
    assert env.options.time_limit == EPISODE
    assert not env.options.terminate_on_time_limit
    assert env.scenario.n_targets == 200
    priority = env.scenario.priority
    assert (priority.sum(1) - 100.0).abs().max() < 1e-12
    assert float(priority.max()) < 1.2
    later = env.scenario.priority_at(torch.full((64,), EPISODE / 2, dtype=torch.float64))
    assert later[0, :9].tolist() == [5.0] * 5 + [10.0] * 3 + [priority[0, 8].item()]
    args = env.satellite.sat_args
    assert torch.allclose(args["oe"][:, 0], torch.tensor(6871e3, dtype=torch.float64))
    assert (args["imageAttErrorRequirement"] == 0.0025).all()
    assert env.satellite.dynamics.sun_hat_H.norm(dim=1).sub(1.0).abs().max() < 1e-6
    period = 2 * torch.pi * (env.satellite.dynamics.semi_major_axis.double() ** 3 / MU_EARTH).sqrt()
    torch.testing.assert_close(env.rewarder.rewarders[0].cooldown, 2.0 * period, rtol=1e-9, atol=0.0)


def played(env, steps: int, seed: int = 0) -> list[dict[str, Any]]:
    """What happens in some random steps: boundaries with levels, images, light, priorities, and what the environment says."""
    generator, td, rows = torch.Generator().manual_seed(seed), env.reset(), []
    scenario, satellite = env.scenario, env.satellite

    def boundary() -> dict[str, Any]:
        every = torch.arange(TARGETS).expand(env.num_envs, -1)
        return dict(
            time=env.fleet.sim_time.tolist(),
            levels=satellite.dynamics.partition_levels.tolist(),
            images=satellite.dynamics.rso_images.tolist(),
            image=(satellite.dynamics.rso_image_time.tolist(), satellite.dynamics.rso_image_quality.tolist()),
            light=scenario.views(satellite, Candidates(every, every >= 0)).target_illumination_factor.tolist(),
            priority=scenario.priority.tolist(),
            pending=scenario.pending.tolist(),
            cooldown=scenario.cooldown_until.tolist(),
        )

    rows.append(boundary())
    for _ in range(steps):
        weight = td["action_mask"].double()
        weight[:, DOWNLINK] *= 3.0
        weight[:, [CHARGE, CHARGE + 2]] *= 0.2
        td = env.step(td.set("action", torch.multinomial(weight, 1, generator=generator).squeeze(1)))["next"]
        rows.append(boundary() | dict(reward=td["reward"].flatten().tolist(), action=env.satellite.task.action.tolist()))
    return rows


class Ledger:
    """The bookkeeping of bsk_rl's branch for one episode: lists of records by target."""

    def __init__(self, share: float, cooldown: float) -> None:
        self.share, self.cooldown = share, cooldown
        self.pending: dict[int, list[tuple[float, float]]] = {}
        self.until: dict[int, float] = {}

    def step(self, old: dict[str, Any], new: dict[str, Any], k: int) -> float:
        """Return the reward of a step; ``k`` is the episode."""
        reward = 0.0
        if new["action"][k] == DOWNLINK and sum(old["levels"][k]) <= 1.0:
            reward -= 1.0
        changes = [b - a for a, b in zip(old["levels"][k], new["levels"][k], strict=True)]
        for target, change in enumerate(changes):
            if change > 0.0:
                success = new["images"][k] > old["images"][k]
                time, quality = (new["image"][0][k], new["image"][1][k]) if success else (new["time"][k], new["light"][k][target])
                self.pending.setdefault(target, []).append((time, quality))
                if quality >= 0.5:
                    reward += (1.0 - self.share) * old["priority"][k][target]
        for target, change in enumerate(changes):
            if change < 0.0:
                time, quality = self.pending[target].pop(0)
                if quality >= 0.5:
                    self.until[target] = max(self.until.get(target, -torch.inf), time + self.cooldown)
                    reward += self.share * old["priority"][k][target]
                else:
                    self.until.pop(target, None)
        return reward


def test_rewards_are_those_of_a_ledger_of_lists():
    """Attempts that fail at the deadline leave images of the quality of that time, so pointing is made hard."""
    hard = dict(imageRateErrorRequirement=0.0004)
    env = make(4, delivery_share=0.3, sat_args=hard, time_limit=18000.0)
    rows = played(env, 90)
    cooldown = env.rewarder.rewarders[0].cooldown.tolist()
    verified = failed = 0
    for k in range(4):
        ledger = Ledger(0.3, cooldown[k])
        for old, new in itertools.pairwise(rows):
            if new["time"][k] < old["time"][k]:
                break
            assert new["reward"][k] == pytest.approx(ledger.step(old, new, k), abs=1e-5)
            assert new["pending"][k] == [len(ledger.pending.get(target, [])) for target in range(TARGETS)]
            waits = [until if until > new["time"][k] else 0.0 for until in new["cooldown"][k]]
            wanted = [ledger.until.get(target, 0.0) for target in range(TARGETS)]
            assert waits == pytest.approx([until if until > new["time"][k] else 0.0 for until in wanted])
        verified += len(ledger.until)
        failed += sum(quality < 0.5 for records in ledger.pending.values() for _, quality in records)
    assert verified > 10


def test_advances_change_when_rewards_come_but_not_their_sum():
    """The priorities rise in between, while images are on board, and some images are never downlinked."""
    episodes = {advance: played_to_the_end(advance) for advance in (0.0, 0.9)}
    late, early = (episode[0].cumsum(0) for episode in episodes.values())
    assert torch.equal(episodes[0.0][1], episodes[0.9][1])
    torch.testing.assert_close(early[-1], late[-1], rtol=0.0, atol=1e-5)
    assert ((early - late) > -1e-5).all()
    assert ((early - late).amax(0) > 0.4).all()
    assert bool((early[-2] - late[-2] > 0.4).any())  # paid back in the last step


def played_to_the_end(advance: float) -> tuple[torch.Tensor, torch.Tensor]:
    """Rewards [T, N] and actions [T, N] of an episode of images, with downlinks and changes of priorities in the middle."""
    env = make(6, advance=advance, time_limit=25_000.0, sat_args=dict(imageRateErrorRequirement=0.0025))
    decide = rule("priority_angle", env)
    td, rewards, actions = env.reset(), [], []
    over = torch.zeros(6, dtype=torch.bool)
    while not bool(over.all()):
        td = env.step(decide(td))
        rewards.append(torch.where(over, 0.0, td["next", "reward"].flatten().double()))
        actions.append(torch.where(over, 0, td["action"]))
        over = over | td["next", "done"].flatten()
        td = step_mdp(td)
    return torch.stack(rewards), torch.stack(actions)


def test_an_image_is_stored_a_tick_after_the_first_valid_one_and_held_afterward():
    env = make(6)
    td = env.reset()
    recording = env.record(("rso_held", "storage"))
    td = env.step(td.set("action", torch.full((6,), FIRST)))["next"]
    recording.stop()
    done = 0
    for k in range(6):
        held, storage = (recording.of(k)[name].flatten().tolist() for name in recording.fields)
        ticks = range(len(held))
        first = next((t for t in ticks if held[t] > 0.0), None)
        if first is None or env.satellite.dynamics.rso_images[k] == 0.0:
            continue
        done += 1
        assert held[first] == 1.0
        assert storage[first] == 0.0
        assert storage[first + 1] == IMAGE
        assert float(env.satellite.dynamics.rso_image_time[k]) == pytest.approx(first + 1)
        assert held[-1] == 10.0
        assert all(b - a in (0.0, 1.0) for a, b in itertools.pairwise(held))
        assert float(td["duration"][k]) == pytest.approx(len(held) - 1)
    assert done >= 2


def test_downlinks_end_with_the_store_and_last_ten_seconds():
    env = make(4, sat_args=dict(storageInit=3 * IMAGE))
    td = env.reset()
    td = env.step(td.set("action", torch.full((4,), DOWNLINK)))["next"]
    assert set(td["duration"].flatten().tolist()) <= {300.0, *map(float, range(10, 300))}
    empty = make(4)
    td = empty.reset()
    for _ in range(2):  # the second one continues the mode
        td = empty.step(td.set("action", torch.full((4,), DOWNLINK)))["next"]
        assert td["duration"].flatten().tolist() == [10.0] * 4
        assert td["reward"].flatten().tolist() == [-1.0] * 4
    td = empty.step(td.set("action", torch.full((4,), CHARGE)))["next"]
    assert td["duration"].flatten().tolist() == [300.0] * 4
    assert td["reward"].flatten().tolist() == [0.0] * 4


class Sender(ScanningSatellite):
    action_spec = (
        act.Scan(duration=60.0),
        act.Downlink(duration=20.0, until_empty=True),
        act.Downlink("always", duration=40.0),
    )


def test_downlinks_of_any_satellite_may_end_with_the_store():
    args = scanning_args() | dict(storageInit=1.5e9, transmitterBaudRate=-1e8)
    world = dict(world_args=dict(gsMinimumElevation=-0.5 * torch.pi))
    env = scanning_environment(Sender("A", args), dict(num_envs=2, seed=0, **world))
    td = env.reset()
    durations = []
    for action in (1, 2, 1, 0, 1, 2):
        td = env.step(td.set("action", torch.full((2,), action)))["next"]
        durations.append(td["duration"][0].item())
    assert durations == pytest.approx([15.0, 40.0, 10.0, 60.0, 10.0, 40.0], abs=1.0)
    assert (env.satellite.memory["empty_downlinks"] >= 1).all()


def test_penalties_of_a_low_battery_and_a_full_store():
    poor = dict(storedCharge_Init=0.05 * 1.8e6, storageInit=50 * IMAGE)
    env = make(2, sat_args=poor, low_battery_penalty=-2.0, full_storage_penalty=-0.5)
    td = env.reset()
    td = env.step(td.set("action", torch.full((2,), CHARGE + 2)))["next"]
    assert td["reward"].flatten().tolist() == [-2.5] * 2
    assert env.rewarder.terms["OperationsPenalty"].flatten().tolist() == [-2.5] * 2


def test_wrong_rewards_are_named():
    with pytest.raises(ValueError, match="give one of them"):
        RSOImageReward(delivery_share=0.5, delivery_reward_fn=lambda record, target: target.priority)
    with pytest.raises(ValueError, match="give one of them"):
        RSOImageReward(cooldown_s=1.0, cooldown_orbits=1.0)
    with pytest.raises(ValueError, match="cooldown_orbits=-1"):
        RSOImageReward(cooldown_orbits=-1.0)
    with pytest.raises(ValueError, match="exposure='later' must be one of"):
        ImageRSO(3, exposure="later")
    with pytest.raises(ValueError, match="give require_illumination_during_hold=False"):
        ImageRSO(3, exposure="first")
    assert servicing_catalog(priority_event=False, n_targets=3).priority_events == ()


# -- several imagers ----------------------------------------------------------------------------------------------------


class Eager(Imager):
    action_spec = (
        act.Charge(duration=100.0),
        act.Downlink(duration=90.0),
        ImageRSO(3, 900.0, 600.0, require_illumination_during_hold=False, exposure="first"),
    )


def test_an_image_whose_hold_another_command_ends_stays_in_the_store_without_quality():
    env = environment(imagers=2, kind=Eager)
    env.reset()
    dynamics = env.satellites[0].dynamics
    moves = torch.ones(2, dtype=torch.bool)
    while not bool((env.fleet.simulators[0].read("rso_open")[::2] > 0.0).any()):
        env.play(
            [torch.tensor([[FIRST - 1, 0]] * 2)] if env.fleet.sim_time[0] == 0.0 else [torch.tensor([[2**31 - 1, 0]] * 2)], moves
        )
        assert env.fleet.sim_time[0] < 900.0
    assert env.scenario.pending.sum() == 0
    assert dynamics.rso_images[::2].tolist() == [0.0, 0.0]
    opened = env.fleet.simulators[0].read("rso_open")[::2].clone()
    play(env, 0, 0)
    assert dynamics.rso_left[::2].tolist() == [1.0, 1.0]
    assert env.scenario.pending.argmax(1).tolist() == (opened - 1.0).tolist()
    assert env.rewarder.memory["rso_product_quality"][:, 0, 0].tolist() == [0.0, 0.0]
    assert env.rewarder.counts()["captured"].tolist() == [[1, 0]] * 2
    for _ in range(3):
        play(env, 1, 0)
    assert env.scenario.pending.sum() == 0
    assert env.rewarder.counts()["delivered"].tolist() == [[1, 0]] * 2


def test_an_episode_that_ends_during_a_hold_counts_the_image():
    env = environment(kind=Eager, time_limit=300.0, rewarder=RSOImageReward(quality_threshold=0.0, delivery_share=0.25))
    env.reset()
    out = play(env, FIRST - 1)
    opened = env.fleet.simulators[0].read("rso_open") > 0.0
    assert opened.all()
    reward = out[next(iter(env.group_map))]["reward"].flatten()
    target = env.satellites[0].memory["rso_target"]
    assert torch.equal(reward, 0.75 * (1.0 + target.double()))


# -- states and rules ---------------------------------------------------------------------------------------------------


def test_a_saved_state_continues_bit_for_bit():
    env, other = make(), make(seed=7)
    played(env, 12)
    saved = pickle.loads(pickle.dumps(env.get_state()))
    other.reset()
    other.restore(saved)

    def on(env) -> list[torch.Tensor]:
        seen = []
        for action in (FIRST, DOWNLINK, FIRST, CHARGE):
            chosen = torch.where(env.satellite.action_mask()[:, action], action, CHARGE)
            outputs = env.play(chosen, torch.ones(3, dtype=torch.bool))
            seen += [outputs["observation"].clone(), outputs["reward"].clone()]
        return seen

    assert all(torch.equal(a, b) for a, b in zip(on(env), on(other), strict=True))


@pytest.mark.parametrize("name", [name for name in (*ORDERS, *WORTHS) if name != "prompt"])
def test_rules_survive_and_deliver(name):
    env = make(3, time_limit=9000.0, n_targets=40, outlook=name in ("candidate_rate_ahead", "prompt_ahead"))
    rule, td = bsk_torch.rule(name, env), env.reset()
    while bool((env.fleet.sim_time < 8500.0).any()) and not bool(td["done"].any()):
        td = env.step(rule(td))["next"]
    assert not env.dead.any()
    assert (env.counts()["captured"] > 10).all()
    assert (env.counts()["delivered"].sum() > 0).all()


def test_rules_over_the_whole_catalog_choose_the_smallest_angle_in_view():
    env = make(8, n_targets=40)
    td = env.reset()
    rule = bsk_torch.rule("angle", env)
    action = rule(td.clone())["action"]
    seen, in_view = whole_catalog(env.scenario, env.satellite)
    for row, chosen in enumerate((-1 - action).tolist()):
        choices = [g for g in range(40) if bool(in_view[row, g])] or list(range(40))
        assert chosen == min(choices, key=lambda g: float(seen.angle_to_target[row, g]))
    other = make(8, n_targets=40, seed=5)
    with pytest.raises(ValueError, match="decides in the environment that it was made for"):
        rule(other.reset())


def test_rules_need_their_actions_and_observations():
    with pytest.raises(ValueError, match="images no targets"):
        bsk_torch.rule("angle", bsk_torch.make("NadirScan-v1", num_envs=1, backend="eager"))
    with pytest.raises(ValueError, match="EO1 images no objects of a catalog; its scenario is UniformTargets"):
        bsk_torch.rule("angle", bsk_torch.make("AEOS-v1", n_targets=100, num_envs=1, backend="eager"))
    with pytest.raises(ValueError, match="nested observations with as_set=True"):
        bsk_torch.rule("angle", make(1, obs_type=dict, backend="eager"))
    assert ServicingImager.action_spec[FIRST].exposure == "first"


def test_candidates_are_observed_as_a_set():
    sets, vectors = make(as_set=True), make()
    td, other = sets.reset(), vectors.reset()
    assert torch.equal(td["observation", "rso_targets", "rows"].flatten(1), other["observation"][:, 14:])
    assert torch.equal(td["observation", "rso_targets", "mask"].bool(), td["action_mask"][:, FIRST:])
    rules = [bsk_torch.rule("candidate_rate", env) for env in (sets, vectors)]
    assert torch.equal(rules[0](td)["action"], rules[1](other)["action"])


def test_candidates_in_the_order_of_priority_per_second():
    """The first one is that of the rule which looks at the whole catalog, and ranks never fall."""
    env = make(16, n_targets=40, order="priority_per_second")
    td = env.reset()
    chosen = bsk_torch.rule("rate", env)(td.clone())["action"]
    first = env.scenario.candidates(env.satellite, 40)
    assert torch.equal(-1 - chosen, first.place[:, 0])
    rank = by_priority_per_second(env.scenario, env.satellite).gather(1, first.place)
    assert first.exists.all()
    assert (rank[:, 1:] >= rank[:, :-1]).all()
    see = td["observation"][:, 14:].view(16, 10, 11)
    lit, turn = see[..., 10] >= 0.5, 40.0 + 90.0 * see[..., 8]
    expected = torch.where(lit & (rank[:, :10] < 0.0), -2.0 * see[..., 0] / turn, rank[:, :10])
    torch.testing.assert_close(rank[:, :10], expected, rtol=1e-9, atol=0.0)
    assert lit.any()


def test_the_outlook_is_what_is_flown():
    """Objects and satellites are where they were expected after the 150 s of a desaturation, without perturbations."""
    env = make(16, n_targets=40)
    td = env.reset()
    at, (r_N, v_N, _) = env.scenario._moment(env.satellite), env.scenario._states_of(env.satellite, everything(env))
    seconds = torch.full_like(r_N[..., 0], 150.0)
    motions = (r_N, v_N, seconds), (at.r_BN_N, at.v_BN_N, seconds[:, 0])
    expected = [coast(Vec3.of(r), Vec3.of(v), t).stack() for r, v, t in motions]
    td = env.step(td.set("action", torch.full((16,), 2)))["next"]
    assert (td["duration"] == 150.0).all()
    assert (env.satellite.dynamics.r_BN_N - expected[1]).norm(dim=-1).max() < 250.0  # the flattening of the Earth
    assert (env.scenario.r_TN_N - expected[0]).norm(dim=-1).max() < 800.0  # that, and eccentricities up to 0.1


def test_images_end_when_and_where_they_are_expected_to():
    env = make(16, n_targets=60, outlook=True, order="priority_per_second_ahead")
    td, policy, rows = env.reset(), bsk_torch.rule("rate_ahead", env), []
    for _ in range(12):
        td = policy(td)
        images = td["action"] < 0
        index = Candidates((-1 - td["action"]).clamp(min=0).unsqueeze(1), images.unsqueeze(1))
        outlook = env.scenario.outlook(env.satellite, index)
        td = env.step(td)["next"]
        seen = env.scenario.views(env.satellite, index)
        done = images & (td["duration"].squeeze(1) < 299.0)
        pairs = (td["duration"].squeeze(1), outlook.expected_duration[:, 0], seen.target_elevation_angle[:, 0])
        rows.append(torch.stack([*pairs, outlook.expected_elevation_angle[:, 0], outlook.expected_in_sight[:, 0]])[:, done])
    flown, expected, end, expected_end, clear = torch.cat(rows, 1)
    assert len(flown) > 100
    assert flown.mean() == pytest.approx(expected.mean(), rel=0.08)
    assert torch.corrcoef(torch.stack([flown, expected]))[0, 1] > 0.8
    assert (end - expected_end).abs().quantile(0.9) < 3.0  # degrees; the orbit turns the satellite by 0.06 degrees in a second
    assert (clear == 1.0).double().mean() > 0.9


def test_the_outlook_is_observed_and_ranks_candidates():
    """The rule that looks at the whole catalog chooses the first candidate, and that for candidates the same."""
    sets, vectors = (make(16, outlook=True, as_set=as_set, order="priority_per_second_ahead") for as_set in (True, False))
    td, other = sets.reset(), vectors.reset()
    assert other["observation"].shape == (16, 14 + 1 + 160)
    assert torch.equal(td["observation", "rso_targets", "rows"].flatten(1), other["observation"][:, 15:])
    chosen = [bsk_torch.rule("candidate_rate_ahead", env)(seen.clone())["action"] for env, seen in ((sets, td), (vectors, other))]
    assert torch.equal(*chosen)
    place = sets.scenario.candidates(sets.satellite, 10).place
    first = -1 - bsk_torch.rule("rate_ahead", sets)(td.clone())["action"]
    assert torch.equal(first, place[:, 0])
    images = chosen[0] >= FIRST
    assert images.any()
    assert torch.equal(place.gather(1, (chosen[0] - FIRST).clamp(min=0).unsqueeze(1)).squeeze(1)[images], first[images])
    every = sets.scenario.outlook(sets.satellite, everything(sets))
    rank = by_priority_per_second_ahead(sets.scenario, sets.satellite)
    good = (every.expected_in_sight > 0.0) & (every.expected_illumination_factor >= 0.5)
    assert torch.equal(good, rank < 0.0)
    torch.testing.assert_close(-rank[good], (sets.scenario.priority / every.expected_duration)[good], rtol=1e-12, atol=0.0)


@pytest.mark.parametrize("images", [0, 20, 50])
def test_the_shield_leaves_actions_that_can_bring_something(images):
    """Images that promise something while the store has room, and downlinks while there is something in it."""
    stored = dict(storageInit=images * IMAGE)
    env = make(16, as_set=True, outlook=True, shielded=True, sat_args=stored)
    td = env.reset()
    rows, legal = td["observation", "rso_targets", "rows"], td["action_mask"]
    promising = rows[..., -1] > 0.0
    assert promising.any()
    assert not promising.all()
    assert torch.equal(legal[:, FIRST:], promising & (images < 50))
    assert torch.equal(legal[:, :FIRST], torch.tensor([True, images > 0, True]).expand(16, -1))


def test_objects_of_infinite_rank_are_no_candidates():
    def nothing(scenario, satellite):
        return torch.full_like(satellite.of_env(scenario.priority), torch.inf)

    scenario = RSOTargets(servicing_catalog(TARGETS, priority_event=False), ["SS1"], order=nothing)
    assert not make(scenario=scenario, backend="eager").reset()["action_mask"][:, FIRST:].any()
