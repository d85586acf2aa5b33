"""Kinds of places that satellites may see."""
