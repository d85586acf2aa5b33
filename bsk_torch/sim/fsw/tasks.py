"""Names in programs of BSK-RL that define flight software, built here from components and modes; errors suggest replacements."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

ADVICE = (
    "flight software is a Component with update(bus), listed in components of the model, and a row of its table modes, which "
    "act.DiscreteFSWAction enters; see docs/how_to/own_fsw_mode.md"
)


class Task:
    """Base class of tasks; deriving from it raises TypeError."""

    def __init_subclass__(cls, **options: Any) -> None:
        raise TypeError(f"{cls.__qualname__} is a task, which is never run here; {ADVICE}")


def action(function: Callable[..., Any]) -> Callable[..., Any]:
    """Decorator of commands; raises TypeError."""
    raise TypeError(f"@action {function.__name__} is a command, which is never run here; {ADVICE}")
