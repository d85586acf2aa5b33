"""Readers of files that others write: places and areas, without a simulation."""
