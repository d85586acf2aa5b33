"""Use of an environment by one thread at a time."""

from __future__ import annotations

import threading
from collections.abc import Callable
from types import TracebackType


class Exclusive:
    """A context that one thread may enter, also several times; RuntimeError for a second thread meanwhile, which does not wait.

    A step changes hundreds of tensors one after the other, so calls of two threads at once would mix two episodes' numbers.
    """

    def __init__(self, leave: Callable[[BaseException | None], None]) -> None:
        """Call ``leave`` with the error, or None, at the end of what a thread does inside."""
        self._lock, self._inside, self._leave = threading.RLock(), "", leave

    def __enter__(self) -> None:
        """Enter; RuntimeError while another thread is inside."""
        if not self._lock.acquire(blocking=False):
            raise RuntimeError(
                f"the environment is in use by thread {self._inside!r}, and {threading.current_thread().name!r} called it at the "
                "same time: give each thread an environment of its own, or let one wait for the other with a threading.Lock"
            )
        self._inside = threading.current_thread().name

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        """Leave."""
        try:
            self._leave(error)
        finally:
            self._lock.release()
