"""Recorded Basilisk episodes, and how to replay them as one batch."""

import itertools
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from bsk_torch import SatelliteTasking, act, data, rand, scene
from bsk_torch.presets.nadir_scan import ScanningSatellite

RECORDINGS = Path(__file__).parent / "recordings"

STATE_COLUMNS = {
    "r": slice(1, 4),
    "v": slice(4, 7),
    "sigma": slice(7, 10),
    "omega": slice(10, 13),
    "wheel_speed": slice(13, 16),
    "battery": slice(16, 17),
    "storage": slice(17, 18),
    "illumination": slice(18, 19),
}
STEPS = ("reward", "action", "terminated", "truncated")


class AllModes(ScanningSatellite):
    """The scanning satellite with two more actions."""

    action_spec = (*ScanningSatellite.action_spec, act.NadirPoint(duration=90.0), act.Drift(duration=45.5))


@dataclass
class Recording:
    """Episodes of one file: what they start from, what was done, and what came of it."""

    initial: list[dict[str, Any]]
    fixed: dict[str, Any]
    env: dict[str, Any]
    lengths: list[int]
    arrays: dict[str, list[np.ndarray]]

    def __len__(self) -> int:
        return len(self.initial)


def split(file: Any, boundary: Sequence[str], steps: Sequence[str]) -> tuple[list[int], dict[str, list[np.ndarray]]]:
    """Lengths of the episodes of a file, and its rows by episode: those at decisions, one more than steps, and those of steps."""
    lengths = file["length"].tolist()
    ends = np.cumsum([0, *lengths])
    cuts = dict.fromkeys(boundary, ends + np.arange(len(ends))) | dict.fromkeys(steps, ends)
    return lengths, {key: [file[key][a:b] for a, b in itertools.pairwise(where)] for key, where in cuts.items()}


def load(name: str) -> Recording:
    """Read a recording, split into episodes."""
    file = np.load(RECORDINGS / f"{name}.npz")
    lengths, arrays = split(file, ("obs", "state"), STEPS)
    texts = {key: json.loads(str(file[key])) for key in ("ic", "fixed", "env")}
    return Recording(texts["ic"], texts["fixed"], texts["env"], lengths, arrays)


def arguments(recording: Recording) -> dict[str, Any]:
    """Arguments of the satellites, environment by environment where they differ."""
    values: dict[str, Any] = {**recording.fixed, "oe": None}
    for name in set(recording.initial[0]) - {"utc_init", "time_limit", "target_seed"}:
        each = [episode[name] for episode in recording.initial]
        same = not isinstance(each[0], list) and all(value == each[0] for value in each)
        values[name] = each[0] if same else rand.per_env(torch.tensor(each, dtype=torch.float64))
    return values


def common_options(recording: Recording) -> dict[str, Any]:
    """Options of the environment that do not depend on the problem."""
    return dict(
        num_envs=len(recording),
        world_args=dict(utc_init=rand.per_env([episode["utc_init"] for episode in recording.initial])),
        dtype=torch.float64,
        seed=0,
        compat="bsk_rl",
    )


def environment(recording: Recording, **options: Any) -> SatelliteTasking:
    """An environment whose episodes start where the recorded ones did."""
    kind = AllModes if len(recording.env.get("modes", ())) > 4 else ScanningSatellite
    defaults = dict(
        scenario=scene.UniformNadirScanning(value_per_second=1 / 28500.0),
        rewarder=data.ScanningTimeReward(),
        time_limit=recording.env["time_limit"],
        sim_rate=recording.env["sim_rate"],
        terminate_on_time_limit=True,
    )
    return SatelliteTasking(kind("Scanner1", sat_args=arguments(recording)), **(common_options(recording) | defaults | options))


def state_of(env: SatelliteTasking) -> Tensor:
    """The recorded quantities of the present state, [N, 19]."""
    s, d = env.simulator, env.satellite.dynamics
    parts = [s.sim_time, d.r_BN_N, d.v_BN_N, d.sigma_BN, d.omega_BN_B, d.wheel_speeds]
    parts += [d.battery_charge, d.storage_level, d.illumination]
    return torch.cat([part.double().reshape(len(s.ticks), -1) for part in parts], 1)


@dataclass
class Difference:
    """Largest absolute differences from the recording, by quantity, and whether the exact things are equal."""

    largest: dict[str, float]
    exact: dict[str, bool]


Check = Callable[[int, Sequence[int], Difference], None]
"""Enters further differences at decision boundary k of some episodes."""


def replay(
    recording: Recording, env: SatelliteTasking, longest: int | None = None, check: Check = lambda k, runs, difference: None
) -> Difference:
    """Play the recorded actions in one batch; rows whose episode has ended are held by partial steps."""
    td = env.reset()
    largest = dict.fromkeys((*STATE_COLUMNS, "observation", "reward"), 0.0)
    exact = dict.fromkeys(("end times", "terminated", "truncated", "storage"), True)
    found, everyone = Difference(largest, exact), range(len(recording))
    compare(recording, env, td["observation"], 0, everyone, largest, exact)
    check(0, everyone, found)
    for k in range(min(max(recording.lengths), longest or 10**9)):
        runs = [i for i, length in enumerate(recording.lengths) if k < length]
        action = torch.zeros(len(recording), dtype=torch.int64)
        for i in runs:
            action[i] = int(recording.arrays["action"][i][k])
        mask = torch.zeros(len(recording), 1, dtype=torch.bool)
        mask[runs] = True
        td = env.step(td.empty().set("action", action).set("_step", mask))["next"]
        compare(recording, env, td["observation"], k + 1, runs, largest, exact)
        check(k + 1, runs, found)
        for i in runs:
            reward = abs(float(td["reward"][i]) - recording.arrays["reward"][i][k])
            largest["reward"] = max(largest["reward"], reward)
            for flag in ("terminated", "truncated"):
                exact[flag] &= bool(td[flag][i]) == bool(recording.arrays[flag][i][k])
    return found


def compare(
    recording: Recording, env: SatelliteTasking, observation: Tensor, k: int, runs: Any, largest: Any, exact: Any
) -> None:
    """Enter the differences at decision boundary k of the episodes ``runs``."""
    state = state_of(env).numpy()
    for i in runs:
        wanted = recording.arrays["state"][i][k]
        exact["end times"] &= round(wanted[0] * 1e9) == round(state[i, 0] * 1e9)
        exact["storage"] &= wanted[17] == state[i, 17]
        for name, columns in STATE_COLUMNS.items():
            error = float(np.abs(state[i, columns] - wanted[columns]).max())
            if not error <= largest[name]:
                largest[name] = error
        error = float(np.abs(observation[i].numpy() - recording.arrays["obs"][i][k]).max())
        if not error <= largest["observation"]:
            largest["observation"] = error
