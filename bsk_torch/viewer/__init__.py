"""Viewer of episodes in a browser: recordings, pages, a local server."""

from bsk_torch.viewer.recording import Recording, load

__all__ = ["Recording", "load"]
