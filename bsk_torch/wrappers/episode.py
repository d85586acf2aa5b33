"""What the Gymnasium and PettingZoo views of one episode show of their environment."""

from __future__ import annotations

from bsk_torch.data.base import GlobalReward
from bsk_torch.env.base import Tasking
from bsk_torch.sats.others import OtherSatellite


class EpisodeView:
    """One episode of a batched environment; quantities are tensors [1, ...].

    Attributes:
        core: The batched environment, with ``num_envs=1``.
    """

    core: Tasking
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
