"""The contract of an exported policy: what every number of its inputs and outputs means, as JSON and as a page."""

from __future__ import annotations

import functools
import hashlib
import inspect
import math
import re
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any, cast

import torch
from torch import Tensor

from bsk_torch import __version__
from bsk_torch.env import Tasking
from bsk_torch.env.action_forms import form
from bsk_torch.env.satellite_group import SatelliteGroup
from bsk_torch.lab.export.graph import MASK, MEMORY, OBSERVATION, PolicyGraph
from bsk_torch.lab.export.record import Record
from bsk_torch.obs import Observation
from bsk_torch.obs.candidates import CandidateObservation
from bsk_torch.obs.opportunities import PRESETS
from bsk_torch.obs.relative_observations import FUNCTIONS
from bsk_torch.rl.networks.plans import ACTOR, NORMALISER
from bsk_torch.sats import Satellite

FORMAT = 1
"""Version of the contract."""

KEY = "bsk_torch.contract"
"""Key of the contract in the metadata of an ONNX file, and its name among the extra files of ``torch.export``."""

FRAMES = {
    "N": "N, inertial (J2000 equator)",
    "P": "P, fixed to the Earth",
    "B": "B, the body",
    "H": "H, the Hill frame of the satellite",
    "Hc": "Hc, the Hill frame of the chief",
    "Hd": "Hd, the Hill frame of the deputy",
    "Hs": "Hs, the Hill frame of the Earth about the Sun",
    "C": "C, the body of the chief",
    "D": "D, the body of the deputy",
}
"""Frames by the ends of names of vectors."""

OPPORTUNITIES = {
    "priority": "Priority of the target, [N].",
    "r_LP_P": "Position of the place, [N, 3] m.",
    "r_LB_H": "Position of the place relative to the satellite, [N, 3] m.",
    "opportunity_open": "Time until the window opens, negative while it is open, [N] s.",
    "opportunity_mid": "Time until the middle of the window, [N] s.",
    "opportunity_close": "Time until the window closes, [N] s.",
    "target_angle": "Angle between the axis of the instrument and the direction to the place, [N] rad.",
    "target_angle_rate": "Rate of the axis of the instrument relative to the direction to the place, [N] rad/s.",
}
"""Meanings of properties of opportunities whose functions have no docstrings."""

REMEMBERED = "zeros at the first decision of an episode; then next.memory of the same satellite's previous decision"
"""What the input ``memory`` of a recurrent policy must be."""

UNIT = re.compile(r"(?:\] |, )(m\^2/s|m/s|rad/s|degrees|rad|m|s|kg|W|J)(?=[ ,.;]|$)")
"""A unit in the first line of a docstring, after the shape or a comma."""


def contract_of(
    graph: PolicyGraph, record: Record, env: Tasking, view: SatelliteGroup, part: Mapping[str, Any], about: dict[str, Any]
) -> dict[str, Any]:
    """Return the contract of the policy of one group, values of JSON.

    Args:
        graph: The policy.
        record: Its recorded decisions.
        env: The environment in which they were recorded.
        view: The satellites of the group.
        part: The networks of the group in the policy's file.
        about: Name of the ``preset``, ``options`` of the environment, name of the ``group``, and of the ``shield``, None without.
    """
    seconds = record.seconds[record.seconds > 0.0].sort().values
    mask, shield = [] if graph.is_real else ["mask"], about["shield"]
    return {
        "format": FORMAT,
        "bsk_torch": __version__,
        "environment": about | {"fingerprint": env.fingerprint.tolist()},
        "network": {
            "kind": part["network"],
            "hidden": list(part["plan"]["hidden"]),
            "parameters": sum(weight.numel() for weight in graph.network.parameters()),
        },
        "weights_sha256": weights_hash(part),
        "inputs": [
            {"name": name, "type": "bool" if path == MASK else "float32", "shape": ["N", *record.inputs[path].shape[1:]]}
            for name, path in zip(graph.names, graph.paths, strict=True)
        ],
        "outputs": [
            {"name": name, "type": str(value.dtype).removeprefix("torch."), "shape": ["N", *value.shape[1:]]}
            for name, value in record.outputs.items()
        ],
        "memory": REMEMBERED if MEMORY in graph.paths else None,
        "observation": quantities_of(graph, record, view),
        "actions": real_actions(view) if graph.is_real else numbered_actions(view),
        "decisions": {
            "when": "when a task ends or the satellite requires a new one; not at a fixed rate",
            "recorded_seconds": [number(seconds[round(share * (len(seconds) - 1))]) for share in (0.0, 0.5, 1.0)],
            "longest_seconds": env.max_step_duration if math.isfinite(env.max_step_duration) else None,
        },
        "included": ["normalizer", "network", *mask, *([f"shield {shield!r}"] if shield else []), "most probable action"],
        "not_included": not_included(view, shield),
        "record": {
            "margin": margin(graph, record),
            "inputs": {name: numbers(record.inputs[path]) for name, path in zip(graph.names, graph.paths, strict=True)},
            "outputs": {name: numbers(value) for name, value in record.outputs.items()},
        },
    }


def number(value: Tensor | float) -> float:
    """Return a float32 as the shortest number that is read as the same float32."""
    return float(f"{float(value):.9g}")


def numbers(values: Tensor) -> Any:
    """Return a tensor as nested lists."""
    if not values.is_floating_point():
        return values.tolist()
    return [numbers(row) for row in values] if values.ndim > 1 else [number(value) for value in values.tolist()]


def weights_hash(part: Mapping[str, Any]) -> str:
    """Return the SHA-256 of names and bytes of normalizer and network, in the order of the names."""
    digest = hashlib.sha256()
    for state in (part[NORMALISER], part[ACTOR]):
        for name in sorted(state):
            digest.update(name.encode() + state[name].detach().cpu().contiguous().numpy().tobytes())
    return digest.hexdigest()


def margin(graph: PolicyGraph, record: Record) -> float | None:
    """Return the least lead of the highest logit of a legal action over the next one; None where there never are two."""
    if graph.is_real or not bool((choices := record.inputs[MASK].sum(-1) > 1).any()):
        return None
    two = record.outputs["logits"].masked_fill(~record.inputs[MASK], -torch.inf)[choices].topk(2).values
    return number((two[:, 0] - two[:, 1]).min())


# -- observations ----------------------------------------------------------------------------------------------------------------


def places_of(graph: PolicyGraph, record: Record, view: SatelliteGroup) -> list[dict[str, Any]]:
    """Return input, name, and place in the vector of the C code of each observed quantity; those of a set repeat in each row."""
    places, start = [], 0
    for path in (path for path in graph.paths if path[:1] == OBSERVATION):
        value, title, (rows, stride) = record.inputs[path], ".".join(path[1:]), (1, 0)
        if graph.rows is None:
            widths: dict[str, int] = Counter(entry.split("[")[0] for entry in view.observation_description)
        elif path[-1] == "rows":
            columns = cast(CandidateObservation, source_of(view, title)).columns()[0]
            widths = {f"{title}.{name}": column[0, 0].numel() for name, column in columns.items()}
            rows, stride = value.shape[1:]
        else:
            widths = {title: value[0].numel()}
        first = start
        for name, width in widths.items():
            place = {"input": ".".join(path), "name": name, "vector": first, "width": width}
            places.append(place | {"rows": rows, "row_stride": stride})
            first += width
        start += value[0].numel()
    return places


def quantities_of(graph: PolicyGraph, record: Record, view: SatelliteGroup) -> list[dict[str, Any]]:
    """Return the observed quantities in order, with their places, meanings and ranges."""
    vectors, limits = record.vectors(), graph.limits()
    result = []
    for place in places_of(graph, record, view):
        first, width, rows, stride = (place[name] for name in ("vector", "width", "rows", "row_stride"))
        recorded = vectors[:, [first + k * stride + j for k in range(rows) for j in range(width)]]
        clipped = limits[:, first : first + width]
        meaning, divisor = described(view, place["name"])
        unit, plain = UNIT.search(meaning), place["name"].split(".")[-1].removesuffix("_normd")
        result.append(
            place
            | {
                "meaning": meaning,
                "unit": unit.group(1) if unit else None,
                "frame": FRAMES.get(plain.rpartition("_")[2]) if width == 3 else None,
                "divisor": divisor,
                "recorded": [number(recorded.min()), number(recorded.max())],
                "clipped": [number(clipped[0].min()), number(clipped[1].max())] if clipped.numel() else None,
            }
        )
    return result


def source_of(view: SatelliteGroup, name: str) -> Observation:
    """Return the observation to which a quantity belongs."""
    return next(entry for entry in view.observations.entries if entry.unique_name == name.split(".")[0])


def described(view: SatelliteGroup, name: str) -> tuple[str, float | list[float] | None]:
    """Return what a quantity is, with unit, and the number that it has been divided by; None where the text tells it."""
    source, leaf = source_of(view, name), name.split(".")[-1]
    if leaf == "mask" and isinstance(source, CandidateObservation):
        return "1 for a row that exists, 0 for padding.", 1.0
    for entry in getattr(source, "entries", ()):
        fields = entry if isinstance(entry, dict) else entry._asdict()
        if fields["name"] == leaf:
            divisor = fields["norm"].tolist() if isinstance(fields["norm"], Tensor) else float(fields["norm"])
            text = document(view, fields) or field_line(source, fields["prop"])
            return text or f"{fields['prop']}: {first_line(type(source).__doc__)}", divisor
    norm = getattr(source, "norm", None)
    return first_line(type(source).__doc__), norm if isinstance(norm, float) else None


def document(view: SatelliteGroup, fields: Mapping[str, Any]) -> str:
    """Return the first line of the docstring of an observed function or property; empty if it has none."""
    function = fields.get("fn")
    if function is not None:
        while isinstance(function, functools.partial):
            function = function.func
        return first_line(function.__doc__)
    prop = fields["prop"]
    if prop in OPPORTUNITIES and isinstance(fields, dict) and not hasattr(type(view.dynamics), prop):
        return OPPORTUNITIES[prop]
    owners = (type(view.dynamics), type(view.fsw))
    holder = next((getattr(owner, prop) for owner in owners if hasattr(owner, prop)), FUNCTIONS.get(prop) or PRESETS.get(prop))
    return first_line(holder.__doc__ if holder is not None else None)


def field_line(source: Observation, prop: str) -> str:
    """Return what a named tuple in the module of an observation says about its field ``prop``; empty if there is none."""
    for value in vars(sys.modules[type(source).__module__]).values():
        if prop in getattr(value, "_fields", ()) and (line := re.search(rf"^ +{prop}: (.+)$", value.__doc__ or "", re.MULTILINE)):
            return line[1]
    return ""


def first_line(text: str | None) -> str:
    """Return the first line of a docstring."""
    return inspect.cleandoc(text or "").partition("\n")[0]


# -- actions ---------------------------------------------------------------------------------------------------------------------


def numbered_actions(view: SatelliteGroup) -> list[dict[str, Any]]:
    """Return number, name, meaning and duration of each action; null for durations that depend on the situation."""
    rows = []
    for k, name in enumerate(view.action_description):
        entry = view.actions.entries[view.actions.entry_of(k)]
        duration = getattr(entry, "duration", None)
        lasts = float(duration) if isinstance(duration, int | float) and duration < 1e9 else None
        rows.append({"number": k, "name": name, "meaning": first_line(type(entry).__doc__), "seconds": lasts})
    return rows


def real_actions(view: SatelliteGroup) -> list[dict[str, Any]]:
    """Return position, name, meaning and bounds of each real number."""
    builder = form(view)
    assert builder is not None
    meaning = first_line(type(builder.entry).__doc__)
    bounds = zip(builder.names, builder.low.tolist(), builder.high.tolist(), strict=True)
    return [{"number": k, "name": name, "meaning": meaning, "range": [low, high]} for k, (name, low, high) in enumerate(bounds)]


def not_included(view: SatelliteGroup, shield: str | None) -> list[str]:
    """Return what stands between policy and satellite in the environment, and is not in the exported file."""
    absent = []
    if form(view) is None:
        rule = type(view).legal_actions is not Satellite.legal_actions and getattr(view, "shielded", True)
        absent.append(
            "the computation of action_mask"
            + (", in which a shield of the environment removes dangerous actions" if rule else "")
        )
        if shield is None:
            absent.append("a shield of evaluations (--shield)")
    if any(getattr(entry, "assurance", None) is not None for entry in view.actions.entries):
        absent.append("the run-time assurance of the action, which changes unsafe forces after the policy")
    return absent


# -- the page --------------------------------------------------------------------------------------------------------------------


def page(contract: Mapping[str, Any], files: Sequence[str]) -> str:
    """Return the contract as a page in Markdown."""
    env, decisions = contract["environment"], contract["decisions"]
    options = ", ".join(f"{name}={value!r}" for name, value in env["options"].items()) or "none"
    network = contract["network"]
    lines = [
        f"# Policy for {env['preset']}",
        "",
        f"- package: bsk_torch {contract['bsk_torch']}; options of the environment: {options}; group: {env['group']}",
        f"- fingerprint of the environment: `{env['fingerprint']}`",
        f"- network: {network['kind']}, layers {network['hidden']}, {network['parameters']:,} parameters",
        f"- SHA-256 of the weights: `{contract['weights_sha256']}`",
        f"- files: {', '.join(f'`{name}`' for name in files)}",
        f"- included: {'; '.join(contract['included'])}",
        f"- **not included: {'; '.join(contract['not_included']) or 'nothing'}**",
        f"- decisions: {decisions['when']}. Least, median and most seconds between recorded ones: "
        f"{cell(decisions['recorded_seconds'])}; longest step: {cell(decisions['longest_seconds']) or 'unlimited'}.",
        "",
        "## Inputs and outputs",
        "",
        *rows(("name", "type", "shape"), [*contract["inputs"], *contract["outputs"]]),
        "",
        *([f"`memory` is {contract['memory']}.", ""] if contract["memory"] else []),
        "## Observation",
        "",
        "A number is the quantity, in its unit, divided by the divisor; where these are empty, the text tells them. Beyond the",
        "clipped range, which covers all numbers of a quantity, the policy does not tell values apart. `vector` is the position",
        "in the C function's vector; a quantity of a set repeats in each row.",
        "",
        *rows(
            ("vector", "name", "width", "rows", "unit", "frame", "divisor", "recorded", "clipped", "meaning"),
            contract["observation"],
        ),
        "",
        "## Actions",
        "",
        *rows(tuple(contract["actions"][0]), contract["actions"]),
        "",
        "## Record",
        "",
        f"`contract.json` has all inputs and outputs of {len(contract['record']['outputs']['action'])} decisions in flight.",
        f"Least lead of a highest logit over the next one: {cell(contract['record']['margin']) or 'none, for want of a choice'}.",
        "",
    ]
    return "\n".join(lines)


def rows(columns: Sequence[str], values: Sequence[Mapping[str, object]]) -> list[str]:
    """Return a table in Markdown."""
    head = [f"| {' | '.join(columns)} |", f"|{'---|' * len(columns)}"]
    return head + [f"| {' | '.join(cell(value[name]) for name in columns)} |" for value in values]


def cell(value: object) -> str:
    """Return the text of a cell."""
    if isinstance(value, float):
        return f"{value:.5g}"
    if isinstance(value, list):
        return f"[{', '.join(cell(part) for part in cast(list[object], value))}]"
    return "" if value is None else str(value).replace("|", r"\|")
