"""Flight software without instruments."""

from bsk_torch.bsk_rl.sim.fsw import BasicFSWModel, FSWModel, FSWModelABC, SteeringFSWModel, Task, action

__all__ = ["BasicFSWModel", "FSWModel", "FSWModelABC", "SteeringFSWModel", "Task", "action"]
