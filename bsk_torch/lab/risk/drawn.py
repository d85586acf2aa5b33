"""Numbers drawn for the arguments of satellites and world: of current episodes, or of seeds without a reset."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import torch
from torch import Tensor

from bsk_torch.astro.ephemeris import sun_position
from bsk_torch.astro.orbit import Elements, elements_to_rv, hill_frame
from bsk_torch.env import Tasking
from bsk_torch.rand import Key
from bsk_torch.vec3 import Vec3

COMPONENTS = {"oe": Elements._fields}
"""Names of the components of arguments; others are numbered."""

ELEMENTS, EPOCH = "oe", "utc_init"
"""Names of the orbital elements and of the epoch."""


def drawn_arguments(env: Tasking) -> tuple[list[str], Tensor]:
    """Return the names and values [N, D] of the numbers drawn for the arguments of satellites and world at reset."""
    return _columns(env, [part.simulator.state.all_arguments for part in env.fleet.satellites], env.num_envs)


def drawn_of_seeds(env: Tasking, seeds: Tensor) -> tuple[list[str], Tensor]:
    """Return what :func:`drawn_arguments` returns after a reset to ``seeds`` [m], without one: names, and values [m, D].

    They are those of the first episodes of environment 0, which :func:`bsk_torch.rl.evaluation.evaluate.start_episodes` starts.
    """
    none = torch.zeros_like(seeds)
    return _columns(env, env.builder.draw_arguments(env.fleet, Key(seeds, none, none)), len(seeds))


def _columns(env: Tasking, values: Sequence[Mapping[str, Tensor]], n: int) -> tuple[list[str], Tensor]:
    """Return names and values [n, D] of the random ones among the arguments of ``n`` episodes, given for each type."""
    series: dict[str, Tensor] = {}
    for part, draws in zip(env.fleet.satellites, values, strict=True):
        simulator, arguments = part.simulator, part.simulator.type.arguments
        for table, owned in ((arguments.sat_args, env.fleet.size > 1), (arguments.world_args, False)):
            for name in table.table:
                if name in table.random and name in simulator.state.arguments:
                    value = draws[name].double()
                    flat = value.expand(n * simulator.count, *value.shape[1:]).reshape(n, simulator.count, -1)
                    for k, column in enumerate(simulator.columns if owned else simulator.columns[:1]):
                        owner = f"{env.names[column]}: " if owned else ""
                        series |= {f"{owner}{name}{_component(name, j, flat.shape[2])}": c for j, c in enumerate(flat[:, k].T)}
    values_of = torch.stack(list(series.values()), 1) if series else torch.zeros(n, 0, dtype=torch.float64)
    return list(series), values_of


def _component(name: str, j: int, count: int) -> str:
    if count == 1:
        return ""
    components = COMPONENTS.get(name, ())
    return f".{components[j]}" if len(components) == count else f"[{j}]"


def suns(names: Sequence[str], drawn: Tensor) -> Tensor:
    """Return the directions of the Sun at reset in the Hill frames of all satellites with drawn orbits, [m, 3 * satellites].

    Eclipses and the power of panels follow from them, which no single drawn number shows.
    """
    columns = dict(zip(names, drawn.T, strict=True))
    ends = [f"{ELEMENTS}.{end}" for end in COMPONENTS[ELEMENTS]]
    owners = [name.removesuffix(ends[0]) for name in names if name.endswith(ends[0])]
    if EPOCH not in columns or not owners:
        return drawn[:, :0]
    sun, directions = Vec3(*sun_position(columns[EPOCH].contiguous()).T).unit(), list[Tensor]()
    for owner in owners:
        frame = hill_frame(*elements_to_rv(Elements(*(columns[owner + end] for end in ends))))
        directions += [*(frame @ sun)]
    return torch.stack(directions, 1)
