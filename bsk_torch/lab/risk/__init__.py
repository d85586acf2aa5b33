"""Probabilities of rare events, by sequential sampling."""
