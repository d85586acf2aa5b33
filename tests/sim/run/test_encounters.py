"""First ticks of conditions on distances, compared with loops over episodes, pairs and ticks; and pairs of satellites."""

import pytest
import torch

from bsk_torch.sim import dyn
from bsk_torch.sim.run.encounters import NEVER, EncounterPairs, Limits, find_pairs, first_ticks, reached
from bsk_torch.vec3 import Vec3
from tests.support.refusals import check_refusals, refusal

N, C, K = 7, 4, 60


def walks(seed=0, n=N):
    """Relative positions of random walks, [n, C, K + 1, 3] m; of episodes whose numbers do not depend on n."""
    steps = [torch.randn(C, K + 1, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(seed + e)) for e in range(n)]
    return 8.0 * torch.stack(steps).cumsum(2)


def limits(n=N):
    """Collisions, of which the second looks between ticks and the third every five ticks, and a range."""
    each = torch.arange(n, dtype=torch.float64).view(-1, 1)
    distance = torch.tensor([12.0, 9.0, 15.0, 60.0], dtype=torch.float64) + each
    every = torch.tensor([1, 1, 5, 1]).expand(n, C) + torch.tensor([0, 0, 1, 0]) * (each % 2).long()
    between = torch.tensor([False, True, False, False]).expand(n, C)
    return Limits(tuple(range(C)), distance, (False, False, False, True), every, between)


def pieces(r, length):
    """The walks in pieces, as a fleet yields them."""
    before = torch.cat([r[:, :, :1], r[:, :, :-1]], 2)
    for start in range(0, r.shape[2], length):
        part = slice(start, start + length)
        yield torch.arange(r.shape[2])[part], Vec3.of(before[:, :, part]), Vec3.of(r[:, :, part])


def closest(start, end):
    """Smallest distance of a thousand points of the way from one position to another."""
    share = torch.linspace(0.0, 1.0, 1001, dtype=torch.float64).unsqueeze(-1)
    return float((start + share * (end - start)).norm(dim=-1).min())


def by_loops(r, given, last):
    first = torch.full((len(r), C), NEVER)
    for e in range(len(r)):
        for c in range(C):
            for k in range(K + 1):
                distance = float(r[e, c, k].norm())
                if given.between[e, c] and k:
                    distance = min(distance, closest(r[e, c, k - 1], r[e, c, k]))
                bound = float(given.distance[e, c])
                holds = distance >= bound if given.beyond[c] else distance <= bound
                if holds and k % int(given.every[e, c]) == 0 and k <= int(last[e]):
                    first[e, c] = k
                    break
    return first


@pytest.mark.parametrize("length", [1, 7, 100])
@pytest.mark.parametrize("seed", [0, 100])
def test_first_ticks_are_those_of_loops(length, seed):
    r, last = walks(seed), torch.tensor([60, 59, 30, 0, -1, 60, 45])
    expected = by_loops(r, limits(), last)
    assert torch.equal(first_ticks(pieces(r, length), limits(), last), expected)
    found = expected < NEVER
    assert 0 < int(found.sum()) < found.numel()
    assert found.any(0).all()


def test_an_episode_does_not_depend_on_the_others():
    last = torch.full((N,), K)
    whole = first_ticks(pieces(walks(), 10), limits(), last)
    for n in (1, 3):
        assert torch.equal(first_ticks(pieces(walks(n=n), 10), limits(n), last[:n]), whole[:n])


def alike(distances, pairs, beyond, between):
    """Conditions of one episode that are looked at in every tick."""
    distance = torch.tensor([distances], dtype=torch.float64)
    return Limits(pairs, distance, beyond, torch.ones_like(distance).long(), torch.full_like(distance, between) > 0.0)


def test_encounters_of_one_pair():
    given = alike([5.0, 5.0], (0, 0), (False, True), between=False)
    for distance, expected in ((5.0, [True, True]), (4.999999, [True, False]), (5.000001, [False, True])):
        now = Vec3.of(torch.tensor([distance, 0.0, 0.0]).double().view(1, 1, 1, 3))
        assert reached(now, now, given).flatten().tolist() == expected
    # 15 km/s, five seconds a tick: 75 km between looks, and 3 m at the closest point, which is no tick's.
    r = torch.stack([torch.tensor([-40e3 + 75e3 * k, 3.0, 0.0]).double() for k in range(4)]).view(1, 1, 4, 3)
    given = alike([20.0, 3.0 + 1e-6, 3.0 - 1e-6], (0, 0, 0), (False, False, False), between=True)
    given.between[0, 0] = False
    assert first_ticks(pieces(r, 2), given, torch.tensor([3])).tolist() == [[NEVER, 1, NEVER]]
    r = torch.tensor([3.0, 4.0, 0.0]).double().expand(1, 1, 3, 3)
    given = alike([5.0, 4.9], (0, 0), (False, False), between=True)
    assert first_ticks(pieces(r, 2), given, torch.tensor([2])).tolist() == [[0, NEVER]]


class Both(dyn.ConjunctionDynModel, dyn.MaxRangeDynModel):
    """May collide and be lost."""


NAMES = ("A", "B", "C", "D")


def test_pairs_follow_from_the_models(caplog):
    models = (Both, dyn.BasicDynamicsModel, dyn.ConjunctionDynModel, dyn.MaxRangeDynModel)
    pairs = find_pairs(NAMES, models, ("B", "ignored", None, "A"), False)
    assert (pairs, pairs.watched) == (EncounterPairs(((2, 0),), ((0, 1), (3, 0))), {0, 1, 2, 3})
    assert pairs.among((0, 2)) == EncounterPairs(((1, 0),), ())
    assert find_pairs(NAMES, (Both,) * 4, ("A",) * 4, True).ranges == ((1, 0), (2, 0), (3, 0))
    assert (
        find_pairs(NAMES, (dyn.DynamicsModel, dyn.ConjunctionDynModel, *[dyn.LOSCommDynModel] * 2), (None,) * 4, True).watched
        == set()
    )
    assert find_pairs(("A",), (Both,), (None,), False) == EncounterPairs((), ())
    assert "A has dyn.MaxRangeDynModel and chief_name=None" in caplog.text


def test_rejects_unknown_chiefs_and_orders_in_which_bsk_rl_raises():
    models, chiefs, unknown = (Both, dyn.DynamicsModel, Both, Both), ("A",) * 4, ("A", "A", "A", "BB")
    find_pairs(NAMES, models, chiefs, False)
    check_refusals(
        refusal(lambda: find_pairs(NAMES, (Both,) * 4, unknown, False), ValueError, "of D", "chief_name='BB'", "'B'"),
        refusal(lambda: find_pairs(NAMES, models, chiefs, True), ValueError, "'C'", "'B'", "dyn.ConjunctionDynModel"),
    )
