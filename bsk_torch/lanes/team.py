"""Kernels whose rows end in teams: in the tick in which the first of them stops.

The rows of a team may lie in several blocks, which have to know after every tick whether another one has stopped. So groups of
blocks that hold whole teams go through their ticks side by side. What :mod:`bsk_torch.lanes.emit` keeps in variables of a block
waits in an object from one tick to the next.

Numbers are those of rows that run alone for as many ticks. Where the compiler does not fuse the same products with sums in both
kernels, they differ by a rounding: in plain C++, and in products that no tick changes.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from bsk_torch.lanes.emit import CLOCKS, TYPES, Emitter, TrackShape, arguments, changed, indent
from bsk_torch.lanes.expr import ALWAYS, DOUBLE, Plane, Program

SPARE = 1 / 16
"""Padding of a group, as part of its rows, for which no larger group is taken."""

BLOCKS, GROUPS = 8, 32
"""Blocks that a group may have to sort its rows by mode, where there are so many groups."""

# -- rows --------------------------------------------------------------------------------------------------------------------


class Groups(NamedTuple):
    """Rows in groups of blocks: ``rows`` and the team of each, [groups, lanes]; ``ends`` [teams + 1] are ticks of the teams.

    The last team is that of padding, which runs no tick. ``size`` is the number of groups, and of blocks in each.
    """

    rows: Tensor
    teams: Tensor
    ends: Tensor
    size: tuple[int, int]


def check_teams(counts: Tensor, team: int, written: Tensor | None) -> None:
    """Raise ValueError for ``counts`` [n] that are not those of teams of ``team`` rows, and where something is to be written."""
    if written is not None:
        raise ValueError(f"written must be None where team={team}: rows that end together write nothing")
    if len(counts) % team:
        raise ValueError(f"team={team} must divide the number of rows, {len(counts)}")
    uneven = torch.nonzero((counts.view(-1, team) != counts[::team, None]).any(1))
    if len(uneven):
        first = int(uneven[0])
        found = counts.view(-1, team)[first].unique().tolist()
        raise ValueError(f"counts of team {first} are {found}; rows of a team must have the same number of ticks")


def in_groups(counts: Tensor, order: Tensor, mode: Tensor | None, team: int, width: int) -> Groups:
    """Groups of teams that should take about as long, with rows of like modes in the blocks of ``width``.

    Args:
        counts: Number of ticks, at most, of each row [n].
        order: Number of ticks to be expected of each row [n]; the first row of a team to stop ends all.
        mode: Mode of each row [n], if there are any.
        team: Rows of a team.
        width: Rows of a block.
    """
    teams = len(counts) // team
    each = _teams_of_a_group(teams, team, width)
    shape = -(-teams // each), each * team
    ranked = order.view(teams, team).amin(1).argsort()
    rows = _filled((ranked.unsqueeze(1) * team + torch.arange(team)).flatten(), 0, shape)
    owners = _filled(ranked.repeat_interleave(team), teams, shape)
    if mode is not None:
        alike = mode[rows].argsort(dim=1, stable=True)
        rows, owners = rows.gather(1, alike), owners.gather(1, alike)
    padding = 0, -shape[1] % width
    rows, owners = torch.constant_pad_nd(rows, padding, 0), torch.constant_pad_nd(owners, padding, teams)
    ends = torch.cat([counts[::team], counts.new_zeros(1)])
    return Groups(rows, owners, ends, (shape[0], rows.shape[1] // width))


def _teams_of_a_group(teams: int, team: int, width: int) -> int:
    """As few as fill their blocks, or some times as many; groups that are larger than a cache are slower."""
    few = next(k for k in range(1, width + 1) if -(k * team) % width <= SPARE * k * team)
    times = min(BLOCKS * width // (few * team), teams // (few * GROUPS))
    return max(1, min(teams, few * max(1, times)))


def _filled(values: Tensor, filler: int, shape: tuple[int, int]) -> Tensor:
    return torch.constant_pad_nd(values, (0, shape[0] * shape[1] - len(values)), filler).view(shape)


# -- source ------------------------------------------------------------------------------------------------------------------

TEAM_SIGNATURE = "iiipppippppippip"
"""Arguments of every kernel of teams, before four for each track; see :data:`TEAM`."""

TEAM = """{header}
#include <atomic>
#include <vector>
using namespace lanes;

namespace {{
// What is the same in all blocks.
struct Common {{
{common}
}};

// A block between two ticks.
struct Block {{
  M running;
{block}
}};
}}  // namespace

extern "C" int lanes_width() {{ return W; }}

// Runs ends[teams[i]] ticks of row rows[i] for every i. Rows come in groups of size blocks of W; all rows of a team are in one
// group. Padding belongs to a team without ticks. What ends a team early lowers its number of ticks.
extern "C" void run(int64_t groups, int64_t size, int64_t threads, const int64_t* rows, const int64_t* teams, int64_t* ends,
                    int64_t n, double* state, const double* shared, const double* own, const double* flags, int64_t modes,
                    const int64_t* mode, const int64_t* ticks, int64_t nanoseconds, const double* schedule{arguments}) {{
#pragma omp parallel num_threads(threads) if (threads > 1)
  {{
  std::vector<Block> blocks(size);
  Common common;
#pragma omp for schedule(dynamic)
  for (int64_t group = 0; group < groups; ++group) {{
    int64_t next = INT64_MAX;
    for (int64_t b = 0; b < size; ++b) {{
      const int64_t* row = rows + (group * size + b) * W;
      const int64_t* team = teams + (group * size + b) * W;
      for (int l = 0; l < W; ++l) {{
        if (ends[team[l]] > 0 && ends[team[l]] < next) next = ends[team[l]];
      }}
      D left;
      load(left, [&](int l) {{ return double(ends[team[l]]); }});
      D ticks_start(0);
      if (ticks) load(ticks_start, [&](int l) {{ return double(ticks[row[l]]); }});
{loads}
{always}
{starts}
      common = Common{{{common_values}}};
      blocks[b] = Block{{gt(left, D(0)), {begun_values}}};
    }}
    for (int64_t k = 1; next != INT64_MAX; ++k) {{
      for (int64_t b = 0; b < size; ++b) {{
        if (!any(blocks[b].running)) continue;
        const int64_t* row = rows + (group * size + b) * W;
        const int64_t* team = teams + (group * size + b) * W;
{bind}
        const D ticks_now = ticks_start + D(double(k));
        const D time_now = {clock};
{tracks}
        // so that records are read where they are needed: no register is free to hold them
        std::atomic_signal_fence(std::memory_order_seq_cst);
{body}
        const M stopping = both({stop}, running);
        if (any(stopping)) {{
          alignas(64) double stopped[W];
          where(stopping, D(1), D(0)).store(stopped);
          for (int l = 0; l < W; ++l) {{
            if (stopped[l] != 0) ends[team[l]] = k;
          }}
          next = k;
        }}
      }}
      if (k != next) continue;
      next = INT64_MAX;
      for (int64_t b = 0; b < size; ++b) {{
        if (!any(blocks[b].running)) continue;
        const int64_t* row = rows + (group * size + b) * W;
        const int64_t* team = teams + (group * size + b) * W;
{bind}
        alignas(64) double out[{changed}][W];
{stores}
        for (int l = 0; l < W; ++l) {{
          const int64_t end = ends[team[l]];
          if (end == k) {{
{last}
          }} else if (end > k && end < next) {{
            next = end;
          }}
        }}
        D left;
        load(left, [&](int l) {{ return double(ends[team[l]] - k); }});
        running = gt(left, D(0));
      }}
    }}
  }}
  }}
}}
"""


def team_source(
    program: Program,
    outputs: Sequence[Plane],
    tracks: Sequence[TrackShape],
    header: str,
    clock: str,
    schedule: int,
    stop: Plane,
) -> str:
    """C++ of a kernel whose teams end together; see :func:`bsk_torch.lanes.emit.loop_source`."""
    emitter = TeamEmitter(program, outputs, stop, len(tracks))
    binds = _bind("const auto&", emitter.common, "common"), _bind("auto&", [("M", "running"), *emitter.block], "blocks[b]")
    return TEAM.format(
        header=emitter.header(header),
        common=indent((f"{kind} {name};" for kind, name in emitter.common), 1),
        block=indent((f"{kind} {name};" for kind, name in emitter.block), 1),
        arguments=arguments(len(tracks)),
        loads=indent(emitter.loads(), 3),
        always=indent(emitter.lines(ALWAYS), 3),
        starts=indent((line for t in range(1, len(tracks) + 1) for line in emitter.start(t)), 3),
        common_values=", ".join(name for _, name in emitter.common),
        begun_values=", ".join(name for _, name in emitter.begun),
        bind=indent(binds, 4),
        clock=CLOCKS[clock].format(width=schedule) if clock in CLOCKS else clock,
        tracks="\n".join(emitter.lookup(t, track, emitter.passing(t)) for t, track in enumerate(tracks, 1)),
        body=indent(emitter.tick(schedule), 4),
        stop=emitter.name(stop),
        changed=max(1, len(emitter.changes)),
        stores=indent(emitter.kept(), 4),
        last=indent((f"state[{k} * n + row[l]] = out[{i}][l];" for i, (k, _) in enumerate(emitter.changes)), 6),
    )


def _bind(how: str, variables: Sequence[tuple[str, str]], where: str) -> str:
    """Names for the members of an object."""
    return f"{how} [{', '.join(name for _, name in variables)}] = {where};" if variables else ""


class TeamEmitter(Emitter):
    """Which variables, each a type and a name, outlive a tick, and a tick that leaves them behind.

    ``common`` are those that all blocks share, ``begun`` those that a block knows when it begins, ``block`` all of a block.
    ``state_<plane>`` is what the next tick reads; where no tick reads just that, ``out_<plane>`` is what the last one leaves.
    """

    def __init__(self, program: Program, outputs: Sequence[Plane], stop: Plane, tracks: int) -> None:
        """Find out what a tick needs that it does not compute."""
        super().__init__(program, [*outputs, stop])
        live = [p for p in self.planes(program.root) if p.op != "constant"]
        args = ((p, arg) for p in live if p.op != "input" for arg in p.args)
        self.needed = {arg.index for p, arg in args if arg.lasts != p.lasts} | {p.index for p in (*outputs, stop)}
        states, alike = self.inputs("state"), _alike(live)
        always = [p for p in live if p.lasts == ALWAYS and p.index in self.needed]
        self.read = {p.args[1]: p.kind for p in states}
        self.changes = changed(outputs)
        self.out = {k for k, p in self.changes if self.read.get(k) != p.kind}
        self.common = self._named(p for p in always if p.index in alike)
        self.begun = [
            ("D", "ticks_start"),
            *self._named(states),
            *self._named(p for p in always if p.index not in alike),
            *(("D", f"{name}_{t}") for t in range(1, tracks + 1) for name in ("start", "base", "from", "until")),
        ]
        records = (p for t in range(1, tracks + 1) for p in self.variables(t) if p.index in self.needed)
        out = ((TYPES[p.kind], f"out_{k}") for k, p in self.changes if k in self.out)
        self.block = [*self.begun, *self._named(records), *out]

    def _named(self, planes: Iterable[Plane]) -> list[tuple[str, str]]:
        return [(TYPES[p.kind], self.name(p)) for p in planes]

    def passing(self, t: int) -> list[str]:
        """Declarations of what is needed only where a record of a track is looked up."""
        return [f"{TYPES[p.kind]} {self.name(p)};" for p in self.variables(t) if p.index not in self.needed]

    def tick(self, schedule: int) -> list[str]:
        """Statements of a tick. What is new is stored as soon as it is known and the old is read no more: registers are few."""
        passed = [(k, p) for k, p in self.changes if p.op == "input" and p.args[0] == "state"]
        copies = {k: f"const {TYPES[p.kind]} new_{k} = {self.name(p)};" for k, p in passed}
        lines = [*copies.values(), *self.body(schedule)]
        last_read = {name: i for i, line in enumerate(lines) for name in re.findall(r"\w+", line)}
        assigned = ((i, re.match(r" *(?:const )?(?:\w )?(\w+)(?: = |\()", line)) for i, line in enumerate(lines))
        known = {found[1]: i for i, found in assigned if found}
        after: dict[int, list[str]] = {}
        for k, p in self.changes:
            name = f"new_{k}" if k in copies else self.name(p)
            moves = [(f"out_{k}", name)] if k in self.out else []
            moves += [(f"state_{k}", self.converted(p, self.read[k], name))] if k in self.read else []
            for target, value in moves:
                at = max(last_read.get(target, -1), known.get(name, -1))
                # not inside of a guarded region
                while at + 1 < len(lines) and lines[at + 1].startswith((" ", "}")):
                    at += 1
                after.setdefault(at, []).append(f"{target} = {value};")
        return [line for i, own in enumerate(["", *lines], -1) for line in (own, *after.get(i, ()))]

    def kept(self) -> list[str]:
        """The state after a tick as rows of doubles."""
        names = [f"{'out' if k in self.out else 'state'}_{k}" for k, _ in self.changes]
        planes = (self.converted(p, DOUBLE, name) for (_, p), name in zip(self.changes, names, strict=True))
        return [f"{plane}.store(out[{i}]);" for i, plane in enumerate(planes)]


def _alike(live: Iterable[Plane]) -> set[int]:
    """Planes that are the same in all rows."""
    alike: set[int] = set()
    for p in live:
        if p.args[0] == "shared" if p.op == "input" else all(arg.op == "constant" or arg.index in alike for arg in p.args):
            alike.add(p.index)
    return alike
