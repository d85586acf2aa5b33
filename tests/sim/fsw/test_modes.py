"""Fields that modes reset: those of no component are refused, those of a component that a subclass replaces are ignored."""

from __future__ import annotations

import pytest

from bsk_torch import SatelliteTasking, fsw
from bsk_torch.presets.nadir_scan import ScanningSatellite
from bsk_torch.sim.fsw import guidance


def environment(modes, components=()):
    """An environment whose flight software has other ``modes`` and ``components``."""
    model = type("Model", (fsw.ContinuousImagingFSWModel,), {"modes": modes, "components": components})
    satellite = type("Mine", (ScanningSatellite,), {"fsw_type": model})
    return SatelliteTasking(satellite("A"), backend="eager", time_limit=300.0)


def test_a_field_of_no_component_is_refused():
    with pytest.raises(ValueError, match=r"mode 'charge' resets 'sun_frash', which is no field of the state; .*'sun_fresh'"):
        environment({"charge": fsw.Mode(("control_on", "sun_on"), {"sun_frash": 1.0})})


def test_fields_of_components_are_reset():
    env = environment({"charge": fsw.Mode(("control_on", "sun_on"), {"sun_fresh": 0.25})})
    planes, resets, values = env.simulator.resets
    plane = env.simulator.tick.state.slices["sun_fresh"].start
    row, mode = planes.tolist().index(plane), env.simulator.mode_names.index("charge")
    assert resets[row, mode]
    assert values[row, mode] == 0.25


def test_fields_of_a_replaced_component_are_ignored():
    """The replacement keeps no state; the mode of the base class resets what it would have kept."""
    component = type(guidance.SUN_POINTING)(slot=guidance.SUN_POINTING.slot)
    env = environment({"charge": fsw.Mode(("control_on",), {"sun_fresh": 1.0})}, (component,))
    assert "sun_fresh" not in env.simulator.tick.state.fields
