"""Replay of recorded flights of spacecraft with their own bodies, wheels and thrusters.

The recordings are those of ``scripts/recorders/record_craft.py``.
"""

import json
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from torch import Tensor

from bsk_torch import SatelliteTasking, act, obs, sats
from bsk_torch.astro.attitude import mrp_add
from bsk_torch.constants import RPM
from bsk_torch.sim import dyn, faults, fsw
from bsk_torch.sim.dyn.effectors.thrusters import OCTET
from bsk_torch.vec3 import Vec3
from tests.basilisk.replay import RECORDINGS

FIELDS = ("r_BN_N", "v_BN_N", "sigma_BN", "omega_BN_B", "Omega_WB_B", "motor_torque_B", "motor_torque_command_B")
POWER = ("charge", "illumination", "storage", "pulse_command")
ACTIONS = ("scan", "charge", "desat", "downlink", "nadir", "drift")


def models(craft: Mapping[str, Any]) -> tuple[type[dyn.DynamicsModel], type[fsw.FSWModel]]:
    """Models of a recorded spacecraft."""
    extra = (dyn.GravityGradientDynModel,) if craft["gravity_gradient"] else ()
    extra = (*extra, dyn.SolarPressureDynModel, dyn.TorqueBarsDynModel) if craft["case"] == "loads" else extra
    extra = (*extra, dyn.NavigationErrorsDynModel) if craft["nav"] else extra
    Dyn = type("CraftDyn", (*extra, dyn.ContinuousImagingDynModel, dyn.GroundStationDynModel), {})
    bases = (fsw.SteeringFSWModel, fsw.ContinuousImagingFSWModel) if craft["steering"] else (fsw.ContinuousImagingFSWModel,)
    return Dyn, type("CraftFSW", bases, {})


def wheel(entry: Mapping[str, Any]) -> dyn.Wheel:
    """A wheel with the numbers that Basilisk's factory ended with."""
    names = ("Js", "u_max", "u_min", "P_max", "fCoulomb", "fStatic", "betaStatic", "cViscous")
    numbers = {name: entry[name] for name in names}
    on = dict(useRWfriction=True, useMinTorque=True)
    return dyn.Wheel("custom", entry["axis"], Omega_max=entry["Omega_max"] / RPM, **numbers, **on)


def faults_of(craft: Mapping[str, Any]) -> list[faults.Fault]:
    """The faults of a recorded spacecraft; what is repaired later lasts until then."""
    listed = []
    for k, entry in enumerate(craft["faults"]):
        kind, part, value, at = (entry[key] for key in ("kind", "index", "value", "time"))
        same = [other["time"] for other in craft["faults"] if (other["kind"], other["index"]) == (kind, part)]
        if at > min(same):  # the repair
            continue
        when = dict(at=at, lasts=max(same) - at if len(same) > 1 else None, name=f"{kind}{k}")
        if kind == "panel":
            names = ("panelNormals_B", "panelArea", "panelEfficiency")
            listed.append(faults.Fault(names, value=value, index=part, only="panel", **when))
        elif kind == "panel_status":
            listed.append(faults.panel(value, part, **when))
        elif kind == "thruster":
            listed.append(faults.thruster(part, **when))
        elif kind == "wheel_friction":
            listed.append(faults.wheel_friction(part, *value, **when))
        elif kind == "wheel_available":
            listed.append(faults.wheel_unavailable(part, **when))
        elif kind in ("wheel_power", "wheel_torque"):
            listed.append(faults.READY[kind](part, value, **when))
        else:
            listed.append(faults.READY[kind](value, **when))
    return listed


def arguments(craft: Mapping[str, Any], given: Mapping[str, Any]) -> dict[str, Any]:
    """``sat_args`` of a recorded spacecraft."""
    args = dict(given) | {"oe": None, "wheels": [wheel(entry) for entry in craft["wheels"]]}
    args["wheelSpeeds"] = [entry["speed"] for entry in craft["wheels"]]
    args |= {
        name: [entry[key] for entry in craft["wheels"]]
        for name, key in (
            ("rwBasePower", "base"),
            ("rwMechToElecEfficiency", "mech_to_elec"),
            ("rwElecToMechEfficiency", "elec_to_mech"),
        )
    }
    if craft["hub"]:
        args |= {"mass": craft["hub"]["mass"], "inertia": craft["hub"]["inertia"], "r_CB_B": craft["hub"]["com"]}
    if craft["control"]["null_gain"] is not None and len(craft["wheels"]) > 3:
        args["nullSpaceGain"] = craft["control"]["null_gain"]
    if craft["thrusters"]:
        args["thrusters"] = [dyn.Thruster(entry["r"], entry["d"], entry["thrust"]) for entry in craft["thrusters"]]
    elif craft["hub"]:  # the software of the recordings knows where the center of mass is: pairs fire one by one
        args["thrusters"] = list(OCTET)
    args |= {"compensateWheels": craft["control"]["wheels"], "integralLimit": craft["control"]["limit"]}
    args["faults"] = faults_of(craft) or None
    args["knownTorquePntB_B"] = craft["control"]["known_torque"] if any(craft["control"]["known_torque"]) else None
    if craft["facets"]:
        shares = craft.get("reflection") or [(0.0, 0.0)] * len(craft["facets"])
        facets = zip(craft["facets"], shares, strict=True)
        args["facets"] = [dyn.Facet(area, n, place, Cd, *light) for (area, Cd, n, place), light in facets]
        args["dragCoeff"] = [entry[1] for entry in craft["facets"]]
    if craft["nav"]:
        numbers = (craft["nav"][name] for name in ("P", "bounds", "seed"))
        args |= dict(zip(("PMatrix", "walkBounds", "RNGSeed"), numbers, strict=True)) | {"crossTrans": True, "crossAtt": True}
    if craft.get("bars"):
        args["torqueBars"] = [dyn.TorqueBar(*bar) for bar in zip(craft["bars"]["axes"], craft["bars"]["max"], strict=True)]
    if craft["panels"]:
        for name in ("panelArea", "panelEfficiency"):  # those of bsk_rl's single panel
            args.pop(name, None)
        args["panels"] = [dyn.Panel(entry["n"], entry["area"], entry["efficiency"]) for entry in craft["panels"]]
    return args


def fly(name: str, orbit: str = "integrated", **options: Any) -> tuple[Any, dict[str, Tensor]]:
    """The recording, and the same fields of the replay at its times."""
    file = np.load(RECORDINGS / f"craft_{name}.npz")
    craft, given = json.loads(str(file["craft"])), json.loads(str(file["sat_args"]))
    dyn_type, fsw_type = models(craft)
    known = {arg.name for model in (dyn_type, fsw_type) for part in model.all_components() for arg in part.args}
    args = {key: value for key, value in arguments(craft, given).items() if key in known}
    if orbit == "arc":  # pairs, which do not push
        args.pop("thrusters", None)
    plan = craft["actions"]
    length = plan[0][2]
    forms = (act.Scan, act.Charge, act.Desat, act.Downlink, act.NadirPoint, act.Drift)
    satellite = type(
        "Craft",
        (sats.Satellite,),
        {
            "dyn_type": dyn_type,
            "fsw_type": fsw_type,
            "action_spec": tuple(form(duration=length) for form in forms),
            "observation_spec": (obs.Time(),),
        },
    )
    env = SatelliteTasking(
        satellite("craft", args),
        num_envs=1,
        world_args=dict(utc_init=craft["utc_init"]),
        time_limit=plan[-1][0] + plan[-1][2],
        sim_rate=craft["sim_rate"],
        dtype=torch.float64,
        seed=0,
        orbit=orbit,
        failure_penalty=0.0,
        **options,
    )
    td, fields = env.reset(), (*FIELDS, *POWER, *(("nav_errors",) if craft["nav"] else ()))
    with env.record(fields) as recording:
        for k, (_, action, _) in enumerate(plan):
            if craft.get("bars"):
                dipoles = torch.tensor([craft["dipoles"][k]], dtype=torch.float64)
                env.simulator.state.write("bar_command", torch.ones(1, dtype=torch.bool), dipoles)
            td = env.step(td.set("action", torch.tensor([ACTIONS.index(action)])))["next"]
    flown = recording.data
    at = np.round(file["time"] / craft["sim_rate"]).astype(int)
    return file, {key: flown[key][torch.from_numpy(at)] for key in fields}


def shadow(sigma: np.ndarray) -> np.ndarray:
    """The other MRP of each attitude."""
    return -sigma / np.maximum((sigma * sigma).sum(-1, keepdims=True), 1e-300)


def differences(file: Any, flown: Mapping[str, Tensor]) -> dict[str, float]:
    """Largest differences between a recording and its replay."""
    found = {key: value.numpy() for key, value in flown.items()}
    n = len(found["charge"])
    state, sigma = file["state"][:n], found["sigma_BN"]
    away = np.minimum(np.abs(sigma - state[:, 6:9]).max(-1), np.abs(shadow(sigma) - state[:, 6:9]).max(-1))
    pairs = {
        "r": (found["r_BN_N"], state[:, :3]),
        "v": (found["v_BN_N"], state[:, 3:6]),
        "omega": (found["omega_BN_B"], state[:, 9:]),
        "Omega": (found["Omega_WB_B"], file["Omega"][:n]),
        "u": (found["motor_torque_B"], file["u"][:n]),
        "u_cmd": (found["motor_torque_command_B"], file["u_cmd"][:n]),
        "charge": (found["charge"], file["power"][:n, 0]),
        "storage": (found["storage"], file["storage"][:n]),
    }
    if found["pulse_command"].shape[-1] == file["on_time"].shape[-1]:  # pairs otherwise; only full pulses are commanded
        full = file["on_time"][:n] >= json.loads(str(file["craft"]))["sim_rate"] - 1e-7
        pairs["pulses"] = found["pulse_command"], full
    if "nav_errors" in found:
        errors, nav = found["nav_errors"], file["nav"][:n]
        known = mrp_add(*(Vec3(*torch.from_numpy(v).T) for v in (sigma, errors[:, 6:9]))).stack().numpy()
        apart = np.minimum(np.abs(known - nav[:, 6:9]).max(-1), np.abs(shadow(known) - nav[:, 6:9]).max(-1))
        pairs |= {"nav_r": (errors[:, :3], nav[:, :3]), "nav_v": (errors[:, 3:6], nav[:, 3:6])}
        pairs |= {"nav_sigma": (apart, 0.0), "nav_omega": (found["omega_BN_B"] + errors[:, 9:12], nav[:, 9:])}
    return {"sigma": float(away.max())} | {key: float(np.abs(a - b).max()) for key, (a, b) in pairs.items()}


def bounds(file: Any) -> dict[str, float]:
    """Largest differences allowed, by how fast neighboring flights of Basilisk itself part."""
    e, E = (max(least, float(twin)) for least, twin in zip((1e-9, 5e-7), file["twin"].max(0), strict=True))
    attitude = {
        "nav_r": 5e-9,
        "nav_v": 5e-12,
        "nav_sigma": 10 * e,
        "nav_omega": 2 * e,
        "sigma": 10 * e,
        "omega": 2 * e,
        "Omega": 10 * E,
        "u": 0.2 * E,
        "u_cmd": 0.2 * E,
    }
    return attitude | {"r": 1e-7, "v": 3e-10, "charge": 200 * E, "storage": 0.0, "pulses": 0.0}
