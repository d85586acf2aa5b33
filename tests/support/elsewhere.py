"""A device that this machine does not have, to test without a GPU what runs on one.

Within :class:`Device`, tensors with ``device="meta"`` have values, which the host computes; everything else is as on a GPU. A
tensor of the host and one of the device do not mix, and kernels of the host cannot read the device's tensors. ``waits`` counts
what makes the host wait for the device: reading a number or a mask's size, and copies between the two.
"""

from collections import Counter
from contextlib import ExitStack
from types import ModuleType
from typing import Any
from unittest import mock

import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode
from torch.utils import _pytree
from torch.utils._python_dispatch import TorchDispatchMode, _disable_current_modes

import bsk_torch.env.base
import bsk_torch.sim.access.visibility.tensors
import bsk_torch.sim.dyn.forces.field
import bsk_torch.sim.orbit.picard
import bsk_torch.sim.tick.runners
from tests.env.default_dtype import line_of_package

NAME = "meta"

READS = {"_local_scalar_dense", "equal", "is_nonzero", "nonzero", "masked_select", "_unique2", "unique_dim", "unique_consecutive"}
"""Operators whose result, or its shape, the host has to know."""

HOST_ONLY = {Tensor.numpy, Tensor.data_ptr}


class Elsewhere(Tensor):
    """A tensor on the device: ``values`` is the same on the host."""

    values: Tensor
    __torch_function__ = torch._C._disabled_torch_function_impl

    @staticmethod
    def __new__(cls, values: Tensor) -> "Elsewhere":
        like = dict(strides=values.stride(), storage_offset=values.storage_offset(), dtype=values.dtype)
        tensor = torch.Tensor._make_wrapper_subclass(cls, values.shape, device=NAME, **like)
        tensor.values = values
        return tensor

    @classmethod
    def __torch_dispatch__(cls, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        raise RuntimeError(f"{func} of a tensor on a device that is not there any more")


def on_host(tree: Any) -> Any:
    return _pytree.tree_map_only(Elsewhere, lambda tensor: tensor.values, tree)


def on_device(tree: Any) -> Any:
    return _pytree.tree_map_only(Tensor, Elsewhere, tree)


def opaque(function: Any, _name: str = "") -> Any:
    """Return ``function`` of tensors as something that the device runs as a whole, as it runs what inductor has compiled."""

    def call(*tensors: Any) -> Any:
        with _disable_current_modes():
            result = function(*on_host(tensors))
        return on_device(result) if any(isinstance(tensor, Elsewhere) for tensor in tensors) else result

    return call


class Device(TorchDispatchMode):
    """Within it, there is the device :data:`NAME`.

    Attributes:
        waits: How often the host has waited for it, by operator and line.
        ran: Its operators in order, with the shapes of their results.
    """

    def __init__(self) -> None:
        super().__init__()
        self.waits: Counter[tuple[str, str]] = Counter()
        self.ran: list[tuple[str, tuple[int, ...]]] = []

    def __enter__(self) -> "Device":
        sim = bsk_torch.sim
        with ExitStack() as stack:
            stack.enter_context(Calls())
            for module in (sim.dyn.forces.field, sim.orbit.picard, sim.tick.runners):
                stack.enter_context(mock.patch.object(module, "just_in_time", opaque))
            visibility: ModuleType = sim.access.visibility.tensors
            stack.enter_context(mock.patch.object(visibility, "positions", opaque(visibility.positions)))  # 160 operators
            stack.enter_context(mock.patch.object(bsk_torch.env.base, "existing_device", torch.device))
            self.undone = stack.pop_all()
        sim.orbit.picard.kernels.cache_clear()
        super().__enter__()
        return self

    def __exit__(self, *error: Any) -> None:
        super().__exit__(*error)
        self.undone.__exit__(*error)
        bsk_torch.sim.orbit.picard.kernels.cache_clear()

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        name, kwargs = func.overloadpacket.__name__, dict(kwargs or {})
        leaves = [leaf for leaf in _pytree.tree_leaves((args, kwargs)) if isinstance(leaf, Tensor)]
        was_here = any(isinstance(leaf, Elsewhere) for leaf in leaves)
        target = kwargs.get("device")
        is_here = was_here if target is None else torch.device(target).type == NAME
        if target is not None:
            kwargs["device"] = "cpu"
        indices = _pytree.tree_leaves(args[1]) if name.startswith("index") and isinstance(args[1], list | tuple) else []
        others = [leaf for leaf in leaves if not isinstance(leaf, Elsewhere) and leaf.dim()]
        moved = (was_here != is_here and bool(leaves)) or (name == "copy_" and bool(others) and was_here)
        if was_here and others and not moved and not all(any(other is index for index in indices) for other in others):
            raise RuntimeError(f"{func} of tensors on the device and of {[tuple(other.shape) for other in others]} on the host")
        by_mask = any(isinstance(index, Tensor) and index.dtype == torch.bool for index in indices)
        uneven = name == "repeat_interleave" and kwargs.get("output_size") is None
        if moved or (was_here and (name in READS or by_mask or uneven or others)):
            self.waits[name, line_of_package(1) or ""] += 1
        result = func(*on_host(args), **on_host(kwargs))
        if not is_here or not isinstance(result, Tensor | tuple | list):
            return result
        if func._schema.is_mutable and isinstance(args[0], Elsewhere):
            return args[0]
        result = on_device(result)
        self.ran.append((name, tuple(result.shape) if isinstance(result, Tensor) else ()))
        return result


class Calls(TorchFunctionMode):
    """What does not become an operator."""

    def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        kwargs = kwargs or {}
        here = bool(args) and isinstance(args[0], Elsewhere)
        if here and func in HOST_ONLY:
            raise TypeError(f"{func.__name__}() of a tensor on the device: use Tensor.cpu() to copy it to the host first")
        if here and func is Tensor.tolist:
            return args[0].cpu().tolist()
        if here and func is Tensor.new_tensor:
            return torch.tensor(*args[1:], **{"dtype": args[0].dtype, **kwargs}).to(NAME)
        if here and func is Tensor.__getitem__ and isinstance(args[1], list):
            return args[0][torch.tensor(args[1]).to(NAME)]  # a copy each time, so a wait
        target = kwargs.get("device")
        if func in (torch.tensor, torch.as_tensor) and not here and target is not None and torch.device(target).type == NAME:
            return func(*args, **{**kwargs, "device": "cpu"}).to(NAME)  # the real one would have no values
        return func(*args, **kwargs)
