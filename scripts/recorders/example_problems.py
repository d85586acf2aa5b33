"""The problems of bsk_rl's documentation on bsk_rl 1.3.8, for ``record_examples.py``: those that ``examples/bsk_rl`` defines.

The examples run with bsk_rl's names in place of bsk_torch's (:func:`example`). What they compute on tensors or store in tables is
written here in bsk_rl's terms, and so are distributions whose numbers NumPy draws otherwise. Where a page needs an older or a
later bsk_rl, the same problem is written for 1.3.8: the cloud environment reads names of buffers that are gone, explicit world
models do not fit the dynamics, and norms of None stand for an orbital period, 5700 s here.
"""

from __future__ import annotations

import builtins
import functools
import sys
from collections.abc import Mapping
from pathlib import Path
from types import ModuleType, SimpleNamespace
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
from bsk_rl.utils import orbital
from bsk_rl.utils.functional import default_args
from bsk_rl.utils.orbital import random_orbit, random_unit_vector

import bsk_torch
import bsk_torch.sim

EXAMPLES = Path(__file__).parents[2] / "examples" / "bsk_rl"
QUIET = {"log_level": "ERROR"}


# -- Examples on bsk_rl --------------------------------------------------------------------------------------------------


class Theirs:
    """A module of bsk_torch with bsk_rl's names where bsk_rl has them."""

    def __init__(self, ours: ModuleType, **theirs: Any) -> None:
        self.__dict__ |= theirs
        self.ours = ours

    def __getattr__(self, name: str) -> Any:
        return getattr(self.ours, name)


def single(num_envs: int, **options: Any) -> SatelliteTasking:
    """An environment of one satellite."""
    return SatelliteTasking(**options, **QUIET)


def several(num_envs: int, joint: bool = False, **options: Any) -> GeneralSatelliteTasking:
    """An environment of several satellites."""
    return (GeneralSatelliteTasking if joint else ConstellationTasking)(**options, **QUIET)


DISTRIBUTIONS = SimpleNamespace(
    Distribution=object,
    Uniform=lambda *ends: lambda: np.random.uniform(*ends),
    Normal=lambda *numbers: lambda: np.random.normal(*numbers),
    random_orbit=lambda **elements: lambda: random_orbit(**elements),
    random_circular_orbit=lambda **elements: lambda: orbital.random_circular_orbit(**elements),
    random_unit_vector=lambda: random_unit_vector,
)
"""The distributions of ``bsk_torch.rand`` that the examples use, as functions that draw a value."""

THEIRS = {
    "bsk_torch": Theirs(
        bsk_torch,
        SatelliteTasking=single,
        ConstellationTasking=several,
        act=act,
        comm=comm,
        data=data,
        formations=orbital,
        obs=obs,
        rand=DISTRIBUTIONS,
        sats=sats,
        scene=Theirs(bsk_torch.scene, **vars(scene)),
    ),
    "bsk_torch.sim": SimpleNamespace(dyn=Theirs(bsk_torch.sim.dyn, **vars(dyn)), fsw=fsw),
}


@functools.cache
def example(name: str) -> ModuleType:
    """A file of ``examples/bsk_rl`` as a module on bsk_rl, as far as it does not compute with tensors."""

    def imported(module: str, *context: Any) -> Any:
        if module in THEIRS:
            return THEIRS[module]
        return example(module) if (EXAMPLES / f"{module}.py").exists() else __import__(module, *context)

    page, path = ModuleType(name), EXAMPLES / f"{name}.py"
    sys.modules[name] = page
    page.__builtins__ = vars(builtins) | {"__import__": imported}
    exec(compile(path.read_text(), path, "exec"), vars(page))
    return page


def compute(properties: obs.SatProperties, functions: Mapping[str, Any]) -> None:
    """Let observed properties be computed by ``functions`` of the satellite, by their names."""
    for given in properties.obs_properties:
        if given["prop"] in functions:
            given["fn"] = functions[given["prop"]]


# -- What several problems observe -----------------------------------------------------------------------------------------


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


def solar_angle_norm(model: Any) -> float:
    """Between the side opposite to the instrument and the Sun, over pi."""
    return angle(model.BN.T @ np.array([0, 0, -1]), sun_N(model)) / np.pi


class Density(obs.Observation):
    """Sums of a value of targets whose next window closes in each of the next intervals."""

    def __init__(self, intervals: int, norm: float) -> None:
        super().__init__()
        self.intervals, self.norm, self.duration = intervals, norm, 180.0

    def value(self, target: Any) -> float:
        return target.priority

    def get_obs(self) -> Any:
        now = self.simulator.sim_time
        self.satellite.calculate_additional_windows(
            now + (self.intervals + 1) * self.duration - self.satellite.window_calculation_time
        )
        soonest = self.satellite.upcoming_opportunities_dict(types="target")
        values = np.array([self.value(target) for target in soonest])
        bins = np.floor((np.array([windows[0][1] for windows in soonest.values()]) - now) / self.duration)
        return np.array([sum(values[bins == k]) for k in range(self.intervals)]) / self.norm


AGILE = example("aeos")
AGILE.Density, AGILE.s_hat_H = Density, sun_H  # which other examples import


# -- Getting started, configuration, several satellites --------------------------------------------------------------------


def simple_environment() -> SatelliteTasking:
    return example("simple_environment").make(sat_args=dict(storageInit=lambda: np.random.uniform(0.25, 0.75) * 1e10))


def configuration(part: str) -> SatelliteTasking:
    page = example("satellite_configuration")
    page.BespokeFSWModel.meaning_of_life = 42
    compute(page.CustomSatPropsSatellite.observation_spec[0], {"meaning_of_life": lambda sat: 42})
    return page.make(part, obs_type=np.ndarray)


def multiagent_envs(joint: bool) -> GeneralSatelliteTasking:
    page = example("multiagent_envs")
    page.ImagingSatellite.dyn_type = dyn.FullFeaturedDynModel  # record_examples.py kills in another way
    return page.make(joint=joint)


def communication_action() -> ConstellationTasking:
    return example("communication_action").make()


def mixed_environment() -> ConstellationTasking:
    """An inspection and imaging side by side, each a scenario with a channel of rewards; the page images an RSO instead."""
    return example("mixed_environment").make()


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

CHARGED_AND_EMPTY = dict(
    storedCharge_Init=lambda: np.random.uniform(0.4, 1.0) * 80.0 * 3600 * 2,
    storageInit=lambda: np.random.randint(0, 0.01 * STORE),
)
"""Arguments that several problems draw."""


def cloud_environment(n_targets: Any = (1000, 10000)) -> GeneralSatelliteTasking:
    page = example("cloud_environment")
    page.CustomDynModel.solar_angle_norm = property(solar_angle_norm)
    page.CustomSatComposed.observation_spec[3] = obs.OpportunityProperties(
        dict(prop="priority"),
        dict(fn=lambda sat, opp: opp["object"].forecast),
        dict(fn=lambda sat, opp: opp["object"].sigma),
        type="target",
        n_ahead_observe=32,
    )
    drawn = CHARGED_AND_EMPTY | dict(oe=random_orbit)
    return page.make(sat_args=drawn, scenario=CloudTargets(n_targets), rewarder=LinearCloudReward(page.linear))


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

    page = example("cloud_environment_with_reimaging")
    page.CloudCoverDensity.value = lambda self, target: target.forecast
    *_, ahead = page.BeliefSatellite.observation_spec
    for function, given in zip(
        (
            lambda sat, opp: opp["object"].forecast,
            lambda sat, opp: opp["object"].belief,
            since,
            lambda sat, opp: belief_after(1 - opp["object"].belief, opp["object"].forecast, since(sat, opp)),
        ),
        ahead.target_properties[-4:],
        strict=True,
    ):
        given["fn"] = function
    page.SAT_ARGS |= CHARGED_AND_EMPTY
    page.CloudTargets, page.BeliefReward = lambda targets: ReimagedTargets(n_targets), BeliefReward
    env = page.make(alpha=alpha)
    for satellite in env.satellites:
        satellite.add_access_filter(lambda opportunity: opportunity["type"] != "target" or opportunity["object"].belief < ENOUGH)
    return env


# -- Nadir scanning ------------------------------------------------------------------------------------------------------------

SCANNING = example("rllib_training")
SCANNING.SAT_ARGS |= dict(
    storageInit=lambda: np.random.uniform(0.0, 0.8) * 5000 * 8e6,
    storedCharge_Init=lambda: np.random.uniform(0.3, 1.0) * 200 * 3600,
)
SCANNING.ScanningDownlinkDynModel.instrument_pointing_error = property(
    lambda model: angle(-model.r_BN_P, model.satellite.fsw.c_hat_P)
)
SCANNING.ScanningDownlinkDynModel.solar_pointing_error = property(
    lambda model: angle(model.BN.T @ model.satellite.sat_args["nHat_B"], sun_N(model))
)


def nadir_scanning(time: bool) -> SatelliteTasking:
    """``rllib_training``, which observes the time, and ``time_discounted_gae``, which does not."""
    return (SCANNING if time else example("time_discounted_gae")).make()


def async_multiagent_training() -> ConstellationTasking:
    return example("async_multiagent_training").make()


# -- Agile Earth observation ---------------------------------------------------------------------------------------------------


def aeos(variant: str) -> SatelliteTasking:
    """``variant`` is S1, S2 or S3, or power."""
    drawn = dict(oe=lambda: random_orbit(alt=800))
    if variant == "power":
        drawn["storedCharge_Init"] = lambda: 120.0 * 3600 * np.random.uniform(0.4, 1.0)
    return AGILE.make(variant, sat_args=drawn)


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
    """Areas grow with time; ``dwell`` is the image time of the target chosen in the last step."""

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
            obs.SatProperties(dict(prop="omega_BN_B", norm=0.03), dict(prop="c_hat_H"), *AGILE.ORBIT),
            Density(intervals=20, norm=5),
            obs.OpportunityProperties(
                dict(prop="priority"),
                dict(prop="r_LB_H", norm=orbitalMotion.REQ_EARTH * 1e3),
                *AGILE.WHERE_AND_WHEN[2:],
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
    page = example("curriculum_learning")
    functions = {
        "attitude_error_norm": lambda sat: angle(-np.array(sat.dynamics.r_BN_P), sat.fsw.c_hat_P) / np.pi,
        "solar_angle_norm": lambda sat: solar_angle_norm(sat.dynamics),
    }
    compute(page.ScanningSatellite.observation_spec[0], functions)
    duration = 90 * 180
    return CurriculumTasking(
        page.ScanningSatellite("Scanner1", page.SAT_ARGS),
        scenario=scene.UniformNadirScanning(value_per_second=1 / duration),
        rewarder=data.ScanningTimeReward(),
        time_limit=duration,
        failure_penalty=-1.0,
        **QUIET,
    )


# -- Shields -----------------------------------------------------------------------------------------------------------------


def training_with_shield(n_targets: Any = (100, 3000), least: float = 0.4, most: float = 1.0) -> SatelliteTasking:
    """``least`` and ``most`` are the ends of the range of the initial charge."""
    drawn = dict(
        oe=lambda: random_orbit(alt=ALTITUDE, i=45),
        storedCharge_Init=lambda: np.random.uniform(least, most) * 80.0 * 3600 * 2,
        storageInit=lambda: np.random.randint(0, 0.99 * 2 * 8e6 * 25),
    )
    return example("training_with_shield").make(sat_args=drawn, scenario=scene.UniformTargets(n_targets))


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
        solar_angle_norm = property(solar_angle_norm)

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

    page = example("fault_environment")

    class Faulty(page.FaultySatellite):
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

    arguments = page.SAT_ARGS | (page.LITERAL if literal else {}) | CHARGED_AND_EMPTY
    arguments |= dict(oe=random_orbit, disturbance_vector=lambda: random_unit_vector() * (1.0 if literal else 1e-4))
    return SatelliteTasking(
        satellite=Faulty("EO", {name: value for name, value in arguments.items() if name not in ("wheels", "nullSpaceGain")}),
        terminate_on_time_limit=True,
        scenario=scene.UniformTargets(n_targets=1000),
        rewarder=data.UniqueImageReward(),
        sim_rate=0.5,
        max_step_duration=300.0,
        time_limit=95 * 60 * 3,
        failure_penalty=0,
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


def space_to_space_rso_imaging(profile: str, seed: int = 0) -> ConstellationTasking:
    """An imager and the catalog of a seed, with the compact profile of the page or that of its research."""

    class Passive(sats.Satellite):
        observation_spec, action_spec = [obs.Time()], [act.Drift(duration=1e9)]
        dyn_type, fsw_type = dyn.RSOTargetDynModel, fsw.FSWModel

    page, targets = example("space_to_space_rso_imaging"), catalog(seed)
    imager, arguments, acquired, delivered = page.PROFILES[profile]
    return ConstellationTasking(
        satellites=[*(Passive(target.satellite_name) for target in targets.targets), imager("imager", arguments)],
        scenario=scene.RSOTargets(targets, ["imager"]),
        rewarder=data.RSOImageReward(
            acquisition_reward_fn=lambda record, target: acquired * target.priority,
            delivery_reward_fn=lambda record, target: delivered * target.priority,
        ),
        world_args=dict(utc_init=page.EPOCH),
        time_limit=6000.0,  # the page's 1200 s are over before most deliveries
        max_step_duration=300.0,
        **QUIET,
    )
