"""Scenarios: what there is for satellites to collect; counterpart of ``bsk_rl.scene``."""

from bsk_torch.bsk_rl.older import renamed_in
from bsk_torch.bsk_rl.scene.composition import MixedScenario
from bsk_torch.bsk_rl.scene.rso_points import RSOPoints, SphericalRSO
from bsk_torch.bsk_rl.scene.rso_targets import RSOPriorityEvent, RSOTarget, RSOTargetCatalog, RSOTargets
from bsk_torch.bsk_rl.scene.scenario import Scenario, UniformNadirScanning
from bsk_torch.bsk_rl.scene.targets import CityTargets, UniformTargets

__all__ = [
    "CityTargets",
    "MixedScenario",
    "RSOPoints",
    "RSOPriorityEvent",
    "RSOTarget",
    "RSOTargetCatalog",
    "RSOTargets",
    "Scenario",
    "SphericalRSO",
    "UniformNadirScanning",
    "UniformTargets",
]

__getattr__ = renamed_in(__name__)
