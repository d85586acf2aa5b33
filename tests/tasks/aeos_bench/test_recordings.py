"""Satellites of AEOS-Bench against flights of the same scenarios on Basilisk, in the order of the benchmark's tick."""

import numpy as np
import pytest
import torch

from bsk_torch.astro.ephemeris import EARTH_ROTATION_RATE, sun_state
from bsk_torch.constants import MU_EARTH, MU_SUN, RPM
from bsk_torch.tasks.aeos_bench import AEOSBenchDynModel
from tests.tasks.aeos_bench.replay import FIELDS, MAX_SPEED, NAMES, Flight

EPOCH = 599572869.184  # s past J2000, of 2019 January 1

ATTITUDE = ("sigma", "omega", "Omega", "u", "sigma_BR", "integral", "charge", "wheel_power")

TICK = {"r": 2e-9, "v": 1e-11, "sigma": 2e-15, "omega": 4e-15, "Omega": 3e-13, "illumination": 2e-9}
"""Largest differences after one tick from a recorded state: rounding; an eclipse loses digits in the penumbra."""

CLOSED_LOOP = {"sigma": 1e-9, "omega": 1e-10, "Omega": 5e-7, "u": 1e-8, "sigma_BR": 1e-9, "integral": 1e-9}
CLOSED_LOOP |= {"charge": 1e-5, "wheel_power": 1e-6, "r": 1e-8, "v": 2e-10, "illumination": 2e-9}
"""Largest differences of a flight of 300 s: ten times those of a second computation, in NumPy, from the same recordings."""

LONGER = {("odd", 1): 20.0, ("stiff", 1): 1000.0, ("stiff", 2): 30.0, ("greedy", 1): 50.0, ("greedy", 2): 50.0}
LONGER |= {("greedy", 0): 10.0, ("greedy", 3): 500.0, ("greedy", 4): 10_000.0}
"""How many times farther the attitude may be away where it chatters or 1200 s have passed: :func:`noise_of_guidance` grows."""


def noise_of_guidance(flight: Flight, place: torch.Tensor, sigma_BR: np.ndarray) -> np.ndarray:
    """Largest noise of Basilisk's sigma_BR, [num_envs, S], when it points at places [num_envs, S, 3] in P, m.

    SPICE counts the turns of the Earth in degrees since 2000, 2.5e6 of them, which rounds the prime meridian to 2e-11 rad; and
    the arc cosine of an angle phi rounds to 2e-16 / sin(phi). An error of the direction x moves ``sigma_BR = -tan(phi / 4) (p x
    x) / sin(phi)`` by up to ``max(tan(phi / 4) / sin(phi), 1 / (2 + 2 cos(phi / 2)))`` of its size.
    """
    r_P = flight.simulator.observer.read(AEOSBenchDynModel.r_BN_P.function).unflatten(0, place.shape[:2])
    phi = 4.0 * np.arctan(np.linalg.norm(sigma_BR, axis=-1))
    sine = np.maximum(np.sin(phi), 1e-9)
    turn = 2e-11 * (place.norm(dim=-1) / (place - r_P).norm(dim=-1)).numpy()
    return turn * np.maximum(np.tan(phi / 4.0) / sine, 0.5 / (1.0 + np.cos(phi / 2.0))) + 1e-15 / sine


def pairs_of(ticks: np.ndarray) -> np.ndarray:
    """Rows of a recording that the next tick follows."""
    return np.flatnonzero(np.diff(ticks) == 1)


def forced(name: str, **options) -> tuple[Flight, np.ndarray]:
    """One tick from every recorded state that another follows, one environment each; returns the flight and those rows."""
    rows = pairs_of(Flight.file_of(name)["tick"])
    flight = Flight(name, num_envs=len(rows), **options)
    ticks = torch.from_numpy(flight.file["tick"][rows]).long()
    places, on = flight.actions(int(ticks[-1]) + 1)
    flight.run(ticks)
    for field in FIELDS:
        value = torch.from_numpy(flight.recorded(field)[rows])
        if field == "charge":  # at time zero, Basilisk's battery says zero, whatever it holds
            value = torch.where(ticks[:, None] == 0, torch.from_numpy(flight.read("charge")), value)
        flight.simulator.write(FIELDS[field], flight.everyone, value.flatten(0, 1))
    flight.command(places[ticks], on[ticks])
    flight.run(1)
    return flight, rows


@pytest.mark.parametrize("name", [name for name in NAMES if name != "greedy"])
@pytest.mark.parametrize("backend", ["compiled", "eager"])
@pytest.mark.nightly("eager")
def test_a_tick_from_every_recorded_state(name, backend):
    flight, rows = forced(name, backend=backend)
    for field, bound in TICK.items():
        np.testing.assert_allclose(flight.read(field), flight.recorded(field)[rows + 1], rtol=0, atol=bound, err_msg=field)
    ticks = flight.file["tick"][rows]
    law = {key: np.array([one["mrp_control"][key] for one in flight.given]) for key in ("k", "ki", "p")}
    largest = np.array([np.abs(one["inertia"]).max() for one in flight.given])
    momentum = np.array([one["reaction_wheels"][0]["max_momentum"] for one in flight.given])
    noise = noise_of_guidance(flight, flight.actions(int(ticks[-1]) + 1)[0][ticks], flight.recorded("sigma_BR")[rows + 1])
    # the rate error is a difference over a second, of MRPs, which are a fourth of the angle
    torque = 1e-14 + 2.0 * (law["k"] + 4.0 * law["p"] * (1.0 + law["ki"] * largest) + 4.0 * momentum) * noise
    speed = np.abs(flight.recorded("Omega")[rows + 1]).max(-1)
    sight = {"sigma_BR": noise, "u": torque, "integral": law["k"] * noise, "wheel_power": 1e-12 + 3.0 * speed * torque}
    for field, bound in sight.items():
        away = np.abs(flight.read(field) - flight.recorded(field)[rows + 1]).reshape(*bound.shape, -1).max(-1)
        assert (away <= bound + 1e-15).all(), (field, (away / bound).max())
    np.testing.assert_allclose(
        flight.read("charge"), flight.recorded("charge")[rows + 1], rtol=0, atol=1e-9
    )  # solar power, 300 W


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("backend", ["compiled", "eager"])
@pytest.mark.nightly("eager")
def test_a_flight(name, backend):
    """The whole flight by recorded actions: states, and access of every pair in every tick."""
    flight = Flight(name, backend=backend)
    ticks = flight.file["tick"]
    assert (flight.file["sensitivity"] < 1e-6).all()  # to the end
    before, events, row = flight.no_access, [], 0
    for tick in flight.replay(int(ticks[-1])):
        access = flight.access()
        events += [(tick, s, k, int(access[0, s, k])) for _, s, k in (access != before).nonzero().tolist()]
        before = access
        if tick == ticks[row]:
            for field, bound in CLOSED_LOOP.items():
                if tick == 0 and field == "charge":
                    continue
                away = np.abs(flight.read(field)[0] - flight.recorded(field)[row]).reshape(len(flight.given), -1).max(-1)
                scale = np.array([LONGER.get((name, s), 1.0) if field in ATTITUDE else 1.0 for s in range(len(away))])
                assert (away <= bound * scale).all(), (tick, field, away / bound)
            row += 1
    assert row == len(ticks)
    assert events == [tuple(event) for event in flight.file["access"].tolist()]


def test_the_recordings_hold_what_they_are_for():
    files = {name: Flight.file_of(name) for name in NAMES}
    assert files["greedy"]["success"].max() > 0
    assert len(files["greedy"]["access"]) >= 20
    assert 0 < np.unique(files["greedy"]["illumination"][:, 1].round(6)).tolist()[1] < 1  # a penumbra
    assert len(files["odd"]["access"]) >= 5
    assert np.linalg.norm(files["odd"]["sigma"][0], axis=-1).max() < 1.0  # switched to its shadow at time zero
    chatter = np.sign(files["stiff"]["u"][60:, 1])
    assert (chatter[1:] * chatter[:-1] < 0).mean() > 0.1


def test_float32_and_batches_change_little():
    """Orbits and charges are exact in the mixed mode, attitudes follow the recorded ones."""
    flight = Flight("random", dtype=torch.float32)
    for _ in flight.replay(40):
        pass
    row = flight.file["tick"].tolist().index(40)
    for field, bound in {"r": 1e-8, "v": 1e-10, "sigma": 1e-3, "omega": 1e-3, "Omega": 1.0, "charge": 1.0}.items():
        np.testing.assert_allclose(flight.read(field)[0], flight.recorded(field)[row], rtol=0, atol=bound, err_msg=field)
    at_once, by_one = Flight("greedy"), Flight("greedy")
    places, on = by_one.actions(1)
    for flight in (at_once, by_one):
        flight.command(places, on)
    at_once.run(60)
    for _ in range(60):
        by_one.run(1)
    assert not [field for field in FIELDS if (at_once.read(field) != by_one.read(field)).any()]


@pytest.mark.parametrize("backend", ["compiled", "eager"])
def test_a_satellite_is_the_same_alone_and_among_others(backend):
    """Bit for bit: beside two others, and in one of three environments."""
    flights = [Flight("random", satellites, n, backend=backend) for satellites, n in (((0, 1, 2), 3), ((1,), 1))]
    for flight in flights:
        for _ in flight.replay(30):
            pass
    together, alone = flights
    differ = [field for field in FIELDS if (together.read(field)[:, 1] != alone.read(field)[0, 0]).any()]
    assert not differ


# --- what is particular to the benchmark ---


def test_the_battery_takes_the_power_of_wheels_one_tick_late_and_none_at_time_zero():
    flight = Flight("stiff")
    sensor = np.array([one["sensor"]["power"] for one in flight.given])
    capacity = np.array([one["battery"]["capacity"] for one in flight.given])
    _, on = flight.actions(40)
    initial = np.array([one["battery"]["percentage"] for one in flight.given]) * capacity
    kept = [(flight.read("charge")[0], flight.read("wheel_power")[0]) for _ in flight.replay(40)]
    np.testing.assert_array_equal(kept[0][0], initial)
    assert (np.abs(kept[0][1]) > 1.0).all()  # W, which the first tick takes
    np.testing.assert_array_equal(flight.recorded("charge")[0], 0.0)  # what Basilisk's battery says at time zero
    for k in range(40):
        (charge, wheels), (new, _) = kept[k : k + 2]
        gain = flight.recorded("solar_power")[k + 1] - sensor * on[k].numpy() + wheels
        np.testing.assert_allclose(new, np.clip(charge + gain, 0.0, capacity), rtol=0, atol=1e-9)
        np.testing.assert_allclose(gain, flight.recorded("net_power")[k + 1], rtol=0, atol=2e-3)


def test_the_integral_starts_with_the_second_tick():
    flight = Flight("random")
    integrals = [flight.read("integral")[0] for _ in flight.replay(2)]
    assert not integrals[0].any()
    assert not integrals[1].any()
    assert (np.abs(integrals[2]).max(-1) > 0.0).all()


def test_a_change_of_target_kicks_the_rate_error_and_saturates_wheels():
    flight, rows = forced("random")
    kicked = np.linalg.norm(flight.recorded("omega_BR")[rows + 1], axis=-1) > 0.5
    settled = np.linalg.norm(flight.recorded("omega")[rows + 1], axis=-1) < 0.1
    assert (kicked & settled).sum() >= 3  # half a radian per second, though the body turns slowly
    torque = np.abs(flight.read("u"))[kicked & settled].max(-1)
    np.testing.assert_array_equal(torque, 0.2)


def test_a_rotation_about_the_line_of_sight_goes_on():
    """At nadir, 30 s after another 0.005 rad/s about it: Basilisk's damping, which is off, would leave little of any rate."""
    flight = Flight("greedy")
    flight.run(600)
    more = torch.tensor([0.0, 0.0, 0.005], dtype=torch.float64)
    flight.simulator.write("omega_BN_B", flight.everyone, flight.simulator.read("omega_BN_B") + more)
    before = flight.read("omega")[0, :, 2]
    flight.run(30)
    assert (np.abs(before) > 3e-3).sum() >= 4
    np.testing.assert_allclose(flight.read("omega")[0, :, 2], before, rtol=0, atol=1e-3)
    assert not flight.read("sigma_BR")[0, :, 2].any()  # nor does the attitude error have a part about it


def test_wheels_are_cut_off_at_their_largest_speed():
    flight = Flight("stiff")
    limit, seen = MAX_SPEED * RPM, 0
    for _ in flight.replay(100):
        speed, torque = flight.read("Omega")[0], flight.read("u")[0]
        fast = np.abs(speed) >= limit
        assert (speed * torque <= 0.0)[fast].all()
        seen += int((torque[fast] == 0.0).sum())
    assert seen > 3
    assert np.abs(flight.recorded("Omega")).max() > limit


def test_an_empty_battery_stops_nothing():
    flight = Flight("stiff")
    for _ in flight.replay(60):
        pass
    assert flight.read("charge")[0, 0] == 0.0
    row = flight.file["tick"].tolist().index(60)
    np.testing.assert_allclose(flight.read("u")[0, 0], flight.recorded("u")[row, 0], rtol=0, atol=1e-7)
    assert np.abs(flight.read("u")[0, 0]).max() > 1e-3


def flown_minute(r: np.ndarray, v: np.ndarray, stretch: float) -> np.ndarray:
    """Positions, m, [S, 3], a minute after the epoch, by 60 steps of a point mass, stretched as Basilisk's is, and the Sun."""
    sun = sun_state(torch.tensor(EPOCH, dtype=torch.float64))[0].numpy()
    toward_sun = MU_SUN * sun / np.linalg.norm(sun) ** 3

    def acceleration(r: np.ndarray, s: float) -> np.ndarray:
        wide = np.array([1.0, 1.0, 0.0]) * stretch * (EARTH_ROTATION_RATE * s) ** 2 / 2.0 + 1.0
        place, from_sun = r * wide, r - sun
        earth = -MU_EARTH * place / np.linalg.norm(place, axis=-1, keepdims=True) ** 3 * wide
        return earth - MU_SUN * from_sun / np.linalg.norm(from_sun, axis=-1, keepdims=True) ** 3 - toward_sun

    for _ in range(60):
        slopes: list[tuple[np.ndarray, np.ndarray]] = []
        for s, part in ((-1.0, 0.0), (-0.5, 0.5), (-0.5, 0.5), (0.0, 1.0)):
            dr, dv = slopes[-1] if slopes else (np.zeros_like(r), np.zeros_like(v))
            slopes.append((v + part * dv, acceleration(r + part * dr, s)))
        (a, b), (c, d), (e, f), (g, h) = slopes
        r, v = r + (a + 2.0 * c + 2.0 * e + g) / 6.0, v + (b + 2.0 * d + 2.0 * f + h) / 6.0
    return r


def test_the_earth_is_a_stretched_point_mass():
    """Basilisk turns positions into the Earth-fixed frame by ``C + dC/dt s``, s = -1, -0.5, -0.5, 0 s from the end of a tick.

    That is a rotation, longer by ``(omega s)^2 / 2`` across the Earth's axis. The recorded minute tells both apart; the axis
    of J2000 stands for that of date, 0.002 rad away.
    """
    flight = Flight("greedy")
    assert flight.file["tick"][1] == 60
    r, v = flight.recorded("r"), flight.recorded("v")
    stretched, round_ = (np.abs(flown_minute(r[0], v[0], stretch) - r[1]).max() for stretch in (1.0, 0.0))
    assert stretched < 1e-6 < 5e-6 < round_, (stretched, round_)


def test_rejects_point_masses_on_arcs_and_fields_of_degree_one():
    with pytest.raises(
        ValueError, match=r"orbit='arc' needs the Earth's oblateness, but AEOSBenchDynModel has gravity_degree = 0"
    ):
        Flight("random", orbit="arc")
    with pytest.raises(TypeError, match=r"Wrong.gravity_degree=1 must be 0 \(a point mass\) or from 2 to 10"):
        type("Wrong", (AEOSBenchDynModel,), {"gravity_degree": 1})
