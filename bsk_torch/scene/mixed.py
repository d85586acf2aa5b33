"""Several scenarios in one environment, each for some of its satellites."""

from __future__ import annotations

import copy
from collections.abc import Collection, Hashable, Iterable, Mapping, Sequence
from typing import Any, TypeVar

from torch import Tensor
from typing_extensions import override

from bsk_torch.rand import Key
from bsk_torch.sats.bound import SatelliteFleet
from bsk_torch.sats.satellite import Satellite
from bsk_torch.scene.base import Scenario
from bsk_torch.sim.names import nearest
from bsk_torch.sim.places import Places, PlaceTables

T = TypeVar("T")


def as_dictionary(title: str, value: Mapping[str, T]) -> dict[str, T]:
    """Return a dictionary with names as keys; ValueError for anything else."""
    if not isinstance(value, Mapping) or not all(isinstance(key, str) for key in value):
        raise ValueError(f"{title}={value!r} must be a dictionary with names as keys")
    return dict(value)


def names_by_key(title: str, value: Mapping[str, Collection[str]]) -> dict[str, frozenset[str]]:
    """Return lists of names as sets, by key; ValueError for anything else."""
    groups = as_dictionary(title, value)
    for key, names in groups.items():
        if isinstance(names, str) or not isinstance(names, Collection) or not all(isinstance(name, str) for name in names):
            raise ValueError(f"{title}[{key!r}]={names!r} must be a list of names of satellites, such as ['EO1']")
    return {key: frozenset(names) for key, names in groups.items()}


def check_same_keys(title: str, value: Mapping[str, object], others: Mapping[str, object], other: str) -> None:
    """Raise ValueError unless two dictionaries have the same keys."""
    if value.keys() != others.keys():
        raise ValueError(f"{title} has the keys {sorted(value)}; they must be those of {other}, {sorted(others)}")


def check_known(title: str, names: Iterable[str], satellites: Sequence[str]) -> None:
    """Raise ValueError for a name that is not among those ``satellites``."""
    for name in sorted(set(names) - set(satellites)):
        raise ValueError(f"{title} names the unknown satellite {name!r}; {nearest(name, satellites)}")


class MixedScenario(Scenario):
    """Several scenarios, each with its group of satellites; see :class:`bsk_torch.data.MixedReward`.

    Satellites see the places of the scenarios in whose group they are: targets of one scenario are hidden from satellites of the
    others. A scenario under several ids has one group, with the satellites of all of them. Attributes that only one scenario has
    can be read from the whole, such as ``priority``.

    The scenarios must draw values of different names: there can be one with targets on the ground, next to others.
    """

    def __init__(self, scenarios: Mapping[str, Scenario], satellite_mapping: Mapping[str, Sequence[str]]) -> None:
        """Combine scenarios by id, each with its satellites, including observed ones; groups may overlap."""
        self.scenarios: dict[str, Scenario] = as_dictionary("scenarios", scenarios)
        self.satellite_mapping = names_by_key("satellite_mapping", satellite_mapping)
        check_same_keys("satellite_mapping", self.satellite_mapping, self.scenarios, "scenarios")
        for key, scenario in self.scenarios.items():
            if not isinstance(scenario, Scenario):
                raise ValueError(f"scenarios[{key!r}]={scenario!r} must be a scenario, made with parentheses")
            if scenario.varies_population:
                raise ValueError(f"scenarios[{key!r}] draws which satellites are present, which concerns all scenarios")

    def __copy__(self) -> MixedScenario:
        new = type(self).__new__(type(self))
        copies = {id(scenario): copy.copy(scenario) for scenario in self.scenarios.values()}
        new.__dict__ |= self.__dict__ | {"scenarios": {key: copies[id(part)] for key, part in self.scenarios.items()}}
        return new

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(f"{type(self).__name__} has no {name!r}")
        having = [part for part in self._parts() if hasattr(part, name)]
        if len(having) != 1:
            many = "several of its scenarios have" if having else "none of its scenarios has"
            raise AttributeError(
                f"{type(self).__name__}: {many} {name!r}; read it from one of them, as in scenarios['id'].{name}"
            )
        return getattr(having[0], name)

    def _parts(self) -> list[Scenario]:
        return list({id(part): part for part in self.__dict__.get("scenarios", {}).values()}.values())

    def members(self, scenario: Scenario) -> set[str]:
        """Return the names of the satellites of one of the scenarios."""
        return {name for key, part in self.scenarios.items() if part is scenario for name in self.satellite_mapping[key]}

    def group_of(self, name: str) -> Hashable:
        """Return what differs between satellites of different scenarios, which are simulated as different types."""
        return tuple(name in self.members(part) for part in self._parts())

    @property
    def calls_user(self) -> bool:
        """See :attr:`Scenario.calls_user`; whether any scenario does."""
        return any(part.calls_user for part in self._parts())

    def draw(self, key: Key) -> dict[str, Tensor]:
        """See :meth:`Scenario.draw`; what the scenarios draw alone. ValueError for values of the same name."""
        drawn: dict[str, Tensor] = {}
        for part in self._parts():
            values = part.draw(key)
            if twice := sorted(values.keys() & drawn.keys()):
                raise ValueError(
                    f"several scenarios of {type(self).__name__} draw {twice[0]!r}, such as two with targets; put the targets of "
                    "both into one scenario"
                )
            drawn |= values
        return drawn

    def redraw(self, rows: Tensor, key: Key, time: Tensor) -> dict[str, Tensor]:
        """See :meth:`Scenario.redraw`; the values of all scenarios."""
        return {name: value for part in self._parts() for name, value in part.redraw(rows, key, time).items()}

    def place_kinds_of(self, names: Sequence[str], tables: PlaceTables) -> Mapping[str, Places]:
        """See :meth:`Scenario.place_kinds_of`; the places of the scenarios with these satellites."""
        joined = [part for part in self._parts() if not self.members(part).isdisjoint(names)]
        return {kind: places for part in joined for kind, places in part.place_kinds(tables).items()}

    def seen_by(self, names: Sequence[str]) -> Scenario:
        """See :meth:`Scenario.seen_by`; the only scenario of the satellites, or all."""
        joined = [part for part in self._parts() if not self.members(part).isdisjoint(names)]
        return joined[0] if len(joined) == 1 else self

    def _own_arguments(self, satellite: Satellite) -> dict[str, object]:
        joined = [part for part in self._parts() if satellite.name in self.members(part)]
        return {name: value for part in joined for name, value in part._own_arguments(satellite).items()}

    def validate_satellite_names(self, satellites: Sequence[Satellite]) -> None:
        """See :meth:`Scenario.validate_satellite_names`; ValueError for names in the mapping that no satellite has, too."""
        names = [satellite.name for satellite in satellites]
        for key, group in self.satellite_mapping.items():
            check_known(f"satellite_mapping[{key!r}]", group, names)
        for part in self._parts():
            members = self.members(part)
            part.validate_satellite_names([satellite for satellite in satellites if satellite.name in members])

    @override
    def link(self, fleet: SatelliteFleet) -> None:
        super().link(fleet)
        for part in self._parts():
            part.attach(fleet)

    @override
    def _bounds(self) -> dict[str, tuple[float, float]]:
        return {name: bound for part in self._parts() for name, bound in part._bounds().items()}

    def reset(self, rows: Tensor) -> None:
        """See :meth:`Scenario.reset`; of all scenarios."""
        for part in self._parts():
            part.begin_episodes(rows)

    def after_step(self, sim_time: Tensor) -> None:
        """See :meth:`Scenario.after_step`; of all scenarios."""
        for part in self._parts():
            part.finish_step(sim_time)
