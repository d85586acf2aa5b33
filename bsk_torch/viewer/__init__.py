"""Viewer of recordings in a browser: pages, other futures, a local server."""
