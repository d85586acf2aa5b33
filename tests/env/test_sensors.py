"""ThreeSensors-v1 and Walker4-v1: what is observed, and the rules of teams, against plain Python."""

import itertools
import random
import re

import pytest
import torch

import bsk_torch
from bsk_torch.act import image_target
from bsk_torch.cli.main import app
from bsk_torch.rl.policies.shared_policy import baseline, for_each_group, shared_baselines
from bsk_torch.tasks.objects import RSOTeamState, team_preset
from bsk_torch.tasks.objects.records import AGO, DELIVERED
from bsk_torch.tasks.objects.rules import ORDERS, WORTHS
from bsk_torch.tasks.objects.team_rules import Choices, TeamRule
from tests.support.episodes import begun

pytestmark = pytest.mark.compiled

TARGETS = 20

AHEAD = {"candidate_rate_ahead", "prompt_ahead"}
"""Rules that need the outlook of candidates."""


def sensors(name="Walker4-v1", **options):
    defaults = dict(n_targets=TARGETS, num_envs=2, seed=3, dtype=torch.float64)
    return bsk_torch.make(name, **(defaults | options))


def columns(env, td):
    """Observed numbers of each imager by name, [N, A]."""
    group = next(iter(env.group_map))
    names = env.satellites[0].observation_description
    return dict(zip(names, td[group, "observation"].unbind(-1), strict=True))


def fly(env, steps, rule="local"):
    """Play a rule, and return the last tensordict."""
    policy, td = bsk_torch.rule(rule, env), env.reset()
    for _ in range(steps):
        td = env.step(policy(td))["next"]
    return td


@pytest.mark.parametrize(("name", "peers"), [("ThreeSensors-v1", 2), ("Walker4-v1", 3)])
def test_candidates_are_observed_as_a_set(name, peers):
    """The same numbers as in one vector, by which the same rule decides alike."""
    options = dict(information="radio", order="priority_per_second")
    sets, vectors = sensors(name, as_set=True, **options), sensors(name, **options)
    (group,) = sets.group_map
    td, other = sets.reset(), vectors.reset()
    seen, vector = td[group, "observation"], other[group, "observation"]
    assert torch.equal(seen["rso_targets", "rows"][..., :17].flatten(2), vector[..., 26:196])
    assert torch.equal(seen["rso_targets", "mask"].bool(), td[group, "action_mask"][..., 3:13])
    assert len(seen["peers"].keys()) == peers
    candidates = sets.scenario.candidates(sets.satellites[0], 10)
    in_sight = sets.scenario.in_sight(sets.satellites[0], candidates)
    assert torch.equal(seen["rso_targets", "rows"][..., 17].flatten(0, 1).bool(), in_sight)
    rules = [bsk_torch.rule("candidate_rate", env) for env in (sets, vectors)]
    assert torch.equal(rules[0](td)[group, "action"], rules[1](other)[group, "action"])


@pytest.mark.parametrize(
    ("rule", "outlook", "able", "seconds"),
    [
        ("prompt", False, lambda row: row[9] >= 0.5 and row[17], lambda row: 40.0 + 90.0 * row[7]),
        ("prompt_ahead", True, lambda row: row[20] >= 0.5 and row[21], lambda row: row[18]),
    ],
    ids=["now", "ahead"],
)
def test_prompt_rules_image_what_pays_most_per_second(rule, outlook, able, seconds):
    """Against a loop over the candidates that are lit and in sight now, or when they are imaged."""
    env = sensors("ThreeSensors-v1", information="ideal", num_envs=8, n_targets=60, as_set=True, outlook=outlook)
    td = fly(env, 5, rule)
    (group,) = env.group_map
    decided = bsk_torch.rule(rule, env)(td)[group, "action"]
    names, images = env.satellites[0].action_description, 0
    for e, a in itertools.product(range(8), range(3)):
        legal, action = td[group, "action_mask"][e, a], int(decided[e, a])
        if not legal[:-1].any() or names[action] in ("action_downlink", "action_charge"):
            continue
        rows = td[group, "observation", "rso_targets", "rows"][e, a].tolist()
        worth = {3 + k: row[0] / seconds(row) for k, row in enumerate(rows) if legal[3 + k] and able(row)}
        assert action == (max(worth, key=worth.__getitem__) if worth else names.index("action_desat"))
        images += bool(worth)
    assert images > 0


@pytest.mark.parametrize(("name", "peers"), [("ThreeSensors-v1", 2), ("Walker4-v1", 3)])
def test_the_outlook_is_added_to_the_set(name, peers):
    """With the time, and what the scenario expects of images."""
    options = dict(information="radio", as_set=True, time_limit=1800.0)
    plain, ahead = sensors(name, **options), sensors(name, outlook=True, **options)
    (group,) = ahead.group_map
    seen, other = (fly(env, 3, "prompt")[group, "observation"] for env in (ahead, plain))
    assert torch.equal(seen["rso_targets", "rows"][..., :18], other["rso_targets", "rows"])
    scenario, imagers = ahead.scenario, ahead.satellites[0]
    candidates = scenario.candidates(imagers, 10)
    expected = torch.stack(scenario.outlook(imagers, candidates), -1) / torch.tensor([100.0, 90.0, 1.0, 1.0])
    shown = seen["rso_targets", "rows"].flatten(0, 1)[..., 18:22]
    torch.testing.assert_close(shown, torch.where(candidates.exists.unsqueeze(-1), expected, 0.0))
    assert torch.equal(seen["time"].flatten(), (ahead.fleet.sim_time / 1800.0).repeat_interleave(peers + 1))


@pytest.mark.parametrize("name", ["ThreeSensors-v1", "Walker4-v1"])
def test_a_shield_leaves_out_downlinks_from_an_empty_store(name):
    """Random actions are then never fined."""
    env = sensors(name, shielded=True, time_limit=3000.0)
    (group,) = env.group_map
    downlink = env.satellites[0].action_description.index("action_downlink")
    td, found = env.reset(), set()
    for _ in range(40):
        decides = ~td[group, "action_mask"][..., -1]
        stored = env.satellites[0].dynamics.storage_level.view(decides.shape) > 1.0
        assert torch.equal(td[group, "action_mask"][..., downlink][decides], stored[decides])
        found |= set(stored[decides].tolist())
        td = env.step(bsk_torch.rule("random", env)(td))["next"]
    assert found == {True, False}
    assert not (env.satellites[0].memory["empty_downlinks"] > 0).any()


@pytest.mark.parametrize(
    ("name", "information", "retasking", "width", "actions"),
    [
        ("ThreeSensors-v1", "independent", "conflict", 196, 14),
        ("ThreeSensors-v1", "radio", "conflict", 220, 16),
        ("Walker4-v1", "radio", "conflict", 232, 17),
        ("Walker4-v1", "ideal", "continuous", 196, 14),
    ],
)
def test_teams_play(name, information, retasking, width, actions):
    env = sensors(name, information=information, retasking=retasking, time_limit=2000.0)
    (group,) = env.group_map
    td = env.reset()
    assert td[group, "observation"].shape == (2, len(env.names), width)
    assert td[group, "action_mask"].shape[2] == actions
    played = env.rollout(8, break_when_any_done=False)
    assert torch.isfinite(played[group, "observation"]).all()
    assert (played["next", "duration"] <= 300.0).all()
    busy = ~played["next", group, "requires_retasking"].squeeze(-1)
    may = played["next", group, "action_mask"][..., :-1].any(-1)
    assert bool((may & busy).any()) == (retasking == "continuous")


def test_orbits_are_those_of_the_studies():
    env = begun(sensors("ThreeSensors-v1"))
    elements = env.satellites[0].dynamics.elements
    a, e, i = (part.view(2, 3)[0] for part in (elements.a, elements.e, elements.i))
    assert a.tolist() == pytest.approx([7071e3, 7171e3, 7071e3], rel=1e-9)
    assert e.tolist() == pytest.approx([1e-3] * 3, rel=1e-6)
    assert torch.rad2deg(i).tolist() == pytest.approx([97.0, 70.0, 97.0])
    walker = begun(sensors())
    assert walker.scenario.service_time.tolist() == pytest.approx([11834.8358] * 2, abs=1e-4)


def test_knowledge_of_candidates_and_peers_is_observed():
    """Against loops over records, at the end of some steps."""
    env = sensors(num_envs=2, mixture="LEO")
    td = fly(env, 60)
    seen, scenario, records = columns(env, td), env.scenario, env.scenario.records
    now = env.fleet.sim_time
    r_N, v_N = scenario.imager_states()
    ids, compared = env.satellites[0], 0
    for e, a in itertools.product(range(2), range(4)):
        row = e * 4 + a
        for k, key in enumerate(scenario.candidate_ids(ids, row, 10)):
            if key is None:
                continue
            target = scenario.ids.index(key)
            for name, version in (("capture", 1), ("delivery", DELIVERED)):
                times = [
                    float(records.capture[e, r])
                    for r in range(records.target.shape[1])
                    if records.target[e, r] == target and records.known[e, r, a] >= version
                ]
                prefix = f"rso_targets.rso_targets_{k}.{name}"
                assert seen[f"{prefix}_known"][e, a] == bool(times)
                expected = (float(now[e]) - max(times)) / 12000.0 if times else 0.0
                assert float(seen[f"{prefix}_age"][e, a]) == pytest.approx(expected)
                compared += bool(times)
        peers = [b for b in range(4) if b != a]
        for k, b in enumerate(peers):
            told = int((records.news()[e, :, a, b] > 0).sum())
            valid = told > 0 and bool(scenario.linked[e, a, b])
            assert float(seen[f"peers.peers_{k}.valid"][e, a]) == valid
            assert float(seen[f"peers.peers_{k}.news"][e, a]) == pytest.approx(valid * told / TARGETS)
            distance = float((r_N[e, b] - r_N[e, a]).norm())
            assert float(seen[f"peers.peers_{k}.distance"][e, a]) == pytest.approx(valid * distance / 15960e3)
            radial = float((r_N[e, b] - r_N[e, a]) @ r_N[e, a] / r_N[e, a].norm())
            assert float(seen[f"peers.peers_{k}.r_H[0]"][e, a]) == pytest.approx(valid * radial / 15960e3)
        untold = sum(int((records.news()[e, r, a] > 0).any()) for r in range(records.target.shape[1]))
        assert float(seen["task_status.untold"][e, a]) == pytest.approx(untold / TARGETS)
    assert int((records.target >= 0).sum()) > 5
    assert v_N.shape == r_N.shape


def test_the_task_in_progress_is_observed():
    env = sensors("ThreeSensors-v1", information="independent")
    (group,) = env.group_map
    td = env.reset()
    td[group, "action"] = torch.tensor([[0, 2, 3]] * 2)
    td = env.step(td)["next"]  # the first task to end, at 150 s, is the second one at the latest
    seen = columns(env, td)
    busy = ~td[group, "requires_retasking"].squeeze(-1)
    assert torch.equal(seen["task_status.busy"] > 0.0, busy)
    for imager, slot in enumerate((0, 2, 4)):
        assert torch.equal(seen[f"task_status.task[{slot}]"][:, imager] > 0.0, busy[:, imager])
    charging = busy[:, 0]
    elapsed = seen["task_status.elapsed"][:, 0] * 12000.0
    assert torch.allclose(elapsed[charging], env.fleet.sim_time[charging])
    remaining = seen["task_status.remaining"][:, 0] * 12000.0
    assert torch.allclose((elapsed + remaining)[charging], torch.tensor(300.0, dtype=torch.float64))


def test_radio_tells_others_and_the_team_pays_once():
    """Imagers that transmit whenever they may take no image twice while they are told of it in time."""
    env = sensors(time_limit=6000.0, mixture="LEO")
    (group,) = env.group_map
    policy, td = bsk_torch.rule("local", env), env.reset()
    sent = 0
    for _ in range(150):
        td = policy(td)
        legal = td[group, "action_mask"][..., 13:16]
        action = torch.where(legal.any(-1), 13 + legal.byte().argmax(-1), td[group, "action"])
        sent += int(legal.any(-1).sum())
        td[group, "action"] = action
        td = env.step(td)["next"]
        if bool(td["done"].any()):
            break
    records = env.scenario.records
    assert sent > 0
    assert int(records.sent.sum()) > 0
    foreign = torch.nn.functional.one_hot(records.source, 4) == 0
    assert int(((records.known > 0) & foreign & (records.target >= 0).unsqueeze(-1)).sum()) > 0
    assert env.links is not None


def joint(choices, images, row):
    """The best joint choice of a row, by the keys of the rule, and whether it is the only one."""
    number = choices.may.shape[2]
    scored = []
    for slots in itertools.product(range(number + 1), repeat=choices.may.shape[1]):
        chosen = [(a, k) for a, k in enumerate(slots) if k < number]
        targets = [int(choices.target[row, a, k]) for a, k in chosen]
        if not all(images[row, a] and choices.may[row, a, k] for a, k in chosen) or len(set(targets)) < len(targets):
            continue
        total = [sum(float(table[row, a, k]) for a, k in chosen) for table in (choices.new, choices.angle, choices.priority)]
        scored.append((total[0], len(chosen), -total[1], total[2], slots))
    best = max(score[:4] for score in scored)
    return [score[4] for score in scored if score[:4] == best]


def test_the_centralized_rule_takes_the_best_joint_choice():
    """Against loops over all joint choices of three imagers with three candidates."""
    env = begun(sensors("ThreeSensors-v1", information="ideal"))
    rule, numbers = TeamRule(env, "centralized"), random.Random(2)
    for _ in range(30):
        draw = lambda make: torch.tensor([[[make() for _ in range(3)] for _ in range(3)] for _ in range(2)])
        choices = Choices(
            draw(lambda: numbers.randrange(5)),
            draw(lambda: numbers.random() < 0.7),
            draw(lambda: numbers.random() < 0.5),
            draw(lambda: float(numbers.randrange(4))).double(),
            draw(lambda: float(numbers.randrange(3))).double(),
        )
        images = torch.tensor([[numbers.random() < 0.8 for _ in range(3)] for _ in range(2)])
        found = rule._joint(choices, images, torch.ones(2, 3, dtype=torch.bool))
        for row in range(2):
            assert tuple(found[row].tolist()) in joint(choices, images, row)


def test_the_local_rule_prefers_new_targets_then_small_angles():
    env = begun(sensors("ThreeSensors-v1"))
    row = lambda *values: torch.tensor([[list(values)] * 3] * 2)
    rule = TeamRule(env)
    choices = Choices(
        row(0, 1, 2, 3),
        row(True, True, False, True),
        row(False, True, True, True),
        row(5.0, 80.0, 1.0, 90.0),
        row(1.0, 1.0, 1.0, 9.0),
    )
    assert rule._local(choices).tolist() == [[1] * 3] * 2
    assert rule._local(choices._replace(may=torch.zeros_like(choices.may))).tolist() == [[4] * 3] * 2


def test_shared_facts_avoid_duplicates():
    """The same rule with the records of all, and without."""
    duplicates = {}
    for information in ("independent", "ideal"):
        env = sensors("ThreeSensors-v1", information=information, n_targets=40, num_envs=4)
        fly(env, 120)
        duplicates[information] = int(env.rewarder.counts()["duplicate_attempts"].sum())
    assert duplicates["ideal"] < 0.2 * duplicates["independent"]


def test_rules_of_teams_are_compared_and_flown_and_stand_behind_no_shield(capsys):
    env = sensors("ThreeSensors-v1")
    assert set(shared_baselines(env)) == {"random", "local", "centralized", *WORTHS} - {"prompt", *AHEAD}
    with pytest.raises(ValueError, match="decides for all satellites at once"):
        for_each_group(lambda policy, view: policy, baseline("local", env), env)
    alone = shared_baselines(bsk_torch.make("Services-v1", n_targets=12))
    assert set(alone) == {"random", *ORDERS, *WORTHS} - {"prompt", *AHEAD}
    app(["eval", "local", "--preset", "ThreeSensors-v1", "--seeds", "0:2", "--time-limit", "600"], standalone_mode=False)
    assert re.search(r"local +[\d.]+ ± ", capsys.readouterr().out)


def test_a_busy_sensor_reserves_its_target():
    env = sensors("ThreeSensors-v1", information="ideal")
    (group,) = env.group_map
    td = env.reset()
    names = [env.scenario.candidate_ids(env.satellites[0], a, 1)[0] for a in range(3)]
    target = env.scenario.ids.index(names[0])
    td[group, "action"] = torch.tensor([[image_target(target), 2, 0]] * 2)
    td = env.step(td)["next"]
    rule = TeamRule(env, "centralized")
    busy = ~td[group, "requires_retasking"].squeeze(-1)
    reserved = rule._reserved(~busy)
    assert reserved[:, target].tolist() == busy[:, 0].tolist()
    assert float(env.scenario.records.latest().amax()) >= AGO


def heard_state(imagers, row):
    """Battery, storage, fastest wheel, end of the task, s, and its place among the observed kinds."""
    dynamics, task, simulator = imagers.dynamics, imagers.task, imagers.simulator
    wheel = max(abs(speed) for speed in dynamics.wheel_speeds_fraction[row].tolist())
    kinds = ["charge", "downlink", "desat_sun", "transmit_rso", "image_rso"]
    busy = not task.requires_retasking[row]
    kind = kinds.index(simulator.mode_names[int(simulator.mode[row])]) if busy else 5
    ends = float(task.ends[row] * simulator.h if busy else simulator.sim_time[row])
    return float(dynamics.battery_charge_fraction[row]), float(dynamics.storage_level_fraction[row]), wheel, ends, kind


def summary(scenario, e, a, heard, now):
    """The 24 numbers of an imager, by loops over the others from which it has heard."""
    records = scenario.records
    r_N, v_N = (part[e] for part in scenario.imager_states())
    columns, tasks = [], [0] * 6
    for b in sorted(heard):
        battery, storage, wheel, ends, kind = heard[b]
        rho, dv = r_N[b] - r_N[a], v_N[b] - v_N[a]
        distance = float(rho.norm())
        captures = [
            float(records.capture[e, k])
            for k in range(records.target.shape[1])
            if int(records.target[e, k]) >= 0 and int(records.source[e, k]) == b and int(records.known[e, k, a]) > 0
        ]
        message, capture = now - float(records.exchanged[e, b, a]), now - max(captures, default=0.0)
        rate, link = float(rho @ dv) / distance, float(scenario.linked[e, a, b])
        column = [distance / 15960e3, rate / 12e3, battery, storage, wheel, max(ends - now, 0.0) / 12e3]
        columns.append([*column, message / 12e3, capture / 12e3, link])
        tasks[kind] += 1
    if not columns:
        return [0.0] * 24
    pairs = [number for values in zip(*columns, strict=True) for number in (sum(values) / len(values), max(values))]
    return [*pairs, *(count / len(columns) for count in tasks)]


def test_the_state_of_the_team_is_what_has_been_heard_last(monkeypatch):
    """Imagers that transmit whenever they can, and act at random otherwise."""
    usual = team_preset.observed
    monkeypatch.setattr(team_preset, "observed", lambda *settings: (*usual(*settings), RSOTeamState(2)))
    env = sensors("ThreeSensors-v1", information="radio", num_envs=3)
    (group,) = env.group_map
    policy, td, heard, sizes = bsk_torch.rule("random", env), env.reset(), {}, set()
    assert not td[group, "observation"][..., -24:].any()
    for _ in range(60):
        legal = policy(td)[group, "action_mask"]
        for k in (13, 14):
            td[group, "action"] = torch.where(legal[..., k], k, td[group, "action"])
        td = env.step(td)["next"]
        for e, a in itertools.product(range(3), range(3)):
            now = float(env.fleet.sim_time[e])
            for b in {0, 1, 2} - {a}:
                if float(env.scenario.records.exchanged[e, b, a]) == now:
                    heard.setdefault((e, a), {})[b] = heard_state(env.satellites[0], 3 * e + b)
            known = heard.get((e, a), {})
            sizes.add(len(known))
            expected = summary(env.scenario, e, a, known, now)
            assert td[group, "observation"][e, a, -24:].tolist() == pytest.approx(expected, rel=1e-9, abs=1e-12)
    assert sizes == {0, 1, 2}
