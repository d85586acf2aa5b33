"""The choices of a case as a network, in which the best chain of observations of each cluster is found exactly.

A node is a pass with one of its starts. A cluster is a part of a satellite's passes with so much time before and after it that
it restricts no other part. Chains of all clusters, which are independent for given values of the tasks, are found together, from
one start to the next.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bsk_torch.tasks.aeossp.files import Case, CaseSatellite
from bsk_torch.tasks.aeossp.geometry import Array, Numbers, Passes, Tracks, angle
from bsk_torch.tasks.aeossp.slews import Fits, Line, required_gap

AGREEMENT_S = 1e-3
"""Part of each gap that plans leave unused, s: angles of other programs differ by 4e-6 deg."""

EXTRA_S = 30.0
"""Bound on the time by which rates at the ends of a slew lengthen it, s."""


@dataclass(frozen=True)
class Network:
    """N nodes in P passes in C clusters."""

    passes: Passes
    node: Numbers  # first node of each pass, and N, [P + 1]; the nodes of a pass are successive
    of: Numbers  # pass of each node, [N]
    task: Numbers  # its task, [N]
    start: Numbers  # grid times of the nodes' starts, [N]
    end: Numbers  # their ends, [N]
    cluster: Numbers  # cluster of each pass, [P]; they increase
    slot: Numbers  # start of each node after the first of its cluster, [N]
    reach: Numbers  # steps after the end of an observation from which on any other may start, by satellite, [S]
    # for each node, sorted as in "order", E numbers of nodes: the last of the first starts of another pass, all of which
    # leave enough time before this node; each node has N, too, for none
    edges: Numbers
    edge: Numbers  # where the edges of these nodes begin, and E, [N + 1]
    order: Numbers  # nodes, sorted by slot, [N]

    @property
    def clusters(self) -> int:
        """Number of clusters."""
        return int(self.cluster.max(initial=-1)) + 1


def build(case: Case, positions: Tracks, passes: Passes, fits: Fits, margin_s: float) -> Network:
    """Return the network of a case.

    Args:
        case: The case.
        positions: Its satellites and tasks.
        passes: Its passes.
        fits: Model of transitions, such as :func:`bsk_torch.tasks.aeossp.slews.verifier`.
        margin_s: Time that each gap leaves beyond what the model asks for, s.
    """
    passes = _without_early(case, positions, passes, margin_s)
    node = np.concatenate([[0], np.cumsum(passes.starts)])
    of = np.repeat(np.arange(len(passes)), passes.starts)
    start = passes.first[of] + np.arange(node[-1]) - node[of]
    end = start + passes.length[of]
    reach = np.array([_reach(satellite, case.step_s, margin_s) for satellite in case.satellites])
    cluster = _clusters(passes, reach)
    slot = start - passes.first[np.searchsorted(cluster, cluster)][of]
    begin, finish = (
        Line(positions.sight(*at), positions.sight_rate(*at))
        for at in ((passes.satellite[of], passes.task[of], k) for k in (start, end))
    )
    heads, tails = [], []
    for number, satellite in enumerate(case.satellites):
        rows, columns, count = _pairs(passes, np.flatnonzero(passes.satellite == number), int(reach[number]), node)
        combos, bounds = _combos(rows, count)
        before, after = node[columns][combos] + rows.first[combos] + bounds, rows.head[combos]
        gap = (start[after] - end[before]) * float(case.step_s) - margin_s - AGREEMENT_S
        good = fits(satellite, gap, _rows(finish, before), _rows(begin, after))
        leading = _leading(good, count) + rows.first
        linked = (leading > 0) & (end[node[columns] + leading - 1] > start[rows.head] - reach[number])
        heads.append(rows.head[linked])
        tails.append((node[columns] + leading - 1)[linked])
    head = np.concatenate([*heads, np.arange(node[-1])])
    tail = np.concatenate([*tails, np.full(node[-1], node[-1])])
    order = np.lexsort((np.arange(node[-1]), slot))
    place = np.empty_like(order)
    place[order] = np.arange(len(order))
    sort = np.lexsort((tail, place[head]))
    edge = np.concatenate([[0], np.cumsum(np.bincount(place[head], minlength=len(order)))])
    return Network(passes, node, of, passes.task[of], start, end, cluster, slot, reach, tail[sort], edge, order)


def _without_early(case: Case, positions: Tracks, passes: Passes, margin_s: float) -> Passes:
    """Return passes without the starts before which a satellite cannot turn from the nadir."""
    skip = np.zeros(len(passes), dtype=np.int64)
    for p in np.flatnonzero(passes.first * case.step_s < 240.0 + margin_s):  # a slew by 180 deg takes 210 s
        k = passes.first[p] + np.arange(passes.starts[p])
        number = int(passes.satellite[p])
        sight = positions.sight(np.full(len(k), number), np.full(len(k), passes.task[p]), k)
        degrees = np.degrees(angle(-positions.r[number, k], sight))
        ready = required_gap(case.satellites[number], degrees) + margin_s + AGREEMENT_S <= k * case.step_s
        skip[p] = int(np.argmax(ready)) if ready.any() else len(k)
    left = passes.starts - skip
    keep = left > 0
    return Passes(passes.satellite[keep], passes.task[keep], (passes.first + skip)[keep], left[keep], passes.length[keep])


def _reach(satellite: CaseSatellite, step_s: int, margin_s: float) -> int:
    """Return the steps after which a satellite that turns with its orbit can look at any task, whatever was last."""
    seconds = 0.0
    for _ in range(20):  # the nadir turns by 0.07 deg/s meanwhile
        degrees = min(2.0 * satellite.off_nadir + 0.07 * seconds, 180.0)
        seconds = float(required_gap(satellite, np.array(degrees)))
    return int(np.ceil((seconds + EXTRA_S + margin_s) / step_s))


def _clusters(passes: Passes, reach: Numbers) -> Numbers:
    cluster = np.zeros(len(passes), dtype=np.int64)
    last = passes.first + passes.starts - 1 + passes.length
    current, free, satellite = -1, 0, -1
    for p in range(len(passes)):
        if passes.satellite[p] != satellite or passes.first[p] >= free:
            current, satellite, free = current + 1, int(passes.satellite[p]), 0
        free = max(free, int(last[p] + reach[satellite]))
        cluster[p] = current
    return cluster


@dataclass(frozen=True)
class _Rows:
    """Pairs of a pass and a later node: the node, and the first start of the pass that needs a check."""

    head: Numbers
    first: Numbers


def _pairs(passes: Passes, mine: Numbers, reach: int, node: Numbers) -> tuple[_Rows, Numbers, Numbers]:
    """Return pairs of a pass and a node of another one that starts less than ``reach`` after its ends.

    Also returns the passes, and the numbers of starts of them that need a check.
    """
    begin, ends = passes.first[mine], passes.first[mine] + passes.length[mine]
    last = begin + passes.starts[mine] - 1
    near = (ends[:, None] < last[None, :]) & ((last + passes.length[mine])[:, None] + reach > begin[None, :])
    near &= passes.task[mine][:, None] != passes.task[mine][None, :]
    p, q = (mine[index] for index in np.nonzero(near))
    repeat = np.repeat(np.arange(len(q)), passes.starts[q])
    j = np.arange(len(repeat)) - np.repeat(np.cumsum(passes.starts[q]) - passes.starts[q], passes.starts[q])
    p, q = p[repeat], q[repeat]
    offset = passes.first[q] + j - (passes.first[p] + passes.length[p])
    first = np.clip(offset - reach + 1, 0, passes.starts[p])
    return _Rows(node[q] + j, first), p, np.clip(offset, 0, passes.starts[p]) - first


def _combos(rows: _Rows, count: Numbers) -> tuple[Numbers, Numbers]:
    """Return the number of the pair, and the number within it, of each start that needs a check."""
    combos = np.repeat(np.arange(len(rows.head)), count)
    return combos, np.arange(len(combos)) - np.repeat(np.cumsum(count) - count, count)


def _leading(good: NDArray[np.bool_], count: Numbers) -> Numbers:
    """Return how many values are true before the first false one, in successive groups of ``count`` values."""
    begin = np.cumsum(count) - count
    wrong = np.append(np.flatnonzero(~good), len(good))
    return np.minimum(wrong[np.searchsorted(wrong, begin)] - begin, count)


def _rows(line: Line, rows: Numbers) -> Line:
    return Line(line.unit[rows], line.rate[rows])


# -- chains ---------------------------------------------------------------------------------------------------------------------


def best_chains(network: Network, value: Array, active: NDArray[np.bool_] | None = None) -> tuple[Numbers, Array]:
    """Return the chain of observations of the largest value in each cluster.

    A chain may observe a task twice, if its pass is long enough.

    Args:
        network: The network.
        value: Value of each node, [N]; those without a positive one are left out.
        active: Clusters to find chains in, [C]; default: all.

    Returns:
        Numbers of the nodes in the chains, sorted, and the values of the clusters' chains, [C].
    """
    chosen = value > 0.0
    if active is not None:
        chosen &= active[network.cluster[network.of]]
    return _Search(network, value, np.flatnonzero(chosen[network.order])).chains()


class _Search:
    """Best chains that end with each node, by dynamic programming over the slots of all clusters together.

    Attributes:
        top: Best value of a chain that ends with a node or an earlier start of its pass, [N + 1]; zero for N.
        top_node: The node that has it.
        done: Best value of the observations of a cluster that have ended by a slot, [slots, C].
        done_node: The last node of their chain, -1 for none.
    """

    def __init__(self, network: Network, value: Array, rows: Numbers) -> None:
        """Search among the nodes at ``rows`` of the network's order."""
        nodes, passes, n = network.order[rows], network.passes, len(network.of)
        of = network.of[nodes]
        self.nodes, self.worth, self.cluster = nodes, value[nodes], network.cluster[of]
        slot = network.slot[nodes]
        self.far = slot - network.reach[passes.satellite[of]]
        finish = slot + passes.length[of]
        self.counts = np.diff(network.edge)[rows]
        self.begins = np.concatenate([[0], np.cumsum(self.counts)])
        self.edges = network.edges[np.repeat(network.edge[rows] - self.begins[:-1], self.counts) + np.arange(self.begins[-1])]
        self.top, self.top_node = np.zeros(n + 1), np.arange(n + 1)
        width = int(finish.max(initial=0)) + 1
        self.done, self.done_node = np.zeros((width, network.clusters)), np.full((width, network.clusters), -1)
        not_first, bounds = nodes != network.node[of], np.searchsorted(slot, np.arange(width + 1))
        for k in range(width):
            if k:
                better = self.done[k - 1] > self.done[k]
                self.done[k, better], self.done_node[k, better] = self.done[k - 1, better], self.done_node[k - 1, better]
            if bounds[k] < bounds[k + 1]:
                self._reach(slice(bounds[k], bounds[k + 1]), not_first, finish)

    def _reach(self, part: slice, not_first: NDArray[np.bool_], finish: Numbers) -> None:
        """Extend chains by the nodes of one slot."""
        ids, row, far, at = self.nodes[part], self.cluster[part], self.far[part], finish[part]
        edges = self.edges[self.begins[part.start] : self.begins[part.stop]]
        best = np.maximum.reduceat(self.top[edges], self.begins[part] - self.begins[part.start])
        best = np.maximum(best, np.where(far >= 0, self.done[np.maximum(far, 0), row], 0.0)) + self.worth[part]
        earlier = not_first[part] & (self.top[ids - 1] > best)
        self.top[ids] = np.where(earlier, self.top[ids - 1], best)
        self.top_node[ids] = np.where(earlier, self.top_node[ids - 1], ids)
        rising = np.argsort(best, kind="stable")  # of several that end at once, the best is written last
        rising = rising[best[rising] > self.done[at[rising], row[rising]]]
        self.done[at[rising], row[rising]], self.done_node[at[rising], row[rising]] = best[rising], ids[rising]

    def chains(self) -> tuple[Numbers, Array]:
        """Return the nodes of the best chains, and their values."""
        place = np.empty(len(self.top), dtype=np.int64)
        place[self.nodes] = np.arange(len(self.nodes))
        nodes: list[int] = []
        for cluster in np.flatnonzero(self.done[-1] > 0.0):
            current = int(self.done_node[-1, cluster])
            while current >= 0:
                nodes.append(current)
                current = self._before(int(place[current]), int(cluster))
        return np.sort(np.array(nodes, dtype=np.int64)), self.done[-1]

    def _before(self, at: int, cluster: int) -> int:
        """Return the node before one in the best chain that ends with it, -1 for none."""
        far, edges = self.far[at], self.edges[self.begins[at] : self.begins[at + 1]]
        edge = int(edges[np.argmax(self.top[edges])])
        by_far = self.done[far, cluster] if far >= 0 else 0.0
        if max(self.top[edge], by_far) <= 0.0:
            return -1
        return int(self.top_node[edge]) if self.top[edge] >= by_far else int(self.done_node[far, cluster])
