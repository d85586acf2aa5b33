"""Kernels of rows: short tensor code on [N] numbers, traced into one loop over the rows.

A tick is a vector program that repeats. What surrounds it, such as the end of a task, is a handful of operations on each row, for
which torch's calls take a hundred times as long as the numbers. The same code, called with the batches of :class:`RowTrace` in
place of tensors, becomes a loop without vectors. Its results equal torch's bit for bit: no product is fused with a sum.
Whole numbers are counted in float64, which holds them exactly up to 2**53, and powers of two beyond.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from bsk_torch.codegen import build
from bsk_torch.codegen.arrays import Batch
from bsk_torch.codegen.ir import TICK, UntraceableError, Value
from bsk_torch.codegen.trace import Proxy, Tracer

TYPES = {torch.float64: "double", torch.float32: "float", torch.int64: "int64_t", torch.bool: "bool"}

OPERATORS = {
    **{"add": "{0} + {1}", "sub": "{0} - {1}", "mul": "{0} * {1}", "div": "{0} / {1}", "neg": "-{0}", "abs": "std::fabs({0})"},
    **{"gt": "{0} > {1}", "lt": "{0} < {1}", "ge": "{0} >= {1}", "le": "{0} <= {1}", "eq": "{0} == {1}", "ne": "{0} != {1}"},
    **{"and": "{0} && {1}", "or": "{0} || {1}", "xor": "{0} != {1}", "not": "!{0}", "where": "{0} ? {1} : {2}"},
    **{name: f"std::{name}({{0}})" for name in ("floor", "ceil", "trunc", "sqrt")},
    # NaN if either is, as torch's
    "minimum": "({0} < {1} || {0} != {0}) ? {0} : {1}",
    "maximum": "({0} > {1} || {0} != {0}) ? {0} : {1}",
}
"""C++ of the operations of a row."""

HEAD = """#include <cmath>
#include <cstdint>
#include <limits>
#if defined(__clang__)
#pragma clang fp contract(off)
#elif defined(__GNUC__)
#pragma GCC optimize("fp-contract=off")
#endif
"""


class Argument(NamedTuple):
    """A tensor that a kernel reads: by row, or looked up where ``columns`` of a row, or numbers for all rows, stand."""

    name: str
    dtype: torch.dtype
    looked_up: str = ""  # "table" [K] or [K, L] of all rows, "columns" [N, K] of each, or "planes" [C, N], which change

    @property
    def text(self) -> str:
        """C++ name; a prefix keeps it apart from keywords."""
        return f"in_{self.name}"

    @property
    def parameters(self) -> list[str]:
        """Parameters of the function."""
        constant = "" if self.looked_up == "planes" else "const "
        return [f"{constant}{TYPES[self.dtype]}* {self.text}", *([f"int64_t size_{self.name}"] if self.looked_up else [])]


class Place(NamedTuple):
    """A plane of a state [C, N], the one whose number is the k-th of a table."""

    state: Argument
    numbers: Argument
    k: int

    @property
    def text(self) -> str:
        """C++ of the number of a row."""
        return f"{self.state.text}[{self.numbers.text}[{self.k}] * n + r]"


class Table:
    """Numbers that a row looks up."""

    def __init__(self, tracer: Tracer, argument: Argument) -> None:
        self._tracer, self.argument = tracer, argument

    def gather(self, dim: int, index: Batch) -> Any:
        """Return the number at an index [N, 1] of each row, [N, 1]."""
        return self[index].unsqueeze(-1)

    def __getitem__(self, index: object) -> Any:
        """Return the number at an index of each row, or at the same one in all."""
        place = index.cells.item() if isinstance(index, Batch) else index
        proxy = place if isinstance(place, Proxy) else self._tracer.constant(float(place), torch.float64)  # type: ignore[arg-type]
        dtype = torch.bool if self.argument.dtype == torch.bool else torch.float64
        return Batch(self._tracer._intern("lookup", (proxy,), self.argument, dtype, TICK))


class Columns(Batch):
    """A tensor [N, K], all numbers of a row of a table."""

    def __init__(self, table: Table, count: int) -> None:
        super().__init__(np.stack([table[k].cells for k in range(count)]))
        self.gather = table.gather


class RowTrace:
    """The arguments of a kernel of rows, for the code that it computes."""

    def __init__(self) -> None:
        self._tracer = Tracer()
        self.arguments: dict[str, Argument] = {}

    def _argument(self, *parts: Any) -> Argument:
        return self.arguments.setdefault(parts[0], Argument(*parts))

    def row(self, name: str, dtype: torch.dtype) -> Any:
        """Return the number of each row in a tensor with N entries."""
        argument = self._argument(name, dtype)
        number = torch.bool if dtype == torch.bool else torch.float64
        return Batch(self._tracer._intern("input", (), argument, number, TICK))

    def table(self, name: str, dtype: torch.dtype) -> Table:
        """Return a tensor [K] that all rows look up."""
        return Table(self._tracer, self._argument(name, dtype, "table"))

    def plane(self, state: str, numbers: str, k: int) -> Any:
        """Return a plane of ``state`` [C, N], the one whose number is the k-th of ``numbers`` [K]."""
        place = Place(self._argument(state, torch.float64, "planes"), self._argument(numbers, torch.int64, "table"), k)
        return Batch(self._tracer._intern("input", (), place, torch.float64, TICK))

    def columns(self, name: str, dtype: torch.dtype) -> Table:
        """Return a tensor [N, K] of which each row looks up its own numbers."""
        return Table(self._tracer, self._argument(name, dtype, "columns"))


class RowKernel:
    """A loop over rows; ``names`` are the arguments of a call, in their order."""

    def __init__(
        self,
        name: str,
        trace: RowTrace,
        outputs: Mapping[str, tuple[Any, ...]],
        largest: Sequence[object] = (),
        stored: Mapping[int, tuple[Batch, object]] | None = None,
        refused: object = None,
    ) -> None:
        """Build the loop that computes ``outputs`` and the ``largest`` of some values over all rows.

        Outputs are a value, its dtype, and the dimensions of its tensor behind the rows, which are ones. ``stored`` are planes,
        each with the value that replaces it. Where a row is ``refused``, nothing is written, and the largest values are
        infinite. UntraceableError for operations that loops over rows do not have.
        """
        self.names = tuple(trace.arguments)
        self._outputs = [(dtype, tuple(shape)) for _, dtype, *shape in outputs.values()]
        self._largest = len(largest)
        self._looked_up = [argument.looked_up for argument in trace.arguments.values()]
        self.source = _source(
            list(trace.arguments.values()),
            [(_value(value), dtype) for value, dtype, *_ in outputs.values()],
            [_value(value) for value in largest],
            [(_value(plane).attr, _value(value)) for plane, value in (stored or {}).values()],
            None if refused is None else _value(refused),
        )
        signature = "i" + "".join("pi" if looked_up else "p" for looked_up in self._looked_up) + "p" * len(outputs) + "p"
        self._run: Callable[..., None] = build.entry(build.load(self.source, name), signature)

    def __call__(self, n: int, inputs: Mapping[str, Any]) -> tuple[list[Tensor], list[float]]:
        """Return outputs of ``n`` rows, and the largest values; ``inputs`` are contiguous tensors of the traced dtypes."""
        arguments: list[Tensor | int] = []
        for name, looked_up in zip(self.names, self._looked_up, strict=True):
            argument = inputs[name]
            arguments.append(argument)
            if looked_up:
                arguments.append(argument.numel() if looked_up == "table" else argument.shape[-1])
        outputs = [torch.empty(n, *shape, dtype=dtype) for dtype, shape in self._outputs]
        largest = torch.empty(self._largest, dtype=torch.float64) if self._largest else None
        self._run(n, *arguments, *outputs, largest)
        return outputs, [] if largest is None else largest.tolist()


def _value(value: object) -> Value:
    cell = value.cells.item() if isinstance(value, Batch) else value
    if not isinstance(cell, Value):
        raise UntraceableError(f"{cell!r} does not follow from the arguments of a kernel of rows")
    return cell


def _live(values: Sequence[Value]) -> list[Value]:
    live: dict[int, Value] = {}
    waiting = list(values)
    while waiting:
        value = waiting.pop()
        if value.index not in live:
            live[value.index] = value
            waiting.extend(value.args)
    return [live[index] for index in sorted(live)]


def _source(
    arguments: list[Argument],
    outputs: list[tuple[Value, torch.dtype]],
    largest: list[Value],
    stored: list[tuple[Place, Value]],
    refused: Value | None,
) -> str:
    parameters = ["int64_t n", *(part for argument in arguments for part in argument.parameters)]
    parameters += [f"{TYPES[dtype]}* out_{k}" for k, (_, dtype) in enumerate(outputs)] + ["double* largest"]
    each = "  for (int64_t r = 0; r < n; ++r) {"
    lines = [HEAD, f'extern "C" void run({", ".join(parameters)}) {{']
    lines += [f"  double most_{k} = -std::numeric_limits<double>::infinity();" for k in range(len(largest))]
    if refused is not None:
        infinite = "".join(f"largest[{k}] = " for k in range(len(largest))) + "std::numeric_limits<double>::infinity()"
        lines += [each, *_computed([refused]), f"    if ({_name(refused)}) {{ {infinite}; return; }}", "  }"]
    values = [value for value, _ in outputs] + largest + [value for _, value in stored]
    lines += [each, *_computed(values)]
    lines += [f"    out_{k}[r] = {TYPES[dtype]}({_name(value)});" for k, (value, dtype) in enumerate(outputs)]
    lines += [f"    {place.text} = {_name(value)};" for place, value in stored]
    lines += [f"    if (double({_name(v)}) > most_{k}) most_{k} = double({_name(v)});" for k, v in enumerate(largest)]
    lines += ["  }", *(f"  largest[{k}] = most_{k};" for k in range(len(largest))), "}"]
    return "\n".join(lines) + "\n"


def _computed(values: Sequence[Value]) -> list[str]:
    live = (value for value in _live(values) if value.op != "constant")
    return [f"    const {TYPES[value.dtype]} v{value.index} = {_expression(value)};" for value in live]


def _name(value: Value) -> str:
    if value.op != "constant":
        return f"v{value.index}"
    if value.dtype == torch.bool:
        return str(value.number).lower()
    if math.isfinite(value.number):
        return f"({value.number!r})"
    limit = "quiet_NaN" if math.isnan(value.number) else "infinity"
    return f"({'-' if value.number < 0 else ''}std::numeric_limits<double>::{limit}())"


def _expression(value: Value) -> str:
    args = [_name(arg) for arg in value.args]
    if value.op == "input" and isinstance(value.attr, Place):
        return value.attr.text
    if value.op == "input":
        return f"{TYPES[value.dtype]}({value.attr.text}[r])"
    if value.op == "lookup":
        name, size = value.attr.text, f"size_{value.attr.name}"
        first = f"r * {size} + " if value.attr.looked_up == "columns" else ""
        # an index that is out of range, which the caller finds among the largest values, reads what is there
        index = f"int64_t({args[0]} >= 0 && {args[0]} < double({size}) ? {args[0]} : 0)"
        return f"{TYPES[value.dtype]}({name}[{first}{index}])"
    if value.op == "cast":
        return f"{args[0]} != 0" if value.dtype == torch.bool else f"double({args[0]})"
    if value.op not in OPERATORS or value.dtype == torch.float32:
        raise UntraceableError(f"{value.op} has no loop over rows")
    return OPERATORS[value.op].format(*args)
