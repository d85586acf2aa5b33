"""Limits of places, and places of components in the schedule, that cannot be."""

import math
from functools import partial

import torch

from bsk_torch.constants import R_EARTH
from bsk_torch.sim import dyn
from bsk_torch.sim.component import Component
from bsk_torch.sim.fsw.target import IMAGE_TARGET
from bsk_torch.sim.places import FixedPlaces, SunElevation
from bsk_torch.sim.schedule import SCHEDULE
from tests.support.refusals import check_refusals, refusal


def test_rejects_wrong_limits_of_places():
    def elevation(value):
        return IMAGE_TARGET.check({"imageTargetMinimumElevation": torch.tensor([0.7, value], dtype=torch.float64)})

    places, sunlit = torch.eye(3, dtype=torch.float64).unsqueeze(0) * R_EARTH, [SunElevation(0.1)]
    name, allowed = "imageTargetMinimumElevation", "[0, pi/2)"
    check_refusals(
        refusal(lambda: elevation(45.0), ValueError, f"{name}=45 rad", allowed, "math.radians(45)"),
        refusal(lambda: elevation(0.5 * math.pi), ValueError, f"{name}=1.5708 rad", allowed),
        refusal(lambda: elevation(-0.1), ValueError, f"{name}=-0.1 rad", allowed),
        refusal(lambda: elevation(-0.3), ValueError, f"{name}=-0.3 rad", allowed),
        refusal(lambda: FixedPlaces(places, 0.1, light=sunlit), ValueError, "light=[SunElevation(", "tables="),
    )


def test_rejects_components_without_a_place_in_the_schedule():
    def define(attribute, part):
        return type("WrongDynModel", (dyn.DynamicsModel,), {attribute: (part,)})

    component = partial(Component, update=print)
    wrong = [
        (component("batery"), "slot='batery'", "after=", "before=", "'battery'"),
        (component("heater", after="batery"), "slot='heater'", "after='batery'", "'battery'"),
        (component("heater", before="heater"), "slot='heater'", "before='heater'", "tick"),
        (component("heater", after="battery", before="hub"), "slot='heater'", "after='battery'", "before='hub'"),
    ]
    rows = [
        refusal(lambda call=call, part=part: call(part), ValueError, *names)
        for part, *names in wrong
        for call in (partial(define, "components"), partial(define, "world_components"), SCHEDULE.place, SCHEDULE.place)
    ]
    model = dyn.DynamicsModel
    named = refusal(lambda: type("Wrong", (model,), {"schedule": ("hub",)}), TypeError, "Wrong.schedule=('hub',)", "SCHEDULE")
    check_refusals(*rows, named)
