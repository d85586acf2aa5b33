"""Log levels of Basilisk, which become those of the package's logger."""

import logging

BSK_DEBUG, BSK_INFORMATION, BSK_WARNING, BSK_ERROR, BSK_SILENT = range(5)

LEVELS = (logging.DEBUG, logging.INFO, logging.WARNING, logging.ERROR, logging.CRITICAL)
"""Level of Python's logging for each of them."""


def setDefaultLogLevel(level: int) -> None:
    """Set the level of bsk_torch's simulation; ValueError for an unknown one."""
    if level not in range(len(LEVELS)):
        raise ValueError(f"level={level!r} must be one of BSK_DEBUG to BSK_SILENT, 0 to {len(LEVELS) - 1}")
    logging.getLogger("bsk_torch.sim").setLevel(LEVELS[level])


def getDefaultLogLevel() -> int:
    """Return the level of :func:`setDefaultLogLevel`; that of warnings unless it has been set."""
    level = logging.getLogger("bsk_torch.sim").level
    return LEVELS.index(level) if level in LEVELS else BSK_WARNING
