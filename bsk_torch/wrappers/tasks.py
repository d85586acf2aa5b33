"""Actions, masks and infos of the single satellites of a constellation."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from bsk_torch.env import NO_ACTION, ConstellationTasking
from bsk_torch.env.action_forms import form, mask_size
from bsk_torch.env.satellite_group import SatelliteGroup
from bsk_torch.wrappers.core import Results, as_numpy, counts, read_values


def read_task(where: str, value: object, satellite: SatelliteGroup, extra: int = 0) -> int:
    """Return a satellite's action as the environment takes it; ``NO_ACTION`` for None.

    Args:
        where: Name of the argument, for messages.
        value: An integer, also as an array or tensor without dimensions; or None to continue the current task.
        satellite: The satellite, as it lives in the environment.
        extra: Number of actions after the satellite's own that also continue the task.

    Raises:
        TypeError: For a value that is not an integer.
        ValueError: For an action out of range.
    """
    n, negative = satellite.actions.n_actions, satellite.actions.n_negative_actions
    if value is None:
        return NO_ACTION
    if isinstance(value, np.ndarray | Tensor) and value.ndim == 0:
        value = value.item()
    if isinstance(value, bool) or not isinstance(value, int | np.integer):
        raise TypeError(f"{where} is {value!r}; it must be an integer, or None to continue the task")
    if value != NO_ACTION and not -negative <= value < n + extra:
        names = [f"{k}: {name}" for k, name in enumerate(satellite.action_description)]
        names += [f"-1 to {-negative}: a target by its index"] if negative else []
        names += [f"{n} or None: continue" if extra else "None: continue"]
        raise ValueError(f"{where} is {value}; it must be one of {', '.join(names)}")
    return int(value)


def read_one(where: str, value: object, satellite: SatelliteGroup, extra: int = 0) -> Tensor:
    """Return a satellite's action: its number, a tensor without dimensions, or its numbers [A] or [A + 1].

    See :func:`read_task` and :func:`~bsk_torch.wrappers.core.read_values`.
    """
    if form(satellite) is None:
        return torch.tensor(read_task(where, value, satellite, extra))
    return read_values(where, value, satellite)


def ends(core: ConstellationTasking) -> tuple[Tensor, Tensor]:
    """Return which satellites are terminated, [N, S], and which episodes are truncated, [N]."""
    cut = core.truncated_by_time | (core.checked.truncated() & core.present).any(1)
    ended = core.dead | (core.checked.terminated() & core.present)
    return (ended | cut.unsqueeze(-1) if core.terminate_on_time_limit else ended), cut


def legal_tasks(core: ConstellationTasking) -> list[np.ndarray | None]:
    """Return which actions are legal as new tasks, [count, n_actions] int8 for each type of satellites; None of real numbers."""
    return [as_numpy(part.action_mask()).astype(np.int8) if mask_size(part) else None for part in core.satellites]


def satellite_infos(core: ConstellationTasking, results: Results) -> list[dict[str, object]]:
    """Return the info of each satellite: whether it needs a task, and its counters."""
    counted = {name: count[0].tolist() for name, count in counts(results).items()}
    idle = core.requires_retasking[0].tolist()
    return [{"requires_retasking": idle[k], **{name: count[k] for name, count in counted.items()}} for k in range(len(idle))]
