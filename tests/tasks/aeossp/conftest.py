"""Commands of the task run as other commands do."""

from tests.cli.conftest import run

__all__ = ["run"]
