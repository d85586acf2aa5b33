"""``bsk-torch eval``: how good is a policy."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import torch
import typer
from tensordict.nn import TensorDictModuleBase

from bsk_torch.cli.results import print_results, save_episodes, save_results
from bsk_torch.cli.shared import Backend, Device, Threads, TimeLimit, console, environment, environment_options, fail, fits
from bsk_torch.env import SatelliteTasking
from bsk_torch.presets import PRESETS
from bsk_torch.rl.baselines import BASELINES
from bsk_torch.rl.evaluate import Evaluation, evaluate
from bsk_torch.rl.policies import build_policy, check_fits, read_card
from bsk_torch.rl.pretrained import pretrained_file
from bsk_torch.rl.shield import find_rule, shielded
from bsk_torch.sim.params import nearest

MOST = 4096
"""Episodes at once, so that any number of them fits into memory."""

TRAINED, PRETRAINED = "trained", "pretrained"
"""What results call the policy of a file, and the one that comes with the package."""

FIRST = next(iter(PRESETS))
"""The environment where neither the command line nor a run says another."""


def evaluate_policy(
    policy: Annotated[
        str, typer.Argument(help=f"Folder of a training run, its policy.pt, 'pretrained', or a baseline: {', '.join(BASELINES)}.")
    ],
    preset: Annotated[str | None, typer.Option(help="Environment; that of the run unless given.")] = None,
    seeds: Annotated[str, typer.Option(help="'A:B' for the episodes of seeds A to B - 1, or a single seed.")] = "0:1000",
    shield: Annotated[str | None, typer.Option(help="'safe', or a rule of your own as package.module:function.")] = None,
    baselines: Annotated[bool, typer.Option(help="Whether to compare with the baselines that fit.")] = True,
    out: Annotated[Path | None, typer.Option(help="JSON file for what the table says.")] = None,
    episodes_out: Annotated[Path | None, typer.Option(help="CSV file with a line for every episode.")] = None,
    threads: Threads = 1,
    backend: Backend = "compiled",
    device: Device = "cpu",
    time_limit: TimeLimit = None,
) -> None:
    """Play the episodes of given seeds, the same for every policy, and compare: returns, survival, causes of death.

    The episode of seed 7 is the one that gymnasium.make("bsk_torch/PRESET").reset(seed=7) starts.
    """
    torch.set_num_threads(threads)
    episodes = _seeds(seeds)
    for path in (out, episodes_out):
        _check_writable(path)
    card = {} if policy in BASELINES else _card(policy, preset or FIRST)
    name = preset or card.get("preset", FIRST)
    env = _environment(name, min(len(episodes), MOST), card, environment_options(backend, device, time_limit))
    label, actor = _actor(policy, card, env, name, device)
    guarded = {} if shield is None else {f"{label} + {shield}": _guarded(actor, shield, env)}
    actors = guarded | {label: actor}
    chosen = next(iter(actors))
    actors |= {other: BASELINES[other](env, 0) for other in BASELINES if baselines and other != policy and fits(other, env)}
    results = {other: _evaluated(other, actor, env, episodes) for other, actor in actors.items()}
    print_results(results, f"{name}, {len(episodes)} episodes, seeds {seeds}", chosen if len(results) > 1 else None)
    if out is not None:
        save_results(results, out, chosen)
    if episodes_out is not None:
        save_episodes(results, episodes, episodes_out)


def _seeds(text: str) -> range:
    """The seeds that ``A:B`` or a single number names."""
    first, colon, end = text.partition(":")
    try:
        seeds = range(int(first), int(end) if colon else int(first) + 1)
    except ValueError:
        fail(f"--seeds {text!r} must be A:B, such as 0:1000, or a single number")
    if not seeds or seeds.start < 0:
        fail(f"--seeds {text!r} names no episode; in A:B, A is at least 0 and B is larger")
    return seeds


def _check_writable(path: Path | None) -> None:
    """Ends the program where a file could not be written, before an hour of work is lost."""
    if path is not None and path.is_dir():
        fail(f"{str(path)!r} is a folder; name a file in it")
    if path is not None and not path.parent.is_dir():
        fail(f"{str(path)!r} cannot be written: there is no folder {str(path.parent)!r}")


def _card(policy: str, preset: str) -> dict[str, Any]:
    """What the file of a policy says, or of the pretrained one for ``preset``; ends the program where there is none."""
    try:
        return read_card(pretrained_file(preset) if policy == PRETRAINED else policy)
    except FileNotFoundError:
        hint = nearest(policy, (*BASELINES, PRETRAINED))
        fail(f"{policy!r} is neither a run with a policy.pt, nor such a file, nor a baseline; {hint}")
    except ValueError as error:
        fail(str(error))


def _environment(preset: str, n: int, card: Mapping[str, Any], options: Mapping[str, Any]) -> SatelliteTasking:
    """Environments that play the episodes of seeds, made as for the policy of ``card``; ends the program where that cannot be."""
    trained = card.get("options", {})
    try:
        return environment(preset, n, trained | options | {"env_ids": [0] * n})
    except TypeError as error:
        if not trained:
            raise
        fail(f"the policy was trained for {card['preset']} with {trained}; {preset} cannot be made so: {error}")


def _actor(
    policy: str, card: Mapping[str, Any], env: SatelliteTasking, preset: str, device: str
) -> tuple[str, TensorDictModuleBase]:
    """What results call the policy, and the policy; ends the program where it does not fit the environment."""
    if policy in BASELINES:
        if not fits(policy, env):
            fail(f"the policy {policy!r} does not fit {preset}")
        return policy, BASELINES[policy](env, 0)
    try:
        check_fits(card, env, preset)
        return PRETRAINED if policy == PRETRAINED else TRAINED, build_policy(card, device)
    except ValueError as error:
        fail(str(error))


def _guarded(policy: TensorDictModuleBase, shield: str, env: SatelliteTasking) -> TensorDictModuleBase:
    """The policy behind a shield; ends the program where the rule does not exist or does not fit."""
    if str(Path.cwd()) not in sys.path:
        sys.path.insert(0, str(Path.cwd()))  # where a user's module is, as python -m would find it
    try:
        return shielded(policy, find_rule(shield), env)
    except KeyError as error:
        fail(f"the shield {shield!r} does not fit: {error.args[0]}")
    except ValueError as error:
        fail(str(error))


def _evaluated(name: str, policy: TensorDictModuleBase, env: SatelliteTasking, seeds: range) -> Evaluation:
    with console.status(f"evaluating: {name}"):
        return evaluate(policy, env, seeds=seeds)
