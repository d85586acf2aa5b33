"""Dynamics models of space-to-space imaging, which bsk_torch does not have yet."""

from bsk_torch.bsk_rl.later import not_yet

__getattr__ = not_yet(__name__)
