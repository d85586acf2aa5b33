"""Generation of datasets: episodes of several behaviors, returns of all actions at a sample of decisions, and descriptions."""

from __future__ import annotations

import hashlib
import json
import secrets
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import torch
from tensordict import TensorDict
from torch import Tensor

from bsk_torch import __version__
from bsk_torch.env import SatelliteTasking, Tasking
from bsk_torch.files import unwritable, write_file
from bsk_torch.lab.offline.behaviors import Behavior, slug
from bsk_torch.lab.offline.croissant import croissant
from bsk_torch.lab.offline.flights import Flown, play, target_returns
from bsk_torch.lab.offline.layout import (
    CARD,
    COUNTERFACTUALS,
    DECISION,
    DESCRIPTION,
    EPISODE,
    FORMAT,
    INDEX,
    MINARI,
    SEED,
    STARTS,
    TABLE,
    TARGET_ACTION,
    TRANSITIONS,
    VALUE,
)
from bsk_torch.lab.offline.minari_format import check_minari, write_minari
from bsk_torch.lab.offline.recipe import Recipe
from bsk_torch.lab.planners.rollout import ActionValues
from bsk_torch.rl.evaluation.evaluate import start_episodes

BLOCK = 1 << 20
"""Bytes of a file read at once."""

Progress = Callable[[str], None]
"""Function that is told what is done now."""


class Played(NamedTuple):
    """Episodes of a behavior: returns [E], numbers of decisions [E] and lengths [E] s, and the number of sampled decisions."""

    behavior: Behavior
    returns: Tensor
    decisions: Tensor
    seconds: Tensor
    sampled: int


def write_dataset(folder: Path | str, env: Tasking, recipe: Recipe, progress: Progress = lambda doing: None) -> dict[str, object]:
    """Play the episodes of a dataset, and write it; see :func:`bsk_torch.lab.offline.open_dataset` for reading.

    The content depends on the recipe only, not on the number of episodes played at once. It is collected next to
    ``folder``, which appears when all is complete.

    Args:
        folder: The folder to make.
        env: The environment, with ``env_ids=[0] * num_envs``; it plays ``num_envs`` episodes at a time.
        recipe: What to write.
        progress: Function that is told what is done now.

    Returns:
        The content of ``dataset.json``.

    Raises:
        ValueError: If the folder exists, or for an environment that does not fit the recipe, all before an episode is played; see
            :meth:`~bsk_torch.lab.offline.Recipe.checked`.
        ImportError: Without Minari, or with a version that does not read what it writes, if the recipe asks for it.
        OSError: If a file cannot be written.
    """
    folder = Path(folder)
    check_folder(folder)
    one = recipe.checked(env)
    judged = recipe.targets if recipe.share > 0.0 else {}
    values = {name: ActionValues(one, target, gamma=recipe.gamma, futures=recipe.futures) for name, target in judged.items()}
    if recipe.minari:
        check_minari()
    aside = folder.with_name(f".{folder.name}.{secrets.token_hex(8)}.part")
    try:
        aside.mkdir()
        card = _write(aside, one, recipe, values, progress)
        aside.rename(folder)
    finally:
        shutil.rmtree(aside, ignore_errors=True)
    return card


def check_folder(folder: Path) -> None:
    """Raise ValueError if a folder exists, or cannot be made."""
    if folder.exists() or folder.is_symlink():
        raise ValueError(f"{str(folder)!r} exists; a dataset is written into a new folder: name another one, or delete it")
    if not folder.parent.is_dir():
        raise ValueError(f"{str(folder)!r} cannot be made: there is no folder {str(folder.parent)!r}")
    if (why := unwritable(folder.parent)) is not None:
        raise ValueError(f"{str(folder)!r} cannot be made: {why}")


def _write(
    folder: Path, env: SatelliteTasking, recipe: Recipe, values: dict[str, ActionValues], progress: Progress
) -> dict[str, object]:
    played = []
    for behavior in recipe.behaviors:
        transitions, one = _write_behavior(folder / slug(behavior.name), env, recipe, behavior, values, progress)
        played.append(one)
        if recipe.minari:
            progress(f"writing {behavior.name} in Minari's format")
            write_minari(folder / MINARI, transitions, recipe, behavior)
    if recipe.targets:
        _write_starts(folder / STARTS, env, recipe, progress)
    write_file(folder / TABLE, _table(played, recipe))
    progress("computing checksums")
    card = _card(env, recipe, played) | {"files": dict(_checksums(folder))}
    write_file(folder / CARD, json.dumps(card, indent=1, allow_nan=False) + "\n")
    write_file(folder / DESCRIPTION, json.dumps(croissant(card, folder / CARD), indent=1) + "\n")
    return card


def _write_behavior(
    folder: Path,
    env: SatelliteTasking,
    recipe: Recipe,
    behavior: Behavior,
    values: dict[str, ActionValues],
    progress: Progress,
) -> tuple[TensorDict, Played]:
    """Play the episodes of a behavior, and write them; return the memory-mapped transitions."""
    flown: list[Flown] = []
    for first in range(0, len(recipe.seeds), env.num_envs):
        progress(f"{behavior.name}: episode {first} of {len(recipe.seeds)}")
        flown.append(play(env, behavior, recipe.seeds[first : first + env.num_envs], values, recipe.share, first))
    decisions = torch.cat([part.decisions for part in flown])
    transitions = _mapped(folder / TRANSITIONS, [part.transitions for part in flown])
    sampled = [part.counterfactuals for part in flown if len(part.counterfactuals)]
    begins = decisions.cumsum(0) - decisions
    for part in sampled:
        part[INDEX] = begins[part[EPISODE]] + part[DECISION]
    if sampled:
        _mapped(folder / COUNTERFACTUALS, sampled)
    returns, seconds = (torch.cat([getattr(part, name) for part in flown]) for name in ("returns", "seconds"))
    return transitions, Played(behavior, returns, decisions, seconds, sum(map(len, sampled)))


def _write_starts(folder: Path, env: SatelliteTasking, recipe: Recipe, progress: Progress) -> None:
    parts = []
    for first in range(0, len(recipe.seeds), env.num_envs):
        progress(f"returns of the targets: episode {first} of {len(recipe.seeds)}")
        seeds = recipe.seeds[first : first + env.num_envs]
        observed = start_episodes(env, seeds).select(*env.observation_spec.keys(True, True))
        part = observed[: len(seeds)].cpu().clone()
        part[SEED] = torch.tensor(seeds)
        for name, target in recipe.targets.items():
            part[TARGET_ACTION, name] = target(part.select(*target.in_keys).to(env.device))["action"].cpu()
            part[VALUE, name] = target_returns(env, target, seeds, recipe.gamma)
        parts.append(part)
    _mapped(folder, parts)


def _mapped(folder: Path, parts: list[TensorDict]) -> TensorDict:
    """Write tensordicts one after the other into a memory-mapped one, and return that."""
    table = parts[0][:1].expand(sum(map(len, parts))).memmap_like(str(folder))
    first = 0
    for part in parts:
        for key in part.keys(True, True):
            table[key][first : first + len(part)].copy_(part[key])
        first += len(part)
    return table


def _table(played: list[Played], recipe: Recipe) -> str:
    lines = ["behavior,episode,seed,decisions,seconds,return"]
    for one in played:
        rows = zip(recipe.seeds, one.decisions.tolist(), one.seconds.tolist(), one.returns.tolist(), strict=True)
        lines += [f"{slug(one.behavior.name)},{k},{','.join(map(str, row))}" for k, row in enumerate(rows)]
    return "\n".join(lines) + "\n"


def _card(env: SatelliteTasking, recipe: Recipe, played: list[Played]) -> dict[str, object]:
    return {
        "format": FORMAT,
        "bsk_torch": __version__,
        "torch": torch.__version__,
        "preset": recipe.preset,
        "options": dict(recipe.options),
        "episodes": len(recipe.seeds),
        "share": recipe.share,
        "gamma": recipe.gamma,
        "futures": recipe.futures,
        "targets": list(recipe.targets),
        "behaviors": {
            one.behavior.name: {
                "folder": slug(one.behavior.name),
                "random": one.behavior.random,
                "episodes": len(one.returns),
                "decisions": int(one.decisions.sum()),
                "counterfactuals": one.sampled,
                "mean_return": float(one.returns.mean()),
            }
            for one in played
        },
        "observation": list(env.satellite.observation_description),
        "actions": list(env.satellite.action_description),
    }


def _checksums(folder: Path) -> Iterator[tuple[str, str]]:
    for path in sorted(path for path in folder.rglob("*") if path.is_file()):
        digest = hashlib.sha256()
        with open(path, "rb") as file:
            while block := file.read(BLOCK):
                digest.update(block)
        yield path.relative_to(folder).as_posix(), digest.hexdigest()
