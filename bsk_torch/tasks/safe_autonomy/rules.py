"""Rules for deputies that thrust close to a chief: dock along a glide slope, and inspect by flying to lit points.

They use the observations of :mod:`bsk_torch.tasks.safe_autonomy.preset_docking` and
:mod:`bsk_torch.tasks.safe_autonomy.preset_inspection`, and return forces.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from tensordict.nn import TensorDictModule
from torch import Tensor

from bsk_torch.env import SatelliteTasking
from bsk_torch.rl.rules.observation_columns import Columns
from bsk_torch.tasks.safe_autonomy.act import HeldThrust

GAIN, FIRM = 6.0, 1.5
"""Force for a velocity that differs from the wish, N s/m, in docking and in inspections, whose decisions are longer."""

SHARE = 0.8
"""Share of the safe speed at which the deputy approaches."""

DISTANCE, RETURN = 60.0, 0.01
"""Distance from the chief in an inspection, m, and speed of a return to it per distance, 1/s."""

SPEED = 0.22
"""Speed of flights around the chief, m/s; the safe speed at 60 m is 0.29 m/s."""


def length(vector: Tensor) -> Tensor:
    """Return the lengths of vectors [..., 3], [..., 1]; at least 1e-9."""
    return torch.linalg.vector_norm(vector, dim=-1, keepdim=True).clamp(min=1e-9)


def glide(see: Columns, most: float) -> Tensor:
    """Return forces [N, 3] N that lead straight to the chief at a share of the safe speed."""
    r, v = see.all("rho_H"), see.all("rho_dot_H")
    wish = -SHARE * see["speed_limit"].unsqueeze(-1) * r / length(r)
    return (GAIN * (wish - v)).clamp(-most, most)


def seek(see: Columns, most: float) -> Tensor:
    """Return forces [N, 3] N that lead around the chief, 60 m away, toward the nearest cluster of lit points, or stop."""
    r, v, goal = see.all("rho_H"), see.all("rho_dot_H"), see.all("nearest_cluster")
    outward = r / length(r)
    aside = goal - (goal * outward).sum(-1, keepdim=True) * outward
    turn = aside / length(aside) * (length(aside) > 0.02) * (goal.abs().sum(-1, keepdim=True) > 0.0)
    wish = SPEED * turn + RETURN * (DISTANCE - length(r)) * outward
    return (FIRM * (wish - v)).clamp(-most, most)


def thruster_rule(rule: Callable[[Columns, float], Tensor]) -> Callable[[SatelliteTasking, int], TensorDictModule]:
    """Return a function from environment and seed to a policy, with KeyError or ValueError if it does not apply.

    Args:
        rule: Function of the observed columns and the maximum force, N.
    """

    def make(env: SatelliteTasking, seed: int = 0) -> TensorDictModule:
        entry, description = env.satellite.action_spec[0], env.satellite.observation_description
        if not isinstance(entry, HeldThrust):
            raise ValueError(f"the rule {rule.__name__!r} needs HeldThrust; the action is {entry!r}")
        most = entry.max_thrust
        rule(Columns(torch.zeros(1, len(description), dtype=torch.float32), description), most)
        return TensorDictModule(
            lambda observation: rule(Columns(observation, description), most), in_keys=["observation"], out_keys=["action"]
        )

    return make


glide_rule, seek_rule = thruster_rule(glide), thruster_rule(seek)
