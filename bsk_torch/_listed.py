"""Names of presets, rules, planners and pretrained policies; read without torch.

``import bsk_torch`` registers the presets, and the command line checks names and prints help, before torch is imported. A test
compares the names with the tables of the functions that they stand for.
"""

from __future__ import annotations

import json
import sys
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

import gymnasium

from bsk_torch._rooms import resolve
from bsk_torch.sim.names import nearest

MODULE = "bsk_torch.wrappers"

ONE = {"entry_point": f"{MODULE}.gymnasium:GymEnv", "vector_entry_point": f"{MODULE}.gymnasium:GymVectorEnv"}
"""Entry points of presets with one satellite."""

SOLO = dict(ONE)
"""Entry points of presets with many satellites, of which one alone has a choice."""

MANY = {"entry_point": f"{MODULE}.general:GymJointEnv"}
"""Entry point of constellations, which have one agent under Gymnasium."""


SCANNING = ("rule", "cautious")
IMAGING = ("greedy", "nearest", "hasty", "farsighted")
INSPECTION = ("drift", "circumnavigate", "survey", "hurried_survey")
SERVICES = ("angle", "priority_angle", "distance", "rate", "rate_ahead", "candidate_priority", "candidate_rate")
SENSORS = ("candidate_priority", "candidate_rate", "candidate_rate_ahead", "prompt", "prompt_ahead", "local", "centralized")


class Listed(NamedTuple):
    """A preset.

    Attributes:
        function: Module and name of the function that makes the environment.
        views: Gymnasium's entry points.
        task: Task in one line.
        rules: Rules, some of which need an option of the preset.
    """

    function: str
    views: dict[str, str]
    task: str
    rules: tuple[str, ...]


LISTED: dict[str, Listed] = {
    "NadirScan-v1": Listed(
        "bsk_torch.presets.nadir_scan:nadir_scan",
        ONE,
        "record the ground below; keep battery, wheels and data buffer within limits",
        SCANNING,
    ),
    "NadirScience-v1": Listed(
        "bsk_torch.presets.nadir_science:nadir_science",
        ONE,
        "the same with ten observations, a large battery and a strong disturbance, of BSK-RL's suite",
        ("science",),
    ),
    "FaultyScan-v1": Listed(
        "bsk_torch.presets.faulty_scan:faulty_scan",
        ONE,
        "NadirScan-v1 while wheels, panel, battery and transmitter fail at random times",
        SCANNING,
    ),
    "Areas-v1": Listed(
        "bsk_torch.tasks.areas.preset:areas",
        ONE,
        "record 500 areas, cell by cell, with an instrument that fills the store whatever lies below",
        ("areas", *SCANNING),
    ),
    "AreasTeam-v1": Listed(
        "bsk_torch.tasks.areas.preset:areas_team",
        MANY,
        "the same with three satellites, one behind the other, which contend for antennas of ground stations",
        ("areas", *SCANNING),
    ),
    "AEOS-v1": Listed(
        "bsk_torch.presets.aeos:aeos", ONE, "choose which of the next 32 targets to image, of 100 to 9,999", IMAGING
    ),
    "AEOSPower-v1": Listed(
        "bsk_torch.presets.aeos_power:aeos_power", ONE, "AEOS-v1 with a small battery and data buffer, and weak wheels", IMAGING
    ),
    "AEOSCity-v1": Listed("bsk_torch.presets.aeos:aeos_city", ONE, "AEOS-v1 with cities as targets (extra: cities)", IMAGING),
    "CloudyAEOS-v1": Listed(
        "bsk_torch.presets.aeos:cloudy_aeos", ONE, "AEOS-v1 under clouds, observed only as a forecast", IMAGING
    ),
    "Constellation-v1": Listed(
        "bsk_torch.presets.constellation:constellation", MANY, "12 imagers that communicate along lines of sight", IMAGING
    ),
    "AEOSConstellation-v1": Listed(
        "bsk_torch.presets.constellation:aeos_constellation",
        MANY,
        "three imagers in one plane that share all knowledge once a minute",
        IMAGING,
    ),
    "RelayConstellation-v1": Listed(
        "bsk_torch.presets.constellation:relay_constellation",
        MANY,
        "four low imagers, two high relays; broadcasting is an action",
        IMAGING,
    ),
    "HeteroCluster-v1": Listed(
        "bsk_torch.presets.hetero_cluster:hetero_cluster",
        MANY,
        "two optical satellites and a radar that sees through clouds and at night",
        (*IMAGING, "cooperative"),
    ),
    "Sites-v1": Listed(
        "bsk_torch.tasks.sites.preset:sites",
        ONE,
        "take mosaics of 3 to 6 images that pay when complete, under weather with a forecast",
        ("commit", *IMAGING),
    ),
    "SitesTeam-v1": Listed(
        "bsk_torch.tasks.sites.preset:sites_team",
        MANY,
        "the same with two imagers, one behind the other, whose images count together",
        ("commit", *IMAGING),
    ),
    "TipAndCue-v1": Listed(
        "bsk_torch.tasks.sites.preset_tips:tip_and_cue",
        ONE,
        "find active spots by wide looks at sites, and confirm all of a site by narrow ones in time",
        ("commit", *IMAGING),
    ),
    "RSOInspection-v1": Listed(
        "bsk_torch.tasks.inspection.preset:rso_inspection",
        SOLO,
        "fly around a spacecraft until its surface is inspected",
        INSPECTION,
    ),
    "MultiInspection-v1": Listed(
        "bsk_torch.tasks.inspection.preset:multi_inspection",
        MANY,
        "the same with three inspectors that must not collide",
        INSPECTION,
    ),
    "Services-v1": Listed(
        "bsk_torch.tasks.objects.preset:services",
        ONE,
        "image 200 satellites and debris again and again; quality is verified on the ground",
        (*SERVICES, "candidate_rate_ahead", "prompt_ahead"),
    ),
    "ThreeSensors-v1": Listed(
        "bsk_torch.tasks.objects.team_preset:three_sensors",
        MANY,
        "three imagers of objects in orbit, each of which knows only its images",
        SENSORS,
    ),
    "Walker4-v1": Listed(
        "bsk_torch.tasks.objects.team_preset:walker4",
        MANY,
        "four imagers of objects in orbit that tell each other of images by radio",
        SENSORS,
    ),
    "CWDocking-v1": Listed(
        "bsk_torch.tasks.safe_autonomy.preset_docking:cw_docking",
        ONE,
        "dock with thrusters below a speed limit that depends on the distance; linear motion",
        ("glide",),
    ),
    "CWInspection-v1": Listed(
        "bsk_torch.tasks.safe_autonomy.preset_inspection:cw_inspection",
        ONE,
        "inspect lit points of a spacecraft with thrusters; linear motion",
        ("seek",),
    ),
    "AEOSBench-v1": Listed(
        "bsk_torch.tasks.aeos_bench.preset:aeos_bench",
        MANY,
        "AEOS-Bench: point up to 50 satellites at tasks on the ground, second by second",
        ("nearest", "nearest_task", "soonest_task"),
    ),
}
"""The presets of the package, in the order of :data:`bsk_torch.presets.PRESETS`."""

RULES = tuple(dict.fromkeys(("random", *(rule for preset in LISTED.values() for rule in preset.rules))))
"""Names of :data:`bsk_torch.rl.policies.shared_policy.RULES`."""

PREFIX = "plan:"
"""What the names of planners begin with."""

PLANNERS = dict.fromkeys(("rollout", "beam", "mcts", "cem"), "bsk_torch.lab.planners.named:named_planner")
"""Names of :data:`bsk_torch.lab.planners.names.PLANNERS`, and the function by which the command line makes each of them."""


@cache
def makings() -> dict[str, dict[str, Any]]:
    """Return the training and the score of each pretrained policy, by preset.

    Entries, which ``scripts/tools/publish_policy.py`` has written, are ``command``, ``seed``, ``frames``, ``seconds`` and
    ``machine`` of the training; ``score`` with the mean ``return``, the half width of its 95 % interval and the ``survival`` in
    ``episodes`` unseen episodes; and ``first``, the returns of the first few episodes.
    """
    path = files("bsk_torch").joinpath("rl/policies/policies.json")  # of a package that would import torch
    return dict(json.loads(path.read_text()))


SCORES = Path(str(files("bsk_torch").joinpath("rl/policies/scores.json")))
"""File of :func:`scores`."""


@cache
def scores() -> dict[str, dict[str, Any]]:
    """Return what policies return in each preset, which ``scripts/tools/measure_presets.py`` has measured.

    An entry has the number of ``episodes``, the same for all policies; ``policies`` by name (``random``, rules, ``pretrained``)
    with the ``mean`` return, the ``half_width`` of its 95 % interval, the ``survival``, the ``options`` of the environment and
    the CPU time; ``best_rule``; and ``gain``, the paired difference of the pretrained policy from it, None without such a policy.
    """
    return dict(json.loads(SCORES.read_text())["presets"]) if SCORES.exists() else {}


REMARKS = {
    "AreasTeam-v1": "policies trained in Areas-v1 gain 3.3 to 3.6 over areas",
    "Sites-v1": "five trainings of its recipe gained 0.5 to 1.2 over commit",
    "TipAndCue-v1": "three trainings of its recipe gained 0.5 to 0.7 over commit",
    "CWDocking-v1": "no policy can gain more than 0.13 over glide",
    "CWInspection-v1": "no policy can gain more than 0.02 over seek",
}
"""What is known of policies in presets without a pretrained one; see the pages areas.md, sites.md and run_time_assurance.md."""


def unlisted(preset: str) -> str:
    """Return what is wrong with a name that is not one of the presets."""
    return f"{preset!r} is not a preset; {nearest(preset, LISTED)}"


def no_policy(preset: str) -> str:
    """Return what to do for a preset without a pretrained policy, or what is wrong with the name."""
    if ":" in preset:
        return f"there is no pretrained policy for {preset!r}, your environment: name a policy, such as random or a run folder"
    if preset not in LISTED:
        return f"there is no pretrained policy for {preset!r}: it {unlisted(preset).partition(' ')[2]}"
    rules = ", ".join(("random", *LISTED[preset].rules))
    return f"there is no pretrained policy for {preset!r}: train one (bsk-torch train {preset}), or choose a rule: {rules}"


def satellite_tasking(**options: Any) -> Any:
    """Return an environment of the user's satellite; the class is imported when it is needed."""
    return resolve("bsk_torch.env:SatelliteTasking")(**options)


def general_satellite_tasking(**options: Any) -> Any:
    """Return an environment of the user's satellites, which are one agent; likewise."""
    return resolve("bsk_torch.env:GeneralSatelliteTasking")(**options)


def refuse_constellation(**options: object) -> NoReturn:
    """Raise Error for ``gymnasium.make`` of agents that act on their own, which Gymnasium's interface does not have."""
    raise gymnasium.error.Error(
        "ConstellationTasking has several agents, which gymnasium.make cannot return. PettingZoo's view is "
        "bsk_torch.wrappers.pettingzoo.parallel_env(bsk_torch.ConstellationTasking, satellites=[...], ...); one agent for all "
        "satellites is gymnasium.make('bsk_torch/GeneralSatelliteTasking-v1', satellites=[...], ...)"
    )


OWN: dict[str, dict[str, object]] = {
    "SatelliteTasking-v1": {**ONE, "kwargs": {"core": satellite_tasking}},
    "GeneralSatelliteTasking-v1": {**MANY, "kwargs": {"core": general_satellite_tasking}},
    "ConstellationTasking-v1": {"entry_point": refuse_constellation, "vector_entry_point": refuse_constellation},
}
"""Environments of a user's own satellites: ``gymnasium.make("bsk_torch/SatelliteTasking-v1", satellite=..., rewarder=...)``."""


def register_listed() -> None:
    """Register :data:`LISTED` and :data:`OWN` as ``bsk_torch/<name>`` with Gymnasium.

    The names of :data:`OWN` are registered without ``bsk_torch/`` too, unless bsk_rl has been imported: then
    they mean bsk_rl's environments, and they do from the moment on when bsk_rl is imported later. Repeated calls do nothing.
    """
    for name, preset in LISTED.items():
        register_once(f"bsk_torch/{name}", **preset.views, kwargs={"core": name})
    for name, entry in OWN.items():
        register_once(f"bsk_torch/{name}", **entry)
        if "bsk_rl" not in sys.modules:
            register_once(name, **entry)


def register_once(env_id: str, **entry: Any) -> None:
    """Register an environment, unless there is one of that name."""
    if env_id not in gymnasium.registry:
        gymnasium.register(env_id, **entry)
