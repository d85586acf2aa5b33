"""A policy beside random actions and the rules on fresh episodes, for the scripts that train with other libraries."""

from __future__ import annotations

from tensordict.nn import TensorDictModuleBase

from bsk_torch.env import SatelliteTasking
from bsk_torch.rl.baselines import BASELINES
from bsk_torch.rl.evaluate import FRESH, Evaluation, evaluate


def compare(name: str, policy: TensorDictModuleBase, env: SatelliteTasking, seed: int) -> dict[str, Evaluation]:
    """Results of a policy trained with ``seed``, and of every baseline that fits, in the same fresh episodes, by name."""
    policies: dict[str, TensorDictModuleBase] = {name: policy}
    for rule, baseline in BASELINES.items():
        try:
            policies[rule] = baseline(env, seed)
        except (KeyError, ValueError):  # a rule for other observations or actions
            continue
    return {key: evaluate(player, env, seed=seed + FRESH) for key, player in policies.items()}


def table(results: dict[str, Evaluation]) -> str:
    """Markdown table of returns with 95 % confidence intervals and survival."""
    rows = [f"| {name} | {result.mean_return} | {result.survival:.1%} |" for name, result in results.items()]
    return "\n".join(["| policy | return | survival |", "|---|---|---|", *rows])
