"""Points of an RSO: what users write, what they get, and which satellites fit."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from bsk_torch import scene
from bsk_torch.sim import fsw
from bsk_torch.tasks.inspection import RSOInspectionReward, RSOPoint, RSOPoints, SphericalRSO
from tests.support.refusals import check_refusals, refusal
from tests.tasks.inspection.inspecting import RSO, Inspector, act_all, chief_args, inspection, inspector_args


class TwoPoints(RSOPoints):
    """Points with normals of any length, the second at random."""

    def generate_points(self):
        limits = dict(theta_max=1.0, range_max=0.0, theta_solar_max=-1.0, min_illumination_factor=0.0)
        where = np.random.uniform(-1.0, 1.0, 3)
        return [RSOPoint([1.0, 0.0, 0.0], [5.0, 0.0, 0.0], **limits), RSOPoint(where, where, **limits)]


class SamePoints(TwoPoints):
    points_are_fixed = True
    calls = 0

    def generate_points(self):
        type(self).calls += 1
        return super().generate_points()[:1]


def build(scenario, satellites=None, **options):
    return inspection(satellites or pair(inspector=Plain), scenario, rewarder=RSOInspectionReward(), **options)


def pair(rso=RSO, inspector=Inspector):
    return [rso("RSO", chief_args()), inspector("A", inspector_args(100.0, 0.0, 0.0))]


class Plain(Inspector):
    observation_spec = RSO.observation_spec


class Blind(Plain):
    fsw_type = fsw.ContinuousImagingFSWModel
    action_spec = RSO.action_spec


def test_a_sphere_has_points_along_a_spiral_with_normals_outwards():
    scenario = SphericalRSO(n_points=50, radius=2.0, theta_max=0.5, range_max=100.0, theta_solar_max=0.7)
    points = scenario.rso_points
    assert len(points) == scenario.n_points == 50
    for point in points:
        assert np.linalg.norm(point.r_PB_B) == pytest.approx(2.0)
        np.testing.assert_allclose(point.n_B, point.r_PB_B / 2.0, atol=1e-15)
        assert (point.theta_max, point.range_max, point.theta_solar_max) == (0.5, 100.0, 0.7)
        assert point.min_illumination_factor == 0.1
    angle = [math.atan2(point.n_B[1], point.n_B[0]) for point in points[20:22]]
    assert (angle[1] - angle[0]) % (2 * math.pi) == pytest.approx(math.pi * (3.0 - math.sqrt(5.0)))
    assert [point.n_B[2] for point in points[:2]] == pytest.approx([-0.98, -0.94])


def test_points_of_a_users_own_are_made_for_each_episode():
    """Each environment and episode has its own, whatever the batch; those of one class that says so are made once."""
    env = build(TwoPoints())
    env.reset()
    first = env.scenario.r_PB_B.clone()
    assert first.shape == (2, 2, 3)
    assert (first[:, 0] == torch.tensor([1.0, 0.0, 0.0])).all()
    assert (first[0, 1] != first[1, 1]).all()
    env.reset()
    assert (env.scenario.r_PB_B[:, 1] != first[:, 1]).all()
    alone = build(TwoPoints(), num_envs=1, env_ids=[1])
    alone.reset()
    assert torch.equal(alone.scenario.r_PB_B[0], first[1])
    assert [point.r_PB_B.tolist() for point in alone.scenario.points_of(0)] == first[1].tolist()
    with pytest.raises(AttributeError, match="points_of"):
        _ = alone.scenario.rso_points


def test_fixed_points_of_a_users_own_are_made_once():
    SamePoints.calls = 0
    env = build(SamePoints())
    td = act_all(env, env.reset())
    act_all(env, td)
    env.reset()
    assert env.scenario.n_points == 1
    assert SamePoints.calls <= 3  # the scenario's own, and those of the copies of trials


def test_own_points_are_inspected_and_saved_with_their_episodes():
    env = build(TwoPoints())
    td = env.reset()
    td = act_all(env, td)
    saved, known = env.get_state(), env.rewarder.inspected.clone()
    td = act_all(env, td)
    after = env.rewarder.inspected.clone()
    env.restore(saved)
    assert torch.equal(env.rewarder.inspected, known)
    act_all(env, env._outputs(None))
    assert torch.equal(env.rewarder.inspected, after)


def test_rejects_wrong_points():
    limits = dict(theta_max=1.0, range_max=1.0, theta_solar_max=1.0, min_illumination_factor=0.0)
    point = RSOPoint([1.0, 0.0, 0.0], [1.0, 0.0, 0.0], **limits)

    def made(generate):
        return build(type("Given", (RSOPoints,), {"generate_points": lambda self: generate()})())

    def one(position, normal):
        return made(lambda: [RSOPoint(position, normal, **limits)])

    name = "Given.generate_points()"
    check_refusals(
        [
            refusal(lambda: made(list), ValueError, name, "no points"),
            refusal(lambda: made(lambda: [(0.0, 0.0, 1.0)]), TypeError, name, (0.0, 0.0, 1.0), "RSOPoint"),
            refusal(lambda: one([1.0, 0.0, 0.0], [0.0, 0.0, 0.0]), ValueError, f"{name}[0].n_B", "zero"),
            refusal(lambda: one([1.0, 0.0], [0.0, 0.0, 1.0]), ValueError, f"{name}[0].r_PB_B", [1.0, 0.0]),
            refusal(lambda: made(lambda: [point] * int(np.random.randint(1, 30))), ValueError, name, "points", "episodes"),
            refusal(lambda: build(RSOPoints()), NotImplementedError, "RSOPoints", "generate_points()"),
        ]
    )


def test_rejects_satellites_and_scenarios_that_do_not_fit():
    rso, one = "RSODynModel", [Plain("A", inspector_args(100.0, 0.0, 0.0))]

    def sphere(satellites):
        return build(SphericalRSO(), satellites)

    two = [*pair(inspector=Plain), RSO("Second", chief_args())]
    blind = pair(inspector=Blind)
    check_refusals(
        [
            refusal(lambda: sphere(two), ValueError, "SphericalRSO", rso, ["RSO", "Second"]),
            refusal(lambda: sphere(one), ValueError, "SphericalRSO", rso, ["A"]),
            refusal(lambda: sphere([RSO("RSO", chief_args())]), ValueError, "RSOInspectorDynModel", ["RSO"]),
            refusal(lambda: sphere(blind), ValueError, ["A"], "RSOInspectorDynModel", "RSOInspectorFSWModel"),
            refusal(lambda: inspection(one, scene.Scenario(), rewarder=None), ValueError, "slot 'rso'"),
            refusal(lambda: build(scene.Scenario()), ValueError, "RSOInspectionReward", "points", "SphericalRSO"),
        ]
    )


def test_a_subclass_of_the_sphere_with_points_of_its_own_makes_them_anew():
    class Half(SphericalRSO):
        def generate_points(self):
            return [point for point in super().generate_points() if point.n_B[2] > 0.0]

    env = build(Half(n_points=20))
    env.reset()
    assert env.scenario.r_PB_B.shape == (2, 10, 3)
    with pytest.raises(TypeError, match="generate_points"):

        class Wrong(RSOPoints):
            def generate_points(self, n):
                return []
