"""Commands of the lab run as other commands do."""

from tests.cli.conftest import run

__all__ = ["run"]
