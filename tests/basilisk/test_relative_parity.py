"""Relative properties of recorded states are what bsk_rl observed, at every boundary of the recorded inspections."""

from __future__ import annotations

import json
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from bsk_torch.obs.relative_observations import FUNCTIONS
from tests.conftest import RECORDINGS

CASES = sorted(path.stem for path in RECORDINGS.glob("inspection_*.npz"))

NORMS = {
    "r_DC_N": 1.0,
    "v_DC_N": 1.0,
    "r_DC_Hc": 500.0,
    "v_DC_Hc": 5.0,
    "rso_sigma_BH": 1.0,
    "rso_omega_BH": 1.0,
    "sun_hat_Hc": 1.0,
}
"""Recorded properties, and the divisors with which they were observed."""

BOUND = 4e-15
"""Of the largest observed number, or of 1: differences are exact, a rotation is a few roundings (4e-16 were seen)."""


def satellite(state, sun):
    """A satellite as the functions see it, from recorded rows of time, position, velocity, attitude and rate."""
    names = {"r_BN_N": slice(1, 4), "v_BN_N": slice(4, 7), "sigma_BN": slice(7, 10), "omega_BN_B": slice(10, 13)}
    dynamics = SimpleNamespace(**{name: state[..., part] for name, part in names.items()})
    return SimpleNamespace(dynamics=dynamics, simulator=SimpleNamespace(world=SimpleNamespace(r_SN_N=sun)))


def column(names, prop):
    """Columns of a property in the recorded vector."""
    wanted = f"rel_props.{prop}" + ("_normd" if NORMS[prop] != 1.0 else "")
    return [k for k, name in enumerate(names) if name.split("[")[0] == wanted]


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("convert", [torch.from_numpy, np.asarray], ids=["batch", "one"])
def test_recorded_states_give_the_recorded_observations(case, convert):
    recorded = np.load(RECORDINGS / f"{case}.npz")
    names = json.loads(str(recorded["obs_names"]))
    seen, states, suns = recorded["obs"], recorded["state"], recorded["sun"]
    assert len(seen) > 2
    for k in range(seen.shape[1]):
        there = ~np.isnan(seen[:, k]).any(-1)
        rows = [np.flatnonzero(there)] if convert is torch.from_numpy else list(np.flatnonzero(there))
        for row in rows:
            chief, deputy = (satellite(convert(states[row, s]), convert(suns[row])) for s in (0, k + 1))
            for prop, norm in NORMS.items():
                columns = column(names, prop)
                assert len(columns) == 3
                value = np.asarray(FUNCTIONS[prop](deputy, chief)) / norm
                expected = seen[row][..., k, :][..., columns]
                scale = max(1.0, float(np.abs(expected).max()))
                np.testing.assert_allclose(value, expected, rtol=0.0, atol=BOUND * scale, err_msg=f"{case} {prop}")
