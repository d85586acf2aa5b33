"""Functions of one satellite as batched functions."""

from __future__ import annotations

import functools
import logging
import warnings
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from bsk_torch._checks import no_gradient
from bsk_torch.bsk_rl.per_episode.views import view_of
from bsk_torch.sats.opportunities import Opportunities
from bsk_torch.sats.user_function import Tree, alike, as_batch, first_of

logger = logging.getLogger(__name__)


def per_episode(function: Callable[..., object]) -> Callable[..., Tree]:
    """Return a function of one satellite as one of all satellites of a type.

    It is called once for all if that gives the first satellite the same result as a call for it alone, else for one after the
    other. ``np.linalg.norm(satellite.dynamics.r_BN_N)`` of positions [N, 3], for example, is a single number. Every number of
    satellites of a type is tried; where one of them fails, satellites of the type are separate from then on.

    Args:
        function: Function of a satellite, of a satellite and an opportunity, or of a deputy and a chief.
    """
    title = getattr(function, "__qualname__", repr(function))
    tried, separate = set[tuple[int, int]](), set[int]()

    @functools.wraps(function)
    def batched(satellite: Any, *others: Any) -> Tree:
        opportunities = others[0] if others and isinstance(others[0], Opportunities) else None
        lead = (len(satellite.simulator.ticks),) if opportunities is None else tuple(opportunities.open.shape)
        device = satellite.simulator.device

        def one(row: int) -> object:
            view = view_of(satellite, row)
            if opportunities is not None:
                return [function(view, each) for each in view.of_windows(opportunities.type, opportunities, padding=True)]
            return function(view, *(view.others[other.name] for other in others))

        def each(rows: int) -> Tree:
            return as_batch(title, stacked(title, [one(row) for row in range(rows)]), (rows, *lead[1:]), device)

        kind = satellite.type_index
        if kind in separate:
            return each(lead[0])
        if (kind, lead[0]) in tried:
            return as_batch(title, function(satellite, *others), lead, device)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # NumPy and torch warn of what the comparison below finds
                result = as_batch(title, function(satellite, *others), lead, device)
            if alike(first_of(result), each(1)):
                tried.add((kind, lead[0]))
                return result
            reason = "it mixes episodes if it is called for all of them"
        except Exception as error:
            reason = f"{type(error).__name__}: {str(error).partition(chr(10))[0]}"
        result = each(lead[0])
        if not separate:
            logger.warning("%s is called for one episode after the other, which is slow: %s", title, reason)
        separate.add(kind)
        return result

    return batched


def stacked(title: str, values: Sequence[Any]) -> Tree:
    """Return the results of several satellites as one tensor [n, ...], float64 unless they are booleans.

    Raises:
        TypeError: For results that are not numbers, or of different shapes.
    """
    if isinstance(values[0], dict):
        return {name: stacked(f"{title}[{name!r}]", [value[name] for value in values]) for name in values[0]}
    parts = [no_gradient(title, value).cpu().numpy() if isinstance(value, Tensor) else np.asarray(value) for value in values]
    if any(part.shape != parts[0].shape for part in parts):
        raise TypeError(f"{title} has shapes {sorted({part.shape for part in parts})} in different environments; they must agree")
    if any(part.dtype.kind not in "biuf" for part in parts):
        raise TypeError(f"{title} is {values[0]!r}; it must be a number or an array of numbers")
    table = np.stack(parts)
    return torch.from_numpy(table if table.dtype.kind == "b" else table.astype(np.float64))
