"""Whether a training was worth it: its policy against the best rule, and what is known to be better."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping

from bsk_torch._listed import REMARKS, makings, scores
from bsk_torch.rl.evaluation.evaluate import Evaluation
from bsk_torch.rl.evaluation.results import TRAINED
from bsk_torch.rl.training.config import SECONDS, PPOConfig
from bsk_torch.tables import line_width

SHARE = 0.1
"""Fraction of the training time, :data:`~bsk_torch.rl.training.config.SECONDS` at least, for the comparison at its end."""

FEWEST, MOST = 32, 256
"""Bounds of the number of its episodes."""

OTHERS = (TRAINED, "untrained", "random")
"""Names in results that are not rules."""


def compared_episodes(config: PPOConfig) -> int:
    """Return the number of unseen episodes of the comparison after a training, a power of two.

    All measured rules, the untrained and the trained policy play as many in :data:`SHARE` of the training time, which follows for
    a number of decisions from the speed of the published training.
    """
    entry, published = scores().get(config.preset), makings().get(config.preset)
    if entry is None:
        return MOST
    seconds = config.clock
    if seconds is None:
        seconds = (config.frames or 0) * published["seconds"] / published["frames"] if published else SECONDS
    costs = [row["core_seconds"] / entry["episodes"] for row in entry["policies"].values()]
    affordable = SHARE * max(seconds, SECONDS) / (sum(costs) + 2.0 * max(costs))
    return min(MOST, max(FEWEST, 1 << max(0, int(affordable).bit_length() - 1)))


def verdict(results: Mapping[str, Evaluation], preset: str) -> str:
    """Return whether the trained policy is better than the best rule in the same episodes, and else what is, to be printed last.

    The best rule is the one with the highest mean in these episodes, which favors it a little. An empty text without rules.
    """
    rules = {name: result for name, result in results.items() if name not in OTHERS}
    if not rules:
        return ""
    best = max(rules, key=lambda name: rules[name].mean_return.mean)
    trained, gain = results[TRAINED], results[TRAINED].gain_over(rules[best])
    numbers = (
        f"{trained.mean_return.mean:.3f} against {rules[best].mean_return.mean:.3f}, a gain of {gain} in {len(trained.returns)} "
        "unseen episodes"
    )
    if gain.mean > gain.half_width:
        return wrapped(f"verdict: the policy is better than the best rule, {best}: {numbers}")
    better = "is better than the policy" if -gain.mean > gain.half_width else "may be as good as the policy or better"
    advice, *command = remedy(preset, best)
    return "\n".join((wrapped(f"verdict: the rule {best} {better}: {numbers}; {advice}"), *command))


def wrapped(text: str) -> str:
    """Return a text in lines that fit the terminal."""
    return textwrap.fill(text, line_width(), break_on_hyphens=False)


def remedy(preset: str, rule: str) -> tuple[str, ...]:
    """Return what is better than the rules of a preset by :func:`~bsk_torch._listed.scores`, and the command, if any."""
    entry, published = scores().get(preset), makings().get(preset)
    if entry is None:
        return (f"train longer (--minutes), or imitate the rule at the start (imitate={rule})",)
    if published is None:
        return (REMARKS.get(preset, f"no training is known to do better in {preset}: use the rule"),)
    gain = f"{entry['gain']['mean']:+.3g} ± {entry['gain']['half_width']:.2g}"
    if entry["gain"]["mean"] <= entry["gain"]["half_width"]:
        return (f"in {preset}, the published policy is not known to be better than {entry['best_rule']} ({gain}): use the rule",)
    better = f"in {preset}, the published policy is better than {entry['best_rule']} by {gain}"
    return f"{better}, after {published['seconds'] / 60.0:.0f} minutes of", published["command"]
