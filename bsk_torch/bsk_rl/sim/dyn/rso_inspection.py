"""Dynamics models of inspections."""

from bsk_torch.bsk_rl.sim.dyn import RSODynModel, RSOInspectorDynModel

__all__ = ["RSODynModel", "RSOInspectorDynModel"]
