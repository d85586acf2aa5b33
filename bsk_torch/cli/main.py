"""The commands of ``bsk-torch`` with their options. This module imports neither torch nor the modules that do the work."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from bsk_torch import __version__
from bsk_torch.cli.declaration import (
    MACHINE,
    Algorithm,
    Backend,
    Branches,
    Changes,
    Device,
    Network,
    OfPreset,
    Options,
    Plan,
    PoliciesOrPlanners,
    Policy,
    PolicyOrPlanner,
    Preset,
    Run,
    Sensor,
    Shield,
    Threads,
    TimeLimit,
    What,
    WithoutTypes,
    WithPolicy,
    command,
)
from bsk_torch.cli.terminal import activity, described, echo, fail, of_arguments, print_message

logger = logging.getLogger(__name__)

INTERRUPTED = 130
"""Exit status after Ctrl-C, as in shells."""


class Commands(WithoutTypes, TyperGroup):
    """Ends the program with one error instead of a traceback if files, memory or a compiler fail during a command."""

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


def show_version(asked: bool) -> None:
    """Print the version and end the program."""
    if asked:
        echo(f"bsk_torch {__version__}")
        raise typer.Exit


@app.callback(epilog="'bsk-torch COMMAND --help' shows the options of a command, with examples.")
def setup(
    version: Annotated[
        bool, typer.Option("--version", metavar="", is_eager=True, callback=show_version, help="Show the version and exit.")
    ] = False,
) -> None:
    """Train, evaluate and film policies for spacecraft tasking."""


@command(app, "presets", "bsk-torch list\nbsk-torch list --long", name="list")
def list_presets(
    long: Annotated[bool, typer.Option("--long", help="Add score and training of the pretrained policies.")] = False,
) -> None:
    """List the environments with short descriptions."""


@command(
    app,
    "train",
    """
    bsk-torch train NadirScan-v1 --minutes 3
    bsk-torch train AEOS-v1 --network attention --frames 600000 --out runs/aeos
    bsk-torch train NadirScan-v1 learning_rate=1e-3 'hidden=[128,128]'
    bsk-torch train NadirScan-v1 --workers auto
    bsk-torch train runs/aeos --resume frames=1200000
    """,
)
def train(
    context: typer.Context,
    preset: Annotated[
        str, typer.Argument(help="Environment ('bsk-torch list' names them); with --resume, a run folder.", show_default=False)
    ],
    changes: Changes = None,
    algorithm: Algorithm = None,
    network: Network = None,
    minutes: Annotated[
        float | None,
        typer.Option(metavar="M", min=0.01, help="Training time, without compilation; default: 3, or no limit with --frames."),
    ] = None,
    frames: Annotated[
        int | None, typer.Option(metavar="N", help="Number of decisions. With --minutes, the limit reached first counts.")
    ] = None,
    seed: Annotated[int, typer.Option(metavar="N", min=0, help="Seed of networks, actions and episodes.")] = 0,
    seeds: Annotated[
        int, typer.Option(metavar="N", min=1, help="Number of runs, one after the other, with seeds starting at --seed.")
    ] = 1,
    workers: Annotated[
        str | None,
        typer.Option(
            metavar="N",
            help="Number of processes that collect experience, or 'auto' for as many as suit the available cores; default: none "
            "in addition to the one that learns.",
            rich_help_panel=MACHINE,
        ),
    ] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Resume the run in the given folder.")] = False,
    out: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="Folder for the results; default: a new one in runs/.")
    ] = None,
    episodes: Annotated[
        int, typer.Option(metavar="N", min=0, help="Unseen episodes of the final comparison; with 0, there is none.")
    ] = 256,
    threads: Threads = 1,
    backend: Backend = "compiled",
    device: Device = "cpu",
    time_limit: TimeLimit = None,
) -> None:
    """Train policies with PPO, MAPPO or IPPO, and compare them with random actions and rules in unseen episodes."""


@command(
    app,
    "profile",
    """
    bsk-torch profile NadirScan-v1
    bsk-torch profile AEOS-v1 --network attention num_envs=512 'hidden=[32]'
    """,
)
def profile(
    preset: Preset,
    changes: Changes = None,
    algorithm: Algorithm = None,
    network: Network = None,
    seconds: Annotated[float, typer.Option(metavar="S", min=0.01, help="CPU time to measure, without compilation.")] = 10.0,
    backend: Backend = "compiled",
    device: Device = "cpu",
    time_limit: TimeLimit = None,
) -> None:
    """Print where the CPU time of a training goes, decisions per CPU-second, and what to change.

    Nothing is kept. The training is in one process and one thread, without evaluations.
    """


@command(
    app,
    "evaluate",
    """
    bsk-torch eval runs/scan
    bsk-torch eval runs/a runs/b my_package.policies:mine --seeds 0:256
    bsk-torch eval pretrained --preset AEOS-v1 --seeds 0:256
    bsk-torch eval runs/scan --shield safe --out results.json
    bsk-torch eval plan:rollout --plan base=rule --plan horizon=1500 --seeds 0:8
    bsk-torch eval nearest_task --preset AEOSBench-v1 --option sensor=on
    """,
    name="eval",
)
def evaluate_policy(
    policies: PoliciesOrPlanners,
    preset: OfPreset = None,
    option: Options = None,
    seeds: Annotated[str, typer.Option(metavar="A:B", help="Episodes of the seeds A to B - 1, or of a single seed.")] = "0:1000",
    shield: Shield = None,
    plan: Plan = None,
    baselines: Annotated[bool, typer.Option(help="Compare with all applicable baselines.")] = True,
    out: Annotated[Path | None, typer.Option(metavar="FILE", help="JSON file for the results.")] = None,
    episodes_out: Annotated[Path | None, typer.Option(metavar="FILE", help="CSV file with a row for each episode.")] = None,
    threads: Threads = 1,
    backend: Backend = "compiled",
    device: Device = "cpu",
    time_limit: TimeLimit = None,
) -> None:
    """Compare policies in the same episodes: returns, survival, causes of death, and measures of the task.

    The episode of seed 7 is the one that gymnasium.make("bsk_torch/PRESET").reset(seed=7) starts.
    """


@command(
    app,
    "film",
    """
    bsk-torch film runs/scan
    bsk-torch film pretrained --preset Constellation-v1 --until 1200
    bsk-torch film rule --preset NadirScan-v1 --seed 7 --out episode.png
    bsk-torch film random --preset Constellation-v1 --every 20 --out team.mp4
    """,
)
def film(
    policy: PolicyOrPlanner,
    preset: OfPreset = None,
    seed: Annotated[int, typer.Option(metavar="N", min=0, help="Seed of the episode.")] = 0,
    out: Annotated[
        Path,
        typer.Option(
            metavar="FILE",
            help="A film (.gif, .webp, .mp4), or a picture of the whole episode (.png, .svg, .pdf).",
        ),
    ] = Path("film.gif"),
    until: Annotated[float | None, typer.Option(metavar="S", help="Stop after S seconds of the episode.")] = None,
    every: Annotated[
        float | None, typer.Option(metavar="S", help="A frame at least every S seconds; default: one for each decision.")
    ] = None,
    fps: Annotated[float, typer.Option(metavar="N", min=0.1, max=50.0, help="Frames per second.")] = 5.0,
    height: Annotated[int, typer.Option(metavar="N", help="Height of a frame in pixels; the width is 4/3 of it.")] = 480,
    plan: Plan = None,
    threads: Threads = 1,
    backend: Backend = "compiled",
    device: Device = "cpu",
    time_limit: TimeLimit = None,
) -> None:
    """Film an episode of a policy, or draw it as one picture. Needs the extra viz; .mp4 needs video."""


@command(
    app,
    "audit",
    """
    bsk-torch audit runs/scan --seeds 0:16 --draw regret.png
    bsk-torch audit pretrained --preset AEOS-v1 --horizon 300 --budget 8
    bsk-torch audit hasty --preset CloudyAEOS-v1 --horizon 300 --futures 8
    """,
    name="audit",
)
def audit_policy(
    policy: Policy,
    preset: OfPreset = None,
    option: Options = None,
    seeds: Annotated[str, typer.Option(metavar="A:B", help="Episodes of the seeds A to B - 1, or of a single seed.")] = "0:8",
    horizon: Annotated[
        float, typer.Option(metavar="S", help="Length of branches in seconds; default: to the end of the episode.")
    ] = float("inf"),
    gamma: Annotated[float, typer.Option(metavar="G", min=0.0, max=1.0, help="Discount per second.")] = 1.0,
    futures: Annotated[
        int | None, typer.Option(metavar="N", min=2, help="Futures drawn for each decision; default: the true one.")
    ] = None,
    budget: Annotated[
        int | None, typer.Option(metavar="N", min=1, help="Number of actions to value, those that the policy prefers.")
    ] = None,
    num_envs: Annotated[int, typer.Option(metavar="N", min=1, help="Episodes at once.")] = 16,
    draw: Annotated[Path | None, typer.Option(metavar="FILE", help="Picture (.png, .svg, .pdf) of the regrets.")] = None,
    out: Annotated[Path | None, typer.Option(metavar="FILE", help="JSON file for all decisions.")] = None,
    threads: Threads = 1,
    backend: Backend = "compiled",
    device: Device = "cpu",
    time_limit: TimeLimit = None,
) -> None:
    """Find the decisions at which a policy loses, by flying all other actions as well.

    The regret of a decision is the return of the best action minus that of the chosen one, both followed by the policy.
    """


@command(
    app,
    "dataset",
    """
    bsk-torch dataset NadirScan-v1 --out data/scan --seeds 0:256
    bsk-torch dataset AEOS-v1 --out data/aeos --target hasty --share 0.002
    bsk-torch dataset NadirScan-v1 --out data/b --behavior rule,random=0.2
    bsk-torch dataset NadirScan-v1 --out data/plan --behavior plan:rollout
    """,
)
def dataset(
    preset: Preset,
    out: Annotated[Path, typer.Option(metavar="FOLDER", help="New folder for the dataset.")],
    behavior: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="Policy that acts: 'random', a baseline, 'pretrained', a run folder, or a planner with its options after "
            "commas, each with random=P for random actions with probability P; repeatable. Default: random actions, the best "
            "rule, and the pretrained policy.",
        ),
    ] = None,
    target: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="Policy that follows the tried actions: a baseline, 'pretrained' (default) or a run folder; repeatable.",
        ),
    ] = None,
    option: Options = None,
    seeds: Annotated[
        str, typer.Option(metavar="A:B", help="Episodes of the seeds A to B - 1, or of a single seed, for each behavior.")
    ] = "0:64",
    share: Annotated[
        float,
        typer.Option(metavar="P", min=0.0, max=1.0, help="Probability that all actions are tried at a decision."),
    ] = 0.01,
    gamma: Annotated[
        float, typer.Option(metavar="G", min=0.0, max=1.0, help="Discount per second of the returns of actions.")
    ] = 1.0,
    futures: Annotated[
        int | None, typer.Option(metavar="N", min=1, help="Futures drawn for each tried action; default: the true one.")
    ] = None,
    minari: Annotated[
        bool, typer.Option("--minari", help="Write the episodes in Minari's format as well. Needs the extra minari.")
    ] = False,
    num_envs: Annotated[int, typer.Option(metavar="N", min=1, help="Episodes at once.")] = 64,
    threads: Threads = 1,
    backend: Backend = "compiled",
    device: Device = "cpu",
    time_limit: TimeLimit = None,
) -> None:
    """Write episodes of several policies for offline learning, with the returns of all actions at a sample of decisions.

    The transitions are tensordicts in the layout of TorchRL, mapped from files. At the sampled decisions, every legal action is
    flown to the end of the episode, followed by each target: off-policy evaluation can be scored against these returns.
    """


@command(
    app,
    "risk",
    """
    bsk-torch risk pretrained --preset NadirScan-v1 --save deaths.json
    bsk-torch risk rule --event 'battery_charge_fraction<0.05' --draw low.png
    bsk-torch risk rule --time-limit 900 --method screen
    bsk-torch risk runs/scan --level battery --episodes 1000 --out risk.json
    """,
    name="risk",
)
def estimate_risk(
    policy: Policy,
    preset: OfPreset = None,
    option: Options = None,
    event: Annotated[
        str,
        typer.Option(metavar="EVENT", help="'death', or a property with a limit such as 'battery_charge_fraction<0.05'."),
    ] = "death",
    level: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="What is followed toward a death: battery, wheels, buffer or distance; repeatable. Default: the nearest limit.",
        ),
    ] = None,
    method: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help="subset: small steps of everything random. screen: flies the seeds whose draws at reset are most dangerous.",
        ),
    ] = "subset",
    episodes: Annotated[int, typer.Option(metavar="N", min=20, help="Episodes of a repetition, a multiple of 10.")] = 1000,
    repetitions: Annotated[int, typer.Option(metavar="R", min=4, help="Independent repetitions.")] = 8,
    smallest: Annotated[
        float, typer.Option(metavar="P", help="Probability at which subset simulation ends its search for the event.")
    ] = 1e-9,
    pool: Annotated[int, typer.Option(metavar="N", min=40, help="Seeds that each repetition screens.")] = 1_000_000,
    seed: Annotated[int, typer.Option(metavar="N", min=0, help="Seed of the estimate.")] = 0,
    num_envs: Annotated[int, typer.Option(metavar="N", min=1, help="Episodes at once.")] = 512,
    save: Annotated[
        Path | None, typer.Option(metavar="FILE", help="JSON file for a typical episode of each way, to fly it again.")
    ] = None,
    draw: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Picture (.png, .svg, .pdf) of the most typical episode.")
    ] = None,
    out: Annotated[Path | None, typer.Option(metavar="FILE", help="JSON file for the results.")] = None,
    threads: Threads = 1,
    backend: Backend = "compiled",
    device: Device = "cpu",
    time_limit: TimeLimit = None,
) -> None:
    """Estimate the probability of a loss, down to 1e-6 and below, and show the ways to it.

    Initial states, scenarios, faults and noise are followed in small steps toward the event (subset simulation). Where draws at
    reset decide about the event, --method screen needs fewer simulated seconds. An event that never happens has an upper limit.
    """


@command(
    app,
    "view",
    """
    bsk-torch view NadirScan-v1
    bsk-torch view Constellation-v1 --until 1200 --out team.html
    bsk-torch view NadirScan-v1 --policy rule --branch 12:1 --out futures.html
    bsk-torch view runs/scan
    bsk-torch view flight.bskview
    """,
)
def view(
    what: What,
    policy: WithPolicy = None,
    seed: Annotated[int, typer.Option(metavar="N", min=0, help="Seed of the episode.")] = 0,
    until: Annotated[float | None, typer.Option(metavar="S", help="Stop after S seconds of the episode.")] = None,
    branch: Branches = None,
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write a file (.html, .bskview, .czml) instead of starting a server.")
    ] = None,
    host: Annotated[str, typer.Option(metavar="NAME", help="Address of the server; others need a token.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(metavar="N", min=1, max=65535, help="Port of the server, or the next free one.")] = 8765,
    browser: Annotated[bool, typer.Option("--browser/--no-browser", help="Open the page in a browser.")] = True,
    plan: Plan = None,
    threads: Threads = 1,
    backend: Backend = "compiled",
    device: Device = "cpu",
    time_limit: TimeLimit = None,
) -> None:
    """Show an episode in the browser: a preset, a run or a recording.

    The page of a server also shows the value of every action at a decision, and flies other futures from there. With --out, one
    file plays without a server.
    """


@command(
    app,
    "view",
    """
    bsk-torch export NadirScan-v1 --out flight.html
    bsk-torch export flight.bskview --out flight.czml
    bsk-torch export runs/scan --seed 7 --out flight.mp4
    """,
)
def export(
    what: What,
    out: Annotated[
        Path,
        typer.Option(metavar="FILE", help="A page (.html), recording (.bskview), CZML (.czml) or film (.mp4, .gif, .webp)."),
    ],
    policy: WithPolicy = None,
    seed: Annotated[int, typer.Option(metavar="N", min=0, help="Seed of the episode.")] = 0,
    until: Annotated[float | None, typer.Option(metavar="S", help="Stop after S seconds of the episode.")] = None,
    branch: Branches = None,
    plan: Plan = None,
    threads: Threads = 1,
    backend: Backend = "compiled",
    device: Device = "cpu",
    time_limit: TimeLimit = None,
) -> None:
    """Write an episode of a preset, a run or a recording to a file."""


@command(
    app,
    "explain",
    """
    bsk-torch explain runs/scan --seeds 0:200
    bsk-torch explain runs/scan --seed 11 --draw death.png
    bsk-torch explain random --preset NadirScan-v1 --seeds 0:50 --out deaths.json
    """,
    name="explain",
)
def explain_failures(
    policy: Policy,
    preset: OfPreset = None,
    seeds: Annotated[
        str, typer.Option("--seeds", "--seed", metavar="A:B", help="Episodes of the seeds A to B - 1, or of a single seed.")
    ] = "0:2000",
    starts: Annotated[
        str | None,
        typer.Option(metavar="A:B", help="Seeds of episodes in which to search for surviving actions, regardless of the policy."),
    ] = None,
    num_envs: Annotated[int, typer.Option(metavar="N", min=1, help="Episodes, or states of a search, at once.")] = 1024,
    draw: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Picture (.png, .svg, .pdf) of the first death, with its cause and last chance."),
    ] = None,
    out: Annotated[Path | None, typer.Option(metavar="FILE", help="JSON file for the results.")] = None,
    threads: Threads = 1,
    backend: Backend = "compiled",
    device: Device = "cpu",
    time_limit: TimeLimit = None,
) -> None:
    """Find actions that would have saved each lost satellite, or prove that none exist.

    For each death, search for surviving actions from the start of the episode, and then from the latest possible decision. An
    episode counts as lost only with a proof.
    """


@command(app, "report", "bsk-torch report runs/scan\nbsk-torch report runs/scan --episodes 256")
def report(
    run: Run,
    episodes: Annotated[
        int, typer.Option(metavar="N", min=1, help="Unseen episodes, of which the best, the median and the worst are shown.")
    ] = 64,
    threads: Threads = 1,
    backend: Backend = "compiled",
    device: Device = "cpu",
) -> None:
    """Write report.html into a run folder: learning curves, final comparison, episodes on maps. Needs the extra viz."""


@command(
    app,
    "bench",
    """
    bsk-torch bench pretrained hasty --presets AEOS-v1 --episodes 64
    bsk-torch bench plan:rollout,base=hasty,horizon=240 --out results.json
    bsk-torch bench my_package.policies:enter
    bsk-torch bench hasty farsighted --suite v2 --presets few_choices
    bsk-torch bench nearest_task soonest_task --suite aeosbench
    """,
)
def bench(
    policies: Annotated[
        list[str],
        typer.Argument(
            help="'pretrained'; a baseline, also with a view of the presets such as survey,actions=waypoints; a policy file or "
            "its folder; a planner with its options such as plan:rollout,base=hasty,horizon=240; or your own function as "
            "package.module:function, with strings for it after commas.",
            show_default=False,
        ),
    ],
    suite: Annotated[str, typer.Option(metavar="NAME", help="Suite of fixed episodes.")] = "v1",
    presets: Annotated[
        str | None, typer.Option(metavar="NAMES", help="Only some of its presets or other tasks, separated by commas.")
    ] = None,
    folder: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="Cases of AEOS-Bench, as another task of the suite aeosbench.")
    ] = None,
    episodes: Annotated[
        int | None,
        typer.Option(metavar="N", min=1, help="Number of episodes per task, the first N; default: all.", show_default=False),
    ] = None,
    earlier: Annotated[
        list[Path] | None,
        typer.Option("--with", metavar="FILE", help="JSON file of an earlier run, whose policies are also shown; repeatable."),
    ] = None,
    out: Annotated[Path | None, typer.Option(metavar="FILE", help="JSON file for results and returns of all episodes.")] = None,
    threads: Threads = 1,
    backend: Backend = "compiled",
    device: Device = "cpu",
    certify: Annotated[
        int, typer.Option(metavar="N", min=0, help="Repeat the first N episodes of each task on Basilisk, if it is installed.")
    ] = 0,
) -> None:
    """Compare policies from any library in the fixed episodes of a suite.

    Scores are returns, scaled to 0 for random actions and 1 for the best rule, policy or planner of the package when the suite
    was created. Policies have no score for presets to which they do not apply. With --certify, the last column shows how many of
    the episodes repeated on Basilisk have the same decisions and outcome, and the largest difference of their returns.
    """


@command(
    app,
    "leaderboard",
    """
    bsk-torch leaderboard bench.json --draw profiles.png
    bsk-torch leaderboard bench.json --published v2
    bsk-torch leaderboard a.json b.json --method 'ppo=runs/ppo*/seed_*'
    """,
)
def leaderboard(
    files: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="FILE...",
            help="JSON files of bsk-torch bench. Of a policy that played a task more than "
            "once, the result of the most episodes counts, then that of the last file.",
            show_default=False,
        ),
    ] = None,
    method: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=PATTERN",
            help="The policies whose names match PATTERN are runs of the method NAME, as many in each task; repeatable, also for "
            "the same method. Default: each policy is a method.",
            show_default=False,
        ),
    ] = None,
    presets: Annotated[
        str | None, typer.Option(metavar="NAMES", help="Only some presets or other tasks of the suite, separated by commas.")
    ] = None,
    against: Annotated[
        str | None, typer.Option(metavar="NAME", help="Method with which the others are compared; default: the best.")
    ] = None,
    published_suite: Annotated[
        str | None,
        typer.Option("--published", metavar="SUITE", help="Also compare with the methods published for the suite, such as v2."),
    ] = None,
    draw: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Picture (.png, .svg, .pdf) of the performance profiles.")
    ] = None,
    out: Annotated[Path | None, typer.Option(metavar="FILE", help="JSON file for the results.")] = None,
) -> None:
    """Compare methods in all tasks of a suite, with the aggregates of Agarwal et al. (2021).

    The interquartile mean (IQM) is the mean of the middle half of the scores of all runs and tasks, the optimality gap is how far
    scores are below 1 on average. "better than" is the probability that a run has a higher score than one of the other method.
    """


@command(
    app,
    "aeos",
    """
    bsk-torch export-aeosbench runs/bench --cases cases --out data
    bsk-torch export-aeosbench nearest_task --cases cases --out o --sensor on
    """,
    name="export-aeosbench",
)
def export_aeosbench(
    policy: Policy,
    cases: Annotated[Path, typer.Option(metavar="FOLDER", help="Folder of the cases: constellations and tasks.")],
    out: Annotated[Path, typer.Option(metavar="FOLDER", help="Folder for the files.")],
    split: Annotated[str, typer.Option(metavar="NAME", help="Part of the data set that the files are named after.")] = "test",
    turn: Annotated[
        int, typer.Option("--round", metavar="E", min=0, help="Round of annotation that the files are named after.")
    ] = 0,
    sensor: Sensor = "assigned",
    option: Options = None,
    threads: Threads = 1,
    backend: Backend = "compiled",
    device: Device = "cpu",
    time_limit: TimeLimit = None,
) -> None:
    """Fly cases of AEOS-Bench, and write trajectories and annotations for its own evaluator."""


@command(
    app,
    "aeos",
    """
    bsk-torch import-aeosbench data --cases cases
    bsk-torch import-aeosbench flown --cases flown --sensor on
    """,
    name="import-aeosbench",
)
def import_aeosbench(
    assignments: Annotated[
        Path,
        typer.Argument(
            metavar="FOLDER", help="Folder of trajectories (.pth) or assignment_runs.json of all cases.", show_default=False
        ),
    ],
    cases: Annotated[Path, typer.Option(metavar="FOLDER", help="Folder of the cases: constellations and tasks.")],
    sensor: Sensor = "assigned",
    out: Annotated[Path | None, typer.Option(metavar="FILE", help="JSON file for the results.")] = None,
    episodes_out: Annotated[Path | None, typer.Option(metavar="FILE", help="CSV file with a row for each case.")] = None,
    threads: Threads = 1,
    backend: Backend = "compiled",
    device: Device = "cpu",
    time_limit: TimeLimit = None,
) -> None:
    """Fly the assigned tasks in files of AEOS-Bench, and show the measures of the benchmark."""


@command(app, "arguments", "bsk-torch args NadirScan-v1", name="args")
def show_arguments(preset: Preset) -> None:
    """Show the arguments of a preset's satellites and world: value in the preset, default and meaning."""


@command(app, "schedule", "bsk-torch schedule\nbsk-torch schedule NadirScan-v1", name="schedule")
def show_schedule(
    preset: Annotated[
        str | None, typer.Argument(help="Environment, such as AEOS-v1; default: all slots.", show_default=False)
    ] = None,
) -> None:
    """Show the order of a tick: all slots, or the components that run in a preset."""


@command(
    app,
    "publish",
    "bsk-torch publish runs/scan --folder policies\nbsk-torch publish runs/team --drop n_satellites --drop n_planes",
)
def publish(
    run: Run,
    training: Annotated[
        str | None,
        typer.Option("--command", metavar="TEXT", help="Training command to record, if it differs from the run's settings."),
    ] = None,
    drop: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="Environment option used only for training, such as n_satellites for a policy trained with one satellite; "
            "repeatable.",
        ),
    ] = None,
    episodes: Annotated[int, typer.Option(metavar="N", min=4, help="Unseen episodes of the evaluation.")] = 256,
    folder: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="Folder of the policies; default: that of the installed package.")
    ] = None,
    threads: Threads = 1,
    device: Device = "cpu",
) -> None:
    """Add the policy of a run to the pretrained ones, with its training command, time and score.

    The evaluation uses the episodes of seed 1,000,003 + the training seed, in the training environment without the dropped
    options.
    """


@command(
    app,
    "kernels",
    "bsk-torch build-kernels NadirScan-v1 --isa avx2 --out kernels\nexport BSK_TORCH_KERNELS=$PWD/kernels",
    name="build-kernels",
)
def build_kernels(
    presets: Annotated[list[str] | None, typer.Argument(help="Environments; default: all.", show_default=False)] = None,
    out: Annotated[
        Path, typer.Option(metavar="FOLDER", help="Output folder; set BSK_TORCH_KERNELS to its path on the other machines.")
    ] = Path("kernels"),
    isa: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="'avx512', 'avx2', or 'default' (plain C++); default: the best of this machine."),
    ] = None,
    mixed: Annotated[bool, typer.Option("--mixed", help="Also for mixed precision (sim_dtype=float32).")] = False,
) -> None:
    """Compile the kernels of presets for machines without a compiler.

    The other machines need the same versions of torch and bsk_torch, processors with the same instructions, and a C library at
    least as new.
    """
