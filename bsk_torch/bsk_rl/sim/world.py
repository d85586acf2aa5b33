"""World models of bsk_rl, which are those of the core."""

from bsk_torch.sim.world import AtmosphereWorldModel, EclipseWorldModel, GroundStationWorldModel, WorldModel

WorldModelABC = WorldModel

__all__ = ["AtmosphereWorldModel", "EclipseWorldModel", "GroundStationWorldModel", "WorldModel", "WorldModelABC"]
