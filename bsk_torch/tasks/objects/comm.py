"""Delivery of packets with records of images."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, ClassVar, cast

import torch
from torch import Tensor

from bsk_torch._checks import number
from bsk_torch.comm.base import CommunicationMethod
from bsk_torch.sim.state import FINITE
from bsk_torch.tasks.objects.aim import PEER
from bsk_torch.tasks.objects.records import RecordBook
from bsk_torch.tasks.objects.team_act import TransmitCatalog

if TYPE_CHECKING:
    from bsk_torch.sats.bound import SatelliteFleet

NUMBER_SHIFT = 32
"""Bits of the number of an episode, above which draws have the number of the packet."""

LONGEST_DELAY = 3600.0
"""Bound of the delay, s, which limits the size of the queue."""


class CatalogCommunication(CommunicationMethod):
    """Delivers what imagers send by :class:`~bsk_torch.tasks.objects.TransmitCatalog`, at the end of a step.

    A packet arrives at the end of the first step that ends at least ``delay_s`` after the packet has been sent. The receiver then
    knows its content, and both know that the other one knows it. A packet that is lost, or that comes later than ``ttl_s``, or
    whose receiver is dead, changes nothing.
    """

    _delivers_packets: ClassVar[bool] = True

    def __init__(self, delay_s: float = 0.0, loss_probability: float = 0.0, ttl_s: float = 600.0) -> None:
        """Choose the radio; ValueError for a wrong argument.

        Args:
            delay_s: Time between sending and arrival, s.
            loss_probability: Probability that a packet is lost.
            ttl_s: Longest time between sending and arrival, s; ValueError if it is less than ``delay_s``.
        """
        super().__init__()
        self.delay_s = number("delay_s", delay_s, 0.0, LONGEST_DELAY, unit="s")
        self.loss_probability = number("loss_probability", loss_probability, 0.0, 1.0)
        self.ttl_s = number("ttl_s", ttl_s, 0.0, unit="s", finite=False)
        if self.ttl_s < self.delay_s:
            raise ValueError(f"ttl_s={ttl_s!r} is less than delay_s={delay_s!r}, so that no packet would arrive")

    def link(self, fleet: SatelliteFleet) -> None:
        """See :meth:`CommunicationMethod.link`; ValueError without records, without senders, or for a wrong number of peers."""
        super().link(fleet)
        if "rso_records" not in fleet.memory.tables:
            raise ValueError(f"{type(self).__name__} needs RSOTargets with knowledge='own'")
        if not any(PEER in simulator.memory for simulator in fleet.simulators):
            raise ValueError(
                f"{type(self).__name__} needs satellites with TransmitCatalog in their action_spec; there are {fleet.names[:5]}"
            )
        entries = [entry for satellite in fleet.satellites for entry in satellite.action_spec]
        senders, peers = [entry for entry in entries if isinstance(entry, TransmitCatalog)], self._records.sensors - 1
        for entry in senders:
            if entry.n_actions != peers:
                raise ValueError(
                    f"TransmitCatalog {entry.name!r} has n_peers={entry.n_actions}, but each of {peers + 1} imagers has "
                    f"{peers} peers"
                )
        shortest = min(entry.min_hold_s for entry in senders)
        self._records.declare_queue(1 + math.ceil(self.delay_s / max(shortest, fleet.h)))

    @property
    def _records(self) -> RecordBook:
        return cast(RecordBook, self.fleet.memory.tables["rso_records"])

    def communication_pairs(self) -> Tensor:
        """See :meth:`CommunicationMethod.communication_pairs`; packets that are due arrive thereby."""
        records, fleet = self._records, self.fleet
        scenario = next(satellite for satellite in fleet.satellites if PEER in satellite.memory).scenario
        age = fleet.sim_time.view(-1, 1, 1) - records.queue_time
        due = (records.queue_time < FINITE) & (age >= self.delay_s) & self.due.view(-1, 1, 1)
        receives = scenario.imagers_alive.unsqueeze(2).expand(-1, -1, records.slots).gather(1, records.queue_receiver)
        links = records.deliver_packets(due, (age <= self.ttl_s) & receives & ~self._losses(), fleet.sim_time)
        columns = torch.tensor(scenario.imager_columns, device=fleet.device)
        pairs = torch.zeros(fleet.num_envs, fleet.size, fleet.size, dtype=torch.bool, device=fleet.device)
        pairs[:, columns.unsqueeze(1), columns] = links
        return pairs

    def _losses(self) -> Tensor:
        """Return which packets of the queue are lost, [N, A, slots]; drawn for the number of the packet."""
        number = self._records.queue_number
        if self.loss_probability == 0.0:
            return torch.zeros_like(number, dtype=torch.bool)
        key, (n, sensors, slots) = self.fleet.key(), number.shape
        sender = torch.arange(sensors).repeat_interleave(slots)
        keys = key.named("loss of packets").of_satellites(sender)
        lots = replace(keys, episode=keys.episode + (number.cpu().flatten() << NUMBER_SHIFT)).uniform(1)
        return lots.view(n, sensors, slots).to(number.device) < self.loss_probability
