"""World models of bsk_rl: those of the core, with bsk_rl's hooks; see :mod:`bsk_torch.bsk_rl.sim.models`."""

from bsk_torch.bsk_rl.older import renamed_in
from bsk_torch.bsk_rl.sim.models import counterparts
from bsk_torch.sim.world import AtmosphereWorldModel, EclipseWorldModel, GroundStationWorldModel, WorldModel

WorldModelABC = WorldModel

__all__ = ["AtmosphereWorldModel", "EclipseWorldModel", "GroundStationWorldModel", "WorldModel", "WorldModelABC"]

counterparts(__name__, __all__)

__getattr__ = renamed_in(__name__)
