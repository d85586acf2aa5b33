import math
from types import SimpleNamespace

import pytest
import torch

from bsk_torch.astro.earth_rotation import pole_matrix
from bsk_torch.astro.ephemeris import earth_angles, earth_orientation, parse_utc
from bsk_torch.constants import R_EARTH
from bsk_torch.sim.component import Bus
from bsk_torch.sim.environment.world import DEFAULT_STATIONS, see_stations, station_arrays
from bsk_torch.vec3 import Vec3

N = 3000
H = 1.0


def number(x: float) -> torch.Tensor:
    return torch.tensor([x], dtype=torch.float64)


def args(elevation: float, longest: float) -> dict:
    return {
        "groundStationsData": DEFAULT_STATIONS,
        "groundLocationPlanetRadius": number(R_EARTH),
        "gsMinimumElevation": number(math.radians(elevation)),
        "gsMaximumRange": number(longest),
    }


def seen(r: torch.Tensor, et: float, arrays: dict[str, torch.Tensor]) -> torch.Tensor:
    """What see_stations says of positions [N, 3] in N: stations and spacecraft as they were a tick before ET."""
    bus, epoch = Bus(round(H * 1e9)), torch.full((len(r),), et, dtype=torch.float64)
    bus.ephemeris, bus.ephemeris_tau = [SimpleNamespace(earth_angle=earth_angles(epoch)[2])], torch.zeros_like(epoch)
    bus.EN, bus.r_BN_N = pole_matrix(epoch), Vec3.of(r)
    for name, value in arrays.items():
        setattr(bus, name, tuple(value[0]))
    see_stations(bus)
    return bus.station_access


@pytest.mark.parametrize("longest", [-1.0, 2e6])
@pytest.mark.parametrize("elevation", [-20.0, 0.0, 10.0, 60.0])
def test_stations_see_what_is_above_their_limit_and_within_their_range(elevation, longest):
    """By angles, though the comparison is one of squares."""
    arrays, et = station_arrays(args(elevation, longest)), parse_utc("2021-05-04T00:00:00")
    r = 6.9e6 * torch.nn.functional.normalize(torch.randn(N, 3, dtype=torch.float64), dim=-1)
    p = arrays["station_positions_P"].view(3, -1).mT
    line = (r @ earth_orientation(torch.tensor(et - H, dtype=torch.float64)).mT).unsqueeze(1) - p
    distance = line.norm(dim=-1)
    angle = torch.asin((line * p).sum(-1) / (distance * p.norm(dim=-1)))
    margin = angle - math.radians(elevation)
    expected = ((margin > 0.0) & ((distance < longest) | (longest < 0.0))).any(1)
    assert margin.abs().min() > 1e-8  # so that rounding decides nothing
    assert torch.equal(seen(r, et, arrays) == 1.0, expected)
    assert expected.any()
    assert not expected.all()


def test_limits_of_single_stations():
    stations = [{"name": "a", "lat": 10.0, "long": 20.0}, {"name": "b", "lat": -30.0, "long": 50.0, "elev": 2000.0}]
    stations[0] |= {"gsMinimumElevation": 0.5, "gsMaximumRange": 3e6}
    arrays = station_arrays(args(10.0, -1.0) | {"groundStationsData": stations})
    assert arrays["station_sin_elevations"][0].tolist() == pytest.approx([math.sin(0.5), math.sin(math.radians(10.0))])
    assert arrays["station_ranges"].tolist() == [[3e6, -1.0]]
    radii = arrays["station_positions_P"].view(3, -1).norm(dim=0)
    assert radii.tolist() == pytest.approx([R_EARTH, R_EARTH + 2000.0], rel=1e-15)
