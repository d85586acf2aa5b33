"""Recordings of the examples of bsk_rl's documentation, and how to replay them in ours.

Files ``example_*.npz`` come from ``scripts/recorders/record_examples.py``; see ``tests/basilisk/README.md``.
"""

import importlib
import json
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from bsk_torch import NO_ACTION, act, rand, scene
from tests.basilisk.replay import RECORDINGS

FOLDER = Path(__file__).parents[2] / "examples" / "bsk_rl"
BY_NAME = 1_000_000
"""Actions from here on name targets."""

BY_SATELLITE = ("sat_args", "names", "action_description", "observation_description")
"""Entries of ``setup`` with one value for each satellite."""

EXACT = 1e-9
"""Bound of rewards and durations, s: bsk_rl's clock has rounding errors of 1e-13 s."""


def example(name: str) -> ModuleType:
    """A file of ``examples/bsk_rl`` as a module; files there import each other."""
    if str(FOLDER) not in sys.path:
        sys.path.insert(0, str(FOLDER))
    return importlib.import_module(name)


@dataclass
class Recorded:
    """An episode: what it starts from, what was done, and what came of it; see the README of the recordings."""

    setup: dict[str, Any]
    arrays: dict[str, np.ndarray]

    @property
    def satellites(self) -> int:
        """Number of satellites."""
        return len(self.setup["names"])

    def only(self, name: str) -> "Recorded":
        """What is recorded of one satellite."""
        k = self.setup["names"].index(name)
        each = {key: value[k : k + 1] for key, value in self.setup.items() if key in BY_SATELLITE}
        width = len(each["observation_description"][0])
        arrays = {key: value if key in ("duration", "targets") else value[:, k : k + 1] for key, value in self.arrays.items()}
        return Recorded(self.setup | each, arrays | {"obs": arrays["obs"][..., :width]})

    def target(self, name: str) -> Tensor:
        """An attribute of the targets that can be seen, [T]."""
        return torch.from_numpy(self.arrays["targets"][:, 4 + self.setup["attributes"].index(name)].copy())

    @property
    def targets(self) -> scene.Targets:
        """The targets that can be seen, as a scenario."""
        table = torch.from_numpy(self.arrays["targets"])
        return scene.Targets(table[:, :3], rand.per_env(table[:, 3].unsqueeze(0)))


def load(name: str) -> Recorded:
    """Read a recording."""
    with np.load(RECORDINGS / f"example_{name}.npz") as file:
        arrays = {key: file[key] for key in file.files if key != "setup"}
        return Recorded(json.loads(str(file["setup"])), arrays)


def start(*recorded: Recorded) -> dict[str, Any]:
    """Options of ``make`` with which environment i starts where the i-th recording did."""
    first = recorded[0].setup["sat_args"]
    arguments = [
        {name: rand.per_env(torch.tensor([r.setup["sat_args"][k][name] for r in recorded], dtype=torch.float64)) for name in one}
        for k, one in enumerate(first)
    ]
    return dict(
        num_envs=len(recorded),
        sat_args=arguments[0] if len(arguments) == 1 else arguments,
        world_args=dict(utc_init=rand.per_env([r.setup["utc_init"] for r in recorded])),
        dtype=torch.float64,
        seed=0,
    )


Before = Callable[[Any, int], None]
"""Called with environment and number of the step before each step."""


class Replay:
    """Plays recorded actions and compares what comes of them."""

    def __init__(self, env: Any, *recorded: Recorded, tolerance: float = 1e-6, before: Before = lambda env, k: None) -> None:
        """``tolerance`` is that of observations."""
        self.env, self.recorded, self.tolerance, self.before = env, recorded, tolerance, before
        self.worst = 0.0

    @property
    def joint(self) -> bool:
        """Whether one agent commands all satellites."""
        return getattr(self.env, "joint", False)

    def rows(self, td: TensorDictBase, name: str) -> Tensor:
        """Observations and the like by satellite or agent, [N, A, ...]."""
        value = td["agents", name] if "agents" in td else td[name]
        return value if "agents" in td else value.unflatten(1, (-1, value.shape[1])) if value.ndim > 1 else value.unsqueeze(1)

    def run(self, longest: int | None = None) -> float:
        """Play at most ``longest`` steps of each recording; return the largest difference of observations."""
        self.names()
        td = self.env.reset()
        self.look(td, 0)
        steps = len(self.recorded[0].arrays.get("action", ()))
        for k in range(min(steps, longest or steps)):
            self.before(self.env, k)
            td = self.env.step(self.task(td, k))["next"]
            self.judge(td, k)
            self.look(td, k + 1)
        return self.worst

    def names(self) -> None:
        """Names of observations and actions are those of bsk_rl, and so is the time limit."""
        for i, recorded in enumerate(self.recorded):
            for satellite, actions, observations in zip(
                members(self.env), *(recorded.setup[f"{what}_description"] for what in ("action", "observation")), strict=True
            ):
                assert list(satellite.action_description) == actions
                assert list(satellite.observation_description) == observations
            self.env.reset()
            assert float(self.env.time_limit[i]) == recorded.setup["time_limit"]

    def task(self, td: TensorDictBase, k: int) -> TensorDict:
        """The recorded actions of step k."""
        action = torch.stack([torch.from_numpy(recorded.arrays["action"][k]) for recorded in self.recorded])
        action = torch.where(action >= BY_NAME, act.image_target((action - BY_NAME).clamp(min=0)), action)
        action = torch.where(action == -1, torch.full_like(action, NO_ACTION), action)
        if "agents" in td:
            return TensorDict({("agents", "action"): action}, [len(self.recorded)])
        return TensorDict({"action": action if self.joint else action.squeeze(1)}, [len(self.recorded)])

    def judge(self, td: TensorDictBase, k: int) -> None:
        """Compare rewards, durations and flags of step k."""
        reward = self.rows(td, "reward").reshape(len(self.recorded), -1).numpy()
        for i, recorded in enumerate(self.recorded):
            row = {name: value[k] for name, value in recorded.arrays.items() if name not in ("obs", "targets")}
            present = row["present"]
            np.testing.assert_allclose(reward[i][present], row["reward"][present], rtol=0, atol=EXACT, err_msg=f"step {k}")
            np.testing.assert_allclose(float(td["duration"][i]), row["duration"], rtol=0, atol=EXACT, err_msg=f"step {k}")
            for flag in ("terminated", "truncated"):
                if present.all():
                    assert bool(td[flag][i]) == bool(row[flag].all()), (flag, k)
            asked = members_require_retasking(self.env, td)[i].numpy()
            np.testing.assert_array_equal(asked, row["requires_retasking"], err_msg=f"step {k}")

    def look(self, td: TensorDictBase, boundary: int) -> None:
        """Compare observations of a decision."""
        seen = self.rows(td, "observation")
        for i, recorded in enumerate(self.recorded):
            index, rest = divmod(boundary, recorded.setup["every"])
            if rest:
                continue
            wanted = recorded.arrays["obs"][index]
            mine = seen[i].reshape(wanted.shape).numpy()
            there = ~np.isnan(wanted)
            error = np.abs(mine - wanted)[there] / np.maximum(1.0, np.abs(wanted[there]))
            self.worst = max(self.worst, float(error.max(initial=0.0)))
            places = np.argwhere((np.abs(mine - wanted) / np.maximum(1.0, np.abs(wanted)) > self.tolerance) & there)
            assert not len(places), (boundary, places[:5].tolist(), self.worst)


def members(env: Any) -> list[Any]:
    """The satellite of each name, in order."""
    if hasattr(env, "satellite"):
        return [env.satellite]
    return [next(part for part in env.fleet.satellites if name in part.names) for name in env.fleet.names]


def members_require_retasking(env: Any, td: TensorDictBase) -> Tensor:
    """[N, S]."""
    if hasattr(env, "satellite"):
        return env.requires_retasking.unsqueeze(1)
    return (td["agents", "requires_retasking"] if "agents" in td else td["members_require_retasking"]).flatten(1)
