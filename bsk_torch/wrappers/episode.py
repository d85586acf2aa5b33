"""One episode of a batched environment, read as bsk_rl's programs read theirs: numbers and arrays instead of tensors [1, ...]."""

from __future__ import annotations

from bsk_torch.env.base import Tasking
from bsk_torch.sats.one import OneSatellite, OneScenario, OneSimulator, OneView
from bsk_torch.sim.names import nearest


class EpisodeView:
    """What the Gymnasium and PettingZoo views of one episode offer of their environment, under bsk_rl's names.

    Attributes:
        core: The batched environment, with ``num_envs=1``.
    """

    core: Tasking
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
        whole = next(satellite for satellite in self.core.satellites if name in satellite.names)
        return whole.one(whole.names.index(name))

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
