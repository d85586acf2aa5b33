"""Causes of death by policy, for the report of a run."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from bsk_torch._text import visible
from bsk_torch.viz.figures.style import INK, PALETTE, save, tidy

BAR = 0.34
"""Height of a policy's row, inches."""

MODEST = 0.06
"""Share of the longest bar from which on a part is wide enough for its number."""


def deaths_chart(deaths: Mapping[str, Mapping[str, int]], path: Path) -> Path:
    """Draw a bar for each policy to the file ``path``, .png, .svg or .pdf, as long as its deaths are many, parted by what failed.

    Args:
        deaths: By policy, the number of episodes in which each aliveness check failed at the end.
        path: The file to write.
    """
    causes = sorted({cause for counts in deaths.values() for cause in counts})
    longest = max(sum(counts.values()) for counts in deaths.values())
    figure = Figure(figsize=(7.2, BAR * len(deaths) + 0.9), dpi=140, layout="constrained", facecolor="white")
    panel = figure.subplots()
    tidy(panel)
    panel.grid(axis="y", visible=False)
    ends = [0] * len(deaths)
    for color, cause in zip(PALETTE[3:] + PALETTE[:3], causes, strict=False):
        counts = [n.get(cause, 0) for n in deaths.values()]
        bars = panel.barh(range(len(ends)), counts, 0.7, ends, color=color, label=plain_cause(cause))
        panel.bar_label(
            bars, [str(n) if n > MODEST * longest else "" for n in counts], label_type="center", color="white", fontsize=9
        )
        ends = [end + n for end, n in zip(ends, counts, strict=True)]
    panel.set_yticks(range(len(ends)), [visible(name) for name in deaths])
    panel.invert_yaxis()
    panel.xaxis.set_major_locator(MaxNLocator(integer=True))
    panel.set_xlabel("episodes", color=INK, fontsize=9.5)
    figure.legend(loc="outside upper left", ncols=len(causes), frameon=False, fontsize=9, labelcolor=INK, borderaxespad=0.0)
    return save(figure, path)


def plain_cause(check: str) -> str:
    """Return the name of an aliveness check in plain words."""
    return check.removesuffix("_valid").replace("rw_", "wheel ").replace("_", " ")
