"""Eclipses of satellites, and light at places."""
