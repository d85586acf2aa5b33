"""Planners, policies that simulate copies of the current episodes before each decision, and bounds on returns."""

from bsk_torch.plan.action_values import ActionValues
from bsk_torch.plan.base_policies import base_of
from bsk_torch.plan.beam import BeamSearch
from bsk_torch.plan.cross_entropy import CrossEntropy
from bsk_torch.plan.names import PLANNERS, planner
from bsk_torch.plan.planner import Planner
from bsk_torch.plan.resampling import redraw_clouds
from bsk_torch.plan.rollout import Rollout
from bsk_torch.plan.search import TreeSearch

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
    "redraw_clouds",
]
