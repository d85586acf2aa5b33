"""Tracing: tensor code becomes a program.

Elementwise tensor code runs unchanged when called with the values of a :class:`Tracer` instead of tensors: operators and torch
functions on a :class:`Proxy` add operations to the tracer's program, with torch's type promotion. Everything else raises
:class:`bsk_torch.codegen.ir.UntraceableError` with a reason.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, NoReturn, cast

import torch

from bsk_torch.codegen.ir import Program, UntraceableError, Value, require_dtype


class Proxy(Value):
    """A value that stands for a tensor [n] in tensor code."""

    def only(self, compute: Callable[[], Sequence[object]], otherwise: Sequence[object]) -> list[Proxy]:
        """Return ``compute()`` where this mask holds, else ``otherwise``; computed only if it holds in some row of a block."""
        _require_mask("only", self)
        tracer = self.program
        if self.number is not None:
            chosen = 0 if self.number else 1
            return [_pair(tracer, *pair)[chosen] for pair in zip(compute(), otherwise, strict=True)]
        with tracer.branch(self) as region:
            pairs = [_pair(tracer, *pair) for pair in zip(compute(), otherwise, strict=True)]
        return tracer.merge(region, pairs)

    def to(self, dtype: torch.dtype) -> Proxy:
        """Return the same numbers as another type."""
        return self.program.cast(self, require_dtype(dtype))

    __hash__ = object.__hash__  # proxies are equal where they are the same; ``==`` is an operation

    @classmethod
    def __torch_function__(cls, func: Any, types: Any, args: Sequence[Any] = (), kwargs: Any = None) -> Any:
        return _build(getattr(func, "__name__", str(func)), "torch.", args, kwargs or {})

    def __getattr__(self, name: str) -> Any:
        """Tensor methods are the functions of the same name."""
        if name.startswith("__"):
            raise AttributeError(name)
        if name not in FUNCTIONS:
            raise UntraceableError(f"Tensor.{name} {UNKNOWN}")
        return lambda *args, **kwargs: _build(name, "Tensor.", (self, *args), kwargs)


class Tracer(Program[Proxy]):
    """A program whose values can be given to tensor code."""

    value_type = Proxy


UNKNOWN = "has no kernel: kernels compute element by element, what bsk_torch.codegen.trace.FUNCTIONS lists"


def _build(name: str, prefix: str, args: Sequence[object], kwargs: dict[str, object]) -> Proxy:
    if name not in FUNCTIONS:
        raise UntraceableError(f"{prefix}{name} {UNKNOWN}")
    try:
        return FUNCTIONS[name](*args, **kwargs)
    except TypeError as error:
        if isinstance(error, UntraceableError):
            raise
        raise UntraceableError(f"{prefix}{name} has no kernel with these arguments: {error}") from error


# -- arguments ---------------------------------------------------------------------------------------------------------------


def _program(args: Sequence[object]) -> Program[Proxy]:
    return next(arg.program for arg in args if isinstance(arg, Proxy))


def as_value(program: Program[Proxy], value: object, dtype: torch.dtype) -> Proxy:
    """Return a value, a number or a tensor without dimensions as a value of a type."""
    if isinstance(value, Proxy):
        return program.cast(value, dtype)
    if isinstance(value, torch.Tensor):
        if value.ndim:
            raise UntraceableError("a kernel cannot hold a tensor with dimensions; make it a parameter of the component")
        value = value.item()
    if not isinstance(value, int | float):
        raise UntraceableError(f"{value!r} is neither a number nor a value of a kernel")
    return program.constant(value, dtype)


def _literal_dtype(value: object) -> torch.dtype:
    """Return the type of a number or a tensor without dimensions among booleans: torch's, as long as its default is float32."""
    if isinstance(value, torch.Tensor):
        return require_dtype(value.dtype)
    if isinstance(value, bool):
        return torch.bool
    return require_dtype(torch.float32 if isinstance(value, float) else torch.int64)


def _common(program: Program[Proxy], args: tuple[object, ...]) -> tuple[Proxy, ...]:
    """Return arguments as values of one type, by torch's promotion: numbers adapt to values, unless these are booleans."""
    dtypes = {arg.dtype if isinstance(arg, Proxy) else None for arg in args}
    if len(dtypes) == 1 and None not in dtypes:
        return cast("tuple[Proxy, ...]", args)  # all are values already, and of one type
    dtypes.discard(None)
    if dtypes <= {torch.bool}:
        dtypes |= {_literal_dtype(arg) for arg in args if not isinstance(arg, Proxy)}
    dtype = next(d for d in (torch.float64, torch.float32, torch.bool) if d in dtypes)
    return tuple(as_value(program, arg, dtype) for arg in args)


def _pair(program: Program[Proxy], a: object, b: object) -> tuple[Proxy, Proxy]:
    a, b = _common(program, (a, b))
    return a, b


def _require_mask(name: str, *values: Value) -> None:
    if any(value.dtype != torch.bool for value in values):
        raise UntraceableError(f"{name} needs booleans; compare numbers with something first")


# -- operations --------------------------------------------------------------------------------------------------------------


def _numeric(op: str) -> Callable[..., Proxy]:
    """Return a builder of ``op``, whose arguments and result are of one type; some mean something for booleans, too."""

    def build(*args: object) -> Proxy:
        program = _program(args)
        values = _common(program, args)
        if values[0].dtype != torch.bool:
            return program.operation(op, values, values[0].dtype)
        if op not in BOOLEAN:
            raise UntraceableError(f"{op} of booleans has no kernel; make them numbers with .to(dtype)")
        return program.operation(BOOLEAN[op], values, torch.bool)

    return build


def _comparison(op: str) -> Callable[..., Proxy]:
    def build(a: object, b: object) -> Proxy:
        program = _program((a, b))
        values = _common(program, (a, b))
        if values[0].dtype != torch.bool:
            return program.operation(op, values, torch.bool)
        if op not in ("eq", "ne"):
            raise UntraceableError(f"{op} of booleans has no kernel; make them numbers with .to(dtype)")
        differ = program.operation("xor", values, torch.bool)
        return differ if op == "ne" else program.operation("not", (differ,), torch.bool)

    return build


def _logical(op: str, truths: bool) -> Callable[..., Proxy]:
    """Return a builder of ``op`` on booleans; with ``truths``, numbers are true unless they are zero."""

    def build(*args: object) -> Proxy:
        program = _program(args)
        values = tuple(as_value(program, arg, torch.bool) for arg in args) if truths else _common(program, args)
        _require_mask(op, *values)
        return program.operation(op, values, torch.bool)

    return build


def _clamp(x: Proxy, min: object = None, max: object = None) -> Proxy:
    lowered = x if min is None else _numeric("maximum")(x, min)
    return lowered if max is None else _numeric("minimum")(lowered, max)


def _where(mask: object, yes: object, no: object) -> Proxy:
    program = _program((mask, yes, no))
    mask = mask if isinstance(mask, Proxy) else as_value(program, mask, torch.bool)
    _require_mask("where", mask)
    yes, no = _common(program, (yes, no))
    return program.operation("where", (mask, yes, no), yes.dtype)


def _filled(number: float) -> Callable[..., Proxy]:
    return lambda x, dtype=None, **_: _full_like(x, number, dtype)


def _full_like(x: Proxy, number: float, dtype: torch.dtype | None = None, **_: object) -> Proxy:
    return as_value(x.program, number, require_dtype(dtype) if dtype else x.dtype)


def _power(x: Proxy, exponent: object) -> Proxy:
    if isinstance(exponent, Proxy) or exponent not in (2, 3):
        raise UntraceableError("only squares and cubes have a kernel; write other powers with products, roots, exp and log")
    square = _numeric("mul")(x, x)
    return square if exponent == 2 else _numeric("mul")(square, x)


def _remainder(x: object, divisor: object) -> Proxy:
    """``x - floor(x / divisor) * divisor``: fmod has the sign of x, the remainder that of the divisor."""
    x, divisor = _common(_program((x, divisor)), (x, divisor))
    rest = x.fmod(divisor)
    return _where(rest.ne(0.0).bitwise_and(rest.lt(0.0).bitwise_xor(divisor.lt(0.0))), rest.add(divisor), rest)


ELEMENTARY = ("neg", "abs", "sign", "sqrt", "floor", "ceil", "trunc", "round")
EXPONENTIAL = ("exp", "expm1", "log", "log1p", "log2", "log10")
TRIGONOMETRIC = ("sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh")
BINARY = ("add", "sub", "mul", "div", "minimum", "maximum", "atan2", "hypot", "fmod")
COMPARISONS = ("gt", "lt", "ge", "le", "eq", "ne")
LOGICAL = ("and", "or", "xor", "not")
BOOLEAN = {"mul": "and", "minimum": "and", "add": "or", "maximum": "or"}

FUNCTIONS: dict[str, Callable[..., Proxy]] = {
    **{name: _numeric(name) for name in (*ELEMENTARY, *EXPONENTIAL, *TRIGONOMETRIC, *BINARY)},
    **{name: _comparison(name) for name in COMPARISONS},
    **{f"bitwise_{op}": _logical(op, False) for op in LOGICAL},
    **{f"logical_{op}": _logical(op, True) for op in LOGICAL},
    "remainder": _remainder,
    "reciprocal": lambda x: _numeric("div")(1.0, x),
    "rsqrt": lambda x: _numeric("div")(1.0, _numeric("sqrt")(x)),
    "square": lambda x: _power(x, 2),
    "pow": _power,
    "deg2rad": lambda x: _numeric("mul")(x, math.pi / 180.0),
    "rad2deg": lambda x: _numeric("mul")(x, 180.0 / math.pi),
    "clamp": _clamp,
    "where": _where,
    "masked_fill": lambda x, mask, value: _where(mask, value, x),
    "isnan": lambda x: _comparison("ne")(x, x),
    "isinf": lambda x: _comparison("eq")(_numeric("abs")(x), math.inf),
    "isfinite": lambda x: _comparison("lt")(_numeric("abs")(x), math.inf),
    "zeros_like": _filled(0.0),
    "ones_like": _filled(1.0),
    "full_like": _full_like,
    "clone": lambda x, **_: x,
    "double": lambda x: x.to(torch.float64),
    "float": lambda x: x.to(torch.float32),
    "bool": lambda x: x.to(torch.bool),
}
"""Functions that a kernel can compute, by torch's names."""

# -- operators ---------------------------------------------------------------------------------------------------------------

OPERATORS = {"add": "add", "sub": "sub", "mul": "mul", "truediv": "div", "mod": "remainder"} | {
    name: f"bitwise_{name}" for name in ("and", "or", "xor")
}
UNARY = {"neg": "neg", "abs": "abs", "invert": "bitwise_not", "pow": "pow"}
REFUSED = {
    "bool": "Python cannot branch on a value of a kernel; use torch.where",
    **dict.fromkeys(
        ("int", "float", "index", "complex"), "Python cannot read numbers while a kernel is traced; use torch's functions"
    ),
    **dict.fromkeys(("len", "iter", "getitem", "setitem", "contains"), "a value of a kernel is one number and has no elements"),
    **dict.fromkeys(("matmul", "rmatmul"), "a value of a kernel is one number; use Vec3 and Mat3"),
    **dict.fromkeys(("floordiv", "rfloordiv"), "use torch.floor of a quotient"),
    **dict.fromkeys(("rpow", "lshift", "rlshift", "rshift", "rrshift", "divmod", "rdivmod"), f"this operator {UNKNOWN}"),
}
"""Operators that proxies do not have, and why."""


def _operator(name: str, swapped: bool) -> Callable[[Proxy, object], object]:
    build = FUNCTIONS[name]

    def method(self: Proxy, other: object) -> object:
        if isinstance(other, tuple):
            return NotImplemented
        return build(other, self) if swapped else build(self, other)

    return method


def _refusal(reason: str) -> Callable[..., NoReturn]:
    def method(*_: object) -> NoReturn:
        raise UntraceableError(reason)

    return method


for _name, _function in OPERATORS.items():
    setattr(Proxy, f"__{_name}__", _operator(_function, False))
    setattr(Proxy, f"__r{_name}__", _operator(_function, True))
for _name in COMPARISONS:
    setattr(Proxy, f"__{_name}__", _operator(_name, False))
for _name, _function in UNARY.items():
    setattr(Proxy, f"__{_name}__", FUNCTIONS[_function])
for _name, _reason in REFUSED.items():
    setattr(Proxy, f"__{_name}__", _refusal(_reason))
