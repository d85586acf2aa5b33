import pytest
import torch

from bsk_torch.sim.component import Arg, Bus, Component, Field, Layout, Track, neighbours, vec
from bsk_torch.sim.environment.ephemeris import put_track
from bsk_torch.vec3 import Vec3
from tests.support.refusals import check_refusals, refusal

FIELDS = (
    vec("r_BN_N", exact=True),
    Field("charge", exact=True),
    Field("pulse", 4),
    Field("one_of_many", 1, many=True),
    Field("idle"),
)


def planes(size: int, n: int = 5) -> list[torch.Tensor]:
    return list(torch.randn(size, n, dtype=torch.float64))


def test_a_bus_knows_its_tick_and_what_has_been_written():
    bus = Bus(500_000_000, torch.float32, opaque_field=True)
    assert (bus.h_ns, bus.h, bus.dtype, bus.opaque_field) == (500_000_000, 0.5, torch.float32, True)
    bus = Bus(1)
    assert not bus.has("power")
    check_refusals(refusal(lambda: bus.power, AttributeError, "'power'"))
    bus.power = 3.0
    assert bus.has("power")


def test_layouts_write_fields_and_packs_have_views():
    layout, bus = Layout(FIELDS), Bus(1)
    pack = planes(layout.size)
    layout.put(bus, pack)
    assert isinstance(bus.r_BN_N, Vec3)
    assert all(a is b for a, b in zip(bus.r_BN_N, pack[:3], strict=True))
    assert bus.charge is pack[3]
    assert isinstance(bus.pulse, tuple)
    assert len(bus.pulse) == 4
    assert isinstance(bus.one_of_many, tuple)
    assert bus.one_of_many == (pack[8],)
    assert all(a is b for a, b in zip(layout.gather(bus), pack, strict=True))
    layout = Layout(FIELDS[:3])
    values = {"r_BN_N": torch.randn(4, 3).double(), "charge": torch.randn(1).double(), "pulse": torch.randn(1, 4).double()}
    pack = layout.rows(values, 4)
    assert torch.equal(layout.view(pack, "r_BN_N"), values["r_BN_N"].mT)
    assert torch.equal(layout.view(pack, "charge"), values["charge"].expand(4))
    assert torch.equal(layout.view(pack, "pulse"), values["pulse"].mT.expand(4, 4))
    layout.view(pack, "charge")[2] = 7.0
    assert (pack[3, 2], Layout(()).rows({}, 3).shape) == (7.0, (0, 3))


def test_fields_of_layouts_are_exact_by_planes_and_joined_by_names():
    assert Layout(FIELDS).exact == [True] * 4 + [False] * 6
    layout = Layout((*FIELDS, Field("charge", exact=True)))
    assert (layout.size, layout.slices["idle"]) == (10, slice(9, 10))


PAIR = Track("pair", 10.0, (Field("x"), vec("y")))
QUARTET = Track("quartet", 10.0, (Field("x"),), count=4, before=1)


def numbered(track: Track, records: int, rows: int = 3) -> torch.Tensor:
    """A table [rows, records, width] whose numbers tell where they stand."""
    index = torch.arange(rows * records * track.width, dtype=torch.float64)
    return index.view(rows, records, track.width)


def test_tracks_have_a_width_and_are_put_on_the_bus():
    assert (PAIR.width, QUARTET.width) == (4, 1)
    bus, pack, tau = Bus(1), planes(PAIR.count * PAIR.width), planes(1)[0]
    put_track(bus, PAIR, pack, tau)
    assert bus.pair_tau is tau
    assert bus.pair[0].x is pack[0]
    assert bus.pair[1].x is pack[4]
    assert all(a is b for record, k in zip(bus.pair, (1, 5), strict=True) for a, b in zip(record.y, pack[k : k + 3], strict=True))


@pytest.mark.parametrize(
    ("elapsed", "first", "tau"),
    [
        (0.0, 0, 0.0),
        (9.999, 0, 9.999),
        (10.0, 1, 0.0),
        (25.0, 2, 5.0),
        (49.0, 4, 9.0),
        (50.0, 4, 10.0),
        (57.0, 4, 17.0),
        (-3.0, 0, -3.0),
    ],
)
def test_the_two_records_around_a_time(elapsed, first, tau):
    """Beyond the ends of the table the outermost pair is continued."""
    table, rows = numbered(PAIR, 6), torch.tensor([2])
    found, since = neighbours(PAIR, table, rows, torch.tensor([elapsed], dtype=torch.float64))
    assert torch.equal(found[0], table[2, first : first + 2])
    assert since.item() == pytest.approx(tau, abs=1e-12)


@pytest.mark.parametrize(
    ("elapsed", "first", "tau"),
    [(0.0, 0, -10.0), (15.0, 0, 5.0), (20.0, 1, 0.0), (39.0, 2, 9.0), (45.0, 2, 15.0), (50.0, 2, 20.0)],
)
def test_more_records_are_centred_but_at_the_ends(elapsed, first, tau):
    """tau counts from the second of the four records, wherever they lie."""
    found, since = neighbours(QUARTET, numbered(QUARTET, 6), torch.tensor([0]), torch.tensor([elapsed], dtype=torch.float64))
    assert found[0, :, 0].tolist() == [first + k for k in range(4)]
    assert since.item() == pytest.approx(tau, abs=1e-12)


def test_every_row_has_its_own_time():
    table, rows = numbered(PAIR, 6), torch.tensor([1, 0, 1, 2])
    elapsed = torch.tensor([0.0, 12.0, 30.0, 44.0], dtype=torch.float64)
    found, tau = neighbours(PAIR, table, rows, elapsed)
    assert found.shape == (4, 2, 4)
    for k in range(4):
        alone, since = neighbours(PAIR, table, rows[k : k + 1], elapsed[k : k + 1])
        assert torch.equal(found[k], alone[0])
        assert tau[k] == since[0]


def _one(bus) -> None:
    """Write one."""
    bus.steps = ("one",)


def _two(bus) -> None:
    bus.steps = (*bus.steps, "two")


def _refuse(args) -> None:
    raise ValueError("refused")


def test_additions_run_after_the_component_and_replace_entries_of_the_same_name():
    part = Component(
        "battery",
        _one,
        args=(Arg("a", 1.0, "-", "first"), Arg("b", 2.0, "-", "second")),
        params=(Field("p"),),
        prepare=lambda args: {"p": args["a"]},
        flags=("on",),
        resets=(("x", 1.0),),
    )
    more = part.extended(
        update=_two,
        args=(Arg("b", 3.0, "-", "other"), Arg("c", 4.0, "-", "third")),
        params=(Field("q"),),
        prepare=lambda args: {"q": args["c"], "p": args["b"]},
        check=_refuse,
        flags=("on", "off"),
        resets=(("y", 2.0),),
    )
    bus = Bus(1)
    more.update(bus)
    assert (bus.steps, more.update.__doc__) == (("one", "two"), "Write one.")
    assert [(arg.name, arg.default) for arg in more.args] == [("a", 1.0), ("b", 3.0), ("c", 4.0)]
    assert more.prepare({"a": 1, "b": 2, "c": 3}) == {"p": 2, "q": 3}
    assert (more.slot, more.flags, more.resets) == ("battery", ("on", "off"), (("x", 1.0), ("y", 2.0)))
    check_refusals(refusal(lambda: more.check({}), ValueError, "refused"))
    assert part.extended().update is _one


def test_additions_reach_the_structure_that_arguments_need():
    part = Component("battery", fit=lambda given: Component("battery", _one, params=(Field("p", given["count"]),)))
    fitted = part.extended(update=_two, flags=("on",)).fit({"count": 5})
    assert [field.width for field in fitted.params] == [5]
    assert fitted.flags == ("on",)
    bus = Bus(1)
    fitted.update(bus)
    assert bus.steps == ("one", "two")
