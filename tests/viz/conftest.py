"""An episode, and the report of a training that it stands for."""

import pytest

import bsk_torch
from bsk_torch.rl.rules.baselines import scan_rule
from bsk_torch.viz.episodes import record
from bsk_torch.viz.report.page import Chosen, RunData

NAN = float("nan")

SHORT = dict(time_limit=400.0, backend="eager")


@pytest.fixture(scope="module")
def env():
    return bsk_torch.make("NadirScan-v1", num_envs=1, seed=0, **SHORT)


@pytest.fixture(scope="module")
def episode(env):
    return record(scan_rule(env), env, seed=1)


@pytest.fixture
def run(episode):
    def result(mean, **more):
        return {"return": {"mean": mean, "half_width": 0.01}, "episodes": 64, "survival": 1.0, "fill": 0.25, "deaths": {}} | more

    gain = {"random": {"mean": 1.25, "half_width": 0.125}}
    log = {"frames": [1e6, 2e6], "seconds": [30.0, 61.0], "simulated_days": [700.0, 1400.0]}
    return RunData(
        name="run<1>",
        preset="NadirScan-v1",
        log=log | {"return": [NAN, 0.2], "survival": [NAN, 0.9], "collected": [NAN, 0.3], "fill": [NAN, NAN]},
        evaluations={
            "frames": [1e6, 2e6],
            "return": [-0.5, 0.75],
            "return_half_width": [0.1, 0.05],
            "survival": [0.5, 0.96],
            "collected": [0.0, 0.79],
            "fill": [NAN, NAN],
        },
        results={"random": result(-0.5, deaths={"battery_valid": 48}, survival=0.25), "trained": result(0.75, gain=gain)},
        episodes=[Chosen("best", 17, episode)],
        played=64,
        config={"preset": "NadirScan-v1", "hidden": [64, 32], "frames": None},
        facts={"Python": "3"},
        command="bsk-torch train NadirScan-v1",
    )
