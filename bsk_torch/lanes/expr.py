"""Symbolic planes: what tensor code computes, written down once for every lane.

A :class:`Plane` stands for one number of every environment. Tensor code that is given planes instead of tensors, and only
computes element by element, runs as it is: operators and torch functions add statements to a :class:`Program`. Equal statements
are stored once, constants are folded, and every statement knows what it depends on, so that what does not change from tick to
tick can leave the loop.
"""

from __future__ import annotations

import ctypes
import math
import operator
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, NoReturn

import torch

DOUBLE, SINGLE, MASK = "double", "float", "mask"
KINDS = {torch.float64: DOUBLE, torch.float32: SINGLE, torch.bool: MASK}
DTYPES = {kind: dtype for dtype, kind in KINDS.items()}

ALWAYS, TICK = 0, -1
"""How long a value lasts: the whole call, or one tick; a positive number is the track whose record it lasts."""


def shortest(spans: Iterable[int]) -> int:
    """How long a value lasts that depends on values that last ``spans``."""
    left = set(spans) - {ALWAYS}
    return ALWAYS if not left else left.pop() if len(left) == 1 else TICK


class UntraceableError(TypeError):
    """Tensor code does something that cannot be written down element by element."""


def kind_of(dtype: torch.dtype) -> str:
    """The kind of plane that holds numbers of a type."""
    if dtype not in KINDS:
        raise UntraceableError(f"a kernel has no numbers of type {dtype}, only {', '.join(str(known) for known in KINDS)}")
    return KINDS[dtype]


class Program:
    """Statements in the order in which they were made; a region is a list of statements that run under a condition."""

    def __init__(self) -> None:
        """Start an empty program."""
        self.root = Region(None, None)
        self.region = self.root
        self.count = 0

    def constant(self, value: float | bool, kind: str) -> Plane:
        """A plane that is the same everywhere; the value is rounded to its kind."""
        exact = bool(value) if kind == MASK else ctypes.c_float(value).value if kind == SINGLE else float(value)
        return self._intern("constant", (exact,), kind, ALWAYS)

    def input(self, name: tuple[Any, ...], kind: str, lasts: int) -> Plane:
        """A plane that the kernel loads: its source and its number there."""
        return self._intern("input", name, kind, lasts)

    def statement(self, op: str, args: tuple[Any, ...], kind: str) -> Plane:
        """The plane ``op(args)``, an equal one that exists, or its value where that is known."""
        folded = _fold(self, op, args, kind)
        if folded is not None:
            return folded
        return self._intern(op, args, kind, shortest(a.lasts for a in args))

    def _intern(self, op: str, args: tuple[Any, ...], kind: str, lasts: int) -> Plane:
        # repr tells 0.0 from -0.0
        key = (op, tuple(a.index if isinstance(a, Plane) else repr(a) for a in args), kind)
        home = self.region if lasts == TICK and op != "input" else self.root
        home.require_visible(a for a in args if isinstance(a, Plane))
        for scope in home.chain():
            if key in scope.known:
                return scope.known[key]
        plane = Plane(self, op, args, kind, lasts, home, self.count)
        self.count += 1
        home.known[key] = plane
        home.statements.append(plane)
        return plane

    def only(self, mask: Plane, compute: Callable[[], Sequence[Any]], otherwise: Sequence[Any]) -> list[Plane]:
        """Planes of ``compute()`` where ``mask`` holds, else ``otherwise``; computed only if ``mask`` holds in some lane."""
        _require_mask("only", mask)
        if mask.value is not None:
            return [_common(self, pair)[0 if mask.value else 1] for pair in zip(compute(), otherwise, strict=True)]
        region = Region(mask, self.region)
        outer, self.region = self.region, region
        try:
            pairs = [_common(self, pair) for pair in zip(compute(), otherwise, strict=True)]
        finally:
            self.region = outer
        region.require_visible(inner for inner, _ in pairs)
        outer.require_visible((mask, *(other for _, other in pairs)))
        outer.statements.append(region)
        return [self._merge(region, mask, *pair) for pair in pairs]

    def _merge(self, region: Region, mask: Plane, inner: Plane, outer: Plane) -> Plane:
        if inner is outer:
            return inner
        plane = Plane(self, "merge", (mask, inner, outer), inner.kind, TICK, self.region, self.count)
        self.count += 1
        self.region.statements.append(plane)
        region.merges.append(plane)
        return plane


class Region:
    """Statements under a common condition."""

    def __init__(self, mask: Plane | None, parent: Region | None) -> None:
        """A region inside ``parent`` that runs where ``mask`` holds somewhere."""
        self.mask, self.parent = mask, parent
        self.statements: list[Plane | Region] = []
        self.known: dict[Any, Plane] = {}
        self.merges: list[Plane] = []
        """What leaves the region."""

    def chain(self) -> Iterator[Region]:
        """This region and those around it, from the inside out."""
        region: Region | None = self
        while region is not None:
            yield region
            region = region.parent

    def require_visible(self, planes: Iterable[Plane]) -> None:
        """Refuse planes that may not have been computed when this region's statements run."""
        inner = {plane.home for plane in planes if plane.home is not self and plane.home.parent is not None}
        if inner and not inner <= set(self.chain()):
            raise UntraceableError("what is computed only where a mask holds must leave as a result of only()")


class Plane:
    """One number of every lane: the result of ``op`` on ``args``."""

    def __init__(self, program: Program, op: str, args: tuple[Any, ...], kind: str, lasts: int, home: Region, index: int) -> None:
        """Made by :class:`Program` only."""
        self.program, self.op, self.args, self.kind, self.lasts = program, op, args, kind, lasts
        self.home, self.index = home, index

    @property
    def dtype(self) -> torch.dtype:
        """Type of the numbers."""
        return DTYPES[self.kind]

    @property
    def value(self) -> Any:
        """The number, where the plane is a constant, else None."""
        return self.args[0] if self.op == "constant" else None

    def only(self, compute: Callable[[], Sequence[Any]], otherwise: Sequence[Any]) -> list[Plane]:
        """See :meth:`Program.only`."""
        return self.program.only(self, compute, otherwise)

    def to(self, dtype: torch.dtype) -> Plane:
        """The same numbers as another type."""
        return _cast(self, kind_of(dtype))

    def __hash__(self) -> int:
        """Planes are equal where they are the same."""
        return id(self)

    @classmethod
    def __torch_function__(cls, func: Any, types: Any, args: Sequence[Any] = (), kwargs: Any = None) -> Any:
        """Torch functions on planes add statements."""
        return _build(getattr(func, "__name__", str(func)), "torch.", args, kwargs or {})

    def __getattr__(self, name: str) -> Any:
        """Tensor methods are the functions of the same name."""
        if name.startswith("__"):
            raise AttributeError(name)
        if name not in FUNCTIONS:
            raise UntraceableError(f"Tensor.{name} {UNKNOWN}")
        return lambda *args, **kwargs: _build(name, "Tensor.", (self, *args), kwargs)


UNKNOWN = "has no kernel: kernels compute element by element, what bsk_torch.lanes.expr.FUNCTIONS lists"


def _build(name: str, prefix: str, args: Sequence[Any], kwargs: dict[str, Any]) -> Plane:
    """The statement of a torch function."""
    if name not in FUNCTIONS:
        raise UntraceableError(f"{prefix}{name} {UNKNOWN}")
    try:
        return FUNCTIONS[name](*args, **kwargs)
    except TypeError as error:
        if isinstance(error, UntraceableError):
            raise
        raise UntraceableError(f"{prefix}{name} has no kernel with these arguments: {error}") from error


# -- statements --------------------------------------------------------------------------------------------------------------


def _program(args: Sequence[Any]) -> Program:
    return next(a.program for a in args if isinstance(a, Plane))


def as_kind(program: Program, value: Any, kind: str) -> Plane:
    """A plane, a number or a tensor without dimensions as a plane of some kind."""
    if isinstance(value, Plane):
        return _cast(value, kind)
    if isinstance(value, torch.Tensor):
        if value.ndim:
            raise UntraceableError("a kernel cannot hold a tensor with dimensions; make it a parameter of the component")
        value = value.item()
    if not isinstance(value, int | float):
        raise UntraceableError(f"{value!r} is neither a number nor a plane")
    return program.constant(value, kind)


def _cast(plane: Plane, kind: str) -> Plane:
    return plane if plane.kind == kind else plane.program.statement("cast", (plane,), kind)


def _literal_kind(value: Any) -> str:
    """The kind that torch gives a number or a tensor without dimensions among booleans."""
    if isinstance(value, torch.Tensor):
        return kind_of(value.dtype)
    if isinstance(value, bool):
        return MASK
    return kind_of(torch.get_default_dtype() if isinstance(value, float) else torch.int64)


def _common(program: Program, args: Sequence[Any]) -> tuple[Plane, ...]:
    """Arguments as planes of one kind, by torch's promotion: numbers adapt to planes, unless these are booleans."""
    kinds = {a.kind for a in args if isinstance(a, Plane)}
    if kinds <= {MASK}:
        kinds |= {_literal_kind(a) for a in args if not isinstance(a, Plane)}
    kind = DOUBLE if DOUBLE in kinds else SINGLE if SINGLE in kinds else MASK
    return tuple(as_kind(program, a, kind) for a in args)


def _require_mask(name: str, *planes: Plane) -> None:
    if any(plane.kind != MASK for plane in planes):
        raise UntraceableError(f"{name} needs booleans; compare numbers with something first")


def _numeric(op: str) -> Callable[..., Plane]:
    """Builder of ``op``, whose arguments and result are of one kind; some mean something for booleans, too."""

    def build(*args: Any) -> Plane:
        program = _program(args)
        planes = _common(program, args)
        if planes[0].kind != MASK:
            return program.statement(op, planes, planes[0].kind)
        if op not in BOOLEAN:
            raise UntraceableError(f"{op} of booleans has no kernel; make them numbers with .to(dtype)")
        return program.statement(BOOLEAN[op], planes, MASK)

    return build


def _comparison(op: str) -> Callable[..., Plane]:
    def build(a: Any, b: Any) -> Plane:
        program = _program((a, b))
        planes = _common(program, (a, b))
        if planes[0].kind != MASK:
            return program.statement(op, planes, MASK)
        if op not in ("eq", "ne"):
            raise UntraceableError(f"{op} of booleans has no kernel; make them numbers with .to(dtype)")
        differ = program.statement("xor", planes, MASK)
        return differ if op == "ne" else program.statement("not", (differ,), MASK)

    return build


def _logical(op: str, truths: bool) -> Callable[..., Plane]:
    """Builder of ``op`` on booleans; with ``truths``, numbers are true unless they are zero."""

    def build(*args: Any) -> Plane:
        program = _program(args)
        planes = tuple(as_kind(program, a, MASK) for a in args) if truths else _common(program, args)
        _require_mask(op, *planes)
        return program.statement(op, planes, MASK)

    return build


def _clamp(x: Plane, min: Any = None, max: Any = None) -> Plane:
    lowered = x if min is None else _numeric("maximum")(x, min)
    return lowered if max is None else _numeric("minimum")(lowered, max)


def _where(mask: Any, yes: Any, no: Any) -> Plane:
    program = _program((mask, yes, no))
    mask = mask if isinstance(mask, Plane) else as_kind(program, mask, MASK)
    _require_mask("where", mask)
    yes, no = _common(program, (yes, no))
    return program.statement("where", (mask, yes, no), yes.kind)


def _filled(value: float) -> Callable[..., Plane]:
    return lambda x, dtype=None, **_: _full_like(x, value, dtype)


def _full_like(x: Plane, value: float, dtype: torch.dtype | None = None, **_: Any) -> Plane:
    return as_kind(x.program, value, kind_of(dtype) if dtype else x.kind)


def _power(x: Plane, exponent: Any) -> Plane:
    if isinstance(exponent, Plane) or exponent not in (2, 3):
        raise UntraceableError("only squares and cubes have a kernel; write other powers with products, roots, exp and log")
    square = _numeric("mul")(x, x)
    return square if exponent == 2 else _numeric("mul")(square, x)


def _remainder(x: Any, divisor: Any) -> Plane:
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

FUNCTIONS: dict[str, Callable[..., Plane]] = {
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
    "isnan": lambda x: _comparison("ne")(x, x),
    "isinf": lambda x: _comparison("eq")(_numeric("abs")(x), math.inf),
    "isfinite": lambda x: _comparison("lt")(_numeric("abs")(x), math.inf),
    "zeros_like": _filled(0.0),
    "ones_like": _filled(1.0),
    "full_like": _full_like,
    "clone": lambda x, **_: x,
    "double": lambda x: _cast(x, DOUBLE),
    "float": lambda x: _cast(x, SINGLE),
    "bool": lambda x: _cast(x, MASK),
}
"""What a kernel can compute, by torch's names."""

# -- operators ---------------------------------------------------------------------------------------------------------------

OPERATORS = {"add": "add", "sub": "sub", "mul": "mul", "truediv": "div", "mod": "remainder"} | {
    name: f"bitwise_{name}" for name in ("and", "or", "xor")
}
REFUSED = {
    "bool": "Python cannot branch on a plane; use torch.where",
    **dict.fromkeys(("int", "float", "index", "complex"), "Python cannot see a plane's numbers; use torch's functions"),
    **dict.fromkeys(("len", "iter", "getitem", "setitem", "contains"), "a plane is one number of every lane and has no elements"),
    **dict.fromkeys(("matmul", "rmatmul"), "a plane is one number of every lane; use Vec3 and Mat3"),
    **dict.fromkeys(("floordiv", "rfloordiv"), "use torch.floor of a quotient"),
    **dict.fromkeys(("rpow", "lshift", "rlshift", "rshift", "rrshift", "divmod", "rdivmod"), f"this operator {UNKNOWN}"),
}
"""Operators that planes do not have, and why."""


def _operator(name: str, swapped: bool) -> Callable[[Plane, Any], Any]:
    build = FUNCTIONS[name]

    def method(self: Plane, other: Any) -> Any:
        if isinstance(other, tuple):
            return NotImplemented
        return build(other, self) if swapped else build(self, other)

    return method


def _refusal(reason: str) -> Callable[..., NoReturn]:
    def method(*_: Any) -> NoReturn:
        raise UntraceableError(reason)

    return method


for _name, _function in OPERATORS.items():
    setattr(Plane, f"__{_name}__", _operator(_function, False))
    setattr(Plane, f"__r{_name}__", _operator(_function, True))
for _name in COMPARISONS:
    setattr(Plane, f"__{_name}__", _operator(_name, False))
for _name, _function in {"neg": "neg", "abs": "abs", "invert": "bitwise_not", "pow": "pow"}.items():
    setattr(Plane, f"__{_name}__", FUNCTIONS[_function])
for _name, _reason in REFUSED.items():
    setattr(Plane, f"__{_name}__", _refusal(_reason))


# -- folding -----------------------------------------------------------------------------------------------------------------


def _divide(a: float, b: float) -> float:
    if b != 0.0:
        return a / b
    return math.nan if a == 0.0 or math.isnan(a) else math.copysign(math.inf, a) * math.copysign(1.0, b)


ARITHMETIC: dict[str, Callable[..., Any]] = {
    "add": operator.add,
    "sub": operator.sub,
    "mul": operator.mul,
    "div": _divide,
    "neg": operator.neg,
    "sqrt": lambda x: math.sqrt(x) if x >= 0.0 else math.nan,
    "abs": abs,
    "minimum": min,
    "maximum": max,
    **{name: getattr(operator, name) for name in COMPARISONS},
    "and": operator.and_,
    "or": operator.or_,
    "xor": operator.xor,
    "not": operator.not_,
    "cast": lambda x: x,
}
"""What is known of constants without a kernel."""

NEUTRAL = {"add": 0.0, "sub": 0.0, "mul": 1.0, "div": 1.0}
"""Right sides that change nothing, but for the sign of zero."""


def _fold(program: Program, op: str, args: tuple[Any, ...], kind: str) -> Plane | None:
    """The plane that a statement equals, where that needs no statement."""
    values = [a.value for a in args]
    if op in ARITHMETIC and None not in values:
        return program.constant(ARITHMETIC[op](*values), kind)
    if op == "where":
        return args[1] if values[0] is True or args[1] is args[2] else args[2] if values[0] is False else None
    if op == "cast":
        return _fold_cast(program, args[0], kind)
    if op in NEUTRAL and values[1] == NEUTRAL[op]:
        return args[0]
    if op in ("add", "mul") and values[0] == NEUTRAL[op]:
        return args[1]
    return None


def _fold_cast(program: Program, plane: Plane, kind: str) -> Plane | None:
    """Casts of zeros and ones, and of other constants that a mask chooses from: float32 is not needed on the way to float64."""
    if plane.op == "cast" and plane.args[0].kind == MASK:
        return _cast(plane.args[0], kind)
    if plane.op == "where" and None not in (plane.args[1].value, plane.args[2].value):
        return program.statement("where", (plane.args[0], *(_cast(a, kind) for a in plane.args[1:])), kind)
    return None
