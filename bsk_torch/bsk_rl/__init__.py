"""bsk_rl on bsk_torch: the modules and names of bsk_rl 1.3.8, for one episode at a time.

Replace ``bsk_rl`` by ``bsk_torch.bsk_rl`` in a program's imports, and it runs on bsk_torch's simulation, with the episodes that
bsk_rl plays under the same seeds. ``docs/migration.md`` lists differences, and describes how to play
thousands of episodes at once.
"""

from typing import Any

import gymnasium

from bsk_torch.bsk_rl.gym import NO_ACTION, ConstellationTasking, GeneralSatelliteTasking, SatelliteTasking
from bsk_torch.bsk_rl.older import renamed_in

__all__ = ["NO_ACTION", "ConstellationTasking", "GeneralSatelliteTasking", "SatelliteTasking"]


def _vector_form(*args: Any) -> Any:
    from bsk_torch.bsk_rl.vector import vector_form  # which programs of single environments need not load

    return vector_form(*args)


GeneralSatelliteTasking._vector_form = staticmethod(_vector_form)

for _made in (GeneralSatelliteTasking, SatelliteTasking, ConstellationTasking):
    _place = f"bsk_torch.bsk_rl.gym:{_made.__name__}"
    gymnasium.registry.pop(f"{_made.__name__}-v1", None)  # bsk_torch's own view of that name
    gymnasium.register(
        id=f"{_made.__name__}-v1",
        entry_point=_place,
        vector_entry_point="bsk_torch.bsk_rl.vector:reject_agents" if _made is ConstellationTasking else _place,
    )

__getattr__ = renamed_in(__name__)
