"""NadirScan-v1: the demonstration of the BSK-RL paper (section 4 and appendix).

One satellite collects data by scanning the ground below it for five orbits, and has to keep its battery charged, its wheels slow
and its store from filling up. Reward: time spent recording over the length of the episode, and -1 for dying.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from bsk_torch import act, data, obs, rand, sats, scene
from bsk_torch.astro.frames import angle_between
from bsk_torch.env import SatelliteTasking
from bsk_torch.sim import dyn, fsw
from bsk_torch.sim.dyn import Now, observable

ORBIT = 5700.0
"""About one orbit, s."""

CAPACITY, BATTERY = 5000 * 8e6, 200 * 3600.0


def next_station() -> obs.OpportunityProperties:
    """Observation of the next pass over a ground station."""
    times = (dict(prop=name, norm=ORBIT) for name in ("opportunity_open", "opportunity_close"))
    return obs.OpportunityProperties(*times, type="ground_station", n_ahead_observe=1)


class ScanningDownlinkDynModel(dyn.ContinuousImagingDynModel, dyn.GroundStationDynModel):
    """Scans and downlinks; adds the two pointing errors that the agent sees."""

    @observable
    def instrument_pointing_error(now: Now) -> Tensor:
        """Angle between the instrument and the nadir, [N] rad."""
        return angle_between(-now.r, now.BN.mT @ now.args.inst_pHat_B)

    @observable
    def solar_pointing_error(now: Now) -> Tensor:
        """Angle between the panel normal and the Sun, [N] rad."""
        return angle_between(now.BN.mT @ now.args.nHat_B, now.r_sun)


class ScanningSatellite(sats.AccessSatellite):
    """The paper's satellite."""

    observation_spec = (
        obs.SatProperties(
            dict(prop="storage_level_fraction"),
            dict(prop="battery_charge_fraction"),
            dict(prop="wheel_speeds_fraction"),
            dict(prop="instrument_pointing_error", norm=torch.pi),
            dict(prop="solar_pointing_error", norm=torch.pi),
        ),
        next_station(),
        obs.Eclipse(norm=ORBIT),
        obs.Time(),
    )
    action_spec = (
        act.Scan(duration=180.0),
        act.Charge(duration=120.0),
        act.Downlink(duration=60.0),
        act.Desat(duration=60.0),
    )
    dyn_type = ScanningDownlinkDynModel
    fsw_type = fsw.ContinuousImagingFSWModel


def scanning_args() -> dict[str, Any]:
    """The paper's arguments and randomisation."""
    return dict(
        dataStorageCapacity=CAPACITY,
        storageInit=rand.Uniform(0.0, 0.8 * CAPACITY),
        instrumentBaudRate=0.5 * 8e6,
        transmitterBaudRate=-50 * 8e6,
        batteryStorageCapacity=BATTERY,
        storedCharge_Init=rand.Uniform(0.3 * BATTERY, BATTERY),
        basePowerDraw=-10.0,
        instrumentPowerDraw=-30.0,
        transmitterPowerDraw=-25.0,
        thrusterPowerDraw=-80.0,
        panelArea=0.25,
        imageAttErrorRequirement=0.1,
        imageRateErrorRequirement=0.1,
        disturbance_vector=rand.Normal(0.0, 1e-4, 3),
        maxWheelSpeed=6000.0,
        wheelSpeeds=rand.Uniform(-3000.0, 3000.0, 3),
        desatAttitude="nadir",
    )


def nadir_scan(*, sat_args: dict[str, Any] | None = None, obs_type: type = torch.Tensor, **options: Any) -> SatelliteTasking:
    """NadirScan-v1; see :func:`bsk_torch.make`."""
    satellite = ScanningSatellite("Scanner1", sat_args=scanning_args() | (sat_args or {}), obs_type=obs_type)
    defaults: dict[str, Any] = dict(
        scenario=scene.UniformNadirScanning(value_per_second=1 / (5 * ORBIT)),
        rewarder=data.ScanningTimeReward(),
        time_limit=5 * ORBIT,
        failure_penalty=-1.0,
        terminate_on_time_limit=True,
    )
    return SatelliteTasking(satellite, **(defaults | options))
