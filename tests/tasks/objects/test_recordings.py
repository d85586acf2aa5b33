"""Imaging of resident space objects (RSO): replays of bsk_rl's episodes on Basilisk."""

import json
from collections import defaultdict

import pytest
import torch

from bsk_torch.tasks.objects import RSOTargetCatalog
from bsk_torch.tasks.objects.candidates import Candidates
from tests.tasks.objects.replay import Episodes, environment, load, replay

BOUNDS = {
    "r": 1e-3,  # m, of orbits solved in advance
    "v": 1e-6,
    "r_T": 1e-3,
    "v_T": 1e-6,
    "sigma": 1e-7,
    "wheels": 1e-5,
    "battery": 1e-3,
    "obs": 1e-9,
    "candidates": 0.0,
    "access": 0.0,
    "hold": 0.0,
    "storage": 0.0,
    "priority": 0.0,
    "pending": 0.0,
    "cooldown": 0.0,
    "retask": 0.0,
    "duration": 1e-11,  # a time minus a time, in Basilisk's seconds
    "reward": 1e-12,
    "credit": 1e-12,
}
"""Largest differences: those of the package's other replays; what is decided is equal."""

CASES = ["one", "two", "per"]


def differences(env, recorded: Episodes) -> tuple[dict[str, float], list[list[list[float]]]]:
    """Largest differences over a replay, and the images of each episode."""
    worst: dict[str, float] = defaultdict(float)
    sim, scenario, satellite = env.fleet.simulators[0], env.scenario, env.satellites[0]
    n, imagers = len(recorded.initial), len(recorded.initial[0]["imagers"])
    images: list[list[list[float]]] = [[] for _ in range(n)]
    before = torch.zeros(n, imagers)
    for k, moves, outputs in replay(env, recorded):
        state = recorded.padded("state", k)

        def compare(name, found, wanted, moves=moves):
            worst[name] = max(worst[name], float((found.double() - wanted)[moves].nan_to_num().abs().max()))

        def read(name):
            return sim.read(name).view(n, imagers, -1)

        envs, place = torch.arange(n), torch.arange(scenario.n_targets).expand(n, -1)
        for name, field, where in (
            ("r", "r_BN_N", 1),
            ("v", "v_BN_N", 4),
            ("sigma", "sigma_BN", 7),
            ("wheels", "Omega_WB_B", 13),
        ):
            compare(name, read(field), state[:, :imagers, where : where + 3])
        compare("battery", read("charge"), state[:, :imagers, 16:17])
        compare("r_T", scenario.r_TN_N, state[:, imagers:, 1:4])
        compare("v_T", scenario.orbits.states(envs, place, env.fleet.sim_time, env.fleet.sim_time)[1], state[:, imagers:, 4:7])
        candidates = scenario.candidates(satellite, 3)
        found = torch.where(candidates.exists, candidates.place, -1).view(n, imagers, 3)
        compare("candidates", found, recorded.padded("candidates", k))
        everything = place.repeat_interleave(imagers, 0)
        seen = scenario.in_sight(satellite, Candidates(everything, torch.ones_like(everything, dtype=torch.bool)))
        compare("access", seen.view(n, imagers, -1), recorded.padded("access", k))
        compare("obs", satellite.observations.get_vector(torch.float64).view(n, imagers, -1), recorded.padded("obs", k))
        compare(
            "hold", torch.cat([read(name) for name in ("rso_held", "rso_valid", "rso_taken")], -1), recorded.padded("hold", k)
        )
        compare("storage", read("partitions"), recorded.padded("storage", k))
        compare("priority", scenario.priority, recorded.padded("priority", k))
        compare("pending", scenario.pending, recorded.padded("pending", k))
        compare("cooldown", scenario.cooldown_until, recorded.padded("cooldown", k).nan_to_num(neginf=0.0))
        if k < max(len(rows) for rows in recorded.arrays["action"]):  # at the end of an episode, no satellite needs a task
            wanted = recorded.padded("retask", k)
            compare("retask", env.requires_retasking.double(), torch.where(wanted < 0.0, env.requires_retasking.double(), wanted))
        if outputs is not None:
            parts = env.rewarder.last_reward_components
            compare("duration", outputs["duration"][:, 0], recorded.padded("duration", k - 1))
            reward = torch.cat([outputs[group]["reward"][..., 0] for group in env.group_map], 1)
            compare("reward", reward, recorded.padded("reward", k - 1))
            compare("credit", torch.stack([parts["acquisition"], parts["delivery"]], -1), recorded.padded("credit", k - 1))
        taken = sim.read("rso_images").view(n, imagers)
        for e, a in torch.nonzero(taken > before).tolist():
            row = e * imagers + a
            model, target = satellite.dynamics, int(satellite.memory["rso_target"][row])
            values = model.rso_image_time, model.instrument_baud, model.rso_image_quality, model.rso_image_held
            images[e].append([a, target, *(float(value[row]) for value in values)])
        before = taken
    return worst, images


@pytest.mark.compiled
@pytest.mark.parametrize("case", CASES)
@pytest.mark.nightly("one", "per")
def test_episodes_are_the_recorded_ones(case):
    """Orbits, attitudes, candidates, rows of observations, holds, images, deliveries, credits and ends of steps."""
    parts = load(case)
    assert parts
    for recorded in parts:
        worst, images = differences(environment(recorded), recorded)
        assert worst.keys() == BOUNDS.keys()
        assert not {name: value for name, value in worst.items() if value > BOUNDS[name]}
        for found, wanted in zip(images, recorded.images, strict=True):
            assert len(found) == len(wanted)
            for one, other in zip(sorted(found), sorted(row[:-1] for row in wanted), strict=True):
                assert one == pytest.approx(other, rel=1e-8)  # the quality of images in a penumbra


@pytest.mark.parametrize("case", CASES)
def test_catalogs_of_bsk_rl_are_read_and_written(case):
    saved = [episode["catalog"] for recorded in load(case) for episode in recorded.initial]
    assert len(saved) == 2
    read = [RSOTargetCatalog.from_dict(catalog) for catalog in saved]
    assert [json.loads(json.dumps(catalog.to_dict())) for catalog in read] == saved
