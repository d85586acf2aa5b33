"""Flight software of satellites that image others; counterpart of ``bsk_rl.sim.fsw.rso_imaging``."""

from bsk_torch.bsk_rl.sim.fsw import SpaceToSpaceImagingFSWModel

__all__ = ["SpaceToSpaceImagingFSWModel"]
