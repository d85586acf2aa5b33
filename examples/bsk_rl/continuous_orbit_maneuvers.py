"""
Continuous orbit maneuvers
==========================

A scanner changes its orbit with continuous actions: a velocity change and a drift time.

On the command line::

    python examples/bsk_rl/continuous_orbit_maneuvers.py --num-envs 4

The problem of bsk_rl's page "Continuous Orbit Maneuvers", as far as supported by 1.3.8. Comments mark lines that differ from it.
In bsk_rl, station passes and eclipses remain those of the first orbit; here, they follow the new orbit (use ``replan=False`` for
bsk_rl's behavior).
"""

# sphinx_gallery_thumbnail_path = "_static/readme/MultiInspection-v1.png"

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

# bsk_rl: from bsk_rl import SatelliteTasking, act, ...
from bsk_torch import SatelliteTasking, act, data, obs, sats, scene
from bsk_torch.constants import R_EARTH  # bsk_rl: orbitalMotion.REQ_EARTH * 1e3
from bsk_torch.sim import dyn, fsw  # bsk_rl: from bsk_rl.sim import dyn, fsw

PASS = (
    dict(prop="opportunity_open", norm=5700.0),
    dict(prop="opportunity_close", norm=5700.0),
)


class Scanner(sats.AccessSatellite):
    """Scans the ground below between maneuvers."""

    observation_spec = [
        obs.SatProperties(
            dict(prop="r_BN_P", norm=R_EARTH),
            dict(prop="v_BN_P", norm=7600.0),
            dict(prop="storage_level_fraction"),
        ),
        obs.OpportunityProperties(*PASS, type="ground_station", n_ahead_observe=2),
        obs.Eclipse(norm=5700.0),
        obs.Time(),
    ]
    action_spec = [
        act.ImpulsiveThrust(
            max_dv=30.0, max_drift_duration=2000.0, fsw_action="action_nadir_scan"
        )
    ]
    dyn_type = (dyn.ContinuousImagingDynModel, dyn.GroundStationDynModel)
    fsw_type = (fsw.MagicOrbitalManeuverFSWModel, fsw.ContinuousImagingFSWModel)


SAT_ARGS = dict(
    dv_available_init=300.0,
    imageAttErrorRequirement=0.1,
    dataStorageCapacity=8e9,
    instrumentBaudRate=1e5,
    u_max=0.4,
    batteryStorageCapacity=1e6,
    storedCharge_Init=1e6,
)


def make(
    num_envs: int = 1, sat_args: dict[str, Any] | None = None, **options: Any
) -> SatelliteTasking:
    """Return ``num_envs`` episodes of the problem.

    ``sat_args`` replace what would be drawn, ``options`` those of the problem.
    """
    defaults = dict(
        scenario=scene.UniformNadirScanning(),
        rewarder=data.ScanningTimeReward(),
        time_limit=2 * 5700.0,
    )
    return SatelliteTasking(
        Scanner("Scanner", sat_args=SAT_ARGS | (sat_args or {})),
        num_envs=num_envs,  # bsk_rl: one episode
        **(defaults | options),
    )


def raise_orbit(env: SatelliteTasking, dv: float, drift: float) -> Tensor:
    """Return actions [N, 4] along the velocity: ``dv``, m/s, and ``drift``, s."""
    v_N = env.satellite.dynamics.v_BN_N
    # bsk_rl: dv * v / np.linalg.norm(v)
    along = dv * v_N / torch.linalg.vector_norm(v_N, dim=-1, keepdim=True)
    return torch.cat([along, torch.full_like(along[:, :1], drift)], 1)


def main() -> None:
    """Raise the orbit until the time limit."""
    parser = argparse.ArgumentParser(
        description="Raise an orbit by impulses while scanning."
    )
    parser.add_argument("--num-envs", type=int, default=4, help="episodes at once")
    parser.add_argument(
        "--time-limit", type=float, default=11400.0, help="length of an episode, s"
    )
    parser.add_argument("--backend", default="compiled", choices=["compiled", "eager"])
    parser.add_argument(
        "--figure",
        type=Path,
        help="file for a figure of altitude and fuel; needs the extra viz",
    )
    options = parser.parse_args()
    env = make(
        options.num_envs, time_limit=options.time_limit, backend=options.backend, seed=0
    )
    td, rows = env.reset(), []
    while True:
        dynamics, left = env.satellite.dynamics, env.satellite.fsw.dv_available
        rows.append(
            torch.stack(
                [env.simulator.sim_time, dynamics.semi_major_axis / 1e3, left], 1
            )
        )
        if bool(td["done"].all()):
            break
        td["action"] = raise_orbit(env, 20.0, 1000.0)
        td = env.step(td)["next"]
    seen = torch.stack(rows, 1)
    print(
        "semi-major axis, km, from",
        seen[:, 0, 1].tolist(),
        "to",
        seen[:, -1, 1].tolist(),
        "fuel, m/s",
        left.tolist(),
    )
    if options.figure is not None:
        from bsk_torch.viz.figures.style import INK, PALETTE, label, panels, save

        figure, axes = panels((1.8, 1.4))
        for panel, column, name in zip(
            axes, (1, 2), ("semi-major axis, km", "fuel, m/s"), strict=True
        ):
            panel.plot(
                seen[0, :, 0] / 3600.0, seen[0, :, column], "o-", color=PALETTE[0]
            )
            label(panel, name)
        axes[-1].set_xlabel("hours since the start", color=INK)
        save(figure, options.figure)


if __name__ == "__main__":
    main()
