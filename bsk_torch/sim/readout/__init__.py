"""Quantities read from a simulation at a decision boundary."""
