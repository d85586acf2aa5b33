"""Actions as passed to an environment: discrete, continuous or hybrid; their specs, and conversion to tensors.

The action of one satellite is an integer, A real numbers, or A + 1 columns for a hybrid action, of which the last is the choice.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor
from torchrl.data import Binary, Bounded, Categorical, Composite, TensorSpec, Unbounded
from torchrl.data.tensor_specs import BoundedContinuous

from bsk_torch._checks import no_gradient
from bsk_torch.act.builders import ContinuousBuilder
from bsk_torch.env.no_action import CLOSE, NO_ACTION
from bsk_torch.env.satellite_group import SatelliteGroup

VALUES, CHOICE = "values", "choice"
"""Parts of a hybrid action."""


class _Kept(type(BoundedContinuous)):  # type: ignore[misc]
    """Makes instances of a subclass; TorchRL's metaclass would make instances of TorchRL's class."""

    def __call__(cls, *args: object, **kwargs: object) -> Any:
        instance = super().__call__(*args, **kwargs)
        instance.__class__ = cls
        return instance


class OpenBox(BoundedContinuous, metaclass=_Kept):
    """Spec of real numbers, some with infinite bounds.

    ``rand`` draws as Gymnasium's ``Box.sample`` does: uniformly between finite bounds, from an exponential distribution of mean
    one beyond a single finite bound, and from a standard normal distribution without bounds.
    """

    def rand(self, shape: Sequence[int] | torch.Size | None = None) -> Tensor:
        """Return finite random values, [*shape, *self.shape]."""
        low, high = (side.expand(*(shape or ()), *self.shape) for side in self.space)
        below, above = torch.isinf(low), torch.isinf(high)
        uniform = torch.rand(low.shape, dtype=self.dtype, device=self.device)
        normal, beyond = torch.randn_like(uniform), torch.empty_like(uniform).exponential_()
        within = torch.where(below, high, low) + uniform * torch.where(below | above, 0.0, high - low)
        within = within.maximum(low).minimum(high)
        drawn = torch.where(above, torch.where(below, normal, low + beyond), torch.where(below, high - beyond, within))
        return drawn.to(self.dtype)

    def to(self, dest: torch.dtype | torch.device | str | int | None) -> OpenBox:
        """Return the spec with another type, or on another device."""
        if dest is None:
            return self
        dtype, device = (dest, self.device) if isinstance(dest, torch.dtype) else (self.dtype, torch.device(dest))
        low, high = (side.to(device=device, dtype=dtype) for side in self.space)
        return type(self)(low, high, self.shape, device, dtype)


def box(low: Tensor, high: Tensor, shape: Sequence[int], dtype: torch.dtype) -> TensorSpec:
    """Return the spec of A real numbers [*shape, A] between ``low`` and ``high`` [A]."""
    size = torch.Size([*shape, len(low)])
    low, high = (side.to(dtype).expand(size).clone() for side in (low, high))
    if bool(torch.isinf(low).all() and torch.isinf(high).all()):
        return Unbounded(size, dtype=dtype)
    if bool(torch.isfinite(low).all() and torch.isfinite(high).all()):
        return Bounded(low, high, size, dtype=dtype)
    return OpenBox(low, high, size, dtype=dtype)


def form(satellite: SatelliteGroup) -> ContinuousBuilder | None:
    """Return the builder of a satellite's actions if they are continuous or hybrid; None if they are discrete."""
    actions = satellite.actions
    return actions if isinstance(actions, ContinuousBuilder) else None


def action_spec(satellite: SatelliteGroup, shape: Sequence[int], dtype: torch.dtype, extra: int = 0) -> TensorSpec:
    """Return the spec of a satellite's action; ``extra`` choices at the end continue the current task."""
    builder = form(satellite)
    if builder is None:
        return Categorical(satellite.actions.n_actions + extra, shape=torch.Size(shape), dtype=torch.int64)
    values = box(builder.low, builder.high, shape, dtype)
    if not builder.is_hybrid:
        return values
    choice = Categorical(builder.n_actions + extra, shape=torch.Size(shape), dtype=torch.int64)
    return Composite({VALUES: values, CHOICE: choice}, shape=torch.Size(shape))


def mask_size(satellite: SatelliteGroup, extra: int = 0) -> int:
    """Return the length of a satellite's ``action_mask``; 0 for continuous actions."""
    n = satellite.actions.n_actions
    return n + extra if n else 0


def mask_spec(size: int, shape: Sequence[int]) -> Binary:
    """Return the spec of a mask of ``size`` actions."""
    return Binary(size, shape=torch.Size([*shape, size]), dtype=torch.bool)


def read(title: str, action: object, satellite: SatelliteGroup, shape: Sequence[int], each: str = "") -> Tensor:
    """Return the actions of satellites of one type, [*shape] int64, or [*shape, A] or [*shape, A + 1] of a floating type.

    ``action`` is a tensor, or for a hybrid action a tensordict or mapping; ``each`` tells messages what dimensions mean.
    """
    builder = form(satellite)
    if builder is not None:
        no_gradient(title, action)
    if builder is not None and builder.is_hybrid and not isinstance(action, Tensor):
        return _joined(title, action, builder, tuple(shape))
    if not isinstance(action, Tensor):
        raise TypeError(f"{title} is {action!r}; it must be {_wanted(builder)}")
    if builder is None:
        if action.dtype.is_floating_point or action.dtype.is_complex or action.dtype == torch.bool:
            raise TypeError(f"{title} has dtype {action.dtype}; it must be an integer tensor, such as torch.int64")
        _check_shape(title, action, tuple(shape), each)
        return action.long()
    if not action.dtype.is_floating_point:
        raise TypeError(f"{title} has dtype {action.dtype}; it must be {_wanted(builder)}, of {_names(builder)}")
    _check_shape(title, action, (*shape, builder.width), f": {_names(builder)}")
    return action


def _wanted(builder: ContinuousBuilder | None) -> str:
    if builder is None:
        return "an integer tensor, such as torch.int64"
    if builder.is_hybrid:
        return f"a tensordict of {VALUES!r} and {CHOICE!r}"
    return "a floating-point tensor, such as torch.float32"


def _names(builder: ContinuousBuilder) -> str:
    return ", ".join([*builder.names, *(["choice"] if builder.is_hybrid else [])])


def _check_shape(title: str, action: Tensor, wanted: tuple[int, ...], each: str = "") -> None:
    if tuple(action.shape) != wanted:
        raise ValueError(f"{title} has shape {list(action.shape)}; it must be {list(wanted)}{each}")


def _joined(title: str, action: Any, builder: ContinuousBuilder, shape: tuple[int, ...]) -> Tensor:
    """Return the parts of hybrid actions side by side, [*shape, A + 1]."""
    keys = set(action.keys()) if hasattr(action, "keys") else set()
    if keys != {VALUES, CHOICE}:
        raise TypeError(f"{title} is {action!r}; it must be a tensordict of {VALUES!r} and {CHOICE!r}")
    values, choice = action[VALUES], action[CHOICE]
    if not isinstance(values, Tensor) or not values.dtype.is_floating_point:
        raise TypeError(f"{title}[{VALUES!r}] is {values!r}; it must be a floating-point tensor, such as torch.float32")
    if not isinstance(choice, Tensor) or choice.dtype.is_floating_point or choice.dtype == torch.bool:
        raise TypeError(f"{title}[{CHOICE!r}] is {choice!r}; it must be an integer tensor, such as torch.int64")
    _check_shape(f"{title}[{VALUES!r}]", values, (*shape, builder.width - 1), f": {', '.join(builder.names)}")
    _check_shape(f"{title}[{CHOICE!r}]", choice, shape)
    return torch.cat([values, choice.to(values.dtype).unsqueeze(-1)], -1)


def acts(action: Tensor, satellite: SatelliteGroup, extra: bool = False) -> Tensor:
    """Return which actions [...], [..., A] or [..., A + 1] are new tasks instead of continuing the current one.

    ``NO_ACTION`` continues the task, in all numbers of a continuous action (within 1 of it, because single precision cannot
    represent it) or as the choice of a hybrid one. So does, with ``extra``, the action or choice after those of the satellite.
    """
    builder, n = form(satellite), satellite.actions.n_actions
    if builder is None:
        new = action != NO_ACTION
        return new & (action != n) if extra else new
    close = (action - NO_ACTION).abs() <= CLOSE
    if not builder.is_hybrid:
        return ~close.all(-1)
    choice = action[..., -1]
    return ~(close[..., -1] | ((choice >= n) & (choice < n + extra)))
