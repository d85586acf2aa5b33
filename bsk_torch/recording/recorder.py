"""Recorder of flights: satellites at every tick, decisions, resources, events.

A recorder reads the environment between steps and records fields at ticks with :meth:`bsk_torch.env.base.Tasking.record`, which
changes nothing about the episode.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from bsk_torch import __version__
from bsk_torch.act import Image
from bsk_torch.act.base import Action, ActionBuilder
from bsk_torch.env import ConstellationTasking, Tasking
from bsk_torch.env.action_forms import acts, form, read
from bsk_torch.env.rollout import ACTION_VALUE, Policy, decide, play_episodes
from bsk_torch.env.satellite_group import SatelliteGroup
from bsk_torch.recording.recording import Array, Branch, Death, Recording, Scene, Series, Track
from bsk_torch.recording.scenes import (
    NONE,
    QUANTITIES,
    RELATIVE,
    aimed_at,
    causes_of,
    crafts_of,
    is_relative,
    quantities,
    scene_of,
    station_elevation,
    targets_of,
)
from bsk_torch.rl.evaluation.evaluate import LOT, with_lots
from bsk_torch.rl.policies.shared_policy import GroupPolicies, SharedPolicy, as_policy
from bsk_torch.scene.recorded import RecordedProgress
from bsk_torch.wrappers.policies import Actor

__all__ = ["Flight", "Flown", "record"]

KEYFRAME = 60.0
"""Longest time between keyframes of satellites, s; positions in between are off by less than a meter in low orbits."""

OBJECT_KEYFRAME = 240.0
"""Time between keyframes of objects in orbit, s."""

SAMPLE = 10.0
"""Seconds between the values of series."""

FIELDS = {"battery_charge_fraction": "charge", "storage_level_fraction": "storage", "wheel_speeds_fraction": "Omega_WB_B"}
"""Fields of the state that are proportional to the :data:`QUANTITIES` of figures."""

BAD: dict[str, Literal["low", "high"]] = {
    "battery_charge_fraction": "low",
    "storage_level_fraction": "high",
    "wheel_speeds_fraction": "high",
}
"""Which values of a quantity endanger a satellite."""


Change = Callable[[int, TensorDictBase], None]
"""Function of a step's number and tensordict."""

EVENT_COLUMNS = {"event_time": "f8", "event_satellite": "i4", "event_target": "i4", "event_kind": "i4"}
COLUMNS = {"time": "f8", "satellite": "i4", "action": "i4", "target": "i4", "reward": "f8", "task": "i4", "priority": "f8"}
"""Types of the arrays of decisions that hold a number for each."""


@dataclass
class Choice:
    """A decision of a satellite; see the arrays ``decision_...`` of a track."""

    step: int
    slot: int
    time: float
    satellite: int
    task: int
    action: int
    target: int
    priority: float
    reward: float
    mask: list[bool]
    probability: list[float]
    value: list[float]
    control: list[float]
    targets: list[int]
    opens: list[float]
    observation: list[float]


@dataclass(frozen=True, kw_only=True)
class Flown:
    """A recorded flight and what repeats it.

    Attributes:
        track: The flight.
        seed: Seed of its episode.
        actions: Actions of all agents in each step.
        choices: The decisions, in the order of the track.
    """

    track: Track
    seed: int
    actions: list[TensorDictBase]
    choices: list[Choice]


@dataclass
class _Noted:
    """What a recorder has noted at the boundaries of steps."""

    times: list[float] = field(default_factory=list)
    sun_N: list[Tensor] = field(default_factory=list)
    rewards: list[Tensor] = field(default_factory=list)
    r_P: list[Tensor] = field(default_factory=list)
    quantities: list[dict[str, Tensor]] = field(default_factory=list)
    marks: dict[str, Tensor] = field(default_factory=dict)
    links: list[Tensor] = field(default_factory=list)
    events: list[tuple[float, int, int, int]] = field(default_factory=list)
    deaths: list[Death] = field(default_factory=list)
    objects: list[tuple[float, Tensor, Tensor]] = field(default_factory=list)


class Flight:
    """Records episode 0 of an environment, once, without changing the episode."""

    def __init__(self, env: Tasking, policy: Actor) -> None:
        """Record ``env`` under ``policy``; see :func:`~bsk_torch.rl.policies.as_policy`.

        ValueError for a constellation with one agent for all satellites.
        """
        self.env, self.slots, self.policy = env, _slots(env), as_policy(policy, env)
        self.noted, self.choices, self.actions = _Noted(), list[Choice](), list[TensorDictBase]()
        self.latest: dict[int, Choice] = {}
        self.offers: dict[int, tuple[list[int], list[float]]] = {}
        self.types = {column: satellite for satellite in env.satellites for column in satellite.simulator.columns}

    def fly(
        self,
        seed: int,
        until: float | None = None,
        past: list[TensorDictBase] | None = None,
        change: Change | None = None,
    ) -> Flown:
        """Play the first episode of ``seed`` with the most probable actions.

        Args:
            seed: The seed.
            until: Time after which no step begins, s; None for the end of the episode.
            past: Actions of the first steps, instead of the policy's.
            change: May change the actions of a step.
        """
        env = self.env
        env.set_seed(seed)
        start = env.reset()
        self.targets = targets_of(env)
        self.scene = scene_of(env, seed, self.targets)
        self.highest = self.targets.priority
        self._look()
        fields = dict.fromkeys(name for part in env.satellites for name in part.simulator.state.layout.fields)
        names = ["r_BN_N", "v_BN_N", "sigma_BN", RELATIVE, "rho_dot_H", "illumination", "station_access", *FIELDS.values()]
        playing = torch.arange(env.batch_size[0], device=env.device) == 0
        with env.record([name for name in names if name in fields], rows=0) as recording:
            for _, step in play_episodes(env, self._player(with_lots(self.policy, env), past or [], change), start, playing):
                self._note(step)
                if until is not None and self.noted.times[-1] >= until:
                    break
        return Flown(track=self._track(recording.of(0)), seed=seed, actions=self.actions, choices=self.choices)

    def _player(self, policy: Policy, past: list[TensorDictBase], change: Change | None) -> Policy:
        env = self.env
        keys: list[object] = [(g.name, "action") for g in env.groups] if isinstance(env, ConstellationTasking) else ["action"]

        def act(tensordict: TensorDictBase) -> TensorDictBase:
            number = len(self.actions)
            self._note_offers()
            decided = policy(tensordict)
            if number < len(past):
                decided.update(past[number])
            if change is not None:
                change(number, decided)
            self.actions.append(decided.select(*keys).clone())
            return decided

        return act

    def _note_offers(self) -> None:
        """Note the targets that the actions of the satellites choose at the coming decision."""
        for group in self.env.satellites:
            if isinstance(group.actions, ActionBuilder):
                targets, opens = (part.tolist() for part in group.actions.offers())
                self.offers |= {column: (targets[row], opens[row]) for row, column in enumerate(group.simulator.columns)}

    # -- between steps ------------------------------------------------------------------------------------------------

    def _look(self) -> None:
        env, noted = self.env, self.noted
        noted.times.append(float(env.fleet.sim_time[0]))
        noted.sun_N.append(_sun(env))
        noted.quantities.append(quantities(env.fleet))
        if not is_relative(env):
            noted.r_P.append(env.fleet.each(lambda part: part.dynamics.r_BN_P)[0].cpu())
        began = len(noted.times) == 1
        links = env.links
        none = torch.zeros(env.fleet.size, env.fleet.size, dtype=torch.bool)
        noted.links.append(none if links is None or began else links[0].cpu())
        self.removed, self.dead = env.fleet.state.removed[0].cpu().clone(), env.dead[0].reshape(-1).cpu().clone()
        self.counted = {name: count[0].cpu().clone() for name, count in env.counts().items()}
        self.progress = env.rewarder.recorded(0)
        for name, mark in self.progress.marks.items():
            at = noted.marks.setdefault(name, torch.full(mark.shape, math.inf, dtype=torch.float64))
            noted.marks[name] = torch.where(mark, at.clamp(max=noted.times[-1]), at)
        self.priority = env.scenario.priority[0].cpu() if hasattr(env.scenario, "priority") else self.targets.priority
        self.highest = torch.maximum(self.highest, self.priority)
        if self.targets.v_N is not None and (began or noted.times[-1] - noted.objects[-1][0] >= OBJECT_KEYFRAME):
            now = targets_of(env)
            assert now.v_N is not None
            noted.objects.append((noted.times[-1], now.r.float(), now.v_N.float()))

    def _note(self, step: TensorDictBase) -> None:
        env, noted = self.env, self.noted
        begin = noted.times[-1]
        counted, progress, dead, removed = self.counted, self.progress, self.dead, self.removed
        rewards = torch.full((env.fleet.size,), torch.nan, dtype=torch.float64)
        for slot, (at, number, member, satellite) in enumerate(self.slots):
            group = self.types[satellite]
            entries = step if at is None else step[at]
            part = _entries(entries, at, number, member)
            if not bool(removed[satellite]) and _decides(group, part["action"]):
                if at is not None and member is None and ACTION_VALUE in step.keys():  # noqa: SIM118  - of all agents
                    part[ACTION_VALUE] = step[ACTION_VALUE][0, slot]
                self.latest[satellite] = self._choice(slot, part, group, satellite, begin)
                self.choices.append(self.latest[satellite])
            if not member:  # the reward of an agent is that of its first satellite
                rewards[satellite] = (step["next"] if at is None else step["next", at])["reward"][0].flatten()[number]
                if satellite in self.latest:
                    self.latest[satellite].reward += float(rewards[satellite])
        noted.rewards.append(rewards)
        self._look()
        self._note_events(counted, progress)
        causes = causes_of(env, 0)
        for k in torch.nonzero(self.dead & ~dead).flatten().tolist():
            noted.deaths.append(Death(satellite=k, time=noted.times[-1], causes=[c for c in causes[k].split(", ") if c]))

    def _choice(self, slot: int, part: TensorDictBase, group: SatelliteGroup, satellite: int, begin: float) -> Choice:
        action, mask, control, task = NONE, list[bool](), list[float](), 0
        if form(group) is not None:
            control = read("action", part["action"].unsqueeze(0), group, (1,))[0].double().tolist()
        else:
            number = int(part["action"])
            action = number if 0 <= number < len(group.action_description) else NONE  # none for any object of a catalog
            mask = part["action_mask"][: group.actions.n_actions].tolist() if "action_mask" in part else []
            task = group.actions.entry_of(number)
        entry = group.actions.entries[task]
        aims = entry.aimed_at() if isinstance(entry, Action) else None
        target = NONE if aims is None else int(aims[list(group.simulator.columns).index(satellite)])
        probability, value = _opinion(self.policy, part, self.slots[slot][0]) if mask else ([], [])
        return Choice(
            step=len(self.actions) - 1,
            slot=slot,
            time=begin,
            satellite=satellite,
            task=task,
            action=action,
            target=target,
            priority=float(self.priority[target]) if target >= 0 else math.nan,
            reward=0.0,
            mask=mask,
            probability=probability,
            value=value,
            control=control,
            targets=self.offers[satellite][0] if satellite in self.offers else [],
            opens=self.offers[satellite][1] if satellite in self.offers else [],
            observation=_flat(part["observation"]) if "observation" in part else [],
        )

    def _note_events(self, counted: Mapping[str, Tensor], before: RecordedProgress) -> None:
        env, now, events = self.env, self.noted.times[-1], self.noted.events
        if "done" in before.marks:
            for target in torch.nonzero(self.progress.marks["done"] & ~before.marks["done"]).flatten().tolist():
                events.append((now, self._who(target), target, 0))
        elif before.images is not None and self.progress.images is not None:
            events += [(now, *image[:2], 2) for image in set(before.images) - set(self.progress.images)]
            events += [(image[2], *image[:2], 0) for image in set(self.progress.images) - set(before.images)]
        elif "imaged" in counted:
            target = env.fleet.each(aimed_at)[0].cpu()
            images = self.counted["imaged"] - counted["imaged"]
            again = self.counted.get("duplicates", images) - counted.get("duplicates", images)
            for k in torch.nonzero((images > 0) & (target >= 0)).flatten().tolist():
                events.append((now, k, int(target[k]), int(again[k] > 0)))

    def _who(self, target: int) -> int:
        """The satellite that has seen a target in the last step: the one that was sent to it, or the nearest inspector."""
        for choice in reversed(self.choices):
            if choice.target == target:
                return choice.satellite
        if self.targets.owner is None:
            return 0
        place = self.env.fleet.each(lambda part: part.dynamics.r_BN_N)[0]
        viewers = list(self.targets.viewers)
        return viewers[int((place[viewers] - place[self.targets.owner]).norm(dim=-1).argmin())]

    # -- the whole flight ---------------------------------------------------------------------------------------------

    def _track(self, ticks: TensorDictBase) -> Track:
        env, noted = self.env, self.noted
        size = env.fleet.size
        time = ticks["time"].cpu().numpy()
        data = {name: _by_satellite(ticks[name], size) for name in ticks.keys() if name not in ("env", "episode", "tick", "time")}  # noqa: SIM118
        boundaries = np.array(noted.times)
        relative = is_relative(env)
        step, burns = float(env.fleet.h), any(simulator.has_tank for simulator in env.fleet.simulators)
        jumps = np.concatenate([boundaries, boundaries + step]) if burns else boundaries  # velocities before and after burns
        keys = _keyframes(time, jumps if relative or burns else boundaries[[0, -1]])
        r_N, v_N = (data[name][keys] for name in ((RELATIVE, "rho_dot_H") if relative else ("r_BN_N", "v_BN_N")))
        sigma = data["sigma_BN"]
        if relative:  # the chief, at the origin
            r_N, v_N, sigma = (np.concatenate([part, np.zeros_like(part[:, :1])], 1) for part in (r_N, v_N, sigma))
        close = relative or self.targets.places == "points"
        sun = torch.stack(noted.sun_N).cpu().double().numpy()
        sun_N = np.stack([np.interp(time[keys], boundaries, sun[:, axis]) for axis in range(3)], -1)
        crafts = crafts_of(env)
        series, values_time, values = self._series(time, data, len(crafts))
        arrays: dict[str, Array] = {
            "key_times": time[keys],
            "r_N": r_N if close else r_N.astype("f4"),
            "v_N": v_N if close else v_N.astype("f4"),
            "sun_N": sun_N / np.linalg.norm(sun_N, axis=-1, keepdims=True),
            "sigma": sigma,
            "series_times": values_time,
            "series": values,
            **self._decision_arrays(max((len(c.actions) for c in crafts), default=0), max(len(c.observation) for c in crafts)),
            **_sorted_columns(noted.events, EVENT_COLUMNS),
            **_link_arrays(boundaries, torch.stack(noted.links)),
            **_interval_arrays("passes", time, data.get("station_access")),
            **_interval_arrays("eclipses", time, 1.0 - data["illumination"] if "illumination" in data else None),
        }
        names, steps = self._steps(len(crafts))
        arrays |= steps
        if noted.marks:
            arrays["mark_time"] = torch.stack(list(noted.marks.values()), -1).numpy()
        if noted.objects:
            times, places, speeds = zip(*noted.objects, strict=True)
            arrays |= {"object_times": np.array(times)}
            arrays |= {"object_r_N": torch.stack(places).cpu().numpy(), "object_v_N": torch.stack(speeds).cpu().numpy()}
        if not torch.equal(self.highest, self.targets.priority):
            self.scene.arrays["highest_priority"] = self.highest.numpy()
        limit = float(env.time_limit[0])
        return Track(
            label=f"seed {self.scene.seed}",
            scene=0,
            total=float(env.returns[0]),
            duration=noted.times[-1],
            limit=limit if math.isfinite(limit) else None,
            deaths=noted.deaths,
            series=series,
            counts={name: int(count[0].sum()) for name, count in env.counts().items()},
            attitude_start=float(time[0]),
            attitude_step=step,
            quantities=names,
            marks=list(noted.marks),
            completed=self.progress.completed,
            arrays=arrays,
        )

    def _steps(self, size: int) -> tuple[list[str], dict[str, Array]]:
        """Names of the quantities at the boundaries of steps, and the arrays ``step_...``."""
        noted, names, values = self.noted, list[str](), list[Tensor]()
        for name in noted.quantities[0]:
            values.append(torch.stack([now[name] for now in noted.quantities]))
            width = values[-1].shape[-1]
            names += [name] if width == 1 else [f"{name}_{k}" for k in range(width)]
        rewards = torch.stack([*noted.rewards, torch.full((self.env.fleet.size,), torch.nan, dtype=torch.float64)])
        tables = {"step_reward": rewards, "step_values": torch.cat([rewards.unsqueeze(-1)[..., :0], *values], -1)}
        tables |= {"step_r_P": torch.stack(noted.r_P)} if noted.r_P else {}
        arrays = {"step_time": np.array(noted.times)}
        for name, table in tables.items():  # the chief has none
            chief = table.new_full((len(table), size - table.shape[1], *table.shape[2:]), torch.nan)
            arrays[name] = torch.cat([table, chief], 1).numpy()
        return names, arrays

    def _series(self, time: Array, data: Mapping[str, Array], size: int) -> tuple[list[Series], Array, Array]:
        """Names, times [J] and values [J, S, n] of the quantities over time."""
        noted = self.noted
        boundaries = np.array(noted.times)
        chosen = np.arange(0, len(time), max(1, round(SAMPLE / float(self.env.fleet.h))))
        if len(boundaries) < len(chosen):
            chosen = np.union1d(chosen, np.searchsorted(time, boundaries).clip(max=len(time) - 1))
        chosen = np.union1d(chosen, [len(time) - 1])
        series, columns = list[Series](), list[Array]()
        for name, title in QUANTITIES.items():
            if FIELDS[name] in data and name in noted.quantities[0]:
                fraction = np.stack([np.abs(now[name].numpy()).max(-1) for now in noted.quantities])  # [B, S]
                series.append(Series(name=name, label=title, bad=BAD[name]))
                columns.append(_scaled(time, chosen, data[FIELDS[name]], boundaries, fraction))
        if "illumination" in data:
            series.append(Series(name="sunlit", label="sunlit"))
            columns.append(data["illumination"][chosen])
        earned = np.zeros((len(chosen), self.env.fleet.size))
        for choice, end in zip(self.choices, self._ends(), strict=True):
            earned[int(np.searchsorted(time[chosen], end)) :, choice.satellite] += choice.reward
        series.append(Series(name="reward", label="reward so far"))
        columns.append(earned)
        values = np.stack(columns, -1)
        missing = size - values.shape[1]
        return series, time[chosen], np.pad(values, ((0, 0), (0, missing), (0, 0)), constant_values=np.nan)

    def _ends(self) -> Array:
        """Times at which decisions are followed by others of the same satellites, or the flight ends, [D]."""
        ends, following = np.zeros(len(self.choices)), dict[int, float]()
        for k in range(len(self.choices) - 1, -1, -1):
            ends[k] = following.get(self.choices[k].satellite, self.noted.times[-1])
            following[self.choices[k].satellite] = self.choices[k].time
        return ends

    def _decision_arrays(self, actions: int, observed: int) -> dict[str, Array]:
        choices = self.choices
        masks = np.zeros((len(choices), actions), "u1")
        for row, choice in zip(masks, choices, strict=True):
            row[: len(choice.mask)] = choice.mask
        offered = _padded([choice.targets for choice in choices], actions, -1.0)
        offers = {"action_target": offered, "action_opens": _padded([choice.opens for choice in choices], actions)}
        controls = max((len(choice.control) for choice in choices), default=0)
        return {
            **{
                f"decision_{name}": np.array([getattr(choice, name) for choice in choices], kind)
                for name, kind in COLUMNS.items()
            },
            "decision_end": self._ends(),
            "decision_mask": masks,
            "decision_probability": _padded([choice.probability for choice in choices], actions),
            "decision_action_value": _padded([choice.value for choice in choices], actions),
            "observation": _padded([choice.observation for choice in choices], observed),
            **({"decision_control": _padded([choice.control for choice in choices], controls)} if controls else {}),
            **({f"decision_{name}": values for name, values in offers.items()} if (offered >= 0).any() else {}),
        }


def record(
    env: Tasking,
    policy: Actor,
    *,
    seed: int = 0,
    until: float | None = None,
    title: str = "",
    preset: str = "",
    label: str = "policy",
) -> Recording:
    """Play the first episode of ``seed`` in row 0 of an environment with the most probable actions, and return its recording.

    Args:
        env: The environment, with one satellite or several.
        policy: Acts for all satellites, such as ``shared(pretrained(...), env)``; see :func:`~bsk_torch.rl.policies.as_policy`.
        seed: Seed of the episode.
        until: Time after which no step begins, s; None for the end of the episode.
        title: Headline (default: the preset, policy and seed).
        preset: Name of the environment.
        label: What the policy is called.

    Raises:
        ValueError: For a constellation with one agent for all satellites.
    """
    flight = Flight(env, policy)
    flown = flight.fly(seed, until)
    return recording_of(
        env, [flight.scene], [flown.track], title or f"{preset or 'An episode'}, {label}, seed {seed}", preset, label
    )


def recording_of(env: Tasking, scenes: list[Scene], tracks: list[Track], title: str, preset: str, label: str) -> Recording:
    """Return a recording of tracks in their scenes; other arguments are those of :func:`record`."""
    return Recording(
        title=title,
        preset=preset,
        policy=label,
        package=__version__,
        places=targets_of(env).places,
        station_min_elevation=station_elevation(env),
        satellites=crafts_of(env),
        scenes=scenes,
        tracks=tracks,
        kind=_kind(env),
    )


def _kind(env: Tasking) -> str:
    """What the figure of an episode shows; see :data:`bsk_torch.viz.episodes.KINDS`."""
    if isinstance(env, ConstellationTasking):
        return env.rewarder.recorded(0).kind or "constellation"
    images = any(isinstance(entry, Image) for entry in env.satellites[0].actions.entries)
    return env.rewarder.recorded(0).track_kind or ("ground_track" if images else "timeline")


def branched(flown: Flown, decision: int, action: int | None, parent: int) -> Branch:
    """Return the branch of a flight at one of its decisions, with its own action for None.

    IndexError for other decisions, ValueError for illegal actions and for decisions of real numbers.
    """
    if not 0 <= decision < len(flown.choices):
        raise IndexError(f"decision={decision} must lie from 0 to {len(flown.choices) - 1}, the decisions of track {parent}")
    choice = flown.choices[decision]
    if not choice.mask:
        raise ValueError(f"decision {decision} is made of real numbers, or for several satellites; none can be exchanged")
    action = choice.action if action is None else action
    if not (0 <= action < len(choice.mask) and choice.mask[action]):
        legal = [k for k, allowed in enumerate(choice.mask) if allowed]
        raise ValueError(f"action={action} is not legal at decision {decision}; legal are {legal!s:.200}")
    return Branch(time=choice.time, decision=decision, satellite=choice.satellite, action=action)


def _slots(env: Tasking) -> list[tuple[str | None, int, int | None, int]]:
    """Group, number within it, number among the satellites of an agent of several, and satellite of each decision.

    ValueError for one agent of all satellites.
    """
    if not isinstance(env, ConstellationTasking):
        return [(None, 0, None, 0)]
    if env.joint:
        raise ValueError("env has joint=True; a constellation is recorded agent by agent, so build it without")
    return [
        (group.name, number, member if group.is_meta else None, column)
        for group in env.groups
        for number, columns in enumerate(group.members.tolist())
        for member, column in enumerate(columns)
    ]


def _decides(group: SatelliteGroup, action: Tensor) -> bool:
    """Whether an action of a satellite begins something, instead of continuing."""
    return bool(acts(read("action", action.unsqueeze(0), group, (1,)), group, True)[0])


def _entries(entries: TensorDictBase, at: str | None, number: int, member: int | None) -> TensorDictBase:
    """What an agent of episode 0 has observed and done; of an agent of several satellites, what it has told one of them."""
    if member is not None:
        return TensorDict({"action": entries["action"][0, number, member]})
    names = [name for name in ("observation", "action", "action_mask", "logits", ACTION_VALUE) if name in entries.keys()]  # noqa: SIM118
    chosen = entries.select(*names)
    return chosen[0] if at is None else chosen[0, number]


def _opinion(policy: TensorDictModuleBase, part: TensorDictBase, group: str | None) -> tuple[list[float], list[float]]:
    """What a policy has computed for a decision: probabilities and values of the actions, [A]; empty for policies without them.

    Policies write ``logits`` or ``action_value``. Those of one satellite that act for each of a constellation are asked again.
    """
    outputs = {"logits", ACTION_VALUE}
    if group is not None and isinstance(policy, SharedPolicy | GroupPolicies) and not outputs & set(part.keys()):
        single = policy.policies[group] if isinstance(policy, GroupPolicies) else policy.policy
        situation = part.select("observation", "action_mask").unsqueeze(0)
        situation["action_mask"] = situation["action_mask"][..., :-1]
        part = part if LOT in single.in_keys else decide(single, situation)[0]
    logits, values = part.get("logits", None), part.get(ACTION_VALUE, None)
    chances, worths = list[float](), list[float]()
    if logits is not None:
        chances = torch.where(part["action_mask"][: logits.shape[-1]], logits.double(), -torch.inf).softmax(-1).tolist()
    if values is not None:
        values = values.double().reshape(-1)[: part["action_mask"].shape[-1]]  # planners write those of the one agent as [1, A]
        rated = part["action_mask"][: len(values)] & torch.isfinite(values)
        worths = torch.where(rated, values, torch.nan).tolist()
    return chances, worths


def _sun(env: Tasking) -> Tensor:
    """Direction to the Sun in episode 0, [3]."""
    dynamics = env.satellites[0].dynamics
    if is_relative(env) and hasattr(type(dynamics), "sun_hat_H"):
        return dynamics.sun_hat_H[0].clone()
    return env.fleet.simulators[0].world.sun_direction_N[0].clone()


def _by_satellite(values: Tensor, size: int) -> Array:
    """Recorded values as [M, S, ...]; the width 1 is left out."""
    array = values.cpu().double().numpy()
    return array[:, None] if size == 1 else array


def _keyframes(time: Array, boundaries: Array) -> Array:
    """Indices of ticks that are keyframes: at ``boundaries``, and at most :data:`KEYFRAME` apart."""
    at = np.unique(np.searchsorted(time, boundaries).clip(max=len(time) - 1))
    stride = int(KEYFRAME / (time[1] - time[0])) if len(time) > 1 else 1
    between = [np.arange(a, b, max(1, stride)) for a, b in itertools.pairwise(at)]
    return np.unique(np.concatenate([at, *between]))


def _scaled(time: Array, chosen: Array, values: Array, boundaries: Array, fraction: Array) -> Array:
    """A field as a fraction, [J, S], by its ratio to the known fractions at the boundaries of steps."""
    field_of = np.abs(values.reshape(*values.shape[:2], -1)).max(-1)  # [M, S]
    at = np.searchsorted(time, boundaries).clip(max=len(time) - 1)
    with np.errstate(divide="ignore", invalid="ignore"):
        scale = fraction / field_of[at]
    fractions = np.empty((len(chosen), field_of.shape[1]))
    for k in range(field_of.shape[1]):
        good = np.isfinite(scale[:, k])
        of_time = np.interp(time[chosen], boundaries[good], scale[good, k]) if good.any() else np.zeros(len(chosen))
        fractions[:, k] = np.where(np.isfinite(field_of[chosen, k]), field_of[chosen, k] * of_time, np.nan)
    return fractions


def _sorted_columns(rows: Sequence[tuple[float, ...]], kinds: dict[str, str]) -> dict[str, Array]:
    """Rows in their order as arrays by name, of the types ``kinds``."""
    columns: list[object] = list(zip(*sorted(rows), strict=True)) or [()] * len(kinds)
    return {name: np.array(column, kind) for (name, kind), column in zip(kinds.items(), columns, strict=True)}


def _link_arrays(boundaries: Array, links: Tensor) -> dict[str, Array]:
    """Links between satellites, from the boundary at which they are in force until the first one at which they are not."""
    either = (links | links.mT).numpy()
    rows = []
    for a, b in zip(*np.nonzero(np.triu(either.any(0), 1)), strict=True):
        for start, end in _spans(boundaries, either[:, a, b]):
            rows.append((start, end, a, b))
    return _sorted_columns(rows, {"link_start": "f8", "link_end": "f8", "link_a": "i4", "link_b": "i4"})


def _interval_arrays(name: str, time: Array, values: Array | None) -> dict[str, Array]:
    """Intervals, by satellite, in which a recorded value [M, S] is more than a half."""
    intervals = []
    for k in range(0 if values is None else values.shape[1]):
        assert values is not None
        intervals += [
            (start, end, k) for start, end in _spans(time, np.nan_to_num(values[:, k].reshape(len(time), -1).max(-1)) > 0.5)
        ]
    rows = np.array(sorted(intervals), "f8").reshape(-1, 3)
    return {name: rows[:, :2], f"{name}_satellite": rows[:, 2].astype("i4")}


def _spans(times: Array, holds: Array) -> list[tuple[float, float]]:
    """Intervals from a time at which something holds until the first one at which it does not."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], holds.astype(np.int8), [0]])))
    last = len(times) - 1
    return [(float(times[a]), float(times[min(b, last)])) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def _flat(observed: Tensor | TensorDictBase) -> list[float]:
    """Numbers of an observation, in the order of their names."""
    if isinstance(observed, Tensor):
        return list(observed.double().flatten().tolist())
    return [number for value in observed.values() for number in _flat(value)]


def _padded(rows: Sequence[Sequence[float]], width: int, missing: float = np.nan) -> Array:
    table = np.full((len(rows), max([width, *map(len, rows)])), missing)
    for row, values in zip(table, rows, strict=True):
        row[: len(values)] = values
    return table
