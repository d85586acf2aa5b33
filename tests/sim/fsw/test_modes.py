"""What modes switch on and reset: flags and fields of no component are errors, fields of a replaced one are ignored."""

import pytest
import torch

from bsk_torch import SatelliteTasking, fsw
from bsk_torch.presets.nadir_scan import ScanningSatellite
from bsk_torch.sim.component import Component
from bsk_torch.sim.fsw import guidance
from tests.support.refusals import check_refusals, refusal


def environment(modes, components=(), backend="eager"):
    """An environment whose flight software has other ``modes`` and ``components``."""
    model = type("Model", (fsw.ContinuousImagingFSWModel,), {"modes": modes, "components": components})
    satellite = type("Mine", (ScanningSatellite,), {"fsw_type": model})
    return SatelliteTasking(satellite("A"), backend=backend, time_limit=300.0)


def test_rejects_fields_and_flags_of_no_component():
    def mode(name, *flags, **resets):
        return environment({name: fsw.Mode(("control_on", *flags), resets)})

    check_refusals(
        refusal(lambda: mode("charge", "sun_on", sun_frash=1.0), ValueError, "mode 'charge'", "'sun_frash'", "'sun_fresh'"),
        refusal(lambda: mode("warm", "heater_on"), ValueError, "mode 'warm'", "'heater_on'", "flags=", "bus.heater_on"),
        refusal(lambda: mode("charge", "sun_onn"), ValueError, "mode 'charge'", "'sun_onn'", "'sun_on'"),
    )


def heat(bus) -> None:
    bus.power = bus.power - 20.0 * bus.heater_on


HEATER = Component("heater", heat, after="transmitter_draw", flags=("heater_on",), idle_flags=("heater_on",))


@pytest.mark.parametrize("backend", ["eager", pytest.param("compiled", marks=pytest.mark.compiled)])
@pytest.mark.nightly("eager")
def test_a_component_brings_a_flag(backend):
    """It is 1 in the modes that list it and, as an idle flag, before the first command."""
    modes = {"warm": fsw.Mode(("control_on", "sun_on", "heater_on")), "cold": fsw.Mode(("control_on", "sun_on"))}
    powers = {}
    for components in ((), (HEATER,)):
        env = environment({} if not components else modes, components, backend)
        for mode in ("idle", "charge", *(modes if components else ())):
            env.set_seed(3)
            env.reset()
            simulator, rows = env.simulator, torch.ones(1, dtype=torch.bool)
            if mode != "idle":
                simulator.command(rows, simulator.mode_index(mode))
            charge = simulator.state.read("charge")
            simulator.run(torch.tensor([1]))
            powers[mode, bool(components)] = float(simulator.state.read("charge") - charge)
    for mode, without, draws in (("idle", "idle", 20.0), ("warm", "charge", 20.0), ("cold", "charge", 0.0)):
        assert powers[without, False] - powers[mode, True] == pytest.approx(draws, abs=1e-9)


def test_fields_are_reset_but_those_of_replaced_components():
    env = environment({"charge": fsw.Mode(("control_on", "sun_on"), {"sun_fresh": 0.25})})
    planes, resets, values = env.simulator.type.resets
    plane = env.simulator.tick.state.slices["sun_fresh"].start
    row, mode = planes.tolist().index(plane), env.simulator.mode_names.index("charge")
    assert resets[row, mode]
    assert values[row, mode] == 0.25
    # The replacement keeps no state; the mode of the base class resets what it would have kept.
    component = type(guidance.SUN_POINTING)(slot=guidance.SUN_POINTING.slot)
    env = environment({"charge": fsw.Mode(("control_on",), {"sun_fresh": 1.0})}, (component,))
    assert "sun_fresh" not in env.simulator.tick.state.fields
