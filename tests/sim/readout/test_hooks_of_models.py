"""Model classes: what would never run is refused at the definition, with what to write instead."""

from typing import Any

from bsk_torch.sim import dyn, fsw, world
from bsk_torch.sim.component import Component
from tests.support.refusals import check_refusals, refusal


def nothing(self: Any, *args: Any, **kwargs: Any) -> None:
    """A hook of bsk_rl."""


def with_defaults(self: Any, heaterPowerDraw: float, **kwargs: Any) -> None:
    """What bsk_rl's ``@default_args`` makes of a method."""


with_defaults.defaults = {"heaterPowerDraw": -5.0}

HEATER = Component("heater", after="base_power")


def test_rejects_members_that_would_never_run():
    def dynamics(**members):
        return type("Mine", (dyn.ImagingDynModel,), members)

    def flight(**members):
        return type("Mine", (fsw.ImagingFSWModel,), members)

    def environment(**members):
        return type("Mine", (world.EclipseWorldModel,), members)

    mixin, hook, task = type("Mixin", (), {"setup_heater": nothing}), classmethod(nothing), type("SafeTask", (), {})
    check_refusals(
        refusal(lambda: dynamics(setup_heater=nothing), TypeError, "Mine.setup_heater", "Component"),
        refusal(lambda: dynamics(_setup_dynamics_objects=nothing), TypeError, "Mine._setup_dynamics_objects", "Component"),
        refusal(lambda: dynamics(heater=with_defaults), TypeError, "Mine.heater", "Arg(name", "args="),
        refusal(lambda: dynamics(reset_for_action=nothing), TypeError, "Mine.reset_for_action", "resets=", "fsw.Mode"),
        refusal(lambda: dynamics(_requires_world=hook), TypeError, "requires_world = (world.EclipseWorldModel,)"),
        refusal(lambda: dynamics(is_alive=nothing), TypeError, "Mine.is_alive", "dyn.aliveness_checker"),
        refusal(lambda: dynamics(reset_post_sim_init=nothing), TypeError, "Mine.reset_post_sim_init", "Field", "state="),
        refusal(lambda: dynamics(_create_process=nothing), TypeError, "Mine._create_process", "Component"),
        refusal(lambda: dynamics(component=(HEATER,)), TypeError, "Mine.component", "'components'"),
        refusal(lambda: dynamics(world_component=(HEATER,)), TypeError, "Mine.world_component", "'world_components'"),
        refusal(lambda: dynamics(components=HEATER), TypeError, "Mine.components=Component(slot='heater'", "tuple"),
        refusal(lambda: dynamics(components=("heater",)), TypeError, "Mine.components=('heater',)", "tuple", "Components"),
        refusal(lambda: dynamics(modes={}), TypeError, "Mine.modes", "flight-software models"),
        refusal(lambda: dynamics(requires_world=world.WorldModel), TypeError, "Mine.requires_world=<class ", "tuple"),
        refusal(lambda: dynamics(requires_world=hook), TypeError, "Mine.requires_world=<classmethod", "tuple"),
        refusal(lambda: type("Mine", (mixin, dyn.ImagingDynModel), {}), TypeError, "Mine.setup_heater"),
        refusal(lambda: flight(action_safe=nothing), TypeError, "act.DiscreteFSWAction('safe')", "modes = {'safe': fsw.Mode"),
        refusal(lambda: flight(SafeTask=task), TypeError, "Mine.SafeTask", "bsk_rl", "components", "modes"),
        refusal(lambda: flight(_make_task_list=nothing), TypeError, "Mine._make_task_list", "Component"),
        refusal(lambda: flight(_set_gateway_msgs=nothing), TypeError, "Mine._set_gateway_msgs", "bus"),
        refusal(lambda: flight(_requires_dyn=hook), TypeError, "requires_dyn = (dyn.BasicDynamicsModel,)"),
        refusal(lambda: flight(world_components=(HEATER,)), TypeError, "Mine.world_components", "dynamics models"),
        refusal(lambda: flight(mode={}), TypeError, "Mine.mode", "'modes'"),
        refusal(lambda: flight(modes=("safe",)), TypeError, "Mine.modes=('safe',)", "dictionary"),
        refusal(lambda: type("SafeTask", (fsw.Task,), {}), TypeError, "SafeTask", "bsk_rl", "Component", "modes"),
        refusal(lambda: fsw.action(nothing), TypeError, "@action nothing", "bsk_rl"),
        refusal(lambda: environment(setup_eclipse_object=nothing), TypeError, "Mine.setup_eclipse_object"),
        refusal(lambda: environment(_setup_world_objects=nothing), TypeError, "Mine._setup_world_objects", "Component"),
        refusal(lambda: environment(default_world_args=hook), TypeError, "Mine.default_world_args", "Arg(name"),
        refusal(lambda: environment(orbit="arc"), TypeError, "Mine.orbit", "dynamics models"),
    )


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
