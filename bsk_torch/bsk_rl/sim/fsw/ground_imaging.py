"""Flight software with instruments."""

from bsk_torch.bsk_rl.sim.fsw import ContinuousImagingFSWModel, ImagingFSWModel, SteeringImagerFSWModel

__all__ = ["ContinuousImagingFSWModel", "ImagingFSWModel", "SteeringImagerFSWModel"]
