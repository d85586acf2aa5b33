"""Rewarders of channels: each for some satellites, and one of several scenarios."""

from __future__ import annotations

from collections.abc import Collection, Hashable, Mapping, Sequence
from typing import Protocol, runtime_checkable

import torch
from torch import Tensor

from bsk_torch.data.base import GlobalReward, Log
from bsk_torch.data.checked import CheckedRewarder
from bsk_torch.data.composed import ComposedReward
from bsk_torch.sats.access_filter import AccessFilter
from bsk_torch.sats.bound import SatelliteFleet
from bsk_torch.scene.base import Scenario
from bsk_torch.scene.mixed import MixedScenario, as_dictionary, check_known, check_same_keys, names_by_key
from bsk_torch.sim.names import nearest


class Looking(Protocol):
    """Satellites of one type that choose among places, as user classes do, too."""

    names: tuple[str, ...]
    access_filters: list[AccessFilter]


@runtime_checkable
class Keeper(Protocol):
    """A rewarder that keeps what satellites know."""

    def store_of(self, part: int) -> object:
        """Return the knowledge of the satellites of a type."""


def check_channels(
    rewarders: Mapping[str, object],
    satellite_mapping: Mapping[str, frozenset[str]],
    scenario_mapping: Mapping[str, str] | None,
) -> None:
    """Raise ValueError for mappings with other channels than ``rewarders``, and for a rewarder under two channels."""
    check_same_keys("satellite_mapping", satellite_mapping, rewarders, "rewarders")
    if scenario_mapping is not None:
        check_same_keys("scenario_mapping", scenario_mapping, rewarders, "rewarders")
    numbers = [id(rewarder) for rewarder in rewarders.values()]
    if twice := [key for key, number in zip(rewarders, numbers, strict=True) if numbers.count(number) > 1]:
        raise ValueError(f"the channels {twice} have the same rewarder; each channel needs another one")


def check_no_ids(scenario_mapping: Mapping[str, str] | None, scenario: object) -> None:
    """Raise ValueError for ids of scenarios where there is one scenario, without an id."""
    if scenario_mapping is not None:
        raise ValueError(f"scenario_mapping needs a scene.MixedScenario; the scenario is a {type(scenario).__name__}")


def scenario_id(
    key: str, group: frozenset[str], scenario_mapping: Mapping[str, str] | None, groups: Mapping[str, Collection[str]]
) -> str:
    """Return the id of the scenario of the channel ``key``, whose satellites are ``group``; ``groups`` are those of scenarios."""
    if scenario_mapping is None:
        raise ValueError(f"scenario_mapping is missing; give each channel one of the scenarios {sorted(groups)}")
    chosen = scenario_mapping[key]
    if not isinstance(chosen, str) or chosen not in groups:
        raise ValueError(f"scenario_mapping[{key!r}] is the unknown {chosen!r}; {nearest(str(chosen), groups)}")
    if outside := sorted(group - set(groups[chosen])):
        raise ValueError(f"satellite_mapping[{key!r}] has {outside}, which do not take part in the scenario {chosen!r}")
    return chosen


class MixedReward(ComposedReward):
    """Rewarders of channels, each for some satellites and one scenario; a satellite gets the sum over its channels.

    A satellite outside of a channel collects no data in it: its images do not count there, targets are not hidden from it, and
    the channel neither pays it nor ends its episode. It passes on what it is told of the channel. A custom rewarder that pays
    satellites whether or not they collect data returns ``self.of_channel(reward)``.

    Attributes:
        terms: Reward of each channel for the last step, [N, S] each.
    """

    def __init__(
        self,
        rewarders: Mapping[str, GlobalReward],
        satellite_mapping: Mapping[str, Sequence[str]],
        scenario_mapping: Mapping[str, str] | None = None,
    ) -> None:
        """Combine rewarders.

        Args:
            rewarders: Rewarder of each channel.
            satellite_mapping: Names of the satellites that collect the data of each channel; some may collect none.
            scenario_mapping: Id of the scenario of each channel in a :class:`bsk_torch.scene.MixedScenario`; None with other
                scenarios.
        """
        rewarders = as_dictionary("rewarders", rewarders)
        super().__init__(*rewarders.values())
        self._keys = tuple(rewarders)
        self.satellite_mapping = names_by_key("satellite_mapping", satellite_mapping)
        self.scenario_mapping = None if scenario_mapping is None else as_dictionary("scenario_mapping", scenario_mapping)
        check_channels(rewarders, self.satellite_mapping, self.scenario_mapping)

    @property
    def channels(self) -> dict[str, GlobalReward]:
        """Rewarder of each channel."""
        return dict(zip(self._keys, self.rewarders, strict=True))

    @property
    def names(self) -> list[str]:
        """Name of each term: its channel."""
        return list(self._keys)

    def group_of(self, name: str) -> Hashable:
        """Return what differs between satellites of different channels, which are simulated as different types."""
        return tuple(name in self.satellite_mapping[key] for key in self._keys)

    def link(self, scenario: Scenario, fleet: SatelliteFleet) -> None:
        """See :meth:`GlobalReward.link`; ValueError for names and scenarios that do not fit, and for missing observers."""
        GlobalReward.link(self, scenario, fleet)
        for key, group in self.satellite_mapping.items():
            check_known(f"satellite_mapping[{key!r}]", group, list(fleet.places))
        looking: list[Looking] = [part for part in fleet.satellites if hasattr(part, "access_filters")]
        groups = self.satellite_mapping
        members = {key: torch.tensor([name in groups[key] for name in fleet.names], device=fleet.device) for key in self._keys}
        self.checked = tuple(map(CheckedRewarder, self.rewarders))
        for key, part in zip(self._keys, self.checked, strict=True):
            before = [list(satellites.access_filters) for satellites in looking]
            part.rewarder._in_channel = members[key]
            part.link(self._scenario_of(key, scenario), fleet)
            self._check_observers(key, part.rewarder, fleet)
            for satellites, filters in zip(looking, before, strict=True):
                if self.satellite_mapping[key].isdisjoint(satellites.names):
                    satellites.access_filters = filters
        self._mine = torch.stack(list(members.values())).unsqueeze(1)

    def _scenario_of(self, key: str, scenario: Scenario) -> Scenario:
        if not isinstance(scenario, MixedScenario):
            check_no_ids(self.scenario_mapping, scenario)
            return scenario
        chosen = scenario_id(key, self.satellite_mapping[key], self.scenario_mapping, scenario.satellite_mapping)
        return scenario.scenarios[chosen]

    def _check_observers(self, key: str, rewarder: GlobalReward, fleet: SatelliteFleet) -> None:
        """Raise ValueError if a satellite whose flight counts for a rewarder is not in its channel."""
        if outside := sorted({fleet.names[column] for column in rewarder.observed_columns} - self.satellite_mapping[key]):
            raise ValueError(
                f"satellite_mapping[{key!r}] lacks {outside}, whose flights count for {type(rewarder).__name__}; add them"
            )

    def store_of(self, part: int) -> object:
        """Return the knowledge of the satellites of type number ``part``; AttributeError unless one of their channels has any."""
        names = self.fleet.satellites[part].names
        keepers = {key: channel for key, channel in self.channels.items() if isinstance(channel, Keeper)}
        keys = [key for key in keepers if not self.satellite_mapping[key].isdisjoint(names)]
        if len(keys) != 1:
            raise AttributeError(
                f"{names[0]} has data in the channels {keys}; read them from the rewarder of one, as in "
                "env.rewarder.channels['id'].known"
            )
        return keepers[keys[0]].store_of(part)

    def calculate_reward(self, before: Log, after: Log) -> Tensor:
        """See :meth:`GlobalReward.calculate_reward`; to a channel, the logs of other satellites do not change."""
        for k, (key, part) in enumerate(zip(self._keys, self.checked, strict=True)):
            prefix, members = f"{k}.", self._mine[k]
            old, new = ({n.removeprefix(prefix): v for n, v in log.items() if n.startswith(prefix)} for log in (before, after))
            own_log = {n: torch.where(members.view(1, -1, *[1] * (v.ndim - 2)), v, old[n]) for n, v in new.items()}
            self.terms[key] = part.reward(old, own_log)
        each = torch.stack(list(self.terms.values()))
        moved = (self.fleet.ticks > self.fleet.since).unsqueeze(1)
        outside = ~self._mine & moved & (each != 0.0)
        if bool(outside.any()):
            k, env, column = torch.nonzero(outside)[0].tolist()
            key, name = self._keys[k], self.fleet.names[column]
            raise ValueError(
                f"the rewarder of channel {key!r}, {type(self.rewarders[k]).__name__}, pays {float(each[k, env, column]):g} to "
                f"{name!r} in environment {env}, which is not one of its satellites; add it to satellite_mapping[{key!r}], or "
                "return self.of_channel(reward) from calculate_reward"
            )
        return each.sum(0)

    def is_terminated(self) -> Tensor:
        """See :meth:`GlobalReward.is_terminated`; by the channels of each satellite."""
        return (torch.stack([part.terminated() for part in self.checked]) & self._mine).any(0)

    def is_truncated(self) -> Tensor:
        """See :meth:`GlobalReward.is_truncated`; by the channels of each satellite."""
        return (torch.stack([part.truncated() for part in self.checked]) & self._mine).any(0)
