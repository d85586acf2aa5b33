"""Base of dynamics and flight-software models: components gathered over base classes, and read-outs by name."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, ClassVar, Protocol, TypeVar

import torch
from torch import Tensor

from bsk_torch.sim.component import Component, collect
from bsk_torch.sim.hooks import check_tensor
from bsk_torch.sim.readout.hooks import check_model
from bsk_torch.sim.readout.observables import Function, Observer, observable, vital
from bsk_torch.sim.readout.surroundings import World
from bsk_torch.sim.satellite_state import SatelliteState

Checker = TypeVar("Checker", bound=Callable[[Any], Tensor])


class Simulation(Protocol):
    """Part of a :class:`bsk_torch.sim.simulator.Simulator` that models read."""

    state: SatelliteState
    observer: Observer
    world: World


def aliveness_checker(method: Checker) -> Checker:
    """Mark a method that returns [N] booleans as an aliveness check: satellites for which a check is False are dead."""
    method.is_aliveness_checker = True  # type: ignore[attr-defined]
    return method


class Model:
    """Base of dynamics and flight-software models.

    Subclasses list their own ``components``; a component replaces the one that a base class has in the same slot. Methods and
    properties read the simulation at a decision boundary and return tensors with leading dimension N.
    """

    components: ClassVar[tuple[Component, ...]] = ()

    def __init_subclass__(cls, **options: object) -> None:
        super().__init_subclass__(**options)
        check_model(cls, Model)

    def __init__(self, simulator: Simulation) -> None:
        """Bind the model to the simulation that it describes."""
        self.simulator = simulator
        self.satellite: Any = None

    @classmethod
    def all_components(cls) -> tuple[Component, ...]:
        """Return the components of the class and its bases in the order of a tick."""
        return collect(reversed(cls.__mro__))

    def observed(self, function: Function) -> Tensor:
        """Return what the function of an :class:`~bsk_torch.sim.readout.observables.observable` is now, [N] or [N, 3] float64.

        It is a copy: other readers of the same step get the same values if it is changed in place.
        """
        return self.simulator.observer.read(function).clone()

    def state(self, name: str) -> Tensor:
        """Return a field of the state, [N] or [N, width]."""
        return self.simulator.state.read(name)

    @property
    def world(self) -> World:
        """Sun, Earth and ground stations at the current time."""
        return self.simulator.world

    def aliveness(self) -> dict[str, Tensor]:
        """Return the result [N] of every aliveness checker, by name."""
        vitals = self.simulator.observer.read_together(tuple(self.vitals().values()), bool)
        together = {} if vitals is None else dict(zip(self.vitals(), vitals.unbind(1), strict=True))
        return {name: together[name] if name in together else self._checked(name) for name in self.checks()}

    def _checked(self, name: str) -> Tensor:
        values, state = getattr(self, name)(), self.simulator.state
        check_tensor(f"{type(self).__name__}.{name}()", values, (state.rows,), torch.bool)
        return values

    @classmethod
    @functools.cache
    def checks(cls) -> tuple[str, ...]:
        """Return the names of the aliveness checkers."""
        return tuple(name for name in dir(cls) if getattr(getattr(cls, name), "is_aliveness_checker", False))

    @classmethod
    @functools.cache
    def observables(cls) -> dict[str, Function]:
        """Return the functions of the properties that are observables, by name, without aliveness checks."""
        members = {name: getattr(cls, name) for name in dir(cls)}
        return {
            name: member.function
            for name, member in members.items()
            if isinstance(member, observable) and not isinstance(member, vital)
        }

    @classmethod
    @functools.cache
    def vitals(cls) -> dict[str, Function]:
        """Return the functions of the aliveness checks that kernels compute, by name."""
        checks = {name: getattr(cls, name) for name in cls.checks()}
        return {name: check.function for name, check in checks.items() if hasattr(check, "function")}
