"""Spacecraft tasking for reinforcement learning: BSK-RL's problems and Basilisk's physics, in batched torch operations."""

from bsk_torch import act, comm, data, formations, obs, rand, sats, scene
from bsk_torch._bsk_rl import install as _install_bsk_rl
from bsk_torch.env import NO_ACTION, ConstellationTasking, GeneralSatelliteTasking, SatelliteTasking
from bsk_torch.presets import make
from bsk_torch.sim import dyn, fsw
from bsk_torch.wrappers.registration import register as _register

__version__ = "0.2.0"

_install_bsk_rl()
_register()

__all__ = [
    "NO_ACTION",
    "ConstellationTasking",
    "GeneralSatelliteTasking",
    "SatelliteTasking",
    "act",
    "comm",
    "data",
    "dyn",
    "formations",
    "fsw",
    "make",
    "obs",
    "rand",
    "sats",
    "scene",
]
