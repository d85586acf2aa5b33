"""Reference slews: their motion in closed form, the frames that they end in, and flown ones with wheels and ticks."""

import math

import pytest
import torch

from bsk_torch import SatelliteTasking, act, craft, data, dyn, fsw, obs, sats, scene
from bsk_torch.astro.attitude import dcm_to_mrp
from bsk_torch.astro.ephemeris import EARTH_ROTATION_RATE
from bsk_torch.astro.orbit import hill_frame
from bsk_torch.constants import MU_EARTH
from bsk_torch.rand import per_env
from bsk_torch.sim.component import Bus
from bsk_torch.sim.fsw import reference_slew as slew
from bsk_torch.vec3 import Mat3, Vec3
from tests.sim.buses import N, plane, vectors, write
from tests.support.refusals import check_refusals, refusal

TICK = 0.5


def cross_matrix(v: torch.Tensor) -> torch.Tensor:
    eye = torch.eye(3, dtype=torch.float64).expand(*v.shape[:-1], 3, 3)
    return torch.linalg.cross(v.unsqueeze(-2).expand_as(eye), eye).mT


def turned(theta: Vec3, v: Vec3) -> torch.Tensor:
    """``exp(-[theta x]) v`` by the exponential of a matrix."""
    return (torch.matrix_exp(-cross_matrix(theta.stack())) @ v.stack().unsqueeze(-1)).squeeze(-1)


# -- closed forms ---------------------------------------------------------------------------------------------------------------


def one(*values: float) -> list[torch.Tensor]:
    return [torch.tensor([value], dtype=torch.float64) for value in values]


@pytest.mark.parametrize(
    ("start", "rate", "duration"),
    [
        (0.1, 0.0, 2.0 * math.sqrt(0.1 / 0.02)),  # from rest to rest, without coasting
        (1.0, 0.0, 1.0 / 0.1 + 0.1 / 0.02),  # with coasting
        (0.0, 0.05, (1.0 + math.sqrt(2.0)) * 0.05 / 0.02),  # stops and comes back
        (0.0625, -0.05, 0.05 / 0.02),  # just braking: 0.05^2 / (2 * 0.02)
        (0.0, 0.0, 0.0),
    ],
)
def test_a_leg_is_as_fast_as_a_double_integrator_can_be(start, rate, duration):
    found = slew.leg(*one(start, rate, 0.02, 0.1))
    assert found.duration.item() == pytest.approx(duration, abs=1e-6)


def test_legs_end_at_rest_at_zero_within_their_limits():
    torch.manual_seed(0)
    start, rate = torch.rand(200, dtype=torch.float64), 0.2 * torch.rand(200, dtype=torch.float64) - 0.1
    found = slew.leg(start, rate, torch.full_like(start, 0.02), torch.full_like(start, 0.1))
    times = torch.linspace(0.0, 1.0, 2001, dtype=torch.float64).unsqueeze(-1) * found.duration
    place, speed = found.at(times)
    torch.testing.assert_close(place[0], start)
    torch.testing.assert_close(speed[0], rate)
    assert place[-1].abs().max() < 1e-12
    assert speed[-1].abs().max() < 1e-12
    assert speed.abs().max() <= 0.1 + 1e-12
    step = times[1] - times[0]
    assert ((speed[1:] - speed[:-1]).abs() <= 0.02 * step + 1e-12).all()
    # the trapezoidal rule is exact but in the three steps in which the acceleration changes
    moved = (0.5 * (speed[1:] + speed[:-1]) * step).sum(0)
    torch.testing.assert_close(moved, -start, rtol=0, atol=1e-4)
    before, same = found.at(torch.full_like(start, -2.0))
    torch.testing.assert_close(before, start - 2.0 * rate)
    torch.testing.assert_close(same, rate)


def test_both_legs_of_a_slew_end_together():
    torch.manual_seed(1)
    theta, rate = vectors(0.5), vectors(0.01)
    acceleration, limit = plane(0.005), plane(0.03)
    share = slew.fitting_share(theta, rate, acceleration, limit)
    along, across = slew.plan(theta, rate, share, acceleration, limit).legs
    assert (across.duration <= along.duration + 1e-9).all()
    assert (along.duration - across.duration < 0.01 * along.duration).all()
    start, speed = slew.plan(theta, rate, share, acceleration, limit).at(plane(0.0))
    torch.testing.assert_close(start.stack(), theta.stack())
    torch.testing.assert_close(speed.stack(), rate.stack())


@pytest.mark.parametrize("size", [1e-3, 0.5, 2.5])
def test_rates_of_rotation_vectors(size):
    """``exp(-[theta x])`` against the exponential of a matrix, and its rate against differences of it."""
    torch.manual_seed(2)
    theta, rate, v = vectors().unit() * size, vectors(0.1), vectors()
    torch.testing.assert_close(slew.turned_back(theta, v).stack(), turned(theta, v), rtol=0, atol=1e-12)
    step = 1e-5
    after, before = (turned(theta + rate * dt, v) for dt in (step, -step))
    omega = slew.angular_rate(theta, rate)
    # components in R of a vector at rest in R_0 change by -omega x v
    expected = -omega.cross(slew.turned_back(theta, v)).stack()
    torch.testing.assert_close((after - before) / (2.0 * step), expected, rtol=0, atol=1e-8)
    torch.testing.assert_close(slew.vector_rate(theta, omega).stack(), rate.stack(), rtol=0, atol=1e-9)


def test_the_target_frame_follows_the_line_of_sight():
    """Axes and rate in closed form against differences of axes; moved by two seconds, against the motion two seconds later."""
    torch.manual_seed(3)
    r, v = vectors().unit() * 7e6, vectors().unit() * 7.5e3
    eye = Mat3(*(Vec3(*(plane(float(i == j)) for j in range(3))) for i in range(3)))
    bus = write(Bus(10**9), EN=eye, cos_earth=plane(0.8), sin_earth=plane(0.6), r_LP_P=vectors().unit() * 6.37e6)
    write(bus, r_BN_N=r, v_BN_N=v, sigma_BN=vectors(), omega_BN_B=vectors())
    motion = slew.relative_motion(bus)
    at = slew.sight(motion, 0.0)
    rows = at.axes.stack()
    torch.testing.assert_close(rows @ rows.mT, torch.eye(3, dtype=torch.float64).expand(N, 3, 3), rtol=0, atol=1e-12)
    assert torch.linalg.det(rows).min() > 0.0
    place = Vec3(bus.r_LP_P.x * 0.8 - bus.r_LP_P.y * 0.6, bus.r_LP_P.x * 0.6 + bus.r_LP_P.y * 0.8, bus.r_LP_P.z)
    torch.testing.assert_close(at.axes.x.stack(), (place - r).unit().stack())
    spin = Vec3(plane(0.0), plane(0.0), plane(EARTH_ROTATION_RATE))
    torch.testing.assert_close(motion.v.stack(), (v - spin.cross(place)).stack())
    gravity = r * (-MU_EARTH) / (r.norm() * r.norm() * r.norm())
    torch.testing.assert_close(motion.a.stack(), (gravity - spin.cross(spin.cross(place))).stack())
    step = 1e-3
    ends = [slew.sight(motion, dt).axes.stack() for dt in (step, -step)]
    turning = (ends[0] - ends[1]) / (2.0 * step)
    expected = torch.linalg.cross(at.rate.stack().unsqueeze(1), rows)
    # the orbit normal stays, though it turns where the acceleration is out of the plane: random velocities have none such
    torch.testing.assert_close(turning, expected, rtol=0, atol=1e-8)


# -- flown ----------------------------------------------------------------------------------------------------------------------


class Slewing(sats.ImagingSatellite):
    observation_spec = (obs.Time(),)
    action_spec = (act.Image(n_ahead_image=3),)
    dyn_type = dyn.ImagingDynModel
    fsw_type = fsw.ReferenceSlewFSWModel


AGILE = craft.from_slew_limits(1.8, 0.4, 2.0, h=TICK)
RATE, ACCELERATION = AGILE["slewRate"], AGILE["slewAcceleration"]


def environment(rows: int, r: torch.Tensor, v: torch.Tensor, sigma: torch.Tensor, **args: object) -> SatelliteTasking:
    """Satellites with the orbit of a state, m and m/s in N, that rest at attitudes [rows, 3]; one kernel serves all."""
    start = dict(rN=r.expand(rows, 3), vN=v.expand(rows, 3), sigma_init=sigma.expand(rows, 3), omega_init=torch.zeros(rows, 3))
    env = SatelliteTasking(
        Slewing("A", AGILE | {name: per_env(value.double()) for name, value in start.items()} | args),
        scenario=scene.UniformTargets(200),
        rewarder=data.UniqueImageReward(),
        world_args={"utc_init": "2026 APR 14 04:00:00.000 (UTC)"},
        num_envs=rows,
        seed=0,
        time_limit=3000.0,
        max_step_duration=300.0,
        sim_rate=TICK,
    )
    env.reset()
    return env


def circular(radius: float, inclination: float) -> tuple[torch.Tensor, torch.Tensor]:
    speed = math.sqrt(MU_EARTH / radius)
    r = torch.tensor([radius, 0.0, 0.0], dtype=torch.float64)
    return r, torch.tensor([0.0, speed * math.cos(inclination), speed * math.sin(inclination)], dtype=torch.float64)


def low_orbit(rows: int, **args: object) -> SatelliteTasking:
    """Satellites 550 km high, whose instruments look down."""
    r, v = circular(6.378e6 + 550e3, 1.7)
    return environment(rows, r, v, dcm_to_mrp(hill_frame(Vec3.of(r), Vec3.of(v))).stack(), **args)


def look(env: SatelliteTasking, places: torch.Tensor, ticks: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Point at Earth-fixed places [N, 3]; returns pointing errors and rates [ticks, N] in N of the following ticks."""
    simulator, dynamics = env.simulator, env.satellite.dynamics
    rows = torch.ones(len(places), dtype=torch.bool)
    simulator.command(rows, simulator.mode_index("image"))
    simulator.write("r_LP_P", rows, places)
    errors, rates = [], []
    for _ in range(ticks):
        simulator.run(torch.ones(len(places), dtype=torch.int64))
        errors.append(env.satellite.fsw.target_pointing_error)
        rates.append((dynamics.BN.mT @ dynamics.omega_BN_B.unsqueeze(-1)).squeeze(-1))
    return torch.stack(errors), torch.stack(rates)


def last_above(values: torch.Tensor, limit: float) -> torch.Tensor:
    """Time from which on values [ticks, N] stay within a limit, s."""
    index = torch.arange(1, len(values) + 1).unsqueeze(-1)
    return TICK * (torch.where(values > limit, index, 0).amax(0) + 1)


GEO = 42_164e3


@pytest.mark.compiled
def test_slews_from_rest_to_rest_take_the_time_of_their_limits():
    """Of 5, 20 and 50 degrees about two axes and between, seen from so far that the place hardly moves.

    The command acts two ticks later. The bounds are those of the benchmark aeossp_standard with its settling time of 2 s.
    """
    axes = torch.tensor([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.6, 0.8]], dtype=torch.float64)
    degrees = torch.tensor([5.0, 20.0, 50.0], dtype=torch.float64)
    angle = torch.deg2rad(degrees).repeat_interleave(3)
    sigma = torch.tan(angle / 4.0).unsqueeze(-1) * axes.repeat(3, 1)
    env = environment(9, *circular(GEO, 0.0), sigma)
    places = env.satellite.dynamics.r_BN_P * (6.378e6 / GEO)
    errors, rates = look(env, places, round(40.0 / TICK))
    short = 2.0 * torch.sqrt(angle / ACCELERATION)
    ideal = torch.where(angle <= RATE**2 / ACCELERATION, short, RATE / ACCELERATION + angle / RATE)
    torch.testing.assert_close(errors[0], angle, rtol=0, atol=1e-3)
    settled = torch.maximum(last_above(errors, 1e-3), last_above(rates.norm(dim=-1), 1e-3))
    assert (settled <= ideal + 2.0).all()
    # half of the angle is left after half of the time, but for the delay of two ticks
    for row, time in enumerate((0.5 * ideal + 2.0 * TICK).tolist()):
        near = errors[math.floor(time / TICK) - 1 : math.ceil(time / TICK) + 1, row]
        assert near.min() - 1e-3 <= 0.5 * angle[row] <= near.max() + 1e-3
    assert rates.norm(dim=-1).max() < 1.001 * RATE
    assert (rates.diff(dim=0).norm(dim=-1) / TICK).max() < 1.02 * ACCELERATION
    assert errors[-1].max() < 1e-4
    assert (env.satellite.dynamics.wheel_speeds_fraction.abs() < 0.7).all()


def ahead(env: SatelliteTasking, seconds: torch.Tensor, aside: torch.Tensor) -> torch.Tensor:
    """Places on the ground below where satellites will be, and as far aside, rad at the Earth's center, [N, 3] Earth-fixed."""
    dynamics = env.satellite.dynamics
    r, v = dynamics.r_BN_N, dynamics.v_BN_N
    up, normal = r / r.norm(dim=-1, keepdim=True), torch.linalg.cross(r, v)
    normal = normal / normal.norm(dim=-1, keepdim=True)
    along = torch.linalg.cross(normal, up)
    turn = (v.norm(dim=-1) / r.norm(dim=-1) * seconds).unsqueeze(-1)
    side = aside.unsqueeze(-1)
    place = torch.cos(side) * (torch.cos(turn) * up + torch.sin(turn) * along) + torch.sin(side) * normal
    PN = env.simulator.observer.now.PN.stack()
    return 6.378e6 * (PN @ place.unsqueeze(-1)).squeeze(-1)


@pytest.mark.compiled
def test_slews_between_tracked_places_start_and_end_in_motion():
    """From tracking a place to tracking another one: planned times hold, and rates and accelerations stay within their limits."""
    torch.manual_seed(4)
    env = low_orbit(24)
    seconds, aside = 40.0 + 40.0 * torch.rand(24, dtype=torch.float64), 0.06 * torch.rand(24, dtype=torch.float64) - 0.03
    first, second = ahead(env, seconds, aside), ahead(env, seconds + 40.0 + 20.0 * torch.rand(24), -aside)
    errors, _ = look(env, first, round(100.0 / TICK))
    assert errors[-1].max() < 1e-4
    tracking = env.satellite.dynamics.omega_BN_B.norm(dim=-1)
    assert (tracking > 0.1 * RATE).all()
    errors, rates = look(env, second, 1)
    planned = env.simulator.read("slew_left").flatten()
    more_errors, more_rates = look_on(env, round(60.0 / TICK))
    errors, rates = torch.cat([errors, more_errors]), torch.cat([rates, more_rates])
    assert (last_above(errors, 1e-3) <= planned + 3.0 * TICK).all()
    assert (last_above(errors, 1e-2) >= planned - 2.5).all()
    assert errors[-1].max() < 1e-4
    assert (env.simulator.read("slew_left") == 0.0).all()
    assert rates.norm(dim=-1).max() < 1.1 * RATE
    assert (rates.diff(dim=0).norm(dim=-1) / TICK).max() < 1.1 * ACCELERATION


def look_on(env: SatelliteTasking, ticks: int) -> tuple[torch.Tensor, torch.Tensor]:
    """The following ticks, without a new command; see :func:`look`."""
    dynamics, errors, rates = env.satellite.dynamics, [], []
    for _ in range(ticks):
        env.simulator.run(torch.ones(env.num_envs, dtype=torch.int64))
        errors.append(env.satellite.fsw.target_pointing_error)
        rates.append((dynamics.BN.mT @ dynamics.omega_BN_B.unsqueeze(-1)).squeeze(-1))
    return torch.stack(errors), torch.stack(rates)


@pytest.mark.compiled
def test_an_image_waits_for_the_instrument():
    env = low_orbit(4, imageAttErrorRequirement=0.002, imageRateErrorRequirement=0.005)
    td, images = env.reset(), 0
    for _ in range(6):
        td = env.step(td.set("action", torch.zeros(4, dtype=torch.int64)))["next"]
        taken = td["reward"].flatten() > 0.0
        images += int(taken.sum())
        assert (env.satellite.fsw.target_pointing_error[taken] < 4.0 * 0.002 * 1.01).all()
        assert (env.satellite.fsw.slew_time_left[taken] < 3.0).all()
    assert images > 3


@pytest.mark.compiled
def test_a_slew_continues_from_a_saved_state():
    env = low_orbit(4)
    places = ahead(env, torch.linspace(30.0, 60.0, 4, dtype=torch.float64), torch.full((4,), 0.02, dtype=torch.float64))
    look(env, places, 10)
    saved = env.get_state()
    errors, rates = look_on(env, 20)
    env.restore(saved)
    same_errors, same_rates = look_on(env, 20)
    assert torch.equal(errors, same_errors)
    assert torch.equal(rates, same_rates)


def test_refusals():
    def made(**args: object) -> Slewing:
        return SatelliteTasking(Slewing("A", args), scenario=scene.UniformTargets(5), num_envs=2, seed=0, backend="eager").reset()

    check_refusals(
        refusal(lambda: made(slewAcceleration=0.01), ValueError, "slewAcceleration=0.01 rad/s^2", "from_slew_limits"),
        refusal(lambda: made(slewRate=0.0), ValueError, "slewRate", "0"),
        refusal(lambda: made(inst_pHat_B=[0.0] * 3), ValueError, "inst_pHat_B"),
    )
