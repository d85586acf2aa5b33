"""Recorded Basilisk episodes, and how to replay them as one batch."""

from __future__ import annotations

import itertools
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from bsk_torch import SatelliteTasking, act, data, rand, scene
from bsk_torch.presets.nadir_scan import ScanningSatellite

HERE = Path(__file__).parent

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


class AllModes(ScanningSatellite):
    """The scanning satellite with two more actions."""

    action_spec = (
        *ScanningSatellite.action_spec,
        act.NadirPoint(duration=90.0),
        act.Drift(duration=45.5),
    )


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


def load(name: str) -> Recording:
    """Read a recording, split into episodes."""
    file = np.load(HERE / f"{name}.npz")
    lengths = file["length"].tolist()
    steps = np.cumsum([0, *lengths])
    points = steps + np.arange(len(steps))
    arrays = {
        key: [file[key][a:b] for a, b in itertools.pairwise(cuts)]
        for keys, cuts in ((("obs", "state"), points), (("reward", "action", "terminated", "truncated"), steps))
        for key in keys
    }
    texts = {key: json.loads(str(file[key])) for key in ("ic", "fixed", "env")}
    return Recording(texts["ic"], texts["fixed"], texts["env"], lengths, arrays)


def environment(recording: Recording, **options: Any) -> SatelliteTasking:
    """An environment whose episodes start where the recorded ones did."""
    arguments: dict[str, Any] = dict(recording.fixed)
    names = [name for name in recording.initial[0] if name != "utc_init"]
    for name in names:
        values = [episode[name] for episode in recording.initial]
        same = all(value == values[0] for value in values)
        arguments[name] = (
            values[0] if same and not isinstance(values[0], list) else rand.per_env(torch.tensor(values, dtype=torch.float64))
        )
    arguments["oe"] = None
    satellite = (AllModes if len(recording.env.get("modes", ())) > 4 else ScanningSatellite)("Scanner1", sat_args=arguments)
    defaults = dict(
        scenario=scene.UniformNadirScanning(value_per_second=1 / 28500.0),
        rewarder=data.ScanningTimeReward(),
        num_envs=len(recording),
        world_args=dict(utc_init=rand.per_env([episode["utc_init"] for episode in recording.initial])),
        time_limit=recording.env["time_limit"],
        sim_rate=recording.env["sim_rate"],
        terminate_on_time_limit=True,
        dtype=torch.float64,
        seed=0,
    )
    return SatelliteTasking(satellite, **(defaults | options))


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


def replay(recording: Recording, env: SatelliteTasking, longest: int | None = None, without: tuple[int, ...] = ()) -> Difference:
    """Play the recorded actions in one batch; rows whose episode has ended are held by partial steps.

    Entries ``without`` of the observation are not compared.
    """
    columns = [k for k in range(recording.arrays["obs"][0].shape[1]) if k not in without]
    td = env.reset()
    largest = dict.fromkeys((*STATE_COLUMNS, "observation", "reward"), 0.0)
    exact = dict.fromkeys(("end times", "terminated", "truncated", "storage"), True)
    steps = min(max(recording.lengths), longest or 10**9)
    compare(recording, env, td["observation"], 0, range(len(recording)), largest, exact, columns)
    for k in range(steps):
        runs = [i for i, length in enumerate(recording.lengths) if k < length]
        action = torch.zeros(len(recording), dtype=torch.int64)
        for i in runs:
            action[i] = int(recording.arrays["action"][i][k])
        mask = torch.zeros(len(recording), 1, dtype=torch.bool)
        mask[runs] = True
        td = env.step(td.empty().set("action", action).set("_step", mask))["next"]
        compare(recording, env, td["observation"], k + 1, runs, largest, exact, columns)
        for i in runs:
            reward = abs(float(td["reward"][i]) - recording.arrays["reward"][i][k])
            largest["reward"] = max(largest["reward"], reward)
            for flag in ("terminated", "truncated"):
                exact[flag] &= bool(td[flag][i]) == bool(recording.arrays[flag][i][k])
    return Difference(largest, exact)


def compare(
    recording: Recording, env: SatelliteTasking, observation: Tensor, k: int, runs: Any, largest: Any, exact: Any, seen: list[int]
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
        error = float(np.abs(observation[i].numpy() - recording.arrays["obs"][i][k])[seen].max())
        if not error <= largest["observation"]:
            largest["observation"] = error
