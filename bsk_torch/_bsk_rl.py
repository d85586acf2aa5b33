"""Modules and names of bsk_rl: each is looked up in bsk_torch, or raises an error with a replacement.

``MODULES`` lists what bsk_rl 1.3.8 has, with the modules of bsk_torch in which its names are looked up; modules that bsk_torch
does not have come into being when they are imported. ``ADVICE`` lists names that bsk_torch does not have. Reading one raises
ImportError, also of a module that exists: ``from ... import name`` would replace the message of an AttributeError by its own.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Sequence
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
from types import ModuleType
from typing import Any

ROOT = "bsk_torch"

MODULES: dict[str, tuple[str, str]] = {
    "": ("", "NO_ACTION ConstellationTasking GeneralSatelliteTasking SatelliteTasking"),
    "act": (
        "",
        "Action AttitudeSetpoint ContinuousAction ImpulsiveThrust ImpulsiveThrustHill Broadcast Charge Desat DiscreteAction "
        "DiscreteFSWAction Downlink Drift Image NadirPoint Scan ImageRSO",
    ),
    "act.actions": ("act", "select_action_builder ActionBuilder Action"),
    "act.continuous_actions": (
        "act",
        "ContinuousActionBuilder ContinuousAction ImpulsiveThrust ImpulsiveThrustHill AttitudeSetpoint",
    ),
    "act.discrete_actions": (
        "act",
        "DiscreteActionBuilder DiscreteAction DiscreteFSWAction Charge Drift NadirPoint Desat Downlink Scan Image Broadcast",
    ),
    "act.rso_imaging": ("act", "ImageRSO"),
    "comm": (
        "",
        "BroadcastCommunication CommunicationMethod FreeCommunication LOSCommunication LOSMultiCommunication "
        "MultiDegreeCommunication NoCommunication",
    ),
    "comm.communication": (
        "comm",
        "CommunicationMethod NoCommunication FreeCommunication LOSCommunication MultiDegreeCommunication LOSMultiCommunication "
        "BroadcastCommunication",
    ),
    "data": (
        "",
        "GlobalReward MixedData MixedDataStore MixedReward ScanningTimeReward NoReward ResourceReward RSOImageData "
        "RSOImageRecord RSOImageReward RSOImageStore RSOInspectionReward UniqueImageReward",
    ),
    "data.base": ("data", "LogStateType Data DataStore GlobalReward"),
    "data.composition": ("data", "ComposedData ComposedDataStore ComposedReward MixedData MixedDataStore MixedReward"),
    "data.nadir_data": ("data", "ScanningTime ScanningTimeStore ScanningTimeReward"),
    "data.no_data": ("data", "NoData NoDataStore NoReward"),
    "data.resource_data": ("data", "ResourceData ResourceDataStore ResourceReward"),
    "data.rso_imaging": ("data", "RSOImageData RSOImageStore RSOImageReward"),
    "data.rso_inspection": ("data", "RSO INSPECTOR RSOInspectionData RSOInspectionDataStore RSOInspectionReward"),
    "data.unique_image_data": ("data", "UniqueImageData UniqueImageStore UniqueImageReward"),
    "gym": (
        ". env env.no_action",
        "SatObs SatAct MultiSatObs MultiSatAct SatArgRandomizer NO_ACTION is_no_action no_action_like no_action_keep_indices "
        "GeneralSatelliteTasking SatelliteTasking ConstellationTasking",
    ),
    "obs": (
        "",
        "Eclipse Observation OpportunityProperties ResourceRewardWeight SatProperties Time RelativeProperties "
        "RSOTargetProperties",
    ),
    "obs.observations": (
        "obs",
        "nested_obs_to_space ObservationBuilder Observation SatProperties Time OpportunityProperties Eclipse "
        "ResourceRewardWeight",
    ),
    "obs.relative_observations": (
        "obs.relative_observations",
        "r_DC_N r_DC_C r_DC_D r_DC_Hc r_DC_Hd v_DC_N v_DC_C v_DC_D v_DC_Hc v_DC_Hd sigma_DC sigma_DHc sigma_HdC sigma_HdHc "
        "rso_sigma_BH rso_omega_BH rso_imaged_regions RelativeProperties",
    ),
    "obs.rso_imaging": ("obs", "target_properties RSOTargetProperties"),
    "sats": ("", "AccessSatellite ImagingSatellite Satellite"),
    "sats.access_satellite": ("sats", "SatObs SatAct AccessSatellite ImagingSatellite"),
    "sats.satellite": ("sats", "SatObs SatAct Satellite"),
    "scene": (
        "",
        "MixedScenario RSOPoints SphericalRSO RSOPriorityEvent RSOTarget RSOTargetCatalog RSOTargets Scenario "
        "UniformNadirScanning CityTargets UniformTargets",
    ),
    "scene.composition": ("scene", "MixedScenario"),
    "scene.rso_points": ("scene", "RSOPoint RSOPoints SphericalRSO"),
    "scene.rso_targets": ("scene", "RSOTarget RSOPriorityEvent RSOTargetCatalog RSOTargets"),
    "scene.scenario": ("scene", "Scenario UniformNadirScanning"),
    "scene.targets": ("scene", "Target UniformTargets CityTargets"),
    "sim": ("sim.simulator", "Simulator"),
    "sim.dyn": (
        "",
        "AtmosphericDragDynModel BasicDynamicsModel DisturbanceTorqueDynModel DynamicsModel DynamicsModelABC EclipseDynModel "
        "ContinuousImagingDynModel GroundStationDynModel ImagingDynModel ConjunctionDynModel LOSCommDynModel MaxRangeDynModel "
        "RSOTargetDynModel SpaceToSpaceImagingDynModel RSODynModel RSOInspectorDynModel FullFeaturedDynModel",
    ),
    "sim.dyn.base": (
        "sim.dyn",
        "DynamicsModelABC DynamicsModel EclipseDynModel DisturbanceTorqueDynModel AtmosphericDragDynModel BasicDynamicsModel",
    ),
    "sim.dyn.ground_imaging": ("sim.dyn", "ImagingDynModel ContinuousImagingDynModel GroundStationDynModel"),
    "sim.dyn.relative_motion": ("sim.dyn", "LOSCommDynModel ConjunctionDynModel MaxRangeDynModel"),
    "sim.dyn.rso_imaging": ("sim.dyn", "RSOTargetDynModel SpaceToSpaceImagingDynModel"),
    "sim.dyn.rso_inspection": ("sim.dyn", "RSODynModel RSOInspectorDynModel"),
    "sim.fsw": (
        "",
        "BasicFSWModel FSWModel FSWModelABC SteeringFSWModel Task action ContinuousImagingFSWModel ImagingFSWModel "
        "SteeringImagerFSWModel MagicOrbitalManeuverFSWModel SpaceToSpaceImagingFSWModel RSOInspectorFSWModel",
    ),
    "sim.fsw.base": ("sim.fsw", "action Task FSWModelABC FSWModel BasicFSWModel SteeringFSWModel"),
    "sim.fsw.ground_imaging": ("sim.fsw", "ImagingFSWModel ContinuousImagingFSWModel SteeringImagerFSWModel"),
    "sim.fsw.orbital": ("sim.fsw", "MagicOrbitalManeuverFSWModel"),
    "sim.fsw.rso_imaging": ("sim.fsw", "SpaceToSpaceImagingFSWModel"),
    "sim.fsw.rso_inspection": ("sim.fsw", "RSOInspectorFSWModel"),
    "sim.simulator": ("", "Simulator"),
    "sim.world": ("", "WorldModelABC WorldModel EclipseWorldModel AtmosphereWorldModel GroundStationWorldModel"),
    "utils": ("", ""),
    "utils.actuator_primitives": ("initial", "balancedHR16Triad idealMonarc1Octet"),
    "utils.attitude": ("initial", "random_tumble hill_frame_attitude"),
    "utils.functional": (
        "sim.dyn",
        "valid_func_name safe_dict_merge default_args collect_default_args vectorize_nested_dict aliveness_checker "
        "check_aliveness_checkers is_property mock_safe_bases remove_duplicate_bases remove_inherited_bases compose_types "
        "AbstractClassProperty Resetable",
    ),
    "utils.logging_config": ("", "style_string SimFormatter ContextFilter"),
    "utils.orbital": (
        "rand astro.relative astro.orbit formations",
        "random_unit_vector random_orbit random_circular_orbit random_epoch elevation walker_delta walker_delta_args "
        "relative_to_chief TrajectorySimulator lla2ecef rv2HN rv2omega cd2hill hill2cd fibonacci_sphere",
    ),
    "utils.rllib": (
        ". wrappers.metrics wrappers.rllib",
        "ConstellationTasking GeneralSatelliteTasking SatelliteTasking EpisodeDataParallelWrapper EpisodeDataWrapper "
        "load_torch_mlp_policy unpack_config",
    ),
    "utils.rllib.callbacks": (
        "wrappers.metrics wrappers.rllib",
        "EpisodeDataCallbacks MultiagentEpisodeDataCallbacks WrappedEpisodeDataCallbacks EpisodeDataLogger EpisodeDataWrapper "
        "EpisodeDataParallelWrapper",
    ),
    "utils.rllib.discounting": (
        "wrappers.rllib",
        "ContinuePreviousAction ContinuePreviousActionAppended MakeAddedStepActionValid CondenseMultiStepActions "
        "compute_value_targets_time_discounted TimeDiscountedGAEPPOLearner TimeDiscountedGAEPPOTorchLearner "
        "TimeDiscountedGAEPPOTfLearner",
    ),
    "utils.rso_imaging": ("data", "RSOImageRecord CandidateSnapshot target_geometry candidate_snapshot illumination_factor"),
    "utils.vizard": ("", "visualize get_color VIZARD_PATH"),
}
"""Modules of bsk_rl below its root (``sim.world`` is a module here too): where their names are here, and which ones there are."""

RSO = (
    "is of bsk_rl's satellites as targets, which bsk_torch.bsk_rl has. Here targets are orbits without satellites: "
    "scene.RSOTargets with its candidates(), views() and candidate_ids()"
)
STORES = (
    "is not needed: rewarders keep tensors of all episodes (env.rewarder.imaged, .known, .cum_reward). Others derive from "
    "data.GlobalReward and define read_log() and calculate_reward(before, after). For one episode it is in "
    "bsk_torch.bsk_rl.data; bsk_torch.per_environment(rewarder) runs rewarders of that package"
)
BUILDERS = "is not needed: environments build actions and observations from action_spec and observation_spec"
TYPES = "is a type for annotations of bsk_rl: write torch.Tensor"
DISCOUNT = (
    "is for RLlib's learners. bsk_torch's PPO and MAPPO discount by seconds ('bsk-torch train'), TorchRL's estimators with "
    "'duration' as steps_to_next_obs; examples/ppo_cleanrl.py shows it by hand"
)
PICTURES = "is for Vizard. env.render() draws the Earth and the satellites (extra viz)"
LOGS = "is not needed: log_level= and log_dir= of an environment set the logger 'bsk_torch' up; see bsk_torch.env.log"
COMPOSE = "is not needed: dyn_type, fsw_type and world_type take tuples, as dyn_type = (dyn.ImagingDynModel, dyn.LOSCommDynModel)"
PLAIN = "is a helper of bsk_rl's inside that has no counterpart: plain Python does the same"

GROUPS: dict[str, str] = {
    RSO: "target_properties RSOTargetDynModel CandidateSnapshot target_geometry candidate_snapshot illumination_factor",
    STORES: "RSOImageData RSOImageStore LogStateType ComposedData ComposedDataStore MixedData MixedDataStore ResourceData "
    "ResourceDataStore RSOInspectionDataStore Data DataStore NoData NoDataStore ScanningTime ScanningTimeStore UniqueImageStore",
    BUILDERS: "select_action_builder ActionBuilder ContinuousActionBuilder DiscreteActionBuilder ObservationBuilder "
    "nested_obs_to_space",
    TYPES: "SatObs SatAct MultiSatObs MultiSatAct SatArgRandomizer",
    DISCOUNT: "ContinuePreviousAction ContinuePreviousActionAppended MakeAddedStepActionValid CondenseMultiStepActions "
    "compute_value_targets_time_discounted TimeDiscountedGAEPPOLearner TimeDiscountedGAEPPOTorchLearner "
    "TimeDiscountedGAEPPOTfLearner",
    PICTURES: "visualize get_color VIZARD_PATH",
    LOGS: "style_string SimFormatter ContextFilter",
    COMPOSE: "compose_types mock_safe_bases remove_duplicate_bases remove_inherited_bases",
    PLAIN: "valid_func_name safe_dict_merge vectorize_nested_dict is_property AbstractClassProperty RSO INSPECTOR",
}

ADVICE: dict[str, str] = {name: advice for advice, names in GROUPS.items() for name in names.split()} | {
    "DiscreteAction": "is act.Action here: define decide(), which returns modes and durations of all environments",
    "DynamicsModelABC": "is dyn.DynamicsModel here",
    "WorldModelABC": "is world.WorldModel here",
    "FSWModelABC": "is fsw.FSWModel here",
    "default_args": "declares arguments in bsk_rl; here a Component lists them, args=(Arg(name, default, unit, meaning),): see "
    "docs/how_to/own_component.md",
    "collect_default_args": "is default_sat_args() of a satellite class here",
    "check_aliveness_checkers": "is satellite.is_alive() here, and satellite.aliveness() for each check",
    "Resetable": "has four hooks in bsk_rl; here values of an episode are tensors that are declared once and reset with it: "
    "fleet.memory.declare(name, initial_value)",
    "idealMonarc1Octet": "makes Basilisk's thrusters, which dyn.BasicDynamicsModel has: act.Desat fires them",
    "TrajectorySimulator": "looks ahead along an orbit; here satellites do: satellite.find_next_opportunities(n), "
    "satellite.find_windows(until), satellite.next_eclipse()",
    "WrappedEpisodeDataCallbacks": "needs Ray, in its own environment: pip install 'ray[rllib]==2.60.0'",
    "load_torch_mlp_policy": "loads a checkpoint of RLlib's: RLModule.from_checkpoint of Ray, as in examples/ppo_rllib.py",
    "EpisodeDataCallbacks": "is deprecated in bsk_rl: wrap the environment in EpisodeDataWrapper",
    "MultiagentEpisodeDataCallbacks": "is deprecated in bsk_rl: wrap the environment in EpisodeDataParallelWrapper",
}
"""Names of bsk_rl that bsk_torch does not have: what they are, and what to write instead."""


class NotInBskTorchError(ImportError):
    """A name of bsk_rl that bsk_torch does not have."""


def place(module: str) -> str:
    """Return the full name of a module here, given below the root: ``bsk_torch.sim.dyn`` for ``sim.dyn``; "." is the root."""
    return f"{ROOT}.{module}" if module.strip(".") else ROOT


def lookup(module: str, name: str) -> Any:
    """Return what ``bsk_rl.<module>.<name>`` is here.

    Raises:
        NotInBskTorchError: For a name of bsk_rl that is not here; the message suggests a replacement.
        AttributeError: For a name that bsk_rl does not have either.
    """
    if f"{module}.{name}".lstrip(".") in MODULES:
        return importlib.import_module(place(f"{module}.{name}".lstrip(".")))
    homes, names = MODULES[module]
    if name in names.split():
        for home in homes.split():
            found = vars(importlib.import_module(place(home)))
            if name in found:
                return found[name]
        if name in ADVICE:
            raise NotInBskTorchError(f"{place(module)}.{name}: bsk_rl's {name} {ADVICE[name]}", name=place(module))
    raise AttributeError(f"module {place(module)!r} has no attribute {name!r}")


def _reader(module: str, before: Callable[[str], Any] | None) -> Callable[[str], Any]:
    """Return a module's ``__getattr__``, which asks the one it had ``before`` first."""

    def read(name: str) -> Any:
        if before is not None:
            try:
                return before(name)
            except AttributeError:
                pass
        return lookup(module, name)

    return read


class _Maker(Loader):
    """Makes a module of bsk_rl that has no file here."""

    def __init__(self, module: str) -> None:
        """Keep its name below the root."""
        self.module = module

    def create_module(self, spec: ModuleSpec) -> None:
        """Let the import system make an empty module."""

    def exec_module(self, module: ModuleType) -> None:
        """Let the module look its names up; where they are is imported, for what that registers."""
        homes, names = MODULES[self.module]
        for home in homes.split():
            importlib.import_module(place(home))
        module.__doc__ = f"Names of ``bsk_rl.{self.module}``, which are at {', '.join(map(place, homes.split()))}."
        module.__dict__["__getattr__"] = _reader(self.module, None)
        module.__dict__["__dir__"] = lambda: [name for name in names.split() if name not in ADVICE]


class _Answering(Loader):
    """Loads a module of ours that also answers for names of bsk_rl."""

    def __init__(self, module: str, loader: Loader) -> None:
        """Keep its name below the root, and how to load it."""
        self.module, self.loader = module, loader

    def __getattr__(self, name: str) -> Any:
        """Return what else the loader has, such as the source."""
        return getattr(self.loader, name)

    def create_module(self, spec: ModuleSpec) -> ModuleType | None:
        """Make the module as the loader does."""
        return self.loader.create_module(spec)

    def exec_module(self, module: ModuleType) -> None:
        """Run the module, and let it look names of bsk_rl up."""
        self.loader.exec_module(module)
        module.__dict__["__getattr__"] = _reader(self.module, module.__dict__.get("__getattr__"))


class _Finder(MetaPathFinder):
    """Finds modules of bsk_rl: ours, which also answer for its names, and those that no file makes."""

    def find_spec(self, name: str, path: Sequence[str] | None, target: ModuleType | None = None) -> ModuleSpec | None:
        """Return how to make a module of bsk_rl; None for all others."""
        root, _, module = name.partition(".")
        if root != ROOT or module not in MODULES:
            return None
        ours = PathFinder.find_spec(name, path, target)
        if ours is not None and ours.loader is not None:
            ours.loader = _Answering(module, ours.loader)
            return ours
        package = any(other.startswith(f"{module}.") for other in MODULES)
        return ModuleSpec(name, _Maker(module), is_package=package)


def install() -> None:
    """Make modules of bsk_rl importable, and let those that exist here answer for names that they do not have.

    To be called before any of them is imported.
    """
    sys.meta_path.insert(0, _Finder())
