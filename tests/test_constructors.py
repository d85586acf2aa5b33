"""Public constructors answer wrong values by an error that names the argument."""

import inspect
import itertools
import math
from functools import partial
from typing import Any

import torch

from bsk_torch import act, comm, data, formations, initial, obs, rand, sats, scene
from bsk_torch.rand import first_key
from bsk_torch.tasks.objects import (
    CatalogCommunication,
    ImageRSO,
    RandomRSOCatalog,
    RSOImageReward,
    RSOPriorityEvent,
    RSOTarget,
    RSOTargetCatalog,
    RSOTargetProperties,
    RSOTargets,
    RSOTeamReward,
    TransmitCatalog,
)

WRONG = {
    "nan": math.nan,
    "inf": math.inf,
    "-inf": -math.inf,
    "-1": -1,
    "-1.5": -1.5,
    "0": 0,
    "0.5": 0.5,
    "1e308": 1e308,
    "10**400": 10**400,
    "None": None,
    "'x'": "x",
    "'4'": "4",
    "[]": [],
    "{}": {},
    "[1, 2]": [1.0, 2.0],
    "object": object(),
    "class": dict,
    "tensor": torch.tensor([math.nan, 1.0]),
}

ORBIT = [7e6, 0.0, 1.0, 0.0, 0.0, 0.0]

VALID: dict[Any, dict[str, Any]] = {
    act.DiscreteFSWAction: dict(fsw_action="charge"),
    act.Charge: {},
    act.Drift: {},
    act.NadirPoint: {},
    act.Desat: {},
    act.Downlink: {},
    act.Scan: {},
    act.Broadcast: {},
    act.Image: dict(n_ahead_image=4),
    ImageRSO: dict(n_ahead_image=4),
    act.ImageStrip: dict(n_ahead_image=4),
    act.HybridImageStrip: dict(n_ahead_image=4),
    TransmitCatalog: dict(n_peers=2),
    obs.Time: {},
    obs.Eclipse: {},
    obs.ResourceRewardWeight: {},
    obs.Noisy: dict(observation=obs.Time()),
    partial(obs.OpportunityProperties, dict(prop="priority")): dict(n_ahead_observe=2),
    RSOTargetProperties: {},
    data.ScanningTimeReward: {},
    data.UniqueImageReward: {},
    data.CloudFreeImageReward: {},
    data.FootprintImageReward: dict(half_angle=0.1),
    data.StripImageReward: {},
    RSOImageReward: {},
    RSOTeamReward: {},
    data.TimePenalty: {},
    data.MixedReward: dict(rewarders={"a": data.NoReward()}, satellite_mapping={"a": ["A"]}),
    data.ResourceReward: dict(resource_fn=lambda satellite: satellite.dynamics.battery_charge),
    comm.FreeCommunication: {},
    comm.LOSCommunication: {},
    CatalogCommunication: {},
    scene.UniformNadirScanning: {},
    scene.UniformTargets: dict(n_targets=3),
    scene.CityTargets: dict(n_targets=3),
    scene.MixedScenario: dict(scenarios={"a": scene.UniformTargets(3)}, satellite_mapping={"a": ["A"]}),
    scene.CloudyTargets: dict(targets=scene.UniformTargets(3)),
    scene.StripTargets: dict(targets=scene.UniformTargets(3)),
    scene.UncertainTargets: dict(targets=scene.UniformTargets(3)),
    scene.Wildfires: dict(n_fires=3),
    scene.Targets: dict(r_LP_P=[[7e6, 0.0, 0.0]]),
    RSOTarget: dict(id="a", satellite_name="A", rN=[7e6, 0.0, 0.0], vN=[0.0, 7546.0, 0.0]),
    RSOPriorityEvent: dict(time_s=0.0, priorities=[("a", 1.0)]),
    RSOTargetCatalog: dict(targets=[RSOTarget("a", "A", [7e6, 0.0, 0.0], [0.0, 7546.0, 0.0])]),
    RandomRSOCatalog: dict(n_targets=2),
    RSOTargets: dict(catalog=RandomRSOCatalog(2), imager_names=["A"]),
    scene.Target: dict(name="Denver", r_LP_P=[6.4e6, 0.0, 0.0], priority=1.0),
    formations.walker_delta: dict(n_spacecraft=2, n_planes=1, rel_phasing=0.0, altitude=5e5, inc=45.0),
    formations.walker_star: dict(n_spacecraft=2, n_planes=1, rel_phasing=0.0, altitude=5e5, inc=45.0),
    formations.walker_delta_args: dict(n_planes=1),
    formations.walker_star_args: dict(n_planes=1),
    formations.train_args: dict(spacing=1.0),
    formations.relative_to_chief: dict(chief_name="A", chief_orbit=ORBIT, deputy_relative_state=dict(B=[1e3, 0, 0, 0, 0, 0])),
    formations.together: dict(formations={("A", "B"): formations.train_args(1.0)}),
    sats.Satellite: dict(name="A"),
    sats.AccessSatellite: dict(name="A"),
    sats.ImagingSatellite: dict(name="A"),
    rand.Uniform: {},
    rand.Normal: {},
    rand.Choice: dict(options=[1.0, 2.0]),
    rand.random_orbit: {},
    rand.random_circular_orbit: {},
    rand.random_epoch: {},
    initial.random_tumble: {},
}
"""Constructors, and arguments that are right."""


def parameters(make: Any) -> list[str]:
    kinds = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)
    return [name for name, given in inspect.signature(make).parameters.items() if given.kind not in kinds]


def use(made: Any) -> None:
    """Draw what can be drawn."""
    if isinstance(made, formations.Formation):
        made.check(["A", "B"])
        drawn = [values for _, values in made.draw_checked(first_key(2), ["A", "B"]).values()]
    elif isinstance(made, scene.Scenario):
        drawn = list(made.draw_checked(first_key(2)).values())
    elif isinstance(made, rand.Distribution):
        drawn = [made.draw(first_key(2))]
    else:
        drawn = [made] if isinstance(made, torch.Tensor) else []
    for values in drawn:
        assert not isinstance(values, torch.Tensor) or bool(torch.isfinite(values).all())


def test_rejects_wrong_values():
    """Every argument of a constructor and every wrong value: an error that names the argument, or something finite."""
    wrong = []
    for make, right in VALID.items():
        use(make(**right))
        for name, (title, value) in itertools.product(parameters(make), WRONG.items()):
            call = f"{getattr(make, 'func', make).__name__}({name}={title})"
            try:
                use(make(**right | {name: value}))
            except (ValueError, TypeError, KeyError) as error:
                if name.removesuffix("_distribution") not in str(error):
                    wrong.append(f"{call}: {type(error).__name__}: {error}")
            except Exception as error:
                wrong.append(f"{call}: {type(error).__name__}: {error}")
    assert not wrong, "\n".join(wrong)
