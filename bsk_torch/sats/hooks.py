"""Checks of the satellite classes that users define."""

from __future__ import annotations

import difflib

from bsk_torch.sim.hooks import check_class

SPECS = ("observation_spec", "action_spec", "dyn_type", "fsw_type", "target_types", "sees_through_clouds")
"""Values that satellite classes define."""

HOOKS = ("on_bind", "note_events", "legal_actions", "action_mask", "counts", "generation")
"""Methods of satellites that subclasses may define."""

MEMORY = "keep values that are reset with every episode in simulator.memory: memory.declare(name, initial_value)"
ENTRY = "define an act.Action, and list it in action_spec"

UNUSED = {
    "get_obs": "define an obs.Observation, and list it in observation_spec",
    "observation_space": "it follows from observation_spec",
    "set_action": ENTRY,
    "set_action_override": ENTRY,
    "action_space": "it follows from action_spec",
    "get_action_mask": "define legal_actions()",
    "default_sat_args": "pass sat_args to the satellite; defaults are those of Arg in args= of a Component of its models",
    "get_dyn_type": "set dyn_type",
    "get_fsw_type": "set fsw_type",
    "update_timed_terminal_event": "return a duration from decide() of an act.Action",
    "parse_target_selection": "act.image_target(index) is the action of a target by its index",
    "enable_target_window": "act.Image ends with the window of its target",
    "reset_overwrite_previous": MEMORY,
    "reset_pre_sim_init": MEMORY,
    "reset_during_sim_init": MEMORY,
    "reset_post_sim_init": MEMORY,
}
"""Names that are not hooks of satellites, those of bsk_rl among them, and what to write instead."""


def check_satellite(cls: type, base: type) -> None:
    """Raise TypeError, with advice, for a satellite class with definitions that would never be used."""
    check_class(cls, base, HOOKS, UNUSED)
    for name in vars(cls):
        meant = difflib.get_close_matches(name, SPECS, n=1, cutoff=0.85)
        if meant and name not in SPECS and not any(name in vars(other) for other in cls.__mro__[1:]):
            raise TypeError(f"{cls.__name__}.{name} is never used; did you mean {meant[0]!r}?")
