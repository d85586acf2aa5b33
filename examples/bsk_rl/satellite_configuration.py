"""
Satellite configuration
=======================

Arguments, observations and actions of seven small satellites.

On the command line::

    python examples/bsk_rl/satellite_configuration.py --num-envs 2

The satellites of bsk_rl's page "Satellite Configuration". Comments mark lines that differ from it.
"""

# sphinx_gallery_thumbnail_path = "_static/readme/AEOSPower-v1.png"

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

# bsk_rl: from bsk_rl import sats, act, obs, scene, ...
from bsk_torch import SatelliteTasking, act, data, obs, rand, sats, scene
from bsk_torch.sim import dyn, fsw  # bsk_rl: from bsk_rl.sim import dyn, fsw


class SimpleSatellite(sats.Satellite):
    """Minimal satellite."""

    observation_spec = [obs.Time()]
    action_spec = [act.Drift()]
    dyn_type = dyn.BasicDynamicsModel
    fsw_type = fsw.BasicFSWModel


class SatPropsSatellite(SimpleSatellite):
    """Observes properties of any model, of a given model, and divided by a norm."""

    observation_spec = [
        obs.SatProperties(
            dict(prop="wheel_speeds"),
            dict(prop="battery_charge_fraction", module="dynamics"),
            dict(prop="r_BN_P", norm=7e6),
        )
    ]


class BespokeFSWModel(fsw.BasicFSWModel):
    """Flight software with a custom property."""

    @property
    def meaning_of_life(self) -> Tensor:
        """[N]."""
        return torch.full_like(self.simulator.sim_time, 42.0)  # bsk_rl: return 42


class BespokeSatPropsSatellite(SimpleSatellite):
    """Observes it."""

    observation_spec = [obs.SatProperties(dict(prop="meaning_of_life"))]
    fsw_type = BespokeFSWModel


def meaning_of_life(satellite: Any) -> Tensor:
    """The same as a function of the satellite, [N]."""
    return torch.full_like(satellite.simulator.sim_time, 42.0)  # bsk_rl: lambda sat: 42


class CustomSatPropsSatellite(SimpleSatellite):
    """Observes the function."""

    observation_spec = [
        obs.SatProperties(dict(prop="meaning_of_life", fn=meaning_of_life))
    ]


class OppPropsSatellite(sats.ImagingSatellite):
    """Observes the next three targets: by names of properties, with a norm, and by a function of all of them."""

    observation_spec = [
        obs.OpportunityProperties(
            dict(prop="priority"),
            dict(prop="opportunity_open", norm=5700.0),
            dict(fn=lambda sat, opp: opp["r_LP_P"] + 42),
            n_ahead_observe=3,
        )
    ]
    action_spec = [act.Drift()]
    dyn_type = dyn.ImagingDynModel
    fsw_type = fsw.ImagingFSWModel


class ComposedObsSatellite(SimpleSatellite):
    """Several observations side by side."""

    observation_spec = [
        obs.Eclipse(),
        obs.SatProperties(dict(prop="battery_charge_fraction")),
    ]


class ActionSatellite(SimpleSatellite):
    """The same action may occur twice."""

    action_spec = [
        act.Charge(duration=120.0),
        act.Desat(duration=60.0),
        act.Charge(duration=600.0),
    ]


class ImageActSatellite(sats.ImagingSatellite):
    """An entry that provides several actions."""

    observation_spec = [obs.Time()]
    action_spec = [act.Image(n_ahead_image=3)]
    dyn_type = dyn.ImagingDynModel
    fsw_type = fsw.ImagingFSWModel


SATELLITES: dict[str, type[sats.Satellite]] = {
    "properties": SatPropsSatellite,
    "bespoke": BespokeSatPropsSatellite,
    "custom": CustomSatPropsSatellite,
    "opportunities": OppPropsSatellite,
    "composed": ComposedObsSatellite,
    "actions": ActionSatellite,
    "images": ImageActSatellite,
}
"""The satellites by name."""


def make(
    part: str, num_envs: int = 1, sat_args: dict[str, Any] | None = None, **options: Any
) -> SatelliteTasking:
    """Return ``num_envs`` episodes of a satellite of :data:`SATELLITES`; ``sat_args`` and ``options`` replace its own."""
    kind, obs_type = SATELLITES[part], options.pop("obs_type", torch.Tensor)
    imaging = issubclass(kind, sats.ImagingSatellite)
    targets = (
        dict(scenario=scene.UniformTargets(1000), rewarder=data.UniqueImageReward())
        if imaging
        else {}
    )
    return SatelliteTasking(
        satellite=kind("Sat1", sat_args or {}, obs_type=obs_type),
        num_envs=num_envs,  # bsk_rl: one episode
        **(targets | options),
    )


def main() -> None:
    """Print arguments and observations, try actions, and select a target."""
    parser = argparse.ArgumentParser(description="Look at the parts of a satellite.")
    parser.add_argument("--num-envs", type=int, default=2, help="episodes at once")
    parser.add_argument("--backend", default="compiled", choices=["compiled", "eager"])
    parser.add_argument(
        "--figure",
        type=Path,
        help="file for a figure of the first episode at the end; needs the extra viz",
    )
    options = parser.parse_args()
    common = dict(num_envs=options.num_envs, backend=options.backend, seed=0)
    print(SimpleSatellite.default_sat_args())
    # bsk_rl: dragCoeff=lambda: np.random.uniform(2.0, 2.4)
    drag = dict(mass=300.0, dragCoeff=rand.Uniform(2.0, 2.4))
    env = make("properties", sat_args=drag, **common)
    for _ in range(3):
        env.reset()  # bsk_rl: sat.generate_sat_args()
        print("dragCoeff:", env.satellite.sat_args["dragCoeff"])
    for part in ("properties", "bespoke", "custom", "opportunities", "composed"):
        env = make(part, obs_type=dict, **common)
        print(part, env.reset()["observation"].to_dict())
    env = make("composed", **common)
    print(env.observation_spec["observation"], env.satellite.observation_description)
    env = make("actions", **common)
    td = env.reset()
    for action in range(3):
        # bsk_rl: env.step(action)
        td = env.step(td.set("action", torch.full((options.num_envs,), action)))["next"]
        print(env.satellite.action_description[action], td["duration"].squeeze(1))
    env = make("images", **common)
    td = env.reset()
    print(env.satellite.action_description)
    # bsk_rl: find_next_opportunities(n=10)[9]["object"]
    ninth = env.satellite.find_next_opportunities(10).place[:, 9]
    # bsk_rl: env.step(target)
    td = env.step(td.set("action", act.image_target(ninth)))["next"]
    print("reward for target", ninth, "is", td["reward"].squeeze(1))
    if options.figure is not None:
        from PIL import Image

        Image.fromarray(env.render(rows=0).numpy()).save(options.figure)


if __name__ == "__main__":
    main()
