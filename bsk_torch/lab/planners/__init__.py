"""Planners, policies that simulate copies of the current episodes before each decision, and bounds on returns."""

from bsk_torch.lab.planners.base_policies import base_of
from bsk_torch.lab.planners.beam import BeamSearch
from bsk_torch.lab.planners.cross_entropy import CrossEntropy
from bsk_torch.lab.planners.names import PLANNERS, planner
from bsk_torch.lab.planners.planner import Planner
from bsk_torch.lab.planners.rollout import ActionValues, Rollout
from bsk_torch.lab.planners.search import TreeSearch

__all__ = [
    "PLANNERS",
    "ActionValues",
    "BeamSearch",
    "CrossEntropy",
    "Planner",
    "Rollout",
    "TreeSearch",
    "base_of",
    "planner",
]
