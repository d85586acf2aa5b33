"""The table of the commands of ``bsk-torch``; the module of a command is imported when it runs or its help is asked for."""

from __future__ import annotations

import logging
from functools import cache
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

from bsk_torch import __version__
from bsk_torch._rooms import absent_room
from bsk_torch.cli.declaration import WithoutTypes, command
from bsk_torch.cli.names import resolved
from bsk_torch.cli.terminal import activity, described, echo, fail, of_arguments, print_message

logger = logging.getLogger(__name__)

INTERRUPTED = 130
"""Exit status after Ctrl-C, as in shells."""

GROUPS: dict[str, dict[str, tuple[str, str]]] = {
    "Everyday": {
        "list": ("bsk_torch.cli.presets:list_presets", "List the environments, and what rules and policies return in them."),
        "args": (
            "bsk_torch.cli.show:show_arguments",
            "Show the arguments of a preset's satellites and world: value in the preset, default and meaning.",
        ),
        "train": (
            "bsk_torch.cli.train:train",
            "Train policies with PPO, MAPPO or IPPO, and compare them with random actions and rules in unseen episodes.",
        ),
        "eval": (
            "bsk_torch.cli.evaluate:evaluate_policy",
            "Compare policies in the same episodes: returns, survival, causes of death, and measures of the task.",
        ),
        "report": (
            "bsk_torch.cli.report:report",
            "Write report.html into a run folder: learning curves, final comparison, episodes on maps. Needs the extra viz.",
        ),
        "film": (
            "bsk_torch.cli.film:film",
            "Film an episode of a policy, or draw it as one picture. Needs the extra viz; .mp4 needs video.",
        ),
        "view": ("bsk_torch.viewer.commands:view", "Show an episode in the browser: a preset, a run or a recording."),
    },
    "Study a policy": {
        "explain": (
            "bsk_torch.lab.commands.explain:explain_failures",
            "Find actions that would have saved each lost satellite, or prove that none exist.",
        ),
        "audit": (
            "bsk_torch.lab.commands.audit:audit_policy",
            "Find the decisions at which a policy loses, by flying all other actions as well.",
        ),
        "risk": (
            "bsk_torch.lab.commands.risk:estimate_risk",
            "Estimate the probability of a rare loss, with its interval, and show the ways to it.",
        ),
        "bench": ("bsk_torch.lab.commands.bench:bench", "Compare policies from any library in the fixed episodes of a suite."),
        "leaderboard": (
            "bsk_torch.lab.commands.leaderboard:leaderboard",
            "Compare methods in all tasks of a suite, with the aggregates of Agarwal et al. (2021).",
        ),
        "dataset": (
            "bsk_torch.lab.commands.dataset:dataset",
            "Write episodes of several policies for offline learning, with the returns of all actions at a sample of decisions.",
        ),
        "mcp": (
            "bsk_torch.lab.agents.commands:mcp",
            "Serve episodes as tools to an agent: observe, list_actions, what_if, commit, report.",
        ),
    },
    "Exchange and maintain": {
        "export-policy": (
            "bsk_torch.lab.commands.export_policy:export_policy",
            "Export a trained policy for flight software and other programs: network, normalizer, mask and choice of the action.",
        ),
        "export": ("bsk_torch.viewer.commands:export", "Write an episode of a preset, a run or a recording to a file."),
        "windows": (
            "bsk_torch.cli.windows:windows",
            "List when satellites are above places on the ground, by SGP4 and the WGS84 ellipsoid.",
        ),
        "aeossp plan": (
            "bsk_torch.tasks.aeossp.commands:plan_case",
            "Plan the observations of a case of aeossp_standard, and write a solution that its verifier accepts.",
        ),
        "aeossp check": (
            "bsk_torch.tasks.aeossp.commands:check_solution",
            "Check a solution of a case of aeossp_standard by the benchmark's rules; the exit status is 1 for an invalid one.",
        ),
        "aeossp fly": (
            "bsk_torch.tasks.aeossp.commands:fly_solution",
            "Fly a plan of aeossp_standard with rigid bodies, wheels and batteries, and show what it delivers.",
        ),
        "import-aeosbench": (
            "bsk_torch.tasks.aeos_bench.commands:import_aeosbench",
            "Fly the assigned tasks in files of AEOS-Bench, and show the measures of the benchmark.",
        ),
        "export-aeosbench": (
            "bsk_torch.tasks.aeos_bench.commands:export_aeosbench",
            "Fly cases of AEOS-Bench, and write trajectories and annotations for its own evaluator.",
        ),
        "schedule": (
            "bsk_torch.cli.show:show_schedule",
            "Show the order of a tick: all slots, or the components of a preset, and what computes the phases of a step.",
        ),
        "profile": (
            "bsk_torch.cli.train:profile",
            "Show where the CPU time of a training goes, decisions per CPU-second, and what to change.",
        ),
        "build-kernels": (
            "bsk_torch.cli.kernels:build_kernels",
            "Compile the kernels of presets for machines without a compiler.",
        ),
    },
}
"""Commands by group: function, ``module:function``, and the first line of its help."""

COMMANDS = {name: entry for group in GROUPS.values() for name, entry in group.items()}


@cache
def loaded(name: str) -> object:
    """Return a command with its options; ends the program if its room is not installed."""
    return command(name, resolved(name, COMMANDS[name][0]))


class Commands(WithoutTypes, TyperGroup):
    """Ends the program with one error instead of a traceback if files, memory or a compiler fail during a command."""

    def __init__(self, **attributes: Any) -> None:
        """Have the installed commands, each with a line of help until it is asked for."""
        super().__init__(**attributes)
        self.commands = {
            name: TyperCommand(name, help=line, rich_help_panel=title)
            for title, group in GROUPS.items()
            for name, (path, line) in group.items()
            if not absent_room(path)
        }
        if absent := [name for name in COMMANDS if name not in self.commands]:
            self.epilog = f"{self.epilog}\n\nNot installed: {', '.join(absent)}."

    def resolve_command(self, ctx: Any, args: list[str]) -> tuple[str | None, Any, list[str]]:
        """Return name, command and further arguments; some names are of two words."""
        for words in (2, 1):
            if (name := " ".join(args[:words])) in COMMANDS:
                return name, loaded(name), args[words:]
        return super().resolve_command(ctx, args)

    def invoke(self, ctx: Any) -> Any:
        """Run the command."""
        try:
            return super().invoke(ctx)
        except (typer.Exit, typer.Abort, BrokenPipeError):
            raise
        except KeyboardInterrupt:
            activity.show("")
            print_message("interrupted")
            raise typer.Exit(INTERRUPTED) from None
        except (OSError, RuntimeError, MemoryError) as error:
            logger.debug("the command failed", exc_info=error)
            fail(described(error))
        except (KeyError, TypeError, ValueError) as error:
            if not of_arguments(error):
                raise
            logger.debug("no episode could begin", exc_info=error)
            fail(described(error))  # --verbose shows where
        finally:
            activity.report()


app = typer.Typer(cls=Commands, no_args_is_help=True, add_completion=False, rich_markup_mode="rich")


def show_version(is_set: bool) -> None:
    """Print the version and end the program."""
    if is_set:
        echo(f"bsk_torch {__version__}")
        raise typer.Exit


@app.callback(epilog="'bsk-torch COMMAND --help' shows the options of a command, with examples.")
def setup(
    version: Annotated[
        bool, typer.Option("--version", metavar="", is_eager=True, callback=show_version, help="Show the version and exit.")
    ] = False,
) -> None:
    """Train, evaluate and film policies for spacecraft tasking."""
