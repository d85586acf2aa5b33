"""Printer of C++: a lowered loop as the source of a kernel.

Rows are processed in blocks of W, the lanes of a vector; every value of a loop is one vector. There are two kernels, built from
the same pieces: in one each row ends by itself, in the other groups of rows end together (lockstep). The printer decides nothing:
:mod:`bsk_torch.codegen.passes` has placed every statement.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import torch

from bsk_torch.codegen.ir import Branch, Carried, Declare, Define, LoweredLoop, Record, Statement, Store, Update, Value, Variable

Lines = list[str]

VECTORS = {torch.float64: "D", torch.float32: "F", torch.bool: "M"}
"""Types of vectors; see ``simd.h``."""

SCALARS = {torch.float64: "double", torch.float32: "float"}

INFIX = {"add": "+", "sub": "-", "mul": "*", "div": "/"}
CALLS = {"and": "both", "or": "either", "xor": "differ", "not": "opposite", "merge": "where"} | {
    name: name for name in ("gt", "lt", "ge", "le", "eq", "ne", "where", "minimum", "maximum", "sign")
}
"""Operations that are functions; all others are methods of their first argument."""

PACKS = (
    "double* state, const double* shared, const double* own, const double* flags, int64_t modes",
    "const int64_t* mode, const int64_t* ticks, int64_t nanoseconds, const double* schedule",
)
WRITTEN = "double* written, int64_t stride"
INDEPENDENT = (
    "int64_t blocks, int64_t threads, const int64_t* rows, int64_t* counts, int64_t n",
    *PACKS,
    WRITTEN,
)
LOCKSTEP = (
    "int64_t tiles, int64_t size, int64_t threads, const int64_t* rows, const int64_t* groups, int64_t* ends, int64_t n",
    *PACKS,
)
TRACK = "const double* table_{t}, const double* starts_{t}, const int64_t* owner_{t}, int64_t records_{t}"
"""Parameters of both kernels, and those for each track."""

CLOCKS = {  # divided: a product could be fused with the subtraction of where a table starts, whose rounding depends on that
    "ticks": "ticks_now * D(double(nanoseconds)) / D(1e9)",
    "start": "ticks_start * D(double(nanoseconds)) / D(1e9)",
    "schedule": "D(schedule[(k - 1) * {width}])",
}


def source(loop: LoweredLoop, include: str) -> str:
    """C++ of the kernel of a loop, whose first line includes the header of vectors."""
    kernel = _independent(loop) if loop.carried is None else _lockstep(loop, loop.carried)
    mixed = ["#define LANES_MIXED"] if loop.mixed else []
    return "\n".join([*mixed, include, *kernel]) + "\n"


def signature(loop: LoweredLoop) -> str:
    """Return the types of the kernel's parameters: p for a pointer, i for an integer."""
    return "".join("p" if "*" in parameter else "i" for line in _parameters(loop) for parameter in line.split(", "))


def _parameters(loop: LoweredLoop) -> Lines:
    fixed = INDEPENDENT if loop.carried is None else (*LOCKSTEP, *([WRITTEN] if loop.written else []))
    return [*fixed, *(TRACK.format(t=t) for t in range(1, len(loop.records) + 1))]


# -- text --------------------------------------------------------------------------------------------------------------------


def _block(head: str, body: Iterable[str], close: str = "}") -> Lines:
    """Lines in braces, one level deeper; those of the preprocessor begin at the left."""
    inner = (line if not line or line[0] == "#" else f"  {line}" for line in body)
    return [f"{head} {{".lstrip(), *inner, close]


def _section(lines: Iterable[str]) -> Lines:
    """Return a part of a kernel, or an empty line in its place."""
    return list(lines) or [""]


def _lanes(body: Iterable[str]) -> Lines:
    return _block("for (int l = 0; l < W; ++l)", body)


def _function(loop: LoweredLoop, body: Iterable[str]) -> Lines:
    head = 'extern "C" void run('
    return _block(head + (",\n" + " " * len(head)).join(_parameters(loop)) + ")", body)


# -- values ------------------------------------------------------------------------------------------------------------------


def name(value: Value | Variable) -> str:
    """Return the C++ by which other statements refer to a value."""
    if isinstance(value, Variable):
        return value.name
    if value.op == "constant":
        return _literal(value.number, value.dtype)
    if value.op == "input":
        return "_".join(str(part) for part in value.attr)
    return f"v{value.index}"


def _literal(number: float | bool, dtype: torch.dtype) -> str:
    if dtype == torch.bool:
        return f"constant({str(number).lower()})"
    if math.isfinite(number):
        return f"{VECTORS[dtype]}({number!r}{'f' if dtype == torch.float32 else ''})"
    limit = f"std::numeric_limits<{SCALARS[dtype]}>::{'quiet_NaN' if math.isnan(number) else 'infinity'}()"
    return f"{VECTORS[dtype]}({'-' if number < 0 else ''}{limit})"


def expression(value: Value) -> str:
    """Return the C++ that computes a value from its arguments."""
    args = [name(arg) for arg in value.args]
    if value.op in INFIX:
        return f"{args[0]} {INFIX[value.op]} {args[1]}"
    if value.op in CALLS:
        return f"{CALLS[value.op]}({', '.join(args)})"
    if value.op == "cast":
        return converted(value.args[0], value.dtype)
    return f"{args[0]}.{value.op}({', '.join(args[1:])})"


def converted(value: Value | Variable, dtype: torch.dtype) -> str:
    """Return the C++ of a value converted to another type."""
    if value.dtype == dtype:
        return name(value)
    if value.dtype == torch.bool:
        return f"where({name(value)}, {VECTORS[dtype]}(1), {VECTORS[dtype]}(0))"
    if dtype == torch.bool:
        return f"ne({name(value)}, {VECTORS[value.dtype]}(0))"
    return f"{'widen' if dtype == torch.float64 else 'narrow'}({name(value)})"


def _declaration(value: Value | Variable) -> str:
    return f"{VECTORS[value.dtype]} {name(value)}"


# -- statements --------------------------------------------------------------------------------------------------------------


def _statement(statement: Statement, width: int) -> Lines:
    """Return a statement as lines; ``width`` is that of the schedule."""
    match statement:
        case Define(value) if value.is_input("schedule"):
            return [f"const {_declaration(value)}(schedule[(k - 1) * {width} + {value.attr[1]}]);"]
        case Define(value):
            return [f"const {_declaration(value)} = {expression(value)};"]
        case Declare(value, Value() as initial):
            return [f"{_declaration(value)} = {name(initial)};"]
        case Declare(value):
            return [f"{_declaration(value)};"]
        case Update(value):
            return [f"{name(value)} = {expression(value)};"]
        case Store(target, value, declare):
            return [f"{f'const {_declaration(target)}' if declare else name(target)} = {converted(value, target.dtype)};"]
        case Branch(mask, body):
            return _block(f"if (any({name(mask)}))", _statements(body, width))


def _statements(statements: Iterable[Statement], width: int = 0) -> Lines:
    return [line for statement in statements for line in _statement(statement, width)]


def _load(value: Value) -> str:
    origin, k = value.attr
    lane = {
        "state": f"state[{k} * n + row[l]]",
        "own": f"own[{k} * n + row[l]]",
        "flag": f"flags[{k} * modes + mode[row[l]]]",
    }
    if origin == "shared":
        return f"const {_declaration(value)} = {VECTORS[value.dtype]}({SCALARS[value.dtype]}(shared[{k}]));"
    return f"{_declaration(value)}; {_gather(name(value), lane[origin])}"


def _gather(target: str, lane: str) -> str:
    """Fill a vector with one number for each lane l."""
    return f"load({target}, [&](int l) {{ return {lane}; }});"


def _stored(values: Sequence[Value | Variable]) -> Lines:
    """Write values as rows of doubles, one below the other."""
    stores = (f"{converted(value, torch.float64)}.store(out[{i}]);" for i, value in enumerate(values))
    return [f"alignas(64) double out[{max(1, len(values))}][W];", *_section(stores)]


# -- pieces of a kernel ------------------------------------------------------------------------------------------------------


def _loads(loop: LoweredLoop) -> Lines:
    """Inputs and constants of a block of rows, before its first tick."""
    return [
        "D ticks_start(0);",
        f"if (ticks) {_gather('ticks_start', 'double(ticks[row[l]])')}",
        *_section(_load(value) for value in loop.loads),
        *_section(_statements(Define(value) for value in loop.constants)),
    ]


def _track_start(t: int) -> Lines:
    """Print the time of a track's first record; no record has been looked up."""
    start = f"starts_{t}[owner_{t} ? owner_{t}[row[l]] : row[l]]"
    return [
        f"D start_{t}(0), base_{t}(0), from_{t}(0), until_{t}(0);",
        f"if (starts_{t}) {_gather(f'start_{t}', start)}",
    ]


def _look_up(t: int, record: Record) -> Lines:
    """Find the records around the time of the tick, if they are not those of the last tick.

    ``from`` and ``until`` bound the times for which they are the right ones; at the ends of the table they are infinite.
    """
    shape = record.shape
    row = f"(owner_{t} ? owner_{t}[row[l]] : row[l]) * records_{t} + int64_t(index[l])"
    lines = [
        f"const D none(0), most(double(records_{t} - {shape.count})), spacing({shape.spacing!r}), before({shape.before}.0);",
        f"const D endless(std::numeric_limits<double>::infinity()), found = (elapsed_{t} / spacing).floor() - before;",
        "// what is no number compares false and gets the first record",
        "const D first = where(ge(found, none), where(lt(found, most), found, most), none);",
        f"base_{t} = (first + before) * spacing;",
        f"from_{t} = where(gt(first, none), base_{t}, none - endless);",
        f"until_{t} = where(lt(first, most), base_{t} + spacing, endless);",
        "alignas(64) double index[W];",
        "first.store(index);",
        "const double* record[W];",
        *_lanes([f"record[l] = table_{t} + ({row}) * {shape.width};"]),
        *_section(
            [
                *_statements(Declare(value) for value in record.local),
                *(_gather(name(value), f"record[l][{value.attr[2]}]") for value in record.inputs),
            ]
        ),
        *_section(_statements(Update(value) for value in record.computed)),
    ]
    return [
        f"const D elapsed_{t} = time_now - start_{t};",
        *_block(f"if (k == 1 || any(either(lt(elapsed_{t}, from_{t}), ge(elapsed_{t}, until_{t}))))", lines),
        f"const D tau_{t} = elapsed_{t} - base_{t};",
    ]


def _clock(loop: LoweredLoop) -> Lines:
    """Number and time of the tick, and the records around it."""
    time = name(loop.clock) if isinstance(loop.clock, Value) else CLOCKS[loop.clock].format(width=loop.schedule)
    records = (line for t, record in enumerate(loop.records, 1) for line in _look_up(t, record))
    return ["const D ticks_now = ticks_start + D(double(k));", f"const D time_now = {time};", *_section(records)]


def _stop(loop: LoweredLoop, end: str) -> Lines:
    """Move the ``end`` of lanes that stop to this tick."""
    if loop.stop is None:
        return []
    ended = [
        "alignas(64) double stopped[W];",
        "where(stopping, D(1), D(0)).store(stopped);",
        *_lanes([f"if (stopped[l] != 0) {end} = k;"]),
        "next = k;",
    ]
    return [f"const M stopping = both({name(loop.stop)}, running);", *_block("if (any(stopping))", ended)]


def _finish(loop: LoweredLoop, end: str) -> Lines:
    """Write the state of a lane whose ``end`` is this tick; ``next`` becomes the first of all later ends."""
    state = _section(f"state[{k} * n + row[l]] = out[{i}][l];" for i, (k, _) in enumerate(loop.results))
    later = _block(f"}} else if ({end} > k && {end} < next)", [f"next = {end};"])
    return [*_block(f"if ({end} == k)", state, close=later[0]), *later[1:]]


def _remaining(ticks: str) -> Lines:
    """Print the number of ``ticks`` that each lane has left, as the vector ``left``."""
    return ["D left;", _gather("left", f"double({ticks})")]


# -- each row by itself ------------------------------------------------------------------------------------------------------

ABOUT_INDEPENDENT = """
// Runs counts[i] ticks of row rows[i] for every i; rows come in blocks of W, padded with counts of zero. Row i of the tables is
// owner[i], or i without owners. Tick k of row i writes record k - 1 of row i of written. What ends a row early lowers its count.
"""

ENTRY = ["using namespace lanes;", "", 'extern "C" int lanes_width() { return W; }']


def _independent(loop: LoweredLoop) -> Lines:
    ticks = [
        *_clock(loop),
        *_section(_statements(loop.body, loop.schedule)),
        *_section(_stop(loop, "count[l]")),
        *_section(_write(loop, "count[l]")),
        *_block("if (k == next)", _end_rows(loop)),
        *_section(_statements(loop.commit)),
    ]
    block = [
        "const int64_t* row = rows + block * W;",
        "int64_t* count = counts + block * W;",
        "int64_t last = 0, next = INT64_MAX;",
        *_lanes(["if (count[l] > last) last = count[l];", "if (count[l] > 0 && count[l] < next) next = count[l];"]),
        "if (last == 0) continue;",
        *_loads(loop),
        *_section(
            line
            for t, record in enumerate(loop.records, 1)
            for line in (*_track_start(t), *_statements(Declare(value) for value in record.outputs))
        ),
        *_section(_remember() if loop.stop is not None else []),
        *_block("for (int64_t k = 1; k <= last; ++k)", ticks),
    ]
    blocks = [
        "#pragma omp parallel for schedule(dynamic) num_threads(threads) if (threads > 1)",
        *_block("for (int64_t block = 0; block < blocks; ++block)", block),
    ]
    return [*ENTRY, *ABOUT_INDEPENDENT.splitlines(), *_function(loop, blocks)]


def _remember() -> Lines:
    """Print the mask of running lanes, updated whenever one ends: ended rows keep computing, and may stop again."""
    lanes = [*_remaining("count[l] - k"), "running = gt(left, D(0));"]
    return ["M running;", *_block("const auto remember = [&](int64_t k)", lanes, close="};"), "remember(0);"]


def _write(loop: LoweredLoop, end: str) -> Lines:
    """Record values of this tick in lanes whose ``end`` has not passed."""
    if not loop.written:
        return []
    width = len(loop.written)
    lane = [
        f"if ({end} < k) continue;",
        f"double* to = written + row[l] * stride + (k - 1) * {width};",
        *(f"to[{i}] = out[{i}][l];" for i in range(width)),
    ]
    return _block("", [*_stored(loop.written), *_lanes(lane)])


def _end_rows(loop: LoweredLoop) -> Lines:
    """Leave the state of rows that end with this tick."""
    return [
        *_stored([value for _, value in loop.results]),
        "next = INT64_MAX;",
        *_lanes(_finish(loop, "count[l]")),
        *_section(["if (next == INT64_MAX) break;", "remember(k);"] if loop.stop is not None else []),
    ]


# -- groups of rows in lockstep ----------------------------------------------------------------------------------------------

ABOUT_LOCKSTEP = """
// Runs ends[groups[i]] ticks of row rows[i] for every i. Rows come in tiles of size blocks of W; all rows of a group are in one
// tile. Padding belongs to a group without ticks. What ends a group early lowers its number of ticks.
"""


def _lockstep(loop: LoweredLoop, carried: Carried) -> Lines:
    """Print a kernel in which a group of rows ends in the tick in which the first of them stops.

    The rows of a group may be in several blocks, so all blocks of a tile run a tick before any of them runs the next. Variables
    that the other kernel keeps in registers or on its stack are members of an object while other blocks run.
    """
    blocks = "for (int64_t b = 0; b < size; ++b)"
    tile = [
        "int64_t next = INT64_MAX;",
        *_block(blocks, [*_rows(), *_begin(loop, carried)]),
        *_block(
            "for (int64_t k = 1; next != INT64_MAX; ++k)",
            [
                *_block(
                    blocks,
                    [*_resume(carried), *_tick(loop), *_stop(loop, "ends[group[l]]"), *_write(loop, "ends[group[l]]")],
                ),
                "if (k != next) continue;",
                "next = INT64_MAX;",
                *_block(blocks, [*_resume(carried), *_end_groups(loop)]),
            ],
        ),
    ]
    parallel = [
        "std::vector<Block> blocks(size);",
        "Common common;",
        "#pragma omp for schedule(dynamic)",
        *_block("for (int64_t tile = 0; tile < tiles; ++tile)", tile),
    ]
    return [
        "#include <atomic>",
        "#include <vector>",
        ENTRY[0],
        "",
        *_structs(carried),
        *ENTRY[1:],
        *ABOUT_LOCKSTEP.splitlines(),
        *_function(loop, ["#pragma omp parallel num_threads(threads) if (threads > 1)", *_block("", parallel)]),
    ]


def _structs(carried: Carried) -> Lines:
    """Print the types of the objects that keep variables between two ticks."""
    common = (f"{_declaration(value)};" for value in carried.common)
    block = ["M running;", *(f"{_declaration(value)};" for value in carried.block)]
    return [
        "namespace {",
        "// Values that are equal in all rows.",
        *_block("struct Common", common, close="};"),
        "",
        "// A block between two ticks.",
        *_block("struct Block", block, close="};"),
        "}  // namespace",
    ]


def _rows() -> Lines:
    return [
        "const int64_t* row = rows + (tile * size + b) * W;",
        "const int64_t* group = groups + (tile * size + b) * W;",
    ]


def _begin(loop: LoweredLoop, carried: Carried) -> Lines:
    """Print the state of a block before its first tick, and the common values."""
    initial = ["gt(left, D(0))", *(name(value) for value in carried.initial)]
    return [
        *_lanes(["if (ends[group[l]] > 0 && ends[group[l]] < next) next = ends[group[l]];"]),
        *_remaining("ends[group[l]]"),
        *_loads(loop),
        *(line for t in range(1, len(loop.records) + 1) for line in _track_start(t)),
        f"common = Common{{{', '.join(name(value) for value in carried.common)}}};",
        f"blocks[b] = Block{{{', '.join(initial)}}};",
    ]


def _resume(carried: Carried) -> Lines:
    """Give the members of a block that is still running their names back."""
    members = [("const auto&", [name(value) for value in carried.common], "common")]
    members += [("auto&", ["running", *(name(value) for value in carried.block)], "blocks[b]")]
    return [
        "if (!any(blocks[b].running)) continue;",
        *_rows(),
        *(f"{kind} [{', '.join(names)}] = {where};" for kind, names, where in members if names),
    ]


def _tick(loop: LoweredLoop) -> Lines:
    return [
        *_clock(loop),
        "// so that records are read where they are needed: no register is free to hold them",
        "std::atomic_signal_fence(std::memory_order_seq_cst);",
        *_statements(loop.body, loop.schedule),
    ]


def _end_groups(loop: LoweredLoop) -> Lines:
    """Leave the state of rows whose group ends with this tick."""
    return [
        *_stored([value for _, value in loop.results]),
        *_lanes(["const int64_t end = ends[group[l]];", *_finish(loop, "end")]),
        *_remaining("ends[group[l]] - k"),
        "running = gt(left, D(0));",
    ]
