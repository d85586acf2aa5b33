"""Which satellites one simulation can hold."""

import numpy as np
import pytest

from bsk_torch import act, dyn, obs, rand, sats
from bsk_torch.env.assembly.types import check_names, check_world, grouped, same_type
from bsk_torch.sim.assembly.composition import world_components
from tests.support.refusals import check_refusals, refusal

ORBIT = [7e6, 0.0, 1.0, 0.0, 0.0, 0.0]
PLACE = {"rN": [7e6, 0.0, 0.0], "vN": [0.0, 7.5e3, 0.0]}


class Basic(sats.Satellite):
    observation_spec = (obs.Time(),)
    action_spec = (act.Charge(),)


class Other(Basic):
    """The same, but another class."""


class Stores(dyn.GroundStationDynModel, dyn.ContinuousImagingDynModel):
    """Stations, and a store that may kill."""


class Ground(sats.AccessSatellite):
    observation_spec = (obs.Time(),)
    action_spec = (act.Charge(),)
    dyn_type = Stores


def basic(name="A", sat_args=None, **options):
    return Basic(name, sat_args, **options)


def test_names():
    assert check_names([basic("A"), Other("B"), basic("A_1")]) == ["A", "B", "A_1"]


def renamed(name):
    satellite = basic("A")
    satellite.name = name
    return satellite


def test_rejects_wrong_names():
    known = [["utc_init"], ["gsMinimumElevation"]]
    check_refusals(
        refusal(lambda: check_names([]), ValueError, "satellites", "empty"),
        refusal(lambda: check_names([basic("A")] * 4097), ValueError, "satellites", 4097, 4096),
        refusal(lambda: check_names([basic("A"), "B"]), TypeError, "satellites", "'B'", "parentheses"),
        refusal(lambda: check_names([Basic]), TypeError, "satellites", Basic, "parentheses"),
        refusal(lambda: check_names([basic("A"), basic("B"), Other("A")]), ValueError, "satellites", ["A"]),
        refusal(lambda: check_names([basic("A"), renamed("B ")]), ValueError, "name", "'B '", "space"),
        refusal(lambda: check_names([renamed("x" * 101)]), ValueError, "name", "101 characters", "100"),
        refusal(lambda: check_world({"utc_init": 1, "utcInit": 2}, known), KeyError, "world_args", "'utcInit'", "'utc_init'"),
        refusal(lambda: check_world({"zzz": 1}, known), KeyError, "world_args", "'zzz'", "gsMinimumElevation, utc_init"),
    )


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ({}, {}),
        ({"mass": 100.0}, {"mass": 200.0}),
        ({"mass": 100.0}, {"K": rand.Uniform(1.0, 2.0)}),
        ({"oe": ORBIT}, {}),
        ({"oe": ORBIT}, {"oe": rand.random_orbit()}),
        (PLACE | {"oe": None}, PLACE),
        (PLACE, {"rN": [8e6, 0.0, 0.0], "vN": [0.0, 7e3, 0.0]}),
        ({"desatAttitude": "sun"}, {"desatAttitude": "nadir"}),
        ({"sigma_init": np.zeros(3)}, {"sigma_init": [0.0, 0.0, 0.1]}),
        ({"storageUnitValidCheck": False}, {}),
        ({"storageUnitValidCheck": True}, {"storageUnitValidCheck": True}),
    ],
    ids=str,
)
def test_values_may_differ(one, other):
    satellites = [Ground(name, args) for name, args in zip("AB", (one, other), strict=True)]
    assert same_type(*satellites)
    assert same_type(*reversed(satellites))


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (Ground("A"), Basic("B")),
        (Basic("A"), Other("B")),
        (Basic("A"), Basic("B", obs_type=dict)),
        (Basic("A"), Basic("B", variable_interval=False)),
        (Ground("A", {"storageUnitValidCheck": True}), Ground("B")),
        (Ground("A", PLACE), Ground("B", {"oe": ORBIT})),
        (Ground("A"), Ground("B", PLACE)),
        (Ground("A"), Ground("B", initial_generation_duration=100.0)),
        (Ground("A"), Ground("B", {"transmitterPacketSize": -8.0})),
    ],
    ids=["class", "subclass", "obs_type", "interval", "constant", "orbit", "default orbit", "generation", "packet"],
)
def test_different_types_are_told_apart(one, other):
    assert not same_type(one, other)
    assert not same_type(other, one)


def alone(name):
    """The group of a satellite where all are in the same one."""


def test_grouped():
    """In the order in which types appear; numbers within a type ascend."""
    satellites = [Basic("A"), Ground("B"), Basic("C", {"mass": 3.0}), Other("D"), Ground("E"), Basic("F", obs_type=dict)]
    assert (grouped(satellites, alone), grouped(satellites[:1], alone)) == ([[0, 2], [1, 4], [3], [5]], [[0]])
    five = [Basic(f"A{k}") for k in range(5)]
    assert grouped(five, alone) == [[0, 1, 2, 3, 4]]
    assert grouped(five, lambda name: name in ("A1", "A4")) == [[0, 2, 3], [1, 4]]


def test_satellites_with_options_of_their_own():
    """What a user's class stores counts, as models and observations may depend on it."""
    one, other = basic("A"), basic("B")
    one.camera = other.camera = {"pixels": 1024}
    assert same_type(one, other)
    other.camera = {"pixels": 512}
    assert not same_type(one, other)
    del other.camera
    assert not same_type(one, other)


def test_worlds_have_the_arguments_of_their_satellites():
    worlds = (world_components(satellite.dyn_type) for satellite in (Basic("A"), Ground("B")))
    basic_world, ground_world = ({arg.name for part in world for arg in part.args} for world in worlds)
    assert basic_world < ground_world
    assert {"utc_init"} <= basic_world
    assert "groundStationsData" in ground_world - basic_world
    check_world({"utc_init": 1, "gsMinimumElevation": 2}, [["utc_init"], ["gsMinimumElevation", "utc_init"]])
    check_world({}, [])
