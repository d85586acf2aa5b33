"""Simulation of bsk_rl's environments."""

from bsk_torch.bsk_rl.sim import dyn, fsw, world
from bsk_torch.bsk_rl.sim.simulator import Simulator

__all__ = ["Simulator", "dyn", "fsw", "world"]
