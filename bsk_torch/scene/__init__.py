"""Scenarios: the tasks of the satellites."""

from bsk_torch.scene.base import Scenario
from bsk_torch.scene.cities import CityTargets
from bsk_torch.scene.clouds import CloudyTargets
from bsk_torch.scene.explicit import Targets
from bsk_torch.scene.mixed import MixedScenario
from bsk_torch.scene.scanning import UniformNadirScanning
from bsk_torch.scene.strips import StripTargets
from bsk_torch.scene.target import Target
from bsk_torch.scene.targets import ChangingTargets, TargetScenario
from bsk_torch.scene.uncertain import UncertainTargets
from bsk_torch.scene.uniform import UniformTargets
from bsk_torch.scene.wildfires import Wildfires

__all__ = [
    "ChangingTargets",
    "CityTargets",
    "CloudyTargets",
    "MixedScenario",
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
