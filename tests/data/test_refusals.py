"""Wrong calls of rewarders: what each must raise, and what its message must name."""

import math

import numpy as np
import pytest
import torch

from bsk_torch import data, scene
from bsk_torch.tasks.inspection import RSOInspectionReward
from bsk_torch.tasks.objects import RSOImageReward, RSOTeamReward
from tests.data import test_custom_rewards as custom
from tests.data import test_footprint as footprint
from tests.data import test_resources as resources
from tests.data.test_radar import Optical, cluster
from tests.support.refusals import check_refusals, refusal
from tests.tasks.objects.objects import environment, play
from tests.tasks.objects.test_team_reward import targets, team

FIRST_IMAGE = 2


def test_rejects_wrong_arguments():
    image, shared, inspection = RSOImageReward, RSOTeamReward, RSOInspectionReward
    angles, weights = (0.0, -0.1, 2.0, math.nan, "wide", [0.1, 0.2]), (-1.0, math.nan, math.inf, "1")
    angle = data.FootprintImageReward
    table = [
        *(refusal(lambda x=x: angle(x), ValueError, f"half_angle={x!r}", "(0, 1.5708]", "rad") for x in angles),
        *(refusal(lambda x=x: data.TimePenalty(x), ValueError, f"weight={x!r}") for x in weights),
        refusal(lambda: image(quality_threshold=1.5), ValueError, "quality_threshold=1.5"),
        refusal(lambda: image(cooldown_s=-1.0), ValueError, "cooldown_s=-1.0"),
        refusal(lambda: image(multi_imager_credit="both"), ValueError, "multi_imager_credit='both'", "'shared'"),
        refusal(lambda: image(acquisition_reward_fn=3.0), ValueError, "acquisition_reward_fn=3.0", "function"),
        refusal(lambda: image(delivery_reward_fn="priority"), ValueError, "delivery_reward_fn='priority'"),
        refusal(lambda: shared(delivery_share=1.5), ValueError, "delivery_share=1.5"),
        refusal(lambda: shared(quality_threshold=-1.0), ValueError, "quality_threshold=-1.0"),
        refusal(lambda: shared(cooldown_s=-1.0), ValueError, "cooldown_s=-1.0"),
        refusal(lambda: shared(same_time_s=-1.0), ValueError, "same_time_s=-1.0"),
        refusal(lambda: inspection(completion_threshold=-0.1), ValueError, "completion_threshold=-0.1"),
        refusal(lambda: inspection(min_illuminated_for_completion=1.1), ValueError, "min_illuminated_for_completion=1.1"),
        refusal(lambda: inspection(terminate_on_completion="yes"), ValueError, "terminate_on_completion='yes'", True, False),
        refusal(lambda: inspection(completion_bonus=math.inf), ValueError, "completion_bonus=inf"),
    ]
    check_refusals(table)


def test_rejects_scenarios_that_do_not_fit():
    uniform, nadir = scene.UniformTargets(10), scene.UniformNadirScanning()
    uncertain = lambda scenario: footprint.imaging(0.0, 0.1, scenario=scenario, backend="eager")
    teamed = lambda **options: team(backend="eager", **options)
    table = [
        refusal(lambda: uncertain(uniform), ValueError, "FootprintImageReward", "scene.UncertainTargets", "UniformTargets"),
        refusal(lambda: environment(scenario=nadir, backend="eager"), ValueError, "RSOTargets"),
        refusal(lambda: targets(knowledge="mine"), ValueError, "knowledge='mine'", "'common'", "'own'"),
        refusal(lambda: teamed(scenario=targets(knowledge="common")), ValueError, "knowledge='common'", "'own'"),
        refusal(lambda: teamed(scenario=targets(block_pending_targets=False)), ValueError, "block_pending_targets=True", False),
    ]
    check_refusals(table)


def test_rejects_satellites_that_do_not_fit():
    radar = lambda **attributes: type("Radar", (Optical,), attributes)
    crew = lambda: environment(imagers=2, rewarder=RSOImageReward(), backend="eager")
    shared = lambda: team(rewarder=RSOImageReward(multi_imager_credit="shared"), backend="eager")
    half = lambda: cluster(radar(sees_through_clouds=0.5), Optical, Optical)
    table = [
        refusal(lambda: crew(), ValueError, "multi_imager_credit", "'shared'", "'per_imager'"),
        refusal(lambda: shared(), RuntimeError, "RSOTargets", "knowledge='own'", "RSOTeamReward"),
        refusal(lambda: half(), ValueError, "Radar.sees_through_clouds=0.5", True, False),
        refusal(lambda: radar(sees_trough_clouds=True), TypeError, "sees_trough_clouds", "'sees_through_clouds'"),
    ]
    check_refusals(table)


def test_rejects_wrong_resources():
    reward, elapsed = data.ResourceReward, resources.elapsed
    table = [
        refusal(lambda: reward(elapsed, -1.0), TypeError, "resource_fn=-1.0", "function"),
        refusal(lambda: reward(2.0), TypeError, "resource_fn=None", "function"),
        refusal(lambda: resources.make(2, data.NoReward()), ValueError, "'resource_reward_weight'", "NoReward"),
        refusal(lambda: resources.make(2, reward(2.0, elapsed)), ValueError, "'half'", "2 norms", "1 weights"),
    ]
    check_refusals(table)


@pytest.mark.compiled
def test_rejects_wrong_results_of_functions():
    image = lambda function: RSOImageReward(function, quality_threshold=0.0)
    endless, summed = image(lambda record, target: target.priority / 0.0), image(lambda record, target: target.priority.sum())
    env = environment(rewarder=endless)
    env.reset()
    resource = lambda *functions: resources.make(2, (data.ResourceReward(*functions),) * 2)
    undrawn, of_places = resource(lambda: np.nan, resources.elapsed), resource(1.0, lambda sat: sat.dynamics.r_BN_N)
    of_places.reset()
    table = [
        refusal(lambda: play(env, FIRST_IMAGE), ValueError, "acquisition_reward_fn", "inf", "'object 1'"),
        refusal(lambda: environment(rewarder=summed, num_envs=1), TypeError, "acquisition_reward_fn", [1, 1]),
        refusal(lambda: undrawn.reset(), ValueError, "reward_weight", "nan", "finite number"),
        refusal(lambda: resources.step(of_places), TypeError, "resource_fn", [2, 3], "one number"),
    ]
    check_refusals(table)


@pytest.mark.compiled
def test_rejects_results_without_the_dimensions_of_one_environment():
    """They are found when the environment is built."""

    class Flat(data.NoReward):
        def calculate_reward(self, before, after):
            return super().calculate_reward(before, after).squeeze(1)

    class Ended(data.NoReward):
        def is_terminated(self):
            return torch.zeros(1, dtype=torch.bool)

    class Logged(data.NoReward):
        def read_log(self):
            return {"level": self.fleet.sim_time}

    made = lambda rewarder: custom.imaging(rewarder, scene.UniformTargets(custom.T), num_envs=1)
    table = [
        refusal(lambda: made(Flat()), TypeError, "Flat.calculate_reward()", [1], [1, 1]),
        refusal(lambda: made(Ended()), TypeError, "Ended.is_terminated()", [1], [1, 1]),
        refusal(lambda: made(Logged()), TypeError, "Logged.read_log()['level']", [1], [1, 1]),
    ]
    check_refusals(table)
