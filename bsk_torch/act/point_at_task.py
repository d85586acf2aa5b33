"""Pointing the sensor at a task, as in AEOS-Bench."""

from __future__ import annotations

from typing import Literal

import torch
from torch import Tensor

from bsk_torch.act.base import Action, Decision
from bsk_torch.sats.bound import BoundSatellite
from bsk_torch.scene.aeos_bench import ASSIGNED, NO_TASK, PLACES, AEOSBench
from bsk_torch.sim.names import nearest

SENSORS = ("assigned", "on", "chosen")


class PointAtTask(Action):
    """Points the sensor at a task for one tick; action 0 points at the Earth's center, action k at task k - 1.

    What is chosen at a time acts from the next tick on, as in the benchmark. A task that is not offered, see
    :attr:`bsk_torch.scene.AEOSBench.task_offered`, can be pointed at, but ``action_mask`` excludes it.
    """

    def __init__(self, sensor: Literal["assigned", "on", "chosen"] = "assigned", name: str = "point") -> None:
        """Provide an action for each task of the scenario, and one for none.

        Args:
            sensor: ``"assigned"``: the sensor is on while a task is chosen. ``"on"``: it is always on, as under the benchmark's
                rule. ``"chosen"``: there are twice as many actions; the second half are the same with the sensor on, the first
                with the sensor off.
            name: Name in ``action_description``.

        Raises:
            ValueError: For another sensor.
        """
        super().__init__(name)
        if sensor not in SENSORS:
            raise ValueError(f"sensor={sensor!r} must be one of {list(SENSORS)}; {nearest(str(sensor), SENSORS)}")
        self.sensor = sensor

    def link_satellite(self, satellite: BoundSatellite) -> None:
        """See :meth:`Action.link_satellite`; ValueError unless the scenario has tasks of AEOS-Bench."""
        super().link_satellite(satellite)
        if PLACES not in satellite.simulator.scenario_state:
            raise ValueError(f"act.PointAtTask {self.name!r} needs scene.AEOSBench as the scenario of the environment")
        for command in ("sensor_off", "sensor_on"):
            satellite.simulator.check_command(command)
        self._choices = 1 + satellite.simulator.scenario_state[PLACES].shape[1]
        self.n_actions = self._choices * (2 if self.sensor == "chosen" else 1)
        satellite.simulator.memory.declare(ASSIGNED, NO_TASK, low=NO_TASK)

    @property
    def _scenario(self) -> AEOSBench:
        scenario: AEOSBench = self.satellite.scenario
        return scenario

    def names(self) -> list[str]:
        """See :meth:`Action.names`."""
        names = [f"{self.name}_none", *(f"{self.name}_{k}" for k in range(self._choices - 1))]
        return names if self.sensor != "chosen" else [*(f"{name}_off" for name in names), *(f"{name}_on" for name in names)]

    def mask(self) -> Tensor:
        """See :meth:`Action.mask`."""
        offered = self.satellite.of_env(self._scenario.task_offered)
        legal = torch.cat([torch.ones_like(offered[:, :1]), offered], 1)
        return torch.cat([legal, legal], 1) if self.sensor == "chosen" else legal

    def decide(self, index: Tensor, mask: Tensor, action: Tensor, previous: Tensor) -> Decision:
        """See :meth:`Action.decide`."""
        simulator, task = self.satellite.simulator, index % self._choices - 1
        off, on = (torch.full_like(index, simulator.mode_names.index(name)) for name in ("sensor_off", "sensor_on"))
        if self.sensor == "on":
            mode = on
        else:
            mode = torch.where(task >= 0 if self.sensor == "assigned" else index >= self._choices, on, off)
        duration = torch.full_like(simulator.sim_time, simulator.h)
        return Decision(mode, torch.ones_like(mask), duration, action, duration, task)

    def begin(self, mask: Tensor, decision: Decision) -> None:
        """See :meth:`Action.begin`: set the place."""
        simulator, task = self.satellite.simulator, decision.command
        assert task is not None
        chosen = task.clamp(min=0)
        place = simulator.look_up(self._scenario.drawn(PLACES), chosen.unsqueeze(1)).squeeze(1)
        simulator.write("r_LP_P", mask, torch.where((task >= 0).unsqueeze(1), place, 0.0))
        memory = simulator.memory
        memory[ASSIGNED] = torch.where(mask, task, memory[ASSIGNED])
