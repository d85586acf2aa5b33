"""Scenarios: the tasks of the satellites."""

from bsk_torch.scene.base import Scenario, UniformNadirScanning
from bsk_torch.scene.cities import CityTargets
from bsk_torch.scene.explicit import Targets
from bsk_torch.scene.mixed import MixedScenario
from bsk_torch.scene.overlaid import CloudyTargets, StripTargets, UncertainTargets
from bsk_torch.scene.requests import Requests
from bsk_torch.scene.targets import ChangingTargets, Target, TargetScenario
from bsk_torch.scene.uniform import UniformTargets
from bsk_torch.scene.wildfires import Wildfires

__all__ = [
    "ChangingTargets",
    "CityTargets",
    "CloudyTargets",
    "MixedScenario",
    "Requests",
    "Scenario",
    "StripTargets",
    "Target",
    "TargetScenario",
    "Targets",
    "UncertainTargets",
    "UniformNadirScanning",
    "UniformTargets",
    "Wildfires",
]
