"""The action that images a resident space object (RSO)."""

import pytest
import torch

from bsk_torch import act
from bsk_torch.act import image_target
from bsk_torch.tasks.objects import ImageRSO
from tests.tasks.objects.objects import Imager, environment, play

CHARGE, DOWNLINK, FIRST = 0, 1, 2


@pytest.mark.compiled
def test_an_image_ends_its_step_and_hides_its_target():
    env = environment()
    env.reset()
    satellite = env.satellites[0]
    assert env.scenario.candidate_ids(satellite, 0, 3) == ["object 1", "object 2", "object 0"]
    outputs = play(env, FIRST)
    assert (outputs["duration"][:, 0] < 200.0).all()
    assert satellite.dynamics.rso_images.tolist() == [1.0, 1.0]
    assert torch.equal(satellite.dynamics.rso_image_time, env.fleet.sim_time)
    assert (satellite.dynamics.rso_image_held >= 5.0).all()
    assert satellite.dynamics.partition_levels[0].tolist() == [0.0, 1e6, 0.0, 0.0]
    assert env.scenario.pending[0].tolist() == [0, 1, 0, 0]
    assert "object 1" not in env.scenario.candidate_ids(satellite, 0, 3)


@pytest.mark.compiled
def test_targets_chosen_by_number_must_be_eligible():
    env = environment()
    env.reset()
    play(env, image_target(1))
    assert env.scenario.pending[0].tolist() == [0, 1, 0, 0]
    with pytest.raises(ValueError, match="selects target 1, 'object 1', which waits for the downlink"):
        play(env, image_target(1))
    env = environment(block_pending_targets=False)
    env.reset()
    for _ in range(2):
        play(env, image_target(1))
    assert env.scenario.pending[0].tolist() == [0, 2, 0, 0]


@pytest.mark.compiled
def test_where_there_are_fewer_candidates_actions_wait():
    class Many(Imager):
        action_spec = (act.Charge(duration=60.0), ImageRSO(6, max_duration=50.0))

    env = environment(kind=Many)
    env.reset()
    assert env.satellites[0].action_mask()[0].tolist() == [True] + [True] * 4 + [False] * 2
    outputs = play(env, 6)
    assert outputs["duration"][:, 0].tolist() == [50.0, 50.0]
    assert env.satellites[0].dynamics.rso_images.tolist() == [0.0, 0.0]


@pytest.mark.compiled
def test_a_target_behind_the_earth_is_not_imaged():
    env = environment()
    env.reset()
    outputs = play(env, image_target(3))
    assert outputs["duration"][:, 0].tolist() == [200.0, 200.0]
    assert env.satellites[0].dynamics.rso_images.tolist() == [0.0, 0.0]
    assert env.simulator.read("rso_held").tolist() == [0.0, 0.0]


@pytest.mark.compiled
def test_a_fixed_duration_lasts_until_the_deadline():
    class Fixed(Imager):
        action_spec = (ImageRSO(3, 120.5, 5.0, require_illumination_during_hold=False, variable_duration_imaging=False),)

    env = environment(kind=Fixed)
    env.reset()
    outputs = play(env, 0)
    assert outputs["duration"][:, 0].tolist() == [121.0, 121.0]
    assert env.satellites[0].dynamics.rso_images.tolist() == [1.0, 1.0]
    assert (env.satellites[0].dynamics.rso_image_time < 120.0).all()


@pytest.mark.compiled
@pytest.mark.parametrize(
    ("args", "images"),
    [
        (dict(instrumentBaudRate=2e7), 1.0),
        (dict(instrumentBaudRate=2.1e7), 0.0),
        (dict(imageTargetMaximumRange=1e6), 1.0),
        (dict(imageTargetMaximumRange=3e5), 0.0),
        (dict(imageAttErrorRequirement=1e-9), 0.0),
        (dict(imageRateErrorRequirement=1e-12), 0.0),
    ],
)
def test_room_range_and_pointing_are_conditions(args, images):
    env = environment(sat_args=args)
    env.reset()
    play(env, image_target(0))
    assert env.satellites[0].dynamics.rso_images.tolist() == [images, images]


@pytest.mark.compiled
def test_light_is_a_condition():
    class Lit(Imager):
        action_spec = (ImageRSO(3, 100.0, 0.0),)

    env = environment(kind=Lit)
    env.reset()
    dark = env.scenario.views(env.satellites[0], env.scenario.candidates(env.satellites[0], 1)).target_illumination_factor
    play(env, 0)
    assert env.satellites[0].dynamics.rso_images.tolist() == (dark[:, 0] > 0.5).double().tolist()
