"""When and how satellites see places, the Sun and one another: windows, eclipses, lines of sight, relative geometry."""

from typing import TYPE_CHECKING

from bsk_torch._deprecated import deprecated_names

if not TYPE_CHECKING:
    __getattr__ = deprecated_names(__name__)
