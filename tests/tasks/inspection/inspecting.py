"""An RSO and inspectors on one orbit, for tests."""

from __future__ import annotations

from typing import Any

import torch

from bsk_torch import ConstellationTasking, act, data, obs, sats
from bsk_torch.astro.relative import hill2cd
from bsk_torch.sim import fsw
from bsk_torch.tasks.inspection import RSODynModel, RSOInspectionReward, RSOInspectorDynModel, RSOInspectorFSWModel, SphericalRSO
from bsk_torch.tasks.inspection.obs import rso_imaged_regions

EPOCH = "2021 JUN 05 09:12:05.830 (UTC)"
R_N, V_N = (0.0, 6.9e6, 0.0), (-5374.0, 0.0, 5374.0)
TURNED = dict(sigma_init=[0.1, 0.2, -0.3], omega_init=[0.0, 0.0, 0.0], wheelSpeeds=[0.0, 0.0, 0.0])
KEPT = dict(
    imageAttErrorRequirement=1.0,
    instrumentBaudRate=1.0,
    dataStorageCapacity=1e6,
    batteryStorageCapacity=1e9,
    storedCharge_Init=1e9,
)


class RSO(sats.Satellite):
    observation_spec = (obs.Time(),)
    action_spec = (act.NadirPoint(duration=1e9), act.Drift(duration=1e9))
    dyn_type = RSODynModel
    fsw_type = fsw.FSWModel


class Inspector(sats.Satellite):
    observation_spec = (
        obs.RelativeProperties(dict(prop="rso_imaged_regions", fn=rso_imaged_regions), chief_name="RSO"),
        obs.ResourceRewardWeight(),
    )
    action_spec = (
        act.DiscreteFSWAction("action_inspect_rso", duration=20.0, reset_task=True),
        act.Drift(duration=10.0),
    )
    dyn_type = RSOInspectorDynModel
    fsw_type = (fsw.MagicOrbitalManeuverFSWModel, RSOInspectorFSWModel)


def chief_args() -> dict[str, Any]:
    return dict(oe=None, rN=list(R_N), vN=list(V_N))


def inspector_args(*rho_H: float, **given: Any) -> dict[str, Any]:
    """Arguments of an inspector at rest at ``rho_H`` in the RSO's Hill frame, m."""
    r, v = hill2cd(torch.tensor(R_N), torch.tensor(V_N), torch.tensor(rho_H), torch.zeros(3))
    return dict(oe=None, rN=r.tolist(), vN=v.tolist(), **TURNED) | KEPT | given


def weighted(satellite: Any) -> Any:
    return satellite.fsw.dv_available


POINTS = dict(n_points=40, theta_max=1.2, range_max=300.0, theta_solar_max=1.3)


def inspection(satellites: Any = None, scenario: Any = None, **options: Any) -> ConstellationTasking:
    """An RSO, and inspectors above and behind it."""
    if satellites is None:
        satellites = [RSO("RSO", chief_args()), Inspector("Above", inspector_args(100.0, 0.0, 0.0))]
        satellites.append(Inspector("Behind", inspector_args(0.0, -100.0, 0.0)))
    weight = options.pop("weight", 0.1)
    reward = options.pop("reward", {})
    defaults = dict(
        rewarder=(RSOInspectionReward(**reward), data.ResourceReward(weight, weighted)),
        world_args=dict(utc_init=EPOCH),
        sim_rate=5.0,
        time_limit=300.0,
        num_envs=2,
        seed=3,
        orbit="integrated",
        backend="eager",
        dtype=torch.float64,
    )
    return ConstellationTasking(satellites, scenario or SphericalRSO(**POINTS), **(defaults | options))


def act_all(env: ConstellationTasking, td: Any, rso: int = 0, inspectors: int = 0) -> Any:
    """Step with an action of the RSO, and one of all inspectors."""
    first, second = env.groups
    td[first.name, "action"] = torch.full((env.num_envs, 1), rso)
    td[second.name, "action"] = torch.full((env.num_envs, len(second.agents)), inspectors)
    return env.step(td)["next"]
