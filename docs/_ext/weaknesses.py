"""Tables of rare losses and adversarial scenarios."""

from __future__ import annotations

from collections.abc import Callable

from docs._ext.markdown import digits, table, whole
from docs._ext.results import certificate, load, made, with_command

PARAMETERS = {
    "battery": "capacity of the battery, of the preset's",
    "charge": "initial charge, of the capacity",
    "storage": "initial data, of the capacity",
    "spin": "bound of initial wheel speeds, of the largest",
    "fastest": "largest wheel speed, of the preset's",
    "torque": "disturbance, of the preset's",
    "baud": "baud rate of the transmitter, of the preset's",
    "panel": "area of the panel, of the preset's",
    "inclination": "inclination, degrees",
}
"""What the parameters of adversarial scenarios are."""


def adversarial_family(name: str, box: str) -> str:
    """Return the family that a search has found in a box."""
    content = load(name)
    whole_box, found = content["boxes"][box], content["families"][box]["family"]
    rows = [
        [title, *(" to ".join(f"{end:.3g}" for end in ends[key]) for ends in (whole_box, found))]
        for key, title in PARAMETERS.items()
    ]
    return table(["parameter", "searched", "family"], rows) + "\n"


def adversaries(name: str) -> str:
    """Return what policies reach in a family and in the preset, with the rule in the same episodes."""
    rows = [
        [
            row["policy"],
            row["condition"],
            f"{row['value']:.3f} ± {row['half']:.3f}",
            f"{row['gain']:+.3f} ± {row['gain_half']:.3f}",
            f"{row['survival']:.1%}",
            f"{row['rule_survival']:.1%}",
            whole(row["episodes"]),
        ]
        for row in load(name)["rows"]
    ]
    head = ["policy", "episodes from", "return", "over the rule", "survival", "the rule's", "episodes"]
    return with_command(name, head, rows)


def adversarial_flights(name: str, box: str) -> str:
    """Return the certificates of a family on Basilisk."""
    rows = [
        [
            f"`{policy}`" if policy == "rule" else "of the package",
            *(", ".join(f"{value:.4f}" for value in flown[key]) for key in ("returns", "returns_basilisk")),
            *(", ".join("yes" if value else "no" for value in flown[key]) for key in ("survived", "survived_basilisk")),
            certificate({"episodes": len(flown["returns"])} | flown),
        ]
        for policy, flown in load(name)["families"][box]["basilisk"].items()
    ]
    head = ["policy", "returns", "on Basilisk", "survived", "on Basilisk", "same decisions; largest difference"]
    return table(head, rows) + "\n"


def risks(*names: str) -> str:
    """Return estimated probabilities, next to the shares of independent episodes, of the questions in some results."""
    rows = []
    for found in [found for name in names for found in load(name)["questions"].values()]:
        asked, plain, (mean, low, high) = found["question"], found.get("plain"), found["probability"].values()
        limit = asked["options"].get("time_limit")
        rows.append(
            [
                asked["preset"] + ("" if limit is None else f", first {limit:,.0f} s"),
                asked["policy"],
                f"`{asked['event']}`",
                f"{mean:.1e} ({low:.1e} to {high:.1e})" if mean else f"at most {high:.1e}",
                whole(found["episodes"]),
                f"{plain['mean']:.1e} ({plain['low']:.1e} to {plain['high']:.1e})" if plain else "-",
                whole(plain["episodes"]) if plain else "-",
                digits(found["saved"]) if found["saved"] else "-",
                whole(found["cpu"]),
            ]
        )
    head = [
        "task",
        "policy",
        "event",
        "estimate",
        "episodes",
        "independent episodes",
        "their number",
        "factor",
        "core-s",
    ]
    return f"{table(head, rows)}\n\n" + "\n".join(made(name) for name in names)


def known_risks(name: str) -> str:
    """Return estimates of known probabilities."""
    rows = [
        [
            f"{case['probability']:.0e}",
            f"{case['mean']:.2e} ± {case['standard_error']:.1e}",
            f"{case['relative_error_of_one_repetition']:.0%}",
            f"{case['intervals_with_the_truth']} of {case['runs']}",
            whole(case["episodes"]),
            digits(case["saved"]),
        ]
        for case in load(name)["textbook"]
    ]
    head = ["probability", "mean estimate, standard error", "error of a repetition", "intervals with it", "episodes", "factor"]
    return f"{table(head, rows)}\n"


TABLES: dict[str, Callable[..., str]] = {
    "risks": risks,
    "known_risks": known_risks,
    "adversarial_family": adversarial_family,
    "adversaries": adversaries,
    "adversarial_flights": adversarial_flights,
}
"""Tables by name."""
