"""What places in orbit cost: bytes and CPU time of each environment, as mean elements and as arcs like those of satellites.

Usage:
    python benchmarks/orbiting_places.py [--batch 4096] [--places 200] [--chunk 256] [--minutes 95] [--range-km 1000]

Every environment has one satellite and ``--places`` places on low orbits. ``draw`` draws the orbits and computes their mean
elements, ``search`` finds the windows in which a place is within range, clear of the Earth and half in sunlight. Environments are
measured ``--chunk`` at a time: the median of all chunks, with quartiles. ``arcs`` solves orbits of as many satellites as
``--arcs`` says, without search and ticks, by the solver of satellites; ``error`` is the distance between both at the end. Times
are CPU time of one thread.
"""

from __future__ import annotations

import math
import time
from typing import Any

import harness
import torch
from torch import Tensor

from bsk_torch.astro.mean_orbit import mean_elements, mean_position
from bsk_torch.astro.orbit import Elements, elements_to_rv
from bsk_torch.sim.access.passes.passes import GroundTrack
from bsk_torch.sim.access.passes.sampled_passes import find_passes
from bsk_torch.sim.draw_table import DrawTable
from bsk_torch.sim.orbit.arcs import Arcs, segments_for
from bsk_torch.sim.orbit.grid import LEAD_NODES, NODE_SPACING, PLAN_STEP
from bsk_torch.sim.orbit.kernel_solver import make_solver
from bsk_torch.sim.places import ClearOfEarth, Lit, OrbitingPlaces, PlaceTables, WithinRange

CPU = torch.device("cpu")

EPOCH = 6e8
"""ET of all episodes, s."""

COLUMNS = {
    "places": "{places}",
    "of": "{batch:,}",
    "kB each": "{kilobytes:.1f}",
    "draw, ms each": "{draw_ms:.2f} ({draw_ms_low:.2f} to {draw_ms_high:.2f})",
    "search, ms each": "{search_ms:.1f} ({search_ms_low:.1f} to {search_ms_high:.1f})",
    "windows each": "{windows:.1f}",
}

ARC_COLUMNS = {
    "arcs of": "{places}",
    "kB each": "{kilobytes:.0f}",
    "solve, ms each": "{solve_ms:.1f}",
    "error, m": "{error_m:.0f}",
}


def orbits(*shape: int) -> tuple[Tensor, Tensor]:
    """Positions and velocities of random low orbits, [..., 3] each."""
    u = torch.rand(6, *shape, dtype=torch.float64)
    turn = 2.0 * math.pi
    elements = Elements(6.78e6 + 8e5 * u[0], 0.002 * u[1], math.pi * u[2], turn * u[3], turn * u[4], turn * u[5])
    r, v = elements_to_rv(elements)
    return r.stack(), v.stack()


def tables(oe: Tensor) -> PlaceTables:
    """Tables of as many environments as ``oe`` has rows."""
    drawn, arguments = (DrawTable(len(oe), 1, CPU) for _ in range(2))
    drawn.declare("orbits", None, *oe.shape[1:])
    drawn["orbits"] = oe
    arguments.declare("utc_init", EPOCH)
    return PlaceTables(drawn, arguments, {})


def chunk(rows: int, places: int, minutes: float, reach: float) -> dict[str, Any]:
    """Draw and search one chunk."""
    clock = time.thread_time()
    oe = mean_elements(*orbits(rows, places))
    drawn = time.thread_time() - clock
    samples = PLAN_STEP * torch.arange(round(60.0 * minutes / PLAN_STEP) + 1, dtype=torch.float64)
    every = torch.arange(rows)
    satellites = OrbitingPlaces(tables(mean_elements(*orbits(rows, 1))), "orbits", ())
    r_BP_P = satellites.position(every, torch.zeros(rows, 1, dtype=torch.long), samples.expand(rows, -1))
    track = GroundTrack(r_BP_P, torch.zeros(rows, dtype=torch.float64))
    kind = OrbitingPlaces(tables(oe), "orbits", (WithinRange(reach), ClearOfEarth(1e5), Lit(0.5)))
    clock = time.thread_time()
    windows = len(find_passes(kind, every, track).row)
    return {"draw": drawn, "search": time.thread_time() - clock, "windows": windows, "bytes": oe.nbytes, "rows": rows}


def arcs(places: int, minutes: float, count: int) -> dict[str, Any]:
    """Row of arcs: what solving ``count`` satellites says of ``places``."""
    r, v = orbits(count)
    made = Arcs(count, segments_for(60.0 * minutes), make_solver(1.0, "compiled", CPU))
    every, et = torch.arange(count), torch.full((count,), EPOCH, dtype=torch.float64)
    made.solve(every, et, r, v)  # compiles
    clock = time.thread_time()
    made.solve(every, et, r, v)
    solved = time.thread_time() - clock
    node = round(60.0 * minutes / NODE_SPACING)
    end = mean_position(mean_elements(r, v), torch.full((count,), NODE_SPACING * node, dtype=torch.float64)).stack()
    error = (end - made.flown[:, LEAD_NODES + node]).norm(dim=-1).median()
    each = places / count
    return {"places": places, "kilobytes": 1e-3 * each * made.nbytes, "solve_ms": 1e3 * each * solved, "error_m": float(error)}


def main() -> None:
    """Measure and print two tables."""
    parser = harness.parser(__doc__, batch=4096, places=200, chunk=256, minutes=95.0, range_km=1000.0, arcs=200)
    options, described = harness.begin(parser)
    torch.manual_seed(0)
    reach = 1e3 * options.range_km
    chunk(min(4, options.chunk), options.places, options.minutes, reach)  # loads tables
    parts = []
    for first in range(0, options.batch, options.chunk):
        parts.append(chunk(min(options.chunk, options.batch - first), options.places, options.minutes, reach))
    row: dict[str, Any] = {"places": options.places, "batch": options.batch}
    for name in ("draw", "search"):
        row |= harness.spread(f"{name}_ms", [1e3 * part[name] / part["rows"] for part in parts])
    row |= {"kilobytes": 1e-3 * sum(part["bytes"] for part in parts) / options.batch}
    row |= {"windows": sum(part["windows"] for part in parts) / options.batch}
    solved = arcs(options.places, options.minutes, options.arcs)
    print(harness.table(COLUMNS, [row]), harness.table(ARC_COLUMNS, [solved]), sep="\n\n")
    harness.write(options, described, rows=[row], arcs=[solved])


if __name__ == "__main__":
    main()
