"""Whole recorded Basilisk episodes, replayed as one batch.

Bounds are those of the design for float64 and ticks of 1 s. What limits each of them:

* position on an arc: truncation of Basilisk's own fourth-order steps, which the arc does not share (0.1 mm in five orbits);
* attitude, rates, wheels: rounding, amplified by the slews; each recording says by how much (``sensitivity``: the change of every
  column when the initial attitude moves by 1e-12);
* battery: the Sun's position between the ends of a minute (linear), and illumination in the penumbra;
* observations: the planned trajectory, reproduced to decimetres, hence windows to 0.1 ms of 5700 s.
"""

import numpy as np
import pytest

from tests.basilisk.replay import RECORDINGS, Difference, environment, load, replay

BOUNDS = {
    "sigma": 1e-7,
    "omega": 1e-8,
    "wheel_speed": 1e-5,
    "battery": 1e-3,
    "illumination": 1e-6,
    "observation": 1e-6,
    "reward": 1e-9,
}
POSITION = {"arc": 1e-3, "integrated": 1e-5}


def check(difference: Difference, position: float, bounds: dict[str, float] = BOUNDS) -> None:
    failures = {name: difference.largest[name] for name, bound in bounds.items() if not difference.largest[name] <= bound}
    if not difference.largest["r"] <= position:
        failures["r"] = difference.largest["r"]
    assert not failures, failures
    assert all(difference.exact.values()), difference.exact


@pytest.mark.compiled
@pytest.mark.parametrize("name", ["nominal", "saturation", "full", "desat_sun", "desat_none"])
def test_arc(name):
    """Every recording above the atmosphere, on precomputed arcs."""
    recording = load(name)
    check(replay(recording, environment(recording)), POSITION["arc"])


@pytest.mark.compiled
def test_eccentric():
    """An eccentric orbit, on which bsk_rl's maximizer leaves the searched interval: the pass from 9644 to 10862 s is lost."""
    recording = load("eccentric")
    env = environment(recording)
    check(replay(recording, env), POSITION["arc"])
    env.reset()
    windows = env.satellite.opportunities("ground_station")
    assert (windows.open[1] > 10862.0).all()


@pytest.mark.compiled
@pytest.mark.parametrize("name", ["integral", "integral_clip", "all_modes"])
def test_other_laws(name):
    """Integral control, its limit, drift and nadir pointing."""
    recording = load(name)
    check(replay(recording, environment(recording)), POSITION["arc"])


@pytest.mark.compiled
@pytest.mark.parametrize("name", ["half_second", "two_seconds"])
def test_other_ticks(name):
    """Ticks of half a second and of two seconds."""
    recording = load(name)
    check(replay(recording, environment(recording)), POSITION["arc"])


@pytest.mark.compiled
@pytest.mark.parametrize("name", ["low", "nominal"])
@pytest.mark.nightly("nominal")
def test_integrated(name):
    """The orbit integrated in every tick: with drag, and for five orbits."""
    recording = load(name)
    check(replay(recording, environment(recording, orbit="integrated")), POSITION["integrated"])


@pytest.mark.parametrize(("name", "steps"), [("nominal", 1), ("all_modes", 4)])
@pytest.mark.nightly("all_modes-4", "nominal-1")
def test_eager_first_steps(name, steps):
    """The debugger's back end on the first steps of two recordings; :func:`test_ticks` has single ticks of it."""
    recording = load(name)
    check(replay(recording, environment(recording, backend="eager"), longest=steps), POSITION["arc"])


@pytest.mark.parametrize("orbit", ["arc", "integrated"])
@pytest.mark.nightly("integrated")
def test_ticks(orbit):
    """Tick by tick: 200 ticks with station passes, desaturation and a change of mode."""
    from tests.basilisk.ticks import compare_ticks

    largest = compare_ticks("ticks_seed11", ticks=200, orbit=orbit)
    bounds = {"r": POSITION[orbit], "sigma": 1e-10, "omega": 1e-11, "Omega": 1e-8, "u": 1e-9, "battery": 1e-6, "storage": 0.0}
    assert all(largest[name] <= bound for name, bound in bounds.items()), largest
    assert largest["illum"] <= 1e-7
    assert largest["access"] == 0.0


def test_recordings_cover_what_they_claim():
    """The comparison would be empty if the recordings did not contain the events they stand for."""
    assert (np.load(RECORDINGS / "saturation.npz")["saturated_ticks"] > 100).all()
    full = load("full")
    assert all(state[:, 17].max() == 4e10 for state in full.arrays["state"])
    assert any(
        np.asarray(end)[-1] and time[-1, 0] < 28500
        for end, time in zip(*(load("nominal").arrays[k] for k in ("terminated", "state")), strict=True)
    )
