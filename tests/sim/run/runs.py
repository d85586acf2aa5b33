"""Starts of runs: everything that a runner needs beside the number of ticks."""

from dataclasses import dataclass

from torch import Tensor

from bsk_torch.codegen.kernel import Kernel, Samples
from bsk_torch.sim.simulator import Simulator
from bsk_torch.sim.tick.runners import TickLoop


@dataclass(frozen=True)
class Start:
    """Arguments of what runs ticks."""

    state: Tensor
    shared: Tensor
    own: Tensor
    mode: Tensor
    flags: Tensor
    ticks: Tensor
    tracks: tuple[Samples, ...]
    nanoseconds: int
    expected_ticks: Tensor | None = None
    lockstep: int = 1
    present: Tensor | None = None

    def run(self, runner: Kernel | TickLoop, counts: Tensor) -> Tensor:
        """Run from here, which changes ``state``; returns the number of ticks of each row."""
        names = ("expected_ticks", "shared", "own", "mode", "flags", "ticks", "nanoseconds", "lockstep", "present")
        return runner(self.state, counts, self.tracks, **{name: getattr(self, name) for name in names})


def start_of(simulator: Simulator) -> Start:
    """The start of a run of a simulation, with a copy of its state."""
    state, tracks = simulator.state, simulator.lookahead.arcs.tracks(simulator.tick.tracks)
    packs = state.planes.clone(), simulator.uniform, state.parameters, state.mode, simulator.flag_table, state.ticks
    return Start(*packs, tracks, simulator.h_ns)
