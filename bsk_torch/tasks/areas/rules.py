"""A rule for Areas-v1: scan when an area is within reach that is worth the data, and charge otherwise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from tensordict.nn import TensorDictModule
from torch import Tensor
from typing_extensions import override

from bsk_torch.env import SatelliteTasking
from bsk_torch.rl.rules.baselines import ScanRule, scan_rule
from bsk_torch.rl.rules.observation_columns import Columns
from bsk_torch.tasks.areas.obs import HORIZON, INTERVALS

USUAL = 0.06
"""What scans would bring per minute in Areas-v1, on average."""


@dataclass(frozen=True)
class AreaRule(ScanRule):
    """Scans areas, and charges where there is nothing else to do.

    Thresholds of the base class keep their meaning. The defaults are the best of seven searches of 64 or 128 settings, the later
    ones around the best of the one before, in 38,400 episodes of Areas-v1, rounded.

    Args:
        lead: Time before a window opens at which the turn to nadir begins, s.
        least: Weight of what a scan would record for which an empty store is used.
        scarce: By how much more it must be with a full store.
        rich: By how much more it must be for each unit of what scans would bring per minute in the observed outlook, or usually.
    """

    fast: float = 0.208
    low: float = 0.0684
    enough: float = 0.211
    facing: float = 0.0564
    worth: float = 0.142
    full: float = 0.975
    lead: float = 90.1
    least: float = 0.0126
    scarce: float = 0.135
    rich: float = 1.34

    @override
    def decide(self, observation: Tensor, description: Sequence[str], actions: Sequence[str]) -> Tensor:
        wish = super().decide(observation, description, actions)
        see = Columns(observation, description)
        lead = torch.as_tensor(self.lead, dtype=observation.dtype, device=observation.device).unsqueeze(-1)  # or one for each row
        soon = see.all("opens") * HORIZON <= lead
        brings = torch.where(soon, see.all("weight") * see.all("gain"), 0.0).amax(-1)
        ahead = see.all("worth").sum(-1) * (60.0 / sum(INTERVALS)) if "outlook.worth[0]" in description else USUAL
        idle = brings <= self.least + self.scarce * see["storage_level_fraction"] + self.rich * ahead
        return torch.where(idle & (wish == actions.index("action_nadir_scan")), actions.index("action_charge"), wish)


def area_rule(env: SatelliteTasking, seed: int = 0) -> TensorDictModule:
    """Return an :class:`AreaRule` for observations and actions like those of Areas-v1; else KeyError or ValueError."""
    return scan_rule(env, seed, AreaRule())
