"""Dynamics models of bsk_rl: those of the core, with bsk_rl's hooks; see :mod:`bsk_torch.bsk_rl.sim.models`."""

from bsk_torch.bsk_rl.sim.models import counterpart, counterparts
from bsk_torch.sim.dyn import (
    AtmosphericDragDynModel,
    BasicDynamicsModel,
    ConjunctionDynModel,
    ContinuousImagingDynModel,
    DisturbanceTorqueDynModel,
    DynamicsModel,
    EclipseDynModel,
    FullFeaturedDynModel,
    GroundStationDynModel,
    ImagingDynModel,
    LOSCommDynModel,
    MaxRangeDynModel,
)
from bsk_torch.tasks.inspection import RSODynModel, RSOInspectorDynModel
from bsk_torch.tasks.objects import SpaceToSpaceImagingDynModel


class RSOTargetDynModel(counterpart(BasicDynamicsModel)):  # type: ignore[misc]  # mypy: known when it runs
    """A satellite that others image; see :class:`bsk_torch.bsk_rl.scene.RSOTargets`. It flies with ``fsw.FSWModel``."""


DynamicsModelABC = DynamicsModel

__all__ = [
    "AtmosphericDragDynModel",
    "BasicDynamicsModel",
    "ConjunctionDynModel",
    "ContinuousImagingDynModel",
    "DisturbanceTorqueDynModel",
    "DynamicsModel",
    "DynamicsModelABC",
    "EclipseDynModel",
    "FullFeaturedDynModel",
    "GroundStationDynModel",
    "ImagingDynModel",
    "LOSCommDynModel",
    "MaxRangeDynModel",
    "RSODynModel",
    "RSOInspectorDynModel",
    "RSOTargetDynModel",
    "SpaceToSpaceImagingDynModel",
]

counterparts(__name__, __all__, "base", "ground_imaging", "relative_motion", "rso_imaging", "rso_inspection")
