"""Record flights of spacecraft with their own bodies, wheels, thrusters, panels and faults again, on Basilisk through bsk_rl.

Usage::

    python scripts/recorders/record_craft.py                        # every file, into tests/basilisk/recordings
    python scripts/recorders/record_craft.py craft_skewed           # only this one
    python scripts/recorders/record_craft.py --list

See ``recording.py`` for what it needs. What flies, and which rows are kept, is read from the present files: ``craft``,
``sat_args`` and ``time``, which were drawn once. Everything else is recorded again. ``loads`` is the CubeSat of the file
``craft_cubesat`` in a lower orbit, with ``LOADS``; ``navigation`` is that CubeSat with errors of navigation.
``tests/basilisk/README.md`` describes the arrays.
"""

from __future__ import annotations

import json
from typing import Any

import numpy as np
from Basilisk.architecture import messaging
from Basilisk.fswAlgorithms import rwNullSpace
from Basilisk.simulation import (
    GravityGradientEffector,
    MtbEffector,
    facetDragDynamicEffector,
    facetSRPDynamicEffector,
    magneticFieldCenteredDipole,
    reactionWheelStateEffector,
    simpleSolarPanel,
    thrusterDynamicEffector,
)
from Basilisk.utilities import macros, simIncludeRW, simIncludeThruster, simSetPlanetEnvironment
from bsk_rl import SatelliteTasking, act, data, obs, sats, scene
from bsk_rl.sim import dyn, fsw
from recording import RECORDINGS, Array, record_files

CASES = ("skewed", "offset", "six", "cubesat", "power", "steering", "loads", "navigation")
ACTIONS = ("scan", "charge", "desat", "downlink", "nadir", "drift")
NUDGE = 1e-13  # change of the initial attitude of the twin

Craft = dict[str, Any]

SIZE, REFLECTED = (0.2, 0.1, 0.34), ((0.2, 0.1), (0.0, 0.7))
"""Sides of the CubeSat, m, and shares of light that its sides and its panel reflect diffusely and as a mirror does."""


def surfaces() -> list[tuple[Any, ...]]:
    """Area, drag coefficient, normal, position, and both shares of light, of the six sides and both faces of a panel."""
    found: list[tuple[Any, ...]] = []
    for k, sign in ((k, sign) for k in range(3) for sign in (1.0, -1.0)):
        normal = [sign * float(k == j) for j in range(3)]
        place = [0.5 * size * n for size, n in zip(SIZE, normal, strict=True)]
        found.append((np.prod(SIZE) / SIZE[k], 2.2, normal, place, *REFLECTED[0]))
    for sign in (1.0, -1.0):
        found.append((0.06, 2.0, [0.0, 0.6 * sign, 0.8 * sign], [0.25, 0.02, -0.1], *REFLECTED[1]))
    return found


LOADS = {
    "gravity_gradient": True,
    "facets": [list(surface[:4]) for surface in surfaces()],
    "reflection": [list(surface[4:]) for surface in surfaces()],
    "bars": {"axes": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.6, 0.0, 0.8]], "max": [0.2, 0.3, 0.25]},
    "dipoles": [[0.1, -0.2, 0.05], [0.5, 0.0, -0.5], [0.0, 0.3, 0.2], [-0.2, -0.1, 0.0], [0.0, 0.0, 0.0]],
    "actions": [[120.0 * k, name, 120.0] for k, name in enumerate(("nadir", "charge", "desat", "drift", "scan"))],
}
"""What pushes the CubeSat of ``loads``, and the dipoles commanded at the start of each action, A m^2."""


def navigation() -> dict[str, Any]:
    """Matrix, bounds and seed of the errors of ``navigation``, which depend on one another and reach some of their bounds."""
    deviations = np.repeat([0.05, 1e-4, 2e-6, 5e-7, 1e-3, 1e-4], 3)
    mixed = np.eye(18) + 0.3 * np.random.default_rng(7).standard_normal((18, 18)) / np.sqrt(18.0)
    bounds = np.repeat([0.6, 0.0, 2e-5, 1e-5, 0.0, 0.0], 3)
    return {"P": (deviations[:, None] * mixed).tolist(), "bounds": bounds.tolist(), "seed": 20261125}


LOW = 6638.0e3  # its distance from the Earth's center, m


def column(values: Any) -> list[list[float]]:
    """Numbers as the 3 x 1 lists that Basilisk wants."""
    return np.asarray(values, float).reshape(3, 1).tolist()


def fail(sim: Any, dynamics: Any, fault: dict[str, Any]) -> None:
    """Change the attribute or message of Basilisk that a fault means."""
    k, value = fault["index"], fault["value"]
    if fault["kind"] == "battery":
        payload = messaging.PowerStorageFaultMsgPayload(faultCapacityRatio=value)
        dynamics.battery_fault.write(payload, sim.sim_time_ns)
    else:
        raise ValueError(f"fault {fault['kind']} of part {k} is not recorded here")


def dynamics_of(craft: Craft) -> type:
    """Dynamics model of a spacecraft."""
    wheels, panels = craft["wheels"], craft["panels"] or []

    class Dyn(dyn.ContinuousImagingDynModel, dyn.GroundStationDynModel):
        def _setup_dynamics_objects(self, **kwargs: Any) -> None:
            super()._setup_dynamics_objects(**kwargs)
            if craft["hub"]:
                self.I_mat, hub = craft["hub"]["inertia"], self.scObject.hub
                hub.mHub, hub.r_BcB_B = craft["hub"]["mass"], column(craft["hub"]["com"])
                hub.IHubPntBc_B = np.reshape(craft["hub"]["inertia"], (3, 3)).tolist()
            for node, wheel in zip(self.rwPowerList, wheels, strict=True):
                node.basePowerNeed = wheel["base"]
                node.mechToElecEfficiency, node.elecToMechEfficiency = wheel["mech_to_elec"], wheel["elec_to_mech"]
            self._add_panels()
            if craft["gravity_gradient"]:
                self.gradient = GravityGradientEffector.GravityGradientEffector()
                self.gradient.addPlanetName(self.world.gravFactory.gravBodies["earth"].planetName)
                self.scObject.addDynamicEffector(self.gradient)
                self.simulator.AddModelToTask(self.task_name, self.gradient, ModelPriority=995)
            if craft.get("reflection"):
                self._add_sunlight()
            if craft.get("bars"):
                self._add_bars()
            if craft["nav"]:
                nav = self.simpleNavObject
                nav.PMatrix, nav.walkBounds, nav.RNGSeed = (craft["nav"][name] for name in ("P", "bounds", "seed"))
                nav.crossTrans = nav.crossAtt = True
            payload = messaging.PowerStorageFaultMsgPayload(faultCapacityRatio=1.0)
            self.battery_fault = messaging.PowerStorageFaultMsg().write(payload)
            self.powerMonitor.batteryFaultInMsg.subscribeTo(self.battery_fault)

        def _add_sunlight(self) -> None:
            self.sunlight = facetSRPDynamicEffector.FacetSRPDynamicEffector()
            self.sunlight.setNumFacets(len(craft["facets"]))
            for (area, _, normal, place), shares in zip(craft["facets"], craft["reflection"], strict=True):
                self.sunlight.addFacet(area, np.eye(3).tolist(), column(normal), column([1, 0, 0]), column(place), *shares)
            self.sunlight.sunInMsg.subscribeTo(self.world.gravFactory.spiceObject.planetStateOutMsgs[self.world.sun_index])
            self.sunlight.sunEclipseInMsg.subscribeTo(self.world.eclipseObject.eclipseOutMsgs[self.eclipse_index])
            self.scObject.addDynamicEffector(self.sunlight)
            self.simulator.AddModelToTask(self.task_name, self.sunlight, ModelPriority=994)

        def _add_bars(self) -> None:
            self.magnetic = magneticFieldCenteredDipole.MagneticFieldCenteredDipole()
            simSetPlanetEnvironment.centeredDipoleMagField(self.magnetic, "earth")
            self.magnetic.addSpacecraftToModel(self.scObject.scStateOutMsg)
            self.magnetic.planetPosInMsg.subscribeTo(self.world.gravFactory.spiceObject.planetStateOutMsgs[self.world.body_index])
            self.simulator.AddModelToTask(self.world.world_task_name, self.magnetic, ModelPriority=900)
            bars, config = craft["bars"], messaging.MTBArrayConfigMsgPayload()
            config.numMTB, config.maxMtbDipoles = len(bars["max"]), bars["max"]
            config.GtMatrix_B = np.transpose(bars["axes"]).flatten().tolist()
            self.bar_config = messaging.MTBArrayConfigMsg().write(config)
            self.bar_command = messaging.MTBCmdMsg().write(messaging.MTBCmdMsgPayload())
            self.bars = MtbEffector.MtbEffector()
            self.bars.mtbParamsInMsg.subscribeTo(self.bar_config)
            self.bars.mtbCmdInMsg.subscribeTo(self.bar_command)
            self.bars.magInMsg.subscribeTo(self.magnetic.envOutMsgs[0])
            self.scObject.addDynamicEffector(self.bars)
            self.simulator.AddModelToTask(self.task_name, self.bars, ModelPriority=993)

        def command_bars(self, dipoles: list[float]) -> None:
            """Write the dipoles of the bars, A m^2, as flight software would."""
            payload = messaging.MTBCmdMsgPayload(mtbDipoleCmds=dipoles)
            self.bar_command.write(payload, self.simulator.sim_time_ns)

        def _add_panels(self) -> None:
            made = [self.solarPanel]
            for _ in panels[1:]:
                panel = simpleSolarPanel.SimpleSolarPanel()
                panel.stateInMsg.subscribeTo(self.scObject.scStateOutMsg)
                panel.sunEclipseInMsg.subscribeTo(self.world.eclipseObject.eclipseOutMsgs[self.eclipse_index])
                sun = self.world.gravFactory.spiceObject.planetStateOutMsgs[self.world.sun_index]
                panel.sunInMsg.subscribeTo(sun)
                self.simulator.AddModelToTask(self.task_name, panel, ModelPriority=898)
                self.powerMonitor.addPowerNodeToModel(panel.nodePowerOutMsg)
                made.append(panel)
            for panel, given in zip(made, panels, strict=False):
                panel.setPanelParameters(column(given["n"]), given["area"], given["efficiency"])
            self.panels = made

        def setup_reaction_wheel_dyn_effector(self, priority: int = 997, **kwargs: Any) -> None:
            self.maxWheelSpeed = np.inf
            self.rwStateEffector = reactionWheelStateEffector.ReactionWheelStateEffector()
            self.rwFactory = simIncludeRW.rwFactory()
            for wheel in wheels:
                rw = self.rwFactory.create("custom", wheel["axis"], Omega=wheel["speed"], Js=wheel["Js"], u_max=1.0)
                for name in ("Omega_max", "u_max", "u_min", "P_max", "fCoulomb", "fStatic", "betaStatic", "cViscous"):
                    setattr(rw, name, wheel[name])
            self.rwFactory.addToSpacecraft("ReactionWheels", self.rwStateEffector, self.scObject)
            self.simulator.AddModelToTask(self.task_name, self.rwStateEffector, ModelPriority=priority)

        def setup_thruster_dyn_effector(self, priority: int = 996) -> None:
            if craft["thrusters"] is None:
                super().setup_thruster_dyn_effector(priority)
                return
            self.thrusterSet = thrusterDynamicEffector.ThrusterDynamicEffector()
            self.thrFactory = simIncludeThruster.thrusterFactory()
            for thruster in craft["thrusters"]:
                place = thruster["r"], thruster["d"]
                self.thrFactory.create("MOOG_Monarc_1", *place, MaxThrust=thruster["thrust"])
            self.thrFactory.addToSpacecraft("ACSThrusterDynamics", self.thrusterSet, self.scObject)
            self.simulator.AddModelToTask(self.task_name, self.thrusterSet, ModelPriority=priority)

        def setup_drag_effector(self, priority: int = 999, **kwargs: Any) -> None:
            if not craft["facets"]:
                super().setup_drag_effector(**kwargs)
                return
            self.dragEffector = facetDragDynamicEffector.FacetDragDynamicEffector()
            for facet in craft["facets"]:
                self.dragEffector.addFacet(*facet)
            self.dragEffector.atmoDensInMsg.subscribeTo(self.world.densityModel.envOutMsgs[-1])
            self.scObject.addDynamicEffector(self.dragEffector)
            self.simulator.AddModelToTask(self.task_name, self.dragEffector, ModelPriority=priority)

        setup_drag_effector.defaults = dyn.AtmosphericDragDynModel.setup_drag_effector.defaults  # type: ignore[attr-defined]

    return Dyn


def flight_software_of(craft: Craft) -> type:
    """Flight software of a spacecraft: it knows wheels and center of mass, and records messages."""
    control, wheels = craft["control"], craft["wheels"]
    null_gain = control["null_gain"]
    bases = (fsw.SteeringFSWModel, fsw.ContinuousImagingFSWModel) if craft["steering"] else (fsw.ContinuousImagingFSWModel,)

    class Fsw(*bases):  # type: ignore[misc]
        def _set_vehicle_config_msg(self) -> None:
            vehicle = messaging.VehicleConfigMsgPayload()
            vehicle.ISCPntB_B, vehicle.CoM_B = self.dynamics.I_mat, (craft["hub"] or {"com": [0, 0, 0]})["com"]
            self.vcConfigMsg = messaging.VehicleConfigMsg().write(vehicle)

        def _set_config_msgs(self) -> None:
            super()._set_config_msgs()
            payload, elements = messaging.RWConstellationMsgPayload(), []
            payload.numRW = len(wheels)
            for wheel in wheels:
                element = messaging.RWConfigElementMsgPayload()
                element.gsHat_B, element.Js, element.uMax = wheel["axis"], wheel["Js"], wheel["u_max"]
                elements.append(element)
            payload.reactionWheels = elements
            self.constellation = messaging.RWConstellationMsg().write(payload)

        def _set_gateway_msgs(self) -> None:
            super()._set_gateway_msgs()
            if null_gain is not None:
                self.dynamics.rwStateEffector.rwMotorCmdInMsg.subscribeTo(self.rwNullSpace.rwMotorTorqueOutMsg)

        class MRPControlTask(bases[0].MRPControlTask):  # type: ignore[name-defined]
            def _create_module_data(self) -> None:
                super()._create_module_data()
                if null_gain is not None:
                    self.rwNullSpace = self.fsw.rwNullSpace = rwNullSpace.rwNullSpace()

            def _setup_fsw_objects(self, **kwargs: Any) -> None:
                super()._setup_fsw_objects(**kwargs)
                speeds = self.fsw.dynamics.rwStateEffector.rwSpeedOutMsg
                law = self.servo if craft["steering"] else self.mrpFeedbackControl
                law.knownTorquePntB_B = control["known_torque"]
                if control["wheels"]:
                    law.rwParamsInMsg.subscribeTo(self.fsw.fswRwConfigMsg)
                    law.rwSpeedsInMsg.subscribeTo(speeds)
                if control["limit"] is not None:
                    law.integralLimit = control["limit"]
                if null_gain is not None:
                    self.rwNullSpace.rwMotorTorqueInMsg.subscribeTo(self.rwMotorTorque.rwMotorTorqueOutMsg)
                    self.rwNullSpace.rwSpeedsInMsg.subscribeTo(speeds)
                    self.rwNullSpace.rwConfigInMsg.subscribeTo(self.fsw.constellation)
                    self.rwNullSpace.OmegaGain = null_gain
                    self._add_model_to_task(self.rwNullSpace, priority=1193)

        def __init__(self, *args: Any, **kwargs: Any) -> None:
            super().__init__(*args, **kwargs)
            simulator, dynamics = self.simulator, self.dynamics
            task = simulator.CreateNewTask("LogTask", macros.sec2nano(simulator.sim_rate))
            simulator.CreateNewProcess("Log", 0).addTask(task)
            command = self.rwNullSpace if null_gain is not None else self.rwMotorTorque
            messages = {
                "sc": dynamics.scObject.scStateOutMsg,
                "battery": dynamics.powerMonitor.batPowerOutMsg,
                "cmd": command.rwMotorTorqueOutMsg,
                "thr": self.thrDump.thrusterOnTimeOutMsg,
                "att": dynamics.simpleNavObject.attOutMsg,
                "trans": dynamics.simpleNavObject.transOutMsg,
                "store": dynamics.storageUnit.storageUnitDataOutMsg,
                "lit": self.world.eclipseObject.eclipseOutMsgs[dynamics.eclipse_index],
                **{f"rw{k}": message for k, message in enumerate(dynamics.rwStateEffector.rwOutMsgs)},
            }
            if craft.get("bars"):
                messages["field"] = dynamics.magnetic.envOutMsgs[0]
            self.log = {name: message.recorder() for name, message in messages.items()}
            for recorder in self.log.values():
                simulator.AddModelToTask("LogTask", recorder)

    return Fsw


def satellite_class(craft: Craft) -> type:
    """Class of a spacecraft, a new one for each flight: bsk_rl keeps composed classes."""

    class Recorded(sats.AccessSatellite):
        observation_spec = (obs.SatProperties(dict(prop="battery_charge_fraction")), obs.Time())
        action_spec = tuple(
            form(duration=1.0) for form in (act.Scan, act.Charge, act.Desat, act.Downlink, act.NadirPoint, act.Drift)
        )
        dyn_type, fsw_type = dynamics_of(craft), flight_software_of(craft)

        def reset_post_sim_init(self) -> None:
            super().reset_post_sim_init()
            for k, fault in enumerate(craft["faults"]):
                self.simulator.createNewEvent(
                    f"fault{k}",
                    macros.sec2nano(self.simulator.sim_rate),
                    True,
                    conditionTime=macros.sec2nano(fault["time"]),
                    actionFunction=lambda sim, fault=fault: fail(sim, self.dynamics, fault),
                )

    return Recorded


def fly(craft: Craft, args: dict[str, Any]) -> dict[str, Array]:
    """Messages of a flight, a row for each tick."""
    given = {name: value for name, value in args.items() if name != "utc_init"}
    env = SatelliteTasking(
        satellite=satellite_class(craft)("Craft", sat_args=given),
        scenario=scene.UniformNadirScanning(value_per_second=1.0),
        rewarder=data.NoReward(),
        sim_rate=craft["sim_rate"],
        time_limit=craft["actions"][-1][0] + craft["actions"][-1][2],
        world_args={"utc_init": craft["utc_init"]},
        log_level="ERROR",
        failure_penalty=0.0,
    )
    env.reset(seed=1)
    satellite = env.unwrapped.satellite
    for k, (_, name, duration) in enumerate(craft["actions"]):
        if craft.get("bars"):
            satellite.dynamics.command_bars(craft["dipoles"][k])
        satellite.action_builder.action_spec[ACTIONS.index(name)].duration = duration
        env.step(ACTIONS.index(name))
    log, count = satellite.fsw.log, len(craft["wheels"])
    wheels, sc, battery = [log[f"rw{k}"] for k in range(count)], log["sc"], log["battery"]
    found = {
        "time": np.array(sc.times()) * 1e-9,
        "state": np.c_[sc.r_BN_N, sc.v_BN_N, sc.sigma_BN, sc.omega_BN_B],
        "Omega": np.stack([wheel.Omega for wheel in wheels], -1),
        "u": np.stack([wheel.u_current for wheel in wheels], -1),
        "friction": np.stack([wheel.frictionTorque for wheel in wheels], -1),
        "u_cmd": np.array(log["cmd"].motorTorque)[:, :count],
        "on_time": np.array(log["thr"].OnTimeRequest)[:, : satellite.dynamics.thrFactory.getNumOfDevices()],
        "power": np.c_[battery.storageLevel, battery.currentNetPower, log["lit"].illuminationFactor],
        "storage": np.array(log["store"].storageLevel),
    }
    if craft.get("bars"):
        found["field"] = np.array(log["field"].magField_N)
    if craft["nav"]:
        errors = log["trans"].r_BN_N - sc.r_BN_N, log["trans"].v_BN_N - sc.v_BN_N
        found["nav"] = np.c_[(*errors, log["att"].sigma_BN, log["att"].omega_BN_B)]
    env.close()
    return found


def shadow(sigma: Array) -> Array:
    """The other MRP of each attitude."""
    return -sigma / np.maximum((sigma * sigma).sum(1, keepdims=True), 1e-300)


def present(name: str) -> tuple[Craft, dict[str, Any], Array]:
    """Spacecraft, arguments and kept times, s, of a present file."""
    file = np.load(RECORDINGS / f"{name}.npz")
    return json.loads(str(file["craft"])), json.loads(str(file["sat_args"])), file["time"]


def low_cubesat() -> tuple[Craft, dict[str, Any], Array]:
    """Spacecraft, arguments and kept times, s, of ``loads``."""
    craft, args, _ = present("craft_cubesat")
    r, v = np.array(args["rN"]), np.array(args["vN"])
    ratio = LOW / np.linalg.norm(r)
    args |= {"rN": (r * ratio).tolist(), "vN": (v / np.sqrt(ratio)).tolist()}
    kept = [np.arange(21), np.arange(30, 601, 15), 120 * np.arange(1, 5) + 1, 120 * np.arange(1, 5) + 2]
    return craft | LOADS | {"case": "loads"}, args, np.unique(np.concatenate(kept)).astype(float)


def play(name: str) -> dict[str, Any]:
    """Arrays of a file; ``twin`` is how far a flight parts whose attitude begins ``NUDGE`` away, in sigma and Omega."""
    if name == "craft_loads":
        craft, args, time = low_cubesat()
    elif name == "craft_navigation":
        craft, args, time = present("craft_cubesat")
        craft |= {"case": "navigation", "nav": navigation()}
    else:
        craft, args, time = present(name)
    found = fly(craft, args)
    near = fly(craft, {**args, "sigma_init": (np.array(args["sigma_init"]) + NUDGE).tolist()})
    sigma, other = found["state"][:, 6:9], near["state"][:, 6:9]
    away = [np.abs(a - b).max(1) for a, b in ((sigma, other), (shadow(sigma), other))]
    found["twin"] = np.c_[np.minimum(*away), np.abs(found["Omega"] - near["Omega"]).max(1)].astype(np.float32)
    kept = np.isin(np.round(found["time"] / craft["sim_rate"]), np.round(time / craft["sim_rate"]))
    return {"craft": json.dumps(craft), "sat_args": json.dumps(args), **{key: value[kept] for key, value in found.items()}}


if __name__ == "__main__":
    record_files({f"craft_{case}": play for case in CASES})
