"""Constellations have the geometry of their definitions and bsk_rl's numbers, and their draws depend on nothing else."""

import math

import pytest
import torch

from bsk_torch import formations as fm
from bsk_torch.astro.orbit import Elements, elements_to_rv, hill_to_inertial
from bsk_torch.constants import MU_EARTH
from bsk_torch.rand import Choice, Key, Normal, Uniform, first_key, per_env, random_orbit
from bsk_torch.vec3 import Vec3
from tests.support.refusals import check_refusals, refusal

TURN = 2.0 * math.pi
ROUNDING = 1e-14
"""Angles in rad: sums and products of a few numbers below 10."""

TWELVE = [f"Sat-{k}" for k in range(12)]

# The following are angles (Omega, omega, f), rad, of bsk_rl 1.3.8's walker_delta.
WALKER_8_4 = [  # (8, 4, 0.5, 500e3, 53.0)
    (0.0, 0.0, 0.0),
    (0.0, 0.0, 3.141592653589793),
    (1.5707963267948966, 0.7853981633974483, 0.0),
    (1.5707963267948966, 0.7853981633974483, 3.141592653589793),
    (3.141592653589793, 1.5707963267948966, 0.0),
    (3.141592653589793, 1.5707963267948966, 3.141592653589793),
    (4.71238898038469, 2.356194490192345, 0.0),
    (4.71238898038469, 2.356194490192345, 3.141592653589793),
]
WALKER_12_3_PAIRS = [  # (12, 3, 1.0, 600e3, 60.0, clustersize=2, clusterspacing=5.0)
    (0.0, 0.0, 0.0),
    (0.0, 0.0, 0.08726646259971647),
    (0.0, 0.0, 3.141592653589793),
    (0.0, 0.0, 3.2288591161895095),
    (2.0943951023931953, 2.0943951023931953, 0.0),
    (2.0943951023931953, 2.0943951023931953, 0.08726646259971647),
    (2.0943951023931953, 2.0943951023931953, 3.141592653589793),
    (2.0943951023931953, 2.0943951023931953, 3.2288591161895095),
    (4.1887902047863905, 4.1887902047863905, 0.0),
    (4.1887902047863905, 4.1887902047863905, 0.08726646259971647),
    (4.1887902047863905, 4.1887902047863905, 3.141592653589793),
    (4.1887902047863905, 4.1887902047863905, 3.2288591161895095),
]
WALKER_12_3_FOURS = [  # (12, 3, 0.25, 600e3, 60.0, clustersize=4, clusterspacing=2.0)
    (plane * 2.0943951023931953, plane * 0.5235987755982988, k * 0.03490658503988659) for plane in range(3) for k in range(4)
]

# Elements that bsk_rl 1.3.8's relative_to_chief gives to deputies with these states, for mu = 398600.436e9 m^3/s^2.
CHIEF = (7.0e6, 0.01, 0.9, 1.1, 0.7, 2.3)
DEPUTIES = {
    "B": (100.0, -2000.0, 300.0, 0.2, -0.1, 0.05),
    "C": (0.0, 1000.0, 0.0, 0.0, 0.0, 0.0),
    "D": (-5e3, 2e4, 1e4, 3.0, 5.0, -7.0),
}
DEPUTY_ELEMENTS = [
    (7000242.600709043, 0.010006484579520945, 0.8999997353935324, 1.100054951869086, 0.7029578052445289, 2.2967242012672866),
    (6999985.560250159, 0.01000138449887622, 0.9000000000000001, 1.1000000000000003, 0.6999858186189226, 2.3001561008920453),
    (6989415.885493869, 0.010844440816522584, 0.9011330875113764, 1.1016272729904095, 0.6695165887855478, 2.3323123311611496),
]


def key(n: int = 5, seed: int = 3, episode: int = 0) -> Key:
    ids = torch.arange(n)
    return Key(torch.full_like(ids, seed), ids, torch.full_like(ids, episode))


def drawn(formation: fm.Formation, n: int = 5, names: list[str] = TWELVE, **options) -> torch.Tensor:
    """Elements [n, S, 6]."""
    formation.check(names)
    settings = formation.draw(key(n, **options), names)
    assert set(settings) == {"oe"}
    columns, values = settings["oe"]
    assert (list(columns), values.dtype) == (list(range(len(names))), torch.float64)
    assert values.shape == (n, len(names), 6)
    return values


def wrapped(angle: torch.Tensor) -> torch.Tensor:
    """The same angle in [-pi, pi)."""
    return torch.remainder(angle + math.pi, TURN) - math.pi


def assert_angle(found: torch.Tensor, expected: torch.Tensor | float, tolerance: float = ROUNDING) -> None:
    assert wrapped(found - expected).abs().amax() < tolerance


@pytest.mark.parametrize(
    ("arguments", "angles"),
    [
        ((8, 4, 0.5, 500e3, 53.0), WALKER_8_4),
        ((12, 3, 1.0, 600e3, 60.0, 2, 5.0), WALKER_12_3_PAIRS),
        ((12, 3, 0.25, 600e3, 60.0, 4, 2.0), WALKER_12_3_FOURS),
    ],
)
def test_walker_delta_has_the_numbers_of_bsk_rl(arguments, angles):
    oe = fm.walker_delta(*arguments)
    n_spacecraft, n_planes, rel_phasing, altitude, inc, *clusters = arguments
    assert (oe[:, 0] == 6371e3 + altitude).all()
    assert (oe[:, 1] == 0.0).all()
    assert_angle(oe[:, 2], math.radians(inc))
    assert_angle(oe[:, 3:], torch.tensor(angles, dtype=torch.float64))
    fixed = fm.walker_delta_args(n_planes, rel_phasing, altitude / 1e3, inc, False, False, *clusters)
    torch.testing.assert_close(drawn(fixed, 2, TWELVE[:n_spacecraft]), oe.expand(2, -1, -1), rtol=1e-15, atol=0)


@pytest.mark.parametrize(("pattern", "nodes"), [(fm.walker_delta, 360.0), (fm.walker_star, 180.0)])
@pytest.mark.parametrize("phasing", [0, 1, 2])
def test_geometry_of_a_walker_pattern(pattern, nodes, phasing):
    """i:12/3/F in Walker's words: planes at equal distances, four satellites each, F 360 / T between neighbours."""
    oe = pattern(12, 3, phasing * 3 / 12, 600e3, 60.0).view(3, 4, 6)
    u = oe[..., 4] + oe[..., 5]
    assert (oe[..., 0] == 6971e3).all()
    assert_angle(oe[..., 3], math.radians(nodes / 3) * torch.arange(3.0).double().unsqueeze(-1))
    assert_angle(u.diff(dim=-1), TURN / 4)
    assert_angle(u.diff(dim=0), phasing * TURN / 12)
    r, v = elements_to_rv(Elements(*oe.unbind(-1)))
    torch.testing.assert_close(r.norm(), torch.full_like(u, 6971e3), rtol=1e-14, atol=0)
    assert (r.cross(v).unit().stack().std(1) < 1e-15).all()  # one normal for a plane
    angle = math.degrees(math.acos(float((r.stack()[0, 0] @ r.stack()[0, 1]) / 6971e3**2)))
    assert angle == pytest.approx(90.0, abs=1e-12)


def test_planes_of_a_star_meet_at_the_poles_and_fly_side_by_side():
    """Polar planes: neighbours ascend together 180 / P degrees apart; across the seam they fly against each other."""
    oe = fm.walker_star(6, 6, 0.0, 780e3, 90.0)
    _, v = elements_to_rv(Elements(*oe.unbind(-1)))
    torch.testing.assert_close(v.unit().stack(), torch.tensor([[0.0, 0.0, 1.0]]).double().expand(6, 3), rtol=0, atol=1e-15)
    seam = oe[0].clone()
    seam[5] = math.pi  # the first plane on the far side, 30 degrees on from the last one
    r, v = elements_to_rv(Elements(*torch.stack([oe[-1], seam]).unbind(-1)))
    assert math.degrees(math.acos(float(r.unit().stack().prod(0).sum()))) == pytest.approx(30.0, abs=1e-12)
    assert float(v.unit().stack().prod(0).sum()) == pytest.approx(-1.0, abs=1e-15)


def test_walkers_phasing_instead_of_bsk_rls():
    by_walker = fm.walker_delta_args(3, phasing=2, randomize_true_anomaly=False, randomize_lan=False)
    by_fraction = fm.walker_delta_args(3, 2 * 3 / 12, randomize_true_anomaly=False, randomize_lan=False)
    assert torch.equal(drawn(by_walker), drawn(by_fraction))
    pairs = fm.walker_delta_args(3, phasing=1, clustersize=2, randomize_true_anomaly=False, randomize_lan=False)
    assert_angle(drawn(pairs)[0, 4, 4] - drawn(pairs)[0, 0, 4], TURN / 6)  # six clusters


def test_a_pattern_is_turned_as_a_whole():
    still = drawn(fm.walker_star_args(3, 0.3, 700.0, 80.0, False, False))
    oe = drawn(fm.walker_star_args(3, 0.3, 700.0, 80.0))
    assert torch.equal(oe[..., [0, 1, 2, 4]], still[..., [0, 1, 2, 4]])
    for column in (3, 5):
        shift = torch.remainder(oe[..., column] - still[..., column], TURN)
        assert_angle(shift, shift[:, :1])
        assert len(shift[:, 0].mul(1e6).round().unique()) == 5  # another one in every environment
        assert ((oe[..., column] >= 0.0) & (oe[..., column] < TURN)).all()
    lan_only = drawn(fm.walker_star_args(3, 0.3, 700.0, 80.0, randomize_true_anomaly=False))
    assert torch.equal(lan_only[..., 5], still[..., 5])
    assert torch.equal(lan_only[..., 3], oe[..., 3])
    anomaly_only = drawn(fm.walker_star_args(3, 0.3, 700.0, 80.0, randomize_lan=False))
    assert torch.equal(anomaly_only[..., 3], still[..., 3])
    assert torch.equal(anomaly_only[..., 5], oe[..., 5])


def test_offsets_are_uniform_and_independent():
    many = 4000
    offsets = drawn(fm.walker_delta_args(1), many, ["A"])[:, 0, [3, 5]] / TURN
    assert offsets.mean(0).tolist() == pytest.approx([0.5, 0.5], abs=5.0 / math.sqrt(12 * many))  # five standard errors
    assert offsets.var(0).tolist() == pytest.approx([1 / 12] * 2, abs=5.0 / 12 / math.sqrt(many))
    assert torch.corrcoef(offsets.mT)[0, 1].abs() < 5.0 / math.sqrt(many)


def test_altitude_and_inclination_may_be_distributions_common_to_all_satellites():
    oe = drawn(fm.walker_delta_args(3, altitude=Uniform(500.0, 800.0), inc=Choice([53.0, 97.6])), 50)
    assert (oe[..., [0, 2]] == oe[:, :1][..., [0, 2]]).all()
    assert ((oe[..., 0] >= 6871e3) & (oe[..., 0] < 7171e3)).all()
    assert len(oe[:, 0, 0].unique()) == 50
    assert torch.rad2deg(oe[:, 0, 2].unique()).tolist() == pytest.approx([53.0, 97.6])
    assert (oe[..., 1] == 0.0).all()


def test_trains_have_gaps_a_node_and_a_place():
    oe = drawn(fm.train_args(2.5, altitude=600.0, inc=97.8))
    assert (oe[..., :5] == oe[:, :1, :5]).all()
    assert_angle(oe[..., 5].diff(dim=-1), math.radians(-2.5))
    r, v = elements_to_rv(Elements(*oe.unbind(-1)))
    r, v = r.stack(), v.stack()
    ahead = ((r[:, :-1] - r[:, 1:]) * v[:, 1:]).sum(-1)
    assert (ahead > 0.0).all()  # each one sees the one before it ahead
    gap = torch.acos((r[:, :-1] * r[:, 1:]).sum(-1) / 6971e3**2)
    torch.testing.assert_close(torch.rad2deg(gap), torch.full_like(gap, 2.5), rtol=0, atol=1e-11)  # acos near 1: 1e-16 / 0.04 rad
    oe = drawn(fm.train_args([1.0, 4.0, 0.5], f=10.0, Omega=20.0), names=TWELVE[:4])
    assert_angle(oe[0, :, 5], torch.deg2rad(torch.tensor([10.0, 9.0, 5.0, 4.5], dtype=torch.float64)))
    assert_angle(oe[..., 3], math.radians(20.0))
    random = drawn(fm.train_args(Uniform(1.0, 5.0, 3)), names=TWELVE[:4])
    gaps = torch.rad2deg(-wrapped(random[..., 5].diff(dim=-1)))
    assert ((gaps >= 1.0) & (gaps < 5.0)).all()
    assert len(gaps.flatten().unique()) == 15
    common = drawn(fm.train_args(Uniform(1.0, 5.0)), names=TWELVE[:4])
    gaps = torch.rad2deg(-wrapped(common[..., 5].diff(dim=-1)))
    torch.testing.assert_close(gaps, gaps[:, :1].expand(5, 3), rtol=1e-12, atol=0)
    assert (len(gaps[:, 0].unique()), drawn(fm.train_args(3.0), names=["A"]).shape) == (5, (5, 1, 6))
    free = drawn(fm.train_args(1.0), 400)
    for column in (3, 5):
        angle = free[:, 0, column] / TURN
        assert float(angle.mean()) == pytest.approx(0.5, abs=5.0 / math.sqrt(12 * 400))
        assert len(angle.unique()) == 400
    held = drawn(fm.train_args(1.0, f=Uniform(0.0, 1.0), Omega=per_env([0.0, 10.0, 20.0, 30.0, 40.0])))
    assert torch.rad2deg(held[:, 0, 3]).tolist() == pytest.approx([0.0, 10.0, 20.0, 30.0, 40.0])
    assert (torch.rad2deg(held[:, 0, 5]) < 1.0).all()


def states(oe: torch.Tensor) -> tuple[Vec3, Vec3]:
    return elements_to_rv(Elements(*oe.unbind(-1)))


def test_deputies_have_the_elements_of_bsk_rl():
    columns, oe = fm.relative_to_chief("A", CHIEF, DEPUTIES).draw(key(2), ["C", "D", "A", "E", "B"])["oe"]
    assert list(columns) == [2, 4, 0, 1]  # E keeps its own
    assert oe.shape == (2, 4, 6)
    assert (oe[:, 0] == torch.tensor(CHIEF, dtype=torch.float64)).all()
    expected = torch.tensor(DEPUTY_ELEMENTS, dtype=torch.float64).expand(2, -1, -1)
    torch.testing.assert_close(oe[:, 1:, 0], expected[..., 0], rtol=0, atol=1e-7)
    torch.testing.assert_close(oe[:, 1:, 1:], expected[..., 1:], rtol=0, atol=1e-12)  # rounding over e = 0.01


@pytest.mark.parametrize("chief", [CHIEF, (6.871e6, 0.0, 0.8, 0.3, 0.0, 5.0), (6.871e6, 0.0, 1e-9, 0.3, 0.0, 5.0)])
@pytest.mark.parametrize("size", [0.0, 1e-3, 1.0, 100.0, 1e4])
def test_elements_lead_through_the_relative_states(chief, size):
    """To 1e-6 m and 1e-9 m/s, also where the deputy's orbit is all but a circle or in the equator."""
    torch.manual_seed(0)
    relative = torch.randn(50, 6, dtype=torch.float64) * size * torch.tensor([1.0, 1.0, 1.0, 1e-3, 1e-3, 1e-3])
    relative[:10, [0, 2, 3, 4, 5]] = 0.0  # only along the track
    deputies = {f"D{k}": state for k, state in enumerate(relative.tolist())}
    formation = fm.relative_to_chief("A", chief, deputies)
    oe = formation.draw(key(1), ["A", *deputies])["oe"][1][0]
    r_C, v_C = states(oe[:1])
    expected = hill_to_inertial(r_C, v_C, Vec3.of(relative[:, :3]), Vec3.of(relative[:, 3:]))
    for found, wanted, tolerance in zip(states(oe[1:]), expected, (1e-6, 1e-9), strict=True):
        torch.testing.assert_close(found.stack(), wanted.stack(), rtol=0, atol=tolerance)


def test_chief_and_deputies_may_be_random():
    class Box:
        a, e, i, Omega, omega, f = CHIEF

    relative = {"B": Normal(0.0, 100.0, 6), "C": lambda: [0.0, 1e3, 0.0, 0.0, 0.0, 0.0], "D": DEPUTIES["D"]}
    oe = drawn(fm.relative_to_chief("A", random_orbit(i=45.0), relative), 40, list("ABCD"))
    assert len(oe[:, 0, 5].unique()) == 40
    r, _ = states(oe)
    gap = (r.stack()[:, 1:] - r.stack()[:, :1]).norm(dim=-1)
    assert len(gap[:, 0].unique()) == 40
    assert (gap[:, 1] - 1e3).abs().amax() < 1e-6
    assert (gap[:, 2] - math.hypot(5e3, 2e4, 1e4)).abs().amax() < 1e-6
    for chief in (Box(), lambda: CHIEF):
        assert drawn(fm.relative_to_chief("A", chief, {}), names=["A"])[0, 0].tolist() == list(CHIEF)


def test_mu_of_the_satellites_counts():
    """The distance does not depend on it, the velocity does: Kepler's third law at 100 m along the track."""
    for mu in (MU_EARTH, 398600.4415e9):
        formation = fm.relative_to_chief("A", (7e6, 0.0, 0.5, 0.0, 0.0, 0.0), {"B": [0.0, 100.0, 0.0, 0.0, 0.0, 0.0]}, mu)
        oe = formation.draw(key(1), ["A", "B"])["oe"][1][0]
        _, v = elements_to_rv(Elements(*oe.unbind(-1)), mu)
        turning = (v.stack()[1] - v.stack()[0]).norm() / 100.0
        assert float(turning) == pytest.approx(math.sqrt(mu / 7e6**3), rel=1e-10)  # 1e-12 m/s of 0.1 m/s


FORMATIONS = {
    "delta": fm.walker_delta_args(3, 0.5, Normal(600.0, 20.0), Uniform(40.0, 60.0)),
    "star": fm.walker_star_args(2, altitude=Choice([500.0, 700.0]), phasing=1),
    "train": fm.train_args(Uniform(1.0, 2.0, 11), Uniform(500.0, 600.0)),
    "chief": fm.relative_to_chief("Sat-3", random_orbit(), {name: Normal(0.0, 50.0, 6) for name in TWELVE if name != "Sat-3"}),
}


@pytest.mark.parametrize("name", FORMATIONS)
def test_draws_do_not_depend_on_the_batch(name):
    formation = FORMATIONS[name]
    whole = formation.draw(key(64), TWELVE)["oe"][1]
    order = torch.tensor([9, 63, 0])
    parts = Key(*(x[order] for x in (key(64).seed, key(64).env_id, key(64).episode)))
    assert torch.equal(formation.draw(parts, TWELVE)["oe"][1], whole[order])
    assert torch.equal(formation.draw(key(1), TWELVE)["oe"][1], whole[:1])
    assert len(whole[:, 0].unique(dim=0)) == 64
    for other in (key(64, seed=4), key(64, episode=1)):
        assert not torch.isclose(formation.draw(other, TWELVE)["oe"][1], whole, rtol=1e-9).all(-1).any()


def test_users_formations():
    class Two(fm.Formation):
        def draw(self, key, names):
            return {"mass": ([1], 300.0 + key.named("mass").uniform(1))}

    formation = Two()
    formation.check(["A", "B"])
    assert formation.draw(key(), ["A", "B"])["mass"][1].shape == (5, 1)
    check_refusals(refusal(lambda: fm.Formation().check(["A"]), TypeError, "draw(key, names)"))


class Given(fm.Formation):
    """Sets what it is told."""

    def __init__(self, satellites, values):
        self.satellites, self.values = satellites, values

    def draw(self, key, names):
        return {"mass": (self.satellites, self.values)}


def test_rejects_wrong_results_of_draw():
    """Indices of satellites that do not exist would change nothing."""
    table = [
        ([0, 2], torch.ones(1, 2), [0, 2], "0 to 1"),
        ([-1], torch.ones(1, 1), [-1]),
        ([1, 1], torch.ones(1, 2), [1, 1]),
        ([0, 1], torch.ones(1, 3), [1, 3], "[1, 2, ...]"),
        ([0, 1], torch.ones(2, 2), [2, 2]),
        ([0], 3.0, 3.0, "tensor"),
    ]
    check_refusals(
        refusal(lambda f=formation: f.check(["A", "B"]), ValueError, "Given.draw(key, names)", "'mass'", *names)
        for satellites, values, *names in table
        for formation in (Given(satellites, values), fm.together({("A", "B"): Given(satellites, values)}))
    )


def test_right_results_of_draw():
    values = torch.rand(1, 2).double()
    Given(torch.tensor([1, 0]), values).check(["A", "B"])
    assert torch.equal(Given(range(2), values).draw_checked(first_key(1), ["A", "B"])["mass"][1], values)
