"""Future positions of satellites: arcs solved ahead of the simulation."""

from typing import TYPE_CHECKING

from bsk_torch._deprecated import deprecated_names

if not TYPE_CHECKING:
    __getattr__ = deprecated_names(__name__)
