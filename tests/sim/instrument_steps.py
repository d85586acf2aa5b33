"""Steps of a satellite with several instruments next to those of satellites with one of them."""

from collections.abc import Callable, Sequence

import torch

from bsk_torch import SatelliteTasking
from bsk_torch.sim.simulator import Simulator


def choose(env: SatelliteTasking, number: int) -> None:
    """Choose an instrument in all environments."""
    n = len(env.env_ids)
    env.simulator.write("instrument_index", torch.ones(n, dtype=torch.bool), torch.full((n,), float(number)))


def assert_steps_are_equal(
    both: SatelliteTasking,
    alone: Sequence[SatelliteTasking],
    numbers: Sequence[int],
    ticks: int,
    command: Callable[[Simulator, int], None],
) -> list[bool]:
    """Run ``both`` with instrument after instrument, and ``alone[number]`` from the same state; return whether data grew.

    ``command(simulator, step)`` commands a step, of ``ticks``.
    """
    mine, layout = both.simulator, alone[0].simulator.state.layout
    before, different = mine.read("storage"), []
    for step, number in enumerate(numbers):
        choose(both, number)
        other = alone[number].simulator
        for name in layout.fields:  # the same state
            other.state.planes[layout.slices[name]] = mine.state.planes[mine.state.layout.slices[name]]
        other.state.ticks = mine.ticks.clone()
        for simulator in (mine, other):
            command(simulator, step)
            simulator.run(torch.full_like(simulator.ticks, ticks))
        different += [(step, name) for name in layout.fields if not torch.equal(mine.read(name), other.read(name))]
    assert not different
    return (mine.read("storage") > before).tolist()
