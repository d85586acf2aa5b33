"""Dynamics models without instruments."""

from bsk_torch.bsk_rl.sim.dyn import (
    AtmosphericDragDynModel,
    BasicDynamicsModel,
    DisturbanceTorqueDynModel,
    DynamicsModel,
    DynamicsModelABC,
    EclipseDynModel,
)

__all__ = [
    "AtmosphericDragDynModel",
    "BasicDynamicsModel",
    "DisturbanceTorqueDynModel",
    "DynamicsModel",
    "DynamicsModelABC",
    "EclipseDynModel",
]
