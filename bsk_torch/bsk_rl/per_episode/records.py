"""What a rewarder of one episode keeps of its episode, for every episode of a batch."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from typing_extensions import override

from bsk_torch.bsk_rl.comm.communication import exchange
from bsk_torch.bsk_rl.data.base import GlobalReward
from bsk_torch.bsk_rl.data.unique_image_data import HideImaged
from bsk_torch.bsk_rl.per_episode.views import OneAccessSatellite, OneSatellite, OneView
from bsk_torch.sim.places import is_target
from bsk_torch.sim.state import StateTable

Filter = Callable[[Mapping[str, Any]], object]


class StoringSatellite:
    """One satellite of one episode, read as :class:`OneSatellite`, to which attributes can be added.

    ``data_store`` is one of them. Filters that are added hide opportunities of this satellite in this episode.
    """

    def __init__(self, one: OneSatellite) -> None:
        self.__dict__.update(_one=one, _filters=[])

    _one: OneSatellite
    _filters: list[Filter]

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return getattr(self.__dict__["_one"], name)

    def __repr__(self) -> str:
        return f"<{self._one.name} of environment {self._one.env}>"

    def add_access_filter(self, access_filter: Filter, types: str | Collection[str] | None = None) -> None:
        """Hide opportunities of this satellite for which ``access_filter(opportunity)`` is false."""
        kinds = (types,) if isinstance(types, str) else types
        self._filters.append(
            access_filter if kinds is None else lambda opportunity: opportunity["type"] not in kinds or access_filter(opportunity)
        )

    def hide(self, kind: str, allowed: Tensor) -> None:
        """Set the places of a type that a filter hides to False in ``allowed`` [P]."""
        others = [keep for keep in self._filters if not isinstance(keep, HideImaged)]
        if is_target(kind):
            for keep in self._filters:
                if isinstance(keep, HideImaged):
                    for target in keep.store.data.imaged:
                        allowed[target._place[1]] = False
        if others:
            assert isinstance(self._one, OneAccessSatellite)
            for place, opportunity in enumerate(self._one.all_places(kind)):
                if not all(keep(opportunity) for keep in others):
                    allowed[place] = False


class SingleScenario(OneView):
    """The scenario in one episode, as rewarders of one episode read it."""

    def __init__(self, whole: object, env: int, satellites: list[StoringSatellite]) -> None:
        super().__init__(whole, env)
        self.__dict__["satellites"] = satellites

    satellites: list[StoringSatellite]

    @property
    def targets(self) -> list[Any]:
        """The targets."""
        return self._whole.target_objects(self._row)


class Record:
    """Copy of the user's rewarder, and the satellites with their stores, of one episode; ``steps`` have been scored."""

    def __init__(self, rewarder: GlobalReward, satellites: list[StoringSatellite], scenario: SingleScenario) -> None:
        self.rewarder, self.satellites, self.scenario, self.steps = rewarder, satellites, scenario, 0

    def begin(self) -> None:
        """Start the episode, in the order of one environment."""
        rewarder = self.rewarder
        rewarder.link_scenario(self.scenario)  # type: ignore[arg-type]  # mypy: a view of the scenario
        rewarder.reset_overwrite_previous()
        rewarder.reset_pre_sim_init()
        for satellite in self.satellites:
            rewarder.create_data_store(satellite)
            rewarder.data += satellite.data_store.data
        rewarder.reset_during_sim_init()
        rewarder.reset_post_sim_init()
        for satellite in self.satellites:
            satellite.data_store.update_from_logs()

    def step(self) -> dict[str, float]:
        """Let the stores of the satellites read their logs; return the rewards by name."""
        self.steps += 1
        return self.rewarder.reward({satellite.name: satellite.data_store.update_from_logs() for satellite in self.satellites})

    def share(self, links: list[list[bool]]) -> None:
        """Spread data along ``links`` by sender and receiver; where all are linked with all, they get the sum."""
        sides = list(enumerate(self.satellites))
        exchange(self.satellites, [(one, other) for a, one in sides for b, other in sides if a != b and links[a][b]])


class RecordTable(StateTable):
    """A record for each episode of a batch, as part of its state; made when it is first asked for.

    Records that have scored a step are objects of the user's, which are neither copied nor saved.
    """

    def __init__(self, num_envs: int, device: torch.device, make: Callable[[int], Record]) -> None:
        """Prepare for ``num_envs`` records; ``make`` returns that of an episode which begins, by its number."""
        super().__init__(num_envs, 1, device)
        self.make = make
        self.entries: list[Record | None] = [None] * num_envs

    def of(self, env: int) -> Record:
        """Return the record of episode ``env``."""
        entry = self.entries[env]
        if entry is None:
            entry = self.entries[env] = self.make(env)
        return entry

    def _check_unscored(self, envs: Tensor) -> None:
        if begun := [entry for env in envs.tolist() if (entry := self.entries[env]) is not None and entry.steps]:
            raise TypeError(
                f"{type(begun[0].rewarder).__name__} is a rewarder of one episode, which keeps objects: its episodes cannot be "
                "copied and saved. A rewarder of bsk_torch.data, which keeps tensors in fleet.memory, has episodes that can"
            )

    @override
    def reset(self, envs: Tensor) -> None:
        for env in envs.tolist():
            self.entries[env] = None
        self.touch()

    @override
    def copy_rows(self, envs: Tensor, other: StateTable, source: Tensor) -> None:
        assert isinstance(other, RecordTable)
        other._check_unscored(source)
        self.reset(envs)

    @override
    def _gathered(self, envs: Tensor) -> dict[str, object]:
        self._check_unscored(envs)
        return {}

    @override
    def to_tensordict(self) -> TensorDict:
        return TensorDict(self._gathered(torch.arange(self.num_envs)), [self.num_envs], device=self.device)

    @override
    def over(self, saved: Mapping[str, object] | TensorDictBase) -> RecordTable:
        other = super().over(saved)
        other.entries = [None] * other.num_envs
        return other
