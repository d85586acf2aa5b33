"""Names of presets and policies on the command line, checked without torch, so that a typo costs no time."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bsk_torch._listed import LISTED, PLANNERS, PREFIX, RULES, makings, no_policy, unlisted
from bsk_torch._rooms import absent_room, resolve
from bsk_torch.cli.terminal import fail, refusing
from bsk_torch.sim.names import nearest

PRETRAINED = "pretrained"
"""Name of the policy that comes with the package."""

FIRST = next(iter(LISTED))
"""The environment unless the command line or a run names another."""


def resolved(name: str, path: str) -> Any:
    """Return the object at "module:function" that ``name`` stands for; ends the program if its room is not installed."""
    if folder := absent_room(path):
        fail(f"{name!r} is not installed: this copy of bsk_torch has no folder {folder}")
    return resolve(path)


def check_names(arguments: Mapping[str, Any]) -> None:
    """End the program for a preset or policy among the arguments of a command that does not exist."""
    preset, what = arguments.get("preset"), arguments.get("what")
    if preset is not None and not arguments.get("resume"):  # else it is the folder of a run
        check_preset(preset)
    if what is not None and not is_preset(what) and not Path(what).exists() and not Path(what).suffix:
        fail(f"{what!r} is neither a preset, nor the folder of a run, nor a recording; {nearest(what, LISTED)}")
    if what is not None and is_preset(what):
        check_preset(what)
        preset = what
    for policy in ("policy", "policies", "behavior", "target"):
        names = arguments.get(policy) or ()
        for name in [names] if isinstance(names, str) else names:
            check_policy(name, preset)


def is_preset(name: str) -> bool:
    """Return whether a name is that of a preset, or of a function of the user's, ``module:name`` or ``file.py:name``."""
    return name in LISTED or (":" in name and not Path(name).exists())


def check_preset(name: str) -> None:
    """End the program for a name that is none of the presets; import a function of the user's, which takes its place."""
    if not is_preset(name):
        fail(unlisted(name))
    if name not in LISTED:
        from bsk_torch.presets.own import enter_named

        with refusing(TypeError, ValueError):
            enter_named(name)


def check_policy(name: str, preset: str | None) -> None:
    """End the program for a name that is neither a rule, a planner, a file, nor a function of the user's.

    What follows a comma is not checked here.
    """
    plain, exists = name.partition(",")[0], Path(name).exists()
    if plain == PRETRAINED and (preset or FIRST) not in makings():
        fail(no_policy(preset or FIRST))
    if plain.startswith(PREFIX) and plain.removeprefix(PREFIX) not in PLANNERS:
        fail(f"{plain!r} is not a planner; {nearest(plain, [PREFIX + planner for planner in PLANNERS])}")
    if exists or plain in (*RULES, PRETRAINED) or ":" in plain:
        return
    fail(
        f"{name!r} is not a run folder, policy file, function (package.module:function) or baseline; {suggestion(plain, preset)}"
    )


def suggestion(name: str, preset: str | None) -> str:
    """Return names of the kind that was written: a policy for a preset, files for a path, else rules, or those of the preset."""
    path = Path(name)
    if name in LISTED:
        return f"it is a preset: name a policy first, such as pretrained, then --preset {name}"
    if path.suffix or path.name != name:
        siblings = [str(other) for other in path.parent.iterdir()] if path.parent.is_dir() else []
        return nearest(name, siblings) if siblings else f"there is no folder {str(path.parent)!r}"
    hint = nearest(name, (*RULES, PRETRAINED))
    if hint.startswith("did you mean"):
        return hint
    preset = preset if preset in LISTED else FIRST
    return f"those of {preset}: {', '.join(('random', *LISTED[preset].rules, PRETRAINED))}"
