"""Objects of the user's own programs by name, ``module:name`` or ``file.py:name``."""

from __future__ import annotations

import logging
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

from bsk_torch.sim.names import nearest

logger = logging.getLogger(__name__)


def import_object(text: str, title: str = "") -> Any:
    """Import the object that a user names, which executes the code of its module.

    Names in files that others may have written must not come here.

    Args:
        text: ``module:name``, of a module in the current folder or installed, or ``file.py:name``.
        title: The argument that it is for, at the start of errors.

    Raises:
        ValueError: If there is no such file, module or object, or if its module raises an exception.
    """
    label = f"{title}={text!r}" if title else text
    module, _, name = text.rpartition(":")
    file = Path(module) if module.endswith(".py") else None
    if file is not None and not file.is_file():
        raise ValueError(f"{label} cannot be imported: there is no file {module!r}")
    folder = str(Path.cwd() if file is None else file.resolve().parent)
    if folder not in sys.path:
        sys.path.insert(0, folder)
    try:
        loaded = import_module(module if file is None else file.stem)
    except (Exception, SystemExit) as error:  # a user's module may raise anything
        logger.debug("%s cannot be imported", module, exc_info=error)
        raise ValueError(f"{label} cannot be imported: {type(error).__name__}: {error}") from error
    if file is not None and Path(loaded.__file__ or "").resolve() != file.resolve():
        raise ValueError(
            f"{label} cannot be imported: another module, {loaded.__file__}, has the name {file.stem!r}; rename the file"
        )
    if not hasattr(loaded, name):
        names = [key for key in vars(loaded) if not key.startswith("_")]
        raise ValueError(f"{label} cannot be imported: {module} has no {name!r}; {nearest(name, names)}")
    return getattr(loaded, name)


def name_of(thing: object) -> str:
    """Return the name of a function, or of the class of another object, such as ``careful``."""
    while hasattr(thing, "func"):  # of a partial
        thing = thing.func
    return str(getattr(thing, "__qualname__", type(thing).__name__))
