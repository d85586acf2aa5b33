"""Rules: hand-written policies, and shields."""

from bsk_torch.rl.rules.baselines import BASELINES, Columns, random_policy, scan_rule
from bsk_torch.rl.rules.shield import RULES, SafeRule, find_rule, shield, shielded

__all__ = [
    "BASELINES",
    "RULES",
    "Columns",
    "SafeRule",
    "find_rule",
    "random_policy",
    "scan_rule",
    "shield",
    "shielded",
]
