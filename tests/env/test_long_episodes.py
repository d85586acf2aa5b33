"""Episodes of years: what lies ahead is computed as far as it is needed."""

import pytest
import torch

import bsk_torch
from bsk_torch.sats import access
from bsk_torch.sim.orbit.grid import ARC_SEGMENT

YEARS = 1e9
"""A time limit, s: 31.7 years, which end before the ephemeris does."""

EPOCH = {"utc_init": "2020-06-01T00:00:00"}


def first_windows(env, until):
    return env.satellite.find_windows(until, "ground_station")


@pytest.mark.compiled
def test_a_limit_of_years_costs_no_more_than_months():
    env = bsk_torch.make("NadirScan-v1", num_envs=1, seed=0, time_limit=YEARS, world_args=EPOCH, backend="compiled")
    env.reset()
    assert env.simulator.arcs.length <= access.LONGEST_AT_RESET + 6 * ARC_SEGMENT
    assert 0.0 <= float(env.satellite.window_calculation_time) - access.LONGEST_AT_RESET < env.satellite.segment
    flight = env.rollout(3, break_when_any_done=False, auto_reset=False, tensordict=env.observe())
    assert flight["next", "observation"].isfinite().all()
    assert env.time_limit.tolist() == [YEARS]
    assert not bool(flight["next", "done"].any())


def test_windows_beyond_what_reset_generates_are_found_by_queries(monkeypatch):
    options = {"num_envs": 2, "seed": 0, "backend": "eager"}
    known = bsk_torch.make("NadirScan-v1", time_limit=4e4, **options)
    known.reset()
    monkeypatch.setattr(access, "LONGEST_AT_RESET", 7200.0)
    env = bsk_torch.make("NadirScan-v1", time_limit=4e4, **options)
    env.reset()
    assert bool((env.satellite.window_calculation_time < 8000.0).all())
    windows = first_windows(env, 4e4)
    for mine, theirs in zip(windows, first_windows(known, 4e4), strict=True):
        width = min(mine.shape[1], theirs.shape[1])
        assert torch.equal(mine[:, :width].nan_to_num(), theirs[:, :width].nan_to_num())
    assert int(torch.isfinite(windows.close).sum()) > 10
    assert float(windows.open[torch.isfinite(windows.open)].max()) > 3e4
