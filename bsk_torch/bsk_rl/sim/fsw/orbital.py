"""Flight software that changes orbits."""

from bsk_torch.bsk_rl.sim.fsw import MagicOrbitalManeuverFSWModel

__all__ = ["MagicOrbitalManeuverFSWModel"]
