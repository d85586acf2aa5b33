"""The report of a training as a web page."""

from typing import TYPE_CHECKING

from bsk_torch._deprecated import deprecated_names

if not TYPE_CHECKING:
    __getattr__ = deprecated_names(__name__)
