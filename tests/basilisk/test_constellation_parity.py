"""Recorded episodes of several satellites, replayed as one batch.

Bounds are those of a single satellite (see test_parity.py); who is asked for a task, who lives, who talks to whom, which targets
are imaged and who knows it are exact, as are the ends of steps.
"""

import itertools

import numpy as np
import pytest

from tests.basilisk.constellation import BUFFER, environment, load, replay
from tests.basilisk.test_parity import BOUNDS, POSITION, check

CONSTELLATION = {**BOUNDS, "paid": 1e-9, "duration": 1e-9}
NAMES = (
    *("los", "range", "multi", "free", "broadcast", "types", "death", "meta", "meta_idle", "scan", "untasked", "joint", "shared"),
)
STORAGE = 17


@pytest.mark.compiled
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.nightly("meta_idle")
def test_constellation(name):
    recording = load(name)
    check(replay(recording, environment(recording)), POSITION["arc"], CONSTELLATION)


@pytest.mark.compiled
@pytest.mark.parametrize("name", ["broadcast", "death"])
def test_second_episode(name):
    """Nothing is left over from an episode that was broken off: no knowledge, no broadcast, no dead satellite."""
    recording = load(name)
    env = environment(recording)
    replay(recording, env, longest=20)
    check(replay(recording, env), POSITION["arc"], CONSTELLATION)


@pytest.mark.parametrize("name", ["types", "scan"])
@pytest.mark.nightly("scan", "types")
def test_eager_first_steps(name):
    """The debugger's back end."""
    recording = load(name)
    check(replay(recording, environment(recording, backend="eager"), longest=2), POSITION["arc"], CONSTELLATION)


class Episode:
    """Rows of one episode, by what the tests below ask of it."""

    def __init__(self, recording, i):
        self.recording, self.i = recording, i
        rows = recording.episode(i)
        self.state, self.retask, self.alive, self.observed = (
            rows[key] for key in ("state", "requires_retasking", "alive", "observed")
        )
        self.action, self.image, self.paid, self.present = (rows[key] for key in ("action", "image", "paid", "present"))
        self.reward, self.terminated, self.truncated = (rows[key] for key in ("reward", "terminated", "truncated"))
        self.access, self.links, self.evaluated = (rows[key] for key in ("access", "links", "evaluated"))
        self.knows, self.everyone, self.active = (rows[key] for key in ("knows", "everyone", "active"))
        self.time, self.duration = self.state[:, 0, 0], np.diff(self.state[:, 0, 0]).round(6)
        self.tasked, self.taken, self.idle = self.action >= 0, self.image >= 0, self.retask[:-1] & self.alive[:-1]
        self.limit = recording.initial[i]["time_limit"]

    @property
    def again(self):
        """Images of targets that had been imaged before, [steps, S]."""
        return self.taken & np.stack([known[target] for known, target in zip(self.everyone, self.image, strict=False)])

    @property
    def unknowing(self):
        """Images of targets of which the satellite did not know that they had been, [steps, S]."""
        rows = zip(self.knows, self.image, strict=False)
        knew = np.stack([np.take_along_axis(knows, target[:, None], 1)[:, 0] for knows, target in rows])
        return self.again & ~knew

    @property
    def shared(self):
        """Steps in which several satellites imaged the same target, [steps]."""
        pairs = itertools.combinations(range(self.image.shape[1]), 2)
        return np.any([(self.image[:, a] == self.image[:, b]) & self.taken[:, a] for a, b in pairs], 0)

    def linked(self, a, b):
        """In which steps two satellites could talk, [steps]."""
        return self.links[:, a, b] | self.links[:, b, a]


def episodes(name):
    recording = load(name)
    return [Episode(recording, i) for i in range(len(recording))]


def test_all_recordings_are_asynchronous():
    for name in NAMES:
        recorded = episodes(name)
        assert recorded, name
        for e in recorded:
            assert (e.retask[1:-1].any(1) & ~e.retask[1:-1].all(1)).any(), name
            assert (~e.tasked & ~e.retask[:-1]).any(), name
            assert abs(np.linalg.norm(e.state[0, :, 1:4], axis=-1) - 6871e3).max() < 1.0, name


def test_imagers_compete():
    for name in ("los", "range", "free", "broadcast", "death", "meta", "meta_idle", "joint", "shared"):
        found = episodes(name)
        assert sum(e.taken.sum() for e in found) >= 20
        assert sum(e.again.sum() for e in found) >= 1
        assert all((e.paid[e.again] == 0.0).all() for e in found)
    for name in ("los", "range", "free", "broadcast", "meta", "meta_idle", "shared"):
        assert any(e.unknowing.any() for e in episodes(name)), name
        assert all((e.knows[:-1] != e.knows[:-1, :1]).any() for e in episodes(name)), name


def test_lines_of_sight_open_and_close():
    (e,) = episodes("los")
    assert e.linked(0, 1).all()
    assert e.linked(2, 3).all()
    for pair in ((1, 2), (3, 4)):
        assert e.linked(*pair).any()
        assert not e.linked(*pair).all()
    assert not e.linked(0, 2).any()
    one_way = e.access & ~e.access.transpose(0, 2, 1)  # the others' positions are a tick old
    assert one_way.any()
    assert (e.links == e.links.transpose(0, 2, 1)).all()
    knows = e.knows.sum(2)
    assert (knows[-1] < e.everyone[-1].sum()).all()


def test_ranges_differ():
    (e,) = episodes("range")
    assert e.access[:, 0, 1].all()
    assert not e.access[:, 1, 0].any()
    assert e.access[:, 0, 2].any()
    assert not e.access[:, 0, 2].all()
    assert not e.access[:, 2].any()
    assert (e.links[e.evaluated, 1, 0]).all()  # heard by the one that does not see
    skipped = e.access.any((1, 2)) & ~e.evaluated
    assert skipped.sum() > 30
    assert not e.links[skipped].any()
    assert (np.diff(e.time[1:][e.evaluated]) >= 60.0).all()


def test_relays_reach_the_ends():
    (e,) = episodes("multi")
    assert not e.access[:, 0, 2].any()
    assert e.links[:, 0, 2].all()
    assert not e.access[:, 0, 4].any()
    assert e.links[:, 0, 4].any()
    assert not e.links[:, 0, 4].all()


def test_free_communication_waits():
    (e,) = episodes("free")
    assert e.evaluated.sum() == 4
    assert (np.diff(e.time[1:][e.evaluated]) >= 300.0).all()
    assert (e.links[e.evaluated].sum((1, 2)) == 6).all()
    assert (e.duration[:-1] <= 71.0).all()
    assert (e.duration == 71.0).any()  # no task was over
    assert (e.limit, e.time[-1]) == (1500.5, 1501.0)
    assert (e.idle & ~e.tasked).sum() > 5
    assert (~e.retask[:-1] & e.tasked).any()
    assert e.retask[-1, 1]  # its task was over before the last tick
    seen = e.recording.episode(e.i)["obs"]
    assert (seen[~e.retask] == 0.0).all()
    assert (np.abs(seen[e.retask]).max(-1) > 0.0).all()
    assert [s["options"] for s in e.recording.env["satellites"]] == [{}, {"variable_interval": False}, {}]
    assert not e.tasked[0].all()  # one satellite is told nothing at the start


def test_broadcasts():
    (e,) = episodes("broadcast")
    sent = e.action == 5
    assert sent.any(0).all()
    heard = e.links.any(2)
    assert (heard == sent).all()  # the message leaves at the end of the step in which it was commanded
    early = sent & (e.duration < 30.0)[:, None]
    assert early.any()  # and the step ends before the action
    assert not e.links.all((1, 2)).any()
    assert e.access[0].sum() == 6
    last = np.maximum.accumulate(np.where(e.tasked, np.arange(len(sent))[:, None], 0))
    assert (np.take_along_axis(sent, last, 0) & e.taken).any()  # an image is taken while the satellite broadcasts


def test_types_are_interleaved():
    (e,) = episodes("types")
    kinds = [satellite["kind"] for satellite in e.recording.env["satellites"]]
    assert kinds == ["imager", "relay", "second", "imager"]
    assert not e.taken[:, 1].any()
    assert e.taken[:, [0, 2, 3]].any(0).all()
    assert e.knows[-1, 1].any()
    assert not e.access[:, 0, 3].any()
    assert e.links[:, 0, 3].any()
    assert not e.links[:, 0, 3].all()
    assert set(e.action[:, 1]) == {-1, 0, 1, 2}
    assert (e.paid[:, 1] == 0.0).all()


def test_satellites_die_one_by_one():
    first, second = episodes("death")
    assert first.alive[-1].tolist() == [True, False, False]
    assert second.alive[-1].tolist() == [False, False, False]
    for e in (first, second):
        for k in range(3):
            if e.alive[-1, k]:
                continue
            dies = int((~e.alive[:, k]).argmax())
            assert e.terminated[dies - 1, k]
            assert e.reward[dies - 1, k] <= -2.0 + 1.0
            assert e.observed[dies, k]
            assert not e.observed[dies + 1 :, k].any()
            assert not e.present[dies:, k].any()
            assert not e.tasked[dies:, k].any()
        dead = ~e.alive[:-1]
        assert (dead & e.taken).any()  # the last command goes on
    assert any((~e.alive[:-1] & (e.paid > 0.0)).any() for e in (first, second))  # such an image counts, but pays no satellite
    assert first.truncated[-1, 0]
    assert first.terminated[-1, 0]
    assert second.time[-1] < second.limit
    assert not second.truncated.any()


def test_agents_of_two():
    (every,), (idle,) = episodes("meta"), episodes("meta_idle")
    pair = [0, 2]
    for e in (every, idle):
        assert e.recording.env["groups"]["pair"] == ["sat2", "sat0"]
        assert (e.tasked[:, 0] == e.tasked[:, 2]).all()
        assert (e.tasked[:, pair] & ~e.retask[:-1, pair]).sum() > 15
        assert not e.links.any()
    assert every.alive.all()
    assert not idle.alive[-1, 0]
    assert idle.alive[-1, 1:].all()
    gone = ~idle.alive[:-1, 0]
    assert not idle.tasked[gone][:, 2].any()  # its mate lives on without tasks
    assert idle.taken[gone].any()


def test_scanning_satellites():
    first, second = episodes("scan")
    modes = [dict(kind["modes"]) for kind in first.recording.env["kinds"].values()]
    assert [mode["Scan"] for mode in modes] == [180.0, 100.0]
    for e in (first, second):
        assert (e.duration <= 150.0).all()
        assert (e.idle & ~e.tasked).any()
        assert (e.paid > 0.0).any(0).all()
        assert e.truncated[-1].all()
        assert e.terminated[-1].all()
    assert (first.tasked & ~first.retask[:-1]).any(0).all()
    assert (first.duration == 150.0).any()
    # an action of 60 s ends in the last tick, and its satellite is not asked any more
    assert second.tasked[-1, 0]
    assert second.duration[-1] == 60.0
    assert not second.retask[-1, 0]


def test_untasked_satellite_transmits():
    (e,) = episodes("untasked")
    waiting = e.time[:-1] < 900.0
    assert not e.tasked[waiting, 1].any()
    assert e.tasked[:, 1].any()
    stored = e.state[: waiting.sum() + 1, 1, STORAGE]
    assert stored[0] > 1e10
    assert stored[-1] == 0.0


def test_joint_agent():
    (e,) = episodes("joint")
    assert (e.alive[-1].tolist(), e.reward[-1, 0]) == ([True, False], e.paid[-1].sum() - 1.0)
    assert e.terminated[-1, 0]
    assert not e.truncated.any()
    assert (e.tasked & ~e.retask[:-1]).any()
    np.testing.assert_allclose(e.reward[:-1, 0], e.paid[:-1].sum(1), atol=1e-15)


def test_images_are_shared():
    found = episodes("shared")
    for e in found:
        assert (e.duration == 120.0).all()
        assert e.shared.any()
        assert (e.retask[1:].sum(1) > 1).any()
    e = found[0]
    step = int(e.shared.argmax())
    targets, counts = np.unique(e.image[step][e.taken[step]], return_counts=True)
    target, share = targets[counts.argmax()], counts.max()
    assert share > 1
    np.testing.assert_allclose(e.paid[step][e.image[step] == target], e.recording.targets[0, target, 3] / share, rtol=1e-12)
    # an image before the last tick is a success, and its satellite is asked, although the others did not stop for it
    assert any((e.retask[-1] & e.taken[-1] & (e.state[-1, :, BUFFER] > e.state[-2, :, BUFFER])).any() for e in found)
