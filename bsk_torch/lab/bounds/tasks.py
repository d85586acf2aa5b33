"""Which tasks of imaging bounds and schedules cover."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from bsk_torch.act import Image
from bsk_torch.data import CloudFreeImageReward, UniqueImageReward
from bsk_torch.env import SatelliteTasking
from bsk_torch.env.base import Tasking
from bsk_torch.lab.bounds.envelope import SOONEST, Envelope
from bsk_torch.sats import BoundImagingSatellite, BoundSatellite
from bsk_torch.sim.fsw import SteeringImagerFSWModel

AGILITY = (
    "mass", "width", "depth", "height", "u_max", "inst_pHat_B", "imageAttErrorRequirement", "imageRateErrorRequirement",
    "K1", "K3", "omega_max", "servo_Ki", "servo_P", "controlAxes_B",
)  # fmt: skip
"""Arguments that decide how fast a satellite turns from target to target."""

ORBIT = 0.01
"""Fraction by which the semi-major axis may differ from that of the flights that an envelope was fitted on."""

DISTURBANCE = 0.01
"""Largest disturbance torque, as a fraction of the wheels' torque; below it the satellite is as agile as without."""


def agility(satellite: BoundImagingSatellite) -> dict[str, str]:
    """Return the arguments that decide how fast a satellite is, as text by name: numbers to nine digits.

    ValueError if they differ between episodes, or where the flight software has none of them.
    """
    args = satellite.sat_args
    if not issubclass(type(satellite).fsw_type, SteeringImagerFSWModel):
        raise ValueError(
            f"{satellite.name} has {type(satellite).fsw_type.__name__}; least times between images are known for satellites with "
            "fsw.SteeringImagerFSWModel, such as AEOS-v1's"
        )
    found = {}
    for name in AGILITY:
        value = args[name].reshape(len(args[name]), -1)
        if bool((value != value[0]).any()):
            raise ValueError(f"{name!r} differs between episodes; least times between images need equally agile satellites")
        found[name] = " ".join(f"{number:.9g}" for number in value[0].tolist())
    axis = args["oe"][..., 0]
    found["a"] = f"{float(axis.mean()):.9g}"
    found["sim_rate"] = f"{satellite.simulator.h:.9g}"
    return found


def check_satellite(satellite: BoundSatellite, envelope: Envelope) -> None:
    """ValueError unless the ``envelope`` holds for a satellite."""
    if not isinstance(satellite, BoundImagingSatellite):
        raise ValueError(f"{satellite.name} is a {type(satellite).__name__}; the bound needs satellites that image targets")
    if satellite.simulator.type.instruments:
        raise ValueError(f"{satellite.name} has a list of instruments; the bound covers a single one")
    if satellite.sat_args.get("oe") is None:
        raise ValueError("the bound needs orbits given as elements, oe=...")
    mine, known = agility(satellite), envelope.arguments
    other = [name for name in mine if name != "a" and mine[name] != known.get(name)]
    if other:
        name = other[0]
        raise ValueError(
            f"{name}={mine[name]}: the envelope of least times between images was fitted with {name}={known.get(name)}; fit one "
            "for this satellite with benchmarks/envelope.py, or with Envelope.below and record_transitions"
        )
    axis, base = satellite.sat_args["oe"][..., 0], float(known["a"])
    if bool(((axis - base).abs() > ORBIT * base).any()) or bool((satellite.sat_args["oe"][..., 1] > ORBIT).any()):
        raise ValueError(
            f"the envelope was fitted on near-circular orbits with a={base:g} m; a={axis.tolist()[:3]} m is too far off"
        )
    if bool((satellite.sat_args["disturbance_vector"].norm(dim=-1) > DISTURBANCE * satellite.sat_args["u_max"]).any()):
        raise ValueError("disturbance_vector is not small compared to u_max, as it was where the envelope was fitted")


def check_task(env: Tasking, envelope: Envelope) -> None:
    """ValueError, before anything is computed, unless the bound of imaging covers the task as it is now."""
    rewarder = env.rewarder
    if type(rewarder) not in (UniqueImageReward, CloudFreeImageReward):
        raise ValueError(
            f"the rewarder is {type(rewarder).__name__}; the bound of imaging covers UniqueImageReward and CloudFreeImageReward"
        )
    if env.failure_penalty > 0.0:
        raise ValueError(f"failure_penalty={env.failure_penalty:g} pays for dying, which the bound does not count")
    if env.fleet.varies:
        raise ValueError("satellites that are not present in all episodes are not covered by the bound; let all be present")
    env.guard.check_begun("imaging_bound(env)")
    imagers = [part for part in env.fleet.satellites if isinstance(part, BoundImagingSatellite)]
    for part in imagers:
        check_satellite(part, envelope)
        if part.simulator.orbit != "arc" or part.simulator.has_tank:
            raise ValueError(f"{part.name}: the bound needs orbits that no action changes, solved in advance")
    if len(imagers) != 1:
        raise ValueError(f"{len(imagers)} types of imaging satellites; the bound covers one")
    if bool((imagers[0].simulator.state.ticks != 0).any()):
        raise ValueError("the bound is that of whole episodes: call it after env.reset(), before the first step")


def shortest_pause(env: Tasking, satellite: BoundImagingSatellite) -> int | None:
    """Return the least ticks after which a step may end other than by an image or a window's end; None if no step can.

    In a constellation any satellite may be given a new action whenever another one's ends.
    """
    if not isinstance(env, SatelliteTasking):
        return SOONEST
    least = [env.max_step_duration]
    for action in env.satellite.actions.entries:
        if isinstance(action, Image):
            least.append(action.max_duration)
        else:
            least.append(float(getattr(action, "duration", 0.0)))
    return max(SOONEST, int(min(least) / satellite.simulator.h))


def payment(env: Tasking) -> Tensor:
    """Return what the first image of each target pays, [N, T]; targets that do not exist pay nothing."""
    rewarder: Any = env.rewarder
    scenario: Any = env.scenario
    paid = rewarder.reward_fn(scenario.priority)
    if isinstance(rewarder, CloudFreeImageReward):
        paid = torch.where(scenario.cloud_cover > rewarder.threshold, 0.0, paid)
    return paid.double().clamp(min=0.0)
