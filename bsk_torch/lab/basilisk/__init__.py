"""Flights of the same episodes on Basilisk itself, driven through bsk_rl, where these are installed.

Only :mod:`bsk_torch.lab.basilisk.reference_env`, and what it imports, needs Basilisk, when an episode is flown; :func:`lacking`
lists what to install.
"""

from bsk_torch.lab.basilisk.certificate import Certificate, certify
from bsk_torch.lab.basilisk.flight import FLOWN, absent_data, lacking

__all__ = ["FLOWN", "Certificate", "absent_data", "certify", "lacking"]
