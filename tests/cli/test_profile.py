"""``bsk-torch profile``, and what it counts."""

import importlib
import re
import time

import pytest
import torch

from bsk_torch.rl.training.profile import ADVICE, COLLECTING, LEARNING, PHASES, Profile, advice, sampling

TINY = ["num_envs=2", "rollout=8", "--seconds", "0.3"]


@pytest.mark.compiled
@pytest.mark.parametrize(
    ("preset", "settings"),
    [
        ("NadirScan-v1", []),
        ("NadirScan-v1", ["workers=auto", "ahead=true", "evaluate_every=100", "imitate=rule"]),  # which it leaves out
        ("AEOSConstellation-v1", ["minibatch=8"]),
    ],
)
def test_the_phases_of_a_training_are_printed(run, preset, settings):
    result = run("profile", preset, *TINY, *settings)
    assert result.exit_code == 0, result.output
    rows = re.findall(r"^ *(\w.*\S) +[\d.,]+ +([\d.]+) *$", result.output, re.MULTILINE)
    shares = {name: float(share) for name, share in rows if name in PHASES}
    assert shares["learning: gradients"] > 0.0
    assert shares["collecting: simulation, observations, rewards"] > 0.0
    assert sum(shares.values()) > 90.0  # hardly anything belongs to no phase
    assert "decisions per CPU-second" in result.output
    assert "largest part: " in result.output


def test_wrong_settings_are_named(run):
    result = run("profile", "NadirScan-v1", "learning_rat=1")
    assert result.exit_code == 1
    assert "did you mean 'learning_rate'" in result.output


@pytest.mark.parametrize("place", [place for places in PHASES.values() for place in places])
def test_phases_are_of_code_that_exists(place):
    """A function that is renamed would silently count for another phase."""
    name, _, function = place.partition(":")
    module = importlib.import_module(name)
    if function:
        owners = [module, *(value for value in vars(module).values() if isinstance(value, type))]
        assert any(callable(getattr(owner, function, None)) for owner in owners)


def busy(seconds):
    end = time.thread_time() + seconds
    while time.thread_time() < end:
        torch.zeros(1)


def test_samples_add_up_to_the_time_of_each_part():
    def first():
        busy(0.2)

    def second():
        busy(0.1)

    def part(frame):
        while frame is not None:
            if frame.f_code in (first.__code__, second.__code__):
                return frame.f_code.co_name
            frame = frame.f_back
        return "other"

    for _ in range(5):  # other processes may take the processor from a run
        with sampling(part) as spent:
            first()
            second()
        if spent.get("first") == pytest.approx(0.2, rel=0.2) and spent.get("second") == pytest.approx(0.1, rel=0.3):
            return
    pytest.fail(f"no run of five has 0.2 s and 0.1 s: {spent}")


def test_advice_is_about_the_largest_part_and_bounds_what_cores_bring():
    spent = {LEARNING + "gradients": 50.0, COLLECTING + "TorchRL": 30.0, "the rest": 10.0, COLLECTING + "networks": 10.0}
    found = Profile(spent)
    assert found.total == 100.0
    largest, processes, ahead = advice(found)
    assert largest == f"largest part: learning: gradients; less with {ADVICE[LEARNING]}"
    assert "in one process: 60%" in processes
    assert "workers=2 is at most 1.2 times as fast, workers=8 1.5 times, any number 1.7 times" in processes
    assert ahead.endswith("at most 1.7 times as fast")
