"""Record the examples of bsk_rl's documentation as numpy files with which ``tests/examples`` compares ``examples/bsk_rl``.

Usage::

    python scripts/recorders/record_examples.py                              # every file, into tests/basilisk/recordings
    python scripts/recorders/record_examples.py example_simple_environment   # only this one
    python scripts/recorders/record_examples.py --list

See ``recording.py`` for what it needs, and ``example_problems.py`` for the problems. bsk_rl draws from NumPy's global
generator, which ``reset(seed=)`` seeds; what it has drawn is read back and stored: all arguments that are functions or come
from a ``sat_arg_randomizer``, the epoch, and the targets that have a window before the end and :data:`BEYOND` seconds after it.
Actions come from a separate generator.
"""

from __future__ import annotations

import json
import types
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import example_problems as problems
import numpy as np
from Basilisk.architecture import messaging
from bsk_rl import ConstellationTasking, GeneralSatelliteTasking, SatelliteTasking
from bsk_rl.utils.rso_imaging import candidate_snapshot
from numpy.typing import NDArray
from recording import record_files, versions

RESOLUTION = 2.0**-24  # observations are rounded to multiples of this, so that files are small
BEYOND = 4800.0  # [s]
NONE = -1  # action of a satellite that is given none

Actions = Callable[[Any, int, Any], Sequence[int]]
"""Function of environment, number of the step and observations that gives an action for each satellite."""


@dataclass(frozen=True)
class Example:
    """What is recorded.

    Attributes:
        make: Function without arguments that returns the environment.
        actions: See :data:`Actions`.
        steps: Number of steps, fewer where the episode ends.
        seed: Of the reset.
        drawn: Arguments that were drawn although they are constants when the environment reads them.
        attributes: Of targets, as they are at the end, in addition to their priority.
        before: Called with environment and number of the step before each step.
        notes: Further arrays of a step, read after it.
        every: Observations are kept of every so manieth decision.
    """

    make: Callable[[], Any]
    actions: Actions
    steps: int
    seed: int = 1
    drawn: tuple[str, ...] = ()
    attributes: tuple[str, ...] = ()
    before: Callable[[Any, int], None] = lambda env, k: None
    notes: Callable[[Any], dict[str, Any]] = lambda env: {}
    every: int = 1


def satellites_of(env: Any) -> list[Any]:
    """All satellites."""
    return env.unwrapped.satellites


def plain(value: Any) -> Any:
    """An argument as JSON has it; orbital elements are a [m], e, i, Omega, omega, f [rad]."""
    if hasattr(value, "Omega"):
        return [float(getattr(value, name)) for name in ("a", "e", "i", "Omega", "omega", "f")]
    if isinstance(value, np.ndarray | list | tuple):
        return [float(x) for x in np.ravel(value)]
    return value if isinstance(value, str) else float(value)


def drawn_arguments(env: Any, satellite: Any, extra: tuple[str, ...]) -> dict[str, Any]:
    """Arguments of a satellite that differ from episode to episode."""
    given = satellite.sat_args_generator
    names = [name for name, value in given.items() if callable(value) or name in extra]
    names += [name for name in ("oe",) if given.get("oe") is None or "walker" in getattr(env.sat_arg_randomizer, "__name__", "")]
    return {
        name: plain(satellite.sat_args[name]) for name in names if satellite.sat_args[name] is not None and name != "utc_init"
    }


class Driver:
    """One interface to the three environments of bsk_rl."""

    def __init__(self, env: Any) -> None:
        """Wrap an environment."""
        self.env, self.joint = env, isinstance(env, GeneralSatelliteTasking) and not isinstance(env, SatelliteTasking)
        self.several = isinstance(env, ConstellationTasking)
        self.names = [satellite.name for satellite in satellites_of(env)]

    def observations(self, given: Any) -> list[Any]:
        """Observations by satellite; None for those without."""
        if self.several:
            return [given.get(name) for name in self.names]
        return list(given) if self.joint else [given]

    def reset(self, seed: int) -> list[Any]:
        """Begin the episode."""
        return self.observations(self.env.reset(seed=seed)[0])

    def step(self, actions: Sequence[Any]) -> tuple[list[Any], dict[str, Any]]:
        """Return observations and a row of the step."""
        given = [None if isinstance(action, int | np.integer) and action == NONE else action for action in actions]
        if self.several:
            alive = list(self.env.agents)
            moves = {name: action for name, action in zip(self.names, given, strict=True) if name in alive and action is not None}
            seen, reward, terminated, truncated, info = self.env.step(moves)
            flags = {
                "reward": [float(reward.get(name, 0.0)) for name in self.names],
                "terminated": [bool(terminated.get(name, True)) for name in self.names],
                "truncated": [bool(truncated.get(name, True)) for name in self.names],
                "present": [name in reward for name in self.names],
                "requires_retasking": [name in alive and bool(info[name]["requires_retasking"]) for name in self.names],
            }
        else:
            seen, reward, terminated, truncated, info = self.env.step(given if self.joint else given[0])
            each = [info[name] for name in self.names] if self.joint else [info]
            flags = {
                "reward": [float(reward)],
                "terminated": [bool(terminated)],
                "truncated": [bool(truncated)],
                "present": [True],
                "requires_retasking": [bool(one["requires_retasking"]) for one in each],
            }
        return self.observations(seen), flags | {"duration": float(self.env.latest_step_duration)}

    @property
    def over(self) -> bool:
        """Whether no agent is left."""
        return self.several and not self.env.agents


def record(example: Example) -> dict[str, Any]:
    """Arrays of one example."""
    env = example.make()
    driver = Driver(env)
    seen = driver.reset(example.seed)
    setup = {
        "utc_init": env.unwrapped.world_args["utc_init"],
        "time_limit": float(env.unwrapped.time_limit),
        "sat_args": [drawn_arguments(env.unwrapped, satellite, example.drawn) for satellite in satellites_of(env)],
        "names": driver.names,
        "action_description": [satellite.action_description for satellite in satellites_of(env)],
        "observation_description": [satellite.observation_description for satellite in satellites_of(env)],
        "attributes": list(example.attributes),
        "every": example.every,
        "versions": versions(),
    }
    if hasattr(env.unwrapped.scenario, "catalog"):
        setup["catalog"] = env.unwrapped.scenario.catalog.to_dict()
    start = targets_of(env)
    observations, steps = [seen], []
    for k in range(example.steps):
        example.before(env, k)
        actions = example.actions(env, k, seen)
        numbers = [action if isinstance(action, int | np.integer) else place(start, action) for action in actions]
        seen, row = driver.step(actions)
        steps.append({"action": numbers, **row, **example.notes(env)})
        observations.append(seen)
        if driver.over or (np.any(row["terminated"]) and not driver.several) or np.all(row["truncated"]):
            break
    kept = keep(env, start)
    arrays: dict[str, Any] = {name: np.array([step[name] for step in steps]) for name in (steps[0] if steps else ())}
    if steps:
        arrays["action"] = renumbered(arrays["action"], kept)
    arrays |= {
        "obs": stack(observations[:: example.every]),
        "targets": table(start, example.attributes)[kept],
        "setup": json.dumps(setup),
    }
    env.close()
    return arrays


def targets_of(env: Any) -> list[Any]:
    """Targets in their order."""
    whole = env.unwrapped.scenario
    return [target for part in getattr(whole, "scenarios", {"": whole}).values() for target in getattr(part, "targets", [])]


BY_NAME = 1_000_000
"""Added to the index of a target that an action names."""


def place(targets: list[Any], target: Any) -> int:
    """Number of an action that names a target."""
    return BY_NAME + [id(one) for one in targets].index(id(target))


def renumbered(actions: NDArray[Any], kept: NDArray[Any]) -> NDArray[Any]:
    """Actions, with targets by their place among those that are kept."""
    named = actions >= BY_NAME
    places = {int(old): new for new, old in enumerate(kept)}
    actions = actions.astype(np.int64)
    actions[named] = [BY_NAME + places[int(action) - BY_NAME] for action in actions[named]]
    return actions


def table(targets: list[Any], attributes: tuple[str, ...]) -> NDArray[Any]:
    """Position [m], priority and further attributes of the targets, [T, 4 + A]."""
    rows = [[*target.r_LP_P, target.priority, *(getattr(target, name) for name in attributes)] for target in targets]
    return np.array(rows, dtype=np.float64).reshape(-1, 4 + len(attributes))


def keep(env: Any, targets: list[Any]) -> NDArray[Any]:
    """Indices of the targets that a satellite sees in time."""
    last = env.unwrapped.simulator.sim_time + BEYOND
    opportunities: Iterator[Any] = (one for satellite in satellites_of(env) for one in getattr(satellite, "opportunities", []))
    seen = {id(one["object"]) for one in opportunities if one["type"] == "target" and one["window"][0] < last}
    return np.array([k for k, target in enumerate(targets) if id(target) in seen], dtype=np.int64)


def stack(observations: list[list[Any]]) -> NDArray[Any]:
    """Observations [steps + 1, satellites, width], NaN where there are none, or a satellite has fewer."""
    width = max(len(one) for row in observations for one in row if one is not None)
    whole = np.full((len(observations), len(observations[0]), width), np.nan)
    for k, row in enumerate(observations):
        for i, one in enumerate(row):
            if one is not None:
                whole[k, i, : len(one)] = one
    return np.rint(whole / RESOLUTION) * RESOLUTION


# -- actions -------------------------------------------------------------------------------------------------------------


def listed(*rows: Sequence[int] | int) -> Actions:
    """These actions."""
    return lambda env, k, seen: [rows[k]] if isinstance(rows[k], int) else rows[k]  # type: ignore[list-item, return-value]


def drawn(seed: int, probability: Sequence[float], satellites: int = 1, first: Sequence[Sequence[int]] = ()) -> Actions:
    """The ``first`` ones, then independent ones."""
    rng = np.random.default_rng(seed)

    def choose(env: Any, k: int, seen: Any) -> Sequence[int]:
        return first[k] if k < len(first) else [int(a) for a in rng.choice(len(probability), satellites, p=probability)]

    return choose


def soon(images: int, *others: float) -> list[float]:
    """Probabilities of the ``others`` and of images, each three quarters of that of the target before."""
    weights = 0.75 ** np.arange(images)
    return [*others, *((1.0 - sum(others)) * weights / weights.sum())]


def idle_only(seed: int, probability: Sequence[float]) -> Actions:
    """Independent ones for satellites that need a task; the others continue."""
    rng = np.random.default_rng(seed)

    def choose(env: Any, k: int, seen: Any) -> Sequence[int]:
        picks = rng.choice(len(probability), len(satellites_of(env)), p=probability)
        return [
            int(pick) if satellite.requires_retasking else NONE for pick, satellite in zip(picks, satellites_of(env), strict=True)
        ]

    return choose


def kill_first(at: int) -> Callable[[Any, int], None]:
    """Let the first satellite's battery read empty from step ``at`` on, as the page does."""

    def before(env: Any, k: int) -> None:
        first = satellites_of(env)[0]

        def is_alive(self: Any, log_failure: bool = False) -> bool:
            message = messaging.PowerStorageStatusMsgPayload()
            message.storageLevel = 0.0
            self.dynamics.powerMonitor.batPowerOutMsg.write(message)
            return self.dynamics.is_alive(log_failure=log_failure) and self.fsw.is_alive(log_failure=log_failure)

        if k == at:
            first.is_alive = types.MethodType(is_alive, first)

    return before


def ninth_target(env: Any, k: int, seen: Any) -> Sequence[Any]:
    """The last of the next ten targets, by itself."""
    return [env.satellite.find_next_opportunities(n=10)[9]["object"]]


def search_again(seed: int) -> Actions:
    """Random ones and, every other time, the last of the next targets that has been imaged before, but not just now."""
    rng, imaged = np.random.default_rng(seed), set()

    def choose(env: Any, k: int, seen: Any) -> Sequence[int]:
        satellite = env.satellite
        imaged.update(satellite.data_store.new_data.imaged)
        ahead = [one["object"] for one in satellite.find_next_opportunities(n=32)]
        pick = int(rng.choice(32, p=soon(32)))
        again = [i for i, target in enumerate(ahead) if target in imaged and target is not satellite.latest_target]
        return [again[-1] if again and k % 2 else pick]

    return choose


def behind_shield(seed: int) -> Actions:
    """Random ones that the rule replaces where it forbids them."""
    rng = np.random.default_rng(seed)
    wanted = soon(32, 0.1, 0.1, 0.1)

    def choose(env: Any, k: int, seen: Any) -> Sequence[int]:
        mask, action = problems.allowed_by_rule(env, seen[0]), int(rng.choice(35, p=wanted))
        return [action if mask[action] else int(mask.argmax())]

    return choose


def image_and_downlink(env: Any, k: int, seen: Any) -> Sequence[int]:
    """The first three candidates in turns, and downlinks where none is left; every tenth time a charge or a desaturation."""
    *others, imager = satellites_of(env)
    there = sum(one is not None for one in candidate_snapshot(imager, 3).targets)
    other = 0 if k % 20 else 2
    chosen = 1 if there == 0 else 3 + k % there
    return [0 if k == 0 else NONE for _ in others] + [other if k % 10 == 9 else chosen]


def configured(part: str, actions: Actions, steps: int) -> Example:
    """A part of the page about configuration."""
    return Example(lambda: problems.configuration(part), actions, steps)


def curriculum(difficulty: float) -> Example:
    """An episode of a difficulty."""

    def make() -> Any:
        env = problems.curriculum_learning()
        env.difficulty = difficulty
        return env

    extra = ("batteryStorageCapacity", "storedCharge_Init", "disturbance_vector")
    return Example(make, drawn(11, [0.25] * 4), 8, drawn=extra)


EXAMPLES: dict[str, Example] = {
    "simple_environment": Example(problems.simple_environment, lambda env, k, seen: [0 if k < 3 else 1], 100),
    "configuration_properties": configured("properties", listed(), 0),
    "configuration_bespoke": configured("bespoke", listed(), 0),
    "configuration_custom": configured("custom", listed(), 0),
    "configuration_opportunities": configured("opportunities", listed(), 0),
    "configuration_composed": configured("composed", listed(), 0),
    "configuration_actions": configured("actions", listed(0, 1, 2), 3),
    "configuration_images": configured("images", ninth_target, 1),
    "multiagent_general": Example(
        lambda: problems.multiagent_envs(True),
        lambda env, k, seen: (
            ([7, 9, 8] if k == 0 else [6, 7, 9])
            if k in (0, 6)
            else [0 if satellite.requires_retasking else NONE for satellite in satellites_of(env)]
        ),
        7,
        before=kill_first(6),
    ),
    "multiagent_constellation": Example(
        lambda: problems.multiagent_envs(False),
        drawn(5, soon(10), 3, first=([7, 9, 8],)),
        12,
        before=kill_first(6),
    ),
    "communication_action": Example(
        problems.communication_action,
        drawn(6, soon(4, 0.3), 2, first=([4, 3], [0, 0], [3, 0])),
        14,
    ),
    "cloud_environment": Example(
        lambda: problems.cloud_environment((1000, 1001)),
        drawn(7, soon(32, 0.05), first=([0], [NONE], [1])),
        24,
        attributes=("cover", "forecast", "sigma"),
    ),
    "cloud_environment_with_reimaging": Example(
        lambda: problems.cloud_environment_with_reimaging((1000, 1001)),
        idle_only(8, soon(40, 0.05)),
        20,
        attributes=("forecast", "belief_at_start", "previous_at_start"),
        every=10,
    ),
    "rllib_training": Example(lambda: problems.nadir_scanning(True), drawn(9, [0.4, 0.2, 0.2, 0.2]), 40),
    "time_discounted_gae": Example(lambda: problems.nadir_scanning(False), drawn(10, [0.4, 0.2, 0.2, 0.2]), 24, seed=2),
    "async_multiagent_training": Example(problems.async_multiagent_training, idle_only(12, [0.55, 0.15, 0.15, 0.15]), 30),
    **{f"aeos_{name}": Example(lambda name=name: problems.aeos(name), drawn(13, soon(32)), 10) for name in ("S1", "S2", "S3")},
    "aeos_power": Example(lambda: problems.aeos("power"), drawn(14, [*(0.9 * np.array(soon(32))), 0.1], first=([32], [2])), 14),
    "target_location_uncertainty": Example(
        lambda: problems.target_location_uncertainty((1000, 1001)),
        search_again(15),
        24,
        attributes=("side_at_start", "acquiring_speed", "image_time_at_start", "speed"),
        notes=lambda env: {"dwell": env.dwell},
    ),
    **{f"curriculum_learning_{round(100 * d)}": curriculum(d) for d in (0.0, 0.5, 1.0)},
    "training_with_shield": Example(  # less charge than on the page, so that the rule acts
        lambda: problems.training_with_shield((1000, 1001), 0.24, 0.25), behind_shield(16), 16
    ),
    "mixed_environment": Example(
        problems.mixed_environment,
        lambda env, k, seen: [(3 * k) % 4 if k % 7 else 4, 0 if k == 0 else NONE, int(k % 9 == 8)],
        60,
        seed=9,
        drawn=("rN", "vN"),
    ),
    **{
        f"space_to_space_rso_imaging_{profile}": Example(
            lambda profile=profile: problems.space_to_space_rso_imaging(profile), image_and_downlink, 40, drawn=("oe",)
        )
        for profile in ("compact", "amos")
    },
    "fault_environment": Example(lambda: problems.fault_environment(False), drawn(17, soon(32, 0.1, 0.1)), 24),
    "fault_environment_literal": Example(lambda: problems.fault_environment(True), drawn(18, soon(32, 0.1, 0.1)), 24),
    "fault_environment_literal_charge": Example(  # images of no target fill the store
        lambda: problems.fault_environment(True), drawn(19, soon(32, 0.1, 0.1), first=([1], [2])), 24, seed=3
    ),
}
"""What is recorded, by the name of the file without ``example_``."""


RECORDERS: dict[str, Callable[[str], dict[str, Any]]] = {
    f"example_{name}": lambda _, example=example: record(example) for name, example in EXAMPLES.items()
}


if __name__ == "__main__":
    record_files(RECORDERS)
