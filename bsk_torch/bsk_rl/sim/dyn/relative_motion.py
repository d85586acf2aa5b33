"""Dynamics models of satellites that see, meet or follow others."""

from bsk_torch.bsk_rl.sim.dyn import ConjunctionDynModel, LOSCommDynModel, MaxRangeDynModel

__all__ = ["ConjunctionDynModel", "LOSCommDynModel", "MaxRangeDynModel"]
