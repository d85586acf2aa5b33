"""Compares two flights of a case: the first difference that a twin does not excuse, and its documented reason if any."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from differential_draw import Case
from differential_flight import Flight, Record

Array = np.ndarray

TOLERANCES = {
    "time": 1e-6,
    "d_ts": 1e-6,
    "r_BN_N": 1e-2,
    "v_BN_N": 1e-5,
    "sigma_BN": 1e-7,
    "omega_BN_B": 1e-8,
    "wheel_speeds": 1e-5,
    "battery_charge": 1e-3,
    "storage_level": 2.0,
    "dv_available": 1e-9,
    "reward": 1e-6,
    "cum_reward": 1e-6,
    "observation": 1e-5,
}
"""Largest absolute difference by quantity.

Rewards may also differ by this part of their value, observations by this part of the length of their vector.
"""

WINDOW = 2e-3, 1e-7
"""Largest difference of windows: s, and part of the time since the reset, in which predicted orbits part."""

AMPLIFIED = 1e3
"""How much more than its twin an exact flight may differ: rounding acts in all ticks, a twin is nudged once."""

EDGE = 5e-3
"""Distance of a window's end from a tick, s, within which the two may end a task in different ticks."""


@dataclass(frozen=True)
class Finding:
    """Where two flights part.

    Attributes:
        step: Number of the step; 0 is the reset.
        quantity: What differs.
        here: Its value in the flight under test.
        there: Its value in the reference.
        reason: Why this is no error; empty if nothing is known.
    """

    step: int
    quantity: str
    here: str
    there: str
    reason: str = ""


@dataclass(frozen=True)
class Verdict:
    """Result of a case.

    Attributes:
        steps: Number of steps that were compared.
        ended: Why no more were: "end", "error" (exceptions on both sides, the same in programs), "chaos" or "difference".
        finding: The first difference, if any.
        parted: Quantity in which the twin left its original.
    """

    steps: int
    ended: str
    finding: Finding | None = None
    parted: str = ""

    @property
    def word(self) -> str:
        """One of "same", "error" (before the first step), "chaos", "explained" and "different"."""
        if self.finding is None:
            return self.ended if self.ended == "chaos" or (self.ended == "error" and not self.steps) else "same"
        return "explained" if self.finding.reason else "different"


def tolerance(name: str) -> float:
    """Return the tolerance of a quantity, by the word of its name that is known."""
    return next(TOLERANCES[word] for word in reversed(name.split()) if word in TOLERANCES) if "observation" not in name else 1e-5


def judge(case: Case, here: Flight, there: Flight, twin: Flight) -> Verdict:
    """Compare a flight with the reference, as far as the reference agrees with its twin."""
    for k in range(max(len(here.records), len(there.records))):
        if k >= len(there.records) or k >= len(here.records):
            return ended(case, here, there, twin, k)
        if k >= len(twin.records):
            return Verdict(k, "chaos")
        mine, wanted, other = here.records[k], there.records[k], twin.records[k]
        found = difference(k, mine, wanted, other)
        if parted := lost(wanted, other):
            return Verdict(k, "chaos", parted=parted)
        if found is not None:
            return Verdict(k, "difference", explained(case, here, there, found))
    raise_alike = type(here.error).__name__ == type(there.error).__name__
    if not raise_alike and (case.program or here.error is None or there.error is None):  # the core raises earlier
        return ended(case, here, there, twin, len(there.records))
    return Verdict(len(there.records), "end" if there.error is None else "error")


def ended(case: Case, here: Flight, there: Flight, twin: Flight, k: int) -> Verdict:
    """Judge flights of which one has ended before record k, or by an exception."""
    if len(twin.records) != len(there.records):
        return Verdict(k, "chaos")
    words = [
        f"{type(flight.error).__name__}: {str(flight.error)[:160]}" if flight.error is not None else "no error"
        for flight in (here, there)
    ]
    return Verdict(k, "difference", explained(case, here, there, Finding(k, f"end ({here.where or there.where})", *words)))


def lost(wanted: Record, other: Record) -> str:
    """Return the first quantity in which a twin differs from its original by more than the tolerance, or an empty text."""
    if wanted.facts != other.facts or wanted.numbers.keys() != other.numbers.keys():
        return "facts"
    for name, value in wanted.numbers.items():
        if value.shape != other.numbers[name].shape:
            return name
        scale = tolerance(name) * relative(name, wanted)
        if not np.all(np.abs(value - other.numbers[name]) <= scale, where=np.isfinite(value)):
            return name
    return ""


def relative(name: str, wanted: Record) -> Array:
    """Scale of the tolerance of each value of a quantity."""
    value = wanted.numbers[name]
    if not name.startswith(("reward", "observation", "cum_reward")):
        return np.ones_like(value)
    return np.maximum(1.0, wanted.lengths.get(name, np.abs(value)))


def difference(k: int, mine: Record, wanted: Record, other: Record) -> Finding | None:
    """Return the first difference of two records, times first, or None."""
    if mine.facts != wanted.facts:
        first = next(name for name in (*wanted.facts, *mine.facts) if mine.facts.get(name) != wanted.facts.get(name))
        time = number_difference(k, "time", mine, wanted, other)
        return time or Finding(k, first, str(mine.facts.get(first)), str(wanted.facts.get(first)))
    if mine.numbers.keys() != wanted.numbers.keys():
        return Finding(
            k,
            "quantities",
            str(sorted(mine.numbers.keys() - wanted.numbers.keys())),
            str(sorted(wanted.numbers.keys() - mine.numbers.keys())),
        )
    for name in wanted.numbers:
        if name.startswith("observation"):
            continue
        if found := number_difference(k, name, mine, wanted, other):
            return found
    for name, windows in wanted.windows.items():
        if found := window_difference(k, name, mine.windows[name], windows):
            return found
    for name in wanted.numbers:
        if name.startswith("observation") and (found := number_difference(k, name, mine, wanted, other)):
            return found
    return None


def number_difference(k: int, name: str, mine: Record, wanted: Record, other: Record) -> Finding | None:
    """Return the largest difference of a quantity beyond its tolerance, or None."""
    a, b, c = (record.numbers[name] for record in (mine, wanted, other))
    if a.shape != b.shape:
        return Finding(k, name, f"shape {a.shape}", f"shape {b.shape}")
    allowed = tolerance(name) * relative(name, wanted) + AMPLIFIED * np.abs(b - c)
    same = (np.abs(a - b) <= allowed) | (a == b) | (np.isnan(a) & np.isnan(b)) | np.isnan(allowed)
    if np.all(same):
        return None
    worst = np.unravel_index(int(np.argmax(np.where(same, 0.0, np.abs(a - b)))), a.shape) if a.ndim else ()
    return Finding(k, f"{name}{list(map(int, worst)) if worst else ''}", f"{a[worst]:.12g}", f"{b[worst]:.12g}")


def window_difference(k: int, name: str, mine: list[Any], wanted: list[Any]) -> Finding | None:
    """Return the first window that only one side knows, or None; the order of windows that close together is free."""
    mine, wanted = seen_by_both(mine, wanted)
    left = list(wanted)
    for window in mine:
        match = next((other for other in left if alike(window, other)), None)
        if match is None:
            return Finding(
                k,
                f"{name} window",
                text(window),
                f"{len(wanted)} windows, none alike; of its place: " + "; ".join(text(w) for w in wanted if w[1] == window[1]),
            )
        left.remove(match)
    if left:
        return Finding(
            k,
            f"{name} window",
            f"{len(mine)} windows, none alike; of its place: " + "; ".join(text(w) for w in mine if w[1] == left[0][1]),
            text(left[0]),
        )
    return None


def seen_by_both(mine: list[Any], wanted: list[Any]) -> tuple[list[Any], list[Any]]:
    """Return the windows that open and close while both sides look ahead: how far they do shows in what satellites observe."""
    end = min(max((window[3] for window in windows), default=-np.inf) for windows in (mine, wanted))
    return tuple([window for window in windows if window[3] < end - WINDOW[0]] for windows in (mine, wanted))  # type: ignore[return-value]


def alike(a: Any, b: Any) -> bool:
    """Whether two windows are the same."""
    same_times = all(abs(a[side] - b[side]) <= WINDOW[0] + WINDOW[1] * abs(b[side]) for side in (2, 3))
    return bool(a[0] == b[0] and np.allclose(a[1], b[1], rtol=0, atol=1.0) and same_times)


def text(window: Any) -> str:
    """Write a window down."""
    return f"{window[0]} {window[2]:.4f} to {window[3]:.4f}"


def explained(case: Case, here: Flight, there: Flight, finding: Finding) -> Finding:
    """Add the row of docs/migration_reference.md that a finding follows from, if any."""
    for reason, applies in REASONS.items():
        if applies(case, here, there, finding):
            return Finding(finding.step, finding.quantity, finding.here, finding.there, reason)
    return finding


def near_tick(case: Case, here: Flight, there: Flight, finding: Finding) -> bool:
    """Whether the ends of a task differ by ticks, at the end of a window within EDGE of a tick."""
    if not finding.quantity.startswith(("time", "d_ts")) or finding.step == 0:
        return False
    ends = [w[side] for windows in there.records[finding.step - 1].windows.values() for w in windows for side in (2, 3)]
    tick = case.env["sim_rate"]
    times = float(finding.here), float(finding.there)
    return any(
        abs(end / tick - round(end / tick)) * tick < EDGE and min(times) - EDGE <= end <= max(times) + EDGE for end in ends
    ) and math.isclose(abs(times[0] - times[1]), tick, rel_tol=1e-3)


def dead_at_once(case: Case, here: Flight, there: Flight, finding: Finding) -> bool:
    """Whether agents die in a step without length, after which bsk_rl keeps them for another one."""
    return finding.quantity == "agents" and finding.step > 0 and float(there.records[finding.step].numbers["d_ts"]) == 0.0


def before_the_epoch(case: Case, here: Flight, there: Flight, finding: Finding) -> bool:
    """Whether bsk_rl's search has left the predicted orbit, and found a window that opens before time zero."""
    return finding.quantity.endswith("window") and finding.there.partition(" ")[2].startswith("-")


def grazing(case: Case, here: Flight, there: Flight, finding: Finding) -> bool:
    """Whether bsk_rl's search, whose tolerance grows with time, has missed a short window."""
    if not finding.quantity.endswith("window") or "none alike" in finding.here:
        return False
    _, opens, _, closes = finding.here.split()
    return float(closes) - float(opens) < 2e-4 * float(closes)


REASONS = {
    "windows shorter than about 2e-4 of the time since reset": grazing,
    "passes of satellites in high or eccentric orbits": before_the_epoch,
    "deaths in a step without length": dead_at_once,
    "window times: a window ends within milliseconds of a tick": near_tick,
}
"""Rows of docs/migration_reference.md, "Differences", and when they explain a finding."""
