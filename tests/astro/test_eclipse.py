import itertools
import math

import pytest
import torch

from bsk_torch.astro import eclipse
from bsk_torch.astro.eclipse import illumination, in_umbra, sunlight_margin, visible_fraction
from bsk_torch.constants import AU, R_EARTH, R_SUN
from bsk_torch.vec3 import Vec3

SUN = Vec3.of(torch.tensor([AU, 0.0, 0.0], dtype=torch.float64))


def light(along: float, across: torch.Tensor | float) -> torch.Tensor:
    """Illumination at distances behind the Earth and from the axis of its shadow, m."""
    across = torch.as_tensor(across, dtype=torch.float64)
    return illumination(Vec3(torch.full_like(across, -along), across * 0.6, across * 0.8), SUN)


def umbra_radius(along: float) -> float:
    """By similar triangles: the umbra narrows from the Earth's disc to a point."""
    length = AU * R_EARTH / (R_SUN - R_EARTH)
    slope = R_EARTH / math.sqrt(length**2 - R_EARTH**2)
    return slope * (length - along)


def penumbra_radius(along: float) -> float:
    """By similar triangles: the penumbra widens from a point between Sun and Earth."""
    length = AU * R_EARTH / (R_SUN + R_EARTH)
    slope = R_EARTH / math.sqrt(length**2 - R_EARTH**2)
    return slope * (length + along)


def test_light_outside_the_shadow_and_darkness_inside():
    assert (light(-7e6, 0.0), light(0.0, 7e6), light(3e6, 6.5e6)) == (1.0, 1.0, 1.0)
    assert (light(7e6, 0.0), light(3e6, 6.2e6)) == (0.0, 0.0)


@pytest.mark.parametrize("along", [1e6, 3e6, 2e7, 4e8])
def test_cones_from_similar_triangles(along):
    """The fraction leaves 0 and reaches 1 where the geometry of the cones says."""
    inner, outer = umbra_radius(along), penumbra_radius(along)
    margin = 1e-3 * (outer - inner)
    assert light(along, inner - margin) == 0.0
    assert 0.0 < light(along, inner + margin) < 0.01
    assert 0.99 < light(along, outer - margin) < 1.0
    assert light(along, outer + margin) == 1.0


@pytest.mark.parametrize("along", [1e6, 3e6, 2e7])
def test_penumbra_is_monotone(along):
    inner, outer = umbra_radius(along), penumbra_radius(along)
    fraction = light(along, torch.linspace(inner, outer, 200, dtype=torch.float64)[1:-1])
    assert (fraction.diff() > 0).all()
    middle = light(along, 0.5 * (inner + outer))
    # the Earth's limb is nearly straight against the Sun's disc: half of it is seen half way
    assert middle == pytest.approx(0.5, abs=0.01)


def test_beyond_the_tip_of_the_umbra_basilisk_gives_the_hidden_fraction():
    """An annular eclipse, where the Earth hides (b/a)^2 of the disc: the documented deviation."""
    along = 2e9
    hidden = (math.asin(R_EARTH / along) / math.asin(R_SUN / (AU + along))) ** 2
    assert 0.4 < hidden < 0.6
    assert light(along, 0.0) == pytest.approx(hidden, rel=1e-9)


def test_rotation_changes_nothing():
    r = torch.randn(2000, 3, dtype=torch.float64)
    r = r / r.norm(dim=-1, keepdim=True) * 6.9e6
    turn = torch.linalg.qr(torch.randn(3, 3, dtype=torch.float64))[0]
    one = illumination(Vec3.of(r), SUN)
    other = illumination(Vec3.of(r @ turn.mT), Vec3.of(turn @ SUN.stack()))
    torch.testing.assert_close(one, other, rtol=0, atol=1e-6)  # rounding of acos over the Sun's 9 mrad
    assert 0.3 < (one == 0).double().mean() < 0.4  # (1 - cos asin(R / r)) / 2 of a sphere
    assert ((one >= 0) & (one <= 1)).all()


@pytest.mark.parametrize(
    ("sun", "planet", "separation", "expected"),
    [
        (0.1, 0.5, 0.61, 1.0),
        (0.1, 0.5, 0.39, 0.0),
        (0.1, 0.1, 0.0, 1.0 - 1.0),
        # two equal discs, each through the other's centre: Montenbruck and Gill, equation 3.92
        (0.1, 0.1, 0.1, 1.0 - (2.0 / 3.0 - math.sqrt(3.0) / (2.0 * math.pi))),
        (0.2, 0.1, 0.05, 0.25),
    ],
    ids=["apart", "covered", "equal and concentric", "equal", "annular"],
)
def test_visible_fraction(sun, planet, separation, expected):
    found = visible_fraction(*(torch.tensor(x, dtype=torch.float64) for x in (sun, planet, separation)))
    assert found.item() == pytest.approx(expected, abs=1e-9)


def test_visible_fraction_against_counting():
    """Share of points of the Sun's disc that lie outside of the planet's."""
    side = torch.linspace(-1.0, 1.0, 1001, dtype=torch.float64)
    x, y = torch.meshgrid(side, side, indexing="ij")
    disc = x * x + y * y <= 1.0
    for planet, separation in ((1.5, 1.2), (3.0, 2.5), (0.7, 0.9), (10.0, 10.3)):
        seen = disc & ((x - separation) ** 2 + y * y > planet**2)
        found = visible_fraction(*(torch.tensor(v, dtype=torch.float64) for v in (1.0, planet, separation)))
        assert found.item() == pytest.approx((seen.sum() / disc.sum()).item(), abs=2e-3)  # a pixel along the edge


def directly(r: Vec3, r_sun: Vec3) -> torch.Tensor:
    """The fraction from the discs' angles on the night side, and cones from similar triangles, without any shortcut."""
    to_sun = r_sun - r
    distance, radius, sun = to_sun.norm(), r.norm(), r_sun.norm()
    separation = torch.acos((-r.dot(to_sun) / (radius * distance)).clamp(-1.0, 1.0))
    fraction = visible_fraction(torch.asin(R_SUN / distance), torch.asin(R_EARTH / radius), separation)
    along = -r.dot(r_sun) / sun
    across = (r + r_sun * (along / sun)).norm()
    tips = (sun * R_EARTH / (R_SUN - sign * R_EARTH) for sign in (1.0, -1.0))
    slopes = [(R_EARTH / torch.sqrt(tip**2 - R_EARTH**2), tip, sign) for tip, sign in zip(tips, (-1.0, 1.0), strict=True)]
    inside = torch.stack([across < slope * torch.abs(tip + sign * along) for slope, tip, sign in slopes]).any(0)
    return torch.where((distance >= sun) & inside, fraction, torch.ones_like(fraction))


@pytest.mark.parametrize("radius", [R_EARTH + 2e5, 7e6, 4.2e7, 4e8, 2e9])
def test_shortcuts_change_nothing(radius):
    """Umbra, penumbra and light around the edge of the shadow."""
    angle = torch.linspace(-1.2, 1.2, 20_001, dtype=torch.float64) * (math.asin(R_EARTH / radius) + 0.01)
    r = Vec3(-radius * torch.cos(angle), radius * torch.sin(angle) * 0.6, radius * torch.sin(angle) * 0.8)
    found = illumination(r, SUN)
    # measured 0; where rounding of 1e-8 rad, near the axis, decides, 1e-9 of the Sun's disc is seen
    torch.testing.assert_close(found, directly(r, SUN), rtol=0, atol=1e-9)
    assert ((found > 0.0) & (found < 1.0)).any()
    assert (found == 1.0).any()
    assert torch.equal(in_umbra(r, SUN), found == 0.0)


def test_rows_alone_and_together():
    """No row depends on another one."""
    r = Vec3.of(7e6 * torch.nn.functional.normalize(torch.randn(64, 3, dtype=torch.float64), dim=-1))
    alone = torch.cat([illumination(Vec3(*(x[k : k + 1] for x in r)), SUN) for k in range(64)])
    assert torch.equal(illumination(r, SUN), alone)


@pytest.mark.parametrize(("visible", "least"), [(0.0, 1e-9), (0.5, 0.5), (1.0, 1.0 - 1e-9)])
def test_the_margin_of_sunlight_is_positive_where_so_much_of_the_disc_is_seen(visible, least):
    across = torch.linspace(R_EARTH - 2e5, R_EARTH + 2e5, 4001, dtype=torch.float64)
    r = Vec3(torch.full_like(across, -2.5e6), across * 0.6, across * 0.8)
    lit = illumination(r, SUN) >= least
    assert 100 < lit.sum() < 3900
    differ = lit != (sunlight_margin(r, SUN, visible) > 0.0)
    # half of the diameter is not quite half of the area, as the limb is bent
    assert differ.sum() <= (3 if visible == 0.5 else 1)
    day = Vec3(-r.x, r.y, r.z)
    assert (sunlight_margin(day, SUN, visible) > 0.0).all()


def test_clear_light_and_darkness_are_so_by_the_discs(monkeypatch):
    """Bit for bit, across the whole shadow; most of the night is decided without comparing discs."""
    failures = []
    radii = [R_EARTH + 1e5, 7e6, 4.2e7, 4e8, 1.3e9, 1.4e9, 2e9, 5e10]
    for radius, distance in itertools.product(radii, [0.98, 1.02]):
        angle = torch.linspace(-1.0, 1.0, 100_001, dtype=torch.float64) * min(1.5, 1.2 * math.asin(R_EARTH / radius) + 0.01)
        r = Vec3(-radius * torch.cos(angle), radius * torch.sin(angle) * 0.6, radius * torch.sin(angle) * 0.8)
        found, clearly = illumination(r, SUN * distance), torch.stack(eclipse._clearly(r, SUN * distance)).any(0)
        with monkeypatch.context() as patch:
            patch.setattr(eclipse, "_clearly", lambda r, r_sun: (torch.zeros_like(r.x, dtype=torch.bool),) * 2)
            differ = int((found != illumination(r, SUN * distance)).sum())
        decided = float(clearly.double().mean())
        if differ or (radius < 1e7 and decided <= 0.98):
            failures.append(f"radius={radius}, {distance} AU: {differ} differ, {decided} decided")
    assert not failures, "\n".join(failures)
