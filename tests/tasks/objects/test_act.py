"""The action that images a resident space object (RSO)."""

import pytest
import torch

from bsk_torch import act
from bsk_torch.act import image_target
from bsk_torch.tasks.objects import ImageRSO
from tests.support.episodes import begun
from tests.tasks.objects.objects import Imager, environment, play

pytestmark = pytest.mark.compiled

CHARGE, DOWNLINK, FIRST = 0, 1, 2


def test_an_image_ends_its_step_and_hides_its_target():
    env = begun(environment())
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


def test_targets_chosen_by_number_must_be_eligible():
    env = begun(environment())
    play(env, image_target(1))
    assert env.scenario.pending[0].tolist() == [0, 1, 0, 0]
    with pytest.raises(ValueError, match="selects target 1, 'object 1', which waits for the downlink"):
        play(env, image_target(1))
    env = begun(environment(block_pending_targets=False))
    for _ in range(2):
        play(env, image_target(1))
    assert env.scenario.pending[0].tolist() == [0, 2, 0, 0]


def test_targets_that_are_missing_or_behind_the_earth_are_not_imaged():
    env = begun(environment())
    outputs = play(env, image_target(3))
    assert outputs["duration"][:, 0].tolist() == [200.0, 200.0]
    assert env.satellites[0].dynamics.rso_images.tolist() == [0.0, 0.0]
    assert env.simulator.read("rso_held").tolist() == [0.0, 0.0]

    class Many(Imager):
        action_spec = (act.Charge(duration=60.0), ImageRSO(6, max_duration=50.0))

    env = begun(environment(kind=Many))
    assert env.satellites[0].action_mask()[0].tolist() == [True] + [True] * 4 + [False] * 2
    outputs = play(env, 6)
    assert outputs["duration"][:, 0].tolist() == [50.0, 50.0]
    assert env.satellites[0].dynamics.rso_images.tolist() == [0.0, 0.0]


def test_a_fixed_duration_lasts_until_the_deadline():
    class Fixed(Imager):
        action_spec = (ImageRSO(3, 120.5, 5.0, require_illumination_during_hold=False, variable_duration_imaging=False),)

    env = begun(environment(kind=Fixed))
    outputs = play(env, 0)
    assert outputs["duration"][:, 0].tolist() == [121.0, 121.0]
    assert env.satellites[0].dynamics.rso_images.tolist() == [1.0, 1.0]
    assert (env.satellites[0].dynamics.rso_image_time < 120.0).all()


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
    env = begun(environment(sat_args=args))
    play(env, image_target(0))
    assert env.satellites[0].dynamics.rso_images.tolist() == [images, images]


def test_light_is_a_condition():
    class Lit(Imager):
        action_spec = (ImageRSO(3, 100.0, 0.0),)

    env = begun(environment(kind=Lit))
    dark = env.scenario.views(env.satellites[0], env.scenario.candidates(env.satellites[0], 1)).target_illumination_factor
    play(env, 0)
    assert env.satellites[0].dynamics.rso_images.tolist() == (dark[:, 0] > 0.5).double().tolist()
