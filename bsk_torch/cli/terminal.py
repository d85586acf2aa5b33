"""What commands print aside from results: errors, messages, what takes long, and the compilation of kernels.

Results alone go to the standard output; all else goes to the standard error.
"""

from __future__ import annotations

import logging
import shlex
import sys
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NoReturn

import typer
from rich.console import Console
from rich.file_proxy import FileProxy
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.text import Text

from bsk_torch._text import visible

logger = logging.getLogger(__name__)

screen = Console(stderr=True)
"""Where messages and activities are shown."""


class Failure(typer.Exit):
    """Ends the program after its message has been printed."""

    def __init__(self, message: str) -> None:
        """End with the status 1."""
        super().__init__(1)
        self.message = message

    def __str__(self) -> str:
        return self.message


def fail(message: str) -> NoReturn:
    """Print an error and end the program."""
    screen.print(Text(visible(message), style="red"), soft_wrap=not screen.is_terminal)
    raise Failure(message)


def described(error: BaseException) -> str:
    """Return the message of an error; system errors start with the file."""
    if isinstance(error, OSError) and error.strerror and error.filename:
        return f"{str(error.filename)!r}: {error.strerror}"
    if isinstance(error, KeyError) and error.args:  # which would be quoted
        return str(error.args[0])
    return str(error) or type(error).__name__


@contextmanager
def refusing(*kinds: type[Exception], why: str = "") -> Iterator[None]:
    """End the program with the message of an error of these kinds (default: ValueError), which ``why`` introduces."""
    kinds = kinds or (ValueError,)
    try:
        yield
    except kinds as error:
        logger.debug("refused", exc_info=error)
        fail(f"{why}{described(error)}")


def of_arguments(error: BaseException) -> bool:
    """Return whether an error ended the start of episodes, where seeds and values are checked, or the decision of a policy.

    All other errors of these types are faults of this package or the user's functions, and keep their traceback.
    """
    if "torch" not in sys.modules:
        return False
    from bsk_torch.env.episodes import Episodes
    from bsk_torch.env.seeds import episode_seed
    from bsk_torch.wrappers.policies import DecisionError

    starts = Episodes._begin.__code__, episode_seed.__code__
    frames = traceback.walk_tb(error.__traceback__)
    return isinstance(error, DecisionError) or any(frame.f_code in starts for frame, _ in frames)


def for_shell(path: Path | str) -> str:
    """Return a path as a shell takes it."""
    return shlex.quote(str(path))


def echo(text: str) -> None:
    """Print results."""
    typer.echo(visible(text))


def print_message(text: str) -> None:
    """Print a message above the activity or the training; the terminal's width breaks it, and files get it in one line."""
    text = visible(text)
    if isinstance(sys.stderr, FileProxy):  # a bar is shown, of this console or of the training's, which prints above it
        print(text, file=sys.stderr)
    else:
        screen.print(Text(text), soft_wrap=not screen.is_terminal)


# -- messages and activities ---------------------------------------------------------------------------------------------------


class Activity:
    """The line at the bottom of the screen: what takes long, and how many kernels have been compiled.

    Attributes:
        quiet: Whether nothing is shown.
        text: The present activity; empty if there is none.
        compiled: Number of kernels since the last report.
        seconds: Time in which they were compiled.
        folder: Where they are kept.
    """

    def __init__(self) -> None:
        """Show nothing yet."""
        self.quiet, self.compiled, self.seconds, self.folder = False, 0, 0.0, ""
        self._bar: Progress | None = None
        self.text, self._kernel = "", ""

    @property
    def line(self) -> str:
        """What is shown: the kernel that is compiled, or the activity."""
        return visible(self._kernel or self.text, keep="")

    def show(self, text: str) -> None:
        """Show an activity, or none if ``text`` is empty."""
        self.text = text
        if text and self._bar is None and screen.is_terminal and not self.quiet:
            columns = SpinnerColumn(), TextColumn("{task.description}", markup=False), TimeElapsedColumn()
            self._bar = Progress(*columns, console=screen, transient=True)
            self._bar.add_task(self.line)
            self._bar.start()
        if self._bar is not None and text:
            self._bar.update(self._bar.task_ids[0], description=self.line)
        elif self._bar is not None:
            self._bar.stop()
            self._bar = None

    def compiling(self, kernel: str) -> None:
        """Count a kernel whose compilation begins."""
        self.compiled += 1
        self._kernel = f"compiling kernel {self.compiled} ({kernel}), once per machine"
        self.show(self.text)

    def has_compiled(self, seconds: float, folder: str) -> None:
        """Add the time that a kernel has taken."""
        self.seconds, self.folder, self._kernel = self.seconds + seconds, folder, ""
        self.show(self.text)

    def report(self) -> None:
        """Print how many kernels have been compiled, in what time, and where they are kept, if there were any."""
        if self.compiled and not self.quiet:
            kernels = f"{self.compiled} kernel{'s' * (self.compiled > 1)}"
            once = f", once per machine; kept in {self.folder}" if self.folder else ""
            print_message(f"compiled {kernels} in {self.seconds:.0f} s{once}")
        self.compiled, self.seconds = 0, 0.0


activity = Activity()


@contextmanager
def working(text: str) -> Iterator[Callable[[str], None]]:
    """Show what takes long; yields a function that shows another text."""
    before = activity.text
    activity.show(text)
    try:
        yield activity.show
    finally:
        activity.show(before)


class Messages(logging.Handler):
    """Prints messages above the activity; those about kernels are counted, and printed only at level DEBUG."""

    def emit(self, record: logging.LogRecord) -> None:
        """Print or count a message."""
        entries = vars(record)
        if "kernel" in entries:
            activity.compiling(entries["kernel"])
        elif "kernel_seconds" in entries:
            activity.has_compiled(entries["kernel_seconds"], entries["folder"])
        counted = {"kernel", "kernel_seconds"} & entries.keys() or ("kernel_folder" in entries and screen.is_terminal)
        if not counted or logging.getLogger().isEnabledFor(logging.DEBUG):
            print_message(self.format(record))


def set_verbosity(verbose: bool, quiet: bool) -> None:
    """Print all messages, warnings and errors alone, or what is usual; ends the program if both are asked for."""
    if verbose and quiet:
        fail("--verbose and --quiet exclude each other")
    activity.quiet = quiet
    level = logging.DEBUG if verbose else logging.WARNING if quiet else logging.INFO
    logging.basicConfig(level=level, format="%(message)s", handlers=[Messages()])
    for name in ("matplotlib", "PIL"):
        logging.getLogger(name).setLevel(logging.WARNING)
