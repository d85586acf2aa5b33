"""Tables of the package itself: its commands, presets, arguments of satellites, and the order of a tick."""

from __future__ import annotations

import dataclasses
import importlib
import inspect
import math
import re
from collections.abc import Iterable
from functools import cache
from typing import Any

from docs._ext.markdown import block, code, plain, table
from docs._ext.results import ROOT

SCHEDULED = ("NadirScan-v1", "AEOS-v1", "Constellation-v1")
"""Presets whose components are marked in the order of a tick."""


# -- the command line ----------------------------------------------------------------------------------------------------------


def commands() -> str:
    """Return the commands of ``bsk-torch``, each with its first sentence."""
    from bsk_torch.cli.main import COMMANDS, loaded

    return table(
        ["command", "use"], [[code(name), paragraphs(loaded(name).help).partition("\n\n")[0]] for name in sorted(COMMANDS)]
    )


def commands_in_full() -> str:
    """Return every command of ``bsk-torch`` with its options."""
    from bsk_torch.cli.main import COMMANDS, loaded

    parts = ["# All commands"]
    for name in sorted(COMMANDS):
        command = loaded(name)
        examples = command.epilog.partition("\n\n")[2].replace("\\[", "[")
        parts += [f"## bsk-torch {name}", paragraphs(command.help), block(usage(name, command)), block(examples, "bash")]
        rows = [parameter(p) for p in command.params if p.name != "help"]
        parts += [table(["argument or option", "default", "meaning"], rows)] if rows else []
    return "\n\n".join(parts) + "\n"


def usage(name: str, command: Any) -> str:
    """Return a command with its arguments."""
    words = [p.name.upper() if p.required else f"[{p.name.upper()}]" for p in command.params if p.param_type_name == "argument"]
    return " ".join(["bsk-torch", name, *words, "[OPTIONS]"])


def parameter(p: Any) -> list[str]:
    """Return name, default and meaning of an argument or option."""
    names = [p.name.upper()] if p.param_type_name == "argument" else [*p.opts, *p.secondary_opts]
    default = (
        "required" if p.required else "-" if p.default in (None, (), [], "") or callable(p.default) else code(str(p.default))
    )
    return [", ".join(map(code, names)), default, paragraphs(p.help or "-")]


def paragraphs(text: str | None) -> str:
    """Return the text of a help without its marks of paragraphs, and with options as code."""
    plain_text = inspect.cleandoc(text or "").replace("\b", "").replace("\f", "")
    return re.sub(r"(?<![\w`-])--[a-z][a-z-]*", lambda option: code(option[0]), plain_text)


# -- presets -------------------------------------------------------------------------------------------------------------------


def presets() -> str:
    """Return all presets with their tasks and the names of their options."""
    from bsk_torch.presets import PRESETS

    rows = [
        [code(name), about(name), ", ".join(code(row[0]) for row in options(preset)) or "-"] for name, preset in PRESETS.items()
    ]
    return table(["preset", "task", "options"], rows)


def about(name: str) -> str:
    """Return what a preset is about."""
    from bsk_torch._listed import LISTED

    return LISTED[name].task


def options(preset: Any) -> list[list[str]]:
    """Return the options that a preset adds to those of its environment: name, default, meaning."""
    given = [p for p in inspect.signature(preset).parameters.values() if p.kind is not p.VAR_KEYWORD]
    return [[p.name, repr(p.default), argument(preset, p.name)] for p in given]


def argument(function: Any, name: str) -> str:
    """Return what the docstring of a function says of an argument."""
    found, text = False, []
    for line in (inspect.getdoc(function) or "").splitlines():
        if line.strip().startswith(f"{name}:"):
            found, text = True, [line.partition(":")[2].strip()]
        elif found and line.startswith("        "):
            text.append(line.strip())
        elif found:
            break
    return " ".join(text) or "-"


RULES = {
    "random": "takes every allowed action with the same probability",
    "rule": "scans; charges, desaturates or downlinks when battery, wheels or buffer pass a threshold",
    "cautious": "the same with tuned thresholds",
    "science": "the same with the thresholds of this preset",
    "areas": "records the cells of areas, and looks after battery, wheels and store",
    "greedy": "takes the most valuable target",
    "nearest": "takes the target whose window closes next",
    "hasty": "weighs value against slew and waiting time",
    "farsighted": "the same, with the best three images that can follow",
    "commit": "takes images of sites that can be completed in time, and prefers sites that it has begun",
    "cooperative": "ranks like *farsighted* with turn rates and clouds; satellites leave each other their targets",
    "drift": "never thrusts",
    "circumnavigate": "flies around the spacecraft at its initial distance",
    "survey": "takes the transfer that reveals the most lit, missing points, minus fuel and time",
    "hurried_survey": "the same with a higher price of time",
    "angle": "images the object with the smallest angle from the instrument",
    "priority_angle": "images the object with the smallest ratio of angle to priority",
    "distance": "images the nearest object",
    "rate": "images the lit object with the most priority per second of turn",
    "rate_ahead": "the same, expected at the end of the image",
    "candidate_priority": "images the observed candidate of the highest priority",
    "candidate_rate": "*rate* among the observed candidates",
    "candidate_rate_ahead": "*rate_ahead* among the observed candidates",
    "prompt": "images the candidate in sight with the most priority per second, and desaturates when idle",
    "prompt_ahead": "the same, expected at the end of the image",
    "local": "each imager decides from what it knows of the others' images",
    "centralized": "the best joint choice of all imagers",
    "glide": "flies straight to the chief at a share of the safe speed",
    "seek": "flies around the chief toward the nearest cluster of lit points",
    "nearest_task": "AEOS-Bench's greedy rule",
    "soonest_task": "gives each task to the satellite that is expected to complete it first",
}
"""What the rules do."""


def rules() -> str:
    """Return all rules with the presets that they fit."""
    from bsk_torch._listed import LISTED
    from bsk_torch.rl.policies.shared_policy import RULES as NAMES

    if set(RULES) != set(NAMES):
        raise ValueError(f"described and existing rules differ: {set(RULES) ^ set(NAMES)}")
    fits = {rule: ", ".join(code(name) for name, preset in LISTED.items() if rule in preset.rules) or "all" for rule in RULES}
    return table(["rule", "what it does", "presets"], [[code(rule), text, fits[rule]] for rule, text in RULES.items()])


# -- options of environments ---------------------------------------------------------------------------------------------------


def environment_options() -> str:
    """Return the options of all environments, then those of constellations, each with default and meaning."""
    from bsk_torch.env.options import ConstellationOptions, TaskingOptions

    parts, seen = [], set[str]()
    for title, kind in {"All environments": TaskingOptions, "Constellations": ConstellationOptions}.items():
        added = [field for field in dataclasses.fields(kind) if field.name not in seen]
        seen |= {field.name for field in added}
        rows = [[code(field.name), code(repr(field.default)), roles(argument(kind, field.name))] for field in added]
        target = (
            f"<!-- site\n```{{py:class}} {kind.__module__}.{kind.__name__}\n:no-typesetting:\n```\n-->"  # for links of docstrings
        )
        parts += [f"## {title}", target, table(["option", "default", "meaning"], rows)]
    return "\n\n".join(parts) + "\n"


def roles(text: str) -> str:
    """Return a docstring's text without its roles."""
    return re.sub(r":(?:class|func|meth|mod|attr|data):`~?", "`", text)


# -- arguments and the tick ----------------------------------------------------------------------------------------------------


def arguments(module: str) -> str:
    """Return the arguments that each model of a module adds to those of the models before it."""
    loaded, seen, parts = importlib.import_module(module), set[str](), []
    models = [getattr(loaded, name) for name in loaded.__all__]
    for model in sorted((m for m in models if hasattr(m, "all_components")), key=lambda m: len(m.__mro__)):
        rows = [arg for component in model.all_components() for arg in component.args if arg.name not in seen]
        seen |= {arg.name for arg in rows}
        if rows:
            parts += [f"### {model.__name__}", arguments_of(rows)]
    return "\n\n".join(parts) + "\n"


def arguments_of(rows: Iterable[Any]) -> str:
    """Return a table of arguments."""
    cells = [[code(arg.name), value(arg.default), arg.unit or "1", arg.doc or "-", bounds(arg)] for arg in rows]
    return table(["argument", "default", "unit", "meaning", "range"], cells)


def value(default: Any) -> str:
    """Return a default."""
    if isinstance(default, tuple) and default and isinstance(default[0], dict):
        return f"{len(default)} stations"
    if isinstance(default, float):
        return code(plain(default))
    text = " ".join(str(default).split())
    return code(text) if len(text) <= 60 else f"{code(text[:57])} ..."


def bounds(arg: Any) -> str:
    """Return the range of an argument."""
    if arg.choices:
        return ", ".join(code(repr(choice)) for choice in arg.choices)
    if (arg.low, arg.high) == (-math.inf, math.inf):
        return "-"
    return f"{plain(arg.low)} to {plain(arg.high)}"


NUMBERS = (
    *("mass", "width", "depth", "height", "u_max", "maxWheelSpeed", "wheelSpeeds"),
    *("panelArea", "panelEfficiency", "batteryStorageCapacity", "storedCharge_Init", "basePowerDraw"),
    *("instrumentPowerDraw", "transmitterPowerDraw", "thrusterPowerDraw"),
    *("instrumentBaudRate", "transmitterBaudRate", "dataStorageCapacity", "storageInit"),
    *("imageAttErrorRequirement", "imageRateErrorRequirement", "imageTargetMinimumElevation", "disturbance_vector", "oe"),
)
"""Arguments that describe a spacecraft at a glance."""

FLOWN = ("NadirScan-v1", "AEOS-v1", "AEOSPower-v1", "Constellation-v1")
"""Presets whose spacecraft are compared."""


def spacecraft_numbers() -> str:
    """Return the most used arguments with their units, the default, and the values in some presets where they differ."""
    import bsk_torch
    from bsk_torch.sim.arguments.table import short

    tables = [bsk_torch.make(name, num_envs=1, time_limit=60.0, backend="eager").default_sat_args() for name in FLOWN]
    rows = []
    for name in NUMBERS:
        arg = next(found.rows[name] for found in tables if name in found.rows)
        here = [
            code(short(found.here[name])) if name in found.here else "-" if name not in found.rows else "default"
            for found in tables
        ]
        rows.append([code(name), arg.unit or "1", code(short(arg.default)), *here])
    return table(["argument", "unit", "default", *FLOWN], rows)


@cache
def schedule() -> str:
    """Return the slots of a tick, in order, and in which presets each of them runs."""
    import bsk_torch
    from bsk_torch.sim.schedule import SCHEDULE

    running = {}
    for name in SCHEDULED:
        env = bsk_torch.make(name, num_envs=1, time_limit=60.0, backend="eager")
        parts = (component for simulator in env.fleet.simulators for component in simulator.tick.components)
        running[name] = {component.slot for component in parts if component.update is not None}
    sections, groups = [], list(dict.fromkeys(slot.group for slot in SCHEDULE))
    for group in groups:
        rows = []
        for slot in (slot for slot in SCHEDULE if slot.group == group):
            marks = ["yes" if slot.name in running[name] else "-" for name in SCHEDULED]
            rows.append([code(slot.name), slot.doc, slot.basilisk, *marks])
        sections += [f"## {group.capitalize()}", table(["slot", "what runs there", "Basilisk", *SCHEDULED], rows)]
    return "\n\n".join(sections) + "\n"


# -- the front page ------------------------------------------------------------------------------------------------------------


def readme_example() -> str:
    """Return the example of the README."""
    text = (ROOT / "README.md").read_text()
    return text.partition("<!-- example -->")[2].partition("<!-- end of the example -->")[0].strip()


TABLES = {
    "readme_example": readme_example,
    "commands": commands,
    "presets": presets,
    "environment_options": environment_options,
    "arguments": arguments,
    "rules": rules,
    "spacecraft_numbers": spacecraft_numbers,
    "schedule": schedule,
}
