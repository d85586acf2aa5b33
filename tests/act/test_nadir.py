"""Nadir pointing: which axis looks down, the warning for one that does not, and errors of pointing as properties."""

import logging
from typing import Any

import pytest
import torch

from bsk_torch import SatelliteTasking, act, craft, data, dyn, fsw, obs, sats, scene
from bsk_torch.astro.ephemeris import earth_orientation, sun_position

NADIR, CHARGE, IMAGE = range(3)

ERRORS = ("nadir_pointing_error", "target_pointing_error", "solar_pointing_error")


class Imager(sats.ImagingSatellite):
    observation_spec = (obs.SatProperties(*(dict(prop=name) for name in ERRORS)),)
    action_spec = (act.NadirPoint(duration=900.0), act.Charge(duration=600.0), act.Image(1))
    dyn_type = dyn.ImagingDynModel
    fsw_type = fsw.SteeringImagerFSWModel


class Scanner(sats.AccessSatellite):
    observation_spec = (obs.SatProperties(*(dict(prop=name) for name in ERRORS)),)
    action_spec = (act.DiscreteFSWAction("nadir_point", name="look_down", duration=60.0), act.Scan(duration=60.0))
    dyn_type = dyn.ContinuousImagingDynModel
    fsw_type = fsw.ContinuousImagingFSWModel


def fly(satellite: sats.Satellite, backend: str = "eager", **options: Any) -> SatelliteTasking:
    targets = scene.UniformTargets(200) if isinstance(satellite, sats.ImagingSatellite) else scene.Scenario()
    common: dict[str, Any] = {"num_envs": 3, "time_limit": 6000.0, "seed": 0, "dtype": torch.float64, "backend": backend}
    return SatelliteTasking(satellite, targets, data.NoReward(), **(common | options))


def step(env: SatelliteTasking, action: int) -> torch.Tensor:
    return env.step(env.observe().set("action", torch.full((3,), action)))["next", "observation"]


def turned(matrix: torch.Tensor, vector: torch.Tensor) -> torch.Tensor:
    return (matrix @ vector.unsqueeze(-1)).squeeze(-1)


def angle(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    """Angle between vectors [N, 3] by its tangent."""
    return torch.atan2(torch.linalg.cross(a, b).norm(dim=-1), (a * b).sum(-1))


@pytest.mark.parametrize("backend", ["eager", pytest.param("compiled", marks=pytest.mark.compiled)])
@pytest.mark.nightly("eager")
def test_errors_are_angles_of_vectors(backend):
    """Also the one that Basilisk's locationPointing takes for the target, ``4 atan |sigma_BR|``, a tick earlier."""
    short = {"max_step_duration": 60.0} if backend == "eager" else {}
    args = dict(inst_pHat_B=[-1.0, 0.2, 0.1], imageAttErrorRequirement=1e-9, imageTargetMinimumElevation=0.1)  # soon in view
    env = fly(Imager("A", craft.cubesat() | args), backend, **short)
    env.reset()
    for action in (NADIR, CHARGE, IMAGE):
        errors = step(env, action)
        dynamics, args, et = env.satellite.dynamics, env.satellite.sat_args, env.simulator.world.et
        instrument, panel = (turned(dynamics.BN.mT, args[name].expand(3, 3)) for name in ("inst_pHat_B", "nHat_B"))
        target = turned(earth_orientation(et).mT, env.simulator.read("r_LP_P"))
        lines = -dynamics.r_BN_N, target - dynamics.r_BN_N, sun_position(et) - dynamics.r_BN_N
        expected = [angle(axis, line) for axis, line in zip((instrument, instrument, panel), lines, strict=True)]
        torch.testing.assert_close(errors, torch.stack(expected, -1), rtol=0.0, atol=1e-7)
    guided = 4.0 * torch.atan(env.simulator.read("location_sigma_BR").norm(dim=-1))
    assert (errors[:, 1] - guided).abs().max() < 0.02  # rad; what the satellite turns in a tick near its target


@pytest.mark.compiled
def test_a_spacecraft_of_the_library_looks_at_nadir(caplog):
    """Not so with bsk_rl's axis, the orbit normal, of which a warning tells once."""
    env = fly(Imager("A", craft.cubesat()), "compiled")
    env.reset()
    assert step(env, NADIR)[:, 0].max() < 1e-4
    assert step(env, CHARGE)[:, 2].max() < 1e-4
    assert not [record for record in caplog.records if "nadir" in record.getMessage()]
    env = fly(Imager("A", craft.cubesat() | dict(inst_pHat_B=[0.0, 0.0, 1.0])), "compiled")
    env.reset()
    assert (step(env, NADIR)[:, 0] - 0.5 * torch.pi).abs().max() < 1e-4
    [said] = [record.getMessage() for record in caplog.records if "nadir" in record.getMessage()]
    assert "90 degrees off nadir" in said
    assert "inst_pHat_B=[-1, 0, 0]" in said


def test_a_scan_targets_the_center_of_the_earth(caplog):
    """And the command warns under any name, once for all environments of a kind, and not under compat."""
    env = fly(Scanner("A"))
    env.reset()
    env.like(2, torch.arange(2)).reset()
    errors = step(env, 1)
    assert torch.equal(errors[:, 0], errors[:, 1])
    assert len([record for record in caplog.records if "'look_down'" in record.getMessage()]) == 1
    caplog.clear()
    fly(Scanner("A"), compat="bsk_rl")
    fly(Scanner("A", dict(inst_pHat_B=[-2.0, 0.0, 0.0])))
    assert not [record for record in caplog.records if record.levelno >= logging.WARNING and "nadir" in record.getMessage()]
