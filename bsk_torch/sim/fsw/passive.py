"""Flight software of passive satellites: none. Debris, upper stages and dead satellites tumble as rigid bodies do."""

from __future__ import annotations

from typing import ClassVar

from bsk_torch.sim.component import Component
from bsk_torch.sim.fsw import imposed
from bsk_torch.sim.fsw.models import FSWModel
from bsk_torch.sim.fsw.modes import Mode

NO_GUIDANCE = Component(slot="nadir_pointing")
"""Nothing in the slot: for satellites that point nowhere."""


class TumblingFSWModel(FSWModel):
    """A passive satellite, rotated only by external torques.

    Its attitude starts from ``sigma_init`` and ``omega_init`` and follows Euler's equation ``I omega' = L - omega x (I omega)``
    with the inertia ``I`` of a uniform box of ``mass``, ``width``, ``depth`` and ``height``, or ``inertia`` (Schaub and Junkins,
    section 4.2). ``L`` is zero without disturbance or drag. Its only command is ``drift``. BSK-RL has no such model: it
    imposes the attitudes of satellites without actuators, see :class:`FSWModel`.
    """

    components: ClassVar[tuple[Component, ...]] = (imposed.ACTUATORS, NO_GUIDANCE)
    modes: ClassVar[dict[str, Mode | None]] = {"nadir_point": None}
