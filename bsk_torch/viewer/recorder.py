"""Recorder of flights for the viewer: satellites at every tick, decisions, resources, events.

A recorder reads the environment between steps and records fields at ticks with :meth:`bsk_torch.env.base.Tasking.record`, which
changes nothing about the episode.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from bsk_torch import __version__
from bsk_torch.act import Image
from bsk_torch.env import NO_ACTION, ConstellationTasking, Tasking
from bsk_torch.env.action_forms import acts, form, read
from bsk_torch.env.rollout import ACTION_VALUE, Policy, decide, play_episodes
from bsk_torch.env.satellite_group import SatelliteGroup
from bsk_torch.rl.evaluation.evaluate import LOT, with_lots
from bsk_torch.rl.policies.shared_policy import GroupPolicies, SharedPolicy, as_policy
from bsk_torch.tasks.aeos_bench import AEOSBench, PointAtTask
from bsk_torch.tasks.aeos_bench.act import ASSIGNED
from bsk_torch.tasks.inspection import RSOPoints
from bsk_torch.tasks.objects import ImageRSO, RSOTargets
from bsk_torch.tasks.objects.aim import AIM
from bsk_torch.viewer.recording import Array, Branch, Death, Recording, Scene, Series, Track
from bsk_torch.viewer.scenes import RELATIVE, crafts_of, inspected_of, is_relative, places_of, scene_of, station_elevation
from bsk_torch.viz.recorders.constellation import quantities
from bsk_torch.viz.recorders.episode import QUANTITIES, first_row
from bsk_torch.viz.recorders.rso_imaging import images_on_board
from bsk_torch.viz.recorders.rso_imaging import rewarder_of as imaging_of
from bsk_torch.viz.render.moment import causes_of
from bsk_torch.wrappers.policies import Actor

__all__ = ["Flight", "Flown", "record"]

KEYFRAME = 60.0
"""Longest time between keyframes of satellites, s; positions in between are off by less than a meter in low orbits."""

OBJECT_KEYFRAME = 240.0
"""Time between keyframes of objects in orbit, s."""

SAMPLE = 10.0
"""Seconds between the values of series."""

BITS = 12
"""Binary digits of series, probabilities and observations, 0.02 % of the number."""

NONE = -1
"""Action or target of a decision without one."""

FIELDS = {"battery_charge_fraction": "charge", "storage_level_fraction": "storage", "wheel_speeds_fraction": "Omega_WB_B"}
"""Fields of the state that are proportional to the :data:`QUANTITIES` of figures."""

BAD: dict[str, Literal["low", "high"]] = {
    "battery_charge_fraction": "low",
    "storage_level_fraction": "high",
    "wheel_speeds_fraction": "high",
}
"""Which values of a quantity endanger a satellite."""


@dataclass
class Choice:
    """A decision of a satellite; see the arrays ``decision_...`` of a track."""

    step: int
    slot: int
    time: float
    satellite: int
    action: int
    target: int
    reward: float
    mask: list[bool]
    probability: list[float]
    value: list[float]
    control: list[float]
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
    returns: list[float] = field(default_factory=list)
    quantities: list[dict[str, Tensor]] = field(default_factory=list)
    links: list[Tensor] = field(default_factory=list)
    events: list[tuple[float, int, int, int]] = field(default_factory=list)
    deaths: list[Death] = field(default_factory=list)
    objects: list[tuple[float, Tensor, Tensor]] = field(default_factory=list)


class Flight:
    """Records episode 0 of an environment for the viewer, once, without changing the episode."""

    def __init__(self, env: Tasking, policy: Actor) -> None:
        """Record ``env`` under ``policy``; see :func:`~bsk_torch.rl.policies.as_policy`.

        Raises:
            ValueError: If satellites of a constellation are not separate agents.
        """
        self.env, self.policy, self.slots = env, as_policy(policy, env), _slots(env)
        self.noted, self.choices, self.actions = _Noted(), list[Choice](), list[TensorDictBase]()
        self.latest: dict[int, Choice] = {}
        self.types = {column: satellite for satellite in env.satellites for column in satellite.simulator.columns}

    def fly(
        self,
        seed: int,
        until: float | None = None,
        past: list[TensorDictBase] | None = None,
        change: Callable[[int, TensorDictBase], None] | None = None,
    ) -> Flown:
        """Play the first episode of ``seed`` with the most probable actions.

        Args:
            seed: The seed.
            until: Time after which no step begins, s; None for the end of the episode.
            past: Actions of the first steps, instead of the policy's.
            change: Function of a step's number and tensordict, which may change its actions.
        """
        env = self.env
        env.set_seed(seed)
        start = env.reset()
        player: Policy = with_lots(self.policy, env) if LOT in self.policy.in_keys else self.policy
        self.scene = scene_of(env, seed)
        self._look()
        known = dict.fromkeys(name for part in env.satellites for name in part.simulator.state.layout.fields)
        wanted = ["r_BN_N", "v_BN_N", "sigma_BN", RELATIVE, "rho_dot_H", "illumination", "station_access", *FIELDS.values()]
        with env.record([name for name in wanted if name in known], rows=0) as recording:
            for _, step in play_episodes(env, self._player(player, past or [], change), start, first_row(env)):
                self._note(step)
                if until is not None and self.noted.times[-1] >= until:
                    break
        return Flown(track=self._track(recording.of(0)), seed=seed, actions=self.actions, choices=self.choices)

    def _player(self, policy: Policy, past: list[TensorDictBase], change: Any) -> Policy:
        """The policy, with the actions of the past and the change."""

        def act(tensordict: TensorDictBase) -> TensorDictBase:
            number = len(self.actions)
            decided = policy(tensordict)
            if number < len(past):
                decided.update(past[number])
            if change is not None:
                change(number, decided)
            self.actions.append(decided.select(*_action_keys(self.env)).clone())
            return decided

        return act

    # -- between steps ------------------------------------------------------------------------------------------------

    def _look(self) -> None:
        """Note the state at a boundary of steps."""
        env, noted = self.env, self.noted
        noted.times.append(float(env.fleet.sim_time[0]))
        noted.sun_N.append(_sun(env))
        noted.returns.append(float(env.returns[0]))
        noted.quantities.append(quantities(env.fleet))
        began = len(noted.times) == 1
        links = env.links
        none = torch.zeros(env.fleet.size, env.fleet.size, dtype=torch.bool)
        noted.links.append(none if links is None or began else links[0].cpu())
        self.removed, self.dead = env.fleet.state.removed[0].cpu().clone(), env.dead[0].reshape(-1).cpu().clone()
        self.counted = {name: count[0].cpu().clone() for name, count in env.counts().items()}
        self.seen = _seen(env)
        self.on_board = _on_board(env)
        if isinstance(env.scenario, RSOTargets) and (
            not noted.objects or noted.times[-1] - noted.objects[-1][0] >= OBJECT_KEYFRAME
        ):
            noted.objects.append((noted.times[-1], *_object_states(env.scenario)))

    def _note(self, step: TensorDictBase) -> None:
        """Note a step that has been taken."""
        env, noted = self.env, self.noted
        begin = noted.times[-1]
        counted, seen, on_board, dead = self.counted, self.seen, self.on_board, self.dead
        removed = self.removed
        for slot, (at, number, satellite) in enumerate(self.slots):
            group = self.types[satellite]
            found = step if at is None else step[at]
            action = found["action"][0] if at is None else found["action"][0, number]
            if not bool(removed[satellite]) and _decides(group, action):
                part = _entries(found, at, number)
                if at is not None and ACTION_VALUE in step.keys():  # noqa: SIM118  - of all agents
                    part[ACTION_VALUE] = step[ACTION_VALUE][0, slot]
                self.latest[satellite] = self._choice(slot, part, group, satellite, begin)
                self.choices.append(self.latest[satellite])
            rewards = (step["next"] if at is None else step["next", at])["reward"][0].flatten()
            if satellite in self.latest:
                self.latest[satellite].reward += float(rewards[number])
        self._look()
        self._note_events(counted, seen, on_board)
        causes = causes_of(env, 0)
        for k in torch.nonzero(self.dead & ~dead).flatten().tolist():
            noted.deaths.append(Death(satellite=k, time=noted.times[-1], causes=[c for c in causes[k].split(", ") if c]))

    def _choice(self, slot: int, part: TensorDictBase, group: SatelliteGroup, satellite: int, begin: float) -> Choice:
        """The decision of an agent in a step."""
        action, mask, control = NONE, list[bool](), list[float]()
        if form(group) is not None:
            control = part["action"].double().tolist()
            entry = group.actions.entries[0]
        else:
            number = int(part["action"])
            action = number if 0 <= number < len(group.action_description) else NONE  # none for any object of a catalog
            mask = part["action_mask"][: group.actions.n_actions].tolist()
            entry = group.actions.entries[group.actions.entry_of(number)]
        probability, value = _opinion(self.policy, part, self.slots[slot][0]) if mask else ([], [])
        return Choice(
            step=len(self.actions) - 1,
            slot=slot,
            time=begin,
            satellite=satellite,
            action=action,
            target=self._target(entry, satellite),
            reward=0.0,
            mask=mask,
            probability=probability,
            value=value,
            control=control,
            observation=_flat(part["observation"]),
        )

    def _target(self, entry: object, satellite: int) -> int:
        """Target that a satellite has chosen with an action; NONE for actions without targets."""
        if isinstance(entry, Image):
            read_target = lambda part: getattr(part, "latest_target", torch.full_like(part.simulator.ticks, NONE))  # noqa: E731
        elif isinstance(entry, ImageRSO):
            read_target = lambda part: _memory(part, AIM)  # noqa: E731
        elif isinstance(entry, PointAtTask):
            read_target = lambda part: _memory(part, ASSIGNED)  # noqa: E731
        else:
            return NONE
        return int(self.env.fleet.each(read_target)[0, satellite])

    def _note_events(
        self, counted: Mapping[str, Tensor], seen: Tensor | None, on_board: Mapping[tuple[int, int, float], bool]
    ) -> None:
        """Note the images, inspections and deliveries of the last step."""
        env, now, events = self.env, self.noted.times[-1], self.noted.events
        if seen is not None and self.seen is not None:
            for target in torch.nonzero(self.seen & ~seen).flatten().tolist():
                events.append((now, self._who(target), target, 0))
        elif isinstance(env.scenario, RSOTargets):
            columns = env.scenario.imager_columns
            for image in on_board.keys() - self.on_board.keys():
                events.append((now, columns[image[0]], image[1], 2))
            for image in self.on_board.keys() - on_board.keys():
                events.append((image[2], columns[image[0]], image[1], 0))
        elif "imaged" in counted:
            target = env.fleet.each(lambda part: getattr(part, "latest_target", torch.full_like(part.simulator.ticks, NONE)))[0]
            images = self.counted["imaged"] - counted["imaged"]
            again = self.counted.get("duplicates", images) - counted.get("duplicates", images)
            for k in torch.nonzero((images > 0) & (target.cpu() >= 0)).flatten().tolist():
                events.append((now, k, int(target[k]), int(again[k] > 0)))

    def _who(self, target: int) -> int:
        """The satellite that has seen a target in the last step: the one that was sent to it, or the nearest inspector."""
        for choice in reversed(self.choices):
            if choice.target == target:
                return choice.satellite
        scenario = self.env.scenario
        if not isinstance(scenario, RSOPoints):
            return 0
        inspectors = scenario.inspector_columns
        place = self.env.fleet.each(lambda part: part.dynamics.r_BN_N)[0]
        point = place[scenario.rso_column]
        return int(inspectors[int((place[inspectors] - point).norm(dim=-1).argmin())])

    # -- the whole flight ---------------------------------------------------------------------------------------------

    def _track(self, ticks: TensorDictBase) -> Track:
        """The flight as a track."""
        env, noted = self.env, self.noted
        size = env.fleet.size
        time = ticks["time"].cpu().numpy()
        data = {name: _by_satellite(ticks[name], size) for name in ticks.keys() if name not in ("env", "episode", "tick", "time")}  # noqa: SIM118
        boundaries = np.array(noted.times)
        relative = is_relative(env)
        jumps = relative or any(simulator.has_tank for simulator in env.fleet.simulators)
        keys = _keyframes(time, boundaries if jumps else boundaries[[0, -1]])
        r_N, v_N = (data[name][keys] for name in ((RELATIVE, "rho_dot_H") if relative else ("r_BN_N", "v_BN_N")))
        sigma = data["sigma_BN"]
        if relative:  # the chief, at the origin
            r_N, v_N, sigma = (np.concatenate([part, np.zeros_like(part[:, :1])], 1) for part in (r_N, v_N, sigma))
        close = relative or places_of(env) == "points"
        sun = torch.stack(noted.sun_N).cpu().double().numpy()
        crafts = crafts_of(env)
        named, values_time, values = self._series(time, data, len(crafts))
        step = float(env.fleet.h)
        arrays: dict[str, Array] = {
            "key_times": time[keys],
            "r_N": r_N if close else r_N.astype("f4"),
            "v_N": v_N if close else v_N.astype("f4"),
            "sun_N": _unit(np.stack([np.interp(time[keys], boundaries, sun[:, axis]) for axis in range(3)], -1)),
            "sigma": sigma,
            "series_times": values_time,
            "series": _rounded(values),
            **self._decision_arrays(max((len(c.actions) for c in crafts), default=0), max(len(c.observation) for c in crafts)),
            **_event_arrays(noted.events),
            **_link_arrays(boundaries, torch.stack(noted.links)),
            **_interval_arrays("passes", time, data.get("station_access")),
            **_interval_arrays("eclipses", time, 1.0 - data["illumination"] if "illumination" in data else None),
        }
        if noted.objects:
            times, places, speeds = zip(*noted.objects, strict=True)
            arrays |= {"object_times": np.array(times)}
            arrays |= {"object_r_N": torch.stack(places).cpu().numpy(), "object_v_N": torch.stack(speeds).cpu().numpy()}
        limit = float(env.time_limit[0])
        return Track(
            label=f"seed {self.scene.seed}",
            scene=0,
            total=float(env.returns[0]),
            duration=noted.times[-1],
            limit=limit if math.isfinite(limit) else None,
            deaths=noted.deaths,
            series=named,
            counts={name: int(count[0].sum()) for name, count in env.counts().items()},
            attitude_start=float(time[0]),
            attitude_step=step,
            arrays=arrays,
        )

    def _series(self, time: Array, data: Mapping[str, Array], size: int) -> tuple[list[Series], Array, Array]:
        """Names, times [J] and values [J, S, n] of the quantities over time."""
        noted = self.noted
        boundaries = np.array(noted.times)
        chosen = np.arange(0, len(time), self._stride())
        if len(boundaries) < len(chosen):
            chosen = np.union1d(chosen, np.searchsorted(time, boundaries).clip(max=len(time) - 1))
        chosen = np.union1d(chosen, [len(time) - 1])
        named, columns = list[Series](), list[Array]()
        for name, title in QUANTITIES.items():
            if FIELDS[name] in data and name in noted.quantities[0]:
                fraction = np.stack([np.abs(now[name].numpy()).max(-1) for now in noted.quantities])  # [B, S]
                named.append(Series(name=name, label=title, bad=BAD[name]))
                columns.append(_scaled(time, chosen, data[FIELDS[name]], boundaries, fraction))
        if "illumination" in data:
            named.append(Series(name="sunlit", label="sunlit"))
            columns.append(data["illumination"][chosen])
        earned = np.zeros((len(chosen), self.env.fleet.size))
        for choice, end in zip(self.choices, self._ends(), strict=True):
            earned[int(np.searchsorted(time[chosen], end)) :, choice.satellite] += choice.reward
        named.append(Series(name="reward", label="reward so far"))
        columns.append(earned)
        values = np.stack(columns, -1)
        missing = size - values.shape[1]
        return named, time[chosen], np.pad(values, ((0, 0), (0, missing), (0, 0)), constant_values=np.nan)

    def _stride(self) -> int:
        return max(1, round(SAMPLE / float(self.env.fleet.h)))

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
        controls = max((len(choice.control) for choice in choices), default=0)
        return {
            "decision_time": np.array([choice.time for choice in choices], "f8"),
            "decision_end": self._ends(),
            "decision_satellite": np.array([choice.satellite for choice in choices], "i4"),
            "decision_action": np.array([choice.action for choice in choices], "i4"),
            "decision_target": np.array([choice.target for choice in choices], "i4"),
            "decision_reward": np.array([choice.reward for choice in choices], "f4"),
            "decision_mask": masks,
            "decision_probability": _rounded(_padded([choice.probability for choice in choices], actions)),
            "decision_action_value": _rounded(_padded([choice.value for choice in choices], actions)),
            "observation": _rounded(_padded([choice.observation for choice in choices], observed)),
            **({"decision_control": _padded([choice.control for choice in choices], controls)} if controls else {}),
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
    """Play the first episode of ``seed`` in row 0 of an environment with the most probable actions, and return it for the viewer.

    Args:
        env: The environment, with one satellite or several.
        policy: Acts for all satellites, such as ``shared(pretrained(...), env)``; see :func:`~bsk_torch.rl.policies.as_policy`.
        seed: Seed of the episode.
        until: Time after which no step begins, s; None for the end of the episode.
        title: Headline (default: the preset, policy and seed).
        preset: Name of the environment.
        label: What the policy is called.

    Raises:
        ValueError: If satellites of a constellation are not separate agents.
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
        places=places_of(env),
        station_min_elevation=station_elevation(env),
        satellites=crafts_of(env),
        scenes=scenes,
        tracks=tracks,
    )


def branched(flown: Flown, decision: int, action: int | None, parent: int) -> Branch:
    """Return the branch of a flight at one of its decisions, with its own action for None.

    IndexError for other decisions, ValueError for illegal actions and for decisions of real numbers.
    """
    if not 0 <= decision < len(flown.choices):
        raise IndexError(f"decision={decision} must lie from 0 to {len(flown.choices) - 1}, the decisions of track {parent}")
    choice = flown.choices[decision]
    if not choice.mask:
        raise ValueError(f"decision {decision} is made of real numbers; only numbered actions can be exchanged")
    action = choice.action if action is None else action
    if not (0 <= action < len(choice.mask) and choice.mask[action]):
        legal = [k for k, allowed in enumerate(choice.mask) if allowed]
        raise ValueError(f"action={action} is not legal at decision {decision}; legal are {legal!s:.200}")
    return Branch(time=choice.time, decision=decision, satellite=choice.satellite, action=action)


def has_agents(env: Tasking) -> bool:
    """Whether each satellite is an agent, as the viewer needs."""
    return not (isinstance(env, ConstellationTasking) and (env.joint or any(group.is_meta for group in env.groups)))


def _slots(env: Tasking) -> list[tuple[str | None, int, int]]:
    """Group, number within it, and satellite of each agent; ValueError unless satellites are separate agents."""
    if not isinstance(env, ConstellationTasking):
        return [(None, 0, 0)]
    if not has_agents(env):
        raise ValueError("env has agents of several satellites; the viewer needs one agent for each satellite")
    return [(g.name, k, int(column)) for g in env.groups for k, column in enumerate(g.members[:, 0].tolist())]


def _decides(group: SatelliteGroup, action: Tensor) -> bool:
    """Whether an action of a satellite begins something, instead of continuing."""
    if form(group) is None:
        return int(action) not in (group.actions.n_actions, NO_ACTION)
    return bool(acts(read("action", action.unsqueeze(0), group, (1,)), group, 1)[0])


def _entries(found: TensorDictBase, at: str | None, number: int) -> TensorDictBase:
    """What an agent of episode 0 has observed and done."""
    names = [name for name in ("observation", "action", "action_mask", "logits", ACTION_VALUE) if name in found.keys()]  # noqa: SIM118
    chosen = found.select(*names)
    return chosen[0] if at is None else chosen[0, number]


def _action_keys(env: Tasking) -> list[Any]:
    return [(g.name, "action") for g in env.groups] if isinstance(env, ConstellationTasking) else ["action"]


def _opinion(policy: TensorDictModuleBase, part: TensorDictBase, group: str | None) -> tuple[list[float], list[float]]:
    """What a policy has computed for a decision: probabilities and values of the actions, [A]; empty for policies without them.

    Policies write ``logits`` or ``action_value``. Those of one satellite that act for each of a constellation are asked again.
    """
    known = {"logits", ACTION_VALUE}
    if group is not None and isinstance(policy, SharedPolicy | GroupPolicies) and not known & set(part.keys()):
        single = policy.policies[group] if isinstance(policy, GroupPolicies) else policy.policy
        seen = part.select("observation", "action_mask").unsqueeze(0)
        seen["action_mask"] = seen["action_mask"][..., :-1]
        part = part if LOT in single.in_keys else decide(single, seen)[0]
    logits, values = part.get("logits", None), part.get(ACTION_VALUE, None)
    chances, worths = list[float](), list[float]()
    if logits is not None:
        chances = torch.where(part["action_mask"][: logits.shape[-1]], logits.double(), -torch.inf).softmax(-1).tolist()
    if values is not None:
        values = values.double().reshape(-1)[: part["action_mask"].shape[-1]]  # planners write those of the one agent as [1, A]
        told = part["action_mask"][: len(values)] & torch.isfinite(values)
        worths = torch.where(told, values, torch.nan).tolist()
    return chances, worths


def _memory(part: SatelliteGroup, name: str) -> Tensor:
    """A target remembered by satellites of a type; NONE for types without it."""
    memory = part.simulator.memory
    return memory[name] if name in memory else torch.full_like(part.simulator.ticks, NONE)


def _sun(env: Tasking) -> Tensor:
    """Direction to the Sun in episode 0, [3]."""
    dynamics = env.satellites[0].dynamics
    if is_relative(env) and hasattr(type(dynamics), "sun_hat_H"):
        return dynamics.sun_hat_H[0].clone()
    return env.fleet.simulators[0].world.sun_direction_N[0].clone()


def _seen(env: Tasking) -> Tensor | None:
    """Points that have been inspected, or tasks of AEOS-Bench that have succeeded, [T] bool; None for other environments."""
    if isinstance(env.scenario, AEOSBench):
        return env.scenario.task_succeeded[0].cpu().clone()
    seen = inspected_of(env)
    return None if seen is None else seen.clone()


def _on_board(env: Tasking) -> dict[tuple[int, int, float], bool]:
    """Images of objects that imagers hold: imager, object and time."""
    rewarder = imaging_of(env)
    return {} if rewarder is None else {image[:3]: True for image in images_on_board(rewarder)}


def _object_states(scenario: RSOTargets) -> tuple[Tensor, Tensor]:
    """Positions, m, and velocities, m/s, of the objects of episode 0, [T, 3] each."""
    assert scenario.r_TN_N is not None  # brings the orbits up to date
    place = torch.arange(scenario.n_targets, device=scenario.r_TN_N.device)
    envs = torch.zeros(1, dtype=torch.int64, device=place.device)
    r_N, v_N = scenario.orbits.motion(envs, place.unsqueeze(0), scenario.fleet.sim_time)
    return r_N.stack()[0].float(), v_N.stack()[0].float()


def _by_satellite(values: Tensor, size: int) -> Array:
    """Recorded values as [M, S, ...]; the width 1 is left out."""
    found = values.cpu().double().numpy()
    return found[:, None] if size == 1 else found


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
    found = np.empty((len(chosen), field_of.shape[1]))
    for k in range(field_of.shape[1]):
        good = np.isfinite(scale[:, k])
        of_time = np.interp(time[chosen], boundaries[good], scale[good, k]) if good.any() else np.zeros(len(chosen))
        found[:, k] = np.where(np.isfinite(field_of[chosen, k]), field_of[chosen, k] * of_time, np.nan)
    return found


def _event_arrays(events: list[tuple[float, int, int, int]]) -> dict[str, Array]:
    ordered = sorted(events)
    columns: list[Any] = list(zip(*ordered, strict=True)) or [(), (), (), ()]
    names = ("event_time", "event_satellite", "event_target", "event_kind")
    return {name: np.array(column, "f8" if name == "event_time" else "i4") for name, column in zip(names, columns, strict=True)}


def _link_arrays(boundaries: Array, links: Tensor) -> dict[str, Array]:
    """Links between satellites, from the boundary at which they are in force until the first one at which they are not."""
    either = (links | links.mT).numpy()
    found = []
    for a, b in zip(*np.nonzero(np.triu(either.any(0), 1)), strict=True):
        for start, end in _spans(boundaries, either[:, a, b]):
            found.append((start, end, a, b))
    columns: list[Any] = list(zip(*sorted(found), strict=True)) or [(), (), (), ()]
    names = ("link_start", "link_end", "link_a", "link_b")
    return {name: np.array(column, "f8" if k < 2 else "i4") for k, (name, column) in enumerate(zip(names, columns, strict=True))}


def _interval_arrays(name: str, time: Array, values: Array | None) -> dict[str, Array]:
    """Intervals, by satellite, in which a recorded value [M, S] is more than a half."""
    found = []
    for k in range(0 if values is None else values.shape[1]):
        assert values is not None
        found += [
            (start, end, k) for start, end in _spans(time, np.nan_to_num(values[:, k].reshape(len(time), -1).max(-1)) > 0.5)
        ]
    rows = np.array(sorted(found), "f8").reshape(-1, 3)
    return {name: rows[:, :2], f"{name}_satellite": rows[:, 2].astype("i4")}


def _spans(times: Array, holds: Array) -> list[tuple[float, float]]:
    """Intervals from a time at which something holds until the first one at which it does not."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], holds.astype(np.int8), [0]])))
    last = len(times) - 1
    return [(float(times[a]), float(times[min(b, last)])) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def _rounded(values: Array) -> Array:
    """Numbers rounded to :data:`BITS` binary digits, which compress well, as float32."""
    dropped = 24 - BITS
    whole = np.ascontiguousarray(values, "f4").view("u4")
    rounded = ((whole.astype("u8") + (1 << (dropped - 1))) >> dropped << dropped).astype("u4").view("f4")
    found: Array = np.where(np.isfinite(rounded), rounded, values).astype("f4")
    return found


def _unit(vectors: Array) -> Array:
    found: Array = vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
    return found


def _flat(observed: Any) -> list[float]:
    """Numbers of an observation, in the order of their names."""
    if isinstance(observed, Tensor):
        numbers: list[float] = observed.double().flatten().tolist()
        return numbers
    return [number for value in observed.values() for number in _flat(value)]


def _padded(rows: list[list[float]], width: int) -> Array:
    found = np.full((len(rows), max([width, *map(len, rows)])), np.nan, "f4")
    for row, values in zip(found, rows, strict=True):
        row[: len(values)] = values
    return found
