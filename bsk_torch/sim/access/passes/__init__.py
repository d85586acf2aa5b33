"""Passes over places between samples."""
