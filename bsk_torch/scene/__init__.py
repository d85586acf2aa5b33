"""Scenarios: the tasks of the satellites."""

from bsk_torch.scene.aeos_bench import AEOSBench
from bsk_torch.scene.aeos_files import Cases, read_cases
from bsk_torch.scene.aeos_generator import AEOSBenchGenerator
from bsk_torch.scene.aeos_writing import write_cases
from bsk_torch.scene.base import Scenario
from bsk_torch.scene.cities import CityTargets
from bsk_torch.scene.clouds import CloudyTargets
from bsk_torch.scene.explicit import Targets
from bsk_torch.scene.mixed import MixedScenario
from bsk_torch.scene.rso_catalog import RandomRSOCatalog, RSOPriorityEvent, RSOTarget, RSOTargetCatalog
from bsk_torch.scene.rso_mixture import RSOMixture
from bsk_torch.scene.rso_order import by_priority_per_second, by_priority_per_second_ahead
from bsk_torch.scene.rso_points import RSOPoint, RSOPoints, SphericalRSO
from bsk_torch.scene.rso_targets import Order, RSOTargets
from bsk_torch.scene.scanning import UniformNadirScanning
from bsk_torch.scene.strips import StripTargets
from bsk_torch.scene.target import Target
from bsk_torch.scene.targets import ChangingTargets, TargetScenario
from bsk_torch.scene.uncertain import UncertainTargets
from bsk_torch.scene.uniform import UniformTargets
from bsk_torch.scene.wildfires import Wildfires

__all__ = [
    "AEOSBench",
    "AEOSBenchGenerator",
    "Cases",
    "ChangingTargets",
    "CityTargets",
    "CloudyTargets",
    "MixedScenario",
    "Order",
    "RSOMixture",
    "RSOPoint",
    "RSOPoints",
    "RSOPriorityEvent",
    "RSOTarget",
    "RSOTargetCatalog",
    "RSOTargets",
    "RandomRSOCatalog",
    "Scenario",
    "SphericalRSO",
    "StripTargets",
    "Target",
    "TargetScenario",
    "Targets",
    "UncertainTargets",
    "UniformNadirScanning",
    "UniformTargets",
    "Wildfires",
    "by_priority_per_second",
    "by_priority_per_second_ahead",
    "read_cases",
    "write_cases",
]
