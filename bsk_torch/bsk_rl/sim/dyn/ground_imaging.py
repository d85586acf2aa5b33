"""Dynamics models with instruments."""

from bsk_torch.bsk_rl.sim.dyn import ContinuousImagingDynModel, GroundStationDynModel, ImagingDynModel

__all__ = ["ContinuousImagingDynModel", "GroundStationDynModel", "ImagingDynModel"]
