"""The command line, ``bsk-torch``."""

from bsk_torch.cli.main import app

__all__ = ["app"]
