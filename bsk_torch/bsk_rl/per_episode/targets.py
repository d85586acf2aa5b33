"""Scenarios with targets of one episode, run for each episode of a batch.

The targets are made by ``regenerate_targets()`` at the start of each episode, with a separate stream of NumPy's global generator
for each environment and episode. They become drawn values, so everything else works as with targets drawn in batches.
"""

from __future__ import annotations

import copy
from collections.abc import Iterable, Sequence

import numpy as np
import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch._checks import no_gradient
from bsk_torch.bsk_rl.scene.targets import UniformTargets as OneTargets
from bsk_torch.constants import R_EARTH
from bsk_torch.rand import Key, seeded
from bsk_torch.scene.draws import check_positions
from bsk_torch.scene.targets import Target
from bsk_torch.scene.uniform import UniformTargets
from bsk_torch.sim.hooks import is_of_package

KEY = "target_key"
"""Drawn value from which the targets of an episode can be made again: the words of its key."""

COMMON = ("name", "r_LP_P", "priority")
"""Attributes of every target."""

RESERVED = ("exists", "key")
"""Attributes whose drawn values would have names already in use."""

NOT_CALLED = (
    "after_step", "link_satellites", "reset_during_sim_init", "reset_overwrite_previous", "reset_post_sim_init",
    "reset_pre_sim_init", "validate_satellite_names",
)  # fmt: skip
"""Hooks of scenarios of one episode that have no counterpart in a batch."""


class PerEpisodeTargets(UniformTargets):
    """Lets a deep copy of a scenario of one episode make the targets of each episode."""

    def __init__(self, targets: OneTargets) -> None:
        """Run copies of ``targets``; TypeError for one with hooks that would not be called."""
        super().__init__(targets._n_targets, radius=targets.radius)
        if hooks := sorted(name for name in NOT_CALLED if not is_of_package(getattr(type(targets), name))):
            raise TypeError(
                f"{type(targets).__name__}: {', '.join(hooks)} would not be called in a batch; regenerate_targets() is"
            )
        self.original = targets
        self._room_is_known = False
        self._made: dict[int, tuple[tuple[int, ...], list[Target]]] = {}

    @property
    @override
    def calls_user(self) -> bool:
        return True

    @override
    def draw(self, key: Key) -> dict[str, Tensor]:
        halves = torch.stack([key.seed & 0xFFFFFFFF, key.seed >> 32, key.env_id, key.episode], -1)
        made = [self._remembered(tuple(row)) for row in halves.tolist()]
        if not self._room_is_known:
            self.most_targets, self._room_is_known = max(self.most_targets, len(made[0])), True
        most = self.most_targets
        for row, targets in enumerate(made):
            if len(targets) > most:
                raise ValueError(
                    f"{type(self.original).__name__}.regenerate_targets() makes {len(targets)} targets in environment "
                    f"{int(key.env_id[row])}, where there is room for {most}; give the largest number as n_targets, as in "
                    f"n_targets=({self.low}, {len(targets) + 1})"
                )
        values = {"target_exists": torch.tensor([[k < len(targets) for k in range(most)] for targets in made]).double()}
        for name, blank in _columns(self.original, made).items():
            rows = [[_number(target, name) for target in targets] + [blank] * (most - len(targets)) for targets in made]
            values[f"target_{name}"] = torch.as_tensor(np.array(rows, dtype=float))
        check_positions(values["target_r_LP_P"].flatten(0, 1))
        return values | {KEY: halves.double()}

    def _remembered(self, words: tuple[int, ...]) -> list[Target]:
        """Return the targets of the words of a key; those of each environment's last key are cached."""
        if words[2] not in self._made or self._made[words[2]][0] != words:
            self._made[words[2]] = words, self._make(words)
        return self._made[words[2]][1]

    def _make(self, words: tuple[int, ...]) -> list[Target]:
        low, high, env_id, episode = (torch.tensor([word]) for word in words)
        key = Key(low | (high << 32), env_id, episode)
        one = copy.deepcopy(self.original)
        one.targets, one.n_targets = [], int(self.draw_exists(key).sum())
        with seeded(key.named("regenerate_targets"), reseed=True) as rows:  # the same when they are made again, outside of a draw
            next(rows)
            one.regenerate_targets()
        made = []
        for theirs in one.targets:
            target = Target(theirs.name, theirs.r_LP_P, theirs.priority)
            target.__dict__.update({name: value for name, value in vars(theirs).items() if name not in vars(target)})
            made.append(target)
        return made

    @override
    def _make_objects(self, row: int) -> Iterable[tuple[int, Target]]:
        return enumerate(self._remembered(tuple(int(word) for word in self.drawn(KEY)[row].tolist())))

    @override
    def names(self, row: int) -> list[str]:
        names = [target.name for target in self.target_objects(row)]
        return names + self.target_names[len(names) :]


def _columns(scenario: OneTargets, made: Sequence[list[Target]]) -> dict[str, object]:
    """Return the names of numeric attributes, each with its value for padding."""
    columns: dict[str, object] = {"r_LP_P": np.array([R_EARTH, 0.0, 0.0]), "priority": 0.0}
    for target in (target for targets in made for target in targets):
        for name in vars(target):
            if name not in COMMON and not name.startswith("_") and name not in columns and _number(target, name) is not None:
                if name in RESERVED:
                    raise TypeError(f"{type(scenario).__name__}: targets cannot have an attribute {name!r}; rename it")
                columns[name] = np.zeros_like(_number(target, name))
    return columns


def _number(target: Target, name: str) -> np.ndarray | None:
    if not hasattr(target, name):
        raise TypeError(f"{target!r} lacks {name!r}, which other targets have; all targets must have the same attributes")
    value = no_gradient(f"{name!r} of a target", getattr(target, name))
    try:
        array = np.asarray(value.cpu() if isinstance(value, Tensor) else value)
    except ValueError:
        return None
    return array.astype(float) if array.dtype.kind in "biuf" else None
