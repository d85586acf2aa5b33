"""Utilities, at the places of ``bsk_rl.utils``."""
