"""Docking and inspection by thrusters in linear relative motion, with the assurance filters of AFRL's safe-autonomy-sims."""

from bsk_torch.tasks.safe_autonomy.act import HeldThrust
from bsk_torch.tasks.safe_autonomy.dyn import DockingDynModel, LinearInspectorDynModel, LinearMotionDynModel

__all__ = ["DockingDynModel", "HeldThrust", "LinearInspectorDynModel", "LinearMotionDynModel"]
