"""The command line: ``bsk-torch train``, ``evaluate``, ``list`` and ``args``."""

from __future__ import annotations

import dataclasses
import json
import logging
from collections.abc import Mapping
from datetime import datetime
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import torch
import typer
from rich.console import Console
from rich.table import Table

from bsk_torch.env import SatelliteTasking, Tasking
from bsk_torch.presets import PRESETS, make
from bsk_torch.rl.baselines import BASELINES
from bsk_torch.rl.evaluate import Evaluation, evaluate
from bsk_torch.rl.log import read_log
from bsk_torch.rl.policies import load_policy
from bsk_torch.rl.ppo import PPOConfig
from bsk_torch.rl.recipes import configure
from bsk_torch.rl.targets import image_actions
from bsk_torch.sim.params import nearest

if TYPE_CHECKING:
    from tensordict.nn import TensorDictModuleBase
    from torch import Tensor

app = typer.Typer(help="Train and evaluate satellite-tasking policies.", no_args_is_help=True, add_completion=False)
console = Console()

FRESH = 1_000_003
"""Added to the seed of training to get the seed of evaluation, whose episodes are then new to the policy."""

Preset = Annotated[str, typer.Argument(help="Name of an environment; see 'bsk-torch list'.")]
Seed = Annotated[int, typer.Option(help="Seed of networks, actions and episodes.")]
Episodes = Annotated[int, typer.Option(min=1, help="Fresh episodes for every evaluation.")]
Threads = Annotated[int, typer.Option(min=1, help="Threads of torch; one is fastest for these sizes.")]
Backend = Annotated[str, typer.Option(help="'compiled', or 'eager' for debugging.")]
Device = Annotated[str, typer.Option(help="Where to simulate and learn, such as 'cuda'.")]
TimeLimit = Annotated[float | None, typer.Option(help="Length of an episode, s, instead of the preset's.")]


@app.callback()
def setup() -> None:
    """Say what takes long, and nothing else."""
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    logging.getLogger("torchrl").setLevel(logging.WARNING)


@app.command("list")
def list_presets() -> None:
    """List the environments that can be trained in."""
    for name, preset in PRESETS.items():
        docs = (preset.__doc__ or "", import_module(preset.__module__).__doc__ or "")
        lines = [doc.partition("\n")[0] for doc in docs]
        about = lines[0] if lines[0].startswith(f"{name}:") else lines[1]
        typer.echo(f"{name}  {about.removeprefix(f'{name}:').strip()}")


@app.command("args")
def show_arguments(preset: Preset) -> None:
    """Print every argument of a preset's satellite and world with default, unit and meaning."""
    env = _made(preset, 1, {"backend": "eager"})
    typer.echo(f"sat_args\n{env.default_sat_args()!r}\n\nworld_args\n{env.default_world_args()!r}")


@app.command("evaluate")
def evaluate_policy(
    policy: Annotated[str, typer.Argument(help="Folder of a training run, or 'random', 'rule', 'greedy', 'nearest', 'hasty'.")],
    preset: Annotated[str | None, typer.Option(help="Environment; that of the run unless given.")] = None,
    episodes: Episodes = 256,
    seed: Seed = 0,
    threads: Threads = 1,
    backend: Backend = "compiled",
    device: Device = "cpu",
    time_limit: TimeLimit = None,
) -> None:
    """Play fresh episodes and print mean return, what was counted, survival and causes of death."""
    torch.set_num_threads(threads)
    folder = Path(policy)
    kept = _read_config(folder) if policy not in BASELINES else {}
    name = preset or kept.get("preset") or next(iter(PRESETS))
    env = _environment(name, episodes, kept.get("options", {}) | _options(backend, device, time_limit))
    if policy in BASELINES and not _fits(policy, env):
        _fail(f"the policy {policy!r} does not fit {name}")
    actor = BASELINES[policy](env, seed) if policy in BASELINES else load_policy(folder / "policy.pt", device)
    _print({policy: evaluate(actor, env, seed=seed + FRESH)}, f"{name}, {episodes} episodes")


@app.command()
def train(
    preset: Preset,
    network: Annotated[str, typer.Option(help="'mlp', or 'attention' for targets observed as a set.")] = "mlp",
    minutes: Annotated[float, typer.Option(min=0.01, help="Training time after compilation.")] = 3.0,
    frames: Annotated[int | None, typer.Option(help="Number of decisions, instead of a time.")] = None,
    num_envs: Annotated[int | None, typer.Option(min=1, help="Episodes at once, instead of the recipe's.")] = None,
    rollout: Annotated[int | None, typer.Option(min=1, help="Decisions of each between two updates, likewise.")] = None,
    seed: Seed = 0,
    out: Annotated[Path | None, typer.Option(help="Folder for the results; a new one in runs/ unless given.")] = None,
    episodes: Episodes = 256,
    threads: Threads = 1,
    backend: Backend = "compiled",
    device: Device = "cpu",
    time_limit: TimeLimit = None,
) -> None:
    """Train a policy with PPO and compare it with random actions and rules on fresh episodes."""
    torch.set_num_threads(threads)
    limit = {"frames": frames, "seconds": None} if frames else {"seconds": 60.0 * minutes}
    sizes = {name: size for name, size in {"num_envs": num_envs, "rollout": rollout}.items() if size is not None}
    config = _configured(preset, network, seed=seed, options=_options(backend, device, time_limit), **limit, **sizes)
    env = _environment(preset, episodes, config.options)
    training = _extra("bsk_torch.rl.training")
    folder = out or Path("runs") / f"{preset}_{datetime.now():%Y%m%d-%H%M%S}"
    run = training.Training(config, folder)
    policies = {name: BASELINES[name](env, seed) for name in BASELINES if _fits(name, env)} | {"untrained": run.policy}
    results = {name: _evaluated(name, policy, env, seed) for name, policy in policies.items()}
    policy = run.run()
    results["trained"] = _evaluated("trained", policy, env, seed)
    _print(results, f"{preset}, {episodes} fresh episodes")
    _save(results, folder / "evaluation.json")
    _draw(policy, results, config, folder)
    typer.echo(f"policy, log, evaluation and pictures are in {folder}")


def _options(backend: str, device: str, time_limit: float | None) -> dict[str, Any]:
    """Arguments of the environment that the command line sets."""
    return {"backend": backend, "device": device} | ({} if time_limit is None else {"time_limit": time_limit})


def _configured(preset: str, network: str, **changes: Any) -> PPOConfig:
    try:
        return configure(preset, network, **changes)
    except ValueError as error:
        _fail(str(error))


def _made(preset: str, num_envs: int, options: Mapping[str, Any]) -> Tasking:
    try:
        return make(preset, num_envs=num_envs, **options)
    except ValueError as error:
        _fail(str(error))


def _environment(preset: str, num_envs: int, options: Mapping[str, Any]) -> SatelliteTasking:
    """An environment of one satellite; ends the program for constellations."""
    env = _made(preset, num_envs, options)
    if not isinstance(env, SatelliteTasking):
        _fail(f"{preset} has many satellites; train and evaluate it with scripts/train_constellation.py --preset {preset}")
    return env


def _fail(message: str) -> NoReturn:
    typer.secho(message, err=True, fg="red")
    raise typer.Exit(1)


def _read_config(folder: Path) -> dict[str, Any]:
    """Configuration of a run; ends the program where there is none."""
    if not (folder / "policy.pt").is_file():
        _fail(f"{str(folder)!r} is neither a run with a policy.pt nor a baseline; {nearest(str(folder), BASELINES)}")
    return json.loads((folder / "config.json").read_text())


def _fits(name: str, env: SatelliteTasking) -> bool:
    """Whether a baseline knows what to do with the environment's observations and actions."""
    try:
        BASELINES[name](env, 0)
    except (KeyError, ValueError):
        return False
    return True


def _extra(module: str) -> Any:
    """A module that needs tqdm or matplotlib; ends the program where these are missing."""
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        _fail(f"training needs {error.name}; pip install 'bsk_torch[train,viz]'")


def _evaluated(name: str, policy: TensorDictModuleBase, env: SatelliteTasking, seed: int) -> Evaluation:
    with console.status(f"evaluating: {name}"):
        return evaluate(policy, env, seed=seed + FRESH)


def _print(results: Mapping[str, Evaluation], title: str) -> None:
    """A table of all results; survival and deaths where somebody died."""
    table = Table(title=title, title_justify="left")
    mortal = any(result.causes for result in results.values())
    rows = {name: _row(result, mortal) for name, result in results.items()}
    for column in ("policy", *next(iter(rows.values()))):
        table.add_column(column, no_wrap=column != "deaths")
    for name, row in rows.items():
        table.add_row(name, *row.values())
    console.print(table)


def _row(result: Evaluation, mortal: bool) -> dict[str, str]:
    """What the table says about a policy, by column."""
    row = {"return (95 %)": str(result.mean_return)}
    if mortal:
        row |= {"survival": f"{result.survival:.1%}", "collected": f"{_mean(result.collected):.3f}"}
    row |= {"decisions": f"{_mean(result.decisions):.0f}"} | {name: f"{_mean(n):.1f}" for name, n in result.counts.items()}
    if mortal:
        row["deaths"] = ", ".join(f"{n} {cause.removesuffix('_valid')}" for cause, n in result.causes.items()) or "none"
    return row


def _mean(samples: Tensor) -> float:
    return float(samples.double().mean())


def _save(results: Mapping[str, Evaluation], path: Path) -> None:
    """Keep the results beside the policy."""
    kept = {
        name: {
            **dataclasses.asdict(result.mean_return),
            "survival": result.survival,
            "deaths": result.causes,
            "counts": {count: _mean(value) for count, value in result.counts.items()},
        }
        for name, result in results.items()
    }
    path.write_text(json.dumps(kept, indent=2) + "\n")


def _draw(policy: TensorDictModuleBase, results: Mapping[str, Evaluation], config: PPOConfig, folder: Path) -> None:
    """Learning curve, and the first fresh episode: from above where targets are imaged, else as a timeline."""
    curves = _extra("bsk_torch.viz.curves")
    levels = {name: (result.mean_return.mean, result.mean_return.half_width) for name, result in results.items()}
    curves.learning_curve(read_log(folder / "log.csv"), folder / "learning_curve.png", levels, f"{config.preset}: learning")
    env = make(config.preset, num_envs=1, **config.options)
    title, seed = f"{config.preset}: one episode of the trained policy", config.seed + FRESH
    if _images(env):
        above = _extra("bsk_torch.viz.ground_track")
        above.ground_track(above.record_imaging_episode(policy, env, seed=seed), folder / "ground_track.png", title)
    else:
        timeline = _extra("bsk_torch.viz.timeline")
        timeline.timeline(timeline.record_episode(policy, env, seed=seed), folder / "timeline.png", title)


def _images(env: SatelliteTasking) -> bool:
    """Whether the satellite images targets."""
    try:
        return bool(image_actions(env))
    except ValueError:
        return False
