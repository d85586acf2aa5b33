"""One episode of a batched environment, read as bsk_rl's programs read theirs: numbers and arrays instead of tensors [1, ...]."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from torch import Tensor, nn

from bsk_torch.comm import CommunicationMethod
from bsk_torch.data import GlobalReward
from bsk_torch.env.base import Tasking
from bsk_torch.sats import Satellite
from bsk_torch.scene import Scenario
from bsk_torch.sim.names import nearest
from bsk_torch.sim.readout.model import Model
from bsk_torch.sim.readout.surroundings import World
from bsk_torch.sim.simulator import Simulator

PARTS = (Satellite, Model, Simulator, World, Scenario, GlobalReward, CommunicationMethod)
"""Objects whose attributes are read row by row."""


class Row:
    """A row of an object whose attributes are tensors with a row for each satellite or episode; for reading.

    Numbers come as ``float``, ``int`` or ``bool``, other rows as NumPy arrays, results of methods likewise. The object itself is
    ``_whole``; its attributes cannot be set through the row.
    """

    def __init__(self, whole: Any, row: int, rows: int, **own: Any) -> None:
        """Read row number ``row`` of an object whose tensors have ``rows`` rows; ``own`` attributes come first."""
        self.__dict__.update({"_whole": whole, "_row": row, "_rows": rows, **own})

    def __getattr__(self, name: str) -> Any:
        """Return the row of an attribute of the object."""
        return self._read(getattr(self._whole, name))

    def __setattr__(self, name: str, value: Any) -> None:
        """AttributeError: it would not reach the simulation."""
        raise AttributeError(
            f"{type(self._whole).__name__}.{name} cannot be set in the view of one episode; set sat_args, or change env.core"
        )

    def __dir__(self) -> list[str]:
        """Names of the object."""
        return [*self.__dict__, *dir(self._whole)]

    def __repr__(self) -> str:
        """Name the object and the row."""
        return f"<{type(self._whole).__name__} {self.__dict__.get('name', self._row)}>"

    def _read(self, value: Any) -> Any:
        if isinstance(value, Tensor):
            mine = value[min(self._row, len(value) - 1)] if value.ndim and len(value) in (1, self._rows) else value
            return mine.item() if mine.ndim == 0 else mine.detach().cpu().numpy().copy()
        if isinstance(value, PARTS):
            return Row(value, self._row, self._rows)
        if isinstance(value, Mapping):
            return {name: self._read(part) for name, part in value.items()}
        if isinstance(value, tuple) and any(isinstance(part, Tensor) for part in value):
            parts = [self._read(part) for part in value]
            return type(value)(*parts) if hasattr(value, "_fields") else tuple(parts)
        if callable(value) and not isinstance(value, type | nn.Module):
            return lambda *args, **options: self._read(value(*args, **options))
        return value


class EpisodeView:
    """What the Gymnasium and PettingZoo views of one episode offer of their environment, under bsk_rl's names.

    Attributes:
        core: The batched environment, with ``num_envs=1``.
    """

    core: Tasking
    latest_step_duration: float = 0.0
    """Duration of the last step, s; zero after a reset."""

    @property
    def simulator(self) -> Any:
        """The simulation; ``simulator.sim_time`` is the time since reset, s."""
        return Row(self.core.simulator, 0, 1, sim_time=float(self.core.fleet.sim_time[0]))

    @property
    def satellites(self) -> list[Any]:
        """The satellites, in their order, with properties of the present: ``satellites[0].dynamics.battery_charge_fraction``."""
        return [self.get_satellite(name) for name in self.core.names]

    def get_satellite(self, name: str) -> Any:
        """Return the satellite of that name; ValueError where there is none."""
        if name not in self.core.names:
            raise ValueError(f"no satellite is called {name!r}; {nearest(str(name), self.core.names)}")
        whole = next(satellite for satellite in self.core.satellites if name in satellite.names)
        return Row(whole, whole.names.index(name), len(whole.names), name=name, id=name)

    @property
    def scenario(self) -> Any:
        """The scenario."""
        return Row(self.core.scenario, 0, 1)

    @property
    def rewarder(self) -> Any:
        """The rewarder; ``rewarder.cum_reward`` has the reward of each satellite so far, by name."""
        return Row(self.core.rewarder, 0, 1)

    @property
    def communicator(self) -> Any:
        """The communication method."""
        return Row(self.core.communicator, 0, 1)

    @property
    def time_limit(self) -> float:
        """Time limit of the present episode, s."""
        return float(self.core.time_limit[0])

    @property
    def failure_penalty(self) -> float:
        """Reward of a satellite for dying."""
        return self.core.failure_penalty

    @property
    def max_step_duration(self) -> float:
        """Longest step, s."""
        return self.core.max_step_duration

    @property
    def sim_rate(self) -> float:
        """Length of a tick, s."""
        return float(self.core.options.sim_rate)

    def delete_simulator(self) -> None:
        """Nothing has to be deleted; bsk_rl's programs call it to free Basilisk's memory."""
