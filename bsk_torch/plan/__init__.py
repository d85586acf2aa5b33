"""Planners: policies that fly copies of the present episodes before they decide."""

from bsk_torch.plan.bases import base_of
from bsk_torch.plan.beam import BeamSearch
from bsk_torch.plan.draws import redraw_clouds
from bsk_torch.plan.planner import Planner
from bsk_torch.plan.rollout import Rollout
from bsk_torch.plan.search import TreeSearch

__all__ = ["BeamSearch", "Planner", "Rollout", "TreeSearch", "base_of", "redraw_clouds"]
