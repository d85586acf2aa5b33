"""Evaluation of policies and analysis of their failures."""

from bsk_torch.rl.evaluation.evaluate import FRESH, Evaluation, evaluate, start_episodes
from bsk_torch.rl.evaluation.replay import Flown, fly
from bsk_torch.rl.evaluation.results import Comparison, compare, comparison_table
from bsk_torch.rl.evaluation.statistics import Estimate, confidence, wilson

__all__ = [
    "FRESH",
    "Comparison",
    "Estimate",
    "Evaluation",
    "Flown",
    "compare",
    "comparison_table",
    "confidence",
    "evaluate",
    "fly",
    "start_episodes",
    "wilson",
]
