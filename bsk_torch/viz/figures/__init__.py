"""Figures of episodes and trainings."""
