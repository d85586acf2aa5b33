"""Viewer of episodes in a browser: recordings, pages, a local server."""

from bsk_torch.viewer.futures import Futures
from bsk_torch.viewer.recorder import record
from bsk_torch.viewer.recording import Recording, load

__all__ = ["Futures", "Recording", "load", "record"]
