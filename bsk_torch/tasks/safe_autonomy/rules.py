"""Rules for deputies that thrust close to a chief: dock along a glide slope, and inspect by flying to lit points.

They use the observations of :mod:`bsk_torch.tasks.safe_autonomy.preset_docking` and
:mod:`bsk_torch.tasks.safe_autonomy.preset_inspection`, and return forces.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

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


def column(value: float | Tensor, like: Tensor) -> Tensor:
    """Return a number, or one for each row [N], as a column, [1] or [N, 1], of the type of ``like``."""
    return torch.as_tensor(value, dtype=like.dtype, device=like.device).unsqueeze(-1)


def glide(
    observation: Tensor, description: Sequence[str], most: float, *, share: float | Tensor = SHARE, gain: float | Tensor = GAIN
) -> Tensor:
    """Return forces [N, 3] N, of at most ``most`` N, that lead straight to the chief at a ``share`` of the safe speed."""
    see = Columns(observation, description)
    r, v = see.all("rho_H"), see.all("rho_dot_H")
    wish = -column(share, r) * see["speed_limit"].unsqueeze(-1) * r / length(r)
    return (column(gain, r) * (wish - v)).clamp(-most, most)


def seek(
    observation: Tensor,
    description: Sequence[str],
    most: float,
    *,
    speed: float | Tensor = SPEED,
    distance: float | Tensor = DISTANCE,
    back: float | Tensor = RETURN,
    gain: float | Tensor = FIRM,
) -> Tensor:
    """Return forces [N, 3] N that lead around the chief, 60 m away, toward the nearest cluster of lit points, or stop.

    Args:
        observation: Observations, [N, F].
        description: Names of the F entries.
        most: Maximum force along each axis, N.
        speed: Speed around the chief, m/s; like the other numbers, one for all rows or for each, [N].
        distance: Distance from the chief, m.
        back: Speed of a return to this distance, 1/s.
        gain: Force for a velocity that differs from the wish, N s/m.
    """
    see = Columns(observation, description)
    r, v, goal = see.all("rho_H"), see.all("rho_dot_H"), see.all("nearest_cluster")
    outward = r / length(r)
    aside = goal - (goal * outward).sum(-1, keepdim=True) * outward
    turn = aside / length(aside) * (length(aside) > 0.02) * (goal.abs().sum(-1, keepdim=True) > 0.0)
    wish = column(speed, r) * turn + column(back, r) * (column(distance, r) - length(r)) * outward
    return (column(gain, r) * (wish - v)).clamp(-most, most)


def thruster_rule(rule: Callable[..., Tensor]) -> Callable[[SatelliteTasking, int], TensorDictModule]:
    """Return a function from environment and seed to a policy, with KeyError or ValueError if it does not apply.

    Args:
        rule: Function of the observation, the names of its entries and the maximum force, N. With the numbers of the rule as
            keyword arguments, the ``module`` of the policy can be given to :func:`bsk_torch.tune`.
    """

    def make(env: SatelliteTasking, seed: int = 0) -> TensorDictModule:
        entry, description = env.satellite.action_spec[0], env.satellite.observation_description
        if not isinstance(entry, HeldThrust):
            raise ValueError(f"the rule {rule.__name__!r} needs HeldThrust; the action is {entry!r}")
        decide = partial(rule, description=description, most=entry.max_thrust)
        decide(torch.zeros(1, len(description), dtype=torch.float32))
        return TensorDictModule(decide, in_keys=["observation"], out_keys=["action"])

    return make


glide_rule, seek_rule = thruster_rule(glide), thruster_rule(seek)
