"""``bsk-torch export-policy``: a trained policy as ONNX, ``torch.export`` or C, with its contract."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bsk_torch.cli.declaration import OfPreset, flag
from bsk_torch.cli.names import FIRST, PRETRAINED
from bsk_torch.cli.shared import check_writable
from bsk_torch.cli.terminal import echo, fail, refusing, working


def export_policy(
    policy: Annotated[str, typer.Argument(help="Run folder, policy file, or 'pretrained'.", show_default=False)],
    out: Annotated[Path, flag("DIR", "Folder for the files.", "--out")],
    preset: OfPreset = None,
    onnx: Annotated[bool, typer.Option("--onnx", help="Write policy.onnx. Needs the extra onnx.")] = False,
    torch: Annotated[bool, typer.Option("--torch", help="Write policy.pt2, a file of torch.export.")] = False,
    c: Annotated[bool, typer.Option("--c", help="Write policy.c and policy.h, C99 without dependencies.")] = False,
    shield: Annotated[str | None, flag("NAME", "Shield to include, 'safe' or 'imager'.")] = None,
    *,
    options: Annotated[dict[str, object], ("threads", "backend", "time_limit")],
) -> None:
    """Export a trained policy for flight software and other programs: network, normalizer, mask and choice of the action.

    A contract, as JSON and as a page, has the names, units, frames and bounds of all numbers, and a table of recorded decisions.

    Examples:
        bsk-torch export-policy runs/scan --onnx --out exported
        bsk-torch export-policy pretrained --preset AEOS-v1 --torch --c --out exported
        bsk-torch export-policy runs/scan --c --shield safe --out exported
    """
    from bsk_torch.lab.export import export_policy as export

    forms = [name for name, chosen in (("onnx", onnx), ("torch", torch), ("c", c)) if chosen]
    if not forms:
        fail("choose at least one of --onnx, --torch and --c")
    check_writable(out.absolute().parent / (out.name + ".part"))
    with refusing(ValueError, FileNotFoundError, ModuleNotFoundError, KeyError), working("exporting"):
        contracts = export(
            policy, out, forms, preset=preset or (FIRST if policy == PRETRAINED else None), shield=shield, **options
        )
    for group, contract in contracts.items():
        place = out if len(contracts) == 1 else out / group
        decisions = len(contract["record"]["outputs"]["action"])
        echo(f"{place}: {contract['network']['parameters']:,} parameters, {decisions} recorded decisions, contract.json and .md")
    absent = {text: None for contract in contracts.values() for text in contract["not_included"]}
    echo(f"not in the exported files: {'; '.join(absent) or 'nothing'}")
