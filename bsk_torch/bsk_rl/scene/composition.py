"""Several scenarios in one environment; counterpart of ``bsk_rl.scene.composition``."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

from typing_extensions import override

from bsk_torch.bsk_rl.scene.scenario import Scenario
from bsk_torch.bsk_rl.utils.functional import ResetableGroup
from bsk_torch.scene.mixed import as_dictionary, check_known, check_same_keys, names_by_key

if TYPE_CHECKING:
    from bsk_torch.bsk_rl.sats.satellite import Satellite


class MixedScenario(ResetableGroup, Scenario):
    """Several scenarios, each with its own group of satellites; see :class:`bsk_torch.bsk_rl.data.MixedReward`.

    A scenario gets every call once, with the satellites of its group: targets are registered with these only. A scenario under
    several ids has one group, with the satellites of all of them.
    """

    def __init__(self, scenarios: Mapping[str, Scenario], satellite_mapping: Mapping[str, Sequence[str]]) -> None:
        """Combine scenarios.

        Args:
            scenarios: Scenarios by id.
            satellite_mapping: Names of the satellites that take part in each, including those that are observed. Groups may
                overlap.

        Raises:
            ValueError: For other ids in the mapping than in the scenarios, and values that are not lists of names.
        """
        self.scenarios: dict[str, Scenario] = as_dictionary("scenarios", scenarios)
        self.satellite_mapping = names_by_key("satellite_mapping", satellite_mapping)
        check_same_keys("satellite_mapping", self.satellite_mapping, self.scenarios, "scenarios")

    def _groups(self) -> Iterator[tuple[Scenario, set[str]]]:
        for scenario in {id(scenario): scenario for scenario in self.scenarios.values()}.values():
            keys = [key for key, other in self.scenarios.items() if other is scenario]
            yield scenario, set().union(*(self.satellite_mapping[key] for key in keys))

    @override
    def _parts(self) -> list[Scenario]:
        return [scenario for scenario, _ in self._groups()]

    def validate_satellite_names(self, satellites: list[Satellite]) -> None:
        """Raise ValueError for repeated names, and for names in the mapping that no satellite has."""
        names = [satellite.name for satellite in satellites]
        if twice := sorted({name for name in names if names.count(name) > 1}):
            raise ValueError(f"satellites has several called {twice}; MixedScenario needs unique names")
        for scenario, group in self._groups():
            check_known("satellite_mapping", group, names)
            scenario.validate_satellite_names([satellite for satellite in satellites if satellite.name in group])

    def link_satellites(self, satellites: list[Satellite]) -> None:
        """Give each scenario the satellites of its group."""
        self.validate_satellite_names(satellites)
        super().link_satellites(satellites)
        for scenario, group in self._groups():
            scenario.link_satellites([satellite for satellite in satellites if satellite.name in group])

    def after_step(self, sim_time: float) -> None:
        """See :meth:`Scenario.after_step`; of all scenarios."""
        for scenario in self._parts():
            scenario.after_step(sim_time)

    @override
    def reset_pre_sim_init(self) -> None:
        for scenario in self._parts():
            scenario.utc_init = self.utc_init
        super().reset_pre_sim_init()
