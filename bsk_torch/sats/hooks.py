"""Checks of the satellite classes that users define."""

from __future__ import annotations

import difflib

from bsk_torch.sim.hooks import check_class

SPECS = ("observation_spec", "action_spec", "dyn_type", "fsw_type", "target_types", "sees_through_clouds")
"""Values that satellite classes define."""

HOOKS = ("on_bind", "note_events", "legal_actions", "action_mask", "counts", "generation")
"""Methods of satellites that subclasses may define."""


def check_satellite(cls: type, base: type) -> None:
    """Raise TypeError, with advice, for a satellite class with definitions that would never be used."""
    check_class(cls, base, HOOKS)
    for name in vars(cls):
        meant = difflib.get_close_matches(name, SPECS, n=1, cutoff=0.85)
        if meant and name not in SPECS and not any(name in vars(other) for other in cls.__mro__[1:]):
            raise TypeError(f"{cls.__name__}.{name} is never used; did you mean {meant[0]!r}?")
