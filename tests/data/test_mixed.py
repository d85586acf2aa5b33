"""Several scenarios in one batch, and rewards of channels: each is what it is alone."""

from __future__ import annotations

import copy
import math
import re
from typing import Any

import pytest
import torch

from bsk_torch import ConstellationTasking, act, comm, data, obs, per_environment, sats, scene
from bsk_torch.bsk_rl import data as bsk_rl_data
from bsk_torch.sim import dyn, fsw
from bsk_torch.tasks.inspection import RSOInspectionReward, SphericalRSO
from bsk_torch.tasks.inspection.obs import rso_imaged_regions
from bsk_torch.tasks.objects import ImageRSO, RSOImageReward, RSOTargets
from tests.support.refusals import check_refusals, refusal
from tests.tasks.inspection import inspecting as inspection
from tests.tasks.inspection.inspecting import EPOCH, POINTS, RSO, TURNED, chief_args, inspector_args
from tests.tasks.objects import objects as space

N, STEPS = 2, 7
GROUPS = {"ground": ["EO", "Scout"], "rso": ["RSO", "Above"]}
CHANNELS = {"images": ["EO"], "points": ["Above"]}
PLACES = {"images": "ground", "points": "rso"}
LOW = dict(oe=None, rN=[0.0, 0.0, 7e6], vN=[7546.0, 0.0, 0.0], **TURNED)
CAMERA = dict(imageAttErrorRequirement=0.1, imageRateErrorRequirement=0.1, imageTargetMinimumElevation=0.5, u_max=0.8)
BONUS = dict(completion_bonus=3.0, completion_threshold=0.1, min_illuminated_for_completion=0.1)


class Imager(sats.ImagingSatellite):
    observation_spec = (obs.Time(), obs.OpportunityProperties(dict(prop="priority"), n_ahead_observe=2))
    action_spec = (act.Image(2), act.Charge())
    dyn_type = dyn.ImagingDynModel
    fsw_type = fsw.ImagingFSWModel


class Inspector(inspection.Inspector):
    observation_spec = (obs.RelativeProperties(dict(prop="rso_imaged_regions", fn=rso_imaged_regions), chief_name="RSO"),)


def imager(name: str) -> sats.Satellite:
    return Imager(name, {**LOW, **CAMERA}, variable_interval=False)


def inspecting() -> list[sats.Satellite]:
    above = Inspector("Above", inspector_args(100.0, 0.0, 0.0), variable_interval=False)
    return [RSO("RSO", chief_args(), variable_interval=False), above]


def targets() -> scene.Scenario:
    return scene.UniformTargets(3000)


def points() -> scene.Scenario:
    return SphericalRSO(**POINTS)


def mixed(**given: Any) -> dict[str, Any]:
    scenario = {"scenarios": {"ground": targets(), "rso": points()}, "satellite_mapping": GROUPS}
    reward = {
        "rewarders": {"images": data.UniqueImageReward(), "points": RSOInspectionReward(**BONUS)},
        "satellite_mapping": CHANNELS,
        "scenario_mapping": PLACES,
    }
    for name, value in given.items():
        (scenario if name in ("scenarios", "groups") else reward)["satellite_mapping" if name == "groups" else name] = value
    return {"scenario": scene.MixedScenario(**scenario), "rewarder": data.MixedReward(**reward)}


def environment(satellites: list[sats.Satellite] | None = None, **options: Any) -> ConstellationTasking:
    satellites = [imager("EO"), *inspecting(), imager("Scout")] if satellites is None else satellites
    defaults = dict(
        num_envs=N,
        seed=3,
        time_limit=3000.0,
        max_step_duration=60.0,
        world_args=dict(utc_init=EPOCH),
        dtype=torch.float64,
        orbit="integrated",
    )
    return ConstellationTasking(satellites, **{**defaults, **options})


def fly(env: ConstellationTasking, steps: int = STEPS) -> dict[str, list[torch.Tensor]]:
    """Rewards and observations of all steps by satellite: imagers image, and inspectors inspect."""
    td, found = env.reset(), {name: [] for name in env.names}
    for _ in range(steps):
        for group, names in env.group_map.items():
            mask = td[group, "action_mask"]
            td[group, "action"] = torch.where(mask[..., 0], 0, mask.shape[-1] - 1)
            assert td[group, "action"].shape == (N, len(names))
        td = env.step(td)["next"]
        for group, names in env.group_map.items():
            for k, name in enumerate(names):
                found[name] += [td[group, "reward"][:, k].clone(), td[group, "observation"][:, k].clone()]
    return found


@pytest.fixture(scope="module")
def together():
    env = environment(**mixed(), communicator=comm.FreeCommunication())
    return env, fly(env)


@pytest.mark.compiled
def test_rewards_are_those_of_each_scenario_alone(together):
    _, found = together
    images = fly(environment([imager("EO")], scenario=targets(), rewarder=data.UniqueImageReward()))
    alone = environment(inspecting(), scenario=points(), rewarder=RSOInspectionReward(**BONUS))
    inspection = fly(alone, 1)
    assert sum(float(reward.sum()) for reward in images["EO"][::2]) > 0.5
    for one, other in zip(found["EO"], images["EO"], strict=True):
        assert torch.equal(one, other)
    assert torch.equal(found["Above"][0], inspection["Above"][0])
    assert float(found["Above"][0].min()) > 3.0  # with the bonus


@pytest.mark.compiled
def test_only_the_channels_of_a_satellite_pay_and_end_it(together):
    env, found = together
    for name in ("RSO", "Scout"):
        assert all(float(reward.abs().max()) == 0.0 for reward in found[name][::2])
    ended = env.rewarder.is_terminated()
    assert ended.tolist() == [[False, False, True, False]] * N
    assert env.rewarder.terms.keys() == {"images", "points"}
    parts = env.rewarder.channels
    assert torch.equal(env.rewarder.cum_reward["Above"], parts["points"].cum_reward["Above"])
    assert float(parts["images"].cum_reward["Above"].abs().max()) == 0.0


@pytest.mark.compiled
def test_satellites_know_the_places_of_their_scenarios_and_channels(together):
    env, _ = together
    kinds = {part.names[0]: getattr(part, "opportunity_types", ()) for part in env.satellites}
    assert kinds["EO"] == kinds["Scout"] == ("target",)
    filters = {part.names[0]: len(part.access_filters) for part in env.satellites if hasattr(part, "access_filters")}
    assert filters == {"EO": 1, "Scout": 0}
    known = env.rewarder.channels["images"].known  # Scout is told, and takes images that do not count
    assert known[:, 0].any()
    assert torch.equal(known[:, 0], known[:, 3])
    assert torch.equal(env.rewarder.channels["images"].imaged, known[:, 0])
    assert torch.equal(env.scenario.priority, env.scenario.scenarios["ground"].priority)
    assert env.scenario.n_points == 40


@pytest.mark.compiled
def test_episodes_are_saved_and_do_not_depend_on_the_batch(together):
    env, found = together
    other = environment(**mixed(), num_envs=2 * N)
    td = other.reset()
    assert torch.equal(other.scenario.priority[:N], env.scenario.priority)
    alike = environment(**mixed())
    alike.restore(env.get_state())
    assert torch.equal(alike.rewarder.channels["images"].imaged, env.rewarder.channels["images"].imaged)
    assert torch.equal(alike.rewarder.is_terminated(), env.rewarder.is_terminated())
    assert len(found["EO"]) == 2 * STEPS
    assert td.batch_size[0] == 2 * N


class SpaceImager(space.Imager):
    action_spec = (ImageRSO(3, max_duration=200.0, min_pointing_hold_s=5.0, require_illumination_during_hold=False),)


@pytest.mark.compiled
def test_imaging_of_the_ground_and_of_objects_in_orbit():
    r_N, v_N = space.state(0.0)
    args = {**space.KEPT, "oe": None, "rN": r_N.tolist(), "vN": v_N.tolist()}

    def fly_in_space(others: list[sats.Satellite], **task: Any) -> tuple[ConstellationTasking, dict[str, list[torch.Tensor]]]:
        imagers = [SpaceImager("SDA", args, variable_interval=False), *others]
        env = environment(imagers, **task, world_args=dict(utc_init=space.EPOCH, gsMinimumElevation=-0.5 * math.pi), orbit=None)
        return env, fly(env)

    catalog, paid = RSOTargets(space.catalog(), ["SDA"]), RSOImageReward(quality_threshold=0.0)
    _, alone = fly_in_space([], scenario=catalog, rewarder=paid)
    scenario = scene.MixedScenario({"ground": targets(), "space": catalog}, {"ground": ["EO"], "space": ["SDA"]})
    channels = {"images": data.UniqueImageReward(), "objects": paid}, {"images": ["EO"], "objects": ["SDA"]}
    reward = data.MixedReward(*channels, {"images": "ground", "objects": "space"})
    env, found = fly_in_space([imager("EO")], scenario=scenario, rewarder=reward)
    assert all(torch.equal(one, other) for one, other in zip(found["SDA"], alone["SDA"], strict=True))
    assert sum(float(value.sum()) for value in found["EO"][::2]) > 0.5
    assert int(env.rewarder.channels["objects"].memory["rso_captured"].sum()) > 0


@pytest.mark.compiled
def test_channels_of_one_scenario():
    rewarder = data.MixedReward({"a": data.UniqueImageReward()}, {"a": ["Scout"]})
    env = environment([imager("EO"), imager("Scout")], scenario=targets(), rewarder=rewarder)
    found = fly(env)
    assert len(env.satellites) == 2  # of one class, with different tasks
    assert all(float(reward.abs().max()) == 0.0 for reward in found["EO"][::2])
    assert sum(float(reward.sum()) for reward in found["Scout"][::2]) > 0.5


class Team(data.GlobalReward):
    """Pays all satellites, or with ``limited`` those of the channel."""

    limited = False

    def calculate_reward(self, before, after):
        reward = torch.ones(self.fleet.shape, dtype=torch.float64)
        return self.of_channel(reward) if self.limited else reward


class LimitedTeam(Team):
    limited = True


@pytest.mark.compiled
def test_rewards_outside_of_a_channel_are_errors():
    def first_step(rewarder: data.GlobalReward) -> torch.Tensor:
        channels = {"none": data.NoReward(), "team": rewarder}
        reward = data.MixedReward(channels, {"none": ["EO", "Scout"], "team": ["Scout"]})
        env = environment([imager("EO"), imager("Scout")], scenario=targets(), rewarder=reward)
        return torch.cat([value[0] for value in fly(env, 1).values()], 1)

    message = (
        "the rewarder of channel 'team', Team, pays 1 to 'EO' in environment 0, which is not one of its satellites; add it to "
        "satellite_mapping['team'], or return self.of_channel(reward) from calculate_reward"
    )
    with pytest.raises(ValueError, match=re.escape(message)):
        first_step(Team())
    assert first_step(LimitedTeam()).tolist() == [[0.0, 1.0]] * N
    assert first_step(data.ComposedReward(data.TimePenalty(), LimitedTeam())).tolist() == [[0.0, -59.0]] * N
    scans = data.ScanningTimeReward(lambda seconds: seconds + 2.0)
    assert first_step(scans).tolist() == [[0.0, 2.0]] * N


@pytest.mark.compiled
def test_channels_of_rewarders_of_one_episode():
    found = []
    for rewarder in (data.UniqueImageReward(), per_environment(bsk_rl_data.UniqueImageReward())):
        reward = data.MixedReward({"a": rewarder}, {"a": ["Scout"]})
        found.append(fly(environment([imager("EO"), imager("Scout")], scenario=targets(), rewarder=reward)))
    assert sum(float(reward.sum()) for reward in found[0]["Scout"][::2]) > 0.5
    for name in ("EO", "Scout"):
        for batched, single in zip(found[0][name], found[1][name], strict=True):
            assert torch.allclose(batched, single, rtol=0.0, atol=1e-12)


def test_copies_have_scenarios_and_rewarders_of_their_own():
    scenario = scene.MixedScenario({"a": (one := points()), "b": one, "c": targets()}, {"a": ["A"], "b": ["B"], "c": ["C"]})
    new = copy.copy(scenario)
    assert new.scenarios["a"] is new.scenarios["b"]
    assert new.scenarios["a"] is not one
    assert new.members(new.scenarios["a"]) == {"A", "B"}
    assert len({scenario.group_of(name) for name in "ABC"}) == 2
    reward = mixed()["rewarder"]
    assert copy.copy(reward).channels["images"] is not reward.channels["images"]


# -- errors -----------------------------------------------------------------------------------------------------------------


def test_rejects_what_does_not_fit():
    class Few(scene.Scenario):
        def present(self, key, names):
            return torch.ones(len(key), len(names), dtype=torch.bool)

    made = lambda **given: environment(**mixed(**given), backend="eager")
    mapped = lambda **channels: made(satellite_mapping={**CHANNELS, **channels})
    ground = lambda *names: made(groups={**GROUPS, "ground": list(names)})
    alone = data.MixedReward({"a": data.UniqueImageReward()}, {"a": ["EO"]}, {"a": "ground"})
    only_ground = lambda: environment([imager("EO")], scenario=targets(), rewarder=alone, backend="eager")
    nothing, both, places = data.NoReward(), ["images", "points"], ["ground", "rso"]
    table = [
        refusal(lambda: made(satellite_mapping={"images": []}), ValueError, "satellite_mapping", ["images"], both),
        refusal(lambda: made(scenario_mapping={"images": "ground"}), ValueError, "scenario_mapping", ["images"]),
        refusal(lambda: made(rewarders=dict.fromkeys(CHANNELS, nothing)), ValueError, both, "rewarder"),
        refusal(lambda: made(rewarders={"images": 3, "points": nothing}), ValueError, "rewarders", 3),
        refusal(lambda: mapped(images="EO"), ValueError, "satellite_mapping['images']='EO'", "list"),
        refusal(lambda: made(scenario_mapping="ground"), ValueError, "scenario_mapping='ground'", "dictionary"),
        refusal(lambda: made(groups={"ground": []}), ValueError, "satellite_mapping", ["ground"], places),
        refusal(lambda: made(scenarios={"ground": 3, "rso": points()}), ValueError, "scenarios['ground']=3", "scenario"),
        refusal(lambda: made(scenario_mapping=None), ValueError, "scenario_mapping", places),
        refusal(lambda: made(scenario_mapping={**PLACES, "images": "grund"}), ValueError, "['images']", "'grund'", "'ground'"),
        refusal(lambda: mapped(images=["E0"]), ValueError, "satellite_mapping['images']", "'E0'", "'EO'"),
        refusal(lambda: mapped(images=["Above"]), ValueError, "satellite_mapping['images']", ["Above"], "'ground'"),
        refusal(lambda: mapped(points=["RSO"]), ValueError, "mapping['points']", ["Above"], "RSOInspectionReward"),
        refusal(lambda: ground("Eo"), ValueError, "satellite_mapping['ground']", "'Eo'", "'EO'"),
        refusal(lambda: made(scenarios={"ground": targets(), "rso": targets()}), ValueError, "MixedScenario", "'target_exists'"),
        refusal(lambda: ground("EO"), ValueError, "sats.ImagingSatellite", "targets", "Scout"),
        refusal(lambda: only_ground(), ValueError, "scenario_mapping", "scene.MixedScenario", "UniformTargets"),
        refusal(lambda: scene.MixedScenario({"few": Few()}, {"few": []}), ValueError, "scenarios['few']", "satellites"),
    ]
    check_refusals(table)


def test_attributes_of_several_scenarios_are_ambiguous():
    whole = scene.MixedScenario({"a": targets(), "b": points(), "c": points()}, {"a": [], "b": [], "c": []})
    assert whole.most_targets == 3000
    with pytest.raises(AttributeError, match="several of its scenarios have 'n_points'; read it from one of them"):
        _ = whole.n_points
    with pytest.raises(AttributeError, match="none of its scenarios has 'nothing'"):
        _ = whole.nothing
