"""Records of captures and what sensors know of them, against lists of records of each sensor."""

from __future__ import annotations

from dataclasses import dataclass, replace

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from bsk_torch.tasks.objects.records import AGO, CAPTURED, DELIVERED, FIRST_RECORDS, NONE, RecordBook

SENSORS, TARGETS, ENVS = 3, 4, 2


@dataclass(frozen=True)
class Record:
    key: int
    source: int
    target: int
    epoch: int
    capture: float
    delivered: bool = False

    @property
    def version(self):
        return DELIVERED if self.delivered else CAPTURED


class Sensor:
    """A catalog as a dictionary of records, with what others have acknowledged."""

    def __init__(self, number):
        self.number, self.known, self.received, self.acknowledged = number, {}, {}, {}

    def merge(self, record, now):
        old = self.known.get(record.key)
        for version in range(CAPTURED, record.version + 1):
            self.received.setdefault((record.key, version), now)
        if old is None or old.version < record.version:
            self.known[record.key] = record

    def acknowledge(self, other, record):
        key = other, record.key
        self.acknowledged[key] = max(self.acknowledged.get(key, 0), record.version)

    def news(self, other):
        return [
            record
            for record in self.known.values()
            if record.source != other and self.acknowledged.get((other, record.key), 0) < record.version
        ]

    def latest(self, target, epoch, version=CAPTURED):
        times = [r.capture for r in self.known.values() if r.target == target and r.epoch == epoch and r.version >= version]
        return max(times, default=AGO)


class Reference:
    """An episode in plain Python."""

    def __init__(self):
        self.sensors, self.epochs, self.number = [Sensor(k) for k in range(SENSORS)], [0] * TARGETS, 0

    def capture(self, sensor, target, now):
        record = Record(self.number, sensor, target, self.epochs[target], now)
        self.number += 1
        self.sensors[sensor].merge(record, now)
        return record.key

    def deliver(self, key, now):
        source = next(s for s in self.sensors if key in s.known and s.known[key].source == s.number)
        source.merge(replace(source.known[key], delivered=True), now)

    def send(self, packets, now):
        """Deliver frozen packets: (sender, receiver, records)."""
        for sender, receiver, records in packets:
            for record in records:
                self.sensors[receiver].merge(record, now)
                self.sensors[sender].acknowledge(receiver, record)
                self.sensors[receiver].acknowledge(sender, record)


def compare(book, env, reference, now):
    for a, sensor in enumerate(reference.sensors):
        known = {r: int(v) for r, v in enumerate(book.known[env, :, a]) if v}
        assert known == {key: record.version for key, record in sensor.known.items()}
        for key, version in sensor.received:
            assert book.received[env, key, a, version - 1] == sensor.received[key, version]
        for b in range(SENSORS):
            if a != b:
                told = {r for r, v in enumerate(book.news()[env, :, a, b]) if v}
                assert told == {record.key for record in sensor.news(b)}
        for target, epoch in enumerate(reference.epochs):
            assert book.latest()[env, a, target] == sensor.latest(target, epoch)
            assert book.latest(DELIVERED)[env, a, target] == sensor.latest(target, epoch, DELIVERED)
            cooldown = torch.full((ENVS,), 5.0, dtype=torch.float64)
            satisfied = book.satisfied(torch.full_like(cooldown, now), cooldown)[env, a, target]
            assert bool(satisfied) == (sensor.latest(target, epoch) + 5.0 > now)


steps = st.lists(
    st.one_of(
        st.tuples(
            st.just("capture"), st.integers(0, ENVS - 1), st.integers(0, SENSORS - 1), st.integers(0, TARGETS - 1), st.booleans()
        ),
        st.tuples(st.just("deliver"), st.integers(0, ENVS - 1), st.integers(0, 30)),
        st.tuples(st.just("request"), st.integers(0, ENVS - 1), st.integers(0, TARGETS - 1)),
        st.tuples(st.just("send"), st.integers(0, ENVS - 1), st.integers(0, SENSORS**2 - 1), st.integers(1, 2**9 - 1)),
    ),
    min_size=1,
    max_size=40,
)


def one_env(env, value, shape):
    table = torch.zeros(ENVS, *shape, dtype=torch.bool)
    table[env] = value
    return table


@given(steps)
@settings(max_examples=60, deadline=None)
def test_knowledge_is_that_of_lists_of_records(sequence):
    """Captures, deliveries, requests and packets that others may have overtaken, in two episodes."""
    book, references = RecordBook(ENVS, SENSORS, TARGETS), [Reference() for _ in range(ENVS)]
    waiting = [[] for _ in range(ENVS)]
    for now, (kind, env, *what) in enumerate(sequence, start=1):
        reference, time = references[env], torch.full((ENVS,), float(now), dtype=torch.float64)
        if kind == "capture":
            sensor, target, _ = what
            there = one_env(env, True, (1,))
            at = time.unsqueeze(1)
            index = book.enter(there, torch.full((ENVS, 1), sensor), torch.full((ENVS, 1), target), at, at, time)
            assert index[env, 0] == reference.capture(sensor, target, float(now))
            assert index[1 - env, 0] == NONE
        elif kind == "deliver" and reference.number:
            key = what[0] % reference.number
            records = torch.full((ENVS, 1), NONE)
            records[env] = key
            book.deliver(records, time)
            reference.deliver(key, float(now))
        elif kind == "request":
            chosen = torch.zeros(ENVS, TARGETS, dtype=torch.bool)
            chosen[env, what[0]] = True
            book.request_again(chosen)
            reference.epochs[what[0]] += 1
        elif kind == "send":
            sender, receiver = divmod(what[0], SENSORS)
            if sender == receiver:
                continue
            frozen = book.news(), reference.sensors[sender].news(receiver), sender, receiver
            waiting[env].append(frozen)
            if what[1] % 2:  # others wait, and arrive late
                continue
            for tensor, records, source, goal in waiting[env][::-1]:
                links = torch.zeros(ENVS, SENSORS, SENSORS, dtype=torch.bool)
                links[env, source, goal] = True
                message = torch.zeros_like(book.told)
                message[:, : tensor.shape[1]] = tensor
                book.pass_on(message, links, time)
                reference.send([(source, goal, records)], float(now))
            waiting[env] = []
        compare(book, env, reference, float(now))
    assert (book.target != NONE).sum(1).tolist() == [reference.number for reference in references]


def test_all_share_what_they_knew_before():
    """Along a chain of links nothing is relayed within one exchange."""
    book, now = RecordBook(1, SENSORS, TARGETS), torch.tensor([7.0], dtype=torch.float64)
    at = now.unsqueeze(1)
    book.enter(torch.tensor([[True]]), torch.tensor([[0]]), torch.tensor([[2]]), at, at, now)
    links = torch.zeros(1, SENSORS, SENSORS, dtype=torch.bool)
    links[0, 0, 1] = links[0, 1, 2] = True
    book.pass_on(book.all_known(links), links, now)
    assert book.known[0, 0].tolist() == [1, 1, 0]
    book.pass_on(book.all_known(links), links, now + 1.0)
    assert book.known[0, 0].tolist() == [1, 1, 1]
    assert book.received[0, 0, :, 0].tolist() == [7.0, 7.0, 8.0]
    assert book.exchanged[0, 0, 1] == 8.0
    assert book.exchanged[0, 1, 0] == AGO


def test_the_book_grows_and_is_reset():
    book, now = RecordBook(2, 2, 3), torch.tensor([1.0, 1.0], dtype=torch.float64)
    for k in range(FIRST_RECORDS + 3):
        there = torch.tensor([[True, False], [k % 2 == 0, True]])
        at = (now + k).unsqueeze(1).expand(2, 2)
        index = book.enter(there, torch.tensor([[0, 1], [1, 0]]), torch.tensor([[k % 3, 0], [1, 2]]), at, at, now + k)
        assert index[0].tolist() == [k, NONE]
    assert int((book.target[0] != NONE).sum()) == FIRST_RECORDS + 3
    assert int((book.target[1] != NONE).sum()) == FIRST_RECORDS + 3 + (FIRST_RECORDS + 4) // 2
    book.reset(torch.tensor([0]))
    assert bool((book.target[0] == NONE).all())
    assert bool((book.latest()[0] == AGO).all())
    assert book.latest()[1, 0, 2] == FIRST_RECORDS + 3.0


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_the_older_version_changes_nothing(order):
    """A capture that arrives after its delivery, or before it."""
    book, now = RecordBook(1, 2, 1), torch.tensor([3.0], dtype=torch.float64)
    at = now.unsqueeze(1)
    book.enter(torch.tensor([[True]]), torch.tensor([[0]]), torch.tensor([[0]]), at, at, now)
    early = book.news()
    book.deliver(torch.tensor([[0]]), now)
    late = book.news()
    links = torch.tensor([[[False, True], [False, False]]])
    for k in order:
        book.pass_on((early, late)[k], links, now)
    assert book.known[0, 0].tolist() == [DELIVERED, DELIVERED]
    assert not bool(book.news().any())
