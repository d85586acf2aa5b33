"""Flight software of satellites that image others; counterpart of ``bsk_rl.sim.fsw.rso_imaging``."""

from bsk_torch.tasks.objects import SpaceToSpaceImagingFSWModel

__all__ = ["SpaceToSpaceImagingFSWModel"]
