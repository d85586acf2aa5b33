"""AEOSPower-v1: agile Earth observation with a small battery, weak wheels and a small store.

The satellite images, charges, downlinks and dumps momentum. A rule says in advance which actions would endanger it: they are
illegal in ``action_mask``, as the shield of bsk_rl's example makes them.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from bsk_torch import act, obs, rand, scene
from bsk_torch.env import SatelliteTasking
from bsk_torch.presets.aeos import AHEAD, ORBIT, SATELLITE, AgileSatellite, agile_args, agile_environment, targets_ahead
from bsk_torch.presets.nadir_scan import next_station
from bsk_torch.sim import dyn

BINS, BIN = 20, 180.0
"""Number of intervals in which the density of targets is observed, and their length, s."""

CROWD = 5.0
"""What sums of priorities are divided by."""

RESERVE = 0.25
"""Charge, fraction of the battery, below which the shield always asks for more."""

FAST = 0.7
"""Wheel speed, fraction of the largest, above which the shield asks for desaturation."""

RESOURCES = (
    dict(prop="battery_charge_fraction"),
    dict(prop="wheel_speeds_fraction"),
    dict(prop="storage_level_fraction"),
)

CHARGE, DOWNLINK, DESAT = 0, 1, 2
"""Numbers of the actions that are not images."""


class TargetDensity(obs.Observation):
    """Sums of the priorities of the targets whose next window closes in each of the next intervals, [N, BINS]."""

    def __init__(self, name: str = "density") -> None:
        """Name of the observation."""
        super().__init__(name)

    def get_obs(self) -> Tensor:
        """See :meth:`Observation.get_obs`."""
        simulator, scenario = self.satellite.simulator, self.satellite.scenario
        close = self.satellite.next_opportunities("target")[1] - simulator.sim_time.unsqueeze(-1)  # type: ignore[attr-defined]
        number = torch.clamp(close / BIN, 0.0, float(BINS)).long()
        sums = torch.zeros(len(close), BINS + 1, dtype=close.dtype, device=close.device)
        return sums.scatter_add(1, number, simulator.of_env(scenario.priority).to(close.dtype))[:, :BINS] / CROWD


def shield(satellite: Any) -> Tensor:
    """Which of n actions do not endanger the satellite, [N, n]: only charging, only desaturation, or all.

    In sunlight the battery must hold a reserve, and what the next eclipse will take if the time until then is too short to make
    up for it, at a battery's charge per orbit; otherwise no wheel may be fast.
    """
    start, end = (time - satellite.simulator.sim_time for time in satellite.next_eclipse())
    dark = end < start
    needed = RESERVE + torch.clamp((end - start) - start, min=0.0) / ORBIT
    low = ~dark & (satellite.dynamics.battery_charge_fraction < needed)
    fast = ~low & (satellite.dynamics.wheel_speeds_fraction.abs().amax(-1) > FAST)
    names = satellite.action_description
    return act.only(names, "action_charge", where=low) & act.only(names, "action_desat", where=fast)


class PowerSatellite(AgileSatellite):
    """Images the next targets while it charges, downlinks and desaturates."""

    observation_spec = (
        obs.SatProperties(*SATELLITE, *RESOURCES),
        targets_ahead(),
        TargetDensity(),
        next_station(),
        obs.Eclipse(norm=ORBIT),
        obs.Time(),
    )
    action_spec = (
        act.Charge(duration=60.0),
        act.Downlink(duration=60.0),
        act.Desat(duration=60.0),
        act.Image(n_ahead_image=AHEAD),
    )
    dyn_type = dyn.GroundStationDynModel
    shielded = True

    def legal_actions(self) -> Tensor | None:
        """See :meth:`Satellite.legal_actions`."""
        return shield(self) if self.shielded else None


class PowerSetSatellite(PowerSatellite):
    """The same, with the targets as a set."""

    observation_spec = (
        PowerSatellite.observation_spec[0],
        targets_ahead(as_set=True),
        *PowerSatellite.observation_spec[2:],
    )


class UnshieldedSatellite(PowerSatellite):
    """May do what endangers it."""

    shielded = False


class UnshieldedSetSatellite(PowerSetSatellite):
    """May do what endangers it, and sees targets as a set."""

    shielded = False


def power_args() -> dict[str, Any]:
    """Arguments of bsk_rl's shield example, with the other power draws of its nadir task."""
    battery = 160.0 * 3600.0
    return agile_args() | dict(
        batteryStorageCapacity=battery,
        storedCharge_Init=rand.Uniform(0.4 * battery, battery),
        rwBasePower=20.0,
        instrumentPowerDraw=-30.0,
        transmitterPowerDraw=-25.0,
        thrusterPowerDraw=-80.0,
        maxWheelSpeed=1500.0,
        wheelSpeeds=rand.Uniform(-400.0, 400.0, 3),
        disturbance_vector=rand.Normal(0.0, 1e-4, 3),
        desatAttitude="nadir",
        dataStorageCapacity=100 * 8e6,
        storageInit=0.0,
    )


def aeos_power(
    *, n_targets: int | tuple[int, int] = 1000, as_set: bool = False, shielded: bool = True, **options: Any
) -> SatelliteTasking:
    """AEOSPower-v1; see :func:`bsk_torch.presets.aeos.aeos`.

    Args:
        n_targets: Number of targets, or its range (the upper end excluded).
        as_set: Whether targets are observed as a set.
        shielded: Whether ``action_mask`` leaves out what :func:`shield` calls dangerous.
        **options: Arguments of the environment to override.
    """
    options = dict(scenario=scene.UniformTargets(n_targets), failure_penalty=-10.0) | options
    satellites = (PowerSatellite, PowerSetSatellite) if shielded else (UnshieldedSatellite, UnshieldedSetSatellite)
    return agile_environment(satellites, power_args(), as_set, options)
