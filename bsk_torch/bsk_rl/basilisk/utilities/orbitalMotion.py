"""Orbital elements and constants of the Earth and the Sun, in Basilisk's units."""

from bsk_torch.bsk_rl.utils.orbital_motion import *  # noqa: F403  - the same names at Basilisk's place
