"""C++ for programs of planes: blocks of W environments, every number in vector registers."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Protocol

from bsk_torch.lanes.expr import ALWAYS, DOUBLE, MASK, SINGLE, TICK, Plane, Program, Region

TYPES = {DOUBLE: "D", SINGLE: "F", MASK: "M"}
INFIX = {"add": "+", "sub": "-", "mul": "*", "div": "/"}
CALLS = {"and": "both", "or": "either", "xor": "differ", "not": "opposite"} | {
    name: name for name in ("gt", "lt", "ge", "le", "eq", "ne", "where", "minimum", "maximum", "sign")
}


class TrackShape(Protocol):
    """What a kernel has to know of a table [N, records, width], of which a tick sees a few neighbouring records."""

    @property
    def spacing(self) -> float:
        """Seconds between records."""

    @property
    def width(self) -> int:
        """Numbers in a record."""

    @property
    def count(self) -> int:
        """Records that a tick sees."""

    @property
    def before(self) -> int:
        """How many of them lie before the last one that has passed."""


class Emitter:
    """Statements of one program as lines of C++."""

    def __init__(self, program: Program, results: Sequence[Plane]) -> None:
        """Find out what the ``results`` need."""
        self.program = program
        program.root.require_visible(results)
        self.live: set[int] = set()
        pending = list(results)
        while pending:
            plane = pending.pop()
            if plane.index not in self.live:
                self.live.add(plane.index)
                pending += [] if plane.op in ("input", "constant") else plane.args

    def header(self, include: str) -> str:
        """The kernel's first lines; lanes are as many as doubles or, if any live plane is float32, as floats fit a register."""
        mixed = any(p.kind == SINGLE for p in self.planes(self.program.root))
        return ("#define LANES_MIXED\n" if mixed else "") + include

    def planes(self, region: Region) -> Iterable[Plane]:
        """Live planes of a region and of those inside, in order."""
        for item in region.statements:
            if isinstance(item, Region):
                yield from self.planes(item)
            elif item.index in self.live:
                yield item

    def inputs(self, source: str) -> list[Plane]:
        """Live inputs from a source."""
        return [p for p in self.planes(self.program.root) if p.op == "input" and p.args[0] == source]

    def lines(self, lasts: int) -> list[str]:
        """Statements that last so long: constants of a call, those of a track's record, or the body of the loop."""
        if lasts == TICK:
            return self._region(self.program.root)
        chosen = [p for p in self.planes(self.program.root) if p.lasts == lasts and p.op not in ("input", "constant")]
        return [f"{'' if lasts else f'const {TYPES[p.kind]} '}{self.name(p)} = {self.expression(p)};" for p in chosen]

    def declarations(self, lasts: int) -> list[str]:
        """Variables that hold what a track's record determines."""
        return [f"{TYPES[p.kind]} {self.name(p)};" for p in self.variables(lasts)]

    def variables(self, lasts: int) -> list[Plane]:
        """Live planes that last so long."""
        return [p for p in self.planes(self.program.root) if p.lasts == lasts and p.op != "constant"]

    def _region(self, region: Region) -> list[str]:
        lines: list[str] = []
        for item in region.statements:
            if isinstance(item, Region):
                lines += self._guarded(item)
            elif item.index in self.live and item.lasts == TICK and item.op not in ("input", "constant", "merge"):
                lines.append(f"const {TYPES[item.kind]} {self.name(item)} = {self.expression(item)};")
        return lines

    def _guarded(self, region: Region) -> list[str]:
        leaving = [p for p in region.merges if p.index in self.live]
        if not leaving or region.mask is None:
            return []
        mask = self.name(region.mask)
        before = [f"{TYPES[p.kind]} {self.name(p)} = {self.name(p.args[2])};" for p in leaving]
        after = [f"{self.name(p)} = where({mask}, {self.name(p.args[1])}, {self.name(p.args[2])});" for p in leaving]
        return [*before, f"if (any({mask})) {{", *(f"  {line}" for line in self._region(region) + after), "}"]

    def name(self, plane: Plane) -> str:
        """How other statements refer to a plane."""
        if plane.op == "constant":
            return _constant(plane.value, plane.kind)
        if plane.op == "input":
            return "_".join(str(part) for part in plane.args)
        return f"v{plane.index}"

    def expression(self, plane: Plane) -> str:
        """What a plane is computed from."""
        args = [self.name(arg) for arg in plane.args]
        if plane.op in INFIX:
            return f"{args[0]} {INFIX[plane.op]} {args[1]}"
        if plane.op in CALLS:
            return f"{CALLS[plane.op]}({', '.join(args)})"
        if plane.op == "cast":
            return self.converted(plane.args[0], plane.kind)
        return f"{args[0]}.{plane.op}({', '.join(args[1:])})"

    def converted(self, plane: Plane, kind: str, name: str = "") -> str:
        """A plane, or a copy of it that has another ``name``, as one of another kind."""
        name = name or self.name(plane)
        if plane.kind == kind:
            return name
        if plane.kind == MASK:
            return f"where({name}, {TYPES[kind]}(1), {TYPES[kind]}(0))"
        if kind == MASK:
            return f"ne({name}, {TYPES[plane.kind]}(0))"
        return f"{'widen' if kind == DOUBLE else 'narrow'}({name})"

    # -- parts of a loop ------------------------------------------------------------------------------------------------

    def loads(self) -> list[str]:
        """What a block reads when it begins."""
        return [
            *(_load(p, f"state[{p.args[1]} * n + row[l]]") for p in self.inputs("state")),
            *(_load(p, f"own[{p.args[1]} * n + row[l]]") for p in self.inputs("own")),
            *(_load(p, f"flags[{p.args[1]} * modes + mode[row[l]]]") for p in self.inputs("flag")),
            *(
                f"const {TYPES[p.kind]} {self.name(p)} = {TYPES[p.kind]}({p.kind}(shared[{p.args[1]}]));"
                for p in self.inputs("shared")
            ),
        ]

    def records(self, t: int) -> list[str]:
        """Variables of a track, of which no record has been looked up."""
        return [*self.start(t), *self.declarations(t)]

    def start(self, t: int) -> list[str]:
        """When a track starts, and for which time its variables hold: none."""
        return [
            f"D start_{t}(0), base_{t}(0), from_{t}(0), until_{t}(0);",
            f"if (starts_{t}) load(start_{t}, [&](int l) {{ return starts_{t}[owner_{t} ? owner_{t}[row[l]] : row[l]]; }});",
        ]

    def lookup(self, t: int, track: TrackShape, local: Sequence[str] = ()) -> str:
        """Statements that keep a track at the time of the tick; ``local`` declarations stand where it is looked up."""
        inputs = [p for p in self.inputs("track") if p.args[1] == t]
        loads = [f"load({self.name(p)}, [&](int l) {{ return record[l][{p.args[2]}]; }});" for p in inputs]
        return TRACK.format(
            t=t,
            spacing=track.spacing,
            count=track.count,
            before=track.before,
            width=track.width,
            loads=indent([*local, *loads], 4),
            lines=indent(self.lines(t), 4),
        )

    def body(self, schedule: int) -> list[str]:
        """What a tick computes, where it has ``schedule`` numbers of its own."""
        inputs = self.inputs("schedule")
        scheduled = [f"const D {self.name(p)}(schedule[(k - 1) * {schedule} + {p.args[1]}]);" for p in inputs]
        return [*scheduled, *self.lines(TICK)]

    def stores(self, planes: Sequence[Plane]) -> list[str]:
        """Planes as rows of doubles."""
        return [f"{self.converted(p, DOUBLE)}.store(out[{i}]);" for i, p in enumerate(planes)]

    def turn(self, changes: Sequence[tuple[int, Plane]]) -> list[str]:
        """Hand the new state to the next tick, all planes at once: some may trade places."""
        known = {p.args[1]: p.kind for p in self.inputs("state")}
        moved = [(k, p) for k, p in changes if k in known]
        copies = [f"const {TYPES[known[k]]} new_{k} = {self.converted(p, known[k])};" for k, p in moved]
        return copies + [f"state_{k} = new_{k};" for k, _ in moved]


def _constant(value: float | bool, kind: str) -> str:
    if kind == MASK:
        return f"constant({str(value).lower()})"
    if math.isfinite(value):
        return f"{TYPES[kind]}({value!r}{'f' if kind == SINGLE else ''})"
    limit = f"std::numeric_limits<{kind}>::{'quiet_NaN' if math.isnan(value) else 'infinity'}()"
    return f"{TYPES[kind]}({'-' if value < 0 else ''}{limit})"


def indent(lines: Iterable[str], depth: int) -> str:
    """Lines as text, so many levels deep."""
    return "\n".join("  " * depth + line for line in lines)


SIGNATURE = "iippippppippippi"
"""Arguments of every loop, before four for each track; see :data:`LOOP`."""

LOOP = """{header}
using namespace lanes;

extern "C" int lanes_width() {{ return W; }}

// Runs counts[i] ticks of row rows[i] for every i; rows come in blocks of W, padded with counts of zero. Row i of the tables is
// owner[i], or i without owners. Tick k of row i writes record k - 1 of row i of written. What ends a row early lowers its count.
extern "C" void run(int64_t blocks, int64_t threads, const int64_t* rows, int64_t* counts, int64_t n,
                    double* state, const double* shared, const double* own, const double* flags, int64_t modes,
                    const int64_t* mode, const int64_t* ticks, int64_t nanoseconds, const double* schedule,
                    double* written, int64_t stride{arguments}) {{
#pragma omp parallel for schedule(dynamic) num_threads(threads) if (threads > 1)
  for (int64_t block = 0; block < blocks; ++block) {{
    const int64_t* row = rows + block * W;
    int64_t* count = counts + block * W;
    int64_t last = 0, next = INT64_MAX;
    for (int l = 0; l < W; ++l) {{
      if (count[l] > last) last = count[l];
      if (count[l] > 0 && count[l] < next) next = count[l];
    }}
    if (last == 0) continue;
    D ticks_start(0);
    if (ticks) load(ticks_start, [&](int l) {{ return double(ticks[row[l]]); }});
{loads}
{always}
{records}
{running}
    for (int64_t k = 1; k <= last; ++k) {{
      const D ticks_now = ticks_start + D(double(k));
      const D time_now = {clock};
{tracks}
{body}
{stops}
{writes}
      if (k == next) {{
        alignas(64) double out[{changed}][W];
{stores}
        next = INT64_MAX;
        for (int l = 0; l < W; ++l) {{
          if (count[l] == k) {{
{ends}
          }} else if (count[l] > k && count[l] < next) {{
            next = count[l];
          }}
        }}
{left}
      }}
{turn}
    }}
  }}
}}
"""

TRACK = """      const D elapsed_{t} = time_now - start_{t};
      if (k == 1 || any(either(lt(elapsed_{t}, from_{t}), ge(elapsed_{t}, until_{t})))) {{
        const D none(0), most(double(records_{t} - {count})), spacing({spacing!r}), before({before}.0);
        const D endless(std::numeric_limits<double>::infinity()), found = (elapsed_{t} / spacing).floor() - before;
        // what is no number compares false and gets the first record
        const D first = where(ge(found, none), where(lt(found, most), found, most), none);
        base_{t} = (first + before) * spacing;
        from_{t} = where(gt(first, none), base_{t}, none - endless);
        until_{t} = where(lt(first, most), base_{t} + spacing, endless);
        alignas(64) double index[W];
        first.store(index);
        const double* record[W];
        for (int l = 0; l < W; ++l) {{
          record[l] = table_{t} + ((owner_{t} ? owner_{t}[row[l]] : row[l]) * records_{t} + int64_t(index[l])) * {width};
        }}
{loads}
{lines}
      }}
      const D tau_{t} = elapsed_{t} - base_{t};"""

WRITE = """      {{
        alignas(64) double out[{count}][W];
{stores}
        for (int l = 0; l < W; ++l) {{
          if (count[l] < k) continue;
          double* to = written + row[l] * stride + (k - 1) * {count};
{lines}
        }}
      }}"""

RUNNING = """    M running;
    const auto remember = [&](int64_t k) {
      D left;
      load(left, [&](int l) { return double(count[l] - k); });
      running = gt(left, D(0));
    };
    remember(0);"""

STOPS = """      const M stopping = both({stop}, running);
      if (any(stopping)) {{
        alignas(64) double stopped[W];
        where(stopping, D(1), D(0)).store(stopped);
        for (int l = 0; l < W; ++l) {{
          if (stopped[l] != 0) count[l] = k;
        }}
        next = k;
      }}"""

LEFT = """        if (next == INT64_MAX) break;
        remember(k);"""

CLOCKS = {
    "ticks": "ticks_now * D(double(nanoseconds)) * D(1e-9)",
    "start": "ticks_start * D(double(nanoseconds)) * D(1e-9)",
    "schedule": "D(schedule[(k - 1) * {width}])",
}


def loop_source(
    program: Program,
    outputs: Sequence[Plane],
    tracks: Sequence[TrackShape],
    header: str,
    written: Sequence[Plane] = (),
    clock: str = "ticks",
    schedule: int = 0,
    stop: Plane | None = None,
) -> str:
    """C++ of a kernel that repeats ticks: ``outputs`` are the planes of the state at the end of a tick.

    Inputs are named ``state_<plane>``, ``shared_<plane>``, ``own_<plane>``, ``flag_<plane>``, ``schedule_<plane>`` (numbers of
    this tick, of ``schedule`` for each), ``track_<t>_<plane>``, ``tau_<t>``, seconds since the record of track t, and
    ``ticks_now``, the number of this tick. Planes ``written`` are recorded in every tick. Tracks are looked up at the time of the
    ``clock``: that of the ticks, that of the start, the first number of the schedule, or the plane of the state that it names.
    A row in which the mask ``stop`` holds in a tick ends with it.
    """
    emitter = Emitter(program, [*outputs, *written, *([] if stop is None else [stop])])
    changes = changed(outputs)
    return LOOP.format(
        header=emitter.header(header),
        arguments=arguments(len(tracks)),
        loads=indent(emitter.loads(), 2),
        always=indent(emitter.lines(ALWAYS), 2),
        records=indent((line for t in range(1, len(tracks) + 1) for line in emitter.records(t)), 2),
        clock=CLOCKS[clock].format(width=schedule) if clock in CLOCKS else clock,
        tracks="\n".join(emitter.lookup(t, track) for t, track in enumerate(tracks, 1)),
        body=indent(emitter.body(schedule), 3),
        running="" if stop is None else RUNNING,
        stops="" if stop is None else STOPS.format(stop=emitter.name(stop)),
        writes=_writes(emitter, written) if written else "",
        changed=max(1, len(changes)),
        stores=indent(emitter.stores([p for _, p in changes]), 4),
        ends=indent((f"state[{k} * n + row[l]] = out[{i}][l];" for i, (k, _) in enumerate(changes)), 6),
        left="" if stop is None else LEFT,
        turn=indent(emitter.turn(changes), 3),
    )


def changed(outputs: Sequence[Plane]) -> list[tuple[int, Plane]]:
    """Planes of the state that a tick does not leave as they are, with their numbers."""
    return [(k, p) for k, p in enumerate(outputs) if not (p.op == "input" and p.args == ("state", k))]


def arguments(tracks: int) -> str:
    """Parameters of the kernel for its tracks."""
    return "".join(
        f",\n                    const double* table_{t}, const double* starts_{t}, const int64_t* owner_{t}, int64_t records_{t}"
        for t in range(1, tracks + 1)
    )


def _load(plane: Plane, lane: str) -> str:
    name = "_".join(str(part) for part in plane.args)
    return f"{TYPES[plane.kind]} {name}; load({name}, [&](int l) {{ return {lane}; }});"


def _writes(emitter: Emitter, written: Sequence[Plane]) -> str:
    lines = (f"to[{i}] = out[{i}][l];" for i in range(len(written)))
    return WRITE.format(count=len(written), stores=indent(emitter.stores(written), 4), lines=indent(lines, 5))
