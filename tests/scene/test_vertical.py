"""Windows and access of places on the real Earth."""

import math
from types import SimpleNamespace

import pytest
import torch

from bsk_torch import SatelliteTasking, act, data, dyn, fsw, obs, sats, scene
from bsk_torch.astro.earth_rotation import pole_matrix
from bsk_torch.astro.ephemeris import earth_angles, earth_orientation, parse_utc
from bsk_torch.astro.geodetic import geodetic_to_fixed, local_vertical
from bsk_torch.formats.stations import ground_stations
from bsk_torch.sim.component import Bus
from bsk_torch.sim.environment.world import see_stations, station_arrays
from bsk_torch.sim.fsw.target import aim_at_place
from bsk_torch.vec3 import Vec3

EPOCH = "2025 JUL 17 12:00:00.000 (UTC)"
ORBIT = dict(rN=[3050019.655, -2957948.288, 6118860.057], vN=[-4133.239051, 4357.33309, 4168.573976])
CITIES = [(48.8566, 2.3522), (64.1466, -21.9426), (55.7558, 37.6173), (30.0444, 31.2357)]
WINDOWS = [(953.3, 1735.5), (673.6, 1326.7), (859.8, 1499.4), (1378.2, 1911.4)]
"""Rises and sets above 10 degrees by Skyfield 1.55: SGP4 for the set whose state at the epoch is ``ORBIT``, WGS84 places."""

TOLERANCE = 2.0
"""Seconds: SGP4 has no high harmonics, the simulation no drag and UT1 = UTC; the worst measured difference is 1.5 s."""


class Imager(sats.ImagingSatellite):
    observation_spec = (obs.OpportunityProperties(dict(prop="opportunity_open"), dict(prop="sun_elevation"), n_ahead_observe=4),)
    action_spec = (act.Image(n_ahead_image=4), act.Charge(duration=60.0))
    dyn_type = (dyn.ImagingDynModel, dyn.GroundStationDynModel)
    fsw_type = fsw.ImagingFSWModel


def make(targets, backend="eager", compat=None, **world):
    satellite = Imager("S1", ORBIT | dict(imageTargetMinimumElevation=math.radians(10.0)))
    world = dict(utc_init=EPOCH) | world
    options = dict(world_args=world, num_envs=1, time_limit=3000.0, seed=0, backend=backend, compat=compat)
    env = SatelliteTasking(satellite, targets, data.UniqueImageReward(), **options)
    env.reset()
    return env


def windows_of(env, kind="target", n=4):
    ahead = env.satellite.find_next_opportunities(n, types=kind)
    rows = zip(ahead.place[0].tolist(), ahead.open[0].tolist(), ahead.close[0].tolist(), strict=True)
    return {place: (opens, closes) for place, opens, closes in rows if math.isfinite(opens)}


@pytest.mark.compiled
@pytest.mark.parametrize("backend", ["eager", "compiled"])
def test_windows_are_those_of_skyfield(backend):
    windows = windows_of(make(scene.Targets.from_geodetic(*zip(*CITIES, strict=True)), backend))
    for place, expected in enumerate(WINDOWS):
        assert windows[place] == pytest.approx(expected, abs=TOLERANCE)


def test_both_backends_find_the_same_windows():
    targets = scene.Targets.from_geodetic(*zip(*CITIES, strict=True))
    eager, compiled = (windows_of(make(targets, backend)) for backend in ("eager", "compiled"))
    assert len(eager) == 4
    for place in eager:
        assert compiled[place] == pytest.approx(eager[place], abs=1e-6)


def test_bsk_rl_counts_from_the_radius():
    targets = scene.Targets.from_geodetic(*zip(*CITIES, strict=True))
    plain = windows_of(make(targets))
    radial = windows_of(make(scene.Targets(targets.positions[0], vertical="radius")))
    differences = [abs(plain[k][0] - radial[k][0]) for k in plain]
    assert 0.5 < max(differences) < 5.0
    assert make(targets, compat="bsk_rl").satellite.access_windows.kinds["target"].vertical == "radius"


def test_places_on_the_sphere_of_bsk_rl_keep_its_vertical():
    assert scene.Targets([[6378136.6, 0.0, 0.0], [0.0, 0.0, 6378136.6]]).vertical == "radius"
    assert scene.Targets([[6378136.6, 0.0, 0.0], [0.0, 0.0, 6356752.3]]).vertical == "wgs84"
    assert scene.CloudyTargets(scene.Targets.from_geodetic([10.0], [20.0])).vertical == "wgs84"
    assert scene.UniformTargets(3).vertical == "radius"


def test_access_is_counted_from_the_normal_of_the_ellipsoid():
    """By angles, though the comparison is one of squares; satellites are close to the limit over places everywhere."""
    n, h, limit = 2000, 1.0, math.radians(40.0)
    torch.manual_seed(3)
    epoch = torch.full((n,), parse_utc("2021-05-04T01:00:00"), dtype=torch.float64)
    u, v = torch.rand(2, n, dtype=torch.float64)
    r_LP_P = geodetic_to_fixed(torch.asin(2.0 * u - 1.0), 6.28 * v, 100.0 * u)
    up = local_vertical(r_LP_P)
    across = torch.linalg.cross(up, torch.nn.functional.normalize(torch.randn(n, 3, dtype=torch.float64), dim=-1))
    elevation = limit + 0.01 * torch.randn(n, dtype=torch.float64).unsqueeze(-1)
    line = torch.sin(elevation) * up + torch.cos(elevation) * torch.nn.functional.normalize(across, dim=-1)
    bus = Bus(round(h * 1e9))
    bus.ephemeris, bus.ephemeris_tau = [SimpleNamespace(earth_angle=earth_angles(epoch)[2])], torch.zeros_like(epoch)
    bus.EN, bus.r_LP_P, bus.location_on = pole_matrix(epoch), Vec3.of(r_LP_P), torch.ones_like(u)
    bus.r_BN_N = Vec3.of((r_LP_P + 1e6 * line) @ earth_orientation(epoch[0] - h))
    bus.target_range, bus.target_sin2_elevation = -torch.ones_like(u), torch.full_like(u, math.sin(limit) ** 2)
    aim_at_place(False, False, "wgs84")(bus)
    assert torch.equal(bus.target_access == 1.0, (elevation > limit).squeeze(-1))


@pytest.mark.compiled
def test_both_backends_take_the_same_images():
    taken = []
    for backend in ("eager", "compiled"):
        env = make(scene.Targets.from_geodetic(*zip(*CITIES, strict=True)), backend)
        td = env.step(env.reset().set("action", torch.zeros_like(env.action_spec.zero())))
        taken.append((td["next", "reward"].item(), env.satellite.simulator.sim_time.item()))
    assert taken[0] == taken[1]
    assert taken[0][0] == 1.0


def test_stations_of_a_user_lie_on_the_ellipsoid():
    stations = ground_stations("Svalbard", "Kiruna")
    env = make(scene.UniformTargets(50), groundStationsData=stations)
    places = env.satellite.access_windows.kinds["ground_station"]
    up = local_vertical(places.r_LP_P[0])
    assert torch.rad2deg(torch.asin(up[:, 2])).tolist() == pytest.approx([s["lat"] for s in stations], abs=1e-9)
    sphere = make(scene.UniformTargets(50), groundStationsData=stations, groundLocationPlanetRadius=6378136.6)
    one, other = (windows_of(e, "ground_station", 2)[0] for e in (env, sphere))
    assert 0.5 < abs(one[0] - other[0]) < 10.0
    compatible = make(scene.UniformTargets(50), compat="bsk_rl", groundStationsData=stations)
    radius = compatible.satellite.access_windows.kinds["ground_station"].r_LP_P.norm(dim=-1)
    assert radius.flatten().tolist() == pytest.approx([6378136.6] * 2)


def test_stations_see_satellites_above_the_horizontal_plane():
    """The access of the tick, :func:`see_stations`, of satellites around the limit over stations, by angles."""
    stations = [{"name": str(lat), "lat": lat, "long": 20.0, "elev": 100.0} for lat in (-60.0, 10.0, 45.0)]
    values = {"gsMinimumElevation": 0.2, "gsMaximumRange": -1.0}
    args = {name: torch.tensor([value], dtype=torch.float64) for name, value in values.items()}
    arrays = station_arrays(args | {"groundStationsData": stations, "groundLocationPlanetRadius": None})
    r_LP_P = arrays["station_positions_P"].view(3, -1).mT
    up, east = local_vertical(r_LP_P), torch.tensor([[-math.sin(math.radians(20.0)), math.cos(math.radians(20.0)), 0.0]])
    north = torch.linalg.cross(up, east.double().expand(3, 3))
    epoch = torch.full((1,), parse_utc("2021-05-04T01:00:00"), dtype=torch.float64)
    for elevation in (0.1999, 0.2001):
        for place in range(3):
            line = math.sin(elevation) * up[place] + math.cos(elevation) * north[place]
            bus = Bus(10**9)
            bus.ephemeris, bus.ephemeris_tau = [SimpleNamespace(earth_angle=earth_angles(epoch)[2])], torch.zeros_like(epoch)
            bus.EN = pole_matrix(epoch)
            bus.r_BN_N = Vec3.of(((r_LP_P[place] + 1e6 * line) @ earth_orientation(epoch[0] - 1.0)).unsqueeze(0))
            for name, value in arrays.items():
                setattr(bus, name, tuple(value[0]))
            see_stations(bus)
            assert bus.station_access.item() == float(elevation > 0.2)
