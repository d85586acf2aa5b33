"""Lines of the log; counterpart of ``bsk_rl.utils.logging_config``: clock, logger, level, simulated time, satellite, message."""

from __future__ import annotations

import logging
import warnings
from typing import Any

from bsk_torch._text import visible

NAMES = ("GRAY", "RED", "GREEN", "YELLOW", "BLUE", "MAGENTA", "CYAN", "WHITE")

colors = {name: 90 + k for k, name in enumerate(NAMES)} | {f"DARK_{name}": 30 + k for k, name in enumerate(NAMES)}
"""Codes of terminals' colors."""

level_color = {"DEBUG": None, "INFO": None, "WARNING": "YELLOW", "ERROR": "RED", "CRITICAL": "RED"}
"""Color of each level."""

sat_color_cycle = ["DARK_CYAN", "GREEN", "DARK_BLUE", "MAGENTA", "CYAN", "DARK_GREEN", "BLUE", "DARK_MAGENTA"]
"""Colors of satellites, in the order in which they first say something."""


def style_string(
    string: str,
    no_format: bool = False,
    style_spec: list[int] | None = None,
    color: str | None = None,
    background_color: str | None = None,
    bold: bool = False,
    emph: bool = False,
    underline: bool = False,
) -> str:
    """Return a text between codes that change its style in a terminal; the text alone with ``no_format``."""
    if no_format:
        return string
    codes = list(style_spec or [])
    codes += [colors[color.upper()]] if color else []
    codes += [colors[background_color.upper()] + 10] if background_color else []
    codes += [code for code, flag in ((1, bold), (3, emph), (4, underline)) if flag]
    return f"\x1b[{';'.join(map(str, codes))}m{string}\x1b[0m"


class SimFormatter(logging.Formatter):
    """One line for each record, in color unless ``color_output`` is False."""

    def __init__(self, *args: Any, color_output: bool = True, **kwargs: Any) -> None:
        """Initialize the formatter; ``args`` and ``kwargs`` are those of :class:`logging.Formatter`."""
        super().__init__(*args, **kwargs)
        self.color_output = color_output
        self.satellite_colors: dict[str, str] = {}

    def format(self, record: logging.LogRecord) -> str:
        """Return the line of a record."""
        plain = not self.color_output
        title = visible(record.name.partition("bsk_rl.")[2] or record.name)
        parents = title.split(".")  # such as sats.satellite.EO1
        satellite = parents[2] if parents[0] == "sats" and len(parents) > 2 else None
        color = None
        if satellite is not None:
            following = sat_color_cycle[len(self.satellite_colors) % len(sat_color_cycle)]
            color = self.satellite_colors.setdefault(satellite, following)
        level: dict[str, Any] = {"color": level_color.get(record.levelname), "bold": record.levelname == "CRITICAL"}
        parts = [
            style_string(self.formatTime(record), plain, color="GRAY", emph=True),
            style_string(f"{title:<30}", plain, color=color),
            style_string(f"{record.levelname:<10}", plain, **level),
        ]
        if hasattr(record, "sim_time"):
            parts.append(style_string(f"<{record.sim_time:.2f}>", plain, color="DARK_YELLOW"))
        if satellite is not None:
            parts.append(style_string(f"{satellite}:", plain, color=color))
        message = visible(record.getMessage())
        headline: dict[str, Any] = {"color": "YELLOW", "bold": True} if message.startswith("=== ") else level
        parts.append(style_string(message, plain, **headline))
        line = " ".join(parts)
        return f"{line}\n{self.formatException(record.exc_info)}" if record.exc_info else line


class ContextFilter(logging.Filter):
    """Adds the simulated time of an environment to records, and drops those of other processes."""

    def __init__(self, name: str = "", env: object = None, proc_id: int | None = None) -> None:
        """Add the time of ``env``, and keep records of the process ``proc_id``; ``name`` as in :class:`logging.Filter`."""
        super().__init__(name)
        self.env, self.proc_id = env, proc_id

    def filter(self, record: logging.LogRecord) -> bool:
        """Add the time, s, where there is a simulation; return whether the record is of the process."""
        simulator = getattr(getattr(self.env, "unwrapped", None), "simulator", None)
        if simulator is not None:
            record.sim_time = simulator.sim_time
        return self.proc_id == record.process


def say(logger: logging.Logger, text: str, *args: object) -> None:
    """Log a warning that programs must see at every log level: as a Python warning where the logger drops it."""
    if logger.isEnabledFor(logging.WARNING):
        logger.warning(text, *args)
    else:
        warnings.warn(text % args if args else text, stacklevel=3)
