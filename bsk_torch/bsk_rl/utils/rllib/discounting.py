"""Value targets of steps of different length; counterpart of ``bsk_rl.utils.rllib.discounting``."""

from __future__ import annotations

from typing import Literal

import numpy as np

from bsk_torch.bsk_rl.older import advising

ADVICE = (
    "is a part of RLlib's learner, which bsk_torch does not have. Its own PPO and MAPPO discount by seconds ('bsk-torch train'), "
    "and compute_value_targets_time_discounted serves other learners"
)

LEARNERS = (
    "ContinuePreviousAction",
    "ContinuePreviousActionAppended",
    "MakeAddedStepActionValid",
    "CondenseMultiStepActions",
    "TimeDiscountedGAEPPOLearner",
    "TimeDiscountedGAEPPOTorchLearner",
    "TimeDiscountedGAEPPOTfLearner",
)
"""Names of bsk_rl that are parts of RLlib's learners and their pipelines."""


def compute_value_targets_time_discounted(
    values: np.ndarray,
    rewards: np.ndarray,
    terminateds: np.ndarray,
    truncateds: np.ndarray,
    step_durations: np.ndarray,
    gamma: float,
    lambda_: float,
    reward_time: Literal["step_start", "step_end"] = "step_end",
) -> np.ndarray:
    """Return value targets [T], float32, of steps that last different times, by generalized advantage estimation.

    Going backwards, with the discount ``d_t = gamma ** duration_t`` of a step and the value v after it::

        step_start:  R_t = r_t + d_t ((1 - lambda) v_{t+1} + lambda R_{t+1})
        step_end:    R_t = d_t (r_t + (1 - lambda) v_{t+1} + lambda R_{t+1})

    Values of steps in which an episode has terminated count as zero, and R continues from ``v_t`` before one that was truncated.
    Steps of several episodes follow one another.

    Args:
        values: Predicted values of the observations at which the steps begin.
        rewards: Rewards of the steps.
        terminateds: Whether the episode terminates in a step.
        truncateds: Whether it is truncated in a step.
        step_durations: ``info["d_ts"]`` of the observations at which the steps begin, s: the durations of the steps before.
        gamma: Discount per second.
        lambda_: Weight of later values.
        reward_time: Whether a reward comes when its step begins or ends.
    """
    if reward_time not in ("step_start", "step_end"):
        raise ValueError(f"reward_time={reward_time!r} must be 'step_start' or 'step_end'")
    durations = np.append(step_durations[1:], step_durations[-1])
    discounts, going = gamma**durations, 1.0 - np.asarray(terminateds, dtype=float)
    following = np.append(values * going, 0.0)
    after = (1.0 - lambda_) * following[1:]
    gains = rewards + discounts * after if reward_time == "step_start" else discounts * (rewards + after)
    targets, last = np.zeros(len(gains)), 0.0
    for t in reversed(range(len(gains))):
        targets[t] = gains[t] + going[t] * discounts[t] * lambda_ * last
        last = following[t] if truncateds[t] else targets[t]
    return targets.astype(np.float32)


__getattr__ = advising(__name__, dict.fromkeys(LEARNERS, ADVICE))
