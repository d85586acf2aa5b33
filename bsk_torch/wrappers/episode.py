"""What the Gymnasium and PettingZoo views of one episode show of their environment."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, ClassVar

import gymnasium
import numpy as np
import torch
from gymnasium.error import ResetNeeded

from bsk_torch.data.base import GlobalReward
from bsk_torch.env.base import Tasking
from bsk_torch.sats.bound import OtherSatellite
from bsk_torch.wrappers.core import RENDERING, Results, begin, check_options, snapshots


class EpisodeView:
    """One episode of a batched environment; quantities are tensors [1, ...].

    Attributes:
        core: The batched environment, with ``num_envs=1``.
        render_mode: ``"rgb_array"``, or None.
    """

    core: Tasking
    render_mode: str | None
    latest_step_duration: float = 0.0
    """Duration of the last step, s; zero after a reset."""

    @property
    def satellites(self) -> list[OtherSatellite]:
        """The satellites, in their order: ``satellites[0].dynamics.battery_charge_fraction`` is [1]."""
        return [self.core.fleet.satellite(name) for name in self.core.names]

    @property
    def rewarder(self) -> GlobalReward:
        """The rewarder; ``rewarder.cum_reward`` has the reward of each satellite so far, [1] by name."""
        return self.core.rewarder

    def render(self) -> np.ndarray | None:
        """Return a picture of the current state, [480, 640, 3] uint8; see :meth:`bsk_torch.env.base.Tasking.render`."""
        pictures = snapshots(self.core, self.render_mode)
        return pictures[0] if pictures else None


class GymEpisode(EpisodeView, gymnasium.Env[Any, Any]):
    """What Gymnasium's views of one episode share; each has its own spaces and actions."""

    metadata: ClassVar[dict[str, object]] = RENDERING  # type: ignore[misc]
    _running = False

    def reset(self, *, seed: int | None = None, options: dict[str, object] | None = None) -> tuple[Any, dict[str, Any]]:
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
    def _observation(self, results: Results) -> object: ...

    @abstractmethod
    def _info(self, results: Results) -> dict[str, object]: ...
