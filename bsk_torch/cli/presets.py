"""``bsk-torch list``: the environments, without importing torch."""

from __future__ import annotations

from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

from bsk_torch._listed import LISTED, ONE, REMARKS, makings, scores
from bsk_torch._rooms import absent_room
from bsk_torch.tables import line_width, print_table


def list_presets(
    long: Annotated[bool, typer.Option("--long", help="Add score and training of the pretrained policies.")] = False,
) -> None:
    """List the environments, and what rules and policies return in them.

    Examples:
        bsk-torch list
        bsk-torch list --long
    """
    if not long:
        table = Table.grid(padding=(0, 2))
        for name, preset in LISTED.items():
            folder = absent_room(preset.function)
            about = Text(f"not installed: no folder {folder}" if folder else preset.task)
            table.add_row(Text(name, style="bold"), about.append(scored(name), style="dim"))
        table.add_row("", Text(f"\n{SCORED}"))
        Console(width=line_width()).print(table)
        return
    print_table(
        [described(name, makings().get(name)) for name in LISTED], EXPLAINED, ("survival", "satellites"), ("preset", "satellites")
    )


SCORED = (
    "Last lines: mean returns of the best rule and of the pretrained policy in the same n unseen episodes, the gain of the "
    "policy with its 95 % interval, and in brackets its share of how far the better one is above random actions."
)


def scored(name: str) -> str:
    """Return the line of a preset on its best rule and its pretrained policy."""
    entry = scores().get(name)
    if entry is None:
        return "\nno scores: to measure all policies takes core-minutes"
    returns, gain = {policy: row["mean"] for policy, row in entry["policies"].items()}, entry["gain"]
    random, rule = returns["random"], returns[entry["best_rule"]]
    digits = 3 if abs(rule) < 10.0 else 1
    line = f"\n{entry['best_rule']} {rule:.{digits}f}, "
    if gain is None:
        remark = f" ({REMARKS[name]})" if name in REMARKS else ""
        return f"{line}no policy{remark}, n={entry['episodes']}"
    policy = returns["pretrained"]
    share = gain["mean"] / (max(policy, rule) - random)
    interval = f"{gain['mean']:+.{digits}f} ± {gain['half_width']:.{digits}f}"
    return f"{line}policy {policy:.{digits}f}: {interval} ({share:+.1%}), n={entry['episodes']}"


EXPLAINED = "Pretrained policies: mean return of unseen episodes with its 95 % interval, and their training"


def described(name: str, note: dict[str, Any] | None) -> dict[str, str]:
    """Return the cells of a preset: how many satellites, and the notes on its pretrained policy, if it has one."""
    satellites = {"preset": name, "satellites": "one" if LISTED[name].views is ONE else "several"}
    if note is None:
        return satellites | dict.fromkeys(("return", "survival", "decisions", "minutes"), "")
    score = note["score"]
    digits = 1 if score["return"] >= 10.0 else 3
    return satellites | {
        "return": f"{score['return']:.{digits}f} ± {score['half_width']:.{digits}f}",
        "survival": f"{score['survival']:.1%}",
        "decisions": f"{note['frames']:,}",
        "minutes": f"{note['seconds'] / 60.0:.0f}",
    }
