"""Tracing of code on batches: a tensor [N, ...] whose entries of one row are values of a kernel.

Kernels are written on planes, users' properties on tensors ``[N]``, ``[N, 3]`` or ``[N, 3, 3]``. Called with :class:`Batch` in
their place, such code computes one row: sums, norms and products of matrices become operations on values. What mixes rows, asks
for their number or leaves torch raises :class:`bsk_torch.codegen.ir.UntraceableError`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, NoReturn

import numpy as np
import numpy.typing as npt
import torch

from bsk_torch.codegen.ir import UntraceableError
from bsk_torch.codegen.trace import COMPARISONS, FUNCTIONS, OPERATORS, UNARY, UNKNOWN, Proxy

Cells = npt.NDArray[np.object_]
"""Entries of a row: values of a kernel, or numbers."""


class Batch:
    """A float64 tensor [N, *shape], of which ``cells`` [*shape] are the entries of a row."""

    device = torch.device("cpu")
    __array_ufunc__ = None  # so that NumPy leaves operators with its arrays to this class

    def __init__(self, cells: object) -> None:
        """Stand for tensors with these entries; anything but an array is the entry of a tensor [N]."""
        self.cells = _cells(cells)

    @property
    def dtype(self) -> torch.dtype:
        """Type of the numbers: those of kernels are float64, or truth values."""
        truths = all(isinstance(cell, bool) or getattr(cell, "dtype", None) == torch.bool for cell in self.cells.flat)
        return torch.bool if truths else torch.float64

    @property
    def ndim(self) -> int:
        """Number of dimensions, that of the rows included."""
        return self.cells.ndim + 1

    @property
    def mT(self) -> Batch:
        """Transposed matrices."""
        return Batch(np.swapaxes(self.cells, -1, -2))

    @classmethod
    def __torch_function__(cls, func: Any, types: Any, args: Sequence[Any] = (), kwargs: Any = None) -> Any:
        return _call(getattr(func, "__name__", str(func)), "torch.", args, kwargs or {})

    def __getattr__(self, name: str) -> Any:
        """Tensor methods are the functions of the same name."""
        if name.startswith("__"):
            raise AttributeError(name)
        _known(name, "Tensor.")
        return lambda *args, **kwargs: _call(name, "Tensor.", (self, *args), kwargs)

    def __getitem__(self, index: object) -> Batch:
        first, *others = index if isinstance(index, tuple) else (index,)
        if first is not Ellipsis and first != slice(None):
            raise UntraceableError("a kernel computes one row, and cannot choose among rows; begin an index with : or ...")
        return Batch(self.cells[(Ellipsis, *others) if first is Ellipsis else tuple(others)])

    def __matmul__(self, other: object) -> Batch:
        return _matmul(self, other)

    def __rmatmul__(self, other: object) -> Batch:
        return _matmul(other, self)


def _refuse(*_: object, **__: object) -> NoReturn:
    raise UntraceableError(
        "Python cannot read or branch on numbers while a kernel is traced; use torch's functions, such as where"
    )


for _name in ("bool", "int", "float", "index", "len", "iter", "array", "contains", "setitem"):
    setattr(Batch, f"__{_name}__", _refuse)


def _cells(value: object) -> Cells:
    if isinstance(value, np.ndarray):
        return value
    cell = np.empty((), dtype=object)
    cell[()] = value
    return cell


def _operands(values: Sequence[object]) -> list[Cells]:
    """Return the entries of a row of batches, of constants that broadcast with them, and of numbers."""
    rank = max((value.ndim for value in values if isinstance(value, Batch)), default=1)
    return [_operand(value, rank) for value in values]


def _operand(value: object, rank: int) -> Cells:
    if isinstance(value, Batch):
        return value.cells
    if not isinstance(value, torch.Tensor):
        return _cells(value)
    value = value[0] if value.ndim == rank and value.shape[0] == 1 else value
    if value.ndim >= rank:
        raise UntraceableError(f"a constant of shape {list(value.shape)} has a number for each row")
    cells = np.empty(tuple(value.shape), dtype=object)
    cells[...] = np.asarray(value.tolist(), dtype=object)
    return cells


def _lifted(name: str) -> Callable[..., Batch]:
    """Return a function of kernels, applied to the entries of a row."""

    def of_cell(*cells: object, **kwargs: object) -> object:
        if any(isinstance(cell, Proxy) for cell in (*cells, *kwargs.values())):
            return FUNCTIONS[name](*cells, **kwargs)
        first, *others = (torch.tensor(cell, dtype=torch.float64) if isinstance(cell, float) else cell for cell in cells)
        return getattr(torch, name)(first, *others, **kwargs).item()

    def lifted(*args: object, **kwargs: object) -> Batch:
        arrays = {key: value for key, value in kwargs.items() if isinstance(value, Batch | torch.Tensor)}
        others = {key: value for key, value in kwargs.items() if key not in arrays}
        cells = _operands((*args, *arrays.values()))

        def apply(*entries: object) -> object:
            named = dict(zip(arrays, entries[len(args) :], strict=True))
            return of_cell(*entries[: len(args)], **named, **others)

        return Batch(np.frompyfunc(apply, len(cells), 1)(*cells))

    return lifted


_add, _mul, _div, _sqrt, _maximum, _minimum = map(_lifted, ("add", "mul", "div", "sqrt", "maximum", "minimum"))


def _axis(rank: int, dim: object) -> int:
    """Return a dimension of tensors [N, ...] with ``rank`` dimensions as one of a row, counted from its end."""
    if type(dim) is not int or not -rank < dim < rank or dim == 0:
        raise UntraceableError(f"dim={dim!r} is no single dimension behind the rows, and a kernel computes one row")
    return dim if dim < 0 else dim - rank


def _reduced(combine: Callable[[Batch, Batch], Batch]) -> Callable[..., Batch]:
    def reduced(x: Batch, dim: object = None, keepdim: bool = False) -> Batch:
        axis = _axis(x.ndim, dim[0] if isinstance(dim, tuple | list) and len(dim) == 1 else dim)
        first, *others = (Batch(part) for part in np.moveaxis(x.cells, axis, 0))
        for other in others:
            first = combine(first, other)
        return Batch(np.expand_dims(first.cells, axis)) if keepdim else first

    return reduced


_sum = _reduced(_add)
_any, _all = (_reduced(_lifted(f"bitwise_{op}")) for op in ("or", "and"))


def _mean(x: Batch, dim: object = None, keepdim: bool = False) -> Batch:
    return _div(_sum(x, dim, keepdim), float(x.cells.shape[_axis(x.ndim, dim)]))


def _norm(x: Batch, p: object = 2, dim: object = None, keepdim: bool = False) -> Batch:
    if p not in (2, None, "fro"):
        raise UntraceableError("only the Euclidean norm has a kernel")
    return _sqrt(_sum(_mul(x, x), dim, keepdim))


def _normalize(x: Batch, p: object = 2.0, dim: int = 1, eps: float = 1e-12, out: None = None) -> Batch:
    return _div(x, _maximum(_norm(x, p, dim, keepdim=True), eps))


def _dot(x: Batch, y: Batch, dim: int = -1) -> Batch:
    return _sum(_mul(x, y), dim)


def _cross(x: Batch, y: Batch, dim: int = -1) -> Batch:
    left, right = (np.moveaxis(cells, dim if dim < 0 else dim - 1, 0) for cells in _operands((x, y)))
    parts = [
        _lifted("sub")(_mul(*map(Batch, (left[i], right[j]))), _mul(*map(Batch, (left[j], right[i])))).cells
        for i, j in ((1, 2), (2, 0), (0, 1))
    ]
    return Batch(np.stack(parts, dim if dim < 0 else dim - 1))


def _einsum(spec: str, *factors: Any) -> Batch:
    factors = tuple(factors[0]) if len(factors) == 1 and isinstance(factors[0], tuple | list) else factors
    terms, out = spec.replace(" ", "").split("->")
    inputs = terms.split(",")
    rows = {
        term[:3] if term.startswith("...") else term[0] for term, x in zip(inputs, factors, strict=True) if isinstance(x, Batch)
    }
    if len(rows) != 1 or not out.startswith(row := rows.pop()):
        raise UntraceableError(f"einsum {spec!r} mixes rows")
    inputs, out = (
        [term.removeprefix(row) if isinstance(x, Batch) else term for term, x in zip(inputs, factors, strict=True)],
        out[len(row) :],
    )
    cells = _operands(factors)
    size = {letter: n for term, x in zip(inputs, cells, strict=True) for letter, n in zip(term, x.shape, strict=True)}
    inner = [letter for letter in size if letter not in out]
    result = np.empty(tuple(size[letter] for letter in out), dtype=object)
    for at in np.ndindex(result.shape):
        products = []
        for within in np.ndindex(*(size[letter] for letter in inner)):
            place = dict(zip((*out, *inner), (*at, *within), strict=True))
            entries = [x[tuple(place[letter] for letter in term)] for term, x in zip(inputs, cells, strict=True)]
            products.append(math.prod(entries[1:], start=entries[0]))
        result[at] = sum(products[1:], start=products[0])
    return Batch(result)


def _matmul(a: object, b: object) -> Batch:
    x, y = ((v.cells, True) if isinstance(v, Batch) else (_operand(v, 99), False) for v in (a, b))
    shapes = x[0].ndim, x[1], y[0].ndim, y[1]
    if shapes[0] == shapes[2] == 2 or shapes in ((1, True, 2, False), (2, True, 1, False)):
        return Batch(np.matmul(x[0], y[0]))
    raise UntraceableError(
        "only products of matrices have a kernel; multiply a vector v by a matrix as (M @ v.unsqueeze(-1)).squeeze(-1)"
    )


def _place(x: Batch, dim: int) -> int:
    """Return where a dimension is put in before, in a row."""
    return _axis(x.ndim + 1, dim)


def _stack(parts: Sequence[Any], dim: int = 0) -> Batch:
    cells = np.broadcast_arrays(*_operands(parts))
    return Batch(np.stack(cells, _place(Batch(cells[0]), dim)))


def _cat(parts: Sequence[Any], dim: int = 0) -> Batch:
    return Batch(np.concatenate([_operand(part, 99) for part in parts], _axis(1 + parts[0].cells.ndim, dim)))


STRUCTURAL: dict[str, Callable[..., Any]] = {
    "sum": _sum,
    "mean": _mean,
    "any": _any,
    "all": _all,
    "amax": _reduced(_maximum),
    "amin": _reduced(_minimum),
    "norm": _norm,
    "linalg_norm": _norm,
    "linalg_vector_norm": _norm,
    "normalize": _normalize,
    "linalg_vecdot": _dot,
    "cross": _cross,
    "linalg_cross": _cross,
    "einsum": _einsum,
    "matmul": _matmul,
    "bmm": _matmul,
    "stack": _stack,
    "cat": _cat,
    "concat": _cat,
    "unsqueeze": lambda x, dim: Batch(np.expand_dims(x.cells, _place(x, dim))),
    "squeeze": lambda x, dim: Batch(
        np.squeeze(x.cells, _axis(x.ndim, dim)) if x.cells.shape[_axis(x.ndim, dim)] == 1 else x.cells
    ),
    "unbind": lambda x, dim=0: tuple(Batch(part) for part in np.moveaxis(x.cells, _axis(x.ndim, dim), 0)),
    "new_tensor": lambda x, data: torch.tensor(data, dtype=torch.float64),
    "detach": lambda x: x,
    "to": lambda x, *args, **kwargs: _to(x, *args, **kwargs),
}
"""Functions of whole rows, by torch's names."""

ALIASES = {
    **{"arccos": "acos", "arcsin": "asin", "arctan": "atan", "arctan2": "atan2", "clip": "clamp", "absolute": "abs"},
    **{"negative": "neg", "subtract": "sub", "multiply": "mul", "divide": "div", "true_divide": "div"},
    **{"greater": "gt", "less": "lt", "greater_equal": "ge", "less_equal": "le", "concatenate": "cat"},
}


def _to(x: Batch, *args: object, **kwargs: object) -> Batch:
    wanted = {*args, *kwargs.values()} - {"cpu", torch.device("cpu")}
    if wanted - {torch.float64}:
        raise UntraceableError("properties are float64 until they are observed; a kernel does not round them before")
    return _lifted("double")(x) if torch.float64 in wanted else x


def _known(name: str, prefix: str) -> str:
    name = ALIASES.get(name, name)
    if name not in STRUCTURAL and (name not in FUNCTIONS or name == "float"):
        raise UntraceableError(f"{prefix}{name} {UNKNOWN}")
    return name


def _call(name: str, prefix: str, args: Sequence[Any], kwargs: dict[str, Any]) -> Any:
    name = _known(name, prefix)
    try:
        return STRUCTURAL[name](*args, **kwargs) if name in STRUCTURAL else _lifted(name)(*args, **kwargs)
    except (TypeError, ValueError) as error:
        if isinstance(error, UntraceableError):
            raise
        raise UntraceableError(f"{prefix}{name} has no kernel with these arguments: {error}") from error


def _operator(name: str, swapped: bool) -> Callable[[Batch, object], Batch]:
    function = _lifted(name)
    return lambda self, other: function(other, self) if swapped else function(self, other)


for _name, _function in OPERATORS.items():
    setattr(Batch, f"__{_name}__", _operator(_function, False))
    setattr(Batch, f"__r{_name}__", _operator(_function, True))
for _name in COMPARISONS:
    setattr(Batch, f"__{_name}__", _operator(_name, False))
for _name, _function in UNARY.items():
    setattr(Batch, f"__{_name}__", _lifted(_function))
