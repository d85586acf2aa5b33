"""At the place of ``bsk_rl.utils.rso_imaging``; its names are not in bsk_torch yet."""

from typing import NoReturn

from bsk_torch.bsk_rl.scene.later import raise_for


def __getattr__(name: str) -> NoReturn:
    """Raise ImportError for names of bsk_rl, AttributeError for others."""
    raise_for(name, __name__)
