"""Scenarios: what there is for satellites to collect; counterpart of ``bsk_rl.scene``."""

from bsk_torch.bsk_rl.later import not_yet
from bsk_torch.bsk_rl.scene.composition import MixedScenario
from bsk_torch.bsk_rl.scene.rso_points import RSOPoints, SphericalRSO
from bsk_torch.bsk_rl.scene.scenario import Scenario, UniformNadirScanning
from bsk_torch.bsk_rl.scene.targets import CityTargets, UniformTargets

__all__ = ["CityTargets", "MixedScenario", "RSOPoints", "Scenario", "SphericalRSO", "UniformNadirScanning", "UniformTargets"]

__getattr__ = not_yet(__name__)
