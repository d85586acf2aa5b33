"""Chains against a search over all pairs of nodes, and plans against the rules."""

import dataclasses
import itertools

import numpy as np
import pytest

from bsk_torch.tasks.aeossp import check, flyable, plan, verifier
from bsk_torch.tasks.aeossp.network import AGREEMENT_S, best_chains
from bsk_torch.tasks.aeossp.planning import RESERVE
from bsk_torch.tasks.aeossp.rules import lines
from bsk_torch.tasks.aeossp.slews import Line


@pytest.fixture(scope="module")
def planned(case, positions):
    return plan(case, positions=positions)


def pairs(case, positions, network, number, fits):
    """For the nodes of a satellite, which may follow which, with all gaps checked."""
    nodes = np.flatnonzero(network.passes.satellite[network.of] == number)
    satellite, task = np.full(len(nodes), number), network.task[nodes]
    ends, starts = (
        Line(positions.sight(satellite, task, k), positions.sight_rate(satellite, task, k))
        for k in (network.end[nodes], network.start[nodes])
    )
    i, j = np.divmod(np.arange(len(nodes) ** 2), len(nodes))
    gap = (network.start[nodes][j] - network.end[nodes][i]) * float(case.step_s) - AGREEMENT_S
    later = gap > 0.0
    good = np.zeros(len(gap), dtype=bool)
    before, after = (Line(line.unit[rows[later]], line.rate[rows[later]]) for line, rows in ((ends, i), (starts, j)))
    good[later] = fits(case.satellites[number], gap[later], before, after)
    good &= task[i] != task[j]
    return nodes, good.reshape(len(nodes), len(nodes))


@pytest.mark.parametrize("number", [1, 2])
def test_chains_are_the_best_of_all(case, positions, network, number):
    nodes, follows = pairs(case, positions, network, number, verifier)
    value = np.random.default_rng(3).uniform(0.1, 5.0, len(network.of))
    reached = np.zeros(len(nodes))
    for k in np.argsort(network.start[nodes], kind="stable"):
        reached[k] = value[nodes[k]] + reached[follows[:, k]].max(initial=0.0)
    active = np.zeros(network.clusters, dtype=bool)
    active[network.cluster[network.passes.satellite == number]] = True
    chains, values = best_chains(network, value, active)
    assert values.sum() == pytest.approx(reached.max(), rel=1e-12)
    assert value[chains].sum() == pytest.approx(values.sum(), rel=1e-12)
    order = chains[np.argsort(network.start[chains])]
    place = {node: k for k, node in enumerate(nodes)}
    assert all(follows[place[a], place[b]] for a, b in itertools.pairwise(order))


def test_plans_are_valid_and_near_their_bound(case, positions, planned, report):
    result = check(case, planned.observations, positions)
    assert result.valid
    assert len(np.unique(planned.observations.task)) == len(planned.observations)
    assert max(report["metrics"]["WCR"], 0.98 * planned.bound) < result.WCR <= planned.bound
    assert (result.power.least_wh >= RESERVE * np.array([craft.capacity_wh for craft in case.satellites])).all()


def test_plans_are_the_same_every_time(case, positions, planned):
    ours, theirs = (dataclasses.astuple(one.observations) for one in (plan(case, positions=positions), planned))
    np.testing.assert_array_equal(np.stack(ours), np.stack(theirs))


def test_margins_are_kept_and_bodies_can_fly_plans(case, positions):
    observations = plan(case, flyable, 10.0, positions=positions).observations
    result = check(case, observations, positions)
    assert result.valid
    assert (result.slews.gap - result.slews.required >= 10.0).all()
    after = np.flatnonzero(result.slews.previous >= 0)
    before = observations.take(result.slews.previous[after])
    plan_after = observations.take(after)
    ends = lines(positions, before, before.end_s, case.step_s)
    starts = lines(positions, plan_after, plan_after.start_s, case.step_s)
    for number, craft in enumerate(case.satellites):
        mine = plan_after.satellite == number
        line = [Line(part.unit[mine], part.rate[mine]) for part in (ends, starts)]
        assert flyable(craft, result.slews.gap[after][mine] - 10.0, *line).all()


def test_batteries_that_bind_keep_their_reserve(case, positions, planned):
    weak = [
        dataclasses.replace(craft, initial_wh=0.1 * craft.capacity_wh, idle_w=5.0, charge_w=12.0) for craft in case.satellites
    ]
    poor = dataclasses.replace(case, satellites=tuple(weak))
    assert not check(poor, planned.observations, positions).valid
    result = check(poor, plan(poor, positions=positions).observations, positions)
    assert result.valid
    assert (result.power.least_wh >= RESERVE * np.array([craft.capacity_wh for craft in weak])).all()
    assert result.WCR > 0.1


def test_cases_without_passes_have_an_empty_plan(case, positions):
    blind = tuple(dataclasses.replace(craft, off_nadir=0.0) for craft in case.satellites)
    empty = plan(dataclasses.replace(case, satellites=blind), positions=positions)
    assert len(empty.observations) == 0
    assert empty.bound == 0.0
