"""Records of decisions and what becomes of them: in chosen environments only, and nothing where nothing is asked for."""

import logging

import pytest
import torch

from bsk_torch import SatelliteTasking, act, data, obs, sats, scene
from bsk_torch.env.log import SimulationFormatter
from tests.support.refusals import check_refusals, refusal
from tests.wrappers.constellations import FULL, trio


@pytest.fixture(autouse=True)
def restored():
    """The package's logger is as before."""
    logger = logging.getLogger("bsk_torch")
    level, handlers = logger.level, list(logger.handlers)
    yield
    logger.setLevel(level)
    for handler in set(logger.handlers) - set(handlers):
        logger.removeHandler(handler)
        handler.close()


def charge_all(env, steps=1):
    now = env.reset()
    for _ in range(steps):
        now["agents", "action"] = torch.ones(*env.batch_size, 3, dtype=torch.int64)
        now = env.step(now)["next"]
    return env


def found(caplog, **fields):
    return [r for r in caplog.records if all(getattr(r, name, None) == value for name, value in fields.items())]


def test_a_constellation_records_decisions_deaths_and_rewards(caplog):
    env = trio(charges=(FULL, 20.0, FULL), backend="eager", seed=5, log_level="info")
    now = env.reset()
    now["agents", "action"] = torch.tensor([[1, 0, 2]])
    env.step(now)
    (began,) = found(caplog, event="began")
    assert (began.seed, began.episode, began.sim_time, began.satellite) == (5, 0, 0.0, None)
    assert [(r.satellite, r.action_name, r.ends) for r in found(caplog, event="chose")] == [
        ("S0", "action_charge", 6.0),
        ("S1", "action_nadir_scan", 9.0),
        ("S2", "action_desat", 3.0),
    ]
    (died,) = found(caplog, event="died")
    assert (died.satellite, died.checks, died.levelname) == ("S1", ["battery_valid"], "WARNING")
    assert (died.name, died.sim_time) == ("bsk_torch.sats.S1", pytest.approx(3.0))
    (step,) = found(caplog, event="step")
    assert (step.duration, step.reward["S1"]) == (pytest.approx(3.0), -1.0)
    assert [r.satellite for r in found(caplog, event="idle")] == ["S2"]
    assert not found(caplog, event="legal")


def test_chosen_environments_are_recorded_at_the_level_asked_for(caplog):
    charge_all(trio(num_envs=3, backend="eager", log_level="INFO", log_envs=[0, 2]))
    assert {r.env for r in caplog.records if hasattr(r, "env")} == {0, 2}
    line = SimulationFormatter().format(found(caplog, event="chose", env=2)[0])
    assert line.endswith("sats.S0                  INFO     <0.00> env 2 S0: action_charge, until 6.0 s at the latest")
    charge_all(trio(backend="eager", log_level="INFO"), steps=3)
    (ended,) = found(caplog, event="ended")
    assert (ended.truncated, ended.terminated, ended.sim_time) == (True, False, pytest.approx(15.0))


def test_debug_adds_what_satellites_may_do(caplog):
    charge_all(trio(backend="eager", log_level="DEBUG"))
    assert found(caplog, event="legal", satellite="S0")[0].action_mask == [True] * 3


class Imager(sats.ImagingSatellite):
    observation_spec = (obs.Time(),)
    action_spec = (act.Charge(duration=30.0), act.Image(n_ahead_image=3))


@pytest.fixture(scope="module")
def imager():
    args = dict(imageAttErrorRequirement=0.1, imageRateErrorRequirement=0.1, u_max=0.4)
    options = dict(time_limit=240.0, backend="eager", seed=2, log_level="INFO")
    return SatelliteTasking(Imager("EO1", args), scene.UniformTargets(3000), data.UniqueImageReward(), **options)


def test_images_and_missed_windows_are_recorded_with_their_targets(imager, caplog):
    now = imager.reset()
    while not bool(now["done"]) and int(imager.satellite.imaged) == 0:
        now = imager.step(now.set("action", torch.tensor([1])))["next"]
    took, missed = found(caplog, event="took"), found(caplog, event="counted", counter="missed")
    assert (len(took), len(missed)) == (int(imager.satellite.imaged), int(imager.satellite.missed))
    assert took
    chosen = [r.target for r in found(caplog, event="chose")]
    assert all(target.startswith("tgt-") for target in chosen)
    assert {r.target for r in took + missed} <= set(chosen)
    assert took[0].getMessage() == f"imaged {took[0].target}"


def test_a_target_by_its_index_is_named(imager, caplog):
    now = imager.reset()
    place = imager.satellite.find_next_opportunities(1).place[:, 0]
    imager.step(now.set("action", act.image_target(place)))
    assert found(caplog, event="chose")[0].target == f"tgt-{int(place)}"


def test_a_file_gets_the_records(tmp_path):
    file = tmp_path / "logs" / "episode.txt"
    charge_all(trio(backend="eager", log_level="INFO", log_dir=file))
    assert "S2: action_charge" in file.read_text()
    check_refusals(refusal(lambda: trio(backend="eager", log_dir=tmp_path), ValueError, tmp_path, "folder"))


def test_nothing_is_recorded_unless_asked_for(caplog):
    caplog.set_level("DEBUG", "bsk_torch")
    env = charge_all(trio(backend="eager"))
    assert env.log is None
    assert not [r for r in caplog.records if hasattr(r, "event")]


def test_rejects_wrong_options():
    check_refusals(
        refusal(lambda: trio(backend="eager", log_level="INF"), ValueError, "log_level", "'INF'"),
        refusal(lambda: trio(backend="eager", log_level="INFO", log_envs=[1]), ValueError, "log_envs", 1),
    )
