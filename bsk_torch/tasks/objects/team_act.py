"""Action that tells one other imager what a satellite knows of images."""

from __future__ import annotations

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch._checks import number, whole
from bsk_torch.act.base import LONGEST, Decision, positive_duration
from bsk_torch.act.candidates import NO_TARGET, SLEW, CandidateAction
from bsk_torch.sats.bound import BoundSatellite
from bsk_torch.sim.names import one_of
from bsk_torch.tasks.objects.aim import NO_AIM, PEER
from bsk_torch.tasks.objects.fsw import CatalogRadioFSWModel
from bsk_torch.tasks.objects.radio import CatalogRadioDynModel
from bsk_torch.tasks.objects.records import RecordBook
from bsk_torch.tasks.objects.scene import RSOTargets, check_imager

LINK_MODES = ("los", "ideal")

HEADER_BYTES, RECORD_BYTES = 64, 215
"""Length of a packet without records, and of a record in it."""


class TransmitCatalog(CandidateAction):
    """Tell the k-th other imager what it does not know yet, for k from 0 to ``n_peers`` - 1; peers are sorted by their names.

    Needs ``RSOTargets(knowledge="own")``, :class:`~bsk_torch.tasks.objects.CatalogCommunication` and a satellite with
    :class:`~bsk_torch.tasks.objects.CatalogRadioDynModel` and :class:`~bsk_torch.tasks.objects.CatalogRadioFSWModel`.

    The packet holds what the satellite knows when the action begins. The instrument points at the peer. The packet is sent when
    the link has been valid without a break for ``max(min_hold_s, 8 bytes / bits_per_second)``; see
    :func:`bsk_torch.tasks.objects.radio.transmit_packet`. The action ends then, or after ``max_duration``. Another command
    drops the packet.

    ``action_mask`` excludes peers that are dead or behind the Earth, and those to whom the satellite has nothing to say:
    that is, if it knows of no capture or delivery by others than the peer that the peer has not been told of.
    """

    def __init__(
        self,
        n_peers: int,
        max_duration: float = 300.0,
        min_hold_s: float = 10.0,
        bits_per_second: float = 64e3,
        link_mode: str = "los",
        name: str = "transmit",
    ) -> None:
        """Provide ``n_peers`` actions.

        Args:
            n_peers: Number of other imagers.
            max_duration: Time until the action ends, s.
            min_hold_s: Least time for which a link must be valid, s.
            bits_per_second: Data rate, bit/s.
            link_mode: ``"los"``, or ``"ideal"`` for links that the Earth does not block.
            name: Name in ``action_description``.
        """
        super().__init__(name)
        self.n_actions = whole("n_peers", n_peers, 1)
        self.max_duration = positive_duration("max_duration", max_duration, name, LONGEST)
        self.min_hold_s = number("min_hold_s", min_hold_s, 0.0, 1e9, unit="s")
        self.bits_per_second = number("bits_per_second", bits_per_second, 0.0, unit="bit/s", above=True)
        self.link_mode = one_of("link_mode", link_mode, LINK_MODES)

    def link_satellite(self, satellite: BoundSatellite) -> None:
        """See :meth:`Action.link_satellite`; ValueError unless it is an imager with a radio."""
        super().link_satellite(satellite)
        check_imager(satellite, f"TransmitCatalog {self.name!r}")
        kinds = satellite.dyn_type, satellite.fsw_type
        if not (issubclass(kinds[0], CatalogRadioDynModel) and issubclass(kinds[1], CatalogRadioFSWModel)):
            raise ValueError(
                f"TransmitCatalog {self.name!r} needs CatalogRadioDynModel and CatalogRadioFSWModel; "
                f"{satellite.name!r} has {kinds[0].__name__} and {kinds[1].__name__}"
            )
        if PEER in satellite.simulator.memory:
            raise ValueError(f"{satellite.name!r} has two actions TransmitCatalog; one of them names all peers")
        satellite.simulator.memory.declare(PEER, NO_AIM, low=NO_AIM)

    @property
    def _scenario(self) -> RSOTargets:
        scenario: RSOTargets = self.satellite.scenario
        return scenario

    @property
    def _records(self) -> RecordBook:
        return self._scenario.records

    @override
    def candidates(self) -> tuple[Tensor, Tensor]:
        scenario = self._scenario
        peers = scenario.peers.expand(scenario.fleet.num_envs, -1, -1)
        may_hear = (self._records.news() > 0).any(1) & scenario.imagers_alive.unsqueeze(1)
        may_hear = may_hear & scenario.linked if self.link_mode == "los" else may_hear
        peer, exists = (scenario.of_imagers(self.satellite, part) for part in (peers, may_hear.gather(2, peers)))
        return scenario.n_targets + peer, exists

    @override
    def decide(self, index: Tensor, mask: Tensor, action: Tensor, previous: Tensor) -> Decision:
        simulator = self.satellite.simulator
        place, may = self.chosen(index)
        duration = torch.full_like(simulator.sim_time, self.max_duration)
        mode = torch.full_like(place, simulator.mode_names.index("transmit_rso"))
        key = torch.where(may, self.keys(place), NO_TARGET)
        return Decision(mode, may, duration, key, duration.clamp(max=SLEW + self.min_hold_s))

    def begin(self, mask: Tensor, decision: Decision) -> None:
        """See :meth:`Action.begin`: make the packet, and set the target of the pointing guidance."""
        satellite, scenario, records = self.satellite, self._scenario, self._records
        simulator, mask = satellite.simulator, mask & (decision.key != NO_TARGET)
        place = self.keys(decision.key)
        simulator.memory[PEER] = torch.where(mask, place, simulator.memory[PEER])
        receiver = (place - scenario.n_targets).clamp(0, records.sensors - 1)
        begins = scenario.by_imager(satellite, mask, False)
        records.begin_packets(begins, scenario.by_imager(satellite, receiver, 0))
        length = HEADER_BYTES + RECORD_BYTES * scenario.of_imagers(satellite, (records.packet > 0).sum(1).double())
        simulator.write("radio_hold", mask, (8.0 * length / self.bits_per_second).clamp(min=self.min_hold_s))
        simulator.write("radio_sees_all", mask, torch.full_like(length, float(self.link_mode == "ideal")))

    def end(self, mask: Tensor, decision: Decision, event: Tensor) -> None:
        """See :meth:`Action.end`: hand packets that have been sent over to the communicator."""
        ready = self._scenario.by_imager(self.satellite, mask & event, False)
        self._records.queue_packets(ready, self._scenario.fleet.sim_time)
