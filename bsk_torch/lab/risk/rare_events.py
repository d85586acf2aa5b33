"""Events whose probability is estimated, and levels that grow toward them."""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from bsk_torch.env import Tasking
from bsk_torch.sats.bound import BoundSatellite
from bsk_torch.sim.names import nearest

DEATH = "death"
"""Name of the event that a satellite dies."""

Function = Callable[[Tasking], Tensor]
"""Function of an environment between two steps: the level [N] float64 of its episodes, or whether the event happens [N] bool."""

COMPARISON = re.compile(r"\s*(\w+)\s*([<>])\s*([-+.\deE]+)\s*")
"""An event such as ``battery_charge_fraction<0.05``."""


@dataclass(frozen=True)
class Limit:
    """How near satellites are to the limit of an aliveness check.

    Attributes:
        check: Name of the check.
        nearness: Function of a satellite that returns the nearness [N]: 1 or more where the check fails.
        applies: Whether the check can fail for a satellite.
    """

    check: str
    nearness: Callable[[BoundSatellite], Tensor]
    applies: Callable[[BoundSatellite], bool] = lambda satellite: True


LIMITS = {
    "battery": Limit("battery_valid", lambda satellite: 1.0 - satellite.dynamics.battery_charge_fraction),
    "wheels": Limit("rw_speeds_valid", lambda satellite: satellite.dynamics.wheel_speeds_fraction.abs().amax(1)),
    "buffer": Limit(
        "data_storage_valid",
        lambda satellite: satellite.dynamics.storage_level_fraction,
        lambda satellite: bool(satellite.simulator.state.all_arguments["storageUnitValidCheck"]),
    ),
    "distance": Limit(
        "distance_valid",
        lambda satellite: satellite.simulator.state.all_arguments["keepOutRadius"] / satellite.dynamics.rho_H.norm(dim=-1),
    ),
}
"""Limits by the names of their levels; the level of death is the largest of those that apply."""


@dataclass(frozen=True)
class RareEvent:
    """An event, and the level that grows toward it.

    Attributes:
        title: Description of the event.
        happens: Whether it happens in each episode, [N].
        level: Level of each episode, [N].
        threshold: Level from which on the event happens, if known.
    """

    title: str
    happens: Function
    level: Function
    threshold: float | None = None


def rare_event(env: Tasking, event: str | Function, level: str | Sequence[str] | Function | None) -> RareEvent:
    """Return the event of a name or function.

    Args:
        env: The environment.
        event: ``"death"``; a property of the dynamics model with a limit, such as ``"battery_charge_fraction<0.05"``, where of
            several satellites or components the nearest one counts, by magnitude for vectors; or a function.
        level: Names of :data:`LIMITS`, of which the nearest one counts; a function; or None for that of the event: all limits
            that apply for death, and the property itself for a comparison.

    Raises:
        ValueError: For unknown names, an event without a level, and functions with wrong results.
    """
    nearness: Function | None = None
    threshold: float | None = None
    if callable(event):
        title, happens = getattr(event, "__name__", "event"), event
    elif event == DEATH:
        title, happens, threshold = DEATH, lambda env: env.dead.view(env.num_envs, -1).any(1), 1.0
    else:
        title, happens, nearness, threshold = _comparison(env, str(event))
    if callable(level):
        nearness, threshold = level, None
    elif level is not None or (nearness is None and event == DEATH):
        nearness, threshold = _limits(env, level), 1.0 if event == DEATH else None
    if nearness is None:
        raise ValueError(f"event={event!r} needs level=, a function that grows toward it, or a name of {sorted(LIMITS)}")
    return RareEvent(title, _checked("event", happens, torch.bool), _checked("level", nearness, torch.float64), threshold)


def _comparison(env: Tasking, text: str) -> tuple[str, Function, Function, float]:
    match = COMPARISON.fullmatch(text)
    try:
        name, sign, limit = match[1], match[2], float(match[3])  # type: ignore[index]
    except (TypeError, ValueError):
        hint = f"; {nearest(text, (DEATH,))}" if difflib.get_close_matches(text.lower(), (DEATH,)) else ""
        raise ValueError(
            f"event={text!r} must be 'death', or a property with a limit such as 'battery_charge_fraction<0.05'{hint}"
        ) from None
    kinds = [type(part.dynamics) for part in env.fleet.satellites]
    having = [k for k, kind in enumerate(kinds) if isinstance(getattr(kind, name, None), property)]
    if not having:
        names = {n for kind in kinds for n in dir(kind) if isinstance(getattr(kind, n, None), property)}
        raise ValueError(f"event={text!r}: {name!r} is not a property of the dynamics model; {nearest(name, names)}")
    toward = 1.0 if sign == ">" else -1.0

    def level(env: Tasking) -> Tensor:
        def of(satellite: BoundSatellite) -> Tensor:
            value = getattr(satellite.dynamics, name).double()
            return toward * value if value.ndim == 1 else (toward * value.flatten(1).abs()).amax(1)

        return _largest(env, having, of)

    return f"{name} {sign} {limit:g}", lambda env: level(env) > toward * limit, level, toward * limit


def _limits(env: Tasking, names: str | Sequence[str] | None) -> Function:
    """Return the largest nearness to the limits of some names, or of all that apply."""
    parts = env.fleet.satellites
    applying = {
        name: [k for k, part in enumerate(parts) if limit.check in part.aliveness() and limit.applies(part)]
        for name, limit in LIMITS.items()
    }
    applying = {name: having for name, having in applying.items() if having}
    selection = list(applying) if names is None else [names] if isinstance(names, str) else list(names)
    for name in selection:
        if name not in applying:
            raise ValueError(f"level={name!r} is not a limit of the satellites; {nearest(name, applying)}")
    if not selection:
        checks = sorted({check for part in parts for check in part.aliveness()})
        raise ValueError(f"none of the checks {checks} has a level that grows toward it; give level=, a function of env")
    terms = [(LIMITS[name].nearness, applying[name]) for name in selection]
    return lambda env: torch.stack([_largest(env, having, of) for of, having in terms]).amax(0)


def _largest(env: Tasking, having: Sequence[int], of: Callable[[BoundSatellite], Tensor]) -> Tensor:
    """Return the largest value [N] of the present satellites of the types ``having``."""
    none = -torch.inf
    parts = [
        of(part).double() if k in having else torch.full_like(part.simulator.sim_time, none)
        for k, part in enumerate(env.fleet.satellites)
    ]
    return torch.where(env.present, env.fleet.joined(parts), none).amax(1)


def _checked(argument: str, function: Function, dtype: torch.dtype) -> Function:
    """Return the function with checks of its results; ``argument`` names it in errors."""

    def result(env: Tasking) -> Tensor:
        value: Any = function(env)
        expected = f"a tensor [{env.num_envs}] of {'booleans' if dtype == torch.bool else 'numbers'}"
        fits = isinstance(value, Tensor) and value.shape == (env.num_envs,)
        if not fits or (value.dtype == torch.bool) != (dtype == torch.bool):
            description = f"{value.dtype} {list(value.shape)}" if isinstance(value, Tensor) else repr(value)
            raise ValueError(f"{argument}= must return {expected}; it returned {description:.80}")
        if bool(value.isnan().any()):
            raise ValueError(f"{argument}= must return {expected}; it returned NaN")
        return value.to(dtype)

    return result
