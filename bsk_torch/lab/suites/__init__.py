"""Suites of tasks with their scores."""
