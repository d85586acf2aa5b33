from __future__ import annotations

import math
import re

import numpy as np
import pytest
import torch

from bsk_torch import rand
from bsk_torch.astro.ephemeris import parse_utc
from bsk_torch.astro.orbit import Elements
from bsk_torch.rand import Key
from bsk_torch.sim.component import Arg
from bsk_torch.sim.dyn.hub import HUB
from bsk_torch.sim.dyn.power import BATTERY, PANEL
from bsk_torch.sim.dyn.storage import TRANSMITTER
from bsk_torch.sim.fsw.control import MRP_FEEDBACK
from bsk_torch.sim.fsw.desaturation import DESATURATION
from bsk_torch.sim.fsw.guidance import LOCATION_POINTING
from bsk_torch.sim.fsw.instrument import SCANNING_CONTROLLER
from bsk_torch.sim.params import Arguments, convert, merge, nearest
from bsk_torch.sim.world import EPHEMERIS, GROUND_STATIONS

PARTS = (HUB, PANEL, BATTERY, TRANSMITTER, MRP_FEEDBACK, DESATURATION, SCANNING_CONTROLLER, LOCATION_POINTING)
WORLD = (EPHEMERIS, GROUND_STATIONS)
ORBIT = [7e6, 0.01, 1.0, 2.0, 3.0, 4.0]


def key(n: int = 3) -> Key:
    zeros = torch.zeros(n, dtype=torch.int64)
    return Key(zeros, torch.arange(n), zeros)


def draw(given: dict, parts=PARTS, n: int = 3, title: str = "sat_args") -> dict:
    values = Arguments(parts, given, title).draw(key(n))
    for part in parts:
        part.check(values)
    return values


@pytest.mark.parametrize(
    ("given", "kind", "message"),
    [
        ({"batteryCapacity": 1.0}, KeyError, "sat_args['batteryCapacity'] is unknown; did you mean 'batteryStorageCapacity'"),
        ({"Mass": 1.0}, KeyError, "sat_args['Mass'] is unknown; did you mean 'mass'?"),
        ({"qqqqqq": 1.0}, KeyError, "sat_args['qqqqqq'] is unknown; valid names: K, Ki, P, "),
        ({"mass": [1.0, 2.0]}, ValueError, "sat_args: mass needs one number for each environment (kg); got shape [2]"),
        ({"sigma_init": 0.1}, ValueError, "sat_args: sigma_init needs 3 numbers for each environment (-); got shape []"),
        ({"sigma_init": [0.1, 0.2]}, ValueError, "sigma_init needs 3 numbers for each environment (-); got shape [2]"),
        ({"oe": [7e6, 0.0]}, ValueError, "oe needs 6 numbers for each environment (m, -, rad); got shape [2]"),
        ({"controlAxes_B": [1.0] * 8}, ValueError, "controlAxes_B needs 9 numbers for each environment (-); got shape [8]"),
        ({"mass": -1.0}, ValueError, "sat_args: mass=-1 kg is not allowed; it must lie in [1e-06, inf]"),
        ({"mass": math.nan}, ValueError, "sat_args: mass=nan kg is not allowed; it must lie in [1e-06, inf]"),
        ({"sigma_init": [0.0, math.nan, 0.0]}, ValueError, "sigma_init=nan - is not allowed"),
        ({"transmitterBaudRate": 1.0}, ValueError, "transmitterBaudRate=1 bit/s is not allowed; it must lie in [-inf, 0]"),
        ({"mass": "heavy"}, ValueError, "sat_args: mass=['heavy'] is not made of numbers (kg): "),
        ({"mass": rand.Uniform(-5.0, -4.0)}, ValueError, "sat_args: mass=-4."),
        ({"mass": rand.Uniform(size=2)}, ValueError, "mass needs one number for each environment (kg); got shape [2]"),
        ({"mass": rand.per_env([1.0, 2.0])}, ValueError, "sat_args: per_env has 2 rows, but environment 2 needs one"),
        ({"mass": None}, ValueError, "sat_args: mass=None is not allowed; give hub mass in kg"),
        ({"sigma_init": None}, ValueError, "sigma_init=None is not allowed; give initial attitude, MRP of B relative to N in -"),
        ({"desatAttitude": "moon"}, ValueError, "sat_args: desatAttitude='moon' must be one of ['sun', 'nadir', None]"),
        ({"desatAttitude": rand.Choice(["sun", "x"])}, ValueError, "desatAttitude='x' must be one of ['sun', 'nadir', None]"),
        ({"thrForceSign": -1}, ValueError, "thrForceSign=[-1.0]: only +1 (thrusters that push) is supported"),
        ({"controlAxes_B": [0.0] * 9}, ValueError, "must be three independent axes (nine numbers)"),
        ({"storedCharge_Init": 3e5}, ValueError, "storedCharge_Init=300000 W s is above batteryStorageCapacity=288000 W s"),
    ],
    ids=lambda x: str(x)[:40] if isinstance(x, dict) else None,
)
def test_messages(given, kind, message):
    with pytest.raises(kind, match=re.escape(message)):
        draw(given)


@pytest.mark.parametrize(
    ("given", "listed"),
    [
        ({"oe": None}, "none"),
        ({"rN": [7e6, 0, 0]}, "['rN']"),
        ({"vN": [0, 7e3, 0]}, "['vN']"),
        ({"oe": ORBIT, "rN": [7e6, 0, 0]}, "['oe', 'rN']"),
        ({"oe": ORBIT, "rN": [7e6, 0, 0], "vN": [0, 7e3, 0]}, "['oe', 'rN', 'vN']"),
    ],
)
def test_orbits_that_say_too_little_or_too_much(given, listed):
    message = f"give the orbit as 'oe', or as both 'rN' and 'vN' with oe=None; given are {listed}"
    with pytest.raises(KeyError, match=re.escape(message)):
        draw(given)


@pytest.mark.parametrize("given", [{}, {"oe": ORBIT}, {"oe": None, "rN": [7e6, 0, 0], "vN": [0, 7e3, 0]}])
def test_orbits_that_are_complete(given):
    state = merge(draw(given), (HUB,), "initial")
    assert state["r"].shape[-1] == state["v"].shape[-1] == 3


def test_position_replaces_the_default_elements():
    values = draw({"rN": [7e6, 0, 0], "vN": [0, 7e3, 0]})
    assert values["oe"] is None
    assert values["rN"].tolist() == [[7e6, 0.0, 0.0]]


@pytest.mark.parametrize(
    ("stations", "message"),
    [
        ([], "groundStationsData is empty; it needs at least one station, such as {'lat': 40.0, 'long': -105.2}"),
        ([{"lat": 1.0, "lon": 2.0}], "groundStationsData has an unknown key 'lon'; did you mean 'long'?"),
        ([{"lat": 1.0}], "groundStationsData needs 'long' in degrees within +-360; got {'lat': 1.0}"),
        ([{"long": 1.0}], "groundStationsData needs 'lat' in degrees within +-90"),
        ([{"lat": 91.0, "long": 1.0}], "groundStationsData needs 'lat' in degrees within +-90; got {'lat': 91.0, 'long': 1.0}"),
        (
            rand.Choice([[], []]),
            "groundStationsData=Choice(options=([], [])) must be the same for all environments; give a constant",
        ),
    ],
)
def test_stations(stations, message):
    with pytest.raises(ValueError, match=re.escape(f"world_args: {message}")):
        draw({"groundStationsData": stations}, WORLD, title="world_args")


def test_stations_as_bsk_rl_takes_them():
    """Falsy entries of a station mean the default."""
    plain = {"lat": 0.0, "long": 0.0, "gsMinimumElevation": 0, "elev": None}
    own = {"lat": 0.0, "long": 90.0, "elev": 100.0, "groundLocationPlanetRadius": 1e6}
    own |= {"gsMinimumElevation": 0.5, "gsMaximumRange": 2e6}
    values = draw({"groundStationsData": [plain, own]}, WORLD)
    arrays = merge(values, WORLD, "prepare")
    assert arrays["station_sin_elevations"].tolist() == [pytest.approx([math.sin(math.radians(10.0)), math.sin(0.5)])]
    assert arrays["station_ranges"].tolist() == [[-1.0, 2e6]]
    expected = [6378136.6, 0.0, 0.0, 1e6 + 100.0, 0.0, 0.0]  # all x, all y, all z
    assert arrays["station_positions"][0].tolist() == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("epoch", ["yesterday", "2021-13-01T00:00:00", "1950-01-01T00:00:00"])
def test_epochs(epoch):
    with pytest.raises(ValueError, match=rf"world_args: epoch '{epoch}'"):
        draw({"utc_init": epoch}, WORLD, title="world_args")


def test_constants_have_one_row_and_draws_one_for_each_environment():
    text = "2021-02-05T09:12:05"
    values = draw({"mass": 100, "K": rand.Uniform(1.0, 2.0), "P": lambda: 5.0, "desatAttitude": "nadir"})
    assert values["mass"].tolist() == [100.0]
    assert len(set(values["K"].tolist())) == 3
    assert values["P"].tolist() == [5.0, 5.0, 5.0]
    assert values["desatAttitude"].tolist() == [1.0]
    assert draw({"utc_init": text}, WORLD)["utc_init"].tolist() == [parse_utc(text)]
    assert all(v.dtype == torch.float64 for v in values.values() if isinstance(v, torch.Tensor))
    arguments = Arguments(PARTS, {"K": rand.Uniform(), "P": lambda: 1.0}, "sat_args")
    assert [arguments.is_random(name) for name in ("K", "P", "Ki")] == [True, True, False]


def test_draws_depend_on_the_name():
    values = draw({"K": rand.Uniform(), "P": rand.Uniform()})
    assert (values["K"] != values["P"]).all()
    again = Arguments(PARTS, {"K": rand.Uniform()}, "sat_args").draw(key())
    assert torch.equal(values["K"], again["K"])


@pytest.mark.parametrize(
    "value",
    [
        (0.1, 0.2, 0.3),
        [0.1, 0.2, 0.3],
        np.array([0.1, 0.2, 0.3]),
        np.array([[0.1], [0.2], [0.3]]),
        torch.tensor([0.1, 0.2, 0.3], dtype=torch.float64),
        [torch.tensor(x, dtype=torch.float64) for x in (0.1, 0.2, 0.3)],
        rand.per_env(np.array([[0.1, 0.2, 0.3]] * 3)),
        rand.per_env(torch.tensor([[0.1, 0.2, 0.3]] * 3, dtype=torch.float64)),
        lambda: np.array([0.1, 0.2, 0.3]),
    ],
    ids=["tuple", "list", "array", "column", "tensor", "list of tensors", "per_env array", "per_env tensor", "callable"],
)
def test_ways_to_write_a_vector(value):
    rows = draw({"sigma_init": value})["sigma_init"]
    assert rows.shape in ((1, 3), (3, 3))
    assert (rows == torch.tensor([0.1, 0.2, 0.3], dtype=torch.float64)).all()


def test_ways_to_write_an_orbit_and_a_matrix():
    elements = Elements(*ORBIT)
    for value in (ORBIT, elements, torch.tensor(ORBIT, dtype=torch.float64), lambda: elements, rand.per_env([ORBIT] * 3)):
        assert (draw({"oe": value})["oe"] == torch.tensor(ORBIT, dtype=torch.float64)).all()
    for value in (np.eye(3), np.eye(3).ravel(), np.eye(3).tolist()):
        assert draw({"controlAxes_B": value})["controlAxes_B"].reshape(3, 3).tolist() == np.eye(3).tolist()


def test_none_where_it_means_something():
    values = draw({"imageRateErrorRequirement": None, "transmitterPacketSize": None, "desatAttitude": None})
    assert values["imageRateErrorRequirement"].tolist() == [math.inf]
    assert values["transmitterPacketSize"] is None
    assert values["desatAttitude"].tolist() == [2.0]


def test_bounds_are_inclusive():
    argument = Arg("x", 0.0, "m", "a length", low=-1.0, high=1.0)
    assert convert(argument, [-1.0, 1.0], 2).tolist() == [-1.0, 1.0]
    with pytest.raises(ValueError, match=r"x=1.5 m is not allowed; it must lie in \[-1, 1\]"):
        convert(argument, [0.0, 1.5], 2)


@pytest.mark.parametrize("name", ["nHat_B", "inst_pHat_B"])
def test_an_axis_of_length_zero_is_refused(name):
    """It has no direction: power or attitude would be NaN from the first tick on."""
    with pytest.raises(ValueError, match=name):
        draw({name: [0.0, 0.0, 0.0]})


def test_nearest():
    assert nearest("Scn", ["Scan", "Charge"]) == "did you mean 'Scan'?"
    assert nearest("zzz", ["Scan", "Charge"]) == "valid names: Charge, Scan"
    assert nearest("mass", ["Mass", "mas", "masses", "massif", "other"]).count(" or ") == 2


def test_stations_are_the_same_for_all_environments():
    with pytest.raises(ValueError, match=r"gsMinimumElevation=Uniform.* must be the same"):
        Arguments(WORLD, {"gsMinimumElevation": rand.Uniform(0.1, 0.2)}, "world_args").draw(key())
