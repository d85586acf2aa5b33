"""Sun, Earth and ground stations at the current time, as users read them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from torch import Tensor

from bsk_torch.astro.ephemeris import EARTH_ROTATION_RATE, sun_position, sun_state
from bsk_torch.sim.environment.world import station_names
from bsk_torch.sim.orbit.arcs import Arcs
from bsk_torch.sim.satellite_state import SatelliteState


class World:
    """Sun, Earth and ground stations at the current time of each environment."""

    def __init__(self, state: SatelliteState, arcs: Arcs, stations: Sequence[Mapping[str, object]] = ()) -> None:
        self._state, self._arcs, self._stations = state, arcs, stations

    @property
    def et(self) -> Tensor:
        """Present time, [N] ET seconds past J2000, float64."""
        return self._arcs.et + self._state.sim_time

    @property
    def PN(self) -> Tensor:
        """DCM from N to the Earth-fixed frame, [N, 3, 3]."""
        return self._arcs.solver.earth.orientation(self.et)

    @property
    def omega_PN_N(self) -> Tensor:
        """Rate of the Earth-fixed frame, [N, 3] rad/s in N."""
        pole = self._arcs.solver.earth.pole(self.et)
        return pole.z.stack() * EARTH_ROTATION_RATE

    @property
    def r_SN_N(self) -> Tensor:
        """Sun relative to the Earth, [N, 3] m in N."""
        return sun_position(self.et)

    @property
    def v_SN_N(self) -> Tensor:
        """Velocity of the Sun relative to the Earth, [N, 3] m/s in N."""
        return sun_state(self.et)[1]

    @property
    def sun_direction_N(self) -> Tensor:
        """Direction from the Earth to the Sun, [N, 3] in N."""
        r = sun_position(self.et)
        return r / r.norm(dim=-1, keepdim=True)

    @property
    def stations(self) -> tuple[str, ...]:
        """Names of the ground stations, in the order of their indices."""
        return station_names(self._stations)
