"""Targets that a subclass makes itself, environment by environment, in bsk_rl's ``regenerate_targets``.

The hook runs on a copy of the scenario for each environment at its reset, under a random stream of that environment and episode.
Its ``self.targets`` become drawn values, so everything else works as with targets drawn in batches.
"""

from __future__ import annotations

import copy
import itertools
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor

from bsk_torch._checks import no_gradient
from bsk_torch.constants import R_EARTH
from bsk_torch.rand import Distribution, Key, seeded
from bsk_torch.scene.draws import check_positions, draw_numbers
from bsk_torch.scene.target import Target
from bsk_torch.sim.hooks import note_slow

if TYPE_CHECKING:
    from collections.abc import Iterator

    from bsk_torch.scene.uniform import UniformTargets

KEY = "target_key"
"""Drawn value from which the targets of an episode can be made again: the words of its key."""

ADVICE = (
    "draw all environments at once by places(key), which returns target_r_LP_P [n, T, 3], and further values such as "
    "target_cloud_cover [n, T] from key.named('cloud_cover').uniform(self.most_targets)"
)

OWN = ("name", "r_LP_P", "priority")
"""Attributes that every target has."""

RESERVED = ("exists", "key")
"""Attributes whose drawn values would take the names of others."""


def draw_regenerated(scenario: UniformTargets, key: Key) -> dict[str, Tensor]:
    """Run ``regenerate_targets`` for each of the key's environments; return what it makes as drawn values, [n, ...].

    Raises:
        TypeError: For something that is no target, or attributes that differ from target to target.
        ValueError: For positions that are no places on the Earth, or more targets than the scenario has room for.
    """
    note_slow(f"{type(scenario).__name__}.regenerate_targets()", ADVICE)
    words = key_words(key)
    made = [_remembered(scenario, tuple(row)) for row in words.tolist()]
    if not vars(scenario).get("_room_is_known"):
        scenario.most_targets = max(scenario.most_targets, len(made[0]))
        scenario._room_is_known = True  # type: ignore[attr-defined]
    most = scenario.most_targets
    for row, targets in enumerate(made):
        if len(targets) > most:
            raise ValueError(
                f"{type(scenario).__name__}.regenerate_targets() makes {len(targets)} targets in environment "
                f"{int(key.env_id[row])}, where there is room for {most}; give the largest number as n_targets, as in "
                f"n_targets=({scenario.low}, {len(targets) + 1})"
            )
    values = {"target_exists": torch.tensor([[k < len(targets) for k in range(most)] for targets in made]).double()}
    for name, blank in _columns(scenario, made).items():
        rows = [[_number(target, name) for target in targets] + [blank] * (most - len(targets)) for targets in made]
        values[f"target_{name}"] = torch.as_tensor(np.array(rows, dtype=float))
    check_positions(values["target_r_LP_P"].flatten(0, 1))
    return values | {KEY: torch.tensor(words.tolist(), dtype=torch.float64)}


def key_words(key: Key) -> Tensor:
    """Return the words of a key, each below 2**32: low and high half of the seed, environment and episode, [n, 4] int64."""
    return torch.stack([key.seed & 0xFFFFFFFF, key.seed >> 32, key.env_id, key.episode], -1)


def made_again(scenario: UniformTargets, row: int) -> list[Target]:
    """Return the targets of the present episode of environment ``row``, the same objects as long as they are known."""
    return _remembered(scenario, tuple(int(word) for word in scenario.drawn(KEY)[row].tolist()))


def _remembered(scenario: UniformTargets, words: tuple[int, ...]) -> list[Target]:
    """Return the targets of a key; those of each environment's last key are kept."""
    known: dict[int, tuple[tuple[int, ...], list[Target]]] = scenario.__dict__.setdefault("_made", {})
    if words[2] not in known or known[words[2]][0] != words:
        known[words[2]] = words, _make(scenario, words)
    return known[words[2]][1]


def _make(scenario: UniformTargets, words: tuple[int, ...]) -> list[Target]:
    low, high, env_id, episode = (torch.tensor([word]) for word in words)
    key = Key(low | (high << 32), env_id, episode)
    one = copy.copy(scenario)
    one.regenerated_key = key
    one.targets, one.n_targets = [], int(scenario.draw_exists(key).sum())
    one.priority_distribution = _one_by_one(scenario, key)
    with seeded(key.named("regenerate_targets"), reseed=True) as rows:  # the same when they are made again, outside of a draw
        next(rows)
        one.regenerate_targets()
    for target in one.targets:
        if not isinstance(target, Target):
            raise TypeError(f"{type(scenario).__name__}.regenerate_targets() makes {target!r}; it must make scene.Target objects")
    return list(one.targets)


def _one_by_one(scenario: UniformTargets, key: Key) -> Callable[[], float]:
    """Return the priorities as bsk_rl's hook asks for them: a function that gives one at each call."""
    given = scenario.priority_distribution
    if callable(given) and not isinstance(given, Distribution):
        return given

    def numbers() -> Iterator[float]:
        for block in itertools.count():
            named = key.named(f"target_priority {block}" if block else "target_priority")
            yield from draw_numbers("priority_distribution", given, named, scenario.most_targets)[0].tolist()

    return numbers().__next__


def _columns(scenario: UniformTargets, made: Sequence[list[Target]]) -> dict[str, Any]:
    """Return the names of attributes that are numbers, each with what padding has."""
    columns: dict[str, Any] = {"r_LP_P": np.array([R_EARTH, 0.0, 0.0]), "priority": 0.0}
    for target in (target for targets in made for target in targets):
        for name in vars(target):
            if name not in OWN and not name.startswith("_") and name not in columns and _number(target, name) is not None:
                if name in RESERVED:
                    raise TypeError(f"{type(scenario).__name__}: targets cannot have an attribute {name!r}; rename it")
                columns[name] = np.zeros_like(_number(target, name))
    return columns


def _number(target: Target, name: str) -> np.ndarray | None:
    """Return an attribute as an array of numbers; None for one made of other things."""
    if not hasattr(target, name):
        raise TypeError(f"{target!r} lacks {name!r}, which other targets have; all targets must have the same attributes")
    value = no_gradient(f"{name!r} of a target", getattr(target, name))
    try:
        array = np.asarray(value.cpu() if isinstance(value, Tensor) else value)
    except ValueError:
        return None
    return array.astype(float) if array.dtype.kind in "biuf" else None
