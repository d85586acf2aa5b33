"""Methods of bsk_rl's models that declare arguments."""

from bsk_torch.sim import dyn, fsw, world
from bsk_torch.tasks.objects.dyn import SpaceToSpaceImagingDynModel

Methods = dict[str, str]
"""Names of methods, with the arguments that they declare, separated by spaces."""

DYN: dict[type, Methods] = {
    dyn.DynamicsModel: {
        "_utc_init": "utc_init",
        "setup_spacecraft_hub": "mass width depth height sigma_init omega_init rN vN oe mu min_orbital_radius",
    },
    dyn.DisturbanceTorqueDynModel: {"setup_disturbance_torque": "disturbance_vector"},
    dyn.AtmosphericDragDynModel: {"setup_drag_effector": "dragCoeff panelArea"},
    dyn.BasicDynamicsModel: {
        "setup_battery": "batteryStorageCapacity storedCharge_Init",
        "setup_power_sink": "basePowerDraw",
        "setup_reaction_wheel_dyn_effector": "wheelSpeeds maxWheelSpeed u_max",
        "setup_reaction_wheel_power": "rwBasePower rwMechToElecEfficiency rwElecToMechEfficiency",
        "setup_solar_panel": "panelArea panelEfficiency nHat_B",
        "setup_thruster_power": "thrusterPowerDraw",
    },
    dyn.ImagingDynModel: {
        "setup_imaging_target": "groundLocationPlanetRadius imageTargetMinimumElevation imageTargetMaximumRange",
        "setup_instrument": "instrumentBaudRate",
        "setup_instrument_power_sink": "instrumentPowerDraw",
        "setup_storage_unit": "dataStorageCapacity bufferNames storageUnitValidCheck storageInit",
        "setup_transmitter": "transmitterBaudRate transmitterNumBuffers transmitterPacketSize",
        "setup_transmitter_power_sink": "transmitterPowerDraw",
    },
    dyn.ContinuousImagingDynModel: {
        "setup_imaging_target": "imageTargetMaximumRange",
        "setup_storage_unit": "dataStorageCapacity storageUnitValidCheck storageInit",
    },
    SpaceToSpaceImagingDynModel: {"setup_imaging_target": "imageTargetMaximumRange"},
    dyn.LOSCommDynModel: {"setup_los_comms": "losMaximumRange"},
    dyn.ConjunctionDynModel: {"setup_conjunctions": "conjunction_radius conjunction_check_rate"},
    dyn.MaxRangeDynModel: {"setup_range": "max_range_radius chief_name enforce_range_on_chief"},
}
"""Arguments of dynamics models."""

FSW: dict[type, Methods] = {fsw.MagicOrbitalManeuverFSWModel: {"setup_fuel": "dv_available_init"}}
"""Arguments of flight-software models."""

TASKS: dict[type, dict[str, Methods]] = {
    fsw.BasicFSWModel: {
        "MRPControlTask": {"setup_mrp_feedback_rwa": "K Ki P"},
        "RWDesatTask": {
            "setup_momentum_dumping": "hs_min maxCounterValue thrMinFireTime desatAttitude",
            "setup_thruster_mapping": "controlAxes_B thrForceSign",
        },
    },
    fsw.SteeringFSWModel: {"MRPControlTask": {"setup_mrp_steering_rwa": "K1 K3 omega_max servo_Ki servo_P"}},
    fsw.ImagingFSWModel: {
        "LocPointTask": {
            "setup_instrument_controller": "imageAttErrorRequirement imageRateErrorRequirement",
            "setup_location_pointing": "inst_pHat_B",
        }
    },
}
"""Arguments of the tasks of flight-software models; a model's task takes the place of that of its bases."""

WORLD: dict[type, Methods] = {
    world.WorldModel: {"setup_gravity_bodies": "utc_init"},
    world.AtmosphereWorldModel: {"setup_atmosphere_density_model": "planetRadius baseDensity scaleHeight"},
    world.GroundStationWorldModel: {
        "setup_ground_locations": "groundStationsData groundLocationPlanetRadius gsMinimumElevation gsMaximumRange"
    },
}
"""Arguments of world models."""
