"""Recorded episodes of several satellites, and how to replay them as one batch."""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict
from torch import Tensor

from bsk_torch import act, comm, data, obs, rand, sats, scene
from bsk_torch.env import NO_ACTION, ConstellationTasking
from bsk_torch.sim import dyn, fsw
from tests.basilisk.replay import RECORDINGS, STATE_COLUMNS, Difference, split

BOUNDARY = ("obs", "observed", "state", "requires_retasking", "alive", "active", "knows", "known", "everyone", "imaged")
OF_STEPS = ("action", "duration", "present", "reward", "terminated", "truncated", "paid", "image", "access", "links", "evaluated")
BUFFER = 19
"""Column of the state with the data in the images' partition."""


class BroadcastLOSMulti(comm.BroadcastCommunication, comm.LOSMultiCommunication):
    """Who broadcasts is heard by everyone that relays can reach."""


class ImagerDyn(dyn.GroundStationDynModel, dyn.LOSCommDynModel):
    """Images, downlinks and sees other satellites."""


class RelayDyn(dyn.BasicDynamicsModel, dyn.LOSCommDynModel):
    """Sees other satellites; has no instrument and no store."""


class ScannerDyn(dyn.ContinuousImagingDynModel, dyn.GroundStationDynModel):
    """Scans and downlinks."""


ROLES: dict[str, tuple[type[sats.Satellite], type, type]] = {
    "imager": (sats.ImagingSatellite, ImagerDyn, fsw.ImagingFSWModel),
    "relay": (sats.Satellite, RelayDyn, fsw.BasicFSWModel),
    "scanner": (sats.AccessSatellite, ScannerDyn, fsw.ContinuousImagingFSWModel),
}


@dataclass
class ConstellationRecording:
    """Episodes of one file: what they start from, what was done, and what came of it.

    Attributes:
        initial: Epoch, time limit and what each satellite starts with, by episode.
        fixed: Other arguments of each satellite.
        env: Satellites, their kinds, agents, communicator and options.
        lengths: Steps of each episode.
        targets: Positions [m] and priorities of the targets, [E, T, 4].
        arrays: Rows of each episode by name: see the README.
    """

    initial: list[dict[str, Any]]
    fixed: list[dict[str, Any]]
    env: dict[str, Any]
    lengths: list[int]
    targets: np.ndarray
    arrays: dict[str, list[np.ndarray]]

    def __len__(self) -> int:
        return len(self.initial)

    @property
    def names(self) -> list[str]:
        """Of the satellites."""
        return [satellite["name"] for satellite in self.env["satellites"]]

    @property
    def images(self) -> bool:
        """Whether the satellites take images of targets, instead of scanning."""
        return self.targets.shape[1] > 0

    def episode(self, i: int) -> dict[str, np.ndarray]:
        """Rows of episode i by name."""
        return {name: rows[i] for name, rows in self.arrays.items()}


def load(name: str) -> ConstellationRecording:
    """Read a recording, split into episodes."""
    with np.load(RECORDINGS / f"constellation_{name}.npz") as archive:
        file = {key: archive[key] for key in archive.files}
    lengths, arrays = split(file, BOUNDARY, OF_STEPS)
    initial, fixed, env = (json.loads(str(file[key])) for key in ("ic", "fixed", "env"))
    return ConstellationRecording(initial, fixed, env, lengths, file["targets"], arrays)


def satellite_class(recording: ConstellationRecording, name: str) -> type[sats.Satellite]:
    """The satellites of a kind that the recording describes."""
    kind = recording.env["kinds"][name]

    def entries(properties: Sequence[Sequence[Any]]) -> list[dict[str, Any]]:
        return [dict(prop=prop, norm=norm) for prop, norm in properties]

    seen = [
        obs.OpportunityProperties(*entries(recording.env["properties"][what]), type=what, n_ahead_observe=kind[count])
        for what, count in (("target", "targets"), ("ground_station", "stations"))
        if kind[count]
    ]
    eclipse = [obs.Eclipse(norm=recording.env["eclipse_norm"], sampled=True)] if kind["eclipse"] else []
    actions = [getattr(act, mode)(duration=duration) for mode, duration in kind["modes"]]
    actions += [act.Image(n_ahead_image=kind["images"], max_duration=kind["max_duration"])] if kind["images"] else []
    actions += [act.Broadcast(duration=kind["broadcast"])] if kind["broadcast"] else []
    base, dynamics, software = ROLES[kind["role"]]
    observations = (obs.SatProperties(*entries(kind["satellite"])), *seen, *eclipse, obs.Time())
    specs = {"observation_spec": observations, "action_spec": tuple(actions)}
    return type(name.title(), (base,), {**specs, "dyn_type": dynamics, "fsw_type": software})


def arguments(recording: ConstellationRecording, k: int) -> dict[str, Any]:
    """Arguments of satellite k, environment by environment where they differ."""
    each = [episode["satellites"][k] for episode in recording.initial]
    own = {name: rand.per_env(torch.tensor([start[name] for start in each], dtype=torch.float64)) for name in each[0]}
    return {**recording.fixed[k], **own, "oe": None}


def environment(recording: ConstellationRecording, **options: Any) -> ConstellationTasking:
    """An environment whose episodes start where the recorded ones did."""
    env, initial = recording.env, recording.initial
    classes = {name: satellite_class(recording, name) for name in env["kinds"]}
    satellites = [
        classes[one["kind"]](one["name"], sat_args=arguments(recording, k), **one["options"])
        for k, one in enumerate(env["satellites"])
    ]
    communicator, period = env["communicator"]
    method = BroadcastLOSMulti if communicator == "BroadcastLOSMulti" else getattr(comm, communicator)
    table = torch.from_numpy(recording.targets)
    r_LP_P, priority = rand.per_env(table[..., :3]), rand.per_env(table[..., 3])
    scanning = scene.UniformNadirScanning(value_per_second=env["value_per_second"])
    together = {agent: team for agent, team in env["groups"].items() if len(team) > 1}
    agents = {"joint": True} if env["joint"] else {"meta_agent_groupings": together}
    defaults = dict(
        scenario=scene.Targets(r_LP_P, priority) if recording.images else scanning,
        rewarder=data.UniqueImageReward() if recording.images else data.ScanningTimeReward(),
        communicator=method(**period),
        num_envs=len(recording),
        world_args=dict(utc_init=rand.per_env([episode["utc_init"] for episode in initial])),
        time_limit=rand.per_env(torch.tensor([episode["time_limit"] for episode in initial], dtype=torch.float64)),
        only_retask_idle_meta_agent_members=env["idle_only"],
        dtype=torch.float64,
        seed=0,
        compat="bsk_rl",
    )
    return ConstellationTasking(satellites, **(defaults | agents | env["options"] | options))


class Ears:
    """Listens to what an environment keeps to itself: what satellites earn, dead ones included, and who talks to whom.

    Attributes:
        paid: What the rewarder gave in the last step, [N, S].
        links: Who was heard by whom after it, [N, S, S].
    """

    def __init__(self, env: ConstellationTasking) -> None:
        """Put ears on an environment."""
        n, s = env.fleet.num_envs, env.fleet.size
        self.paid, self.links = torch.zeros(n, s), torch.zeros(n, s, s, dtype=torch.bool)
        self.reward, self.communicate = env.rewarder.calculate_reward, env.communicator.communicate
        env.rewarder.calculate_reward, env.communicator.communicate = self.hear_reward, self.hear_links  # type: ignore[method-assign]

    def hear_reward(self, *logs: Any) -> Tensor:
        """In place of ``calculate_reward``."""
        self.paid = self.reward(*logs)
        return self.paid

    def hear_links(self, moves: Tensor) -> Tensor:
        """In place of ``communicate``."""
        self.links = self.communicate(moves) & ~torch.eye(self.links.shape[1], dtype=torch.bool)
        return self.links


def tasks(recording: ConstellationRecording, env: ConstellationTasking, k: int, runs: Sequence[int]) -> TensorDict:
    """The recorded actions of step k for the episodes ``runs``; the others are held."""
    given = torch.full((len(recording), env.fleet.size), NO_ACTION, dtype=torch.int64)
    for i in runs:
        action = torch.from_numpy(recording.arrays["action"][i][k])
        given[i] = torch.where(action < 0, NO_ACTION, action)
    moves = torch.zeros(len(recording), 1, dtype=torch.bool)
    moves[list(runs)] = True
    td = TensorDict({"_step": moves}, [len(recording)])
    for group in env.groups:
        action = given[:, group.members]
        td["action" if env.joint else (group.name, "action")] = action.squeeze(1) if env.joint else action.squeeze(-1)
    return td


def by_satellite(env: ConstellationTasking, td: TensorDict, name: str) -> Tensor:
    """What members of agents see under ``name``, by satellite, [N, S, ...], padded with zeros."""
    parts = {}
    for group in env.groups:
        key = "members_require_retasking" if name == "requires_retasking" and (env.joint or group.is_meta) else name
        whole = td[key].unsqueeze(1) if env.joint else td[group.name, key]
        rows = whole.unflatten(-1, (len(group.types), -1)).flatten(1, 2)
        parts |= dict(zip(group.members.flatten().tolist(), rows.unbind(1), strict=True))
    widest = max(part.shape[-1] for part in parts.values())
    return torch.stack([torch.nn.functional.pad(parts[k], (0, widest - parts[k].shape[-1])) for k in range(env.fleet.size)], 1)


def by_agent(recording: ConstellationRecording, env: ConstellationTasking, td: TensorDict, name: str) -> Tensor:
    """What agents get under ``name``, in the order of the recording, [N, A]."""
    if env.joint:
        return td[name].reshape(len(recording), 1)
    places = {agent: (group.name, k) for group in env.groups for k, agent in enumerate(group.agents)}
    chosen = [places[agent] for agent in recording.env["groups"]]
    return torch.stack([td[group, name].reshape(len(recording), -1)[:, k] for group, k in chosen], 1)


def state_of(env: ConstellationTasking) -> Tensor:
    """The recorded quantities of the present state, [N, S, 20]."""
    fleet = env.fleet

    def column(read: Callable[[Any], Tensor]) -> Tensor:
        table = fleet.each(lambda part: read(part.dynamics)).double()
        return table.reshape(fleet.num_envs, fleet.size, -1)

    readers = [lambda d, name=name: getattr(d, name) for name in ("r_BN_N", "v_BN_N", "sigma_BN", "omega_BN_B", "wheel_speeds")]
    readers += [lambda d, name=name: getattr(d, name) for name in ("battery_charge", "storage_level", "illumination")]
    time = fleet.sim_time.view(-1, 1, 1).expand(-1, fleet.size, 1)
    return torch.cat([time, *map(column, readers)], -1)


class Replay:
    """Plays a recording in an environment and gathers the differences, step by step."""

    def __init__(self, recording: ConstellationRecording, env: ConstellationTasking) -> None:
        """Nothing is played yet."""
        self.recording, self.env, self.ears = recording, env, Ears(env)
        names = (*STATE_COLUMNS, "observation", "reward", "paid", "duration")
        self.found = Difference(dict.fromkeys(names, 0.0), {})
        self.place = {name: k for k, name in enumerate(recording.names)}
        self.teams = [[self.place[name] for name in team] for team in recording.env["groups"].values()]

    def enter(self, name: str, error: Any) -> None:
        """Enter an absolute difference."""
        worst = float(np.max(np.abs(error), initial=0.0))
        if not worst <= self.found.largest[name]:
            self.found.largest[name] = worst

    def equal(self, name: str, mine: Any, wanted: Any) -> None:
        """Enter whether something is equal."""
        self.found.exact[name] = self.found.exact.get(name, True) and bool(np.array_equal(mine, wanted))

    def run(self, longest: int | None = None) -> Difference:
        """Play the recorded actions, at most ``longest`` steps; rows whose episode has ended are held by partial steps."""
        self.boundary(self.env.reset(), 0, range(len(self.recording)))
        for k in range(min(max(self.recording.lengths), longest or 10**9)):
            runs = [i for i, length in enumerate(self.recording.lengths) if k < length]
            self.ears.links.zero_()
            td = self.env.step(tasks(self.recording, self.env, k, runs))["next"]
            self.step(td, k, runs)
            self.boundary(td, k + 1, runs)
        return self.found

    def step(self, td: TensorDict, k: int, runs: Sequence[int]) -> None:
        """Compare step k of the episodes ``runs``."""
        reward = by_agent(self.recording, self.env, td, "reward").numpy()
        for i in runs:
            row = {name: rows[k] for name, rows in self.recording.episode(i).items() if name in OF_STEPS}
            self.enter("reward", reward[i] - row["reward"])
            self.enter("duration", float(td["duration"][i]) - row["duration"])
            self.enter("paid", self.ears.paid[i].numpy() - row["paid"])
            self.equal("links", self.ears.links[i].numpy(), row["links"])
            for flag in ("terminated", "truncated"):
                self.equal(flag, bool(td[flag][i]), bool(row[flag][row["present"]].all()))

    def boundary(self, td: TensorDict, k: int, runs: Sequence[int]) -> None:
        """Compare decision boundary k of the episodes ``runs``."""
        state = state_of(self.env).numpy()
        seen = by_satellite(self.env, td, "observation").numpy()
        asked = by_satellite(self.env, td, "requires_retasking").squeeze(-1).numpy()
        for i in runs:
            row = {name: rows[k] for name, rows in self.recording.episode(i).items() if name in BOUNDARY}
            wanted = row["state"]
            self.equal("end times", np.rint(state[i, :, 0] * 1e9), np.rint(wanted[:, 0] * 1e9))
            self.equal("storage", state[i, :, 17], wanted[:, 17])
            for name, columns in STATE_COLUMNS.items():
                self.enter(name, state[i, :, columns] - wanted[:, columns])
            self.enter("observation", (seen[i] - row["obs"])[row["observed"]])
            self.equal("hidden", seen[i][~row["observed"]], row["obs"][~row["observed"]])
            self.equal("alive", ~self.env.dead[i].numpy(), row["alive"])
            living = np.concatenate([[row["alive"][team].all()] * len(team) for team in self.teams])
            living = living[np.argsort(np.concatenate(self.teams))] | self.env.joint
            self.equal("retasking", asked[i], row["requires_retasking"] & living)
            if not self.env.joint:
                mask = by_agent(self.recording, self.env, td, "mask")[i].numpy()
                self.equal("living agents", mask, np.array([row["alive"][team].all() for team in self.teams]))
            if self.recording.images:
                self.images(i, k, row)

    def images(self, i: int, k: int, row: dict[str, np.ndarray]) -> None:
        """Compare what has been imaged at decision boundary k of episode i, and who knows."""
        env, before = self.env, self.recording.episode(i)
        self.equal("imaged", env.rewarder.imaged[i].numpy(), row["everyone"])
        self.equal("known", env.rewarder.known[i].numpy(), row["knows"])
        buffer = env.fleet.each(lambda part: part.dynamics.partition_levels[:, 0])[i].numpy()
        self.equal("buffer", buffer, row["state"][:, BUFFER])
        counts = {name: count[i].numpy() for name, count in env.counts().items()}
        self.equal("successes", counts["imaged"], row["imaged"])
        again = [(target >= 0) & known[target] for target, known in zip(before["image"][:k], before["everyone"], strict=False)]
        self.equal("duplicates", counts["duplicates"], np.sum(again, 0, dtype=int) + np.zeros(env.fleet.size, dtype=int))


def replay(recording: ConstellationRecording, env: ConstellationTasking, longest: int | None = None) -> Difference:
    """Play the recorded actions in one batch, and compare."""
    return Replay(recording, env).run(longest)
