"""Which cells a flight records: against sums over every tick in numpy, and against the buffered track in shapely."""

import math

import numpy as np
import pytest
import torch

from bsk_torch.astro.geodetic import ECCENTRICITY2, SEMI_MAJOR_AXIS
from bsk_torch.tasks.areas import Areas, cap
from bsk_torch.tasks.areas.preset import areas
from bsk_torch.tasks.areas.scene import RECORDED

pytestmark = pytest.mark.compiled

SWATH = 300e3


def on_ellipsoid(r, d):
    """Where rays [M, 3] from places [M, 3] meet WGS84, by bisection along them; only of those that do."""
    metric = np.array([1.0, 1.0, 1.0 / (1.0 - ECCENTRICITY2)])
    low, high = np.zeros(len(r)), -(r * d * metric).sum(1) / (d * d * metric).sum(1)  # where it is deepest
    deepest = r + d * high[:, None]
    meets = (high > 0.0) & ((deepest**2 * metric).sum(1) < SEMI_MAJOR_AXIS**2)
    r, d, low, high = r[meets], d[meets], low[meets], high[meets]
    for _ in range(60):
        middle = 0.5 * (low + high)
        place = r + d * middle[:, None]
        above = (place**2 * metric).sum(1) > SEMI_MAJOR_AXIS**2
        low, high = np.where(above, middle, low), np.where(above, high, middle)
    return r + d * low[:, None]


def along_the_track(env, seconds, cell):
    """Large areas on both sides of the track that an environment flies in some time."""
    env.reset()
    with env.record(("r_BN_P",), every=60) as recording:
        for _ in range(seconds // 60):
            env.step(env.rand_action())
    x, y, z = recording["r_BN_P"].numpy()[::3].T
    latitude, longitude = np.degrees(np.arctan2(z, np.hypot(x, y))), np.degrees(np.arctan2(y, x))
    return [cap(f"a{k}", *map(float, place), 500e3, cell) for k, place in enumerate(zip(latitude, longitude, strict=True))]


def flown(seconds=1200, actions=(0,), cell=40e3, n=2, **options):
    """Areas, the environment after some steps, and the places and times of all recorded ticks of each environment."""
    common = dict(num_envs=n, seed=3, dtype=torch.float64, sat_args=dict(storageInit=0.0))
    listed = along_the_track(areas(**(common | dict(num_envs=1))), seconds, cell)
    env = areas(scenario=Areas(listed, SWATH, **options), **common)
    td, earned = env.reset(), torch.zeros(n, dtype=torch.float64)
    with env.record(("r_BN_P", "c_hat_P", "storage")) as recording:
        for k in range(seconds // 60):
            td = env.step(td.set("action", torch.full((n,), actions[k % len(actions)])))["next"]
            earned += td["reward"].squeeze(-1)
    tracks = []
    for e in range(n):
        r, d, level = (recording.of(e)[name].numpy() for name in ("r_BN_P", "c_hat_P", "storage"))
        on = np.flatnonzero(np.diff(level) > 0.0) + 1
        tracks.append((on, on_ellipsoid(r[on], d[on])))
    return listed, env, tracks, earned


def test_cells_are_those_near_a_recorded_place():
    # four scans, then a turn to the Sun
    listed, env, tracks, earned = flown(actions=(0, 0, 0, 0, 1))
    state = env.scenario.memory[RECORDED]
    for e, (on, place) in enumerate(tracks):
        assert 200 < len(on) < 1200
        total = 0.0
        for k, area in enumerate(listed):
            nearest = np.linalg.norm(area.r_CP_P[:, None] - place, axis=-1).min(1) - 0.5 * SWATH
            found = state[e, k, : len(nearest)].numpy() >= 0
            certain = np.abs(nearest) > 1e-3  # but for rounding, m
            assert np.array_equal(found[certain], (nearest < 0.0)[certain])
            total += area.share[found].sum()
            assert not (state[e, k, len(nearest) :] >= 0).any()
        assert earned[e].item() == pytest.approx(total, abs=1e-12)
    assert earned[0] > 1.0
    # the command of the last scan is left over when the next one begins, with the instrument away from the Earth
    assert any(len(place) < len(on) for on, place in tracks)


def test_cells_are_those_in_the_buffered_track():
    shapely = pytest.importorskip("shapely")
    listed, env, tracks, _ = flown(actions=(0,), n=1, seconds=420)
    (on, place), state = tracks[0], env.scenario.memory[RECORDED][0]
    assert (np.diff(on) == 1).all()
    up = place[len(place) // 2] / np.linalg.norm(place[len(place) // 2])
    east = np.cross([0.0, 0.0, 1.0], up)
    east /= np.linalg.norm(east)
    plane = np.stack([east, np.cross(up, east)], 1)

    def flat(r):
        """Azimuthal equidistant map of places, m: at 1,300 km from its center, it stretches distances by up to 0.7 percent."""
        direction, angle = r @ plane, np.arccos((r @ up / np.linalg.norm(r, axis=-1)).clip(-1.0, 1.0))
        return direction / np.linalg.norm(direction, axis=-1, keepdims=True) * (SEMI_MAJOR_AXIS * angle)[..., None]

    swath = shapely.LineString(flat(place)).buffer(0.5 * SWATH, quad_segs=64)
    wrong = seen = 0
    for k, area in enumerate(listed):
        cells = shapely.points(flat(area.r_CP_P))
        inside, found = shapely.contains(swath, cells), state[k, : len(cells)].numpy() >= 0
        certain = shapely.distance(swath.boundary, cells) > 1500.0  # 0.7 percent of half a swath, and of the ellipsoid's 0.3
        wrong, seen = wrong + (inside != found)[certain].sum(), seen + (inside & certain).sum()
    assert seen > 200
    assert wrong == 0


def test_a_full_store_records_nothing():
    listed, env, *_ = flown(actions=(0,), n=1, seconds=600)
    full = areas(
        scenario=Areas(listed, SWATH), num_envs=1, seed=3, sat_args=dict(storageInit=5000 * 8e6, dataStorageCapacity=5000 * 8e6)
    )
    td = full.reset()
    for _ in range(10):
        td = full.step(td.set("action", torch.zeros(1, dtype=torch.int64)))["next"]
    assert (env.scenario.memory[RECORDED] >= 0).any()
    assert not (full.scenario.memory[RECORDED] >= 0).any()


def test_cells_are_due_again():
    _, env, _, earned = flown(actions=(0,), n=1, seconds=300, revisit=600.0)
    scenario = env.scenario
    at = torch.tensor([-1, 0, 30, 100], dtype=torch.int32)
    assert torch.allclose(scenario.due(at, torch.tensor(300)), torch.tensor([1.0, 0.5, 0.45, 1.0 / 3.0], dtype=torch.float64))
    _, once, _, single = flown(actions=(0,), n=1, seconds=300)
    again = earned - single  # cells within the swath of two successive steps pay for the minute between
    assert 0.0 < again.item() < 0.1 * 300 / 60 * math.ceil(single.item())
    assert torch.equal(scenario.covered(), once.scenario.covered())
