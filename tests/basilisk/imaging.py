"""Recorded point-imaging episodes, and how to replay them as one batch."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import torch

from bsk_torch import SatelliteTasking, act, data, obs, rand, sats, scene
from bsk_torch.sim import dyn, fsw
from tests.basilisk.replay import RECORDINGS, STEPS, Difference, Recording, arguments, common_options, split
from tests.basilisk.replay import replay as replay_state

EARTH_RADIUS = 6378136.6
KINDS = ("target", "ground_station")
BOUNDARY = ("obs", "state", "imaged", "missed", "duplicates")
IMAGING_STEPS = (*STEPS, "requires_retasking", "tasked", "image")
BUFFER = 19
"""Column of the state with the data in the images' partition."""


@dataclass
class Windows:
    """Windows that bsk_rl knew at one time, in its order: number of the place, opening and closing time."""

    place: np.ndarray
    open: np.ndarray
    close: np.ndarray


@dataclass
class ImagingRecording(Recording):
    """Adds targets, [E, T, 3] m and [E, T], and ``windows[kind][episode]``: after reset, and after the last step."""

    r_LP_P: np.ndarray
    priority: np.ndarray
    windows: dict[str, list[tuple[Windows, Windows]]]


def make_targets(seed: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Positions [count, 3] m and priorities [count] of recorded targets: what scripts/recorders/record_imaging.py draws."""
    rng = np.random.RandomState(seed)
    r_LP_P = rng.normal(size=(count, 3))
    r_LP_P *= EARTH_RADIUS / np.sqrt((r_LP_P**2).sum(1, keepdims=True))
    return r_LP_P, rng.uniform(size=count)


def load(name: str) -> ImagingRecording:
    """Read a recording, split into episodes."""
    with np.load(RECORDINGS / f"{name}.npz") as archive:
        file = {key: archive[key] for key in archive.files}
    lengths, arrays = split(file, BOUNDARY, IMAGING_STEPS)
    initial, fixed, env = (json.loads(str(file[key])) for key in ("ic", "fixed", "env"))
    tables = [make_targets(episode["target_seed"], env["targets"]) for episode in initial]
    r_LP_P, priority = (np.stack(part) for part in zip(*tables, strict=True))
    totals = np.concatenate([r_LP_P.sum(1), priority.sum(1, keepdims=True)], 1)
    np.testing.assert_allclose(totals, file["target_sum"], rtol=1e-12, err_msg="numpy draws other targets than it used to")
    windows = {kind: [known(file, kind, episode) for episode in range(len(initial))] for kind in kinds_of(env)}
    return ImagingRecording(initial, fixed, env, lengths, arrays, r_LP_P, priority, windows)


def kinds_of(env: dict[str, Any]) -> tuple[str, ...]:
    """Kinds of windows: those of instruments with their own limits follow targets and stations."""
    return (*KINDS, *(kind for kind in env["properties"] if kind.startswith("target@")))


def known(file: dict[str, np.ndarray], kind: str, episode: int) -> tuple[Windows, Windows]:
    """Windows of one kind that an episode knew at its start and at its end."""
    number = kinds_of(json.loads(str(file["env"]))).index(kind)
    mine = (file["window_station"] == number) & (file["window_episode"] == episode)
    rows = [mine & (file["window_time"] == when) for when in (0, 1)]
    first, last = (Windows(*(file[f"window_{name}"][row] for name in ("place", "open", "close"))) for row in rows)
    return first, last


def imager(env: dict[str, Any]) -> type[sats.ImagingSatellite]:
    """The satellite that a recording's ``env`` describes."""

    def entries(kind: str) -> list[dict[str, Any]]:
        return [dict(prop=prop, norm=norm) for prop, norm in env["properties"][kind]]

    opportunities = [
        obs.OpportunityProperties(*entries(kind), type=kind, n_ahead_observe=count)
        for kind, count in zip(KINDS, (env["ahead"], env["stations"]), strict=True)
        if count
    ]
    opportunities += [
        obs.OpportunityProperties(*entries(kind), n_ahead_observe=env["ahead"], instrument=kind.removeprefix("target@"))
        for kind in kinds_of(env)[len(KINDS) :]
    ]
    last = obs.Eclipse(norm=env["eclipse_norm"], sampled=True), obs.Time()
    modes = [getattr(act, name)(duration=duration) for name, duration in env["modes"]]
    images = [
        act.Image(n_ahead_image=env["ahead"], max_duration=env["max_duration"], instrument=instrument)
        for instrument in env.get("instruments", (None,))
    ]

    class Imager(sats.ImagingSatellite):
        observation_spec = (obs.SatProperties(*entries("satellite")), *opportunities, *last)
        action_spec = (*modes, *images)
        dyn_type = dyn.GroundStationDynModel
        fsw_type = fsw.SteeringImagerFSWModel if env["steering"] else fsw.ImagingFSWModel

    return Imager


def environment(recording: ImagingRecording, **options: Any) -> SatelliteTasking:
    """An environment whose episodes start where the recorded ones did."""
    env, limits = recording.env, [episode["time_limit"] for episode in recording.initial]
    same = len(set(limits)) == 1
    targets = (rand.per_env(torch.from_numpy(table)) for table in (recording.r_LP_P, recording.priority))
    defaults = dict(
        scenario=scene.Targets(*targets),
        rewarder=data.UniqueImageReward(),
        time_limit=limits[0] if same else rand.per_env(torch.tensor(limits, dtype=torch.float64)),
        **{name: env[name] for name in ("sim_rate", "max_step_duration") if name in env},
    )
    args = arguments(recording)
    if "instruments" in env:
        args["instruments"] = [dyn.Instrument(name, **own) for name, own in env["instruments"].items()]
    satellite = imager(env)("Imager1", sat_args=args, **env["satellite"])
    return SatelliteTasking(satellite, **(common_options(recording) | defaults | options))


def replay(recording: ImagingRecording, env: SatelliteTasking, longest: int | None = None) -> Difference:
    """Play the recorded actions in one batch, and compare images and windows too."""
    return replay_state(recording, env, longest, check=partial(compare, recording, env))


def compare(recording: ImagingRecording, env: SatelliteTasking, k: int, runs: Sequence[int], difference: Difference) -> None:
    """Enter the differences at decision boundary k of the episodes ``runs``."""
    exact, rows = difference.exact, recording.arrays
    buffer = env.satellite.dynamics.partition_levels[:, 0].tolist()
    duplicates = env.rewarder.counts()["duplicates"].tolist()

    def enter(name: str, equal: bool) -> None:
        exact[name] = exact.get(name, True) and equal

    for i in runs:
        imaged = rows["image"][i][:k]
        enter("images", set(torch.nonzero(env.rewarder.imaged[i]).flatten().tolist()) == set(imaged[imaged >= 0].tolist()))
        enter("successes", int(env.satellite.imaged[i]) == rows["imaged"][i][k])
        enter("duplicates", duplicates[i] == rows["duplicates"][i][k])
        enter("buffer", buffer[i] == rows["state"][i][k, BUFFER])
        enter("missed", int(env.satellite.missed[i]) == misses(recording, i)[:k].sum())
        if k:
            enter("retasking", bool(env.requires_retasking[i]) == rows["requires_retasking"][i][k - 1])
        if k in (0, recording.lengths[i]):
            compare_windows(recording, env, i, int(k > 0), difference)


def compare_windows(recording: ImagingRecording, env: SatelliteTasking, i: int, when: int, difference: Difference) -> None:
    """Enter the differences of the windows that have not closed, after reset (``when`` 0) or at the end (1) of episode i."""
    now = float(env.simulator.sim_time[i])
    for kind in recording.windows:
        opens, close, place = (table[i].numpy() for table in env.satellite.opportunities(kind))
        mine, wanted = np.isfinite(close) & (close >= now), recording.windows[kind][i][when]
        ahead = wanted.close >= now
        order = np.array_equal(place[mine], wanted.place[ahead])
        difference.exact[f"{kind} windows"] = difference.exact.get(f"{kind} windows", True) and order
        if order and mine.any():
            errors = np.abs(opens[mine] - wanted.open[ahead]).max(), np.abs(close[mine] - wanted.close[ahead]).max()
            difference.largest["window"] = max(difference.largest.get("window", 0.0), *map(float, errors))


def misses(recording: ImagingRecording, i: int) -> np.ndarray:
    """Steps of episode i in which the window of a chosen target closed without an image, [steps] booleans.

    bsk_rl counts only those that close less than 1e-5 of the present time before the tick that notices, so not its numbers.
    """
    rows = {key: part[i] for key, part in recording.arrays.items()}
    start = rows["state"][:-1, 0]
    tasked = np.nonzero((rows["tasked"] >= 0) & rows["requires_retasking"] & (np.diff(rows["imaged"]) == 0))[0]
    longest, missed = recording.env["max_duration"] or np.inf, np.zeros(len(start), dtype=bool)
    for k in tasked:
        known = recording.windows[kind_of_action(recording.env, rows["action"][k])][i][1]
        closes = known.close[(known.place == rows["tasked"][k]) & (known.close >= start[k])]
        missed[k] = closes.min() - start[k] < longest
    return missed


def kind_of_action(env: dict[str, Any], action: int) -> str:
    """Kind of the windows of an image action."""
    kinds = [f"target@{name}" for name in env.get("instruments", ("",))]
    kind = kinds[(action - len(env["modes"])) // env["ahead"]]
    return kind if kind in env["properties"] else "target"
