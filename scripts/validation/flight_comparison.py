"""The same episodes in bsk_torch and in Basilisk, side by side: pairs of flights, their statistics, and how they are shown."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from rich.table import Table

from bsk_torch.lab.basilisk.flight import NUDGE, Array, Flight
from bsk_torch.rl.evaluation.statistics import Estimate, confidence

TOLERANCE = 1e-6
"""Largest difference of the return that equal actions may bring, and of observations that need no explanation."""

LEVEL = 0.95


@dataclass(frozen=True)
class Divergence:
    """The first decision of an episode that differs.

    Attributes:
        step: Its number.
        actions: What was done here and there; -1 for an episode that had ended.
        margins: By how much each side preferred its own action to the other's, in logits; nan for policies without.
        logits: Largest difference of the logits; nan likewise.
        observation: Largest difference of what was seen there.
    """

    step: int
    actions: tuple[int, int]
    margins: tuple[float, float]
    logits: float
    observation: float


@dataclass(frozen=True)
class Pair:
    """One episode, flown in bsk_torch and in Basilisk.

    ``nudged`` is Basilisk once more, from an attitude that is :data:`~bsk_torch.lab.basilisk.flight.NUDGE` away, where the two
    differ: its reaction is not a difference between the simulators.
    """

    here: Flight
    there: Flight
    nudged: Flight | None = None

    @property
    def agreed(self) -> int:
        """Number of first decisions that are the same."""
        k = min(len(self.here.actions), len(self.there.actions))
        differ = np.nonzero(self.here.actions[:k] != self.there.actions[:k])[0]
        return int(differ[0]) if len(differ) else k

    @property
    def same(self) -> bool:
        """Whether all decisions are the same."""
        return self.agreed == len(self.here.actions) == len(self.there.actions)

    @property
    def return_difference(self) -> float:
        """Return here minus that in Basilisk."""
        return self.here.returns - self.there.returns

    @property
    def observation_differences(self) -> Array:
        """Largest difference of each entry of the observation while the decisions agree, [F]."""
        k = self.agreed + 1
        return np.abs(self.here.observations[:k] - self.there.observations[:k]).max(0)

    @property
    def doubtful(self) -> bool:
        """Whether decisions differ, or what is seen differs by more than the tolerance."""
        return not self.same or float(self.observation_differences.max()) > TOLERANCE

    @property
    def itself(self) -> Pair | None:
        """Basilisk, nudged, against Basilisk."""
        return None if self.nudged is None else Pair(self.nudged, self.there)

    @property
    def divergence(self) -> Divergence | None:
        """The first decision that differs; None where there is none."""
        if self.same:
            return None
        k = self.agreed
        seen = float(np.abs(self.here.observations[k] - self.there.observations[k]).max())
        mine, theirs = (int(flight.actions[k]) if k < len(flight.actions) else -1 for flight in (self.here, self.there))
        actions = mine, theirs
        if -1 in actions or not self.here.logits.shape[1]:
            return Divergence(k, actions, (np.nan, np.nan), np.nan, seen)
        here, there = self.here.logits[k], self.there.logits[k]
        margins = float(here[mine] - here[theirs]), float(there[theirs] - there[mine])
        return Divergence(k, actions, margins, float(np.abs(here - there).max()), seen)


def column(flights: Sequence[Flight], name: str) -> torch.Tensor:
    """A number of every flight, [n] float64."""
    return torch.tensor([float(getattr(flight, name)) for flight in flights], dtype=torch.float64)


def deaths(flights: Sequence[Flight]) -> dict[str, int]:
    """Count the failures of each aliveness check."""
    return dict(Counter(name.removesuffix("_valid") for flight in flights for name in flight.deaths))


def difference(pairs: Sequence[Pair], name: str) -> Estimate:
    """Mean of a number here minus that in Basilisk, episode by episode, with its 95 % confidence interval."""
    return confidence(column([pair.here for pair in pairs], name) - column([pair.there for pair in pairs], name), LEVEL)


def rarest(n: int) -> float:
    """Return the upper end of the one-sided 95 % confidence interval of a share that was never found in ``n`` samples."""
    return 1.0 - (1.0 - LEVEL) ** (1.0 / n)


# -- what is shown ----------------------------------------------------------------------------------------------------

ROWS: dict[str, tuple[str, str]] = {
    "return": ("returns", "{:.4f}"),
    "survival": ("survived", "{:.1%}"),
    "collected": ("collected", "{:.4f}"),
    "fill": ("fill", "{:.4f}"),
    "decisions": ("decisions", "{:.1f}"),
    "seconds": ("seconds", "{:.0f}"),
}
"""Rows of the table: attribute of a flight, and how its mean is written."""


def table(pairs: Sequence[Pair], title: str) -> Table:
    """Means of both sides, and the mean paired difference."""
    shown = Table(title=title, title_justify="left")
    for name in ("", "bsk_torch", "Basilisk", "difference (95 %)"):
        shown.add_column(name, no_wrap=True)
    sides = [pair.here for pair in pairs], [pair.there for pair in pairs]
    for name, (attribute, form) in ROWS.items():
        means = [float(column(side, attribute).mean()) for side in sides]
        if not np.isnan(means[0]):
            gap = difference(pairs, attribute)
            shown.add_row(name, *map(form.format, means), f"{gap.mean:.2g} ± {gap.half_width:.2g}")
    causes = (", ".join(f"{n} {name}" for name, n in deaths(side).items()) or "none" for side in sides)
    shown.add_row("deaths", *causes, "")
    return shown


def findings(pairs: Sequence[Pair], observed: Sequence[str], actions: Sequence[str]) -> list[str]:
    """Lines about equal and differing decisions."""
    same = [pair for pair in pairs if pair.same]
    fates = sum(pair.here.survived != pair.there.survived for pair in pairs)
    n, taken, agreed = len(pairs), sum(len(pair.here.actions) for pair in pairs), sum(pair.agreed for pair in pairs)
    lines = [f"episodes with the same actions: {len(same)} of {n} ({agreed} of {taken} decisions before the first that differs)"]
    if same:
        worst = max(abs(pair.return_difference) for pair in same)
        verdict = "as asked" if worst <= TOLERANCE else "TOO MUCH"
        lines.append(
            f"largest difference of the return where actions are the same: {worst:.2g} ({verdict}: at most {TOLERANCE:g})"
        )
    lines.append(
        f"episodes that only one side survived: {fates} of {n}" + ("" if fates else f" (95 %: at most {rarest(n):.1%} of all)")
    )
    differences = np.max([pair.observation_differences for pair in pairs], 0)
    worst_first = np.argsort(-differences)[:4]
    lines.append("largest differences of observations while actions agree:")
    lines += [f"  {observed[k] if k < len(observed) else k}: {differences[k]:.2g}" for k in worst_first]
    return lines + [told(pair, actions) for pair in pairs if pair.doubtful]


def told(pair: Pair, actions: Sequence[str]) -> str:
    """Describe an episode in which something differs."""
    parts, first = [f"seed {pair.here.seed}: {first_difference(pair, actions)}"], pair.divergence
    if first is not None:
        parts.append(f"returns {pair.here.returns:.4f}, {pair.there.returns:.4f}")
    if pair.itself is not None:
        parts.append(f"Basilisk against itself, {NUDGE:g} away: {first_difference(pair.itself, actions)}")
    return "; ".join(parts)


def first_difference(pair: Pair, actions: Sequence[str]) -> str:
    """The first decision that differs, and by how much its reasons do."""
    first, seen = pair.divergence, pair.observation_differences.max()
    if first is None:
        return f"the same actions, observations differ by {seen:.2g}"
    done = ("the end" if action < 0 else actions[action] for action in first.actions)
    text = f"decision {first.step} is {' and '.join(done)}, observations differ by {first.observation:.2g}"
    if np.isnan(first.logits):
        return text
    return f"{text}, logits by {first.logits:.2g}, preferred by {first.margins[0]:.2g} and {first.margins[1]:.2g}"


# -- what is kept -----------------------------------------------------------------------------------------------------

EPISODE: dict[str, Callable[[Pair], Any]] = {
    "seed": lambda pair: pair.here.seed,
    "return": lambda pair: rounded(pair.here.returns),
    "return_basilisk": lambda pair: rounded(pair.there.returns),
    "survived": lambda pair: pair.here.survived,
    "survived_basilisk": lambda pair: pair.there.survived,
    "decisions": lambda pair: len(pair.here.actions),
    "same_actions": lambda pair: pair.same,
    "observation_difference": lambda pair: float(f"{pair.observation_differences.max():.2e}"),
}
"""Return the results that are kept of every episode."""


def differs(pair: Pair) -> dict[str, Any]:
    """Return the differences in an episode, and those of Basilisk from itself; None unless it has been flown again."""
    first = pair.divergence
    numbers = {} if first is None else {name: plain(value) for name, value in dataclasses.asdict(first).items()}
    again = None if pair.itself is None else differs(pair.itself)
    return {"observations": float(pair.observation_differences.max()), "first": numbers, "nudged": again}


def plain(value: Any) -> Any:
    """The value with None for what is no number."""
    if isinstance(value, tuple):
        return [plain(part) for part in value]
    return value if np.isfinite(value) else None


def rounded(value: float) -> float:
    """To twelve decimals, so that sums of the same rewards read the same."""
    return round(value, 12)


def kept(pairs: Sequence[Pair]) -> dict[str, Any]:
    """The comparison as plain values: summary, and columns with an entry for every episode."""
    sides = {"bsk_torch": [pair.here for pair in pairs], "basilisk": [pair.there for pair in pairs]}
    same = [pair for pair in pairs if pair.same]
    summary: dict[str, Any] = {
        side: {name: interval(confidence(column(flights, attribute), LEVEL)) for name, (attribute, _) in ROWS.items()}
        | {"deaths": deaths(flights)}
        for side, flights in sides.items()
    }
    summary["difference"] = {name: interval(difference(pairs, attribute)) for name, (attribute, _) in ROWS.items()}
    summary["same_actions"] = len(same)
    summary["largest_return_difference_with_same_actions"] = max((abs(pair.return_difference) for pair in same), default=None)
    doubtful = {pair.here.seed: differs(pair) for pair in pairs if pair.doubtful}
    return {
        "summary": summary,
        "doubtful": doubtful,
        "episodes": {name: [f(pair) for pair in pairs] for name, f in EPISODE.items()},
    }


def interval(estimate: Estimate) -> list[float | None]:
    """Mean and half width; None where they are no numbers."""
    return plain((estimate.mean, estimate.half_width))
