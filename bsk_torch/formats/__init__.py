"""Files of other programs, read into plain dataclasses and written from them: orbits, places, areas, requests, schedules."""

from pathlib import Path

SAMPLES = Path(__file__).with_name("samples")
"""Folder of two small files to begin with: ``earth_observation.tle``, 20 real satellites in 2026, and ``cities.csv``.

``scripts/tools/make_samples.py`` names their sources and licenses.
"""
