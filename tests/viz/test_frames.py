"""Frames show what there is, and drawing them changes nothing."""

import sys
from dataclasses import replace

import numpy as np
import pytest
import torch

pytest.importorskip("matplotlib", reason="needs the extra viz")

from tensordict import TensorDict

import bsk_torch
from bsk_torch.astro.frames import lla_to_fixed
from bsk_torch.constants import R_EARTH
from bsk_torch.viz.render.closeup import INSPECTED, LIT, look_closely
from bsk_torch.viz.render.frames import MOST, picture
from bsk_torch.viz.render.globe import LAND, NIGHT, SEA, Camera, camera, globe
from bsk_torch.viz.render.marks import DONE, NEW, color_of
from bsk_torch.viz.render.moment import DEAD, look, revolution
from tests.support.refusals import check_refusals, refusal
from tests.wrappers.constellations import EMPTY, FULL, trio

pytestmark = pytest.mark.compiled

SCAN, CHARGE, DOWNLINK, DESAT = range(4)

SIDES = np.eye(3)
"""Right, up and towards an eye that looks from N's z axis."""


def scanner(**options):
    return bsk_torch.make("NadirScan-v1", **({"num_envs": 2, "seed": 0, "time_limit": 900.0} | options))


def constellation(**options):
    given = {"n_satellites": 3, "n_planes": 1, "n_targets": 300, "time_limit": 300.0, "seed": 0}
    return bsk_torch.make("Constellation-v1", **(given | options))


def step(env, *actions):
    td = env.reset()
    for action in actions:
        td = env.step(td.set("action", torch.full(env.batch_size, action)))["next"]
    return td


def color(name):
    return np.array([int(name[k : k + 2], 16) for k in (1, 3, 5)])


# -- what comes out ---------------------------------------------------------------------------------------------------


def test_pictures_have_a_row_for_every_environment_that_is_drawn():
    env = scanner()
    env.reset()
    assert env.render().shape == (2, 480, 640, 3)
    assert env.render(rows=[1], height=240).shape == (1, 240, 320, 3)
    single = env.render(rows=1, height=240)
    assert single.dtype == torch.uint8
    assert torch.equal(single, env.render(height=240)[1])
    assert not torch.equal(single, env.render(rows=0, height=240))  # another episode


def test_types_may_have_different_numbers_of_wheels():
    env = bsk_torch.make("HeteroCluster-v1", num_envs=1, seed=0, n_targets=300, time_limit=300.0)
    env.reset()
    fastest = max(float(part.dynamics.wheel_speeds_fraction.abs().max()) for part in env.satellites)
    assert look(env, 0).levels["wheel speeds"] == fastest
    assert env.render(height=240).shape == (1, 240, 320, 3)


def test_wrong_arguments_are_named():
    env = scanner()
    with pytest.raises(RuntimeError, match="reset"):
        env.render()
    env.reset()
    for rows in (2, [-1], []):
        with pytest.raises(ValueError, match="from 0 to 1"):
            env.render(rows=rows)
    for height in (100, 481, 480.0):
        with pytest.raises(ValueError, match="height="):
            env.render(height=height)
    many = scanner(num_envs=MOST + 1)
    many.reset()
    with pytest.raises(ValueError, match=r"num_envs=17.*rows=0"):
        many.render()
    assert many.render(rows=MOST, height=120).shape == (120, 160, 3)


def test_rejects_a_missing_extra(monkeypatch):
    env = scanner()
    env.reset()
    for name in [name for name in sys.modules if name.startswith("bsk_torch.viz.render.frames")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "PIL", None)
    check_refusals([refusal(env.render, ModuleNotFoundError, "render()", "PIL", "pip install 'bsk_torch[viz]'")])


@pytest.mark.parametrize("make", [scanner, constellation])
def test_drawing_changes_nothing(make):
    """To the last bit, in everything that is observed and in the state that is kept."""
    watched, unwatched = make(), make()
    results = []
    for env in (watched, unwatched):
        torch.manual_seed(5)
        td = env.reset()
        for _ in range(5):
            if env is watched:
                env.render(height=120)
            td = env.rand_step(td)["next"]
        results.append((td, env.get_state()))
    assert len(results) == 2
    for left, right in zip(*results, strict=True):
        assert bool((left == right).all())


# -- what a frame tells -----------------------------------------------------------------------------------------------


def test_a_moment_is_the_present_of_its_row():
    env = scanner()
    td = step(env, DESAT, CHARGE)
    moment, dynamics = look(env, 1), env.satellite.dynamics
    assert moment.names == ["Scanner1"]
    assert moment.modes == ["charge"]
    assert np.array_equal(moment.r_N[0], dynamics.r_BN_N[1].numpy())
    assert moment.time == 180.0
    assert moment.limit == 900.0
    assert moment.levels["battery"] == float(dynamics.battery_charge_fraction[1])
    assert moment.levels["wheel speeds"] == float(dynamics.wheel_speeds_fraction[1].abs().max())
    assert len(moment.stations_P) == 7
    assert len(moment.targets_P) == 0
    assert td["done"].sum() == 0


def test_modes_are_called_as_they_are_commanded():
    """The satellite's ``desat_nadir`` is one of several ways to obey "desat"."""
    env = scanner()
    step(env, DESAT)
    assert env.simulator.mode_names[int(env.simulator.mode[0])] == "desat_nadir"
    assert look(env, 0).modes == ["desat"]


def test_satellites_of_a_constellation_keep_their_columns():
    env = trio(charges=(FULL, EMPTY, FULL), num_envs=2)
    td = env.reset()
    for action in ([0, 0, 1], [3, 3, 3]):
        td["agents", "action"] = torch.tensor([action, [1, 1, 1]])
        td = env.step(td)["next"]
    moment = look(env, 0)
    assert moment.modes == ["nadir_scan", DEAD, "charge"]
    places = env.fleet.each(lambda part: part.dynamics.r_BN_N)
    assert np.array_equal(moment.r_N, places[0].numpy())
    assert moment.levels["battery"] == float(env.fleet.each(lambda part: part.dynamics.battery_charge_fraction)[0].min())


def test_targets_turn_when_they_have_been_imaged():
    env = constellation()
    td = env.reset()
    assert len(look(env, 0).targets_P) == 300
    while not env.rewarder.imaged.any():
        td["agents", "action"] = td["agents", "action_mask"].byte().argmax(-1)
        td = env.step(td)["next"]
    moment = look(env, 0)
    assert moment.imaged.sum() == env.rewarder.imaged.sum()
    assert np.array_equal(moment.targets_P[moment.imaged], env.scenario.r_LP_P[0][env.rewarder.imaged[0]].numpy())
    target = env.satellites[0].latest_target
    assert np.array_equal(moment.aims_P, env.scenario.r_LP_P[0][target].numpy())
    assert moment.counts["imaged"] == int(env.counts()["imaged"].sum())


def test_returns_are_sums_of_rewards_begin_anew_and_are_restored():
    env = scanner(time_limit=400.0)
    td, total = env.reset(), torch.zeros(2, dtype=torch.float64)
    for action in (SCAN, CHARGE):
        td = env.step(td.set("action", torch.full((2,), action)))["next"]
        total += td["reward"].squeeze(-1)
    assert float(total.min()) > 0.0
    # rewards are float32, the sum of what the simulation paid is not
    torch.testing.assert_close(env.returns, total, rtol=1e-6, atol=0.0)
    assert look(env, 0).total == float(env.returns[0])
    saved, returns = env.get_state(), env.returns.clone()
    env.reset(TensorDict({"_reset": torch.tensor([[True], [False]])}, [2]))
    assert env.returns.tolist() == [0.0, float(returns[1])]
    env.reset(TensorDict({"state": saved}, [2]), set_state=True)
    assert torch.equal(env.returns, returns)


def test_returns_of_constellations_are_those_of_all_satellites():
    env = trio(charges=(FULL, EMPTY, FULL), num_envs=2)
    td, total = env.reset(), torch.zeros(2, dtype=torch.float64)
    for _ in range(2):
        td["agents", "action"] = torch.tensor([[0, 0, 1], [1, 1, 1]])
        td = env.step(td)["next"]
        total += td["agents", "reward"].sum((1, 2))
    assert float(total[0]) < -0.9  # the second satellite has died scanning
    torch.testing.assert_close(env.returns, total)


def test_the_drawn_orbit_is_the_one_that_was_flown():
    """Where the satellite was ten minutes ago lies on the ellipse through where it is now, up to the flattening."""
    env = scanner()
    td = env.reset()
    before = env.satellite.dynamics.r_BN_N[0].numpy()
    for _ in range(5):
        td = env.step(td.set("action", torch.full((2,), CHARGE)))["next"]
    orbit = look(env, 0).orbits_N[0]
    assert np.allclose(orbit[0], env.satellite.dynamics.r_BN_N[0].numpy(), rtol=0.0, atol=1.0)
    assert np.allclose(orbit[0], orbit[-1], rtol=0.0, atol=1.0)
    start, edge = orbit[:-1], np.diff(orbit, axis=0)
    share = np.clip(((before - start) * edge).sum(1) / (edge * edge).sum(1), 0.0, 1.0)
    near = np.linalg.norm(start + share[:, None] * edge - before, axis=1)
    behind = near.argmin() / len(edge)
    assert near.min() < 15e3  # m: chords of 3 degrees cut corners of 2.4 km; the rest is the flattening
    assert behind == pytest.approx(600.0 / 5700.0, abs=0.01)


def test_orbits_of_any_shape_close():
    r = torch.tensor([[7e6, 0.0, 0.0], [0.0, 9e6, 1e6]], dtype=torch.float64)
    v = torch.tensor([[0.0, 7546.0, 10.0], [-7.5e3, 0.0, 1e3]], dtype=torch.float64)
    orbits = revolution(r, v)
    for end in (0, -1):
        torch.testing.assert_close(orbits[:, end], r, rtol=0.0, atol=1e-3)


# -- what is seen -----------------------------------------------------------------------------------------------------


def test_the_earth_hides_what_is_behind_it():
    eye = Camera(SIDES, 100.0, 200.0)
    points = np.array([[0, 0, 1.0], [0, 0, -1.1], [0.5, 0.5, -0.9], [1.1, 0, -0.5], [0, 0.5, 0.9]]) * R_EARTH
    pixels, there = eye.project(points)
    assert there.tolist() == [True, False, False, True, True]
    assert np.allclose(pixels, [[200, 200], [200, 200], [250, 150], [310, 200], [200, 150]])


@pytest.mark.parametrize(
    ("latitude", "longitude", "expected"), [(-25.0, 134.0, LAND), (5.0, -30.0, SEA), (55.0, 75.0, LAND), (-40.0, -110.0, SEA)]
)
def test_land_and_sea_are_where_they_belong(latitude, longitude, expected):
    """Whatever the Earth's rotation, by day and by night."""
    env = scanner()
    env.reset()
    moment = look(env, 0)
    radians = (torch.deg2rad(torch.tensor(angle, dtype=torch.float64)) for angle in (latitude, longitude))
    up_N = lla_to_fixed(*radians, torch.zeros((), dtype=torch.float64)).numpy() @ moment.PN / R_EARTH
    right = np.cross([0.0, 0.0, 1.0], up_N)
    right /= np.linalg.norm(right)
    eye = Camera(np.stack([right, np.cross(up_N, right), up_N]), 90.0, 100.0)
    for side, light in ((1.0, 1.0), (-1.0, np.array(NIGHT))):
        lit = vars(moment) | {"sun_N": side * up_N}
        middle = globe(eye, type(moment)(**lit), 200)[99:101, 99:101].reshape(-1, 3).mean(0)
        # a hundredth of white is lost in rounding
        assert np.allclose(middle, color(expected) * light, atol=3.0)


def test_one_satellite_is_followed_and_many_are_looked_at_by_day():
    env = scanner()
    env.reset()
    moment = look(env, 0)
    eye = camera(moment, 480)
    pixels, there = eye.project(moment.r_N)
    assert there.all()
    assert abs(pixels[0, 0] - 240.0) < 1e-9
    assert np.abs(pixels - 240.0).max() < 100.0
    assert np.allclose(eye.axes @ eye.axes.T, np.eye(3))
    assert eye.axes[1, 2] > 0.0  # north is up
    several = vars(moment) | {"names": ["A", "B"]}
    assert camera(type(moment)(**several), 480).axes[2] @ moment.sun_N > 0.5


def test_orbits_fit_into_the_picture():
    env = scanner()
    env.reset()
    high = revolution(*(torch.tensor([x], dtype=torch.float64) for x in ([0.0, 0.0, 42164e3], [3074.66, 0.0, 0.0])))
    moment = type(look(env, 0))(**vars(look(env, 0)) | {"orbits_N": high.numpy()})
    pixels, _ = camera(moment, 480).project(moment.orbits_N)
    assert 0.0 < pixels.min() < 40.0
    assert 440.0 < pixels.max() < 480.0


def test_satellites_have_the_colour_of_what_they_do():
    env = scanner()
    for action, mode in ((SCAN, "nadir_scan"), (DESAT, "desat")):
        step(env, action)
        moment = look(env, 0)
        (x, y), _ = camera(moment, 480).project(moment.r_N[0])
        assert np.allclose(picture(moment, 480)[int(y), int(x)], color(color_of(mode)), atol=3.0)


def test_imaged_targets_are_drawn_in_their_colour():
    env = constellation()
    env.reset()
    moment = look(env, 0)
    eye = camera(moment, 480)
    pixels, there = eye.project(moment.targets_P @ moment.PN)
    central = there & (np.linalg.norm(pixels - 240.0, axis=1) < 150.0)
    before = picture(moment, 480)
    after = picture(type(moment)(**vars(moment) | {"imaged": central}), 480)
    changed = (before != after).any(-1)
    assert changed.sum() > central.sum()
    greens = [after[int(y), int(x)] for x, y in pixels[central]]
    near = [np.abs(green.astype(int) - color(DONE)).max() < 40 for green in greens]
    assert np.mean(near) > 0.8  # the others lie below orbits and satellites


def test_the_dead_are_shown_with_their_cause():
    env = trio(charges=(FULL, EMPTY, FULL), num_envs=2)
    td = env.reset()
    assert look(env, 0).causes == ["", "", ""]
    td["agents", "action"] = torch.zeros(2, 3, dtype=torch.int64)
    env.step(td)
    assert look(env, 0).causes == ["", "battery", ""]


def test_targets_are_drawn_larger_the_more_they_are_worth():
    env = constellation(num_envs=1)
    env.reset()
    moment = look(env, 0)
    priority = env.scenario.priority[0]
    assert np.allclose(moment.worth, (priority / priority.max())[env.scenario.available[0]].numpy())
    dark = np.array([int(NEW[k : k + 2], 16) for k in (1, 3, 5)])
    drawn = [
        int(
            (np.abs(picture(replace(moment, worth=np.full_like(moment.worth, worth)), 480).astype(int) - dark).sum(-1) < 60).sum()
        )
        for worth in (0.0, 1.0)
    ]
    assert drawn[1] > 2 * drawn[0]


# -- inspections ------------------------------------------------------------------------------------------------------


def inspection(steps=0):
    env = bsk_torch.make("MultiInspection-v1", num_envs=2, seed=4, actions="waypoints", time_limit=20_000.0)
    policy = bsk_torch.rule("survey", env)
    td = env.reset()
    for _ in range(steps):
        td = env.step(policy(td))["next"]
    return env


def test_an_inspection_is_seen_from_nearby():
    env = inspection(6)
    moment = look(env, 1)
    close = look_closely(env, 1, moment)
    assert [moment.names[k] for k in close.inspectors] == ["Inspector1", "Inspector2", "Inspector3"]
    assert moment.names[close.rso] == "RSO"
    reward = env.rewarder
    assert (close.states == INSPECTED).sum() == int(reward.inspected[1].sum()) > 0
    assert (close.states >= LIT).sum() == int((reward.inspected | reward.illuminated)[1].sum())
    away = np.linalg.norm(moment.r_N[close.inspectors] - moment.r_N[close.rso], axis=-1)
    assert np.allclose(np.linalg.norm(close.rho_H, axis=-1), away)
    assert np.array_equal(close.fuel, env.satellites[1].fsw.dv_available.view(2, 3)[1].numpy())
    assert np.allclose(np.linalg.norm(close.normals_H, axis=-1), 1.0)
    assert np.isclose(np.linalg.norm(close.sun_H), 1.0)


def test_inspectors_drift_where_it_is_drawn():
    """The linear motion is off by the square of distance over radius, the eccentricity, and the flattening of the Earth."""
    env = bsk_torch.make("RSOInspection-v1", num_envs=1, seed=4, actions="thrust", time_limit=20_000.0)
    td = env.reset()
    before = look_closely(env, 0, look(env, 0))
    td["chief", "action"] = torch.zeros(1, 1, dtype=torch.int64)
    td["inspector", "action"] = torch.tensor([[[0.0, 0.0, 0.0, 1000.0]]])
    after = env.step(td)["next"]
    close = look_closely(env, 0, look(env, 0))
    chief = env.satellites[0].dynamics
    rate = float(torch.linalg.cross(chief.r_BN_N, chief.v_BN_N).norm() / chief.r_BN_N.square().sum())
    where = float(after["duration"]) * rate / np.pi * (before.drifts_H.shape[1] - 1)  # samples since then
    drawn = [np.interp(where, np.arange(before.drifts_H.shape[1]), axis) for axis in before.drifts_H[0].T]
    assert np.allclose(before.drifts_H[:, 0], before.rho_H)
    assert np.linalg.norm(close.rho_H[0] - drawn) < 0.01 * np.linalg.norm(close.rho_H[0])
    assert np.linalg.norm(close.rho_H[0] - before.rho_H[0]) > 30.0


def test_pictures_of_inspections_show_what_has_been_inspected():
    env = inspection()
    before = env.render(0).int()
    env = inspection(6)
    after = env.render(0).int()
    assert before.shape == after.shape == (480, 640, 3)
    green = [((shot[:, :480] - torch.tensor(color(DONE))).abs().sum(-1) < 30).sum() for shot in (before, after)]
    assert int(green[1]) > int(green[0]) + 100
