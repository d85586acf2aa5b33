"""Dynamics of satellites that image others, and of their targets; counterpart of ``bsk_rl.sim.dyn.rso_imaging``."""

from bsk_torch.bsk_rl.sim.dyn import RSOTargetDynModel, SpaceToSpaceImagingDynModel

__all__ = ["RSOTargetDynModel", "SpaceToSpaceImagingDynModel"]
