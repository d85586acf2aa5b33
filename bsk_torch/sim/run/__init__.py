"""Ticks, what repeats them, and runs of satellites that depend on one another."""
