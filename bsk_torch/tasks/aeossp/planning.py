"""A planner of observations: chains of observations as columns of a set packing problem, generated at prices of the tasks.

Each task may be observed once, which couples the clusters of a :class:`bsk_torch.tasks.aeossp.network.Network`. Relaxed with a
price for each task, their best chains are independent, and bound the weight of every plan from above (Fisher, *Management
Science* 27, 1981). Chains found on the way become columns of a linear program, whose prices yield further chains (Dantzig and
Wolfe, *Operations Research* 8, 1960). HiGHS then chooses among all columns at most one for each cluster. Batteries that a choice
would empty are rows of the program, too.

Plans depend on a seed, and on no clock.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import Bounds, LinearConstraint, linprog, milp
from scipy.sparse import csr_matrix

from bsk_torch.tasks.aeossp.files import Case, Observations
from bsk_torch.tasks.aeossp.geometry import Array, Numbers, Tracks, find_passes, tracks
from bsk_torch.tasks.aeossp.network import Network, best_chains, build
from bsk_torch.tasks.aeossp.rules import Power, find_power, find_slews
from bsk_torch.tasks.aeossp.slews import Fits, verifier

PRICING, GENERATION, REPEATS = 150, 60, 4
"""Steps of the prices, most rounds of further columns, and most attempts to get rid of a task that a chain observes twice."""

CYCLES, VARIED = 2, 60
"""Cycles of further columns, and rounds of chains at varied prices in each."""

SPREAD, SLACK = 0.5, 1.5
"""By which part prices vary, and how much less, in weight, such a chain may be worth than the best one of its cluster."""

NODES, GAP = 50, 2e-4
"""Most nodes of HiGHS's tree, and the relative gap at which it stops."""

RESERVE = 0.02
"""Part of the capacity that batteries keep in plans: models of the shadow differ by 0.1 % of it."""

EXACT = 1e-7
"""Reduced value, in weight, from which on a chain becomes a column."""


@dataclass(frozen=True)
class Plan:
    """A plan.

    Attributes:
        observations: Its observations, sorted by satellite and start.
        bound: Upper bound on the WCR of every plan with the same transitions, whatever the batteries.
        columns: Number of chains among which it has been chosen.
    """

    observations: Observations
    bound: float
    columns: int


def plan(
    case: Case,
    fits: Fits = verifier,
    margin_s: float = 0.0,
    seed: int = 0,
    positions: Tracks | None = None,
    tell: Callable[[str], object] = lambda text: None,
) -> Plan:
    """Return a plan for a case, which the benchmark's verifier accepts.

    Args:
        case: The case.
        fits: Model of transitions: :func:`bsk_torch.tasks.aeossp.slews.verifier`, or ``flyable`` for plans which leave a body
            with the same limits the time for its slews. With the latter, no task is observed while its line of sight turns
            faster than the satellite may.
        margin_s: Further time in each gap, s.
        seed: Seed of the varied prices.
        positions: :func:`bsk_torch.tasks.aeossp.geometry.tracks` of the case, computed unless given.
        tell: Receives a line about the progress now and then.

    Raises:
        ValueError: If SGP4 has no orbit for a satellite.
    """
    positions = tracks(case) if positions is None else positions
    rates = None if fits is verifier else [satellite.slew_rate for satellite in case.satellites]
    tell("finding passes")
    network = build(case, positions, find_passes(case, positions, rates), fits, margin_s)
    if not len(network.of):
        nothing = np.empty(0, dtype=np.int64)
        return Plan(Observations(nothing, nothing, nothing, nothing), 0.0, 0)
    master, random = _Master(case, network), np.random.default_rng(seed)
    bound = _price(master, tell) / float(case.requests.weight.sum())
    while True:
        for _ in range(1 if master.limits else CYCLES):
            _generate(master, random, tell)
        tell(f"choosing among {len(master.columns)} chains")
        nodes = master.choose()
        observations = _observations(case, network, nodes)
        power = find_power(case, observations, find_slews(case, observations, positions))
        if not master.limit(nodes, power):
            return Plan(observations, bound, len(master.columns))


def _observations(case: Case, network: Network, nodes: Numbers) -> Observations:
    satellite = network.passes.satellite[network.of[nodes]]
    order = np.lexsort((network.start[nodes], satellite))
    nodes, step = nodes[order], case.step_s
    return Observations(satellite[order], network.task[nodes], network.start[nodes] * step, network.end[nodes] * step)


# -- columns --------------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Limit:
    """The energy, Wh, of observations of each node that counts, [N], and how much of it a plan may use."""

    energy: Array
    most: float


class _Master:
    """The program that chooses among columns: chains of nodes of one cluster, in which each task is observed once.

    Attributes:
        case: The case.
        network: Its network.
        columns: Nodes of each chain.
        prices: The prices of the tasks with the least bound so far, [T].
        limits: Limits of batteries.
    """

    def __init__(self, case: Case, network: Network) -> None:
        """Begin without columns."""
        self.case, self.network = case, network
        self.columns: list[Numbers] = []
        self.prices: Array = np.zeros(len(case.requests))
        self.limits: list[_Limit] = []
        self.cluster = network.cluster[network.of]
        self.key = self.cluster * len(case.requests) + network.task  # of a task in a cluster
        self._known: set[tuple[int, ...]] = set()

    def add(self, nodes: Numbers, value: Array, least: Array) -> int:
        """Add the chains in ``nodes`` in which no task repeats, and return how many are new.

        With nodes worth ``value`` [N], a chain is worth more than ``least`` [C] of its cluster.
        """
        clusters, begins = np.unique(self.cluster[nodes], return_index=True)
        before = len(self.columns)
        for cluster, chain in zip(clusters, np.split(nodes, begins)[1:], strict=True):
            tasks = np.unique(self.network.task[chain])
            known = (int(cluster), *tasks.tolist())
            if len(tasks) < len(chain) or known in self._known:
                continue
            if value[chain].sum() > least[cluster]:
                self._known.add(known)
                self.columns.append(chain)
        return len(self.columns) - before

    def choose(self) -> Numbers:
        """Return the nodes of the best columns."""
        worth, rows, most = self._program()
        settings = {"node_limit": NODES, "mip_rel_gap": GAP}
        result = milp(
            -worth, constraints=LinearConstraint(rows, -np.inf, most), integrality=1, bounds=Bounds(0, 1), options=settings
        )
        if result.x is None:
            raise RuntimeError(f"HiGHS found no plan: {result.message}")
        chosen = [self.columns[k] for k in np.flatnonzero(result.x > 0.5)]
        return np.concatenate([*chosen, np.empty(0, dtype=np.int64)])

    def duals(self) -> tuple[Array, Array, Array]:
        """Return prices of clusters, [C], of tasks, [T], and of limits, by which no column is worth more than its cluster."""
        worth, rows, most = self._program()
        result = linprog(-worth, A_ub=rows, b_ub=most, bounds=(0.0, None), method="highs")
        clusters, tasks = self.network.clusters, len(self.case.requests)
        prices = np.maximum(-result.ineqlin.marginals, 0.0)
        return prices[:clusters], prices[clusters : clusters + tasks], prices[clusters + tasks :]

    def value(self, prices: Array, limits: Array) -> Array:
        """Return the reduced weight of each node, [N]."""
        value = (self.case.requests.weight - prices)[self.network.task]
        for limit, price in zip(self.limits, limits, strict=True):
            value = value - price * limit.energy
        return value

    def _program(self) -> tuple[Array, csr_matrix, Array]:
        """Return weights of the columns, and rows with bounds: clusters, tasks, limits."""
        clusters, tasks = self.network.clusters, len(self.case.requests)
        sizes = [len(chain) for chain in self.columns]
        nodes, column = np.concatenate(self.columns), np.repeat(np.arange(len(sizes)), sizes)
        first = np.cumsum(sizes) - sizes
        parts = [(self.cluster[nodes[first]], np.arange(len(sizes)), np.ones(len(sizes)))]
        parts.append((clusters + self.network.task[nodes], column, np.ones(len(nodes))))
        for k, limit in enumerate(self.limits):
            parts.append((np.full(len(nodes), clusters + tasks + k), column, limit.energy[nodes]))
        row, column_of, entry = (np.concatenate(values) for values in zip(*parts, strict=True))
        shape = clusters + tasks + len(self.limits), len(sizes)
        worth = np.bincount(column, self.case.requests.weight[self.network.task[nodes]]).astype(np.float64)
        most = np.concatenate([np.ones(clusters + tasks), [limit.most for limit in self.limits]])
        return worth, csr_matrix((entry, (row, column_of)), shape=shape), most

    def limit(self, nodes: Numbers, power: Power) -> bool:
        """Limit the energy on satellites whose batteries observations take below the reserve; return whether there are any.

        What an observation costs is its own energy, and that of the satellite's mean slew in this plan.
        """
        network, case = self.network, self.case
        satellite = network.passes.satellite[network.of]
        reserve = RESERVE * np.array([craft.capacity_wh for craft in case.satellites])
        before = len(self.limits)
        for number in np.flatnonzero(power.least_wh < reserve):
            craft, mine = case.satellites[number], satellite == number
            slew = craft.slew_w * power.slewing_s[number] / max(np.count_nonzero(mine[nodes]), 1)
            length = (network.end - network.start) * case.step_s
            counts = mine & (network.start * case.step_s >= power.full_s[number])
            counts &= network.end * case.step_s <= power.least_s[number]
            energy = np.where(counts, (craft.imaging_w * length + slew) / 3600.0, 0.0)
            used = energy[nodes].sum()
            if used > 0.0:  # else the satellite is short of energy by itself
                self.limits.append(_Limit(energy, max(used - (reserve[number] - power.least_wh[number]) - 0.1, 0.0)))
        return len(self.limits) > before


# -- prices ---------------------------------------------------------------------------------------------------------------------


def _price(master: _Master, tell: Callable[[str], object]) -> float:
    """Find prices of tasks by subgradient steps, which halve where they do not help; return the least upper bound."""
    weight, count = master.case.requests.weight, len(master.case.requests)
    whole = float(weight.sum())
    prices, bound, scale, stalled = master.prices, np.inf, 0.02, 0
    everything: Array = np.ones(len(master.network.of))
    for step in range(PRICING):
        nodes, values = best_chains(master.network, (weight - prices)[master.network.task])
        master.add(nodes, everything, np.zeros(master.network.clusters))
        total = float(prices.sum() + values.sum())
        if total < bound * (1.0 - 1e-5):
            bound, master.prices, stalled = total, prices, 0
        else:
            stalled += 1
        if stalled == 5:
            prices, scale, stalled = master.prices, 0.5 * scale, 0
            continue
        slope = np.bincount(master.network.task[nodes], minlength=count) - 1.0
        slope[(slope < 0.0) & (prices <= 0.0)] = 0.0
        prices = np.maximum(prices + scale * bound / max(float(slope @ slope), 1.0) * slope, 0.0)
        if step % 10 == 0:
            tell(f"pricing: at most {bound / whole:.4f} of the weight")
    return bound


def _generate(master: _Master, random: np.random.Generator, tell: Callable[[str], object]) -> None:
    """Add chains until none is worth more than the program's columns at their prices; then others at varied prices."""
    for turn in range(GENERATION):
        clusters, tasks, limits = master.duals()
        if turn == 0:
            stable = tasks if master.limits else master.prices
        new, exact = 0, master.value(tasks, limits)
        for prices in (0.5 * (tasks + stable), tasks):  # the former change less from round to round
            for nodes in _simple(master, master.value(prices, limits)):
                new += master.add(nodes, exact, clusters + EXACT)
        if not new:
            break
        tell(f"round {turn}: {len(master.columns)} chains")
    for turn in range(VARIED):
        varied = tasks * random.uniform(1.0 - SPREAD, 1.0 + SPREAD, len(tasks))
        for nodes in _simple(master, master.value(varied, limits)):
            master.add(nodes, exact, clusters - SLACK)
        if turn % 10 == 0:
            tell(f"varied prices {turn}: {len(master.columns)} chains")


def _simple(master: _Master, value: Array) -> list[Numbers]:
    """Return best chains; where a task repeats, also chains without its later or without its earlier starts."""
    nodes, _ = best_chains(master.network, value)
    chains = [nodes]
    for later in (True, False):
        left, current = value.copy(), nodes
        for _ in range(REPEATS):
            keys, counts = np.unique(master.key[current], return_counts=True)
            if counts.max(initial=1) == 1:
                break
            repeated = keys[counts > 1]
            order = np.lexsort((master.network.start[current] * (1 if later else -1), master.key[current]))
            key = master.key[current][order]
            kept = master.network.start[current][order][np.searchsorted(key, repeated)]
            at = np.minimum(np.searchsorted(repeated, master.key), len(repeated) - 1)
            start = master.network.start
            out = (repeated[at] == master.key) & ((start > kept[at]) if later else (start < kept[at]))
            left[out] = 0.0
            active = np.zeros(master.network.clusters, dtype=bool)
            active[repeated // len(master.case.requests)] = True
            current, _ = best_chains(master.network, left, active)
            chains.append(current)
    return chains
