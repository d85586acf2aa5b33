"""Recorders of episodes."""
