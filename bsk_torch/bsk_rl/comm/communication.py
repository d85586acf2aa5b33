"""Communication methods, which select the satellites that exchange data; counterpart of ``bsk_rl.comm.communication``."""

from __future__ import annotations

import logging
from abc import ABC, abstractmethod
from collections.abc import Sequence
from copy import copy
from itertools import permutations
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from typing_extensions import override

from bsk_torch.bsk_rl.utils.functional import Resetable
from bsk_torch.sim.dyn import LOSCommDynModel

if TYPE_CHECKING:
    from bsk_torch.bsk_rl.sats.satellite import Satellite


logger = logging.getLogger(__name__)

Pairs = list[tuple[Any, Any]]
"""Satellites that tell, and satellites that are told."""


class CommunicationMethod(ABC, Resetable):
    """Base of communication; subclasses define :meth:`communication_pairs`.

    Attributes:
        satellites: Satellites of the environment.
        last_communication_time: Time of the last one, s.
    """

    satellites: list[Satellite]

    def __init__(self, min_period: float = 0.0) -> None:
        """Communicate after steps, but not less than ``min_period`` s after the last communication."""
        self.min_period = min_period

    def reset_overwrite_previous(self) -> None:
        """Forget the last episode."""
        self.last_communication_time = 0.0

    def link_satellites(self, satellites: list[Satellite]) -> None:
        """Store the satellites of the environment."""
        self.satellites = satellites

    @abstractmethod
    def communication_pairs(self) -> Pairs:
        """Return pairs of sending and receiving satellites after a step."""

    def communicate(self) -> None:
        """Exchange data between satellites, unless the last communication was less than ``min_period`` ago.

        If there are as many pairs as between all satellites, all exchange data, regardless of which the pairs are.
        """
        now = self.satellites[0].simulator.sim_time
        if now - self.last_communication_time < self.min_period:
            return
        pairs = self.communication_pairs()
        if pairs:
            logger.info("Communicating data in %d direction%s.", len(pairs), "s" if len(pairs) > 1 else "")
        if len(pairs) == len(self.satellites) * (len(self.satellites) - 1):
            logger.info("Optimizing data communication between all pairs of satellites")
        exchange(self.satellites, pairs)
        self.last_communication_time = now


def exchange(satellites: Sequence[Any], pairs: Pairs) -> None:
    """Exchange data between pairs; where there are as many as between all satellites, every satellite gets the data of all."""
    if len(pairs) != len(satellites) * (len(satellites) - 1):
        for sender, receiver in pairs:
            receiver.data_store.stage_communicated_data(sender.data_store.data)
        for satellite in satellites:
            satellite.data_store.update_with_communicated_data()
        return
    total = type(satellites[0].data_store.data)()
    for satellite in satellites:
        total += satellite.data_store.data
    for satellite in satellites:
        satellite.data_store.data = copy(total)
        if hasattr(satellite.data_store, "pass_data"):
            satellite.data_store.pass_data()


class NoCommunication(CommunicationMethod):
    """Satellites do not communicate."""

    @override
    def communication_pairs(self) -> Pairs:
        return []


class FreeCommunication(CommunicationMethod):
    """All satellites exchange data with all others."""

    @override
    def communication_pairs(self) -> Pairs:
        return list(permutations(self.satellites, 2))


class LOSCommunication(CommunicationMethod):
    """Satellites exchange data if they had a line of sight to each other, not blocked by the Earth, at any time in the step."""

    _cleared: float

    def link_satellites(self, satellites: list[Satellite]) -> None:
        """Keep the satellites; TypeError for those without lines of sight."""
        super().link_satellites(satellites)
        for satellite in satellites:
            if not issubclass(satellite.dyn_type, LOSCommDynModel):
                raise TypeError(
                    f"{satellite.name} has dynamics model {satellite.dyn_type.__name__}, without lines of sight; "
                    "write dyn_type = (..., dyn.LOSCommDynModel)"
                )

    def reset_post_sim_init(self) -> None:
        """See :meth:`CommunicationMethod.reset_post_sim_init`; logs are empty."""
        super().reset_post_sim_init()
        self._cleared = 0.0

    @property
    def los_logs(self) -> dict[object, dict[object, SimpleNamespace]]:
        """Logs of the current step by sensor and other satellite; empty after :meth:`communicate`, as in bsk_rl.

        Their ``hasAccess`` is 1 in ticks with a line of sight and 0 in others, [T].
        """
        simulator = self.satellites[0].simulator
        sights = simulator.recorded_sights()[: 0 if simulator.sim_time == self._cleared else None]
        numbered = list(enumerate(self.satellites))
        logs = [[SimpleNamespace(hasAccess=access) for access in row] for row in sights.transpose(1, 2, 0).astype(int)]
        return {one: {other: logs[i][j] for j, other in numbered if j != i} for i, one in numbered}

    def communication_pairs(self) -> Pairs:
        """See :meth:`CommunicationMethod.communication_pairs`; as in bsk_rl, both directions are listed for each sensor."""
        visible = self.satellites[0].simulator.visible_pairs()
        pairs = []
        for (i, one), (j, other) in permutations(enumerate(self.satellites), 2):
            if (i, j) in visible:
                pairs += [(one, other), (other, one)]
        return pairs

    def communicate(self) -> None:
        """See :meth:`CommunicationMethod.communicate`; logs are empty afterwards."""
        super().communicate()
        self._cleared = self.satellites[0].simulator.sim_time


class MultiDegreeCommunication(CommunicationMethod):
    """Composed with another method, whose pairs are links of chains: satellites that a chain joins tell one another."""

    @override
    def communication_pairs(self) -> Pairs:
        groups = {satellite.name: {satellite.name} for satellite in self.satellites}
        for one, other in super().communication_pairs():  # type: ignore[safe-super]
            joined = groups[one.name] | groups[other.name]
            for name in joined:
                groups[name] = joined
        distinct = {id(group): group for group in groups.values()}.values()
        members = [[satellite for satellite in self.satellites if satellite.name in group] for group in distinct]
        return [pair for group in members for pair in permutations(group, 2)]


class LOSMultiCommunication(MultiDegreeCommunication, LOSCommunication):
    """Satellites that a chain of lines of sight joins tell one another."""


class BroadcastCommunication(CommunicationMethod):
    """Composed with another method: of its pairs, those communicate whose sender has chosen ``act.Broadcast``."""

    @override
    def communication_pairs(self) -> Pairs:
        actions = {
            satellite.name: [act for act in satellite.action_builder.action_spec if hasattr(act, "broadcast_pending")]
            for satellite in self.satellites
        }
        senders = {name for name, acts in actions.items() if any(act.broadcast_pending for act in acts)}
        pairs = [(one, other) for one, other in super().communication_pairs() if one.name in senders]  # type: ignore[safe-super]
        for name in senders:
            for act in actions[name]:
                act.broadcast_pending = False
        return pairs
