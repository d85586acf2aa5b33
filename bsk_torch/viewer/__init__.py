"""Viewer of recordings in a browser: pages, other futures, a local server."""

from bsk_torch.viewer.futures import Futures

__all__ = ["Futures"]
