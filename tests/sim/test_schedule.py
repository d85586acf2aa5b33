import re

import pytest
import torch
from typer.testing import CliRunner

from bsk_torch import SatelliteTasking
from bsk_torch.cli import app
from bsk_torch.cli.show import described, tick_lines
from bsk_torch.presets import make
from bsk_torch.presets.nadir_scan import ScanningSatellite
from bsk_torch.rand import first_key
from bsk_torch.sim import dyn, fsw
from bsk_torch.sim.component import Component, Field, collect
from bsk_torch.sim.schedule import SCHEDULE, Slot
from tests.sim.simulators import make_simulator
from tests.support.refusals import check_refusals, refusal

NADIR_SCAN = (
    *("earth_pole", "ground_stations", "location_target", "ephemeris", "eclipse", "orbit", "hub", "wheels", "thrusters"),
    *("panel", "wheel_power", "base_power", "thruster_draw", "instrument_draw", "transmitter_draw"),
    *("instrument", "battery", "transmitter", "storage"),
    *("navigation", "sun_pointing", "nadir_pointing", "desaturation", "location_pointing", "instrument_controller", "control"),
)

AEOS = (
    *("earth_pole", "location_target", "ephemeris", "eclipse", "orbit", "hub", "wheels", "thrusters"),
    *("panel", "wheel_power", "base_power", "thruster_draw", "instrument_draw", "transmitter_draw"),
    *("instrument", "battery", "transmitter", "storage", "image_event"),
    *("navigation", "sun_pointing", "nadir_pointing", "desaturation", "location_pointing", "instrument_controller", "control"),
)


BASES, FSW = (ScanningSatellite.get_dyn_type(),), ScanningSatellite.get_fsw_type()


def component(slot: str, **options: str) -> Component:
    return Component(slot, lambda bus: None, **options)


def test_every_slot_has_a_name_of_its_own_and_a_group():
    names = [slot.name for slot in SCHEDULE]
    assert len(set(names)) == len(names)
    assert all(all(slot) for slot in SCHEDULE)
    assert list(dict.fromkeys(slot.group for slot in SCHEDULE)) == [
        "faults",
        "environment",
        "orbit",
        "dynamics",
        "flight software",
    ]


@pytest.mark.parametrize(("name", "slots"), [("NadirScan-v1", NADIR_SCAN), ("AEOS-v1", AEOS)])
@pytest.mark.parametrize("backend", ["eager", pytest.param("compiled", marks=pytest.mark.compiled)])
def test_the_order_of_presets(name, slots, backend):
    """Basilisk's order of modules; the same under both back ends."""
    assert make(name, num_envs=1, backend=backend).fleet.simulators[0].tick.schedule == slots


def test_where_drag_acts_if_the_orbit_is_integrated():
    schedule = make("NadirScan-v1", num_envs=1, backend="eager", orbit="integrated").fleet.simulators[0].tick.schedule
    assert schedule.index("ephemeris") < schedule.index("atmosphere") < schedule.index("eclipse") < schedule.index("hub")
    assert schedule[schedule.index("hub") + 1] == "drag"
    assert "orbit" not in schedule


def test_own_components_run_after_and_before_slots():
    """Where several say the same, in the order in which they are given; one may also leave its slot's place."""
    mine = [component(name, **where) for name, where in {
        "c": {"after": "battery"}, "b": {"before": "battery"}, "a": {"before": "battery"}, "d": {"after": "battery"},
    }.items()]  # fmt: skip
    moved = component("eclipse", after="control")
    scheduled = [component(name) for name in ("transmitter", "battery", "instrument")]
    names = [c.slot for c in SCHEDULE.ordered([moved, *mine, *scheduled])]
    assert names == ["instrument", "b", "a", "battery", "c", "d", "transmitter", "eclipse"]


def test_replacing_a_slot_keeps_its_place():
    class Replaced(dyn.BasicDynamicsModel):
        components = (component("battery"),)

    before, after = (collect(reversed(cls.__mro__)) for cls in (dyn.BasicDynamicsModel, Replaced))
    assert [c.slot for c in before] == [c.slot for c in after]
    assert next(c for c in after if c.slot == "battery") is Replaced.components[0]


def test_slots_are_moved_and_added():
    names = [slot.name for slot in SCHEDULE.moved("battery", before="panel")]
    assert sorted(names) == sorted(slot.name for slot in SCHEDULE)
    assert names.index("battery") == names.index("panel") - 1
    radiator = Slot("radiator", "heat", "none", "dynamics")
    after = SCHEDULE.with_slot(radiator, after="battery")
    assert after[after.numbers["battery"] + 1] is radiator
    check_refusals(
        refusal(lambda: SCHEDULE.moved("battery", before="panle"), ValueError, "before='panle'", "'panel'"),
        refusal(lambda: SCHEDULE.moved("battery"), ValueError, "'battery'", "after=None", "before=None"),
        refusal(lambda: SCHEDULE.with_slot(SCHEDULE[SCHEDULE.numbers["battery"]], after="panel"), ValueError, "'battery'"),
    )


class Radiating(dyn.BasicDynamicsModel):
    """Charges the battery before the sinks draw from it, and has its own slot."""

    schedule = SCHEDULE.moved("battery", before="wheel_power").with_slot(
        Slot("radiator", "heat that leaves the spacecraft", "none", "dynamics"), after="battery"
    )
    components = (component("radiator"), component("probe", before="radiator"))


class RadiatorFSWModel(fsw.BasicFSWModel):
    """Flight software that knows the slot of the dynamics model."""

    components = (component("watch", after="radiator"),)


def test_a_dynamics_model_has_another_order():
    satellite = type("Mine", (ScanningSatellite,), {"dyn_type": (Radiating, *BASES), "fsw_type": (RadiatorFSWModel, FSW)})
    env = SatelliteTasking(satellite("A"), backend="eager", time_limit=300.0)
    order = env.simulator.tick.schedule
    first = order.index("battery")
    assert order[first : first + 5] == ("battery", "probe", "radiator", "watch", "wheel_power")
    printed = tick_lines(env.simulator.tick, env.simulator.type.schedule)
    assert [line.split()[0] for line in printed if "heat that leaves the spacecraft (none)" in line] == ["radiator"]
    other = type("Other", (ScanningSatellite,), {"fsw_type": (RadiatorFSWModel, FSW)})
    with pytest.raises(ValueError, match="slot='watch' has after='radiator', which is not a slot of a tick"):
        SatelliteTasking(other("A"), backend="eager", time_limit=300.0)


def measure(bus) -> None:
    """Distance of the Sun."""
    bus.sun_range = bus.r_SN_N.norm()
    bus.sun_calls = bus.sun_calls + 1.0


def count(bus) -> None:
    """Ticks."""
    bus.calls = bus.calls + 1.0


def fields(*names: str) -> dict:
    zeros = {name: torch.zeros(1, dtype=torch.float64) for name in names}
    return dict(state=tuple(Field(name, exact=True) for name in names), initial=lambda args: zeros)


class Measuring(dyn.DynamicsModel):
    """A world component of the user's own, and one of the spacecraft that runs at time zero only if it says so."""

    components = (
        Component("counter", count, after="hub", **fields("calls")),
        Component(
            "starter", lambda bus: setattr(bus, "starts", bus.starts + 1.0), after="hub", at_start=True, **fields("starts")
        ),
    )
    world_components = (Component("sun_range", measure, after="ephemeris", **fields("sun_range", "sun_calls")),)


@pytest.mark.parametrize("backend", ["eager", pytest.param("compiled", marks=pytest.mark.compiled)])
def test_components_of_the_world_take_part_in_the_tick_at_time_zero(backend):
    options = dict(num_envs=2, dtype=torch.float64, sim_rate=1.0, horizon=600.0, backend=backend)
    simulator = make_simulator(Measuring, fsw.FSWModel, {}, {}, orbit="arc", segment=600.0, **options)
    simulator.reset(simulator.state.all_rows, simulator.type.arguments.draw(first_key(2)), torch.zeros(2, dtype=torch.float64))
    torch.testing.assert_close(simulator.read("sun_range"), simulator.world.r_SN_N.norm(dim=-1), rtol=1e-9, atol=0)
    names = "sun_calls", "starts", "calls"
    assert [simulator.read(name).tolist() for name in names] == [[1.0, 1.0], [1.0, 1.0], [0.0, 0.0]]
    simulator.run(torch.tensor([3, 0]))
    assert [simulator.read(name).tolist() for name in names] == [[4.0, 1.0], [4.0, 1.0], [3.0, 0.0]]
    assert simulator.tick.schedule == (
        *("earth_pole", "ephemeris", "sun_range", "orbit", "hub", "counter", "starter"),
        *("imposed_attitude", "navigation", "nadir_pointing"),
    )


def test_schedules_are_printed_in_order():
    printed = re.findall(r"^  (\w+) ", CliRunner().invoke(app, ["schedule"]).output, re.MULTILINE)
    assert printed == [slot.name for slot in SCHEDULE]
    printed = CliRunner().invoke(app, ["schedule", "NadirScan-v1"]).output
    assert re.findall(r"^    (\w+) ", printed, re.MULTILINE) == list(NADIR_SCAN)
    assert printed.startswith("Scanner1:\n  environment:\n    earth_pole ")
    assert printed.endswith("Phases of a step: kernels of rows\n")
    printed = CliRunner().invoke(app, ["schedule", "AEOS-v1"]).output
    assert "on tensors, because of actions that are more than a table, but images begin and end by kernels of rows" in printed
    slot = described(Measuring.world_components[0])
    assert slot == ("sun_range", "Distance of the Sun.", "none, runs after ephemeris", "environment")
    result = CliRunner().invoke(app, ["schedule", "NadirScn-v1"])
    assert result.exit_code != 0
    assert "did you mean 'NadirScan-v1'" in result.output
