"""One simulated tick of one satellite type: the function that is compiled.

State, parameters and flags cross its boundary as packs of planes [C, n] and are separate tensors inside, so that the whole tick
fuses into one loop over the batch. Compiled and eager ticks are the same source.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence

import torch
from torch import Tensor

from bsk_torch.sim.compiler import BACKENDS, compiled
from bsk_torch.sim.component import Bus, Component, Field, Layout
from bsk_torch.sim.dyn.field import prepare
from bsk_torch.sim.fsw.modes import FLAGS
from bsk_torch.sim.orbit import position_on_arc
from bsk_torch.sim.world import SEGMENT


def follow_arc(bus: Bus) -> None:
    """Take position and velocity at the end of the tick from the arc."""
    bus.r, bus.v = position_on_arc(bus.arc_nodes, bus.arc_first, bus.tau)


ARC_FIELDS = (Field("arc_nodes", 27), Field("arc_first", 1, "s"))
ARC_ORBIT = Component(slot="orbit", order=195, update=follow_arc)

Step = Callable[..., Tensor]

BATCHED = (True, False, True, True, True, False, True)
"""Which arguments of a step have a column for each row of the batch."""


class Tick:
    """The tick of a list of components, and the layouts of its packs.

    ``shared`` are the parameters that all environments have in common, ``own`` those that differ.
    """

    def __init__(
        self, components: Sequence[Component], shared: set[str], h: float, on_arc: bool, backend: str, dtype: torch.dtype
    ) -> None:
        """Lay out the packs of ``components``, which are in the order of a tick of ``h`` seconds, for tensors of ``dtype``."""
        if backend not in BACKENDS:
            raise ValueError(f"backend={backend!r} must be one of {list(BACKENDS)}")
        params = [field for component in components for field in component.params]
        self.components, self.h, self.on_arc = components, h, on_arc
        self.backend, self.dtype = backend, dtype
        self.state = Layout(field for component in components for field in component.state)
        self.shared = Layout(field for field in params if field.name in shared)
        self.own = Layout(field for field in params if field.name not in shared)
        self.flags = Layout(Field(name) for name in FLAGS)
        self.segment = Layout((*SEGMENT, *(ARC_FIELDS if on_arc else ())))
        self._updates = tuple(component.update for component in components if component.update)

    @property
    def make(self) -> Hashable:
        """What two ticks have in common that compile to the same code."""
        layouts = (tuple(layout.fields.items()) for layout in (self.state, self.shared, self.own, self.segment))
        return (*layouts, self._updates, self.h, self.dtype)

    def step(
        self, state: Tensor, shared: Tensor, own: Tensor, flags: Tensor, segment: Tensor, clock: Tensor, row: Tensor
    ) -> Tensor:
        """State [C, n] after one tick; rows whose time is up keep theirs, bit for bit.

        Args:
            state: State pack [C, n].
            shared: Shared parameters [C, 1].
            own: Own parameters [C, n].
            flags: Flags of the flight mode [C, n].
            segment: Sun, Earth and orbit around this time [C, n].
            clock: Seconds since the start of the segment and number of the tick within it, [2].
            row: Number of ticks to run in this segment, and whether a thruster pulse reaches the integrator, [2, n].
        """
        bus = Bus(self.h, compiled=self.backend == "compiled")
        packs = (self.state, state), (self.shared, shared), (self.own, own), (self.flags, flags), (self.segment, segment)
        for layout, pack in packs:
            layout.put(bus, pack)
        bus.tau, number = clock.unbind(0)
        ticks_left, bus.pulse_reaches = row.unbind(0)
        for update in self._updates:
            update(bus)
        runs = number <= ticks_left
        return torch.stack(
            [torch.where(runs, new, old) for new, old in zip(self.state.gather(bus), state.unbind(0), strict=True)]
        )


STEPS: dict[Hashable, Step] = {}
"""Compiled steps of this process: environments of the same make share one."""


def make_step(tick: Tick, device: torch.device) -> Step:
    """The tick's step under its back end."""
    if tick.backend == "eager":
        return tick.step
    if not tick.on_arc:
        prepare(device, tick.dtype)
    return STEPS.setdefault((tick.make, device.type), compiled(tick.step, "tick", BATCHED))
