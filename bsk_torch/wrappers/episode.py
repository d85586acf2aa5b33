"""One episode of a batched environment, read as bsk_rl's programs read theirs: numbers and arrays instead of tensors [1, ...]."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, ClassVar

import gymnasium
import numpy as np
import torch
from gymnasium.error import ResetNeeded

from bsk_torch.env.base import Tasking
from bsk_torch.sats.one import OneSatellite, OneScenario, OneSimulator, OneView
from bsk_torch.sim.names import nearest
from bsk_torch.wrappers.core import RENDERING, Results, begin, check_options, snapshots


class EpisodeView:
    """What the Gymnasium and PettingZoo views of one episode offer of their environment, under bsk_rl's names.

    Attributes:
        core: The batched environment, with ``num_envs=1``.
        render_mode: ``"rgb_array"``, or None.
    """

    core: Tasking
    render_mode: str | None
    latest_step_duration: float = 0.0
    """Duration of the last step, s; zero after a reset."""

    @property
    def simulator(self) -> OneSimulator:
        """The simulation; ``simulator.sim_time`` is the time since reset, s."""
        return self.satellites[0].simulator

    @property
    def satellites(self) -> list[OneSatellite]:
        """The satellites, in their order, with properties of the present: ``satellites[0].dynamics.battery_charge_fraction``."""
        return [self.get_satellite(name) for name in self.core.names]

    def get_satellite(self, name: str) -> OneSatellite:
        """Return the satellite of that name; ValueError if there is none."""
        if name not in self.core.names:
            raise ValueError(f"no satellite is called {name!r}; {nearest(str(name), self.core.names)}")
        group = next(satellite for satellite in self.core.satellites if name in satellite.names)
        return group.one(group.names.index(name))

    @property
    def scenario(self) -> OneScenario:
        """The scenario."""
        return OneScenario(self.core.scenario, 0, 1)

    @property
    def rewarder(self) -> OneView:
        """The rewarder; ``rewarder.cum_reward`` has the reward of each satellite so far, by name."""
        return OneView(self.core.rewarder, 0, 1)

    @property
    def communicator(self) -> OneView:
        """The communication method."""
        return OneView(self.core.communicator, 0, 1)

    @property
    def time_limit(self) -> float:
        """Time limit of the current episode, s."""
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

    def render(self) -> np.ndarray | None:
        """Return a picture of the current state, [480, 640, 3] uint8; see :meth:`bsk_torch.env.base.Tasking.render`."""
        pictures = snapshots(self.core, self.render_mode)
        return pictures[0] if pictures else None


class GymEpisode(EpisodeView, gymnasium.Env[Any, Any]):
    """What Gymnasium's views of one episode share; each has its own spaces and actions."""

    metadata: ClassVar[dict[str, Any]] = RENDERING  # type: ignore[misc]
    _running = False

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Start an episode.

        Args:
            seed: Begin with the first episode of this seed; None for the next episode of the present seed.
            options: ``{"state": state}`` starts from a state of ``core.get_state()`` instead.
        """
        options = check_options(options, ("state",))
        super().reset(seed=seed)
        if seed is not None:
            self.core.reseed(seed)
        every = torch.ones(1, dtype=torch.bool, device=self.core.device)
        results = begin(self.core, every, state=options.get("state"))
        self._running = True
        return self._observation(results), self._info(results)

    def _check_running(self) -> None:
        if not self._running:
            raise ResetNeeded("step() needs a running episode; call reset() first")

    def _ended(self, results: Results) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Return the results of a step in the form of Gymnasium."""
        terminated, truncated = bool(results["terminated"]), bool(results["truncated"])
        self._running = not (terminated or truncated)
        return self._observation(results), float(results["reward"]), terminated, truncated, self._info(results)

    @abstractmethod
    def _observation(self, results: Results) -> Any: ...

    @abstractmethod
    def _info(self, results: Results) -> dict[str, Any]: ...
