"""Flights for estimates of risks: levels, draws and causes of death of the episodes of seeds, and files to fly them again."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import isnan
from pathlib import Path
from typing import Annotated, Any, Literal

import torch
from annotated_types import Interval, MinLen
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from bsk_torch.env import Tasking
from bsk_torch.env.rollout import play_episodes
from bsk_torch.files import write_file
from bsk_torch.lab.planners.agent_table import AgentTable
from bsk_torch.lab.risk.drawn import drawn_arguments, drawn_of_seeds, suns
from bsk_torch.lab.risk.rare_events import RareEvent
from bsk_torch.lab.risk.subset import Sample
from bsk_torch.rand import Blend, blended
from bsk_torch.rl.evaluation.evaluate import failed_checks, of_team, start_episodes, with_lots
from bsk_torch.untrusted import Json, parse_json, read_bytes

FAILED, TIME, DRAWN, RETURNS = "failed", "time", "drawn", "returns"
"""Notes: failed aliveness checks [m, C], time of the event [m] s (NaN without), drawn arguments [m, D], returns [m]."""


@dataclass
class Flights:
    """Plays episodes of seeds with a policy, as many at a time as the environment has rows.

    Attributes:
        env: The environment, with ``env_ids=[0] * num_envs``.
        policy: The policy.
        event: The event.
        checks: Names of the aliveness checks, after the first flight.
        columns: Names of the drawn arguments, after the first flight.
    """

    env: Tasking
    policy: TensorDictModuleBase
    event: RareEvent
    checks: list[str] = field(default_factory=list)
    columns: list[str] = field(default_factory=list)

    def __call__(self, seeds: Tensor) -> TensorDict:
        """Play the episodes of ``seeds`` [m]; see :data:`bsk_torch.lab.risk.subset.Fly`."""
        return torch.cat([self._fly(some) for some in seeds.split(self.env.num_envs)])

    def _fly(self, seeds: Tensor) -> TensorDict:
        env, m = self.env, len(seeds)
        start = start_episodes(env, seeds.tolist())
        names, values = drawn_arguments(env)
        rows = torch.arange(env.num_envs, device=env.device) < m
        level, happened = self.event.level(env), self.event.happens(env)
        time = torch.where(happened, env.fleet.sim_time, torch.nan)
        for playing, _ in play_episodes(env, with_lots(self.policy, env), start, rows):
            level = torch.where(playing, torch.maximum(level, self.event.level(env)), level)
            now = playing & ~happened & self.event.happens(env)
            happened, time = happened | now, torch.where(now, env.fleet.sim_time, time)
        failed = {name: of_team(each) > 0 for name, each in failed_checks(env).items()}
        self.checks, self.columns = list(failed), names
        results = {
            "level": torch.where(happened, torch.inf, level),
            "seconds": env.fleet.sim_time.clone(),
            FAILED: torch.stack(list(failed.values()), 1) & env.dead.view(len(rows), -1).any(1, keepdim=True),
            TIME: time,
            DRAWN: values,
            RETURNS: env.returns.clone(),
        }
        return TensorDict(results, [len(rows)])[:m].cpu()

    def draws(self, seeds: Tensor) -> Tensor:
        """Return what is drawn at reset for ``seeds`` [m] without a reset, and the Sun's directions, [m, D + 3 S]."""
        names, values = drawn_of_seeds(self.env, seeds)
        return torch.cat([values, suns(names, values)], 1)

    def actions(self, seeds: Tensor) -> list[list[object]]:
        """Return the actions of all agents in the episodes of ``seeds`` [m], a list of decisions for each."""
        env, slots, episodes = self.env, AgentTable(self.env), list[list[object]]()
        for some in seeds.split(env.num_envs):
            decisions: list[list[object]] = [[] for _ in some]
            start = start_episodes(env, some.tolist())
            rows = torch.arange(env.num_envs, device=env.device) < len(some)
            for playing, step in play_episodes(env, with_lots(self.policy, env), start, rows):
                chosen = slots.numbers(step) if any(slots.real) else slots.chosen(step)
                for row in torch.nonzero(playing).squeeze(1).tolist():
                    decisions[row].append(chosen[row].tolist())
            episodes += decisions
        return episodes


# -- files --------------------------------------------------------------------------------------------------------------------

KIND = "episodes with a rare event"
"""What the first entry of a file says."""

TABLES = {"parts": torch.int64, "steps": torch.float64, "shares": torch.float64}
"""Tables of a blend in a file, and their types."""


LARGEST = 2**26
"""Largest file, bytes, and most numbers in one of its tables."""


@dataclass
class SavedEpisode:
    """An episode of a file: its seed, its blend, and the actions of all agents at each decision."""

    seed: Annotated[int, Interval(ge=-(2**63), lt=2**63)]
    parts: list[Annotated[int, Interval(ge=-(2**63), lt=2**63)]]
    steps: list[float]
    shares: list[float]
    actions: Annotated[list[Annotated[list[float | list[float]], MinLen(1)]], MinLen(1)]

    def __post_init__(self) -> None:
        if not len(self.parts) == len(self.steps) == len(self.shares):
            raise ValueError(f"seed {self.seed}: parts, steps and shares have different lengths")


@dataclass
class Paths:
    """A file of :func:`save_paths`, apart from what it tells of the flights."""

    kind: Literal["episodes with a rare event"]
    episodes: Annotated[list[SavedEpisode], MinLen(1)]


def save_paths(path: Path | str, about: Mapping[str, object], sample: Sample, actions: Sequence[object]) -> None:
    """Write episodes into a JSON file, from which :func:`read_paths` plays them again.

    Args:
        path: The file.
        about: Entries that tell what was flown, such as preset, options and policy.
        sample: The episodes.
        actions: What was done in each of them; see :meth:`Flights.actions`.
    """
    lines = []
    for k, seed in enumerate(sample.seeds.tolist()):
        mask = sample.steps[k] != 0.0
        blend = {name: getattr(sample, name)[k, mask].tolist() for name in TABLES}
        time = float(sample.flown[TIME][k])
        outcome = {"time": None if isnan(time) else time, "return": float(sample.flown[RETURNS][k])}
        lines.append({"seed": seed, **blend, **outcome, "actions": actions[k]})
    head = ",\n ".join(f"{json.dumps(name)}: {json.dumps(value)}" for name, value in {"kind": KIND, **about}.items())
    entries = ",\n  ".join(json.dumps(line) for line in lines)
    write_file(path, f'{{\n {head},\n "episodes": [\n  {entries}\n ]\n}}\n')


def read_paths(path: Path | str) -> tuple[dict[str, Any], Blend]:
    """Return the content of a file of :func:`save_paths`, and the blend within whose context its seeds are its episodes.

    Raises:
        OSError, ValueError: If it cannot be read, or is another file.
    """
    try:
        raw = read_bytes(path, LARGEST)
        episodes, content = parse_json(raw, Paths).episodes, parse_json(raw, dict[str, Json])
        width = max(len(episode.parts) for episode in episodes)
        if width * len(episodes) > LARGEST:  # one long blend would widen those of all episodes
            raise ValueError(f"its {len(episodes):,} episodes are blends of up to {width:,} parts")
        tables = [
            torch.tensor([[*row, *[0] * (width - len(row))] for row in (getattr(one, name) for one in episodes)], dtype=dtype)
            for name, dtype in TABLES.items()
        ]
        blend = Blend(torch.tensor([episode.seed for episode in episodes], dtype=torch.int64), *tables)
    except ValueError as error:
        raise ValueError(f"{str(path)!r} is not a file of episodes written by 'bsk-torch risk': {error}") from None
    return content, blend


def play_again(env: Tasking, path: Path | str) -> Tensor:
    """Take the saved actions in the saved episodes, and return their returns, [E].

    Args:
        env: An environment made as for the file; it plays ``num_envs`` episodes at a time.
        path: See :func:`read_paths`.

    Raises:
        OSError, ValueError: See :func:`read_paths`.
    """
    content, blend = read_paths(path)
    twin, episodes, returns = env.like(env.num_envs, env_ids=[0] * env.num_envs), content["episodes"], list[Tensor]()
    with blended(blend):
        for first in range(0, len(episodes), env.num_envs):
            some = episodes[first : first + env.num_envs]
            now = start_episodes(twin, [episode["seed"] for episode in some])
            returns.append(_repeated(twin, now, [episode["actions"] for episode in some]))
    return torch.cat(returns)


def _repeated(env: Tasking, start: TensorDictBase, actions: Sequence[Sequence[Any]]) -> Tensor:
    slots, steps = AgentTable(env), iter(range(max(map(len, actions))))
    rows = torch.arange(env.num_envs) < len(actions)

    def scripted(td: TensorDictBase) -> TensorDictBase:
        step = next(steps)
        current = [list(episode[min(step, len(episode) - 1)]) for episode in actions]
        table = torch.tensor(current + current[-1:] * (env.num_envs - len(current)), device=env.device)
        if table.shape[1] != slots.size:
            raise ValueError(f"the episodes have actions of {table.shape[1]} agents; this environment has {slots.size}")
        slots.neutral(td)
        for slot in range(slots.size):
            slots.put(td, torch.full_like(rows, slot, dtype=torch.int64), table[:, slot], torch.ones_like(rows))
        return td

    for _ in play_episodes(env, scripted, start, rows.to(env.device)):
        pass
    return env.returns[: len(actions)].clone()
