"""How functions become commands: their parameters are arguments and options, their docstrings the help, without torch."""

from __future__ import annotations

import inspect
import textwrap
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperCommand
from typer.main import get_command

from bsk_torch._listed import PLANNERS, RULES
from bsk_torch.cli import terminal
from bsk_torch.cli.names import check_names

MACHINE = "Machine"
"""Panel of the help with options that do not change what a command does."""


def flag(metavar: str, text: str, *names: str, **settings: Any) -> Any:
    """Return an option of the command line with its placeholder and help, and perhaps other names than its parameter's."""
    return typer.Option(*names, metavar=metavar, help=text, **settings)


# -- arguments and options of several commands -----------------------------------------------------------------------------------

Preset = Annotated[
    str,
    typer.Argument(
        help="Environment; 'bsk-torch list' names them; or your own (module:name or file.py:name).", show_default=False
    ),
]
ANY = (
    "Run folder, 'pretrained', policy file of any library (Stable-Baselines3, ONNX, torch.export, RLlib, BenchMARL, torch), your "
    "own function (package.module:function),"
)
FEW = "a baseline, such as random, rule or hasty ('bsk-torch eval --help' names all)"
Policy = Annotated[str, typer.Argument(help=f"{ANY} or {FEW}.", show_default=False)]
Trust = Annotated[bool, typer.Option("--trust", help="Also read policy files that execute code, such as pickles.")]
PLANS = f"or a planner ({', '.join(f'plan:{name}' for name in PLANNERS)})."
PolicyOrPlanner = Annotated[str, typer.Argument(help=f"{ANY} {FEW}, {PLANS}", show_default=False)]
PoliciesOrPlanners = Annotated[
    list[str], typer.Argument(help=f"{ANY} a baseline ({', '.join(RULES)}), {PLANS}", show_default=False)
]
OfPreset = Annotated[
    str | None,
    flag("NAME", "Environment, or your own (module:name or file.py:name); default: the environment of the run, or NadirScan-v1."),
]
Plan = Annotated[
    list[str] | None, flag("NAME=VALUE", "Option of a planner, such as base=hasty, horizon=240 or budget=64; repeatable.")
]
Options = Annotated[
    list[str] | None,
    flag("NAME=VALUE", "Option of the environment, such as n_targets=1000 or folder=cases; repeatable.", "--option"),
]
Seed = Annotated[int, flag("N", "Seed of the episode.", min=0)]
Seeds = Annotated[str, flag("A:B", "Episodes of the seeds A to B - 1, or of a single seed.")]
Until = Annotated[float | None, flag("S", "Stop after S seconds of the episode.")]
AtOnce = Annotated[int, flag("N", "Episodes at once.", min=1)]
JsonFile = Annotated[Path | None, flag("FILE", "JSON file for the results.")]

SETTINGS: dict[str, tuple[object, object]] = {
    "threads": (Annotated[int, flag("N", "Threads of torch.", min=1, rich_help_panel=MACHINE)], 1),
    "backend": (
        Annotated[str, flag("NAME", "'compiled', or 'eager', which needs no compiler.", rich_help_panel=MACHINE)],
        "compiled",
    ),
    "device": (Annotated[str, flag("NAME", "Device of torch, such as 'cuda'.", rich_help_panel=MACHINE)], "cpu"),
    "time_limit": (Annotated[float | None, flag("S", "Length of an episode in seconds; default: the preset's.")], None),
    "verbose": (Annotated[bool, typer.Option("--verbose", "-v", help="Show debug messages.", rich_help_panel=MACHINE)], False),
    "quiet": (
        Annotated[bool, typer.Option("--quiet", "-q", help="Show results, warnings and errors only.", rich_help_panel=MACHINE)],
        False,
    ),
}
"""Annotation and default of options that :func:`command` adds."""

EnvironmentOptions = Annotated[dict[str, Any], ("threads", "backend", "device", "time_limit")]
MachineOptions = Annotated[dict[str, Any], ("threads", "backend", "device")]
"""Kinds of the parameter ``options`` of a command, a dictionary of arguments of its environment, from the named options of the
command line. Threads are set for torch, and not in the dictionary; nor are options without a value."""


# -- commands --------------------------------------------------------------------------------------------------------------------


class WithoutTypes:
    """A command whose help shows no types of switches."""

    def get_params(self, ctx: object) -> list[Any]:
        """Return the parameters; ``--help <bool>`` says no more than ``--help``."""
        parameters: list[Any] = super().get_params(ctx)  # type: ignore[misc]
        for parameter in parameters:
            if getattr(parameter, "is_flag", False):
                parameter.metavar = ""
        return parameters


class Command(WithoutTypes, TyperCommand):
    """One of the commands."""


def unwrapped(text: str) -> str:
    """Return a docstring with one line for each paragraph, which the terminal's width breaks."""
    return "\n\n".join(" ".join(part.split()) for part in text.split("\n\n"))


def command(name: str, function: Callable[..., None]) -> object:
    """Return the command ``name``, which calls a function.

    Its arguments and options are the parameters of the function, as their annotations declare them, those that its parameter
    ``options`` stands for (:data:`EnvironmentOptions`), and ``--verbose`` and ``--quiet``. Its help is the docstring, which
    ends with its section *Examples*.
    """
    help_text, _, examples = inspect.cleandoc(function.__doc__ or "").partition("\n\nExamples:\n")
    signature = inspect.signature(function, eval_str=True)
    declared = dict(signature.parameters)
    settings: tuple[str, ...] = declared.pop("options").annotation.__metadata__[0] if "options" in declared else ()

    def start(*, verbose: bool, quiet: bool, **arguments: object) -> None:
        terminal.set_verbosity(verbose, quiet)
        check_names(arguments)
        if settings:
            with terminal.working("starting"):  # importing torch takes seconds
                import_module("bsk_torch.env")
            values = {setting: arguments.pop(setting) for setting in settings}
            if "threads" in values:
                import_module("torch").set_num_threads(values.pop("threads"))
            arguments["options"] = {setting: value for setting, value in values.items() if value is not None}
        function(**arguments)

    kind = inspect.Parameter.KEYWORD_ONLY
    shared = ((setting, *SETTINGS[setting]) for setting in (*settings, "verbose", "quiet"))
    parameters = [*declared.values(), *(inspect.Parameter(n, kind, annotation=a, default=d) for n, a, d in shared)]
    start.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
    start.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    app = typer.Typer(add_completion=False, rich_markup_mode="rich")
    epilog = "Examples:\n\n" + textwrap.dedent(examples).strip().replace("[", r"\[")
    app.command(name, cls=Command, help=unwrapped(help_text), epilog=epilog)(start)
    return get_command(app)
