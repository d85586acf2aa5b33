"""AEOSPower-v1: agile Earth observation with a small battery, weak wheels and a small data buffer.

The satellite images, charges, downlinks and desaturates its wheels. As in BSK-RL's shield example, ``action_mask`` excludes
dangerous actions; see :func:`shield`.

Observation, 298 numbers: those of AEOS-v1 (:mod:`bsk_torch.presets.aeos`), and

=============================  ==================================================================================
``battery_charge_fraction``    battery charge as a fraction of the capacity
``wheel_speeds_fraction`` (3)  wheel speeds as fractions of the maximum speed
``storage_level_fraction``     data in the buffer as a fraction of the capacity
``density`` (20)               sum of the priorities of targets whose next window closes within each of the next
                               20 intervals of 180 s, divided by 5
``ground_station`` (2)         time until the next pass over a station opens and closes, divided by 5700 s
``eclipse`` (2)                time until the next eclipse begins and ends, divided by 5700 s
=============================  ==================================================================================

Actions: 0 charge, 1 downlink, 2 desaturate the wheels (60 s each), 3 to 34 image one of the next 32 targets.

Reward: the priority of a target for its first image; -10 if the satellite dies.

Termination: at the end of a step with an empty battery, a wheel at its maximum speed, or an altitude below 200 km; and at the
time limit of 17,100 s.

Eclipses are observed with ``obs.Eclipse(sampled=True)``: up to 30 s late, and, where none comes, at one second
after reset.
Windows that open after the time limit are legal: ``act.Image(mask_late=False)``.

Random at reset: as in AEOS-v1 with 1,000 targets; initial charge and wheel speeds, disturbance torque.
"""

from __future__ import annotations

from typing import cast

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch import act, obs, rand, scene
from bsk_torch.env import SatelliteTasking
from bsk_torch.presets.aeos import (
    AHEAD,
    ORBIT,
    SATELLITE,
    AgileSatellite,
    agile_args,
    agile_environment,
    imagers,
    targets_ahead,
)
from bsk_torch.presets.nadir_scan import next_station
from bsk_torch.sats import BoundAccessSatellite, BoundSatellite
from bsk_torch.sim import dyn

BINS = 20
"""Number of intervals in which the density of targets is observed."""

BIN = 180.0
"""Length of these intervals, s."""

CROWD = 5.0
"""Norm of sums of priorities."""

RESERVE = 0.25
"""Charge below which the shield allows only charging, as a fraction of the battery's capacity."""

FAST = 0.7
"""Wheel speed above which the shield allows only desaturation, as a fraction of the maximum speed."""

RESOURCES = (
    dict(prop="battery_charge_fraction"),
    dict(prop="wheel_speeds_fraction"),
    dict(prop="storage_level_fraction"),
)
"""Observed properties of the satellite in addition to those of AEOS-v1."""

CHARGE, DOWNLINK, DESAT = 0, 1, 2
"""Actions that are not images."""


class TargetDensity(obs.Observation):
    """Sums of the priorities of the targets whose next window closes in each of the next intervals, [N, 20]."""

    satellite: BoundAccessSatellite

    @override
    def get_obs(self) -> Tensor:
        simulator, scenario = self.satellite.simulator, self.satellite.scenario
        close = self.satellite.next_opportunities("target")[1] - simulator.sim_time.unsqueeze(-1)
        number = torch.clamp(close / BIN, 0.0, float(BINS)).long()
        sums = torch.zeros(len(close), BINS + 1, dtype=close.dtype, device=close.device)
        return sums.scatter_add(1, number, simulator.of_env(scenario.priority).to(close.dtype))[:, :BINS] / CROWD


def shield(satellite: BoundSatellite) -> Tensor:
    """Return which actions do not endanger the satellite, [N, n_actions] bool: only charging, only desaturation, or all.

    In sunlight, only charging is allowed below the charge (as a fraction of the capacity)

        needed = RESERVE + max(0, eclipse_duration - time_until_eclipse) / ORBIT

    where the second term covers an eclipse that begins before the battery can be charged for it, at one capacity per orbit.
    Otherwise, only desaturation is allowed while a wheel is faster than :data:`FAST`.
    """
    start, end = (time - satellite.simulator.sim_time for time in satellite.next_eclipse(sampled=True))
    dark = end < start
    needed = RESERVE + torch.clamp((end - start) - start, min=0.0) / ORBIT
    low = ~dark & (satellite.dynamics.battery_charge_fraction < needed)
    fast = ~low & (satellite.dynamics.wheel_speeds_fraction.abs().amax(-1) > FAST)
    names = satellite.action_description
    return act.allow_only(names, "action_charge", where=low) & act.allow_only(names, "action_desat", where=fast)


def observed(as_set: bool) -> tuple[obs.Observation, ...]:
    """Return the observations of the satellite."""
    return (
        obs.SatProperties(*SATELLITE, *RESOURCES),
        targets_ahead(as_set=as_set),
        TargetDensity("density"),
        next_station(),
        obs.Eclipse(norm=ORBIT, sampled=True),
        obs.Time(),
    )


class PowerSatellite(AgileSatellite):
    """Images targets, charges, downlinks and desaturates; the shield limits its actions unless ``shielded`` is False."""

    observation_spec = observed(as_set=False)
    action_spec = (
        act.Charge(duration=60.0),
        act.Downlink(duration=60.0),
        act.Desat(duration=60.0),
        act.Image(n_ahead_image=AHEAD, mask_late=False),
    )
    dyn_type = dyn.GroundStationDynModel
    shielded = True

    @override
    def legal_actions(self) -> Tensor | None:
        return shield(cast(BoundSatellite, self)) if self.shielded else None


def power_args() -> dict[str, object]:
    """Return the arguments of the shield example, with the power draws of its nadir task."""
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
    *, n_targets: int | tuple[int, int] = 1000, as_set: bool = False, shielded: bool = True, **options: object
) -> SatelliteTasking:
    """Return AEOSPower-v1; see the module, and :func:`bsk_torch.presets.aeos.aeos` for the arguments.

    With ``shielded``, ``action_mask`` excludes actions by the rule :func:`shield`.
    """
    options = dict(scenario=scene.UniformTargets(n_targets), failure_penalty=-10.0) | options
    settings = dict(obs_type=dict if as_set else torch.Tensor, observation_spec=observed(as_set))
    (satellite,) = imagers(PowerSatellite, ["EO1"], power_args(), options, **settings)
    satellite.shielded = shielded
    return agile_environment(satellite, options)
