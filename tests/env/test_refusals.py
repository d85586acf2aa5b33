"""Wrong calls of environments and of their presets: what each must raise, and what its message must name."""

import torch

import bsk_torch
from bsk_torch import SatelliteTasking, data, scene
from bsk_torch.env.agents import agents_of, check_map
from bsk_torch.lab.basilisk.flight import problem_of
from bsk_torch.presets.nadir_scan import ScanningSatellite, scanning_args
from bsk_torch.tasks.objects import RSOImageReward, RSOTargets, RSOTeamState, team_preset
from bsk_torch.tasks.objects.preset import servicing_catalog
from tests.support.refusals import check_refusals, refusal
from tests.tasks.objects.objects import environment

TARGETS = 12


def make(name="NadirScan-v1", **options):
    return bsk_torch.make(name, **(dict(num_envs=4, seed=1, time_limit=300.0, backend="eager") | options))


def services(name="Services-v1", **options):
    return make(name, **(dict(num_envs=1, n_targets=TARGETS) | options))


def test_rejects_wrong_agents_and_maps_of_groups():
    agents = lambda groupings: agents_of(["A", "B", "C", "D", "E"], groupings)
    check_refusals(
        refusal(lambda: agents({" crew": ["A"]}), ValueError, "meta_agent_groupings", "' crew'", "space"),
        refusal(lambda: agents({3: ["A"]}), ValueError, "meta_agent_groupings", "3", "string"),
        refusal(lambda: agents({"Crew": []}), ValueError, "meta_agent_groupings", "'Crew'", "[]", "satellite"),
        refusal(lambda: agents({"Crew": "A"}), ValueError, "meta_agent_groupings", "'Crew'", "'A'", "satellite"),
        refusal(lambda: agents({"Crew": ["A", "b"]}), ValueError, "meta_agent_groupings", "'Crew'", "'b'", "'B'"),
        refusal(lambda: agents({"Crew": ["Zeppelin"]}), ValueError, "meta_agent_groupings", "'Zeppelin'", "A, B, C, D, E"),
        refusal(lambda: agents({"Crew": ["A"], "Team": ["B", "A"]}), ValueError, "satellite 'A'", "'Crew'", "'Team'"),
        refusal(lambda: agents({"Crew": ["A", "A"]}), ValueError, "meta_agent_groupings", "'A'", "'Crew'"),
        refusal(lambda: agents({"B": ["A", "C"]}), ValueError, "meta_agent_groupings", "['B']", "names"),
    )
    mapped = lambda **group_map: check_map(group_map, {"A": (0,), "B": (0,), "C": (1, 0)})
    check_refusals(
        refusal(lambda: mapped(all=["A", "F"]), ValueError, "group_map", "'F'", "A, B, C"),
        refusal(lambda: mapped(all=["A", "c"]), ValueError, "group_map", "'c'", "'C'"),
        refusal(lambda: mapped(one=["A", "B"], two=["B", "C"]), ValueError, "group_map", ["B"]),
        refusal(lambda: mapped(one=["A", "B"]), ValueError, "group_map", ["C"]),
        refusal(lambda: mapped(), ValueError, "group_map", ["A", "B", "C"]),
        refusal(lambda: mapped(one=["A", "B"], none=[], two=["C"]), ValueError, "group_map['none']", "[]", "empty"),
        refusal(lambda: mapped(one=["A", "B"], reward=["C"]), ValueError, "group_map['reward']", ["C"], "'observation'"),
        refusal(lambda: mapped(one=["A", "B", "C"]), ValueError, "group_map['one']", "'A'", "'C'", "types"),
    )


def test_rejects_wrong_seeds_and_checks_of_failures():
    env = make(num_envs=3)
    check_refusals(
        refusal(lambda: env.reseed([1, 2]), ValueError, "seed", "2", "3"),
        refusal(lambda: env.reseed(-1), ValueError, "seed=-1"),
        refusal(lambda: env.reseed([1, 2, 0.5]), ValueError, "seed=0.5"),
    )
    fixed = ScanningSatellite("A", scanning_args(), variable_interval=False)
    check_refusals(
        refusal(lambda: make(failures="continous"), ValueError, "failures", "'continous'", "'step'", "'continuous'"),
        refusal(lambda: SatelliteTasking(fixed, failures="continuous"), ValueError, "'continuous'", "A", "variable_interval"),
        refusal(lambda: problem_of(make(failures="continuous"), "NadirScan-v1"), ValueError, "failures", "bsk_rl"),
    )


def test_rejects_wrong_states():
    env = make()
    env.reset()
    state = env.get_state()
    beyond = state.clone().set(("satellites_0", "mode"), torch.full((4,), 99))

    def rows(envs, source):
        env.restore(env, torch.tensor(envs), torch.tensor(source))

    class Draws(scene.Scenario):
        def draw(self, key):
            return {"mass": torch.zeros(len(key), dtype=torch.float64)}

    check_refusals(
        refusal(lambda: rows([4], [0]), IndexError, "envs", [4], 3),
        refusal(lambda: rows([0], [-1]), IndexError, "source", [-1], 3),
        refusal(lambda: rows([0, 1], [0]), IndexError, "envs", 2, "source", 1),
        refusal(lambda: env.restore(beyond), ValueError, "satellites_0.mode", 99, [0, 8]),
        refusal(lambda: env.restore(state.clone().exclude("made_by")), ValueError, "fingerprint", "0.1"),
        refusal(lambda: env.restore(state.clone().exclude("returns")), KeyError, "state", ["returns"]),
        refusal(lambda: SatelliteTasking(env.builder.satellites[0], Draws()), ValueError, "scenario", ["mass"]),
    )


def test_rejects_wrong_options_rewards_and_ranks_of_services():
    check_refusals(
        refusal(lambda: services(n_targets=5), ValueError, "n_targets=5", 8),
        refusal(lambda: services(n_targets=0), ValueError, "n_targets=0"),
        refusal(lambda: services(delivery_share=1.5), ValueError, "delivery_share", 1.5),
        refusal(lambda: services(advance=-0.5), ValueError, "advance", -0.5),
        refusal(lambda: services(delivery_share=0.5, advance=0.5), ValueError, "delivery_share=0.5", "advance=0.5"),
        refusal(lambda: services(priority_sum=0.0), ValueError, "priority_sum", 0.0),
        refusal(lambda: services(mixture="MEO"), ValueError, "shares", "'MEO'", "'LEO'"),
        refusal(lambda: services(priority_event=1.5), ValueError, "priority_event", 1.5),
        refusal(lambda: services(empty_downlink_penalty=1.0), ValueError, "empty_downlink", 1.0),
        refusal(lambda: services(order="elevations"), ValueError, "order", "'elevations'", "'elevation'"),
    )
    penalty, advance = data.OperationsPenalty, RSOImageReward(advance=0.5, multi_imager_credit="shared")
    world = lambda rewarder, **options: environment(rewarder=rewarder, backend="eager", **options)
    names = ("low_battery", "full_storage", "empty_downlink")
    check_refusals(
        *(refusal(lambda name=name: penalty(**{name: 1.0}), ValueError, name, 1.0) for name in names),
        refusal(lambda: penalty(battery_below=2.0), ValueError, "battery_below", 2.0),
        refusal(lambda: world(penalty(empty_downlink=-1.0)), ValueError, "empty_downlink=-1", "until_empty=True"),
        refusal(lambda: world(advance, imagers=2), ValueError, "advance", 0.5, 2),
    )

    def ranked(order):
        return services(scenario=RSOTargets(servicing_catalog(TARGETS, priority_event=False), ["SS1"], order=order))

    nan = lambda scenario, satellite: torch.full_like(satellite.of_env(scenario.priority), torch.nan)
    check_refusals(
        refusal(lambda: ranked(nan), ValueError, "order(scenario, satellite)", "NaN", "SS1"),
        refusal(lambda: ranked(lambda scenario, satellite: None), TypeError, "order(scenario, satellite)", None),
    )


def test_rejects_wrong_options_of_sensors_and_rules_without_a_team():
    sensors = lambda **options: services("Walker4-v1", **options)
    check_refusals(
        refusal(lambda: sensors(information="telepathy"), ValueError, "information", "'telepathy'", "'radio'"),
        refusal(lambda: sensors(retasking="never"), ValueError, "retasking", "'never'", "'conflict'"),
        refusal(lambda: sensors(delivery_share=2.0), ValueError, "delivery_share", 2.0),
        refusal(lambda: sensors(mixture="MEO"), ValueError, "shares", "'MEO'", "'LEO'"),
        refusal(lambda: sensors(order="distance"), ValueError, "order", "'distance'", "'elevation'"),
        refusal(lambda: sensors(outlook=True), ValueError, "outlook=True", "as_set=True"),
        refusal(lambda: sensors(shielded=1), ValueError, "shielded=1", True, False),
    )
    check_refusals(refusal(lambda: bsk_torch.rule("local", services()), ValueError, "RSOTargets", "knowledge='own'"))


def test_rejects_states_of_teams_of_another_size(monkeypatch):
    def team(*states):
        monkeypatch.setattr(team_preset, "observed", lambda *settings: states)
        services("ThreeSensors-v1", information="radio").reset()

    state = RSOTeamState
    check_refusals(
        refusal(lambda: team(state(2), state(2, name="again")), ValueError, "SS1", "RSOTeamState"),
        refusal(lambda: team(state(3)), ValueError, "RSOTeamState", "n_peers=3", "2 peers"),
        refusal(lambda: state(2, norm=0.0), ValueError, "norm", 0.0),
    )
