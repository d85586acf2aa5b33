"""What surrounds the spacecraft, as users read it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from torch import Tensor

from bsk_torch.astro.ephemeris import EARTH_ROTATION_RATE, earth_orientation, sun_position
from bsk_torch.sim.span import pole_matrix

if TYPE_CHECKING:
    from bsk_torch.sim.simulator import Simulator


class World:
    """What surrounds the spacecraft at the present time of each environment."""

    def __init__(self, simulator: Simulator) -> None:
        """Bind the world to a simulation."""
        self.simulator = simulator

    @property
    def et(self) -> Tensor:
        """Present time, [N] ET seconds past J2000, float64."""
        return self.simulator.arcs.et + self.simulator.sim_time

    @property
    def PN(self) -> Tensor:
        """DCM from N to the Earth-fixed frame, [N, 3, 3]."""
        return earth_orientation(self.et)

    @property
    def omega_PN_N(self) -> Tensor:
        """Rate of the Earth-fixed frame, [N, 3] rad/s in N."""
        pole = pole_matrix(self.et)
        return pole.z.stack() * EARTH_ROTATION_RATE

    @property
    def r_sun_N(self) -> Tensor:
        """Sun relative to the Earth, [N, 3] m in N."""
        return sun_position(self.et)

    @property
    def sun_direction_N(self) -> Tensor:
        """Direction from the Earth to the Sun, [N, 3] in N."""
        r = sun_position(self.et)
        return r / r.norm(dim=-1, keepdim=True)

    @property
    def stations(self) -> tuple[str, ...]:
        """Names of the ground stations, in the order of their indices."""
        data = self.simulator.world_args.given.get("groundStationsData", ())
        return tuple(f"GroundStation{s.get('name', k)}" for k, s in enumerate(data))
