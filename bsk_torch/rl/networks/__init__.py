"""Networks of policies and critics."""

from bsk_torch.rl.networks.normaliser import FeatureNormaliser, ObservationNormaliser
from bsk_torch.rl.networks.plans import PLANS, AttentionPlan, GRUPlan, MLPPlan, Networks

__all__ = ["PLANS", "AttentionPlan", "FeatureNormaliser", "GRUPlan", "MLPPlan", "Networks", "ObservationNormaliser"]
