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
from differential_draw import Case, Craft, Drawn, Part

from bsk_torch.bsk_rl.per_episode.views import OneOthers

REFERENCE = "bsk_rl"
"""The library on Basilisk."""

CORE = "bsk_torch"
"""The batched environments of this package, seen through its Gymnasium and PettingZoo views."""

DROP_IN = "bsk_torch.bsk_rl"
"""The package that is bsk_rl, with the same programs and seeds."""

NUDGE = 1e-12
"""Relative change of where a twin starts: of its attitude, its position, and its true anomaly."""

FARTHER = 1e-10
"""That of a second twin: about the accuracy of orbits and of the Earth's orientation here."""

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
        lengths: Lengths of the vectors that the numbers of observations belong to.
        facts: Quantities by name that must be equal.
        windows: Windows that have not closed by satellite: kind, place (rounded to 0.1 m), opening and closing, s.
    """

    numbers: dict[str, np.ndarray] = field(default_factory=dict)
    lengths: dict[str, np.ndarray] = field(default_factory=dict)
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
        for part in ("act", "obs", "sats", "scene", "data", "comm", "sim.dyn", "sim.fsw", "scene.targets", "utils.orbital"):
            home = {"utils.orbital": "formations"}.get(part, part) if name == CORE else part
            setattr(self, part.replace(".", "_"), importlib.import_module(f"{name}.{home}"))
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
    utils_orbital: Any

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


FUNCTIONS = {
    "height": lambda sat: np.linalg.norm(sat.dynamics.r_BN_N) - 6.4e6,
    "age": lambda sat: sat.simulator.sim_time,
    "sun": lambda sat: sun_of(sat.simulator.world) @ sat.dynamics.r_BN_N / np.linalg.norm(sat.dynamics.r_BN_N),
    "length": lambda sat, opp: opp["window"][1] - opp["window"][0],
    "squared": lambda priority: priority**2,
}
"""Functions of the user's, by the names that cases have for them."""

TYPES = {"dict": dict, "list": list, "float32": np.float32}
"""Types, likewise."""


def sun_of(world: Any) -> Any:
    """Direction of the Sun in N."""
    position = np.array(world.gravFactory.spiceObject.planetStateOutMsgs[world.sun_index].read().PositionVector)
    return position / np.linalg.norm(position)


def real(value: Any) -> Any:
    """Make a value of a description: functions that draw it, functions and types by name, and copies of all else."""
    if isinstance(value, Drawn):
        return lambda: np.random.uniform(value.low, value.high)
    if isinstance(value, dict):
        named = {"fn": FUNCTIONS, "reward_fn": FUNCTIONS, "obs_type": TYPES, "dtype": TYPES}
        return {key: named[key][part] if key in named and isinstance(part, str) else real(part) for key, part in value.items()}
    return copy.deepcopy(value)


def parts(module: Any, entries: tuple[Part, ...]) -> list[Any]:
    """Make the objects of a description."""
    return [getattr(module, part.name)(*map(real, part.args), **real(part.options)) for part in entries]


def arguments_of(library: Library, craft: Craft) -> dict[str, Any]:
    """Return the arguments of a satellite."""
    args = real(craft.sat_args)
    if args.get("disturbance_vector") is not None:
        args["disturbance_vector"] = np.array(args["disturbance_vector"])
    if craft.orbit is None:
        return args
    if isinstance(craft.orbit, Part):
        name, options = craft.orbit.name, craft.orbit.options
        return args | dict(oe=lambda: getattr(library.utils_orbital, name)(**options))
    if craft.orbit.elements:
        i, node, perigee, f = craft.orbit.angles
        return args | dict(oe=SimpleNamespace(a=craft.orbit.a, e=craft.orbit.e, i=i, Omega=node, omega=perigee, f=f))
    r, v = craft.orbit.state()
    return args | dict(oe=None, rN=r, vN=v)


def nudged(base: Any, nudge: float) -> Any:
    """Return a class of bsk_rl's satellites whose start is changed by a part ``nudge`` once it has been drawn."""

    class Twin(base):
        """Starts elsewhere."""

        def generate_sat_args(self, **overrides: Any) -> None:
            """Change attitude and place."""
            super().generate_sat_args(**overrides)
            args = self.sat_args
            args["sigma_init"] = np.add(args["sigma_init"], [nudge, 0.0, 0.0])
            if args["oe"] is None:
                args["rN"] = np.array(args["rN"], dtype=float) * (1.0 + nudge)
            else:
                args["oe"] = copy.copy(args["oe"])
                args["oe"].f += nudge

    return Twin


def satellite(library: Library, craft: Craft, nudge: float) -> Any:
    """Make a satellite."""
    attributes = dict(
        observation_spec=parts(library.obs, craft.observations),
        action_spec=parts(library.act, craft.actions),
        dyn_type=tuple(getattr(library.sim_dyn, name) for name in craft.dyn),
        fsw_type=tuple(getattr(library.sim_fsw, name) for name in craft.fsw),
    )
    base = getattr(library.sats, craft.base)
    kind = type(f"Kind{craft.name}", (nudged(base, nudge) if nudge else base,), attributes)
    return kind(craft.called or craft.name, sat_args=arguments_of(library, craft), **real(craft.options))


def scenario(library: Library, case: Case) -> Any:
    """Make the scenario, with the targets of the case."""
    if case.scenario.name != "Targets":
        (made,) = parts(library.scene, (case.scenario,))
        return made

    if library.name == CORE:
        rows = np.array(case.targets, dtype=float)
        return library.scene.Targets(rows[:, :3], rows[:, 3], names=[f"tgt_{k}" for k in range(len(rows))])

    class Given(library.scene.UniformTargets):  # type: ignore[name-defined, misc]
        """The targets of the case."""

        def regenerate_targets(self) -> None:
            """Fill in the targets."""
            make = library.scene_targets.Target
            self.targets = [make(f"tgt_{k}", row[:3], float(row[3])) for k, row in enumerate(case.targets)]

    return Given(len(case.targets))


def rewarder(library: Library, part: Part) -> Any:
    """Make a reward."""
    options = real(part.options)
    if part.name != "ResourceReward":
        return getattr(library.data, part.name)(**options)
    weight, name = options["reward_weight"], options["resource"]
    if name == "dv_available":  # of satellites without a tank, such as an RSO: none

        def fuel(sat: Any) -> Any:
            return sat.fsw.dv_available if hasattr(sat.fsw, "dv_available") else 0.0

        return library.data.ResourceReward(
            reward_weight=weight, resource_fn=(lambda sat: sat.fsw.dv_available) if library.name == CORE else fuel
        )
    return library.data.ResourceReward(reward_weight=weight, resource_fn=lambda sat: getattr(sat.dynamics, name))


def communicator(library: Library, part: Part) -> Any:
    """Make the communication; that of broadcasts is composed with how they spread."""
    if not part.name.startswith("Broadcast"):
        (made,) = parts(library.comm, (part,))
        return made
    spread = getattr(library.comm, part.name.removeprefix("Broadcast"))
    return type(part.name, (library.comm.BroadcastCommunication, spread), {})(**part.options)


def build(library: Library, case: Case, nudge: float = 0.0, backend: str = "compiled") -> Any:
    """Make the environment of a case."""
    rewards = [rewarder(library, part) for part in case.rewarders]
    satellites = [satellite(library, craft, nudge) for craft in case.crafts]
    env = real({name: value for name, value in case.env.items() if name != "integrated"})
    if case.communicator is not None:
        env["communicator"] = communicator(library, case.communicator)
    if case.randomizer is not None:
        (env["sat_arg_randomizer"],) = parts(library.utils_orbital, (case.randomizer,))
    return library.environment(
        case,
        backend,
        **({"satellite": satellites[0]} if case.view == "single" else {"satellites": satellites}),
        scenario=scenario(library, case),
        rewarder=rewards[0] if len(rewards) == 1 else tuple(rewards),
        world_args=copy.deepcopy(case.world_args),
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
    """Fly a case until its episodes end, or all of its actions are done."""
    flight, where = Flight([]), "construction"
    steps = np.array_split(np.arange(len(case.chances)), len(case.seeds))
    with calm():
        try:
            env = build(library, case, nudge, backend)
            for seed, numbers in zip(case.seeds, steps, strict=True):
                where = f"reset with seed {seed}"
                observation, info = env.reset(seed=seed)
                flight.records.append(seen(case, env, observation, info, whole=True))
                beyond = case.program and case.view != "agents"  # one step after the end, where someone can act
                for k in numbers if case.view != "agents" or env.agents else ():
                    where = f"step {k + 1}"
                    last = flight.records[-1]
                    agents = {
                        n: own for n, own in agents_of(case).items() if case.program or case.view != "agents" or n in env.agents
                    }
                    actions = {name: member_actions(case, env, last, k, own) for name, own in agents.items()}
                    observation, *outcome, info = env.step(given(case, actions))
                    over = bool(np.any([np.all(list(f.values())) if isinstance(f, dict) else f for f in outcome[1:]]))
                    over = over or (case.view == "agents" and not env.agents)
                    whole = over or k == numbers[-1]
                    flight.records.append(seen(case, env, observation, info, outcome, whole))
                    if over and not beyond:
                        break
                    beyond = beyond and not over
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
        one = satellite_of(env.unwrapped, craft.name) if case.program else None
        actions.append(action_of(craft, chances, one) if acts else None)
    return actions


def action_of(craft: Craft, chances: np.ndarray, one: Any = None) -> Any:
    """Return an action of a satellite; in programs, a target or its id now and then."""
    if craft.choices:
        number = int(chances[0] * craft.choices)
        ahead = [(part.name, k) for part in craft.actions for k in range(part.options.get("n_ahead_image", 1))]
        name, k = ahead[number]
        if one is None or name != "Image" or chances[4] < 0.8:
            return number
        target = one.find_next_opportunities(n=k + 1, types="target")[-1]["object"]
        return target if chances[4] < 0.9 else target.id
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


def satellite_of(raw: Any, name: str) -> Any:
    """Return a satellite of an episode by its name, with numbers and arrays."""
    return OneOthers(raw.core.fleet, 0)[name] if hasattr(raw, "core") else raw.get_satellite(name)


def leaves(value: Any) -> Iterator[float]:
    """Yield the numbers of an observation in their order."""
    if isinstance(value, dict | list | tuple | np.ndarray):
        for part in value.values() if isinstance(value, dict) else value:
            yield from leaves(part)
    else:
        yield float(value)


def lengths(values: np.ndarray, satellites: list[Any]) -> np.ndarray:
    """Return the length of the vector that each value of an observation belongs to, by the names of the values."""
    names = [name.partition("[")[0] for one in satellites for name in one.observation_description]
    squares: dict[str, float] = {}
    for name, value in zip(names, values, strict=True):
        squares[name] = squares.get(name, 0.0) + value**2
    return np.sqrt([squares[name] for name in names])


def flags(value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Yield what an info holds, but for numbers."""
    for name, part in value.items():
        if isinstance(part, dict):
            yield from flags(part, f"{path}{name}.")
        else:
            yield f"{path}{name}", bool(part) if isinstance(part, bool | np.bool_) else type(part).__name__


def descriptions(case: Case, raw: Any, info: Any) -> dict[str, Any]:
    """Return names, spaces, counters and the info of a program, all of which must be equal."""
    found: dict[str, Any] = {"names": [one.name for one in raw.satellites], "info": dict(flags(info))}
    for craft in case.crafts:
        one = satellite_of(raw, craft.name)
        spaces = [one.action_space, one.observation_space]
        found[f"{craft.name} spaces"] = str(spaces)
        if craft.choices:  # that of real numbers raises in bsk_rl
            found[f"{craft.name} actions"] = one.action_description
        found[f"{craft.name} observations"] = one.observation_description
        for name in ("imaged", "missed"):
            found[f"{craft.name} {name}"] = getattr(one, name, None)
        known = getattr(one.data_store.data, "known", None)
        found[f"{craft.name} known"] = None if known is None else len(known)
        found[f"{craft.name} data"] = type(one.data_store.data).__name__
    return found


def seen(case: Case, env: Any, observation: Any, info: Any, outcome: list[Any] | None = None, whole: bool = False) -> Record:
    """Record what an environment shows now."""
    record, raw = Record(), env.unwrapped
    record.numbers["time"] = np.array(satellite_of(raw, case.crafts[0].name).simulator.sim_time)
    for craft in case.crafts:
        one = satellite_of(raw, craft.name)
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
    owners = agents_of(case) if case.view == "agents" else {n: [k] for k, n in enumerate(observations)}
    for name, part in observations.items():
        key = f"observation {name}".strip()
        record.numbers[key] = np.array(list(leaves(part)), dtype=float)
        record.lengths[key] = lengths(record.numbers[key], [satellite_of(raw, case.crafts[k].name) for k in owners[name]])
    if case.program:
        record.facts |= descriptions(case, raw, info)
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
        if case.program:
            record.numbers["cum_reward"] = np.array(list(leaves(raw.rewarder.cum_reward)))
        for flag, values in (("terminated", terminated), ("truncated", truncated)):
            record.facts[flag] = {n: bool(v) for n, v in values.items()} if isinstance(values, dict) else bool(values)
    if case.view == "agents":
        record.facts["agents"] = sorted(env.agents)
    return record
