"""The problems of bsk_rl's documentation in bsk_rl's terms, for ``record_examples.py``.

They say what the pages say, by the same numbers, without their logging, training and plots, and run on bsk_rl 1.3.8. Where a
page needs an older or a later bsk_rl, the same problem is written for 1.3.8: the cloud environment reads names of buffers that
are gone, explicit world models do not fit the dynamics, and norms of None stand for an orbital period, 5700 s here.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from Basilisk.architecture import messaging
from Basilisk.fswAlgorithms import rwNullSpace
from Basilisk.simulation import reactionWheelStateEffector
from Basilisk.utilities import macros, orbitalMotion, simIncludeRW
from bsk_rl import ConstellationTasking, GeneralSatelliteTasking, SatelliteTasking, act, comm, data, obs, sats, scene
from bsk_rl.data.base import Data, DataStore, GlobalReward
from bsk_rl.data.unique_image_data import UniqueImageData, UniqueImageReward, UniqueImageStore
from bsk_rl.sim import dyn, fsw
from bsk_rl.sim.fsw import action
from bsk_rl.utils.functional import default_args
from bsk_rl.utils.orbital import random_circular_orbit, random_orbit, random_unit_vector, relative_to_chief, walker_delta_args

ORBIT = 5700.0
EARTH = orbitalMotion.REQ_EARTH * 1e3
SPEED = 7616.5
QUIET = {"log_level": "ERROR"}


def angle(a: np.ndarray, b: np.ndarray) -> float:
    """Between two vectors, rad."""
    return float(np.arccos(np.dot(a, b) / np.linalg.norm(a) / np.linalg.norm(b)))


def sun_N(model: Any) -> np.ndarray:
    """Position of the Sun, m."""
    return np.array(model.world.gravFactory.spiceObject.planetStateOutMsgs[model.world.sun_index].read().PositionVector)


def sun_H(satellite: Any) -> np.ndarray:
    """Direction of the Sun from the satellite in the Hill frame."""
    toward = satellite.dynamics.HN @ (sun_N(satellite.dynamics) - np.array(satellite.dynamics.r_BN_N))
    return toward / np.linalg.norm(toward)


# -- Getting started ---------------------------------------------------------------------------------------------------


def simple_environment() -> SatelliteTasking:
    class Scanner(sats.AccessSatellite):
        observation_spec = [
            obs.SatProperties(dict(prop="storage_level_fraction"), dict(prop="battery_charge_fraction")),
            obs.Eclipse(),
        ]
        action_spec = [act.Scan(duration=60.0), act.Charge(duration=600.0)]
        dyn_type = dyn.ContinuousImagingDynModel
        fsw_type = fsw.ContinuousImagingFSWModel

    arguments = dict(
        imageAttErrorRequirement=0.05,
        dataStorageCapacity=1e10,
        instrumentBaudRate=1e7,
        storedCharge_Init=50000.0,
        storageInit=lambda: np.random.uniform(0.25, 0.75) * 1e10,
    )
    return SatelliteTasking(
        Scanner("EO1", arguments),
        scenario=scene.UniformNadirScanning(),
        rewarder=data.ScanningTimeReward(),
        time_limit=ORBIT,
        **QUIET,
    )


# -- Satellite configuration ---------------------------------------------------------------------------------------------


def configuration(part: str) -> SatelliteTasking:
    class BespokeFSWModel(fsw.BasicFSWModel):
        @property
        def meaning_of_life(self) -> int:
            return 42

    class Properties(sats.Satellite):
        observation_spec = [
            obs.SatProperties(
                dict(prop="wheel_speeds"),
                dict(prop="battery_charge_fraction", module="dynamics"),
                dict(prop="r_BN_P", norm=7e6),
            )
        ]
        action_spec = [act.Drift()]
        dyn_type = dyn.BasicDynamicsModel
        fsw_type = fsw.BasicFSWModel

    class Bespoke(Properties):
        observation_spec = [obs.SatProperties(dict(prop="meaning_of_life"))]
        fsw_type = BespokeFSWModel

    class Custom(Properties):
        observation_spec = [obs.SatProperties(dict(prop="meaning_of_life", fn=lambda sat: 42))]

    class Opportunities(sats.ImagingSatellite):
        observation_spec = [
            obs.OpportunityProperties(
                dict(prop="priority"),
                dict(prop="opportunity_open", norm=5700.0),
                dict(fn=lambda sat, opp: opp["r_LP_P"] + 42),
                n_ahead_observe=3,
            )
        ]
        action_spec = [act.Drift()]
        dyn_type = dyn.ImagingDynModel
        fsw_type = fsw.ImagingFSWModel

    class Composed(Properties):
        observation_spec = [obs.Eclipse(), obs.SatProperties(dict(prop="battery_charge_fraction"))]

    class Actions(Properties):
        observation_spec = [obs.Time()]
        action_spec = [act.Charge(duration=120.0), act.Desat(duration=60.0), act.Charge(duration=600.0)]

    class Images(sats.ImagingSatellite):
        observation_spec = [obs.Time()]
        action_spec = [act.Image(n_ahead_image=3)]
        dyn_type = dyn.ImagingDynModel
        fsw_type = fsw.ImagingFSWModel

    targets = dict(scenario=scene.UniformTargets(1000), rewarder=data.UniqueImageReward())
    kinds: dict[str, tuple[Any, dict[str, Any]]] = {
        "properties": (Properties, {}),
        "bespoke": (Bespoke, {}),
        "custom": (Custom, {}),
        "opportunities": (Opportunities, targets),
        "composed": (Composed, {}),
        "actions": (Actions, {}),
        "images": (Images, targets),
    }
    kind, options = kinds[part]
    return SatelliteTasking(kind("Sat1", {}), **options, **QUIET)


# -- Several satellites ------------------------------------------------------------------------------------------------------

PLENTY = dict(
    imageAttErrorRequirement=0.01,
    imageRateErrorRequirement=0.01,
    batteryStorageCapacity=1e9,
    storedCharge_Init=1e9,
    dataStorageCapacity=1e12,
    u_max=0.4,
    K1=0.25,
    K3=3.0,
    omega_max=0.087,
    servo_Ki=5.0,
    servo_P=150 / 5,
)


def target_imager(ahead: int, *actions: act.Action) -> type[sats.ImagingSatellite]:
    class Imager(sats.ImagingSatellite):
        observation_spec = [
            obs.OpportunityProperties(dict(prop="priority"), dict(prop="opportunity_open", norm=5700.0), n_ahead_observe=ahead)
        ]
        action_spec = [*actions, act.Image(n_ahead_image=ahead)]
        dyn_type = dyn.FullFeaturedDynModel
        fsw_type = fsw.SteeringImagerFSWModel

    return Imager


def multiagent_envs(joint: bool) -> GeneralSatelliteTasking:
    imager = target_imager(10)
    return (GeneralSatelliteTasking if joint else ConstellationTasking)(
        satellites=[imager(f"EO{k + 1}", PLENTY) for k in range(3)],
        scenario=scene.UniformTargets(1000),
        rewarder=data.UniqueImageReward(),
        communicator=comm.LOSCommunication(),
        sat_arg_randomizer=walker_delta_args(altitude=800.0, inc=60.0, n_planes=1),
        **QUIET,
    )


class BroadcastLOS(comm.BroadcastCommunication, comm.LOSMultiCommunication):
    pass


def communication_action() -> ConstellationTasking:
    imager = target_imager(4, act.Broadcast(duration=15.0))
    return ConstellationTasking(
        satellites=[imager(f"EO{k + 1}", PLENTY) for k in range(2)],
        scenario=scene.UniformTargets(1000),
        rewarder=data.UniqueImageReward(),
        communicator=BroadcastLOS(),
        sat_arg_randomizer=walker_delta_args(altitude=800.0, inc=60.0, n_planes=1, clustersize=2, clusterspacing=5.0),
        **QUIET,
    )


# -- Clouds ---------------------------------------------------------------------------------------------------------------------


class CloudTargets(scene.UniformTargets):
    mean_cover = 0.6740208166434426

    def regenerate_targets(self) -> None:
        super().regenerate_targets()
        for target in self.targets:
            target.cover = np.clip(np.random.uniform(0.0, 2 * self.mean_cover), 0.0, 1.0)
            target.sigma = np.random.uniform(0.01, 0.05)
            target.forecast = np.clip(np.random.normal(target.cover, target.sigma), 0.0, 1.0)


class CloudData(UniqueImageData):
    def __init__(self, imaged: Any = None, duplicates: int = 0, known: Any = None, covered: Any = (), free: Any = ()) -> None:
        super().__init__(imaged=imaged, duplicates=duplicates, known=known)
        self.covered, self.free = set(covered), set(free)

    def __add__(self, other: Any) -> Any:
        both = super().__add__(other)
        both.covered, both.free = self.covered | other.covered, self.free | other.free
        return both


class CloudStore(UniqueImageStore):
    data_type = CloudData

    def compare_log_states(self, old_state: Any, new_state: Any) -> CloudData:
        if new_state <= old_state:
            return CloudData()
        target = self.satellite.latest_target
        kind = "covered" if target.cover > 0.7 else "free"
        return CloudData(imaged={target}, **{kind: {target}})


class LinearCloudReward(UniqueImageReward):
    data_store_type = CloudStore

    def calculate_reward(self, new_data_dict: Any) -> dict[str, float]:
        free = [target for new in new_data_dict.values() for target in new.free]
        return {
            name: sum((self.reward_fn(target.priority, target.cover, free.count(target)) for target in new.free), 0.0)
            for name, new in new_data_dict.items()
        }


STORE = 20 * 8e6 * 100


def cloud_environment(n_targets: Any = (1000, 10000)) -> GeneralSatelliteTasking:
    class SunModel(dyn.FullFeaturedDynModel):
        @property
        def solar_angle_norm(self) -> float:
            return angle(self.BN.T @ np.array([0, 0, -1]), sun_N(self)) / np.pi

    class CloudSatellite(sats.ImagingSatellite):
        observation_spec = [
            obs.SatProperties(
                dict(prop="omega_BP_P", norm=0.03),
                dict(prop="c_hat_P"),
                dict(prop="r_BN_P", norm=EARTH),
                dict(prop="v_BN_P", norm=SPEED),
                dict(prop="battery_charge_fraction"),
                dict(prop="solar_angle_norm"),
            ),
            obs.OpportunityProperties(
                dict(prop="opportunity_open", norm=5700),
                dict(prop="opportunity_close", norm=5700),
                type="ground_station",
                n_ahead_observe=1,
            ),
            obs.Eclipse(),
            obs.OpportunityProperties(
                dict(prop="priority"),
                dict(fn=lambda sat, opp: opp["object"].forecast),
                dict(fn=lambda sat, opp: opp["object"].sigma),
                type="target",
                n_ahead_observe=32,
            ),
            obs.Time(),
        ]
        action_spec = [act.Charge(duration=60.0), act.Image(n_ahead_image=32)]
        dyn_type = SunModel
        fsw_type = fsw.SteeringImagerFSWModel

    arguments = CloudSatellite.default_sat_args(
        oe=random_orbit,
        imageAttErrorRequirement=0.01,
        imageRateErrorRequirement=0.01,
        batteryStorageCapacity=80.0 * 3600 * 2,
        storedCharge_Init=lambda: np.random.uniform(0.4, 1.0) * 80.0 * 3600 * 2,
        u_max=0.2,
        K1=0.5,
        nHat_B=np.array([0, 0, -1]),
        imageTargetMinimumElevation=np.radians(45),
        rwBasePower=20,
        maxWheelSpeed=1500,
        storageInit=lambda: np.random.randint(0, 0.01 * STORE),
        wheelSpeeds=lambda: np.random.uniform(-1, 1, 3),
    )
    return GeneralSatelliteTasking(
        satellites=[CloudSatellite("EO", arguments)],
        terminate_on_time_limit=True,
        scenario=CloudTargets(n_targets),
        rewarder=LinearCloudReward(lambda priority, cover, count: priority / count * (1 - cover / 0.7)),
        sim_rate=0.5,
        max_step_duration=300.0,
        time_limit=95 * 60 * 3,
        failure_penalty=0,
        **QUIET,
    )


class Density(obs.Observation):
    """Sums of a value of targets whose next window closes in each of the next intervals."""

    def __init__(self, value: Callable[[Any], float], intervals: int = 20, norm: float = 5.0, duration: float = 180.0) -> None:
        super().__init__()
        self.value, self.intervals, self.norm, self.duration = value, intervals, norm, duration

    def get_obs(self) -> Any:
        now = self.simulator.sim_time
        self.satellite.calculate_additional_windows(
            now + (self.intervals + 1) * self.duration - self.satellite.window_calculation_time
        )
        soonest = self.satellite.upcoming_opportunities_dict(types="target")
        values = np.array([self.value(target) for target in soonest])
        bins = np.floor((np.array([windows[0][1] for windows in soonest.values()]) - now) / self.duration)
        return np.array([sum(values[bins == k]) for k in range(self.intervals)]) / self.norm


def belief_after(failure: float, forecast: float, seconds: float) -> float:
    """Probability of success after another image, from that of failure before."""
    variation = 0.0 if seconds <= 0 else 1 / (1.0 + np.exp(-2.5 * (seconds / (30 * 60 / 5) - 2.5)))
    return 1 - failure * (1 - (1 - forecast) * variation)


class ReimagedTargets(CloudTargets):
    def regenerate_targets(self) -> None:
        super().regenerate_targets()
        for target in self.targets:
            target.belief = np.random.uniform(0.0, 0.94)
            target.previous = -np.random.uniform(0.0, 5700.0)
            target.belief_at_start, target.previous_at_start = target.belief, target.previous


ENOUGH = 0.95


class BeliefData(Data):
    def __init__(self, imaged: Any = (), complete: Any = (), known: Any = ()) -> None:
        self.imaged, self.complete, self.known = list(imaged), set(complete), set(known)

    def __add__(self, other: Any) -> Any:
        return BeliefData(self.imaged + other.imaged, self.complete | other.complete, self.known | other.known)


class BeliefStore(DataStore):
    data_type = BeliefData

    def get_log_state(self) -> float:
        return self.satellite.dynamics.storageUnit.storageUnitDataOutMsg.read().storedData[0]

    def compare_log_states(self, old_state: Any, new_state: Any) -> BeliefData:
        if new_state <= old_state:
            return BeliefData()
        target, now, before = self.satellite.latest_target, self.satellite.simulator.sim_time, self.satellite.latest_target.belief
        target.belief = belief_after(1 - before, target.forecast, now - target.previous)
        target.previous = now
        return BeliefData([(target, target.belief - before)], [target] if target.belief > ENOUGH else [])


class BeliefReward(GlobalReward):
    data_store_type = BeliefStore

    def __init__(self, alpha: float) -> None:
        super().__init__()
        self.alpha = alpha

    def initial_data(self, satellite: Any) -> BeliefData:
        return BeliefData(known=self.scenario.targets)

    def calculate_reward(self, new_data_dict: Any) -> dict[str, float]:
        reward = {}
        for name, new in new_data_dict.items():
            reward[name] = 0.0
            for target, change in new.imaged:
                if target not in self.data.complete:
                    whole = (1 - self.alpha) * (target in new.complete)
                    reward[name] += target.priority * (whole + change * self.alpha)
        return reward


def cloud_environment_with_reimaging(n_targets: Any = (1000, 10000), alpha: float = 1.0) -> ConstellationTasking:
    def since(sat: Any, opp: Any) -> float:
        return sat.simulator.sim_time - opp["object"].previous

    class BeliefSatellite(sats.ImagingSatellite):
        observation_spec = [
            obs.SatProperties(
                dict(prop="omega_BN_B", norm=0.03),
                dict(prop="c_hat_H"),
                dict(prop="r_BN_P", norm=EARTH),
                dict(prop="v_BN_P", norm=SPEED),
                dict(prop="battery_charge_fraction"),
                dict(prop="s_hat_H", fn=sun_H),
            ),
            obs.Eclipse(norm=ORBIT),
            Density(lambda target: target.forecast),
            obs.OpportunityProperties(
                dict(prop="priority"),
                dict(prop="r_LB_H", norm=EARTH),
                dict(prop="target_angle", norm=np.pi / 2),
                dict(prop="target_angle_rate", norm=0.03),
                dict(prop="opportunity_open", norm=300.0),
                dict(prop="opportunity_close", norm=300.0),
                dict(prop="cloud_forecast", fn=lambda sat, opp: opp["object"].forecast),
                dict(prop="belief", fn=lambda sat, opp: opp["object"].belief, norm=1.0),
                dict(prop="time_since_prev_obs", fn=since, norm=ORBIT),
                dict(
                    prop="belief_expected",
                    fn=lambda sat, opp: belief_after(1 - opp["object"].belief, opp["object"].forecast, since(sat, opp)),
                    norm=1.0,
                ),
                type="target",
                n_ahead_observe=40,
            ),
        ]
        action_spec = [act.Charge(duration=60.0), act.Image(n_ahead_image=40)]
        fsw_type = fsw.SteeringImagerFSWModel

    arguments = BeliefSatellite.default_sat_args(
        imageAttErrorRequirement=0.01,
        imageRateErrorRequirement=0.01,
        batteryStorageCapacity=80.0 * 3600 * 2,
        storedCharge_Init=lambda: np.random.uniform(0.4, 1.0) * 80.0 * 3600 * 2,
        u_max=0.1,
        K1=0.2,
        K3=0.5,
        servo_P=30,
        nHat_B=np.array([0, 0, -1]),
        imageTargetMinimumElevation=np.radians(45),
        rwBasePower=20,
        maxWheelSpeed=1500,
        storageInit=lambda: np.random.randint(0, 0.01 * STORE),
        wheelSpeeds=lambda: np.random.uniform(-1, 1, 3),
        dataStorageCapacity=STORE,
    )
    satellites = [BeliefSatellite(f"EO{k}", arguments) for k in range(5)]
    for satellite in satellites:
        satellite.add_access_filter(lambda opportunity: opportunity["type"] != "target" or opportunity["object"].belief < ENOUGH)
    return ConstellationTasking(
        satellites=satellites,
        scenario=ReimagedTargets(n_targets),
        rewarder=BeliefReward(alpha),
        sat_arg_randomizer=walker_delta_args(altitude=500.0, n_planes=1, inc=45, clustersize=5, clusterspacing=72),
        sim_rate=0.5,
        max_step_duration=300.0,
        time_limit=95 * 60 / 2,
        failure_penalty=0.0,
        **QUIET,
    )


# -- Nadir scanning ------------------------------------------------------------------------------------------------------------


class ScanningDownlinkDynModel(dyn.ContinuousImagingDynModel, dyn.GroundStationDynModel):
    @property
    def instrument_pointing_error(self) -> float:
        return angle(-self.r_BN_P, self.satellite.fsw.c_hat_P)

    @property
    def solar_pointing_error(self) -> float:
        return angle(self.BN.T @ self.satellite.sat_args["nHat_B"], sun_N(self))


SCAN_ARGS = dict(
    dataStorageCapacity=5000 * 8e6,
    storageInit=lambda: np.random.uniform(0.0, 0.8) * 5000 * 8e6,
    instrumentBaudRate=0.5 * 8e6,
    transmitterBaudRate=-50 * 8e6,
    batteryStorageCapacity=200 * 3600,
    storedCharge_Init=lambda: np.random.uniform(0.3, 1.0) * 200 * 3600,
    basePowerDraw=-10.0,
    instrumentPowerDraw=-30.0,
    transmitterPowerDraw=-25.0,
    thrusterPowerDraw=-80.0,
    panelArea=0.25,
    imageAttErrorRequirement=0.1,
    imageRateErrorRequirement=0.1,
    disturbance_vector=lambda: np.random.normal(scale=0.0001, size=3),
    maxWheelSpeed=6000.0,
    wheelSpeeds=lambda: np.random.uniform(-3000, 3000, 3),
    desatAttitude="nadir",
)


def scanner(durations: tuple[float, float, float, float], time: bool) -> type[sats.AccessSatellite]:
    class Scanner(sats.AccessSatellite):
        observation_spec = [
            obs.SatProperties(
                dict(prop="storage_level_fraction"),
                dict(prop="battery_charge_fraction"),
                dict(prop="wheel_speeds_fraction"),
                dict(prop="instrument_pointing_error", norm=np.pi),
                dict(prop="solar_pointing_error", norm=np.pi),
            ),
            obs.OpportunityProperties(
                dict(prop="opportunity_open", norm=5700),
                dict(prop="opportunity_close", norm=5700),
                type="ground_station",
                n_ahead_observe=1,
            ),
            obs.Eclipse(norm=5700),
            *([obs.Time()] if time else []),
        ]
        action_spec = [
            kind(duration=duration)
            for kind, duration in zip((act.Scan, act.Charge, act.Downlink, act.Desat), durations, strict=True)
        ]
        dyn_type = ScanningDownlinkDynModel
        fsw_type = fsw.ContinuousImagingFSWModel

    return Scanner


def scanning_options() -> dict[str, Any]:
    duration = 5 * ORBIT
    return dict(
        scenario=scene.UniformNadirScanning(value_per_second=1 / duration),
        rewarder=data.ScanningTimeReward(),
        time_limit=duration,
        failure_penalty=-1.0,
        terminate_on_time_limit=True,
        **QUIET,
    )


def nadir_scanning(time: bool) -> SatelliteTasking:
    """``rllib_training``, which observes the time, and ``time_discounted_gae``, which does not."""
    return SatelliteTasking(scanner((180.0, 120.0, 60.0, 60.0), time)("Scanner1", SCAN_ARGS), **scanning_options())


def async_multiagent_training() -> ConstellationTasking:
    kind = scanner((150.0, 120.0, 80.0, 45.0), False)
    return ConstellationTasking(
        satellites=[kind(f"Scanner{k + 1}", SCAN_ARGS) for k in range(4)],
        sat_arg_randomizer=walker_delta_args(n_planes=2, altitude=500),
        **scanning_options(),
    )


# -- Agile Earth observation ---------------------------------------------------------------------------------------------------

RICH_TARGET = (
    dict(prop="priority"),
    dict(prop="r_LB_H", norm=800 * 1e3),
    dict(prop="target_angle", norm=np.pi / 2),
    dict(prop="target_angle_rate", norm=0.03),
    dict(prop="opportunity_open", norm=300.0),
    dict(prop="opportunity_close", norm=300.0),
)
ORBITAL = (dict(prop="r_BN_P", norm=EARTH), dict(prop="v_BN_P", norm=SPEED))
IN_HILL = (dict(prop="omega_BH_H", norm=0.03), dict(prop="c_hat_H"), *ORBITAL)

AGILE_SETS: dict[str, tuple[Any, Any]] = {
    "S1": (
        (dict(prop="omega_BP_P", norm=0.03), dict(prop="c_hat_P"), *ORBITAL),
        (dict(prop="priority"), dict(prop="r_LP_P", norm=EARTH)),
    ),
    "S2": (IN_HILL, (dict(prop="priority"), dict(prop="r_LB_H", norm=EARTH))),
    "S3": (IN_HILL, RICH_TARGET),
}

AGILE_ARGS = dict(
    imageAttErrorRequirement=0.01,
    imageRateErrorRequirement=0.01,
    batteryStorageCapacity=80.0 * 3600 * 100,
    storedCharge_Init=80.0 * 3600 * 100.0,
    dataStorageCapacity=200 * 8e6 * 100,
    u_max=0.4,
    imageTargetMinimumElevation=np.arctan(800 / 500),
    K1=0.25,
    K3=3.0,
    omega_max=np.radians(5),
    servo_Ki=5.0,
    servo_P=150 / 5,
    oe=lambda: random_orbit(alt=800),
)

POWER_ARGS = AGILE_ARGS | dict(
    batteryStorageCapacity=120.0 * 3600,
    storedCharge_Init=lambda: 120.0 * 3600 * np.random.uniform(0.4, 1.0),
    rwBasePower=20.4,
    instrumentPowerDraw=-10,
    thrusterPowerDraw=-30,
    nHat_B=np.array([0, 0, -1]),
    wheelSpeeds=lambda: np.random.uniform(-2000, 2000, 3),
    desatAttitude="nadir",
)


def aeos(variant: str) -> SatelliteTasking:
    """``variant`` is S1, S2 or S3, or power."""
    if variant == "power":

        class Agile(sats.ImagingSatellite):
            observation_spec = [
                obs.SatProperties(
                    *IN_HILL,
                    dict(prop="battery_charge_fraction"),
                    dict(prop="wheel_speed_3", fn=lambda sat: np.array(sat.dynamics.wheel_speeds[0:3]) / 630),
                    dict(prop="s_hat_H", fn=sun_H),
                ),
                obs.OpportunityProperties(*RICH_TARGET, type="target", n_ahead_observe=32),
                obs.Eclipse(norm=ORBIT),
                Density(lambda target: target.priority),
            ]
            action_spec = [act.Image(n_ahead_image=32), act.Charge()]
            fsw_type = fsw.SteeringImagerFSWModel
    else:
        satellite, target = AGILE_SETS[variant]

        class Agile(sats.ImagingSatellite):  # type: ignore[no-redef]
            observation_spec = [
                obs.SatProperties(*satellite),
                obs.OpportunityProperties(*target, type="target", n_ahead_observe=32),
            ]
            action_spec = [act.Image(n_ahead_image=32)]
            fsw_type = fsw.SteeringImagerFSWModel

    return SatelliteTasking(
        Agile("EO1", POWER_ARGS if variant == "power" else AGILE_ARGS),
        scenario=scene.UniformTargets(3000),
        rewarder=data.UniqueImageReward(),
        sim_rate=0.5,
        max_step_duration=300.0,
        time_limit=5 * ORBIT,
        failure_penalty=0.0,
        terminate_on_time_limit=True,
        **QUIET,
    )


ALTITUDE = 800.0
PERIOD = 2 * np.pi * np.sqrt((orbitalMotion.REQ_EARTH + ALTITUDE) ** 3 / orbitalMotion.MU_EARTH)


# -- Uncertain places of targets ---------------------------------------------------------------------------------------------


def search_seconds(side: Any, speed: Any) -> Any:
    """Time to sweep a square of a side, m, in swaths of 20 km."""
    return side * np.ceil(side / 20e3) / speed


class AreaTargets(scene.UniformTargets):
    def regenerate_targets(self) -> None:
        super().regenerate_targets()
        for target in self.targets:
            side = np.random.uniform(10.0, 100.0) * 1e3
            target.acquiring_speed = np.random.uniform(3.0, 6.0) * 1e3
            target.search_area, target.search_duration = side**2, search_seconds(side, target.acquiring_speed)
            target.image_time = max(0.0, np.random.normal(target.search_duration / 2, 0.3 * target.search_duration))
            target.speed = np.random.uniform(22e3 / 3600, 46e3 / 3600)
            target.side_at_start, target.image_time_at_start = side, target.image_time


class UncertaintyReward(UniqueImageReward):
    def create_data_store(self, satellite: Any) -> None:
        GlobalReward.create_data_store(self, satellite)  # without the filter of what has been imaged

    def calculate_reward(self, new_data_dict: Any) -> dict[str, float]:
        return {
            name: sum((self.reward_fn(target.priority * target.search_area / (100e3**2)) for target in new.imaged), 0.0)
            for name, new in new_data_dict.items()
        }


class DwellFSWModel(fsw.SteeringImagerFSWModel):
    @action
    def action_image(self, r_LP_P: Any, data_name: str, acquisition: float, allowed: float) -> None:
        self.insControl.controllerStatus = 1
        self.dynamics.instrumentPowerSink.powerStatus = 1
        self.dynamics.imagingTarget.r_LP_P_Init = r_LP_P
        self.dynamics.instrument.nodeDataName = data_name
        self.insControl.imaged = 0
        self.insControl.useDurationImaging = True
        self.insControl.acquisitionTime = macros.sec2nano(acquisition)
        self.insControl.allowedTime = macros.sec2nano(allowed)
        self.simulator.enableTask(self.LocPointTask.name + self.satellite.name)


class UncertainTasking(SatelliteTasking):
    """Areas grow with time; ``dwell`` is the image time of the target that was chosen in the last step."""

    dwell = -1.0

    def step(self, action: int) -> Any:
        chosen = self.satellites[0].parse_target_selection(action)
        self.dwell = chosen.image_time
        result = super().step(action)
        targets = self.scenario.targets  # in their order; that of the set of known ones changes from run to run
        sides = np.sqrt([t.search_area for t in targets]) + np.array([t.speed for t in targets]) * result[-1]["d_ts"]
        seconds = search_seconds(sides, np.array([t.acquiring_speed for t in targets]))
        times = np.maximum(0.0, np.random.normal(seconds / 2, 0.3 * seconds))
        for target, side, duration, time in zip(targets, sides, seconds, times, strict=True):
            target.search_area, target.search_duration, target.image_time = side**2, duration, time
        if result[1] > 0.0:
            chosen.search_area = chosen.search_duration = chosen.image_time = 0.0
        return result


def target_location_uncertainty(n_targets: Any = (1000, 10000)) -> UncertainTasking:
    class Searcher(sats.ImagingSatellite):
        observation_spec = [
            obs.SatProperties(dict(prop="omega_BN_B", norm=0.03), dict(prop="c_hat_H"), *ORBITAL),
            Density(lambda target: target.priority),
            obs.OpportunityProperties(
                dict(prop="priority"),
                dict(prop="r_LB_H", norm=EARTH),
                *RICH_TARGET[2:],
                dict(prop="search_area", fn=lambda sat, opp: opp["object"].search_area, norm=100e3**2),
                type="target",
                n_ahead_observe=32,
            ),
        ]
        action_spec = [act.Image(n_ahead_image=32)]
        dyn_type = dyn.FullFeaturedDynModel
        fsw_type = DwellFSWModel

        def task_target_for_imaging(self, target: Any, max_duration: float | None = None) -> None:
            self.fsw.action_image(target.r_LP_P, self.buffer_name, target.image_time, target.search_duration)
            self.enable_target_window(target, max_duration=max_duration)
            self.latest_target = target

    battery = 1000.0 * 3600 * 2
    arguments = Searcher.default_sat_args(
        oe=lambda: random_orbit(alt=ALTITUDE, i=45),
        imageAttErrorRequirement=0.01,
        imageRateErrorRequirement=0.01,
        batteryStorageCapacity=battery,
        storedCharge_Init=lambda: np.random.uniform(0.4, 1.0) * battery,
        u_max=0.4,
        K1=0.25,
        K3=3.0,
        servo_P=150 / 5,
        nHat_B=np.array([0, 0, -1]),
        omega_max=np.radians(5.0),
        imageTargetMinimumElevation=np.arctan(800 / 500),
        rwBasePower=20,
        maxWheelSpeed=1500,
        storageInit=lambda: np.random.randint(0, 0.01 * STORE),
        wheelSpeeds=lambda: np.random.uniform(-1, 1, 3),
        dataStorageCapacity=STORE,
    )
    return UncertainTasking(
        Searcher("EO", arguments),
        scenario=AreaTargets(n_targets),
        rewarder=UncertaintyReward(),
        sim_rate=0.5,
        max_step_duration=PERIOD,
        time_limit=PERIOD * 3,
        failure_penalty=0.0,
        **QUIET,
    )


# -- Curriculum --------------------------------------------------------------------------------------------------------------


class CurriculumTasking(SatelliteTasking):
    """Battery and torque follow ``difficulty``, 0 to 1, from the next reset on."""

    difficulty = 0.0

    def reset(self, seed: int | None = None, options: Any = None) -> Any:
        np.random.seed(seed)
        torque = np.random.normal(size=3)
        battery = 400 * 3600 * (1.0 - 0.6 * self.difficulty)
        self.satellites[0].sat_args_generator |= dict(
            batteryStorageCapacity=battery,
            storedCharge_Init=np.random.uniform(0.375, 0.625) * battery,
            disturbance_vector=torque / np.linalg.norm(torque) * 0.0002 * (1.0 + 7.0 * self.difficulty),
        )
        return super().reset(seed=seed, options=options)


def curriculum_learning() -> CurriculumTasking:
    class CurriculumDynModel(dyn.GroundStationDynModel, dyn.ContinuousImagingDynModel):
        pass

    class Scanner(sats.AccessSatellite):
        observation_spec = [
            obs.SatProperties(
                dict(prop="wheel_speeds_fraction"),
                dict(prop="battery_charge_fraction"),
                dict(prop="storage_level_fraction"),
                dict(prop="attitude_error_norm", fn=lambda sat: angle(-np.array(sat.dynamics.r_BN_P), sat.fsw.c_hat_P) / np.pi),
                dict(
                    prop="solar_angle_norm",
                    fn=lambda sat: angle(sat.dynamics.BN.T @ np.array([0, 0, -1]), sun_N(sat.dynamics)) / np.pi,
                ),
            ),
            obs.Eclipse(norm=ORBIT),
            obs.OpportunityProperties(
                dict(prop="opportunity_open", norm=ORBIT),
                dict(prop="opportunity_close", norm=ORBIT),
                type="ground_station",
                n_ahead_observe=1,
            ),
        ]
        action_spec = [kind(duration=180.0) for kind in (act.Scan, act.Charge, act.Downlink, act.Desat)]
        dyn_type = CurriculumDynModel
        fsw_type = fsw.ContinuousImagingFSWModel

    arguments = dict(
        imageAttErrorRequirement=0.1,
        imageRateErrorRequirement=0.1,
        dataStorageCapacity=5000 * 8e6,
        instrumentPowerDraw=-30.0,
        instrumentBaudRate=0.5e6,
        transmitterPowerDraw=-25.0,
        transmitterBaudRate=-112.0e6,
        rwMechToElecEfficiency=0.0,
        rwElecToMechEfficiency=0.5,
        thrusterPowerDraw=-80.0,
        rwBasePower=10.0,
        maxWheelSpeed=6000,
        desatAttitude="nadir",
        K=3.5,
        Ki=-1,
        P=17.5,
        panelEfficiency=0.2,
    )
    duration = 90 * 180
    return CurriculumTasking(
        Scanner("Scanner1", arguments),
        scenario=scene.UniformNadirScanning(value_per_second=1 / duration),
        rewarder=data.ScanningTimeReward(),
        time_limit=duration,
        failure_penalty=-1.0,
        **QUIET,
    )


# -- Shields -----------------------------------------------------------------------------------------------------------------


def training_with_shield(n_targets: Any = (100, 3000), least: float = 0.4, most: float = 1.0) -> SatelliteTasking:
    """``least`` and ``most`` are the ends of the range of the initial charge."""

    class Shielded(sats.ImagingSatellite):
        observation_spec = [
            obs.SatProperties(
                dict(prop="omega_BN_B", norm=0.03),
                dict(prop="c_hat_H"),
                *ORBITAL,
                dict(prop="battery_charge_fraction"),
                dict(prop="storage_level_fraction"),
                dict(prop="wheel_speeds_fraction"),
                dict(prop="s_hat_H", fn=sun_H),
            ),
            obs.OpportunityProperties(
                dict(prop="opportunity_open", norm=ORBIT),
                dict(prop="opportunity_close", norm=ORBIT),
                type="ground_station",
                n_ahead_observe=1,
            ),
            obs.Eclipse(norm=ORBIT),
            Density(lambda target: target.priority),
            obs.OpportunityProperties(
                dict(prop="priority"), dict(prop="r_LB_H", norm=EARTH), *RICH_TARGET[2:], type="target", n_ahead_observe=32
            ),
        ]
        action_spec = [act.Charge(duration=60.0), act.Downlink(), act.Desat(duration=60.0), act.Image(n_ahead_image=32)]
        dyn_type = dyn.FullFeaturedDynModel
        fsw_type = fsw.SteeringImagerFSWModel

    arguments = dict(
        oe=lambda: random_orbit(alt=ALTITUDE, i=45),
        imageAttErrorRequirement=0.01,
        imageRateErrorRequirement=0.01,
        u_max=0.4,
        K1=0.25,
        K3=3.0,
        servo_P=150 / 5,
        omega_max=np.radians(5.0),
        imageTargetMinimumElevation=np.arctan(800 / 500),
        rwBasePower=20,
        transmitterPacketSize=0,
        batteryStorageCapacity=80.0 * 3600 * 2,
        storedCharge_Init=lambda: np.random.uniform(least, most) * 80.0 * 3600 * 2,
        maxWheelSpeed=1500,
        wheelSpeeds=lambda: np.random.uniform(-750, 750, 3),
        dataStorageCapacity=2 * 8e6 * 25,
        storageInit=lambda: np.random.randint(0, 0.99 * 2 * 8e6 * 25),
    )
    return SatelliteTasking(
        Shielded("EarthObserving", arguments),
        scenario=scene.UniformTargets(n_targets),
        rewarder=data.UniqueImageReward(),
        time_limit=np.floor(PERIOD * 3),
        failure_penalty=0.0,
        sim_rate=0.5,
        max_step_duration=300.0,
        **QUIET,
    )


def allowed_by_rule(env: SatelliteTasking, observation: np.ndarray) -> np.ndarray:
    """Actions that the page's rule allows, [35] booleans; the rule reads the observation."""
    names = env.satellite.observation_builder.obs_array_keys()
    charge = observation[names.index("sat_props.battery_charge_fraction")]
    start, end = (observation[names.index(f"eclipse[{k}]")] for k in (0, 1))
    wheels = [observation[names.index(f"sat_props.wheel_speeds_fraction[{k}]")] for k in range(3)]
    draw = (end - start) % 1
    needed = 0.25 if draw < start else 0.25 + draw - start
    mask = np.ones(35, dtype=bool)
    if not end < start and charge < needed:
        mask[:] = np.arange(35) == 0
    elif np.abs(wheels).max() > 0.7:
        mask[:] = np.arange(35) == 2
    return mask


# -- Faults ------------------------------------------------------------------------------------------------------------------

FOUR_AXES = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [3**-0.5] * 3]


def fault_environment(literal: bool) -> SatelliteTasking:
    """Four wheels, of which one fails at the start; ``literal`` as the page has it, otherwise with five corrections.

    The page connects no command to the camera, disturbs by 1 N m, slows wheels with a gain of 0.3, steers with gains that are
    unstable in ticks of 0.5 s, and reads three wheels.
    """

    class FourWheels(dyn.FullFeaturedDynModel):
        @property
        def solar_angle_norm(self) -> float:
            return angle(self.BN.T @ np.array([0, 0, -1]), sun_N(self)) / np.pi

        @property
        def wheel_speeds(self) -> np.ndarray:
            return np.array(self.rwStateEffector.rwSpeedOutMsg.read().wheelSpeeds)[: 3 if literal else 4]

        @property
        def wheel_speeds_frac(self) -> np.ndarray:
            return self.wheel_speeds / (self.maxWheelSpeed * macros.rpm2radsec)

        @default_args(wheelSpeeds=lambda: np.random.uniform(-1500, 1500, 4), maxWheelSpeed=np.inf, u_max=0.200)
        def setup_reaction_wheel_dyn_effector(
            self, wheelSpeeds: Any, maxWheelSpeed: float, u_max: float, priority: int = 997, **kwargs: Any
        ) -> None:
            self.maxWheelSpeed, self.rwFactory = maxWheelSpeed, simIncludeRW.rwFactory()
            self.rwStateEffector = reactionWheelStateEffector.ReactionWheelStateEffector()
            for axis, speed in zip(FOUR_AXES, wheelSpeeds, strict=True):
                self.rwFactory.create("Honeywell_HR16", axis, maxMomentum=50.0, Omega=speed).u_max = u_max
            self.rwFactory.addToSpacecraft(self.scObject.ModelTag, self.rwStateEffector, self.scObject)
            self.simulator.AddModelToTask(self.task_name, self.rwStateEffector, ModelPriority=priority)

    base = fsw.SteeringImagerFSWModel

    class NullMotion(base):  # type: ignore[misc, valid-type]
        def _set_config_msgs(self) -> None:
            super()._set_config_msgs()
            payload, elements = messaging.RWConstellationMsgPayload(), []
            payload.numRW = len(FOUR_AXES)
            for axis, wheel in zip(FOUR_AXES, self.dynamics.rwFactory.rwList.values(), strict=True):
                element = messaging.RWConfigElementMsgPayload()
                element.gsHat_B, element.Js, element.uMax = axis, wheel.Js, wheel.u_max
                elements.append(element)
            payload.reactionWheels = elements
            self.constellation = messaging.RWConstellationMsg().write(payload)

        def _set_gateway_msgs(self) -> None:
            if literal:  # the page's copy of this method leaves out what ImagingFSWModel adds: the command to the camera
                fsw.BasicFSWModel._set_gateway_msgs(self)
            else:
                super()._set_gateway_msgs()
            self.dynamics.rwStateEffector.rwMotorCmdInMsg.subscribeTo(self.rwNullSpace.rwMotorTorqueOutMsg)

        class MRPControlTask(base.MRPControlTask):
            def _create_module_data(self) -> None:
                super()._create_module_data()
                self.rwNullSpace = self.fsw.rwNullSpace = rwNullSpace.rwNullSpace()

            def _setup_fsw_objects(self, **kwargs: Any) -> None:
                super()._setup_fsw_objects(**kwargs)
                self.rwNullSpace.rwMotorTorqueInMsg.subscribeTo(self.rwMotorTorque.rwMotorTorqueOutMsg)
                self.rwNullSpace.rwSpeedsInMsg.subscribeTo(self.fsw.dynamics.rwStateEffector.rwSpeedOutMsg)
                self.rwNullSpace.rwConfigInMsg.subscribeTo(self.fsw.constellation)
                self.rwNullSpace.OmegaGain = 0.3 if literal else 0.03
                self._add_model_to_task(self.rwNullSpace, priority=1193)

    class Faulty(sats.ImagingSatellite):
        observation_spec = [
            obs.SatProperties(
                dict(prop="omega_BP_P", norm=0.03),
                dict(prop="c_hat_P"),
                *ORBITAL,
                dict(prop="battery_charge_fraction"),
                dict(prop="solar_angle_norm"),
                dict(prop="wheel_speeds_frac"),
            ),
            obs.OpportunityProperties(
                dict(prop="priority"),
                dict(prop="r_LP_P", norm=EARTH),
                dict(prop="target_angle", norm=np.pi),
                type="target",
                n_ahead_observe=32,
            ),
            obs.Time(),
            obs.Eclipse(norm=ORBIT),
        ]
        action_spec = [act.Desat(duration=60.0), act.Charge(duration=60.0), act.Image(n_ahead_image=32)]
        dyn_type, fsw_type = FourWheels, NullMotion

        def reset_post_sim_init(self) -> None:
            super().reset_post_sim_init()
            self.simulator.createNewEvent(
                "powerFault",
                self.dynamics.dyn_rate,
                True,
                conditionTime=0,
                actionFunction=lambda sim: setattr(self.dynamics.rwFactory.rwList["RW1"], "P_max", 1.0),
            )

    arguments = Faulty.default_sat_args(
        oe=random_orbit,
        imageAttErrorRequirement=0.01,
        imageRateErrorRequirement=0.01,
        batteryStorageCapacity=80.0 * 3600 * 2,
        storedCharge_Init=lambda: np.random.uniform(0.4, 1.0) * 80.0 * 3600 * 2,
        u_max=0.2,
        **(dict(K1=0.5) if literal else dict(K1=0.3, servo_P=55.0)),
        nHat_B=np.array([0, 0, -1]),
        imageTargetMinimumElevation=np.radians(45),
        rwBasePower=20,
        maxWheelSpeed=1500,
        storageInit=lambda: np.random.randint(0, 0.01 * STORE),
        wheelSpeeds=lambda: np.random.uniform(-900, 900, 4),
        disturbance_vector=lambda: random_unit_vector() * (1.0 if literal else 1e-4),
    )
    return SatelliteTasking(
        satellite=Faulty("EO", arguments),
        terminate_on_time_limit=True,
        scenario=scene.UniformTargets(n_targets=1000),
        rewarder=data.UniqueImageReward(),
        sim_rate=0.5,
        max_step_duration=300.0,
        time_limit=95 * 60 * 3,
        failure_penalty=0,
        **QUIET,
    )


# -- Mixed environment -------------------------------------------------------------------------------------------------


def mixed_environment() -> ConstellationTasking:
    """An inspection and imaging side by side, each a scenario with a channel of rewards; the page images an RSO instead."""

    class GroundObserver(sats.ImagingSatellite):
        observation_spec = [
            obs.SatProperties(dict(prop="storage_level_fraction"), dict(prop="r_BN_P", norm=7e6)),
            obs.OpportunityProperties(dict(prop="priority"), dict(prop="opportunity_close", norm=300.0), n_ahead_observe=4),
            obs.Time(),
        ]
        action_spec = [act.Image(4, max_duration=120.0), act.Charge(duration=60.0)]
        dyn_type = dyn.GroundStationDynModel
        fsw_type = fsw.ImagingFSWModel

    class RSO(sats.Satellite):
        observation_spec = [obs.Time()]
        action_spec = [act.NadirPoint(duration=1e9)]
        dyn_type = dyn.RSODynModel
        fsw_type = fsw.FSWModel

    class Inspector(sats.Satellite):
        observation_spec = [
            obs.SatProperties(dict(prop="wheel_speeds_fraction")),
            obs.RelativeProperties(dict(prop="r_DC_Hc", norm=100.0), dict(prop="v_DC_Hc"), chief_name="RSO"),
            obs.Time(),
        ]
        action_spec = [
            act.DiscreteFSWAction("action_inspect_rso", name="inspect", duration=60.0),
            act.Charge(duration=60.0),
        ]
        dyn_type = dyn.RSOInspectorDynModel
        fsw_type = (fsw.BasicFSWModel, fsw.RSOInspectorFSWModel)

    camera = dict(imageAttErrorRequirement=0.1, imageRateErrorRequirement=0.1, u_max=0.8)
    near = dict(imageAttErrorRequirement=1.0, imageRateErrorRequirement=None, instrumentBaudRate=1.0, dataStorageCapacity=1e6)
    start = {"Inspector": lambda: np.array([*np.random.uniform(-60.0, 60.0, 3), *np.random.uniform(-0.3, 0.3, 3)])}
    return ConstellationTasking(
        satellites=[GroundObserver("Ground", camera), RSO("RSO"), Inspector("Inspector", near)],
        scenario=scene.MixedScenario(
            {
                "ground_scene": scene.UniformTargets(1000),
                "rso_scene": scene.SphericalRSO(n_points=100, theta_max=1.4, theta_solar_max=1.5),
            },
            {"ground_scene": ["Ground"], "rso_scene": ["RSO", "Inspector"]},
        ),
        rewarder=data.MixedReward(
            {
                "ground_images": data.UniqueImageReward(),
                "inspection": data.RSOInspectionReward(completion_bonus=1.0, completion_threshold=0.6),
            },
            {"ground_images": ["Ground"], "inspection": ["Inspector"]},
            {"ground_images": "ground_scene", "inspection": "rso_scene"},
        ),
        communicator=comm.FreeCommunication(),
        sat_arg_randomizer=relative_to_chief("RSO", lambda: random_orbit(a=7000.0), start),
        time_limit=ORBIT,
        **QUIET,
    )


# -- Space-to-space imaging of RSOs ------------------------------------------------------------------------------------


def catalog(seed: int) -> scene.RSOTargetCatalog:
    """Three targets, one above the other."""
    rng, targets = np.random.default_rng(seed), []
    for k in range(3):
        elements = orbitalMotion.ClassicElements()
        elements.a, elements.e, elements.Omega, elements.omega = 7.2e6 + k * 1e5, 0.0, 0.0, 0.0
        elements.i, elements.f = np.radians(rng.uniform(0.0, 90.0)), rng.uniform(0.0, 0.1)
        r_N, v_N = orbitalMotion.elem2rv(orbitalMotion.MU_EARTH * 1e9, elements)
        targets.append(scene.RSOTarget(f"rso-{83 + 17 * k}", f"object_{k}", r_N, v_N, priority=k + 1.0))
    return scene.RSOTargetCatalog(tuple(targets))


def space_to_space_rso_imaging(amos: bool, seed: int = 0) -> ConstellationTasking:
    """An imager and the catalog of a seed, with the compact profile of the page or that of its research."""
    candidates = 10 if amos else 3
    compact = [
        obs.SatProperties(dict(prop="storage_level_fraction")),
        obs.RSOTargetProperties(
            *(dict(prop=name) for name in ("valid", "priority", "target_distance", "target_illumination_factor")),
            n_ahead_observe=candidates,
        ),
    ]
    full = [
        obs.SatProperties(
            dict(prop="storage_level_fraction"),
            dict(prop="battery_charge_fraction"),
            dict(prop="wheel_speeds_fraction"),
            dict(prop="s_hat_H", fn=sun_H),
        ),
        obs.Eclipse(norm=ORBIT),
        obs.OpportunityProperties(
            dict(prop="opportunity_open", norm=ORBIT),
            dict(prop="opportunity_close", norm=ORBIT),
            type="ground_station",
            n_ahead_observe=2,
        ),
        obs.RSOTargetProperties(n_ahead_observe=candidates),
    ]

    class Imager(sats.AccessSatellite):
        observation_spec = full if amos else compact
        action_spec = [
            act.Charge(duration=300.0 if amos else 60.0),
            act.Downlink(duration=300.0 if amos else 90.0),
            act.Desat(duration=150.0 if amos else 60.0),
            act.ImageRSO(candidates, max_duration=300.0, min_pointing_hold_s=10.0, require_illumination_during_hold=False),
        ]
        dyn_type = (dyn.SpaceToSpaceImagingDynModel, dyn.GroundStationDynModel)
        fsw_type = fsw.SpaceToSpaceImagingFSWModel

    class Passive(sats.Satellite):
        observation_spec, action_spec = [obs.Time()], [act.Drift(duration=1e9)]
        dyn_type, fsw_type = dyn.RSOTargetDynModel, fsw.FSWModel

    arguments = dict(
        oe=random_circular_orbit(i=45.0, alt=600.0, Omega=0.0, f=0.0),
        sigma_init=[0.0, 0.0, 0.0],
        omega_init=[0.0, 0.0, 0.0],
        wheelSpeeds=[0.0, 0.0, 0.0],
        maxWheelSpeed=6000.0,
        batteryStorageCapacity=1e9,
        storedCharge_Init=1e9,
    )
    if amos:
        arguments |= dict(
            imageAttErrorRequirement=0.0025,
            imageRateErrorRequirement=0.01,
            dataStorageCapacity=50 * 4e6,
            instrumentBaudRate=4e6,
            transmitterBaudRate=-4e6,
            batteryStorageCapacity=500 * 3600.0,
            storedCharge_Init=500 * 3600.0,
            basePowerDraw=-10.0,
            instrumentPowerDraw=-30.0,
            transmitterPowerDraw=-25.0,
            thrusterPowerDraw=-80.0,
            panelArea=1.0,
            desatAttitude="sun",
        )
    weights = (0.9, 0.1) if amos else (0.0, 1.0)
    targets = catalog(seed)
    return ConstellationTasking(
        satellites=[*(Passive(target.satellite_name) for target in targets.targets), Imager("imager", arguments)],
        scenario=scene.RSOTargets(targets, ["imager"]),
        rewarder=data.RSOImageReward(
            acquisition_reward_fn=lambda record, target: weights[0] * target.priority,
            delivery_reward_fn=lambda record, target: weights[1] * target.priority,
        ),
        world_args=dict(utc_init="2026 JUN 21 00:00:00.000 (UTC)"),
        time_limit=6000.0,  # the page's 1200 s are over before most deliveries
        max_step_duration=300.0,
        **QUIET,
    )
