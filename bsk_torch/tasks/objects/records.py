"""What sensors know of each other's images: records of captures, and copies of them."""

from __future__ import annotations

import functools

import torch
from torch import Tensor

from bsk_torch.sim.state import FINITE, StateTable

NONE = -1
"""Target of a place without a record."""

UNKNOWN, CAPTURED, DELIVERED = 0, 1, 2
"""Versions of a record that a sensor has: none, that of the capture, and that of the delivery."""

FIRST_RECORDS = 16
"""Room for records of an episode at the beginning; it grows."""

AGO = -FINITE
"""Time of what has not happened, s."""


class RecordBook(StateTable):
    """Records of qualified captures, and which sensors know them.

    A record states that a sensor has captured a target, and, in its second version, that the image has been delivered. It is
    stored once; of each sensor only the version that it knows is kept, so knowledge never depends on the order of messages, or on
    who has relayed them. A *request epoch* of a target counts the requests for it: records of an older epoch do not count.

    N is the number of episodes, R that of records, A that of sensors, G that of targets.
    """

    target: Tensor  # target of each record, [N, R]; NONE where there is no record
    source: Tensor  # sensor that has captured it, [N, R]
    epoch: Tensor  # epoch of the target at that time, [N, R]
    capture: Tensor  # time of the capture, [N, R] s
    completion: Tensor  # end of the step in which the exposure was completed, [N, R] s
    delivery: Tensor  # time of the delivery, [N, R] s; FINITE before
    known: Tensor  # version of each record that each sensor knows, [N, R, A] int8
    received: Tensor  # time at which each sensor learned of the capture and of the delivery, [N, R, A, 2] s; FINITE before
    told: Tensor  # version that the third index knows the fourth to have, [N, R, A, A] int8
    exchanged: Tensor  # time of the last message from the first to the second sensor, [N, A, A] s; AGO before
    epochs: Tensor  # present epochs of the targets, [N, G]
    packet: Tensor  # versions of records in the packet that each sensor is sending, or has sent last, [N, R, A] int8
    receiver: Tensor  # sensor to which it is sent, [N, A]
    queue: Tensor  # packets on their way, [N, R, A, slots] int8, which a communicator declares; likewise the next four
    queue_receiver: Tensor  # their receivers, [N, A, slots]
    queue_time: Tensor  # times at which they have been sent, [N, A, slots] s; FINITE for places without a packet
    queue_number: Tensor  # number of packets that their senders had sent before, [N, A, slots]
    sent: Tensor  # number of packets that each sensor has sent, [N, A]
    # places of each sensor in the queue; 0 where no communicator delivers packets, so that links stand for all that is known
    slots: int

    def __init__(self, num_envs: int, sensors: int, targets: int, device: torch.device | str = "cpu") -> None:
        """Make a book without records for ``sensors`` A and ``targets`` G in each of ``num_envs`` episodes N."""
        super().__init__(num_envs, 1, device)
        self.sensors, self.targets, self.slots = sensors, targets, 0
        record = functools.partial(self.declare, grows=True)
        version = functools.partial(record, dtype=torch.int8, low=UNKNOWN, high=DELIVERED)
        record("target", NONE, FIRST_RECORDS, low=NONE, high=targets - 1)
        record("source", 0, FIRST_RECORDS, low=0, high=sensors - 1)
        record("epoch", 0, FIRST_RECORDS, low=0)
        for name in ("capture", "completion"):
            record(name, 0.0, FIRST_RECORDS, low=0.0, high=FINITE)
        record("delivery", FINITE, FIRST_RECORDS, low=0.0, high=FINITE)
        version("known", UNKNOWN, FIRST_RECORDS, sensors)
        version("told", UNKNOWN, FIRST_RECORDS, sensors, sensors)
        version("packet", UNKNOWN, FIRST_RECORDS, sensors)
        record("received", FINITE, FIRST_RECORDS, sensors, 2, low=0.0, high=FINITE)
        self.declare("receiver", 0, sensors, low=0, high=sensors - 1)
        self.declare("exchanged", AGO, sensors, sensors, low=AGO, high=FINITE)
        self.declare("epochs", 0, targets, low=0)

    # -- records ------------------------------------------------------------------------------------------------------

    def enter(self, exists: Tensor, source: Tensor, target: Tensor, capture: Tensor, completion: Tensor, now: Tensor) -> Tensor:
        """Enter captures of a step, which their sensors know; return the numbers of the records, [N, K], ``NONE`` for others.

        Args:
            exists: Whether there is a capture, [N, K].
            source: Its sensor, [N, K].
            target: Its target, [N, K].
            capture: Time of the capture, [N, K] s.
            completion: End of the step in which the exposure was completed, [N, K] s.
            now: The present, [N] s.
        """
        count = (self.target != NONE).sum(1, keepdim=True)
        number = count + exists.long().cumsum(1) - 1
        self._make_room(int(number.max()) + 1)
        spare = self.target.shape[1]  # where what is not there is written
        place = torch.where(exists, number, spare)
        facts = {"target": target, "source": source, "capture": capture, "completion": completion}
        facts["epoch"] = self.epochs.gather(1, target)
        for name, value in facts.items():
            self[name] = _put(self[name], place, value)
        owner = torch.nn.functional.one_hot(source, self.sensors)
        self.known = _put(self.known, place, (owner * CAPTURED).to(torch.int8))
        pairs = (owner.unsqueeze(-1) * owner.unsqueeze(-2) * CAPTURED).to(torch.int8)
        self.told = _put(self.told, place, pairs)
        first = torch.where(owner.bool(), now.view(-1, 1, 1), FINITE)
        self.received = _put(self.received, place, torch.stack([first, torch.full_like(first, FINITE)], -1))
        self.touch()
        return torch.where(exists, number, NONE)

    def _make_room(self, records: int) -> None:
        missing = records - self.target.shape[1]
        if missing <= 0:
            return
        more = max(missing, FIRST_RECORDS)
        for name, field in self.fields.items():
            if field.grows:
                table = self[name]
                padding = table.new_full((len(table), more, *table.shape[2:]), field.initial or 0)
                setattr(self, name, torch.cat([table, padding], 1))

    def deliver(self, records: Tensor, now: Tensor) -> None:
        """Record the delivery of ``records`` [N, K], which may contain ``NONE``, at ``now`` [N] s; their sources know it."""
        spare = self.target.shape[1]
        place = torch.where(records == NONE, spare, records)
        delivered = _put(torch.zeros_like(self.target, dtype=torch.bool), place, torch.ones_like(records, dtype=torch.bool))
        self.delivery = torch.where(delivered, now.unsqueeze(1), self.delivery)
        sources = torch.nn.functional.one_hot(self.source, self.sensors).bool() & delivered.unsqueeze(-1)
        self._learn(torch.where(sources, DELIVERED, UNKNOWN).to(torch.int8), now)

    def request_again(self, targets: Tensor) -> None:
        """Begin a new epoch of ``targets`` [N, G] bool: captures so far do not count any more."""
        self["epochs"] = self.epochs + targets

    # -- messages -----------------------------------------------------------------------------------------------------

    def news(self) -> Tensor:
        """Return what each sensor has to tell each other: versions by sender and receiver, [N, R, A, A] int8, else zero.

        These are the records that the sender knows in a version which it does not know the receiver to have; but a receiver
        hears nothing of what it has captured.
        """
        foreign = torch.nn.functional.one_hot(self.source, self.sensors) == 0
        versions = self.known.unsqueeze(-1)
        return torch.where((self.told < versions) & foreign.unsqueeze(2), versions, UNKNOWN).to(torch.int8)

    def all_known(self, links: Tensor) -> Tensor:
        """Return messages of all that senders know, [N, R, A, A] int8, along ``links`` [N, A, A] bool."""
        return self.known.unsqueeze(-1) * links.unsqueeze(1).to(torch.int8)

    # -- packets ------------------------------------------------------------------------------------------------------

    def declare_queue(self, slots: int) -> None:
        """Make room for so many packets of each sensor on their way."""
        self.slots = slots
        self.declare(
            "queue", UNKNOWN, FIRST_RECORDS, self.sensors, slots, dtype=torch.int8, grows=True, low=UNKNOWN, high=DELIVERED
        )
        self.declare("queue_receiver", 0, self.sensors, slots, low=0, high=self.sensors - 1)
        self.declare("queue_time", FINITE, self.sensors, slots, low=0.0, high=FINITE)
        self.declare("queue_number", 0, self.sensors, slots, low=0)
        self.declare("sent", 0, self.sensors, low=0)

    def begin_packets(self, begins: Tensor, receiver: Tensor) -> None:
        """Put what sensors have to tell into packets, where ``begins`` [N, A], for the ``receiver`` [N, A]."""
        index = receiver.view(len(receiver), 1, -1, 1).expand(-1, self.target.shape[1], -1, 1)
        content = self.news().gather(3, index).squeeze(3)
        self.packet = torch.where(begins.unsqueeze(1), content, self.packet)
        self.receiver = torch.where(begins, receiver, self.receiver)
        self.touch()

    def queue_packets(self, ready: Tensor, now: Tensor) -> None:
        """Put packets that have been sent at ``now`` [N] s into the queue, where ``ready`` [N, A]."""
        slot = torch.nn.functional.one_hot((self.queue_time >= FINITE).byte().argmax(2), self.slots).bool()  # the first one free
        place = slot & ready.unsqueeze(2)
        self.queue = torch.where(place.unsqueeze(1), self.packet.unsqueeze(3), self.queue)
        self.queue_receiver = torch.where(place, self.receiver.unsqueeze(2), self.queue_receiver)
        self.queue_time = torch.where(place, now.view(-1, 1, 1), self.queue_time)
        self.queue_number = torch.where(place, self.sent.unsqueeze(2), self.queue_number)
        self.sent = self.sent + ready
        self.touch()

    def deliver_packets(self, due: Tensor, arrives: Tensor, now: Tensor) -> Tensor:
        """Take packets ``due`` [N, A, slots] from the queue, and deliver those that also ``arrive``.

        Returns:
            Which sensors have sent something to which others, [N, A, A] bool.
        """
        goal = torch.nn.functional.one_hot(self.queue_receiver, self.sensors).bool() & (due & arrives).unsqueeze(3)
        messages = torch.where(goal.unsqueeze(1), self.queue.unsqueeze(4), UNKNOWN).amax(3)
        links = goal.any(2)
        self.queue_time = torch.where(due, FINITE, self.queue_time)
        self.pass_on(messages, links, now)
        return links

    def pass_on(self, messages: Tensor, links: Tensor, now: Tensor) -> None:
        """Deliver messages; senders learn that receivers know their content, and receivers that senders do.

        All messages hold what was known before; nothing is relayed at once.

        Args:
            messages: Versions of records by sender and receiver, [N, R, A, A] int8; zero for records that are not in a message.
            links: Messages that arrive, which may be empty, [N, A, A] bool.
            now: The present, [N] s.
        """
        arrives = messages * links.unsqueeze(1).to(torch.int8)
        self.told = torch.maximum(self.told, torch.maximum(arrives, arrives.mT))
        heard = arrives.amax(2)
        self._learn(heard, now)
        self["exchanged"] = torch.where(links, now.view(-1, 1, 1), self.exchanged)

    def _learn(self, versions: Tensor, now: Tensor) -> None:
        """Let sensors learn ``versions`` [N, R, A] of records, and keep the time at which they first did."""
        for k, version in enumerate((CAPTURED, DELIVERED)):
            new = (versions >= version) & (self.known < version)
            self.received[..., k] = torch.where(new, now.view(-1, 1, 1), self.received[..., k])
        self.known = torch.maximum(self.known, versions)
        diagonal = torch.diag_embed(self.known)
        self.told = torch.maximum(self.told, diagonal)
        self.touch()

    # -- knowledge ----------------------------------------------------------------------------------------------------

    def latest(self, version: int = CAPTURED) -> Tensor:
        """Return the time of the latest capture of each target that each sensor knows, [N, A, G] s; ``AGO`` where it knows none.

        Captures count whose records are of the present epoch, and known at least in ``version``.
        """
        place = self.target.clamp(min=0)
        counts = (self.target != NONE) & (self.epoch == self.epochs.gather(1, place))
        counts = counts.unsqueeze(-1) & (self.known >= version)
        time = torch.where(counts, self.capture.unsqueeze(-1), AGO).mT
        shape = self.num_envs, self.sensors, -1
        blank = torch.full((self.num_envs, self.sensors, self.targets), AGO, dtype=torch.float64, device=self.device)
        return blank.scatter_reduce(2, place.unsqueeze(1).expand(shape), time, "amax")

    def satisfied(self, now: Tensor, cooldown: Tensor) -> Tensor:
        """Return the targets of which each sensor knows a capture that is younger than the cooldown, [N, A, G] bool.

        Args:
            now: The present, [N] s.
            cooldown: Time after a capture in which no other is wanted, [N] s.
        """
        return self.latest() + cooldown.view(-1, 1, 1) > now.view(-1, 1, 1)


def _put(table: Tensor, place: Tensor, value: Tensor) -> Tensor:
    """Return a table [N, R, ...] with values [N, K, ...] at the places [N, K], of which R stands for none."""
    room = torch.cat([table, table[:, :1]], 1)
    index = place.view(*place.shape, *[1] * (table.ndim - 2)).expand(*place.shape, *table.shape[2:])
    return room.scatter(1, index, value.to(table.dtype))[:, :-1]
