import math

import pytest
import torch

from bsk_torch.astro.attitude import dcm_to_mrp, mrp_add, mrp_rate, mrp_subtract, mrp_to_dcm
from bsk_torch.astro.orbit import Elements, elements_to_rv, hill_frame
from bsk_torch.sim.component import Bus, declared
from bsk_torch.sim.dyn import ContinuousImagingDynModel, ImagingDynModel
from bsk_torch.sim.fsw import BasicFSWModel, ContinuousImagingFSWModel, ImagingFSWModel, Mode, guidance
from bsk_torch.sim.fsw.modes import mode_table
from bsk_torch.vec3 import Vec3
from tests.sim.buses import N, plane, vectors, write


def pointing(h: float = 1.0) -> Bus:
    """Satellites somewhere in orbit, pointing at random, about to point at something far away; all laws are on."""
    bus = write(
        Bus(round(h * 1e9)),
        r_BN_N=vectors(7e6),
        v_BN_N=vectors(7e3),
        sigma_BN=mrp_add(vectors(0.3), vectors(0.3)),
        omega_BN_B=vectors(0.01),
    )
    guidance.navigate(bus)
    for task in ("location", "sun"):
        memory = {f"{task}_fresh": plane(1.0), f"{task}_sigma_BR": Vec3.zeros_like(plane(0.0))}
        write(bus, **memory)
    write(bus, location_on=plane(1.0), sun_on=plane(1.0), nadir_on=plane(1.0))
    write(bus, panel_normal_B=vectors().unit(), r_SN_N=vectors(1.5e11))
    return write(bus, instrument_axis_B=vectors().unit(), r_LN_N=vectors(1e8))


ROUNDING = 1e-13

MODELS = (ContinuousImagingDynModel, ContinuousImagingFSWModel), (ImagingDynModel, ImagingFSWModel)

LAWS = {"sun": guidance.point_at_sun, "nadir": guidance.point_along_hill, "location": guidance.point_at_location}
"""In the order of a tick."""


def direct_error(bus: Bus) -> torch.Tensor:
    """Principal rotation from target direction to axis: ``-tan(phi / 4) e`` with ``phi = acos(p . x)``, ``e = p x x``."""
    x = (mrp_to_dcm(bus.sigma_BN) @ (bus.r_LN_N - bus.r_BN_N)).unit()
    phi = torch.acos(bus.instrument_axis_B.dot(x).clamp(-1.0, 1.0))
    return (bus.instrument_axis_B.cross(x).unit() * (-torch.tan(phi / 4.0))).stack()


def test_errors_are_relative_attitudes():
    bus = pointing()
    guidance.point_at_location(bus)
    torch.testing.assert_close(bus.error.sigma_BR.stack(), direct_error(bus), rtol=1e-10, atol=1e-12)
    assert torch.equal(bus.location_sigma_BR.stack(), bus.error.sigma_BR.stack())
    assert (bus.location_fresh == 0.0).all()
    bus = pointing()
    zero = torch.zeros(N, 3, dtype=torch.float64)
    for found, expected in zip(bus.error, (bus.sigma_BN.stack(), bus.omega_BN_B.stack(), zero, zero), strict=True):
        assert torch.equal(found.stack(), expected)
    # sigma_BR of hill pointing composes with the reference to the attitude itself.
    bus = pointing()
    guidance.point_along_hill(bus)
    reference = dcm_to_mrp(hill_frame(bus.r_BN_N, bus.v_BN_N))
    torch.testing.assert_close(mrp_to_dcm(mrp_add(reference, bus.error.sigma_BR)).stack(), bus.BN.stack(), rtol=0, atol=1e-12)
    torch.testing.assert_close(mrp_subtract(bus.sigma_BN, reference).stack(), bus.error.sigma_BR.stack(), rtol=0, atol=0)


def test_the_reference_points_at_the_target_and_turns_about_the_line_of_sight():
    """[RN] of sigma_RN = sigma_BN (+) -sigma_BR maps the line of sight to the axis."""
    bus = pointing()
    guidance.point_at_location(bus)
    RN = mrp_to_dcm(mrp_add(bus.sigma_BN, -bus.error.sigma_BR))
    torch.testing.assert_close(
        (RN @ (bus.r_LN_N - bus.r_BN_N).unit()).stack(), bus.instrument_axis_B.stack(), rtol=0, atol=ROUNDING
    )
    bus = pointing()
    guidance.point_at_location(bus)
    x = (bus.BN @ (bus.r_LN_N - bus.r_BN_N)).unit()
    error = bus.error
    torch.testing.assert_close(error.omega_BR_B.stack(), (x * bus.omega_BN_B.dot(x)).stack(), rtol=0, atol=ROUNDING)
    torch.testing.assert_close(error.omega_RN_B.stack(), (bus.omega_BN_B - error.omega_BR_B).stack(), rtol=0, atol=ROUNDING)
    assert (error.domega_RN_B.stack() == 0.0).all()


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-4, 1.0, math.pi - 1e-6])
def test_location_pointing_keeps_its_digits(angle):
    bus = pointing()
    zero = plane(0.0)
    write(bus, r_BN_N=Vec3(zero, zero, zero), sigma_BN=Vec3(zero, zero, zero), instrument_axis_B=Vec3(zero, zero, zero + 1.0))
    guidance.navigate(bus)
    bus.r_LN_N = Vec3(zero + math.sin(angle), zero, zero + math.cos(angle)) * 1e8
    guidance.point_at_location(bus)
    expected = [0.0, -math.tan(angle / 4.0), 0.0]
    found = bus.error.sigma_BR.stack()[0].tolist()
    assert found == pytest.approx(expected, rel=1e-9, abs=1e-24)


@pytest.mark.parametrize("h", [0.5, 1.0])
def test_rate_error_of_later_ticks_is_a_finite_difference(h):
    bus = pointing(h)
    guidance.point_at_location(bus)
    first = bus.location_sigma_BR
    bus.sigma_BN = mrp_add(bus.sigma_BN, vectors(1e-3))
    guidance.navigate(bus)
    guidance.point_at_location(bus)
    error = bus.error
    x = (bus.BN @ (bus.r_LN_N - bus.r_BN_N)).unit()
    without_damping = error.omega_BR_B - x * bus.omega_BN_B.dot(x)
    rate = mrp_rate(error.sigma_BR, without_damping)  # the difference is what this rate would have changed
    torch.testing.assert_close(rate.stack(), ((error.sigma_BR - first) / h).stack(), rtol=0, atol=1e-12)


def test_a_pointing_law_that_is_off_remembers_what_it_had():
    bus = pointing()
    bus.location_on = torch.where(torch.arange(N) % 2 == 0, plane(1.0), plane(0.0))
    bus.location_sigma_BR = vectors()
    before = bus.location_sigma_BR.stack()
    guidance.point_at_location(bus)
    assert torch.equal(bus.location_sigma_BR.stack()[1::2], before[1::2])
    assert (bus.location_sigma_BR.stack()[::2] != before[::2]).all()
    assert bus.location_fresh.tolist() == [0.0, 1.0] * (N // 2)


def test_sun_pointing_uses_the_panel():
    bus = pointing()
    write(bus, panel_normal_B=bus.instrument_axis_B, r_SN_N=bus.r_LN_N)
    guidance.point_at_location(bus)
    location = bus.error
    guidance.navigate(bus)
    guidance.point_at_sun(bus)
    assert len(location) == 4
    for found, expected in zip(bus.error, location, strict=True):
        assert torch.equal(found.stack(), expected.stack())


def test_hill_and_nadir_pointing():
    oe = (plane(7e6), plane(0.1), *torch.rand(4, N, dtype=torch.float64))
    bus = pointing()
    bus.r_BN_N, bus.v_BN_N = elements_to_rv(Elements(*oe))
    guidance.point_along_hill(bus)
    error, HN, BN = bus.error, hill_frame(bus.r_BN_N, bus.v_BN_N), mrp_to_dcm(bus.sigma_BN)
    torch.testing.assert_close(mrp_to_dcm(error.sigma_BR).stack(), BN.stack() @ HN.stack().mT, rtol=0, atol=1e-12)
    # rate and acceleration of the frame from the orbit at close times
    dt, mu = 1e-2, 398600.436e9
    acceleration = bus.r_BN_N * (-mu / bus.r_BN_N.norm() ** 3)

    def frame_at(t: float) -> torch.Tensor:
        jerk = (bus.v_BN_N - bus.r_BN_N * (3.0 * bus.r_BN_N.dot(bus.v_BN_N) / bus.r_BN_N.dot(bus.r_BN_N))) * (
            -mu / bus.r_BN_N.norm() ** 3
        )
        r = bus.r_BN_N + bus.v_BN_N * t + acceleration * (t * t / 2) + jerk * (t**3 / 6)
        v = bus.v_BN_N + acceleration * t + jerk * (t * t / 2)
        rate = r.cross(v).norm() / r.dot(r)
        return hill_frame(r, v).z.stack() * rate.unsqueeze(-1)

    omega, domega = frame_at(0.0), (frame_at(dt) - frame_at(-dt)) / (2 * dt)
    torch.testing.assert_close(error.omega_RN_B.stack(), (BN @ Vec3.of(omega)).stack(), rtol=0, atol=1e-15)
    torch.testing.assert_close(error.domega_RN_B.stack(), (BN @ Vec3.of(domega)).stack(), rtol=0, atol=1e-12)
    torch.testing.assert_close(error.omega_BR_B.stack(), (bus.omega_BN_B - error.omega_RN_B).stack(), rtol=0, atol=1e-15)
    # At the reference attitude the error vanishes and body x is radial.
    bus = pointing()
    bus.sigma_BN = dcm_to_mrp(hill_frame(bus.r_BN_N, bus.v_BN_N))
    guidance.navigate(bus)
    guidance.point_along_hill(bus)
    assert bus.error.sigma_BR.norm().amax() < ROUNDING
    torch.testing.assert_close(
        (bus.BN @ bus.r_BN_N.unit()).stack(), torch.eye(3).double()[:1].expand(N, 3), rtol=0, atol=ROUNDING
    )


def stacked(error: guidance.Error) -> torch.Tensor:
    """All errors of a law, [N, 12]."""
    return torch.cat([part.stack() for part in error], -1)


def test_the_law_that_is_on_is_tracked():
    """Bit for bit what that law says alone; rows without one keep the error of rest."""
    bus = pointing()
    expected = {"rest": stacked(bus.error)}
    for task, law in LAWS.items():
        law(bus)
        expected[task] = stacked(bus.error)
    assert len({e[0, 0].item() for e in expected.values()}) == 4
    guidance.navigate(bus)
    for k, task in enumerate(LAWS):
        write(bus, **{f"{task}_on": (torch.arange(N) % 4 == k).double()})
        if task != "nadir":
            write(bus, **{f"{task}_fresh": plane(1.0), f"{task}_sigma_BR": Vec3.zeros_like(plane(0.0))})
    for law in LAWS.values():
        law(bus)
    for k, task in enumerate((*LAWS, "rest")):
        assert torch.equal(stacked(bus.error)[k::4], expected[task][k::4])


@pytest.mark.parametrize("task", LAWS)
def test_laws_in_single_precision(task):
    """Positions stay float64 until they are directions, so only the rounding of attitudes remains."""
    torch.manual_seed(8)
    exact = pointing()
    LAWS[task](exact)
    torch.manual_seed(8)
    bus = pointing()
    bus.dtype = torch.float32
    for name in ("sigma_BN", "omega_BN_B", "instrument_axis_B", "panel_normal_B", f"{task}_sigma_BR"):
        if bus.has(name):
            setattr(bus, name, getattr(bus, name).to(torch.float32))
    guidance.navigate(bus)
    LAWS[task](bus)
    assert all(x.dtype == torch.float32 for part in bus.error for x in part)
    # measured up to 4e-6, where an axis points almost away from its target; elsewhere a few roundings of 6e-8
    torch.testing.assert_close(stacked(bus.error).double(), stacked(exact.error), rtol=0, atol=1e-5)


@pytest.mark.parametrize(
    ("mode", "on"),
    [
        ("idle", {"instrument_power", "transmitter_on", "thruster_power"}),
        ("drift", set()),
        ("charge", {"control_on", "sun_on"}),
        ("nadir_point", {"control_on", "nadir_on"}),
        ("downlink", {"control_on", "nadir_on", "transmitter_on"}),
        ("nadir_scan", {"control_on", "location_on", "controller_on", "instrument_linked", "instrument_power"}),
        ("image", {"control_on", "location_on", "controller_on", "instrument_power"}),
        ("desat_sun", {"control_on", "sun_on", "desat_on", "thruster_power"}),
        ("desat_nadir", {"control_on", "nadir_on", "desat_on", "thruster_power"}),
        ("desat_none", {"control_on", "desat_on", "thruster_power"}),
    ],
)
def test_mode_table(mode, on):
    dyn_type, fsw_type = MODELS[mode == "image"]
    entry = mode_table(fsw_type.all_modes(), declared(dyn_type, fsw_type))[mode]
    assert set(entry.on) == on
    assert ("sun_fresh" in entry.resets) == ("sun_on" in on)
    assert ("dump_calls" in entry.resets) == ("desat_on" in on)
    assert ("image_taken" in entry.resets) == (mode == "image")


def test_modes_and_commands_of_models():
    assert "nadir_scan" not in BasicFSWModel.all_modes()
    assert "nadir_scan" not in ImagingFSWModel.all_modes()
    assert "image" not in ContinuousImagingFSWModel.all_modes()
    assert "image" not in ContinuousImagingFSWModel.all_commands()
    assert ContinuousImagingFSWModel.all_commands()["desat"].modes == ("desat_sun", "desat_nadir", "desat_none")
    assert ContinuousImagingFSWModel.all_commands()["charge"].modes == ("charge",)
    with pytest.raises(ValueError, match=r"on='warp_on' must be a tuple of flags: write on=\('warp_on',\)"):
        Mode("warp_on")


def test_a_subclass_takes_a_mode_away_and_another_gives_it_back():
    class Blind(ImagingFSWModel):
        modes = {"image": None, "downlink": None}  # noqa: RUF012

    class Seeing(Blind):
        modes = {"image": Mode(("location_on",))}  # noqa: RUF012

    kept = set(ImagingFSWModel.all_modes())
    assert set(Blind.all_modes()) == kept - {"image", "downlink"}
    assert set(Seeing.all_modes()) == set(Seeing.all_commands()) - {"desat"} == kept - {"downlink"}
