"""``bsk-torch train`` and ``bsk-torch profile``: train policies, compare and draw them, and show where the time goes."""

from __future__ import annotations

from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bsk_torch.cli.declaration import MACHINE, EnvironmentOptions, Preset, flag
from bsk_torch.cli.shared import environment
from bsk_torch.cli.terminal import activity, echo, fail, refusing, working
from bsk_torch.tables import print_table

if TYPE_CHECKING:
    from bsk_torch.rl.evaluation.evaluate import Evaluation

OF_NEW_RUNS = ("algorithm", "network", "seed", "seeds", "workers", "out", "backend", "device", "time_limit")
"""Parameters of the command that new runs take; one that is resumed takes changes as NAME=VALUE."""

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
Algorithm = Annotated[str | None, flag("NAME", "'ppo' for one satellite; 'mappo' (default) or 'ippo' for constellations.")]
Network = Annotated[
    str | None,
    typer.Option(
        metavar="NAME",
        help="'mlp', 'gru' (with a memory), or 'attention' (for targets observed as a set, and for constellations); default: the "
        "one that suits the preset.",
    ),
]


def train(
    context: typer.Context,
    preset: Annotated[
        str,
        typer.Argument(
            help="Environment ('bsk-torch list' names them), or your own function of num_envs (module:name or file.py:name); "
            "with --resume, a run folder.",
            show_default=False,
        ),
    ],
    changes: Changes = None,
    algorithm: Algorithm = None,
    network: Network = None,
    minutes: Annotated[
        float | None, flag("M", "Training time, without compilation; default: 3, or no limit with --frames.", min=0.01)
    ] = None,
    frames: Annotated[int | None, flag("N", "Number of decisions. With --minutes, the limit reached first counts.")] = None,
    seed: Annotated[int, flag("N", "Seed of networks, actions and episodes.", min=0)] = 0,
    seeds: Annotated[int, flag("N", "Number of runs, one after the other, with seeds starting at --seed.", min=1)] = 1,
    workers: Annotated[
        str | None,
        typer.Option(
            metavar="N",
            help="Number of processes that collect experience, or 'auto' for as many as suit the available cores; default: only "
            "the one that learns.",
            rich_help_panel=MACHINE,
        ),
    ] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Resume the run in the given folder.")] = False,
    out: Annotated[Path | None, flag("FOLDER", "Folder for the results; default: a new one in runs/.")] = None,
    episodes: Annotated[
        int | None,
        flag("N", "Unseen episodes of the final comparison; default: 256, fewer where they take long; 0: none.", min=0),
    ] = None,
    *,
    options: EnvironmentOptions,
) -> None:
    """Train policies with PPO, MAPPO or IPPO, and compare them with random actions and rules in unseen episodes.

    The last line compares the policy with the best rule, and if it is not better, names a training that is known to be better.

    Examples:
        bsk-torch train NadirScan-v1 --minutes 3
        bsk-torch train AEOS-v1 --network attention --frames 600000 --out runs/aeos
        bsk-torch train NadirScan-v1 learning_rate=1e-3 'hidden=[128,128]'
        bsk-torch train NadirScan-v1 --workers auto
        bsk-torch train mine.py:scanner --frames 200000 --out runs/mine
        bsk-torch train runs/aeos --resume frames=1200000
    """
    from bsk_torch.cli.training import check, check_resumable, configured, evaluated, read, run, several
    from bsk_torch.rl.evaluation.results import print_results
    from bsk_torch.rl.policies.shared_policy import shared_baselines
    from bsk_torch.rl.training.verdict import compared_episodes

    limits = {"frames": frames, "seconds": minutes and 60.0 * minutes}
    changes = [*(f"{name}={value}" for name, value in limits.items() if value is not None), *(changes or [])]
    if resume:
        folder = Path(preset)
        config = read(folder, changes)
        changed = [name for name in OF_NEW_RUNS if getattr(context.get_parameter_source(name), "name", None) == "COMMANDLINE"]
        if changed:
            name = changed[0].replace("_", "-")
            fail(f"--{name} is for new runs; with --resume, changes are written as NAME=VALUE: learning_rate=1e-4")
        check_resumable(folder, config)
        runs, seed = {folder: config}, config.seed
    else:
        for name, said in (("preset", "the first argument"), ("network", "--network"), ("algorithm", "--algorithm")):
            if any(change.startswith(f"{name}=") for change in changes):
                fail(f"{name}= is not a setting; give it as {said}")
        config = configured(preset, algorithm, network, [*several(workers, changes), *changes], seed=seed, options=options)
        folder = out or Path("runs") / f"{Path(preset).name.replace(':', '_')}_{datetime.now():%Y%m%d-%H%M%S}"
        runs = {folder / f"seed_{seed + k}" if seeds > 1 else folder: replace(config, seed=seed + k) for k in range(seeds)}
        check(runs)
    episodes = compared_episodes(config) if episodes is None else episodes
    env = environment(config.preset, episodes, config.options) if episodes else None
    results = {name: evaluated(name, rule, env, seed) for name, rule in shared_baselines(env, seed).items()} if env else {}
    trained: dict[str, Evaluation] = {}
    for folder, config in runs.items():
        result, interrupted = run(config, folder, env, results, seed, resume)
        if result is not None:
            trained[f"seed {config.seed}"] = result
        if interrupted:
            break
    if len(trained) > 1:
        print_results(results | trained, f"{config.preset}, {episodes} unseen episodes")


def profile(
    preset: Preset,
    changes: Changes = None,
    algorithm: Algorithm = None,
    network: Network = None,
    seconds: Annotated[float, flag("S", "CPU time to measure, without compilation.", min=0.01)] = 10.0,
    *,
    options: Annotated[dict[str, object], ("backend", "device", "time_limit")],
) -> None:
    """Show where the CPU time of a training goes, decisions per CPU-second, and what to change.

    The training runs in one process and one thread, without evaluations, and nothing is kept.

    Examples:
        bsk-torch profile NadirScan-v1
        bsk-torch profile AEOS-v1 --network attention num_envs=512 'hidden=[32]'
    """
    from bsk_torch.cli.training import configured
    from bsk_torch.rl.marl.runs import training_of
    from bsk_torch.rl.training.profile import advice, measure

    config = configured(preset, algorithm, network, changes or [], options=options)
    with refusing(), working(f"training {preset} for {seconds:g} s"):
        costs = measure(config, seconds, training_of)
    activity.report()
    spent = costs.spent | {"all": costs.total}
    rows = [
        {"phase": phase, "us per decision": f"{us:,.2f}", "%": f"{100.0 * us / costs.total:.1f}"} for phase, us in spent.items()
    ]
    print_table(rows, f"{preset}: CPU time of a training in one process and one thread", left=("phase",))
    echo(f"{1e6 / costs.total:,.0f} decisions per CPU-second")
    for line in advice(costs):
        echo(line)
