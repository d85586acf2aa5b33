"""Vizard's switches; counterpart of ``bsk_rl.utils.vizard``: there is no Vizard, so functions that draw in it do nothing."""

from __future__ import annotations

import functools
from collections.abc import Callable

VIZARD_PATH = None
"""Folder that Vizard's files are written to: None, for none."""

VIZINSTANCE = None
"""Vizard's object: None."""


def visualize(func: Callable[..., object]) -> Callable[..., None]:
    """Return a function that does nothing in place of one that draws in Vizard."""

    @functools.wraps(func)
    def skipped(*args: object, **kwargs: object) -> None:
        return None

    return skipped


@visualize
def get_color(index: int) -> None:
    """Return None; with Vizard, the color of a satellite."""
