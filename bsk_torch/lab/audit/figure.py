"""Regret of the decisions of a policy: how unevenly it is distributed, and for which actions."""

from __future__ import annotations

from pathlib import Path

import torch
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter
from torch import Tensor

from bsk_torch.lab.audit.audit import Audit
from bsk_torch.viz.figures.style import FAINT, INK, PALETTE, WIDTH, caption, finish, label, tidy


def shares(regret: Tensor) -> tuple[Tensor, Tensor]:
    """Return the shares of the decisions with the largest regrets [D], and of the regret that these have, [D + 1] each."""
    ordered = regret.clamp(min=0.0).sort(descending=True).values
    total = ordered.sum().clamp(min=torch.finfo(ordered.dtype).tiny)
    summed = torch.cat([torch.zeros(1, dtype=ordered.dtype), ordered.cumsum(0) / total])
    return torch.arange(len(summed), dtype=ordered.dtype) / max(len(regret), 1), summed


def regret_figure(audit: Audit, path: Path, title: str = "", width: float = WIDTH) -> Path:
    """Draw the share of the regret in the worst decisions, the regret over time, and its share by chosen action.

    Args:
        audit: An audit.
        path: The picture, .png, .svg or .pdf.
        title: Headline; no headline if empty.
        width: Width, inches, such as :data:`~bsk_torch.viz.figures.style.COLUMN` for a paper, where the panels are stacked.
    """
    narrow = width < WIDTH
    figure = Figure(figsize=(width, 5.8 if narrow else 3.6), dpi=140, layout="constrained", facecolor="white")
    lorenz, times, kinds = figure.subplots(*((3, 1) if narrow else (1, 3)))
    for panel in (lorenz, times, kinds):
        tidy(panel)
    lorenz.plot(*(part.tolist() for part in shares(audit.regret)), color=PALETTE[0], linewidth=1.8)
    lorenz.plot([0.0, 1.0], [0.0, 1.0], color=FAINT, linewidth=1.0)
    lorenz.xaxis.set_major_formatter(PercentFormatter(1.0))
    lorenz.yaxis.set_major_formatter(PercentFormatter(1.0))
    lorenz.set_xlabel("decisions, the worst first", color=INK, fontsize=9.5)
    label(lorenz, "share of all regret")
    times.scatter((audit.time / 3600.0).tolist(), audit.regret.tolist(), s=7.0, color=PALETTE[3], alpha=0.5, linewidth=0)
    times.set_xlabel("time since reset, h", color=INK, fontsize=9.5)
    label(times, "regret of a decision")
    rows = audit.by_action()[:8][::-1]
    kinds.barh([row.chosen for row in rows], [row.share for row in rows], color=PALETTE[0], height=0.6)
    kinds.xaxis.set_major_formatter(PercentFormatter(1.0))
    kinds.grid(axis="y", visible=False)
    caption(kinds, "share of all regret by chosen action")
    return finish(figure, path, title, width)
