"""Figures of training runs and of episodes, drawn with matplotlib."""
