"""Recorded point-imaging episodes, replayed as one batch.

Bounds are those of the design, with two of them particular to images:

* observations: 1e-6 with feedback, 1e-5 with steering, whose loop amplifies rounding;
* windows: 1 ms. They come from the planned trajectory, which follows bsk_rl's to metres for half a day. From then on it drifts
  ahead or behind with the third power of time, to 27 ms after 45 hours: the look-ahead of days has its own bound.
"""

import numpy as np
import pytest

from tests.basilisk.imaging import BUFFER, EARTH_RADIUS, environment, load, misses, replay
from tests.basilisk.test_parity import BOUNDS, POSITION, check

IMAGING = {**BOUNDS, "window": 1e-3}
STEERING = {**IMAGING, "observation": 1e-5}
LIMITED = {**IMAGING, "observation": IMAGING["window"] / 300.0}
"""Ends of windows are divided by 300 s. Where range limits them, its rate is low, and errors of the position count more."""

DAYS = {**IMAGING, "window": 5e-2, "observation": 2e-4}

FEEDBACK = (
    *("feedback", "few", "bounded", "sparse", "dense", "polar", "equatorial", "30deg", "80deg", "range", "full", "cut"),
    *("timeout", "stale", "interval", "stored", "unlimited", "half_second"),
)
IMAGE = 4e6
TARGET_WIDTH, FIRST_TARGET = 12, 23
R_LP_P, OPEN, CLOSE = slice(1, 4), 7, 9
STORAGE = 17


@pytest.mark.compiled
@pytest.mark.parametrize("name", FEEDBACK)
def test_feedback(name):
    """Attitude by feedback, on precomputed arcs."""
    recording = load(f"imaging_{name}")
    check(replay(recording, environment(recording)), POSITION["arc"], IMAGING)


@pytest.mark.compiled
def test_two_instruments():
    """Boresight, tolerances, size and power of the image are those of the instrument that each action chooses."""
    recording = load("imaging_instruments")
    check(replay(recording, environment(recording)), POSITION["arc"], IMAGING)
    assert len(episodes("instruments")) == 2
    for e in episodes("instruments"):
        used = (e.action - len(recording.env["modes"])) // recording.env["ahead"]
        assert all((e.success & (used == k)).sum() > 3 for k in (0, 1))


@pytest.mark.compiled
def test_limits_of_instruments():
    """Elevation, range and light at the target are limited for each instrument, in its windows and in the tick of an image."""
    recording = load("imaging_limits")
    check(replay(recording, environment(recording)), POSITION["arc"], LIMITED)
    names = [*recording.env["instruments"]]
    taken = np.zeros(len(names), dtype=int)
    for e in episodes("limits"):
        used = (e.action - len(recording.env["modes"])) // recording.env["ahead"]
        taken += [(e.taken & e.tasked & (used == k)).sum() for k in range(len(names))]
        r_BN_P = e.obs[1:, 12:15] * EARTH_RADIUS
        away = r_BN_P - recording.r_LP_P[e.i][e.image]
        reach = np.array([recording.env["instruments"][name].get("imageTargetMaximumRange", np.inf) for name in names])
        images = e.taken & e.tasked
        assert (np.linalg.norm(away, axis=1)[images] < reach[used[images]] + 8e3).all()  # as it was in the tick before
    assert taken.min() > 3


@pytest.mark.compiled
def test_steering():
    """Attitude by the steering law, with gains at which it is not chaotic."""
    recording = load("imaging_steering")
    check(replay(recording, environment(recording)), POSITION["arc"], STEERING)


@pytest.mark.compiled
def test_look_ahead_of_days():
    """So few targets that queries give up: the last window is repeated, and every query searches 60 000 s more."""
    recording = load("imaging_padded")
    check(replay(recording, environment(recording)), POSITION["arc"], DAYS)


@pytest.mark.compiled
@pytest.mark.nightly
def test_integrated():
    """The orbit integrated in every tick."""
    recording = load("imaging_stale")
    check(replay(recording, environment(recording, orbit="integrated")), POSITION["integrated"], IMAGING)


@pytest.mark.compiled
def test_second_episode():
    """Nothing is left over from an episode that was broken off."""
    recording = load("imaging_stale")
    env = environment(recording)
    replay(recording, env, longest=3)
    check(replay(recording, env), POSITION["arc"], IMAGING)


def test_eager_first_steps():
    """The debugger's back end, on an image action that is cut off and what it leaves behind."""
    recording = load("imaging_stale")
    check(replay(recording, environment(recording, backend="eager"), longest=2), POSITION["arc"], IMAGING)


class Episode:
    """Rows of one episode, by what the tests below ask of it."""

    def __init__(self, recording, i):
        self.recording, self.i = recording, i
        rows = {key: part[i] for key, part in recording.arrays.items()}
        self.action, self.reward, self.retask = (rows[key] for key in ("action", "reward", "requires_retasking"))
        self.state, self.obs, self.truncated = rows["state"], rows["obs"], rows["truncated"]
        self.time, self.duration = self.state[:, 0], np.diff(self.state[:, 0]).round(6)
        self.target, self.image = rows["tasked"], rows["image"]
        self.tasked, self.taken = self.target >= 0, self.image >= 0
        self.success = np.diff(rows["imaged"]) > 0
        self.duplicates, self.counted = rows["duplicates"], rows["missed"]
        self.new_images = np.round(np.diff(self.state[:, BUFFER]) / IMAGE).astype(int)
        self.downlink = np.diff(self.state[:, STORAGE]) < 0
        self.again = np.r_[False, self.tasked[1:] & (self.target[1:] == self.target[:-1])]
        self.missed = misses(recording, i)

    @property
    def slots(self):
        """Observed targets, [steps + 1, n, features]."""
        n = self.recording.env["ahead"]
        return self.obs[:, FIRST_TARGET : FIRST_TARGET + n * TARGET_WIDTH].reshape(len(self.obs), n, TARGET_WIDTH)

    @property
    def padded(self):
        """Observed windows that repeat the one before, by decision."""
        windows = self.slots[:, :, [*range(1, 4), OPEN, CLOSE]]
        return (windows[:, 1:] == windows[:, :-1]).all(-1).sum(1)

    def windows(self, when=1):
        return self.recording.windows["target"][self.i][when]

    def distances(self):
        """From the satellite to what it has imaged, at the end of each such step, m."""
        r_BN_P = self.obs[1:, 12:15] * EARTH_RADIUS
        return np.linalg.norm(r_BN_P - self.recording.r_LP_P[self.i][self.image], axis=1)[self.taken & self.tasked]

    def inclination(self):
        h = np.cross(self.state[0, 1:4], self.state[0, 4:7])
        return np.degrees(np.arccos(h[2] / np.linalg.norm(h)))


def episodes(name):
    recording = load(f"imaging_{name}")
    return [Episode(recording, i) for i in range(len(recording))]


@pytest.mark.parametrize("name", ["feedback", "steering"])
def test_long_episodes_contain_every_mode(name):
    found = episodes(name)
    for e in found:
        assert (e.taken & e.tasked).sum() > 30
        assert set(e.action) >= {0, 1, 2, 3, 10}
        assert len(set(e.state[:, 18] == 1.0)) == 2  # in sunlight and in shadow
        assert e.missed.any()
    assert any(e.downlink.any() for e in found)
    assert any((e.counted[-1] > 0) and (e.counted[-1] < e.missed.sum()) for e in found)  # bsk_rl overlooks some


def test_numbers_of_targets_differ():
    assert [load(f"imaging_{name}").env["targets"] for name in ("few", "sparse", "dense")] == [10, 100, 5000]
    for e in episodes("few"):
        assert e.windows().close.max() > 2 * e.time[-1]  # far beyond the episode
    assert any(e.taken.any() for e in episodes("few"))
    assert all(e.taken.any() for e in episodes("sparse"))
    assert all(len(e.windows().open) > 150 for e in episodes("dense"))


def test_padding_repeats_the_last_window():
    hidden = 0
    for e in episodes("padded"):
        assert e.padded[:2].any()
        shown = e.slots[0, e.action[0] - 3, R_LP_P] * EARTH_RADIUS
        hidden += np.abs(shown - e.recording.r_LP_P[e.i][e.target[0]]).max() > 1.0
        assert e.windows().close.max() > 86400.0
    assert hidden  # the action found a target that the observation had not
    for e in episodes("bounded"):
        assert e.padded[-1] > 0
        assert e.windows().close.max() <= e.time[-1] + 1200.0 + 600.0


def test_orbits_and_elevations_differ():
    assert all(abs(e.inclination() - 97.0) < 0.1 for e in episodes("polar"))
    assert all(e.inclination() < 0.1 for e in episodes("equatorial"))
    longest = {}
    for name in ("30deg", "feedback", "80deg"):
        longest[name] = max((e.windows().close - e.windows().open).max() for e in episodes(name))
        assert all(e.taken.any() for e in episodes(name))
    assert longest["30deg"] > 180.0 > 140.0 > longest["feedback"] > 100.0 > 30.0 > longest["80deg"]


def test_range_limits_images_but_not_windows():
    assert max(e.distances().max() for e in episodes("feedback")) > 620e3
    for e in episodes("range"):
        assert e.distances().max() < 600e3 + 8e3  # as it was in the tick before
        assert e.missed.any()
        assert any(
            "imageRateErrorRequirement" in fixed and fixed["imageRateErrorRequirement"] is None for fixed in [e.recording.fixed]
        )


def test_store_fills_up():
    found = episodes("full")
    for e in found:
        full = e.state[:-1, STORAGE] == 3 * IMAGE
        assert (full & e.missed & (e.reward == 0.0)).any()
    assert any(e.downlink.any() and e.taken.sum() > 3 for e in found)


def test_time_limit_cuts():
    first, second, third, fourth, fifth, last = episodes("cut")
    assert all(e.truncated[-1] and not e.retask[-1] for e in (first, second, third, fourth, fifth, last))
    # the image of the last tick pays, but is not counted as a success; a tick later it would have been one
    assert first.taken[-1]
    assert first.reward[-1] > 0.0
    assert not first.success[-1]
    assert second.tasked[-1]
    assert not second.taken[-1]
    # the window closes, or the action is over, in the last tick
    close = third.windows(0).close[third.windows(0).place == third.target[-1]]
    assert third.tasked[-1]
    assert close.min() <= third.time[-1] < close.min() + 1.0
    assert (fourth.action[-1], fourth.duration[-1]) == (1, 60.0)
    assert (fifth.recording.initial[4]["time_limit"], fifth.time[-1]) == (333.4, 334.0)
    assert last.time[-1] == 600.0


def test_longest_duration_cuts():
    cut = [e.tasked & ~e.taken & (e.duration == 33.0) for e in episodes("timeout")]
    assert all(c.sum() > 10 for c in cut)
    found = episodes("timeout")
    assert all((e.again & e.taken).any() for e in found)  # waited for again, then imaged
    # cut off in the tick of the command: the next target is credited with the image a tick later
    assert any((e.taken & e.tasked & ~e.again & (e.duration == 1.0)).any() for e in found)


def test_commands_are_left_over():
    charge, other, same, desat = episodes("stale")
    for e in (charge, other, same, desat):
        assert e.tasked[0]
        assert not e.taken[0]
        assert e.duration[0] == 73.0
        assert e.taken[1]
        assert e.success[1]
        assert e.duration[1] == 1.0
        assert e.reward[1] > 0.0
    for e in (charge, desat):  # the old event ends the first step; then an image in every tick, until the store is full
        assert not e.tasked[1:3].any()
        assert (e.image[1:3] == e.target[0]).all()
        assert e.new_images[2] == 39
        assert not e.success[2]
        assert (e.reward[2], e.duplicates[3]) == (0.0, 1)
    assert other.tasked[1]
    assert other.image[1] == other.target[1] != other.target[0]
    assert same.again[1]
    assert same.image[1] == same.target[0]


def test_intervals_are_fixed():
    found = episodes("interval")
    for e in found:
        assert (e.duration[:-1] == 71.0).all()
        assert (e.success & e.retask).sum() > 3
    assert any((e.retask & ~e.tasked).any() for e in found)
    assert any((e.missed & e.retask).any() for e in found)
    assert any(e.downlink.any() for e in found)
    assert any((e.again & e.taken).any() for e in found)


def test_data_are_stored_at_the_start():
    found = episodes("stored")
    for e in found:
        assert (e.state[0, STORAGE], e.state[0, BUFFER]) == (47_123_457, 0.0)
        assert e.state[-1, BUFFER] > 0.0
        assert e.downlink.sum() > 2
        other = e.state[:, STORAGE] - e.state[:, BUFFER]
        assert other[-1] < IMAGE  # less than a packet is left
    assert any((e.new_images < 0).any() for e in found)  # the images follow


def test_time_is_unlimited():
    recorded = episodes("unlimited")
    assert recorded
    for e in recorded:
        assert len(e.action) == 30
        assert not e.truncated.any()
        assert e.windows(0).close.max() < 3600.0  # known after reset: no more than what was asked for
        assert e.windows(1).close.max() > e.time[-1]


def test_ticks_of_half_a_second():
    (e,) = episodes("half_second")
    assert (e.time % 1.0 == 0.5).any()
    assert e.taken.any()
