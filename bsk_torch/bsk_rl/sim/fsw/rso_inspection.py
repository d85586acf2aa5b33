"""Flight software of inspectors."""

from bsk_torch.bsk_rl.sim.fsw import RSOInspectorFSWModel

__all__ = ["RSOInspectorFSWModel"]
