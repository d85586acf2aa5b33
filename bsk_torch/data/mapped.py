"""Rewarders of one episode, such as bsk_rl's, run for each environment of a batch."""

from __future__ import annotations

import copy
import functools
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch.data.base import GlobalReward, Log
from bsk_torch.data.record import OneReward, Record, SingleScenario, StoringSatellite, check_record, classes_of
from bsk_torch.sats.bound_access import BoundAccessSatellite
from bsk_torch.sim.object_table import ObjectTable

if TYPE_CHECKING:
    from bsk_torch.sats.fleet import SatelliteFleet
    from bsk_torch.scene.base import Scenario


class PerEnvironmentReward(GlobalReward):
    """Runs a rewarder of one episode for each environment, with separate stores for each; see :func:`bsk_torch.per_environment`.

    Attributes:
        given: The rewarder of one episode; every episode begins with a deep copy of it.
        records: Rewarder and stores of each environment, part of the state.
    """

    given: OneReward
    records: ObjectTable

    def __init__(self, given: OneReward) -> None:
        """Run copies of ``given``."""
        self.given = given

    @override
    def link(self, scenario: Scenario, fleet: SatelliteFleet) -> None:
        super().link(scenario, fleet)
        self._classes = classes_of(self.given)
        dump = functools.partial(Record.dump, given=self.given, classes=self._classes)
        check = functools.partial(check_record, classes=self._classes)
        self.records = ObjectTable(fleet.num_envs, fleet.device, self._begin, dump, self._load, check)
        number = sum(name.startswith("records_") for name in self.memory.tables)
        self.memory.add(f"records_{number}", self.records)
        for part in fleet.satellites:
            if isinstance(part, BoundAccessSatellite):
                for kind in part.opportunity_types:
                    part.add_access_filter(functools.partial(self._allowed, part, kind), kind)

    # -- records ------------------------------------------------------------------------------------------------------

    def _record(self, env: int) -> Record:
        satellites: list[Any] = [None] * self.fleet.size
        for part, columns in zip(self.fleet.satellites, self.fleet.columns, strict=True):
            for number, column in enumerate(columns.tolist()):
                satellites[column] = StoringSatellite(part.one(env * len(columns) + number))
        scenario = SingleScenario(self.scenario, env, self.fleet.num_envs, satellites)
        return Record(copy.deepcopy(self.given), satellites, scenario)

    def _begin(self, env: int) -> Record:
        record = self._record(env)
        record.begin()
        return record

    def _load(self, env: int, saved: bytes) -> Record:
        record = self._record(env)
        record.load(saved, self.given, self._classes)
        return record

    def _collecting(self) -> list[int]:
        """Return the numbers of the satellites whose data count: those of the channel in a ``data.MixedReward``, else all."""
        mine = self._in_channel
        return list(range(self.fleet.size)) if mine is None else torch.nonzero(mine).squeeze(-1).tolist()

    def _all(self) -> list[Record]:
        return [self.records.of(env) for env in range(self.fleet.num_envs)]

    def _allowed(self, satellite: BoundAccessSatellite, kind: str) -> Tensor:
        """Return the places of a type that the filters of each satellite leave, [N * count, P] bool."""
        columns = self.fleet.columns[satellite.type_index].tolist()
        rows = [record.satellites[column] for record in self._all() for column in columns]
        allowed = torch.ones(len(rows), satellite.places(kind), dtype=torch.bool)
        for mine, one in zip(allowed, rows, strict=True):
            one.hide(kind, mine)
        return allowed.to(self.fleet.device)

    # -- hooks --------------------------------------------------------------------------------------------------------

    def read_log(self) -> Log:
        """See :meth:`GlobalReward.read_log`; stores keep their own."""
        self._all()  # episodes that begin read their first log now
        return {}

    def calculate_reward(self, before: Log, after: Log) -> Tensor:
        """See :meth:`GlobalReward.calculate_reward`; TypeError unless every satellite, of the channel if any, has a number."""
        reward = torch.zeros(self.fleet.num_envs, self.fleet.size, dtype=torch.float64)
        collecting = self._collecting()
        names = [self.fleet.names[k] for k in collecting]
        for env in torch.nonzero(self.fleet.ticks > self.fleet.since).squeeze(-1).tolist():
            found = self.records.of(env).step(collecting)
            for k, name in zip(collecting, names, strict=True):
                try:
                    reward[env, k] = float(found[name])
                except (KeyError, TypeError, ValueError) as error:
                    raise TypeError(
                        f"{type(self.given).__name__}.calculate_reward(new_data_dict) returns {found!r}; it must return a number "
                        f"for each of {names}"
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
        found = [[bool(getattr(r.rewarder, hook)(satellite)) for satellite in r.satellites] for r in self._all()]
        return torch.tensor(found, device=self.fleet.device)

    # -- reading ------------------------------------------------------------------------------------------------------

    def rewarder_of(self, row: int) -> Any:
        """Return the rewarder of environment ``row``."""
        return self.records.of(row).rewarder

    def data_of(self, row: int) -> Any:
        """Return all data collected in environment ``row``."""
        return self.rewarder_of(row).data

    @property
    def data(self) -> list[Any]:
        """All data that has been collected, of each environment."""
        return [record.rewarder.data for record in self._all()]

    def store_of(self, part: int) -> list[Any]:
        """Return the stores of the satellites of type number ``part``, a list of N * count; it is their ``data_store``."""
        columns = self.fleet.columns[part].tolist()
        return [record.satellites[column].data_store for record in self._all() for column in columns]

    def store_of_one(self, part: int, row: int) -> Any:
        """Return the store of the satellite of a row [N * count]."""
        env, number = divmod(row, len(self.fleet.columns[part]))
        return self.records.of(env).satellites[int(self.fleet.columns[part][number])].data_store
