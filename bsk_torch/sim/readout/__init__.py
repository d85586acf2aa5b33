"""Quantities that are read from a simulation at a decision boundary."""
