"""``python -m bsk_torch`` is the command ``bsk-torch``."""

from bsk_torch.cli import app

if __name__ == "__main__":
    app()
