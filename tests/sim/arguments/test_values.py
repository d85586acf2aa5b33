import math

import numpy as np
import pytest
import torch

from bsk_torch import rand
from bsk_torch.astro.ephemeris import parse_utc
from bsk_torch.astro.orbit import Elements
from bsk_torch.presets.nadir_scan import ScanningSatellite
from bsk_torch.rand import Key
from bsk_torch.sim.arguments.values import Arguments, convert, merge, nearest
from bsk_torch.sim.component import Arg, asked
from bsk_torch.sim.dyn.hub import HUB
from bsk_torch.sim.dyn.power.balance import BATTERY
from bsk_torch.sim.dyn.power.panels import PANEL
from bsk_torch.sim.dyn.storage.partitions import transmitter
from bsk_torch.sim.dyn.storage.store import TRANSMITTER
from bsk_torch.sim.environment.world import EPHEMERIS, GROUND_STATIONS
from bsk_torch.sim.fsw.control import MRP_FEEDBACK
from bsk_torch.sim.fsw.desaturation import DESATURATION
from bsk_torch.sim.fsw.guidance import LOCATION_POINTING
from bsk_torch.sim.fsw.instrument import SCANNING_CONTROLLER
from tests.support.refusals import check_refusals, refusal

PARTS = (HUB, PANEL, BATTERY, TRANSMITTER, MRP_FEEDBACK, DESATURATION, SCANNING_CONTROLLER, LOCATION_POINTING)
WORLD = (EPHEMERIS, GROUND_STATIONS)
ORBIT = [7e6, 0.01, 1.0, 2.0, 3.0, 4.0]


def key(n: int = 3) -> Key:
    zeros = torch.zeros(n, dtype=torch.int64)
    return Key(zeros, torch.arange(n), zeros)


def draw(given: dict, parts=PARTS, n: int = 3, title: str = "sat_args") -> dict:
    values = Arguments(parts, given, title).draw(key(n))
    for part, own in asked(parts, values):
        if part.check is not None:
            part.check(own)
    return values


def test_messages():
    sender = Arguments((transmitter(2),), {"transmitterBaudRate": 1e6}, "sat_args", as_flown=True)
    rN, vN, choice = [7e6, 0, 0], [0, 7e3, 0], rand.Choice(["sun", "x"])
    check_refusals(
        refusal(lambda: draw({"batteryCapacity": 1.0}), KeyError, "sat_args['batteryCapacity']", "'batteryStorageCapacity'"),
        refusal(lambda: draw({"Mass": 1.0}), KeyError, "sat_args['Mass']", "'mass'"),
        refusal(lambda: draw({"qqqqqq": 1.0}), KeyError, "sat_args['qqqqqq']", "K, Ki, P, "),
        refusal(lambda: draw({"mass": [1.0, 2.0]}), ValueError, "sat_args", "mass", "one number", "kg", "[2]"),
        refusal(lambda: draw({"sigma_init": 0.1}), ValueError, "sat_args", "sigma_init", "3 numbers", "[]"),
        refusal(lambda: draw({"sigma_init": [0.1, 0.2]}), ValueError, "sigma_init", "3 numbers", "[2]"),
        refusal(lambda: draw({"oe": [7e6, 0.0]}), ValueError, "oe", "6 numbers", "m, -, rad", "[2]"),
        refusal(lambda: draw({"controlAxes_B": [1.0] * 8}), ValueError, "controlAxes_B", "9 numbers", "[8]"),
        refusal(lambda: draw({"mass": -1.0}), ValueError, "sat_args", "mass=-1 kg", "[1e-06, 1e+09]"),
        refusal(lambda: draw({"mass": math.nan}), ValueError, "sat_args", "mass=nan kg", "[1e-06, 1e+09]"),
        refusal(lambda: draw({"sigma_init": [0.0, math.nan, 0.0]}), ValueError, "sigma_init=nan"),
        refusal(lambda: draw({"transmitterBaudRate": 1.0}), ValueError, "transmitterBaudRate=1 bit/s", "[-9.0072e+15, 0]"),
        refusal(lambda: draw({"mass": "heavy"}), ValueError, "sat_args", "mass='heavy'", "kg"),
        refusal(lambda: draw({"mass": rand.Uniform(-5.0, -4.0)}), ValueError, "sat_args", "mass=-4."),
        refusal(lambda: draw({"mass": rand.Uniform(size=2)}), ValueError, "mass", "one number", "kg", "[2]"),
        refusal(lambda: draw({"mass": rand.per_env([1.0, 2.0])}), ValueError, "sat_args", "mass", "2 rows", "environment 2"),
        refusal(lambda: draw({"mass": None}), ValueError, "sat_args", "mass=None", "hub mass", "kg"),
        refusal(lambda: draw({"sigma_init": None}), ValueError, "sigma_init=None", "initial attitude, MRP of B"),
        refusal(lambda: draw({"desatAttitude": "moon"}), ValueError, "desatAttitude='moon'", "['sun', 'nadir', None]"),
        refusal(lambda: draw({"desatAttitude": choice}), ValueError, "desatAttitude='x'", "['sun', 'nadir', None]"),
        refusal(lambda: draw({"thrForceSign": -1}), ValueError, "thrForceSign=[-1.0]", "+1"),
        refusal(lambda: draw({"controlAxes_B": [0.0] * 9}), ValueError, "controlAxes_B=[[[0.0", "three independent axes"),
        refusal(lambda: draw({"storedCharge_Init": 3e5}), ValueError, "storedCharge_Init=300000", "StorageCapacity=288000"),
        refusal(lambda: draw({"nHat_B": [0.0, 0.0, 0.0]}), ValueError, "nHat_B=[0, 0, 0]"),
        refusal(lambda: draw({"inst_pHat_B": [0.0, 0.0, 0.0]}), ValueError, "inst_pHat_B=[0, 0, 0]"),
        refusal(lambda: draw({"oe": None}), KeyError, "'oe'", "'rN'", "'vN'", "oe=None", "none"),
        refusal(lambda: draw({"rN": rN}), KeyError, "'oe'", "'vN'", "oe=None", "['rN']"),
        refusal(lambda: draw({"vN": vN}), KeyError, "'oe'", "'rN'", "oe=None", "['vN']"),
        refusal(lambda: draw({"oe": ORBIT, "rN": rN}), KeyError, "'vN'", "oe=None", "['oe', 'rN']"),
        refusal(lambda: draw({"oe": ORBIT, "rN": rN, "vN": vN}), KeyError, "oe=None", "['oe', 'rN', 'vN']"),
        refusal(lambda: sender.draw(key()), ValueError, "transmitterBaudRate=1e+06 bit/s"),
    )


@pytest.mark.parametrize("given", [{}, {"oe": ORBIT}, {"oe": None, "rN": [7e6, 0, 0], "vN": [0, 7e3, 0]}])
def test_orbits_that_are_complete(given):
    state = merge(draw(given), (HUB,), "initial")
    assert state["r_BN_N"].shape[-1] == state["v_BN_N"].shape[-1] == 3


def test_position_replaces_the_default_elements():
    values = draw({"rN": [7e6, 0, 0], "vN": [0, 7e3, 0]})
    assert values["oe"] is None
    assert values["rN"].tolist() == [[7e6, 0.0, 0.0]]


def stations(given) -> dict:
    return draw({"groundStationsData": given}, WORLD, title="world_args")


def test_rejects_wrong_stations():
    name, beyond = "world_args: groundStationsData", {"lat": 91.0, "long": 1.0}
    check_refusals(
        refusal(lambda: stations([]), ValueError, name, "empty", "{'lat': 40.0, 'long': -105.2}"),
        refusal(lambda: stations([{"lat": 1.0, "lon": 2.0}]), ValueError, name, "'lon'", "'long'"),
        refusal(lambda: stations([{"lat": 1.0}]), ValueError, name, "'long'", "degrees", "+-360", "{'lat': 1.0}"),
        refusal(lambda: stations([{"long": 1.0}]), ValueError, name, "'lat'", "degrees", "+-90", "{'long': 1.0}"),
        refusal(lambda: stations([beyond]), ValueError, name, "'lat'", "degrees", "+-90", beyond),
    )


def test_stations_as_bsk_rl_takes_them():
    """Falsy entries of a station mean the default."""
    plain = {"lat": 0.0, "long": 0.0, "gsMinimumElevation": 0, "elev": None}
    own = {"lat": 0.0, "long": 90.0, "elev": 100.0, "groundLocationPlanetRadius": 1e6}
    own |= {"gsMinimumElevation": 0.5, "gsMaximumRange": 2e6}
    values = draw({"groundStationsData": [plain, own], "groundLocationPlanetRadius": 6378136.6}, WORLD)
    arrays = merge(values, WORLD, "prepare")
    assert arrays["station_sin_elevations"].tolist() == [pytest.approx([math.sin(math.radians(10.0)), math.sin(0.5)])]
    assert arrays["station_ranges"].tolist() == [[-1.0, 2e6]]
    expected = [6378136.6, 0.0, 0.0, 1e6 + 100.0, 0.0, 0.0]  # all x, all y, all z
    assert arrays["station_positions_P"][0].tolist() == pytest.approx(expected, abs=1e-6)


def test_epochs():
    names, epochs = ("world_args", "utc_init"), ("yesterday", "2021-13-01T00:00:00", "1950-01-01T00:00:00")
    check_refusals(
        refusal(lambda epoch=epoch: draw({"utc_init": epoch}, WORLD, title="world_args"), ValueError, *names, f"'{epoch}'")
        for epoch in epochs
    )


def test_constants_have_one_row_and_draws_one_for_each_environment():
    text = "2021-02-05T09:12:05"
    values = draw({"mass": 100, "K": rand.Uniform(1.0, 2.0), "P": lambda: 5.0, "desatAttitude": "nadir"})
    assert (values["mass"].tolist(), len(set(values["K"].tolist()))) == ([100.0], 3)
    assert (values["P"].tolist(), values["desatAttitude"].tolist()) == ([5.0, 5.0, 5.0], [1.0])
    assert draw({"utc_init": text}, WORLD)["utc_init"].tolist() == [parse_utc(text)]
    assert all(v.dtype == torch.float64 for v in values.values() if isinstance(v, torch.Tensor))
    arguments = Arguments(PARTS, {"K": rand.Uniform(), "P": lambda: 1.0}, "sat_args")
    assert [name in arguments.random for name in ("K", "P", "Ki")] == [True, True, False]


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
    check_refusals(refusal(lambda: convert(argument, [0.0, 1.5], 2), ValueError, "x=1.5", "[-1, 1]"))


def test_nearest():
    assert nearest("Scn", ["Scan", "Charge"]) == "did you mean 'Scan'?"
    assert nearest("zzz", ["Scan", "Charge"]) == "valid names: Charge, Scan"
    assert nearest("mas", ["Mass", "mast", "masses", "other"]) == "did you mean 'Mass' or 'mast'?"
    assert nearest("pretraned", ["random", "greedy", "pretrained"]) == "did you mean 'pretrained'?"


def test_stations_are_the_same_for_all_environments():
    drawn, choice = Arguments(WORLD, {"gsMinimumElevation": rand.Uniform(0.1, 0.2)}, "world_args"), rand.Choice([[], []])
    check_refusals(
        refusal(lambda: drawn.draw(key()), ValueError, "gsMinimumElevation=Uniform", "same", "environments"),
        refusal(lambda: stations(choice), ValueError, f"world_args: groundStationsData={choice}", "same", "environments"),
    )


def several(*given: dict, columns: tuple[int, ...] | None = None, n: int = 3) -> dict:
    """What satellites with these arguments draw, rows environment-major."""
    return Arguments(PARTS, given, "sat_args", range(len(given)) if columns is None else columns).draw(key(n))


def test_satellites_with_the_same_arguments():
    """Each draws its own values, the first one those that it would draw alone; constants stay one row."""
    given = {"K": rand.Uniform(), "sigma_init": rand.Uniform(size=3), "mass": 100.0, "P": lambda: 5.0}
    values = Arguments(PARTS, given, "sat_args", (0, 1)).draw(key())
    assert (values["mass"].tolist(), values["P"].tolist()) == ([100.0], [5.0] * 6)
    for name in ("K", "sigma_init"):
        assert len(values[name].unique()) == values[name].numel()
        assert torch.equal(values[name][::2], draw({name: given[name]})[name])
    listed = several(given, given)
    assert all(torch.equal(listed[name], values[name]) for name in given)


def test_draws_of_a_satellite_depend_on_its_number_only():
    whole = several(*[{"K": rand.Uniform()}] * 6)["K"].view(3, 6)
    part = Arguments(PARTS, {"K": rand.Uniform()}, "sat_args", (4, 1)).draw(key())
    assert torch.equal(part["K"].view(3, 2), whole[:, [4, 1]])
    alone = several({"K": rand.Uniform()}, columns=(5,), n=1)
    assert torch.equal(alone["K"], whole[:1, 5])


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (100.0, 100.0),
        ([0.1, 0.2, 0.3], [0.1, 0.2, 0.3]),
        (np.array([0.1, 0.2, 0.3]), np.array([0.1, 0.2, 0.3])),
        (torch.tensor([0.1, 0.2, 0.3]), torch.tensor([0.1, 0.2, 0.3])),
    ],
    ids=["number", "list", "array", "tensor"],
)
def test_equal_constants_are_kept_once(one, other):
    name = "mass" if isinstance(one, float) else "sigma_init"
    assert len(several({name: one}, {name: other})[name]) == 1


def test_equal_distributions_draw_as_one():
    """Built for every satellite, or once: the draws are the same."""
    apart = several(*({"K": rand.Uniform(1.0, 2.0)} for _ in range(3)))
    assert torch.equal(apart["K"], several(*[{"K": rand.Uniform(1.0, 2.0)}] * 3)["K"])


def test_different_constants():
    values = several({"mass": 100.0, "nHat_B": [1.0, 0.0, 0.0]}, {"mass": 200}, {"desatAttitude": "nadir"})
    assert values["mass"].tolist() == [100.0, 200.0, 330.0] * 3
    assert values["nHat_B"].view(3, 3, 3)[2].tolist() == [[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 0.0, -1.0]]
    assert values["desatAttitude"].view(3, 3).tolist() == [[0.0, 0.0, 1.0]] * 3
    assert values["K"].tolist() == [7.0]


def test_different_distributions_callables_and_constants():
    draws = iter(range(100))
    given = {"K": rand.Uniform(1.0, 2.0)}, {"K": 7.0}, {"K": lambda: float(next(draws))}, {"K": rand.Uniform(3.0, 5.0)}
    k = several(*given)["K"].view(3, 4)
    assert torch.equal(k[:, 0], draw(given[0])["K"])
    assert k[:, 1:3].tolist() == [[7.0, 0.0], [7.0, 1.0], [7.0, 2.0]]
    assert torch.equal(k[:, 3], 3.0 + 2.0 * several(*[{"K": rand.Uniform()}] * 4)["K"].view(3, 4)[:, 3])
    arguments = Arguments(PARTS, [{}, {"K": rand.Uniform()}, {}], "sat_args", range(3))
    assert "K" in arguments.random
    assert "P" not in arguments.random
    assert arguments.given["K"] == 7.0


def test_constants_of_satellites_are_repeated_for_every_draw():
    arguments = Arguments(PARTS, [{"mass": 100.0}, {"mass": 200.0}], "sat_args", range(2))
    assert arguments.draw(key(1))["mass"].tolist() == [100.0, 200.0]
    assert arguments.draw(key(3))["mass"].tolist() == [100.0, 200.0] * 3


def test_none_for_some_satellites():
    values = several({"imageRateErrorRequirement": None}, {"imageRateErrorRequirement": 0.1, "transmitterPacketSize": None})
    assert values["imageRateErrorRequirement"].tolist() == [math.inf, 0.1] * 3
    assert values["transmitterPacketSize"] is None
    words = "sat_args: transmitterPacketSize must be given for all satellites of a type, or for none"
    with pytest.raises(ValueError, match=words):
        several({"transmitterPacketSize": None}, {"transmitterPacketSize": -8.0})
    check_refusals(refusal(lambda: several({"oe": ORBIT}, {"rN": [7e6, 0, 0], "vN": [0, 7e3, 0]}), ValueError, "sat_args"))


def test_what_is_known_is_not_drawn_again():
    def never():
        raise AssertionError("asked again")

    known = {"utc_init": torch.tensor([1.0, 2.0, 3.0])}
    values = Arguments(WORLD, {"utc_init": never}, "world_args").draw(key(), known)
    assert values["utc_init"] is known["utc_init"]


THREE = Arguments(PARTS, {}, "sat_args", (0, 1, 2))


def test_override_some_satellites():
    """Satellites 2 and 0 of two environments get other masses, whether the old ones are one row or one for each."""
    given = torch.tensor([[20.0, 10.0], [40.0, 30.0]])
    for old in (torch.tensor([5.0]), torch.full((6,), 5.0)):
        old = old.double()
        before = old.clone()
        new = THREE.override("mass", old, torch.tensor([2, 0]), given)
        assert new.tolist() == [10.0, 5.0, 20.0, 30.0, 5.0, 40.0]
        assert torch.equal(old, before)


def test_override_all_satellites():
    orbits = torch.tensor(ORBIT, dtype=torch.float64) + torch.arange(6).view(2, 3, 1)
    new = THREE.override("oe", None, torch.tensor([1, 0, 2]), orbits)
    assert torch.equal(new, orbits[:, [1, 0, 2]].flatten(0, 1))


def test_rejects_wrong_arguments_of_several_satellites():
    def override(name: str, given: list):
        return THREE.override(name, None, torch.tensor([0]), torch.tensor(given, dtype=torch.float64))

    unequal = Arguments(WORLD, [{}, {"gsMinimumElevation": 0.5}], "world_args", range(2))
    check_refusals(
        refusal(lambda: several({}, {"Mass": 1.0}), KeyError, "sat_args['Mass']", "'mass'"),
        refusal(lambda: several({}, {"mass": -1.0}), ValueError, "sat_args", "mass=-1 kg"),
        refusal(lambda: several({}, {"mass": [1.0, 2.0]}), ValueError, "sat_args", "mass", "one number", "kg", "[2]"),
        refusal(lambda: several({}, {"mass": None}), ValueError, "sat_args", "mass=None", "hub mass", "kg"),
        refusal(lambda: unequal.draw(key()), ValueError, "world_args", "gsMinimumElevation", "same", "satellites"),
        refusal(lambda: override("Mass", [[1.0]]), KeyError, "sat_arg_randomizer", "'Mass'", "'mass'"),
        refusal(lambda: override("mass", [[-1.0]]), ValueError, "mass=-1 kg", "[1e-06, 1e+09]"),
        refusal(lambda: override("mass", [[[1.0, 2.0]]]), ValueError, "mass", "one number", "kg", "[2]"),
        refusal(lambda: override("oe", [[ORBIT]]), ValueError, "sat_arg_randomizer", "oe", "sat_args"),
    )


@pytest.mark.parametrize(
    "args",
    [
        {"disturbance_vector": [2.0, 0.0, 0.0]},
        {"transmitterBaudRate": 1e6},
        {"panelEfficiency": 1.5},
        {"rwElecToMechEfficiency": 1.5},
        {"hs_min": -1.0},
        {"maxWheelSpeed": 0.0},
        {"dragCoeff": -1.0},
    ],
    ids=str,
)
def test_bounds_are_wider_where_bsk_rl_is_repeated(args):
    (name,) = args
    parts = (*ScanningSatellite.dyn_type.all_components(), *ScanningSatellite.fsw_type.all_components())
    with pytest.raises(ValueError, match=rf"{name}=.* is not allowed"):
        Arguments(parts, args, "sat_args").draw(key())
    assert Arguments(parts, args, "sat_args", as_flown=True).draw(key())[name].tolist() == [args[name]]
