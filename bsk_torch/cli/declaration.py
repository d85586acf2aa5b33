"""How commands are declared: with what users see of them, and without torch.

``command`` adds a function to the application. Its body is empty: the function of the same name in the module that is given there
does the work, and is imported when the command runs.
"""

from __future__ import annotations

import functools
import inspect
import textwrap
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperCommand

from bsk_torch._listed import PLANNERS, RULES
from bsk_torch.cli import terminal
from bsk_torch.cli.names import check_names

Parameters = list[inspect.Parameter]

MACHINE = "Machine"
"""Panel of the help with options that do not change what a command does."""

Preset = Annotated[str, typer.Argument(help="Environment; 'bsk-torch list' names them.", show_default=False)]
BASELINES = ", ".join(RULES)

Policy = Annotated[
    str,
    typer.Argument(
        help=f"Run folder, policy file, 'pretrained', your own function (package.module:function), or a baseline: {BASELINES}.",
        show_default=False,
    ),
]
PLANNED = (
    f"Run folder, policy file, 'pretrained', your own function (package.module:function), a baseline ({BASELINES}), or a planner "
    f"({', '.join(f'plan:{name}' for name in PLANNERS)})."
)
PolicyOrPlanner = Annotated[str, typer.Argument(help=PLANNED, show_default=False)]
PoliciesOrPlanners = Annotated[list[str], typer.Argument(help=PLANNED, show_default=False)]
Changes = Annotated[
    list[str] | None,
    typer.Argument(
        metavar="NAME=VALUE",
        help="Settings that differ from the preset's recipe, such as learning_rate=1e-3, evaluate_every=500000, "
        "collector=multi, or options.n_targets=1000 for the environment: the fields of bsk_torch.rl.training.PPOConfig and, "
        "for constellations, bsk_torch.rl.marl.MAPPOConfig.",
        show_default=False,
    ),
]
Algorithm = Annotated[
    str | None, typer.Option(metavar="NAME", help="'ppo' for one satellite; 'mappo' (default) or 'ippo' for constellations.")
]
Network = Annotated[
    str | None,
    typer.Option(
        metavar="NAME",
        help="'mlp' (default for one satellite), 'gru' (with a memory), or 'attention' (for targets observed as a set, and "
        "for constellations).",
    ),
]
What = Annotated[str, typer.Argument(help="Preset, run folder, or recording (.bskview).", show_default=False)]
WithPolicy = Annotated[
    str | None,
    typer.Option(
        "--policy",
        metavar="NAME",
        help="Policy of a preset: 'pretrained' (default), a baseline, a run folder, or a planner such as plan:rollout.",
    ),
]
Branches = Annotated[
    list[str] | None,
    typer.Option("--branch", metavar="DECISION:ACTION", help="Another future: take this action at that decision; repeatable."),
]
Run = Annotated[Path, typer.Argument(help="Run folder.", show_default=False)]
OfPreset = Annotated[str | None, typer.Option(metavar="NAME", help="Environment; default: that of the run, or NadirScan-v1.")]
Plan = Annotated[
    list[str] | None,
    typer.Option(metavar="NAME=VALUE", help="Option of a planner, such as base=hasty, horizon=240 or budget=64; repeatable."),
]
Options = Annotated[
    list[str] | None,
    typer.Option(
        "--option", metavar="NAME=VALUE", help="Option of the environment, such as n_targets=1000 or folder=cases; repeatable."
    ),
]
Sensor = Annotated[
    str, typer.Option(metavar="NAME", help="When sensors are on: 'assigned', while a task is assigned, or 'on', always.")
]
Shield = Annotated[str | None, typer.Option(metavar="NAME", help="'safe', 'imager', or package.module:function.")]
TimeLimit = Annotated[float | None, typer.Option(metavar="S", help="Length of an episode in seconds; default: the preset's.")]
Threads = Annotated[int, typer.Option(metavar="N", min=1, help="Threads of torch.", rich_help_panel=MACHINE)]
Backend = Annotated[
    str, typer.Option(metavar="NAME", help="'compiled', or 'eager', which needs no compiler.", rich_help_panel=MACHINE)
]
Device = Annotated[str, typer.Option(metavar="NAME", help="Device of torch, such as 'cuda'.", rich_help_panel=MACHINE)]
Verbose = Annotated[bool, typer.Option("--verbose", "-v", help="Show debug messages.", rich_help_panel=MACHINE)]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Show results, warnings and errors only.", rich_help_panel=MACHINE)]

VERBOSITY: Parameters = [
    inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=False, annotation=annotation)
    for name, annotation in (("verbose", Verbose), ("quiet", Quiet))
]
"""Parameters that every command has."""


class WithoutTypes:
    """A command whose help shows no types of switches."""

    def get_params(self, ctx: Any) -> list[Any]:
        """Return the parameters; ``--help <bool>`` says no more than ``--help``."""
        found: list[Any] = super().get_params(ctx)  # type: ignore[misc]
        for parameter in found:
            if getattr(parameter, "is_flag", False):
                parameter.metavar = ""
        return found


class Command(WithoutTypes, TyperCommand):
    """One of the commands."""


def unwrapped(text: str) -> str:
    """Return a docstring with one line for each paragraph, which the terminal's width breaks."""
    return "\n\n".join(" ".join(part.split()) for part in inspect.cleandoc(text).split("\n\n"))


def command(app: typer.Typer, module: str, examples: str, name: str | None = None) -> Callable[[Callable[..., None]], object]:
    """Return a decorator that adds a function to the application; see above.

    Args:
        app: The application.
        module: Module of :mod:`bsk_torch.cli` whose function of the same name does the work.
        examples: Commands, one a line, for the end of the help.
        name: What users type; default: the function's name.
    """

    def add(declared: Callable[..., None]) -> object:
        @functools.wraps(declared)
        def start(*, verbose: bool, quiet: bool, **arguments: Any) -> None:
            terminal.set_verbosity(verbose, quiet)
            check_names(arguments)
            with terminal.working("starting"):  # importing torch takes seconds
                work = getattr(import_module(f"bsk_torch.cli.{module}"), declared.__name__)
            work(**arguments)

        signature = inspect.signature(declared, eval_str=True)
        start.__signature__ = signature.replace(parameters=[*signature.parameters.values(), *VERBOSITY])  # type: ignore[attr-defined]
        start.__annotations__ = {p.name: p.annotation for p in start.__signature__.parameters.values()}  # type: ignore[attr-defined]
        epilog = "Examples:\n\n" + textwrap.dedent(examples).strip().replace("[", r"\[")
        return app.command(name, cls=Command, help=unwrapped(declared.__doc__ or ""), epilog=epilog)(start)

    return add
