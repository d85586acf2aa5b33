"""Light at targets: the Sun's elevation against a textbook, in windows, and where images are taken."""

import math
from datetime import datetime, timedelta
from types import SimpleNamespace

import pytest
import torch

from bsk_torch import SatelliteTasking, act, data, obs, rand, sats, scene
from bsk_torch.astro.ephemeris import earth_orientation, parse_utc, sun_position
from bsk_torch.astro.frames import sin_elevation
from bsk_torch.constants import R_EARTH
from bsk_torch.sim import dyn, fsw
from bsk_torch.sim.component import Bus
from bsk_torch.sim.environment.ephemeris import EPHEMERIS_TRACK, ephemeris_records, pole_matrix, put_track
from bsk_torch.sim.fsw import target
from bsk_torch.vec3 import Vec3
from tests.sim.buses import plane, write
from tests.support.refusals import check_refusals, refusal

LOW, HIGH = "imageTargetMinimumSunElevation", "imageTargetMaximumSunElevation"


def textbook(when: datetime, latitude: torch.Tensor, longitude: torch.Tensor) -> tuple[torch.Tensor, float]:
    """Sine of the solar elevation, and declination, rad, by the Astronomical Almanac's low-precision formulas (page C5).

    They are good to 0.01 degrees:

    ``sin e = sin(phi) sin(delta) + cos(phi) cos(delta) cos(H)`` with the hour angle ``H = GMST + longitude - alpha``.
    """
    days = (when - datetime(2000, 1, 1, 12)).total_seconds() / 86400.0
    L, g = math.radians(280.460 + 0.9856474 * days), math.radians(357.528 + 0.9856003 * days)
    along = L + math.radians(1.915) * math.sin(g) + math.radians(0.020) * math.sin(2.0 * g)
    tilt = math.radians(23.439 - 4e-7 * days)
    alpha, delta = math.atan2(math.cos(tilt) * math.sin(along), math.cos(along)), math.asin(math.sin(tilt) * math.sin(along))
    gmst = math.radians(280.46061837 + 360.98564736629 * days)
    hour = gmst + longitude - alpha
    sine = torch.sin(latitude) * math.sin(delta) + torch.cos(latitude) * math.cos(delta) * torch.cos(hour)
    return sine, delta


def places(n: int) -> torch.Tensor:
    random = torch.Generator().manual_seed(1)
    return R_EARTH * torch.nn.functional.normalize(torch.randn(n, 3, generator=random, dtype=torch.float64), dim=-1)


@pytest.mark.parametrize("when", ["2021-05-04T00:00:00", "2024-03-20T15:00:00", "2026-12-21T06:30:00", "2029-08-01T21:17:03"])
def test_the_elevation_of_the_sun_is_that_of_the_textbook(when):
    """Within 0.1 degrees: the prime meridian of IAU_EARTH, Basilisk's frame, is off by 0.08 to 0.095 in these years.

    The declination does not depend on it, and agrees within the error of the textbook.
    """
    et, r_LP_P = torch.tensor(parse_utc(when), dtype=torch.float64), places(500)
    sun_P = earth_orientation(et) @ sun_position(et)
    found = torch.asin(sin_elevation(Vec3.of(sun_P.expand(500, 3)), Vec3.of(r_LP_P)))
    x, y, z = (r_LP_P / R_EARTH).unbind(-1)
    sine, declination = textbook(datetime.fromisoformat(when), torch.asin(z), torch.atan2(y, x))
    torch.testing.assert_close(found, torch.asin(sine), rtol=0, atol=math.radians(0.1))
    assert math.asin(sun_P[2] / sun_P.norm()) == pytest.approx(declination, abs=math.radians(0.01))


@pytest.mark.parametrize(("low", "high"), [(0.1, None), (None, -0.2), (-0.1, 0.3)])
def test_a_target_has_access_in_the_light_of_one_tick_ago(low, high):
    n, h, epoch = 2000, 2.0, parse_utc("2021-05-04T01:00:00")
    et, r_LP_P = torch.full((n,), epoch, dtype=torch.float64), places(n)
    bus = Bus(round(h * 1e9))
    put_track(bus, EPHEMERIS_TRACK, ephemeris_records(et, 2).flatten(1).unbind(-1), torch.full((n,), 1200.0).double())
    PN = earth_orientation(et[0] + 1200.0 - h)
    write(bus, EN=pole_matrix(et + 1200.0), location_on=plane(1.0, n), r_LP_P=Vec3.of(r_LP_P))
    bus.r_BN_N = Vec3.of(1.1 * r_LP_P @ PN)  # above each
    given = {LOW: low, HIGH: high, target.VERTICAL: "radius"}
    args = {"imageTargetMinimumElevation": plane(0.8, 1), "imageTargetMaximumRange": plane(-1.0, 1)}
    args |= {name: plane(value, 1) for name, value in ((LOW, low), (HIGH, high)) if value is not None}
    part = target.fitted_target(given)
    write(bus, **part.prepare(args))
    part.update(bus)
    sine = sin_elevation(Vec3.of((PN @ sun_position(et[0] + 1200.0 - h)).expand(n, 3)), Vec3.of(r_LP_P))
    low, high = (math.sin(value) if value is not None else sign for value, sign in ((low, -2.0), (high, 2.0)))
    clear = ((sine - low).abs() > 1e-9) & ((sine - high).abs() > 1e-9)
    expected = (sine >= low) & (sine <= high)
    assert torch.equal((bus.target_access > 0.0)[clear], expected[clear])
    assert expected.any()
    assert not expected.all()


class Imager(sats.ImagingSatellite):
    observation_spec = (obs.Time(),)
    action_spec = (act.Image(n_ahead_image=3),)
    dyn_type = dyn.ImagingDynModel
    fsw_type = fsw.SteeringImagerFSWModel


def environment(backend: str = "eager", **args: object) -> SatelliteTasking:
    return SatelliteTasking(
        Imager("A", {"imageTargetMinimumElevation": math.radians(30.0), **args}),
        scenario=scene.UniformTargets(400),
        rewarder=data.UniqueImageReward(),
        num_envs=3,
        time_limit=6000.0,
        seed=0,
        backend=backend,
    )


def sun_sine(env: SatelliteTasking, time: torch.Tensor, place: torch.Tensor) -> torch.Tensor:
    """Sine of the Sun's elevation at places [N, W] and times [N, W] s."""
    et = env.satellite.simulator.arcs.et.unsqueeze(-1) + time
    sun_P = (earth_orientation(et) @ sun_position(et).unsqueeze(-1)).squeeze(-1)
    return sin_elevation(Vec3.of(sun_P), Vec3.of(env.scenario.r_LP_P.gather(1, place.unsqueeze(-1).expand(-1, -1, 3))))


def contains(windows: SimpleNamespace, time: torch.Tensor, place: torch.Tensor) -> torch.Tensor:
    """Whether times [N, K] of places [N, K] lie in windows."""
    same = windows.place.unsqueeze(1) == place.unsqueeze(-1)
    time = time.unsqueeze(-1)
    return (same & (windows.open.unsqueeze(1) <= time) & (time <= windows.close.unsqueeze(1))).any(-1)


@pytest.mark.parametrize(
    ("low", "high"), [(0.2, None), (None, -0.1), (rand.per_env([-0.1, 0.1, 0.0]), 0.4)], ids=["lit", "dark", "drawn"]
)
def test_windows_are_those_of_passes_in_the_light_wanted(low, high):
    """Points in all passes lie in a window where, and only where, the Sun is within the limits."""
    plain, lit = environment(), environment(**{name: value for name, value in ((LOW, low), (HIGH, high)) if value is not None})
    for env in (plain, lit):
        env.reset()
    passes, windows = (env.satellite.find_windows(6000.0) for env in (plain, lit))
    there = torch.isfinite(passes.close)
    limits = [
        lit.satellite.sat_args[name].sin().expand(3).unsqueeze(-1) if value is not None else sign
        for name, value, sign in ((LOW, low, -2.0), (HIGH, high, 2.0))
    ]
    counts = [0, 0]
    for share in torch.linspace(0.02, 0.98, 9).tolist():
        time = torch.where(there, passes.open + share * (passes.close - passes.open), 0.0)
        sine = sun_sine(plain, time, passes.place)
        wanted = (sine >= limits[0]) & (sine <= limits[1])
        clear = there & ((sine - limits[0]).abs() > 1e-5) & ((sine - limits[1]).abs() > 1e-5)
        found = contains(windows, time, passes.place)
        assert torch.equal(found[clear], wanted[clear])
        counts = [counts[0] + int(wanted[clear].sum()), counts[1] + int((~wanted[clear]).sum())]
    assert min(counts) > 100


class Observer(Imager):
    observation_spec = (
        obs.OpportunityProperties(
            *(dict(prop=prop) for prop in ("sun_elevation", "opportunity_open", "r_LP_P")), n_ahead_observe=5
        ),
    )


def test_the_suns_elevation_is_observed_where_and_when_windows_open():
    """Within 0.1 degrees of the textbook: see the first test. Windows that are open are lit as they are now."""
    when = datetime(2024, 3, 20, 15)
    env = SatelliteTasking(
        Observer("A", {"imageTargetMinimumElevation": math.radians(30.0)}),
        scenario=scene.UniformTargets(400),
        rewarder=data.NoReward(),
        num_envs=6,
        time_limit=6000.0,
        world_args={"utc_init": when.isoformat()},
        dtype=torch.float64,
        seed=0,
        backend="eager",
    )
    td = env.step(env.reset().set("action", torch.zeros(6, dtype=torch.int64)))["next"]
    elevation, opens, x, y, z = td["observation"].view(6, 5, 5).unbind(-1)
    assert (opens < 0.0).any()
    assert (opens > 0.0).any()
    sooner = env.simulator.sim_time.unsqueeze(-1) + opens.clamp(min=0.0)
    radius = torch.stack([x, y, z], -1).norm(dim=-1)
    latitude, longitude = torch.asin(z / radius), torch.atan2(y, x)
    for row in range(6):
        for k in range(5):
            time = when + timedelta(seconds=sooner[row, k].item())
            sine, _ = textbook(time, latitude[row, k], longitude[row, k])
            assert elevation[row, k].item() == pytest.approx(math.asin(sine), abs=math.radians(0.1))
    assert (elevation > 0.1).any()
    assert (elevation < -0.1).any()


@pytest.mark.compiled
def test_images_are_taken_in_the_light_alone():
    env = environment("compiled", **{LOW: 0.1, HIGH: 0.6})
    td = env.reset()
    imaged = 0
    for _ in range(12):
        before = env.satellite.imaged.clone()
        td = env.step(td.set("action", torch.zeros(3, dtype=torch.int64)))["next"]
        took = env.satellite.imaged > before
        sine = sun_sine(env, env.simulator.sim_time.unsqueeze(-1), env.satellite.latest_target.clamp(min=0).unsqueeze(-1))[:, 0]
        # the image is of an earlier tick of the step's end, some seconds ago: 3e-4 rad
        assert bool(((sine > math.sin(0.1) - 1e-3) & (sine < math.sin(0.6) + 1e-3))[took].all())
        imaged += int(took.sum())
    assert imaged > 5


def test_rejects_impossible_light():
    check_refusals(
        refusal(lambda: environment(**{LOW: 10.0}), ValueError, f"{LOW}=10 rad", "[-1.5708, 1.5708]"),
        refusal(lambda: environment(**{LOW: 0.3, HIGH: 0.2}), ValueError, f"{LOW}=0.3 rad", f"{HIGH}=0.2 rad"),
    )


def test_without_limits_targets_are_those_of_before():
    assert target.fitted_target({LOW: None, HIGH: None, target.VERTICAL: "radius"}) is target.IMAGE_TARGET
    kinds = environment().satellite.access_windows.kinds
    assert kinds["target"].light == ()
