"""Planners and bounds on what they can reach."""
