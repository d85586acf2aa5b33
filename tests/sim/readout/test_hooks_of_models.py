"""Model classes: what would never run is refused at the definition, with what to write instead."""

from __future__ import annotations

from typing import Any

import pytest

from bsk_torch.sim import dyn, fsw, world
from bsk_torch.sim.component import Component


def nothing(self: Any, *args: Any, **kwargs: Any) -> None:
    """A hook of bsk_rl."""


def with_defaults(self: Any, heaterPowerDraw: float, **kwargs: Any) -> None:
    """What bsk_rl's ``@default_args`` makes of a method."""


with_defaults.defaults = {"heaterPowerDraw": -5.0}

HEATER = Component("heater", after="base_power")


@pytest.mark.parametrize(
    ("base", "members", "words"),
    [
        (dyn.ImagingDynModel, dict(setup_heater=nothing), r"Mine.setup_heater is never used; write a Component"),
        (dyn.ImagingDynModel, dict(_setup_dynamics_objects=nothing), "write a Component"),
        (dyn.ImagingDynModel, dict(heater=with_defaults), r"default arguments that are never used; arguments are Arg\(name"),
        (dyn.ImagingDynModel, dict(reset_for_action=nothing), r"resets= of an fsw.Mode"),
        (dyn.ImagingDynModel, dict(_requires_world=classmethod(nothing)), r"requires_world = \(world.EclipseWorldModel,\)"),
        (dyn.ImagingDynModel, dict(is_alive=nothing), "dyn.aliveness_checker"),
        (dyn.ImagingDynModel, dict(reset_post_sim_init=nothing), "Field in state= of a Component"),
        (dyn.ImagingDynModel, dict(_create_process=nothing), "write a Component"),
        (dyn.ImagingDynModel, dict(component=(HEATER,)), "Mine.component is never used; did you mean 'components'"),
        (dyn.ImagingDynModel, dict(world_component=(HEATER,)), "did you mean 'world_components'"),
        (dyn.ImagingDynModel, dict(components=HEATER), "is no tuple of Components; it must be written like"),
        (dyn.ImagingDynModel, dict(components=("heater",)), "is no tuple of Components"),
        (dyn.ImagingDynModel, dict(modes={}), "Mine.modes is never used; it belongs to flight-software models"),
        (dyn.ImagingDynModel, dict(requires_world=world.WorldModel), "is no tuple of models"),
        (dyn.ImagingDynModel, dict(requires_world=classmethod(nothing)), "is no tuple of models"),
        (fsw.ImagingFSWModel, dict(action_safe=nothing), r"act.DiscreteFSWAction\('safe'\) enters: modes = {'safe': fsw.Mode"),
        (fsw.ImagingFSWModel, dict(SafeTask=type("SafeTask", (), {})), "tasks of bsk_rl are components and modes here"),
        (fsw.ImagingFSWModel, dict(_make_task_list=nothing), "write a Component"),
        (fsw.ImagingFSWModel, dict(_set_gateway_msgs=nothing), "attributes of the bus"),
        (fsw.ImagingFSWModel, dict(_requires_dyn=classmethod(nothing)), r"requires_dyn = \(dyn.BasicDynamicsModel,\)"),
        (fsw.ImagingFSWModel, dict(world_components=(HEATER,)), "it belongs to dynamics models"),
        (fsw.ImagingFSWModel, dict(mode={}), "did you mean 'modes'"),
        (fsw.ImagingFSWModel, dict(modes=("safe",)), "is no dictionary"),
        (
            world.EclipseWorldModel,
            dict(setup_eclipse_object=nothing),
            r"Mine.setup_eclipse_object is never used",
        ),
        (world.EclipseWorldModel, dict(_setup_world_objects=nothing), "write a Component"),
        (world.EclipseWorldModel, dict(default_world_args=classmethod(nothing)), "Arg"),
        (world.EclipseWorldModel, dict(orbit="arc"), "it belongs to dynamics models"),
    ],
)
def test_what_would_not_run_is_refused_at_the_definition(base, members, words):
    with pytest.raises(TypeError, match=words):
        type("Mine", (base,), members)


def test_hooks_of_classes_that_are_mixed_in_are_refused_too():
    mixin = type("Mixin", (), {"setup_heater": nothing})
    with pytest.raises(TypeError, match=r"Mine.setup_heater is never used"):
        type("Mine", (mixin, dyn.ImagingDynModel), {})


def test_tasks_and_decorators_of_bsk_rl_say_what_to_write():
    with pytest.raises(TypeError, match=r"SafeTask is a task of bsk_rl, .* Component .* table modes"):

        class SafeTask(fsw.Task):
            name = "safeTask"

    with pytest.raises(TypeError, match=r"@action nothing is a command of bsk_rl"):
        fsw.action(nothing)


def test_models_may_have_helpers_values_and_readouts_of_their_own():
    members = {
        "helper": nothing,
        "_setup": nothing,
        "limit": 3.0,
        "share": property(lambda self: self.state("charge")),
        "components": [HEATER],
        "alive": dyn.aliveness_checker(lambda self: self.state("charge") > 0.0),
    }
    model = type("Mine", (dyn.ImagingDynModel,), members)
    assert "heater" in [component.slot for component in model.all_components()]
    assert "alive" in model.checks()
