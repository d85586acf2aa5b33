"""Builds a case of the differential tester from the classes of a library, and flies it.

A library is a package with the modules of bsk_rl: ``bsk_rl`` itself or ``bsk_torch``.
Only :class:`Library` knows which one it is.
"""

from __future__ import annotations

import contextlib
import copy
import importlib
import logging
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np
from differential_draw import Case, Craft, Part

REFERENCE = "bsk_rl"
"""The library on Basilisk."""

CORE = "bsk_torch"
"""The batched environments of this package, seen through its Gymnasium and PettingZoo views."""

NUDGE = 1e-12
"""Relative change of where a twin starts: of its attitude, its position, and its true anomaly."""

VIEWS = {"single": "SatelliteTasking", "joint": "GeneralSatelliteTasking", "agents": "ConstellationTasking"}

STATES = ("r_BN_N", "v_BN_N", "sigma_BN", "omega_BN_B", "wheel_speeds", "battery_charge", "storage_level", "dv_available")
"""Properties of dynamics or flight software that are compared, of satellites that have them."""

NEXT = 12
"""Number of upcoming windows that are compared after each step; all of them are after the reset and at the end."""


@dataclass
class Record:
    """What is seen at the reset, or after a step.

    Attributes:
        numbers: Quantities by name, compared within tolerances.
        facts: Quantities by name that must be equal.
        windows: Windows that have not closed by satellite: kind, place (rounded to 0.1 m), opening and closing, s.
    """

    numbers: dict[str, np.ndarray] = field(default_factory=dict)
    facts: dict[str, Any] = field(default_factory=dict)
    windows: dict[str, list[tuple[str, tuple[float, ...], float, float]]] = field(default_factory=dict)


@dataclass
class Flight:
    """A flown case: what was seen, and the exception that ended it, if any."""

    records: list[Record]
    error: BaseException | None = None
    where: str = ""


class Library:
    """The modules of a library, and the environments that it makes."""

    def __init__(self, name: str) -> None:
        """Find a library by the name of its package."""
        self.name = name
        for part in ("act", "obs", "sats", "scene", "data", "comm", "sim.dyn", "sim.fsw", "scene.targets"):
            setattr(self, part.replace(".", "_"), importlib.import_module(f"{name}.{part}"))
        self.root = importlib.import_module(name)

    act: Any
    obs: Any
    sats: Any
    scene: Any
    data: Any
    comm: Any
    sim_dyn: Any
    sim_fsw: Any
    scene_targets: Any

    def environment(self, case: Case, backend: str, **options: Any) -> Any:
        """Return the environment of a case with the interface of bsk_rl's."""
        kind = getattr(self.root, VIEWS[case.view])
        if self.name != CORE:
            if self.name == REFERENCE:
                options["log_level"] = "ERROR"
            return kind(**options)
        wrappers = importlib.import_module("bsk_torch.wrappers")
        view = {"single": wrappers.GymEnv, "joint": wrappers.GymJointEnv, "agents": wrappers.PettingZooEnv}[case.view]
        orbit = {"orbit": "integrated"} if case.integrated else {}
        return view(kind(**options, **orbit, compat="bsk_rl", dtype=np.float64, seed=0, backend=backend))


def parts(module: Any, entries: tuple[Part, ...]) -> list[Any]:
    """Make the objects of a description."""
    return [getattr(module, part.name)(*copy.deepcopy(part.args), **copy.deepcopy(part.options)) for part in entries]


def start_of(craft: Craft, nudge: float) -> dict[str, Any]:
    """Return the arguments of a satellite, whose start is changed by ``nudge``."""
    args = copy.deepcopy(craft.sat_args)
    args["sigma_init"][0] += nudge
    if "disturbance_vector" in args and args["disturbance_vector"] is not None:
        args["disturbance_vector"] = np.array(args["disturbance_vector"])
    if craft.orbit.elements:
        i, node, perigee, f = craft.orbit.angles
        return args | dict(oe=SimpleNamespace(a=craft.orbit.a, e=craft.orbit.e, i=i, Omega=node, omega=perigee, f=f + nudge))
    r, v = craft.orbit.state()
    return args | dict(oe=None, rN=r * (1.0 + nudge), vN=v)


def satellite(library: Library, craft: Craft, nudge: float) -> Any:
    """Make a satellite."""
    attributes = dict(
        observation_spec=parts(library.obs, craft.observations),
        action_spec=parts(library.act, craft.actions),
        dyn_type=tuple(getattr(library.sim_dyn, name) for name in craft.dyn),
        fsw_type=tuple(getattr(library.sim_fsw, name) for name in craft.fsw),
    )
    kind = type(f"Kind{craft.name}", (getattr(library.sats, craft.base),), attributes)
    return kind(craft.name, sat_args=start_of(craft, nudge), **copy.deepcopy(craft.options))


def scenario(library: Library, case: Case) -> Any:
    """Make the scenario, with the targets of the case."""
    if case.scenario.name != "Targets":
        (made,) = parts(library.scene, (case.scenario,))
        return made

    class Given(library.scene.UniformTargets):  # type: ignore[name-defined, misc]
        """The targets of the case."""

        def regenerate_targets(self) -> None:
            """Fill in the targets."""
            make = library.scene_targets.Target
            self.targets = [make(f"tgt_{k}", row[:3], float(row[3])) for k, row in enumerate(case.targets)]

    return Given(len(case.targets))


def rewarder(library: Library, part: Part) -> Any:
    """Make a reward."""
    if part.name != "ResourceReward":
        return getattr(library.data, part.name)(**part.options)
    weight, name = part.options["reward_weight"], part.options["resource"]
    if name == "dv_available":  # of satellites without a tank, such as an RSO: none
        return library.data.ResourceReward(
            reward_weight=weight, resource_fn=lambda sat: sat.fsw.dv_available if hasattr(sat.fsw, "dv_available") else 0.0
        )
    return library.data.ResourceReward(reward_weight=weight, resource_fn=lambda sat: getattr(sat.dynamics, name))


def build(library: Library, case: Case, nudge: float = 0.0, backend: str = "compiled") -> Any:
    """Make the environment of a case."""
    rewards = [rewarder(library, part) for part in case.rewarders]
    communicator = {}
    if case.communicator is not None:
        (made,) = parts(library.comm, (case.communicator,))
        communicator["communicator"] = made
    satellites = [satellite(library, craft, nudge) for craft in case.crafts]
    env = {name: copy.deepcopy(value) for name, value in case.env.items() if name != "integrated"}
    return library.environment(
        case,
        backend,
        **({"satellite": satellites[0]} if case.view == "single" else {"satellites": satellites}),
        scenario=scenario(library, case),
        rewarder=rewards[0] if len(rewards) == 1 else tuple(rewards),
        world_args=copy.deepcopy(case.world_args),
        **communicator,
        **env,
    )


# -- flying -------------------------------------------------------------------------------------------------------------


@contextlib.contextmanager
def calm() -> Iterator[None]:
    """Keep warnings and log records of a flight to itself."""
    disabled = logging.root.manager.disable
    logging.disable(logging.ERROR)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            yield
        finally:
            logging.disable(disabled)


def fly(library: Library, case: Case, nudge: float = 0.0, backend: str = "compiled") -> Flight:
    """Fly a case until its episode ends, or all of its actions are done."""
    flight, where = Flight([]), "construction"
    with calm():
        try:
            env = build(library, case, nudge, backend)
            where = "reset"
            observation, info = env.reset(seed=0)
            flight.records.append(seen(case, env, observation, info, whole=True))
            agents = agents_of(case)
            for k in range(len(case.chances) if case.view != "agents" or env.agents else 0):
                where = f"step {k + 1}"
                actions = {name: member_actions(case, env, flight.records[-1], k, members) for name, members in agents.items()}
                observation, *outcome, info = env.step(given(case, actions))
                over = bool(np.any([np.all(list(flag.values())) if isinstance(flag, dict) else flag for flag in outcome[1:]]))
                over = over or (case.view == "agents" and not env.agents)
                last = over or k + 1 == len(case.chances)
                flight.records.append(seen(case, env, observation, info, outcome, whole=last))
                if over:
                    break
        except Exception as error:  # compared as part of the flight
            flight.error, flight.where = error, where
    return flight


def agents_of(case: Case) -> dict[str, list[int]]:
    """Numbers of the satellites that each agent commands."""
    names = [craft.name for craft in case.crafts]
    if case.view != "agents":
        return {"all": list(range(len(names)))}
    groups = case.env.get("meta_agent_groupings", {})
    led = [name for members in groups.values() for name in members]
    return {agent: [names.index(name) for name in members] for agent, members in groups.items()} | {
        name: [k] for k, name in enumerate(names) if name not in led
    }


def member_actions(case: Case, env: Any, last: Record, k: int, members: list[int]) -> list[Any]:
    """Return the actions of some satellites at step k, None to continue: idle ones are given a task, mostly."""
    actions = []
    waits = [last.facts.get(f"{craft.name} idle", False) for craft in case.crafts]
    for number in members:
        craft, chances = case.crafts[number], case.chances[k, number]
        alone = all(waits)  # no one has a task: without one for all the step would be as long as it may
        acts = case.view == "single" or alone or (case.follows[k, number] if waits[number] else chances[4] < 0.1)
        actions.append(action_of(craft, chances) if acts else None)
    return actions


def action_of(craft: Craft, chances: np.ndarray) -> Any:
    """Return an action of a satellite."""
    if craft.choices:
        return int(chances[0] * craft.choices)
    if craft.actions[0].name == "AttitudeSetpoint":
        return 2.0 * chances[:3] - 1.0
    options = craft.actions[0].options
    dv = (2.0 * chances[:3] - 1.0) * options["max_dv"]
    return np.append(dv, chances[3] * options["max_drift_duration"])


def given(case: Case, actions: dict[str, list[Any]]) -> Any:
    """Return actions as the view takes them."""
    if case.view == "single":
        return actions["all"][0]
    if case.view == "joint":
        return actions["all"]
    teams = case.env.get("meta_agent_groupings", {})
    whole = {name: row if name in teams else row[0] for name, row in actions.items()}
    return {
        name: action
        for name, action in whole.items()
        if action is not None and not (isinstance(action, list) and all(a is None for a in action))
    }


def seen(case: Case, env: Any, observation: Any, info: Any, outcome: list[Any] | None = None, whole: bool = False) -> Record:
    """Record what an environment shows now."""
    record, raw = Record(), env.unwrapped
    record.numbers["time"] = np.array(raw.simulator.sim_time)
    for craft in case.crafts:
        one = raw.get_satellite(craft.name)
        for name in STATES:
            owner = one.fsw if name == "dv_available" else one.dynamics
            with contextlib.suppress(AttributeError):
                record.numbers[f"{craft.name} {name}"] = np.array(getattr(owner, name), dtype=float)
        if craft.base != "Satellite":
            windows = [
                (
                    entry["type"],
                    tuple(np.round(np.asarray(entry["r_LP_P"], dtype=float), 1).tolist()),
                    *map(float, entry["window"]),
                )
                for entry in one.upcoming_opportunities
            ]
            record.windows[craft.name] = windows if whole else windows[:NEXT]
        if craft.base == "ImagingSatellite" and hasattr(one, "imaged"):
            record.facts[f"{craft.name} imaged"] = int(one.imaged)
    observations = {"": observation} if case.view == "single" else observation
    if case.view == "joint":
        observations = {craft.name: part for craft, part in zip(case.crafts, observation, strict=True)}
    for name, part in observations.items():
        record.numbers[f"observation {name}".strip()] = np.asarray(part, dtype=float)
    infos = {case.crafts[0].name: info} if case.view == "single" else info
    for craft in case.crafts:
        mine = infos.get(craft.name) or next(
            (one[craft.name] for one in infos.values() if isinstance(one, dict) and craft.name in one), None
        )
        if mine is not None:
            record.facts[f"{craft.name} idle"] = bool(mine["requires_retasking"])
    d_ts = info["__common__"]["d_ts"] if "__common__" in info else info.get("d_ts", raw.latest_step_duration)
    record.numbers["d_ts"] = np.array(d_ts)
    if outcome is not None:
        reward, terminated, truncated = outcome
        for name, value in reward.items() if isinstance(reward, dict) else [("", reward)]:
            record.numbers[f"reward {name}".strip()] = np.array(float(value))
        for flag, values in (("terminated", terminated), ("truncated", truncated)):
            record.facts[flag] = {n: bool(v) for n, v in values.items()} if isinstance(values, dict) else bool(values)
    if case.view == "agents":
        record.facts["agents"] = sorted(env.agents)
    return record
