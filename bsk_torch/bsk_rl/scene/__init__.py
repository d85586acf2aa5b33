"""Scenarios: what there is for satellites to collect, at the place of ``bsk_rl.scene``."""

from typing import NoReturn

from bsk_torch.bsk_rl.scene.later import raise_for
from bsk_torch.bsk_rl.scene.rso_points import RSOPoints, SphericalRSO
from bsk_torch.bsk_rl.scene.scenario import Scenario, UniformNadirScanning
from bsk_torch.bsk_rl.scene.targets import CityTargets, UniformTargets

__all__ = ["CityTargets", "RSOPoints", "Scenario", "SphericalRSO", "UniformNadirScanning", "UniformTargets"]


def __getattr__(name: str) -> NoReturn:
    """Raise ImportError for names of bsk_rl that are not here yet, AttributeError for others."""
    raise_for(name, __name__)
