"""Recordings of episodes, which figures, reports, exports and the viewer read."""

from bsk_torch.recording.recorder import record
from bsk_torch.recording.recording import Recording, load

__all__ = ["Recording", "load", "record"]
