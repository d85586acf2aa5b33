"""Dynamics of satellites that image others, and of their targets; counterpart of ``bsk_rl.sim.dyn.rso_imaging``."""

from bsk_torch.sim.dyn import BasicDynamicsModel
from bsk_torch.tasks.objects import SpaceToSpaceImagingDynModel

__all__ = ["RSOTargetDynModel", "SpaceToSpaceImagingDynModel"]


class RSOTargetDynModel(BasicDynamicsModel):
    """A satellite that others image; see :class:`bsk_torch.bsk_rl.scene.RSOTargets`. It flies with ``fsw.FSWModel``."""
