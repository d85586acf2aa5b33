"""Basilisk's flight software, of which there is none."""

from bsk_torch.bsk_rl.basilisk.unsimulated import advising

__getattr__ = advising("fswAlgorithms")
