"""Counterpart of ``bsk_rl.scene.rso_targets``; its names are not in bsk_torch yet."""

from bsk_torch.bsk_rl.later import not_yet

__getattr__ = not_yet(__name__)
