"""Rewarders of one episode, run for each episode of a batch."""

from __future__ import annotations

import copy
import functools
from typing import TYPE_CHECKING

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch.bsk_rl.data.base import GlobalReward as OneReward
from bsk_torch.bsk_rl.per_episode.records import Record, RecordTable, SingleScenario, StoringSatellite
from bsk_torch.bsk_rl.per_episode.views import satellites_of
from bsk_torch.data.base import GlobalReward, Log
from bsk_torch.sats.bound_access import BoundAccessSatellite

if TYPE_CHECKING:
    from bsk_torch.sats.bound import SatelliteFleet
    from bsk_torch.scene.base import Scenario


class PerEpisodeReward(GlobalReward):
    """Runs a deep copy of a rewarder of one episode for each episode, with separate stores for each."""

    records: RecordTable

    def __init__(self, rewarder: OneReward) -> None:
        self.original = rewarder

    @override
    def link(self, scenario: Scenario, fleet: SatelliteFleet) -> None:
        super().link(scenario, fleet)
        self.records = RecordTable(fleet.num_envs, fleet.device, self._begin)
        self.memory.add("records", self.records)
        for part in fleet.satellites:
            if isinstance(part, BoundAccessSatellite):
                for kind in part.opportunity_types:
                    part.add_access_filter(functools.partial(self._allowed, part, kind), kind)

    # -- records ------------------------------------------------------------------------------------------------------

    def _begin(self, env: int) -> Record:
        satellites = [StoringSatellite(one) for one in satellites_of(self.fleet, env)]
        record = Record(copy.deepcopy(self.original), satellites, SingleScenario(self.scenario, env, satellites))
        record.begin()
        return record

    def _all(self) -> list[Record]:
        return [self.records.of(env) for env in range(self.fleet.num_envs)]

    def _allowed(self, satellite: BoundAccessSatellite, kind: str) -> Tensor:
        """Return the places of a type that the filters of each satellite leave, [N * count, P] bool."""
        columns = self.fleet.columns[satellite.type_index].tolist()
        rows = [record.satellites[column] for record in self._all() for column in columns]
        allowed = torch.ones(len(rows), satellite.places(kind), dtype=torch.bool)
        for places, one in zip(allowed, rows, strict=True):
            one.hide(kind, places)
        return allowed.to(self.fleet.device)

    # -- hooks --------------------------------------------------------------------------------------------------------

    def read_log(self) -> Log:
        """See :meth:`GlobalReward.read_log`; stores keep their own."""
        self._all()  # episodes that begin read their first log now
        return {}

    def calculate_reward(self, before: Log, after: Log) -> Tensor:
        """See :meth:`GlobalReward.calculate_reward`; TypeError unless every satellite has a number."""
        reward = torch.zeros(self.fleet.num_envs, self.fleet.size, dtype=torch.float64)
        names = self.fleet.names
        for env in torch.nonzero(self.fleet.ticks > self.fleet.since).squeeze(-1).tolist():
            paid = self.records.of(env).step()
            for k, name in enumerate(names):
                try:
                    reward[env, k] = float(paid[name])
                except (KeyError, TypeError, ValueError) as error:
                    raise TypeError(
                        f"{type(self.original).__name__}.calculate_reward(new_data_dict) returns {paid!r}; it must return a "
                        f"number for each of {names}"
                    ) from error
        return reward.to(self.fleet.device)

    @override
    def share(self, links: Tensor) -> None:
        for env in torch.nonzero(links.flatten(1).any(1)).squeeze(-1).tolist():
            self.records.of(env).share(links[env].tolist())

    @override
    def is_terminated(self) -> Tensor:
        return self._flags("is_terminated")

    @override
    def is_truncated(self) -> Tensor:
        return self._flags("is_truncated")

    def _flags(self, hook: str) -> Tensor:
        flags = [[bool(getattr(r.rewarder, hook)(satellite)) for satellite in r.satellites] for r in self._all()]
        return torch.tensor(flags, device=self.fleet.device)

    # -- reading ------------------------------------------------------------------------------------------------------

    def store_of(self, part: int) -> list[object]:
        """Return the stores of the satellites of type number ``part``, a list of N * count; it is their ``data_store``."""
        columns = self.fleet.columns[part].tolist()
        return [record.satellites[column].data_store for record in self._all() for column in columns]
