"""Consistency of the episodes of an environment: one thread at a time, and no step after an interrupted call."""

from __future__ import annotations

import enum
import threading
from types import TracebackType

import torch
from tensordict import TensorDictBase
from torch import Tensor

from bsk_torch.sim.state import SHOWN, StateTable


class ResetNeededError(RuntimeError):
    """Raised by a call that needs running episodes when there are none."""


class Origin(enum.Enum):
    """Origin of the numbers of the current episodes.

    Each number of a saved state may be valid by itself while the combination is not; the first step shows this.
    """

    DRAWN = enum.auto()
    RESTORED = enum.auto()
    RESTORED_AND_STEPPED = enum.auto()


class EpisodeGuard:
    """A reentrant context for one thread; a second thread gets a RuntimeError instead of waiting.

    A step changes hundreds of tensors one after the other. Simultaneous calls by two threads would therefore mix the numbers of
    two episodes, and a call interrupted by an error leaves the episodes it was changing inconsistent: they must be reset. Inside,
    gradients are not recorded (:func:`bsk_torch._checks.no_gradient` rejects values that need them), and torch's inference mode
    is disabled.

    Attributes:
        state: Table with the field ``begun``: episodes that can be stepped, [N].
        all_begun: Whether all episodes can be stepped.
        interrupted: Whether some cannot be stepped because of an interrupted call.
        origin: Origin of the numbers of the episodes.
    """

    def __init__(self, state: StateTable) -> None:
        """Guard the episodes of ``state``."""
        self.state, self.all_begun, self.interrupted, self.origin = state, False, False, Origin.DRAWN
        self._changing: Tensor | None = None
        self._lock, self._inside = threading.RLock(), ""
        self._outer: list[tuple[bool, torch.inference_mode | None, Tensor | None]] = []

    def __enter__(self) -> None:
        if not self._lock.acquire(blocking=False):
            raise RuntimeError(
                f"the environment is in use by thread {self._inside!r}, and {threading.current_thread().name!r} called it at the "
                "same time: give each thread its own environment, or let one wait for the other with a threading.Lock"
            )
        self._inside = threading.current_thread().name
        grad, mode = torch.is_grad_enabled(), torch.inference_mode(False) if torch.is_inference_mode_enabled() else None
        if mode is not None:
            mode.__enter__()
        self._outer.append((grad, mode, self._changing))
        self._changing = None
        torch.set_grad_enabled(False)

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        try:
            if error is not None and self._changing is not None:
                self._interrupt(self._changing, error)
        finally:
            grad, mode, self._changing = self._outer.pop()
            torch.set_grad_enabled(grad)
            if mode is not None:
                mode.__exit__(None, None, None)
            self._lock.release()

    def change(self, envs: Tensor | None) -> None:
        """Mark the episodes ``envs``, a mask [N], as being changed by the current call; None for none after all."""
        self._changing = envs

    def replace(self) -> Tensor:
        """Mark all episodes as being replaced, until :meth:`begin`; return the mask of those that have begun."""
        begun = self.state["begun"]
        self._changing, self.all_begun = torch.zeros_like(begun), False
        return begun

    def begin(self, envs: Tensor, others: Tensor) -> None:
        """Mark the episodes ``envs`` [n] as ready to be stepped, in addition to ``others``, a mask [N]."""
        self.state["begun"] = others.index_fill(0, envs, True)
        self.all_begun = bool(self.state["begun"].all())
        self.interrupted = self.interrupted and not self.all_begun

    def _interrupt(self, changing: Tensor, error: BaseException) -> None:
        # an error affects only the episodes of the call; Ctrl-C may interrupt the rearrangement of the tables of all episodes
        half = changing if isinstance(error, Exception) else torch.ones_like(changing)
        self.state["begun"] = self.state["begun"] & ~half
        self.all_begun, self.interrupted = False, self.interrupted or bool(half.any())
        if isinstance(error, IndexError) and self.origin is not Origin.DRAWN:
            raise FloatingPointError(f"no satellite can fly with the numbers of the restored state: {error}") from error

    def check_begun(self, call: str, envs: Tensor | None = None) -> None:
        """Raise ResetNeededError if an episode, of those in the mask ``envs`` [N] if given, has not begun or was interrupted."""
        if self.all_begun:
            return
        begun = self.state["begun"]
        rows = torch.nonzero(~begun if envs is None else envs & ~begun).squeeze(-1).tolist()
        if rows:
            which = "" if len(rows) == len(begun) else f" of environments {rows[:SHOWN]} ({len(rows)} in all)"
            why = "a step was interrupted, which leaves its episodes incomplete" if self.interrupted else "these have not begun"
            raise ResetNeededError(f"{call} needs running episodes{which}, and {why}; call reset() first")


def check_numbers(outputs: TensorDictBase) -> None:
    """Check the outputs [N, ...] of the first step from a restored state; FloatingPointError for NaN in them."""
    for key, leaf in outputs.items(True, True):
        rows = torch.nonzero(torch.isnan(leaf).reshape(len(outputs), -1).any(1)).squeeze(-1).tolist()
        if rows:
            raise FloatingPointError(f"{key!r} of environments {rows[:SHOWN]} is NaN after the step from a restored state")
