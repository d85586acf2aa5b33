"""The satellite: a list of observations, a list of actions, and the models that simulate it."""

from __future__ import annotations

import copy
import keyword
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import torch
from torch import Tensor

from bsk_torch.act.base import Action, ActionBuilder
from bsk_torch.obs.base import Observation, ObservationBuilder
from bsk_torch.sim.component import Component
from bsk_torch.sim.dyn.models import BasicDynamicsModel, DynamicsModel
from bsk_torch.sim.fsw.models import BasicFSWModel, FSWModel
from bsk_torch.sim.queries import next_eclipse
from bsk_torch.sim.simulator import Simulator

OBS_TYPES = (torch.Tensor, dict)


class ArgumentTable(dict[str, Any]):
    """Default arguments by name, shown as a table with unit and meaning."""

    def __init__(self, components: Sequence[Component]) -> None:
        """Collect the arguments of ``components``."""
        self.rows = {arg.name: arg for component in components for arg in component.args}
        super().__init__({name: arg.default for name, arg in self.rows.items()})

    def __repr__(self) -> str:
        """One line for each argument."""
        lines = [(arg.name, _short(arg.default), arg.unit, arg.doc) for arg in self.rows.values()]
        widths = [max(len(line[k]) for line in lines) for k in range(3)]
        return "\n".join("  ".join((*(text.ljust(w) for text, w in zip(line, widths, strict=False)), line[3])) for line in lines)


def _short(value: Any) -> str:
    if isinstance(value, tuple) and value and isinstance(value[0], dict):
        return f"{len(value)} stations"
    return f"{value:g}" if isinstance(value, float) else str(value)


class _Arguments(dict[str, Any]):
    """Drawn arguments, a tensor with leading dimension N each; a wrong name is answered with the nearest right one."""

    def __missing__(self, name: str) -> Any:
        from bsk_torch.sim.params import nearest

        raise KeyError(f"sat_args has no {name!r}; {nearest(name, self)}")


class Satellite:
    """An agent. Subclasses set ``observation_spec``, ``action_spec``, ``dyn_type`` and ``fsw_type``."""

    observation_spec: ClassVar[Sequence[Observation]] = ()
    action_spec: ClassVar[Sequence[Action]] = ()
    dyn_type: ClassVar[type[DynamicsModel]] = BasicDynamicsModel
    fsw_type: ClassVar[type[FSWModel]] = BasicFSWModel
    opportunity_types: tuple[str, ...] = ()

    def __init__(
        self,
        name: str,
        sat_args: Mapping[str, Any] | None = None,
        *,
        obs_type: type = torch.Tensor,
        variable_interval: bool = True,
    ) -> None:
        """Describe a satellite; an environment makes its own copy and simulates that.

        Args:
            name: A Python identifier.
            sat_args: Arguments of the models that differ from :meth:`default_sat_args`: constants, distributions of
                :mod:`bsk_torch.rand`, or callables without arguments.
            obs_type: ``torch.Tensor`` for one vector, ``dict`` for named observations.
            variable_interval: Whether the end of an action ends the step; else steps last ``max_step_duration``.
        """
        if not name.isidentifier() or keyword.iskeyword(name):
            raise ValueError(f"name={name!r} must be a Python identifier, such as 'Scanner1'")
        if obs_type not in OBS_TYPES:
            raise ValueError(f"obs_type={obs_type!r} must be torch.Tensor or dict")
        self.name, self.obs_type, self.variable_interval = name, obs_type, variable_interval
        self.sat_args_generator = dict(sat_args or {})

    @classmethod
    def default_sat_args(cls) -> ArgumentTable:
        """Every argument that ``sat_args`` accepts, with its default."""
        return ArgumentTable((*cls.dyn_type.all_components(), *cls.fsw_type.all_components()))

    # -- in an environment --------------------------------------------------------------------------------------------

    def generation(self, limit: Tensor) -> Tensor:
        """Seconds for which access windows are generated at reset, given time limits [n]; none here."""
        return torch.zeros_like(limit)

    @property
    def segment(self) -> float:
        """Seconds by which access windows are extended."""
        return 600.0

    def bind(self, simulator: Simulator, time_limit: Tensor, names: Sequence[str] = ()) -> Satellite:
        """A copy that stands for all satellites of its type in ``simulator``.

        Args:
            simulator: Where they live, N of them.
            time_limit: Time limits of their episodes, [N] s (read, never written).
            names: Their names; the satellite's own unless given.
        """
        bound = copy.copy(self)
        bound.simulator, bound.time_limit, bound.names = simulator, time_limit, tuple(names) or (self.name,)
        bound.dynamics, bound.fsw = self.dyn_type(simulator), self.fsw_type(simulator)
        bound.dynamics.satellite = bound.fsw.satellite = bound
        bound.equip()
        bound.actions = ActionBuilder(copy.deepcopy(list(self.action_spec)), bound)
        bound.observations = ObservationBuilder(copy.deepcopy(list(self.observation_spec)), bound)
        simulator.observer.want((*bound.observations.observables, *bound.dynamics.vitals(), *bound.fsw.vitals()))
        return bound

    def equip(self) -> None:
        """Called on the copy that lives in an environment, before its actions and observations are linked."""

    def note_events(self, event: Tensor) -> None:
        """Called after a run; ``event`` [N] where something happened that ends the actions which wait for it."""

    def legal_actions(self) -> Tensor | None:
        """Which actions are legal now beside what the actions themselves say, [N, n_actions]; None for all of them."""
        return None

    def action_mask(self) -> Tensor:
        """Which actions are legal now, [N, n_actions]; where none would be, all of them are."""
        mask, legal = self.actions.mask(), self.legal_actions()
        mask = mask if legal is None else mask & legal
        return mask | ~mask.any(1, keepdim=True)

    def counts(self) -> dict[str, Tensor]:
        """What an environment counts for the satellite in each episode, [N] each, by name."""
        return {}

    def title(self, row: int) -> str:
        """What errors call the satellite of a row [N]."""
        env, k = divmod(row, len(self.names))
        return f"environment {env}" if len(self.names) == 1 else f"satellite {self.names[k]} of environment {env}"

    absent: Tensor | None = None
    """Satellites that have left their episodes, [N], if any can: queries look for nothing on their behalf."""

    simulator: Simulator
    names: tuple[str, ...]
    scenario: Any
    time_limit: Tensor
    dynamics: Any
    fsw: Any
    actions: ActionBuilder
    observations: ObservationBuilder
    observation_description: list[str]
    """Name of every entry of the observation vector; known once an environment has been built."""

    @property
    def sat_args(self) -> dict[str, Any]:
        """Arguments of the present episodes, [N, ...] each, float64."""
        return _Arguments(self.simulator.drawn)

    @property
    def action_description(self) -> list[str]:
        """Name of every action."""
        return self.actions.description

    def next_eclipse(self) -> tuple[Tensor, Tensor]:
        """Next start and next end of an eclipse, [N] s since reset."""
        return next_eclipse(self.simulator)

    def aliveness(self) -> dict[str, Tensor]:
        """Result [N] of every aliveness check of dynamics and flight software, by name."""
        return {**self.dynamics.aliveness(), **self.fsw.aliveness()}

    def is_alive(self) -> Tensor:
        """Whether every aliveness check holds now, [N]."""
        alive = torch.ones_like(self.simulator.ticks, dtype=torch.bool)
        for check in self.aliveness().values():
            alive = alive & check
        return alive
