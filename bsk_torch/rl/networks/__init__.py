"""Networks of policies and critics."""

from typing import TYPE_CHECKING

from bsk_torch._deprecated import deprecated_names
from bsk_torch.rl.networks.normaliser import FeatureNormaliser, ObservationNormaliser
from bsk_torch.rl.networks.plans import PLANS, AttentionPlan, GRUPlan, MLPPlan, Networks

__all__ = ["PLANS", "AttentionPlan", "FeatureNormaliser", "GRUPlan", "MLPPlan", "Networks", "ObservationNormaliser"]

if not TYPE_CHECKING:
    __getattr__ = deprecated_names(__name__)
