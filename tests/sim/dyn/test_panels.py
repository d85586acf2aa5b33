"""Several solar panels; fixed ones are compared with Basilisk's in ``tests/basilisk/test_craft_parity.py``."""

import itertools
import math

import pytest
import torch
from torch import Tensor

from bsk_torch import dyn, faults, rand
from bsk_torch.constants import AU
from bsk_torch.sim.component import Bus
from bsk_torch.sim.dyn.forces.drag import DRAG, fitted_drag
from bsk_torch.sim.dyn.power.panels import PANEL, best_direction, fitted_panels, panel_set, turned
from bsk_torch.sim.fsw.guidance import SUN_POINTING, fitted_sun_pointing
from bsk_torch.vec3 import Vec3
from tests.sim.buses import plane, vectors, write
from tests.sim.dyn.flights import CHARGE, SCAN, fly

WING = dict(axis=[0, 1, 0], rate=0.01)
PAIR = [dyn.Panel([0, 0, -1], 0.5, 0.3, **WING), dyn.Panel([0, 0, -2], 0.5, 0.3, **WING, stops=[-1.0, 2.0])]
GIVEN = {arg.name: arg.default for arg in (*PANEL.args, *DRAG.args)}


def test_best_directions_of_panels():
    """The power, ``max over subsets of s . sum g n``, is largest along the longest of these sums, for |s| = 1."""
    random = torch.Generator().manual_seed(0)
    for count in (1, 2, 3, 7):
        normals = torch.randn(count, 3, generator=random, dtype=torch.float64)
        gains = torch.rand(count, generator=random, dtype=torch.float64)
        normals = normals / normals.norm(dim=-1, keepdim=True)
        listed = tuple(dyn.Panel(n.tolist(), g.item(), 0.5) for n, g in zip(normals, gains, strict=True))
        subsets = torch.tensor(list(itertools.product((0.0, 1.0), repeat=count)), dtype=torch.float64)
        sums = (subsets * gains) @ normals
        longest = sums[int(sums.norm(dim=-1).argmax())]
        torch.testing.assert_close(torch.tensor(best_direction(listed)).double(), longest / longest.norm(), rtol=0, atol=1e-6)
    # A wing about y has full power from anywhere in its plane, up to its stops: a small fixed panel decides.
    fixed = dyn.Panel([1, 0, 0], 0.05, 0.3)
    free = dyn.Panel([0, 0, -1], 1.0, 0.3, **WING)
    assert best_direction((free,)) == (0.0, 0.0, -1.0)
    torch.testing.assert_close(torch.tensor(best_direction((free, fixed))), torch.tensor([1.0, 0.0, 0.0]), rtol=0, atol=1e-6)
    # stops 0.5 rad from the normal, toward x: to go phi beyond costs 1 - cos(phi) of the wing and gives 5 % of sin(phi + 0.5)
    stopped = dyn.Panel([0, 0, -1], 1.0, 0.3, **WING, stops=[-0.5, 0.5])
    beyond = math.atan2(0.05 * math.cos(0.5), 1.0 + 0.05 * math.sin(0.5))
    expected = [math.sin(0.5 + beyond), 0.0, -math.cos(0.5 + beyond)]
    torch.testing.assert_close(torch.tensor(best_direction((stopped, fixed))), torch.tensor(expected), rtol=0, atol=1e-6)
    stuck = dyn.Panel([0, 0, -1], 1.0, 0.3, axis=[0, 1, 0], rate=0.0, angle=-0.5)
    assert best_direction((stuck,)) == pytest.approx((math.sin(0.5), 0.0, -math.cos(0.5)), abs=1e-12)
    box = tuple(dyn.Panel(n, 1.0, 0.3) for k in range(3) for n in (torch.eye(3)[k].tolist(), (-torch.eye(3)[k]).tolist()))
    assert [abs(x) for x in best_direction(box)] == pytest.approx([math.sqrt(1.0 / 3.0)] * 3)
    assert best_direction((dyn.Panel([1, 0, 0], 0.0, 0.3),)) == (1.0, 0.0, 0.0)


def a_tick(listed: list[dyn.Panel], sun_B: Vec3, angles: list[Tensor], h_ns: int = 1_000_000_000) -> Bus:
    """The bus after an update of panels in sunlight at one astronomical unit; B is N."""
    n = len(sun_B.x)
    bus = write(Bus(h_ns), r_BN_N=Vec3.zeros_like(sun_B.x), sigma_BN=Vec3.zeros_like(sun_B.x), r_SN_N=sun_B.unit() * AU)
    part = panel_set(tuple(listed))
    args = {arg.name: torch.tensor(arg.default, dtype=torch.float64).unsqueeze(0) for arg in part.args if arg.name != "panels"}
    for field in part.params:
        value = part.prepare(args)[field.name].reshape(-1, field.width).expand(n, -1)
        planes = value.unbind(-1)
        rows = tuple(Vec3(*planes[k : k + 3]) for k in range(0, field.width, 3)) if field.vectors else planes
        write(bus, **{field.name: rows})
    write(bus, illumination=plane(1.0, n), panel_angle=tuple(angles))
    part.update(bus)
    return bus


def test_fixed_panels_add_up_and_a_tick_of_no_length_turns_none():
    sun = vectors()
    listed = [dyn.Panel([0, 0, -1], 0.5, 0.2), dyn.Panel([0, 3, -4], 0.1, 0.3), dyn.Panel([-1, 0, 0], 1.0, 0.1)]
    s = sun.unit()
    shares = (0.1 * -s.z).clamp(min=0) + (0.03 * (0.6 * s.y - 0.8 * s.z)).clamp(min=0) + (0.1 * -s.x).clamp(min=0)
    torch.testing.assert_close(a_tick(listed, sun, []).power, 1361.0 * shares, rtol=1e-12, atol=1e-12)
    bus = a_tick(PAIR, sun, [plane(0.3), plane(0.2)], h_ns=0)
    assert bool((bus.panel_angle[0] == 0.3).all() and (bus.panel_angle[1] == 0.2).all())


def test_a_panel_turns_to_the_sun_at_its_rate_and_loses_only_what_is_along_its_axis():
    sun = vectors()
    bus, ticks = a_tick([PAIR[0]], sun, [torch.zeros_like(sun.x)]), 1
    assert bus.panel_angle[0].abs().amax() == pytest.approx(0.01)
    while ticks < 320:  # half a turn takes 315 s
        before = bus.panel_angle[0]
        bus, ticks = a_tick([PAIR[0]], sun, [before]), ticks + 1
        assert bool(((bus.panel_angle[0] - before).abs() <= 0.01 + 1e-12).all())
    s = sun.unit()
    torch.testing.assert_close(bus.power, 1361.0 * 0.15 * torch.sqrt(1.0 - s.y * s.y), rtol=1e-9, atol=1e-9)
    # a right-handed turn about y takes -z to -x
    torch.testing.assert_close(bus.panel_angle[0], torch.atan2(-s.x, -s.z), rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    ("angle", "wanted", "stops", "expected"),
    [
        (0.0, 2.0, None, 0.1),
        (3.1, -3.1, None, -3.1),  # the short way, over pi
        (-3.1, 3.0, None, 2.0 * math.pi - 3.2),
        (0.95, 2.0, (-1.0, 1.0), 1.0),
        (1.0, -3.0, (-1.0, 1.0), 0.9),  # the nearest allowed angle is -1
        (1.0, 2.5, (-2.0, 1.0), 1.0),  # and here 1
        (0.0, -3.0, (-0.5, 4.0), 0.1),  # 2 pi - 3 lies between the stops
    ],
)
def test_turning(angle, wanted, stops, expected):
    pair = None if stops is None else (plane(stops[0]), plane(stops[1]))
    assert turned(plane(angle), plane(wanted), plane(0.1), pair)[0].item() == pytest.approx(expected, abs=1e-12)


def test_one_panel_in_a_list_flies_as_the_single_one():
    plain = fly({"panelArea": 0.7, "panelEfficiency": 0.25}, (SCAN, CHARGE))
    listed = {"panels": [dyn.Panel([0, 0, -3], 0.7, 0.25)]}
    one = fly(listed, (SCAN, CHARGE))
    for name in ("battery_charge", "sigma_BN"):
        torch.testing.assert_close(*(getattr(env.satellite.dynamics, name) for env in (plain, one)), rtol=1e-12, atol=1e-12)
    assert one.satellite.sat_args["nHat_B"].tolist() == [[0.0, 0.0, -1.0]] * 3


@pytest.mark.compiled
def test_drawn_panels_fly_alike_compiled():
    args = dict(
        panels=[*PAIR, dyn.Panel([1, 0, 0], 0.1, 0.3)],
        panelArea=rand.Uniform(0.1, 1.0, 3),
        panelAngles=rand.Choice([[0.1, 0.2, 0.0], [-0.3, 1.0, 0.0]]),
        panelRates=[0.01, 0.002, 0.0],
        faults=[faults.panel(0.5, 2, at=50.0), faults.stuck_panel(panel=0, at=100.0), faults.stuck_panel([0, 1, 0], 2, at=45.0)],
    )
    eager, compiled = (fly(args, (SCAN, CHARGE, SCAN), backend=backend) for backend in ("eager", "compiled"))
    for name in ("battery_charge", "panel_angles", "sigma_BN"):
        a, b = (getattr(env.satellite.dynamics, name) for env in (eager, compiled))
        torch.testing.assert_close(a, b, rtol=1e-9, atol=1e-9)
    assert eager.satellite.dynamics.panel_angles.shape == (3, 2)


def test_a_panel_that_is_stuck_stays_where_it_is():
    listed = {"panels": PAIR, "nHat_B": [0.0, 0.0, -1.0]}
    stuck = fly(listed | {"faults": [faults.stuck_panel(panel=0, at=15.0)]}, (SCAN, SCAN))
    moved = fly(listed, (SCAN, SCAN))
    angle = stuck.satellite.dynamics.panel_angles[:, 0]
    assert bool((angle.abs() <= 0.15 + 1e-6).all())
    assert bool((moved.satellite.dynamics.panel_angles[:, 0].abs() > 0.15).any())


def test_a_panel_that_fails_gives_a_share_of_its_power():
    listed = {"panels": [dyn.Panel([0, 0, -1], 0.5, 0.3), dyn.Panel([0, 0, -1], 1.0, 0.3)]}
    listed |= {"batteryStorageCapacity": 1e7, "storedCharge_Init": 5e6}
    whole, half, none = (
        fly(listed | {"faults": broken}, (CHARGE, CHARGE)).satellite.dynamics.battery_charge
        for broken in (None, [faults.panel(0.5, 1, at=0.0)], [faults.panel(0.0, 0, at=0.0), faults.panel(0.0, 1, at=0.0)])
    )
    torch.testing.assert_close(3.0 * (whole - half), whole - none, rtol=1e-9, atol=1e-6)
    assert bool((whole > none).any())


def test_the_structure_follows_from_the_arguments():
    assert fitted_panels(GIVEN) is PANEL
    assert fitted_panels(GIVEN | {"panels": PAIR}) is fitted_panels(GIVEN | {"panels": list(PAIR)})
    assert fitted_sun_pointing(GIVEN) is SUN_POINTING
    one, other = (fitted_sun_pointing(GIVEN | {"panels": PAIR}) for _ in range(2))
    assert one is other is not SUN_POINTING  # the same function, so that ticks are traced once


def test_drag_on_the_box_has_the_area_of_all_panels():
    part = fitted_drag(GIVEN | {"panels": PAIR})
    args = {"width": 1.0, "depth": 1.0, "height": 2.0, "dragCoeff": 2.2}
    values = {name: torch.tensor([value], dtype=torch.float64) for name, value in args.items()}
    found = [
        component.prepare(values | {"panelArea": torch.tensor(area, dtype=torch.float64)})["facet_areas"]
        for component, area in ((part, [[0.5, 0.25]]), (DRAG, [0.75]))
    ]
    torch.testing.assert_close(*found, rtol=0, atol=0)
