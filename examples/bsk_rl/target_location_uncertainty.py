"""
Target location uncertainty
===========================

Images take longer for larger search areas, and search areas grow with time.

On the command line::

    python examples/bsk_rl/target_location_uncertainty.py --num-envs 4

The problem of bsk_rl's page "Target Location Uncertainty". Comments mark lines that differ from it. On the page, every target is
an object with an area updated by the environment after each step; here, areas are a table [N, T] of all targets, kept by the
rewarder.
"""

# sphinx_gallery_thumbnail_path = "_static/readme/AEOSCity-v1.png"

from __future__ import annotations

import argparse
import dataclasses
import math
from pathlib import Path
from typing import Any

import torch
from aeos import Density
from torch import Tensor

# bsk_rl: from bsk_rl import act, obs, sats
from bsk_torch import SatelliteTasking, act, obs, rand, sats, scene

# bsk_rl: orbitalMotion.MU_EARTH * 1e9, orbitalMotion.REQ_EARTH * 1e3
from bsk_torch.constants import MU_EARTH, R_EARTH

# bsk_rl: from bsk_rl.data.unique_image_data import UniqueImageData, UniqueImageReward
from bsk_torch.data import ImageReward
from bsk_torch.sim import dyn, fsw  # bsk_rl: from bsk_rl.sim import dyn, fsw, world
from bsk_torch.sim.component import Bus, Field
from bsk_torch.sim.fsw.instrument import IMAGE_CONTROLLER, permission

IMAGE_MODE = fsw.ImagingFSWModel.all_modes()["image"]

ALTITUDE = 800e3  # m
PERIOD = 2 * math.pi * math.sqrt((R_EARTH + ALTITUDE) ** 3 / MU_EARTH)
"""Of the orbit, s."""

SWATH = 20e3
"""Width of the instrument's track, m; bsk_rl: scan_width."""

LARGEST = 100e3
"""Side of the largest area at the start, m."""


LOTS = 1024
"""Number of random numbers drawn for the decisions of an episode; longer episodes reuse them from the start."""


class AreaTargets(scene.UniformTargets):
    """Targets in square areas, with drawn search parameters."""

    # bsk_rl: regenerate_targets, target by target
    def draw(self, key: rand.Key) -> dict[str, Tensor]:
        """Draw side of the area, m, speeds of search and target, m/s, and a random number for every decision."""
        drawn = {
            # bsk_rl: np.random.uniform(10.0, 100.0) * 1e3, and so on
            "side": (10e3, 100e3),
            "acquiring_speed": (3e3, 6e3),
            "speed": (22e3 / 3600, 46e3 / 3600),
        }
        numbers = {
            name: low + (high - low) * key.named(name).uniform(self.most_targets)
            for name, (low, high) in drawn.items()
        }
        return super().draw(key) | numbers | {"lot": key.named("lot").normal(LOTS)}


# bsk_rl: UncertainMultiplyReward, and class SatelliteUncertaintyTargets(SatelliteTasking)
class UncertaintyReward(ImageReward):
    """Rewards every image with priority times area; the area then shrinks to zero and grows with time.

    Areas change after the observation of every step, as on the page: an observation shows the areas of the previous step.
    Counters: ``found`` and ``found_again`` [N, S], images of targets for the first time, and later ones.
    """

    def link(self, scenario: Any, fleet: Any) -> None:
        """Declare growth of each side, m, since the start or the last image, and whether there was one: now, and as observed."""
        super().link(scenario, fleet)
        for name in ("grown", "grown_seen"):
            self.memory.declare(name, 0.0, scenario.most_targets)
        for name in ("was_found", "was_found_seen"):
            self.memory.declare(name, 0, scenario.most_targets, dtype=torch.bool)
        for name in ("found", "found_again"):
            self.memory.declare(name, 0, fleet.size)
        self.memory.declare("time", 0.0)

    def side(self, seen: bool = False) -> Tensor:
        """Return the side of each area, [N, T] m, as it is now or as it is observed."""
        grown, found = (
            self.memory[f"{name}_seen" if seen else name]
            for name in ("grown", "was_found")
        )
        return torch.where(found, 0.0, self.scenario.drawn("side")) + grown

    def search_of(self, target: Tensor, lot: Tensor) -> tuple[Tensor, Tensor]:
        """Return the time after which each target [N] is found, and that of a whole search, s; ``lot`` [N] is standard normal."""
        side, speed = (
            table.gather(1, target.unsqueeze(1)).squeeze(1)
            for table in (self.side(), self.scenario.drawn("acquiring_speed"))
        )
        whole = side * torch.ceil(side / SWATH) / speed
        # bsk_rl: max(0.0, np.random.normal(whole / 2, 0.3 * whole))
        return (whole * (0.5 + 0.3 * lot)).clamp(min=0.0), whole

    def counts(self) -> dict[str, Tensor]:
        """See the class."""
        return {name: self.memory[name] for name in ("found", "found_again")}

    # bsk_rl: create_data_store without the filter of what has been imaged
    def selectable(self) -> Tensor:
        """All targets, always."""
        return self.scenario.available.unsqueeze(1)

    # bsk_rl: calculate_reward, and step of the environment
    def value(self, target: Tensor, taken: Tensor) -> Tensor:
        """Return the reward for an image ``taken`` of ``target``, [N, 1] each, and let areas grow."""
        memory, side = self.memory, self.side()
        area = side.gather(1, target) ** 2
        reward = torch.where(
            taken, self.scenario.priority.gather(1, target) * (area / LARGEST**2), 0.0
        )
        again = memory["was_found"].gather(1, target)
        for name, which in (("found", taken & ~again), ("found_again", taken & again)):
            memory[name] = memory[name] + which
        seconds = (self.fleet.sim_time - memory["time"]).unsqueeze(1)
        moved, shrinks = (
            seconds > 0.0,
            self.taken_by_any(target, reward > 0.0, side.shape[1]),
        )
        for name in ("grown", "was_found"):
            memory[f"{name}_seen"] = torch.where(
                moved, memory[name], memory[f"{name}_seen"]
            )
        memory["grown"] = torch.where(
            shrinks, 0.0, memory["grown"] + self.scenario.drawn("speed") * seconds
        )
        memory["was_found"] = memory["was_found"] | shrinks
        memory["time"] = self.fleet.sim_time.clone()
        return reward


def search(bus: Bus) -> None:
    """Take an image once the target has been in sight for its time, as Basilisk's simpleInstrumentController does.

    Time counts from the first tick in which an image is permitted, and restarts after every tick in which it is not. The
    instrument stops in the first tick after a complete search, even if the target would be found between the last two ticks.
    """
    on = bus.location_on > 0.0
    tries = (bus.image_taken < 0.5) & (bus.given_up < 0.5)
    sees = on & tries & (permission(bus) > 0.0)
    elapsed = torch.where(
        bus.dwell < 0.0, torch.zeros_like(bus.dwell), bus.dwell + bus.h
    )
    over = sees & (elapsed >= torch.minimum(bus.acquisition_time, bus.allowed_time))
    takes = over & (elapsed >= bus.acquisition_time) & (elapsed <= bus.allowed_time)
    one, never = torch.ones_like(bus.dwell), torch.full_like(bus.dwell, -1.0)
    counts = (sees & ~over) | (~(on & tries) & (bus.dwell >= 0.0))
    bus.dwell = torch.where(counts, elapsed, never)
    bus.instrument_command = torch.where(
        on, takes.to(one.dtype), bus.instrument_command
    )
    bus.image_taken = torch.where(takes, one, bus.image_taken)
    bus.given_up = torch.where(over & ~takes, one, bus.given_up)


OWN_STATE = {
    "dwell": -1.0,
    "acquisition_time": 0.0,
    "allowed_time": 0.0,
    "given_up": 0.0,
}
"""Time in sight, -1 while there is none; time after which the target is found; that of a whole search; whether it failed."""

SEARCH_CONTROLLER = dataclasses.replace(
    IMAGE_CONTROLLER,
    update=search,
    state=(
        *IMAGE_CONTROLLER.state,
        *(Field(name, 1, "-" if name == "given_up" else "s") for name in OWN_STATE),
    ),
    initial=lambda args: {
        name: torch.full((1,), x).double() for name, x in OWN_STATE.items()
    },
)


# bsk_rl: CustomFswModel, with another action_image
class SearchFSWModel(fsw.SteeringImagerFSWModel):
    """Takes images with a search time."""

    components = (SEARCH_CONTROLLER,)
    modes = {"image": fsw.Mode(IMAGE_MODE.on, {**IMAGE_MODE.resets, "given_up": 0.0})}


class Search(act.Image):  # bsk_rl: task_target_for_imaging of the satellite
    """Images one of the next targets, with a search time per target."""

    def link_satellite(self, satellite: Any) -> None:
        """Count decisions."""
        super().link_satellite(satellite)
        satellite.simulator.memory.declare("searches", 0)

    def begin(self, mask: Tensor, decision: act.Decision) -> None:
        """Set the search time of the instrument."""
        super().begin(mask, decision)
        satellite, memory = self.satellite, self.satellite.simulator.memory
        number = torch.remainder(memory["searches"], LOTS).unsqueeze(1)
        lot = satellite.scenario.drawn("lot").gather(1, number).squeeze(1)
        target = torch.where(mask, satellite.latest_target, 0)
        for name, seconds in zip(
            ("acquisition_time", "allowed_time"),
            satellite.rewarder.search_of(target, lot),
            strict=True,
        ):
            satellite.simulator.write(name, mask & decision.retask, seconds)
        memory["searches"] = memory["searches"] + mask


def search_area(satellite: Any, opportunities: Any) -> Tensor:
    """Return the area of each target, [N, n] m^2; bsk_rl: opp["object"].search_area."""
    return satellite.simulator.look_up(
        satellite.rewarder.side(seen=True) ** 2, opportunities.place
    )


class Searcher(sats.ImagingSatellite):  # bsk_rl: CustomSatComposed
    """Images one of the next 32 targets."""

    observation_spec = [
        obs.SatProperties(
            dict(prop="omega_BN_B", norm=0.03),
            dict(prop="c_hat_H"),
            dict(prop="r_BN_P", norm=R_EARTH),
            dict(prop="v_BN_P", norm=7616.5),
        ),
        Density(intervals=20, norm=5),
        obs.OpportunityProperties(
            dict(prop="priority"),
            dict(prop="r_LB_H", norm=R_EARTH),
            dict(prop="target_angle", norm=math.pi / 2),
            dict(prop="target_angle_rate", norm=0.03),
            dict(prop="opportunity_open", norm=300.0),
            dict(prop="opportunity_close", norm=300.0),
            dict(prop="search_area", fn=search_area, norm=LARGEST**2),
            type="target",
            n_ahead_observe=32,
        ),
    ]
    action_spec = [Search(n_ahead_image=32)]  # bsk_rl: act.Image(n_ahead_image=32)
    dyn_type = dyn.FullFeaturedDynModel
    fsw_type = SearchFSWModel


BATTERY, STORE = 1000.0 * 3600 * 2, 20 * 8e6 * 100

SAT_ARGS: dict[str, Any] = dict(
    # bsk_rl: lambda: random_orbit(alt=ALTITUDE, i=45)
    oe=rand.random_orbit(a=6371 + 800.0, i=45.0, omega=0.0),
    imageAttErrorRequirement=0.01,
    imageRateErrorRequirement=0.01,
    batteryStorageCapacity=BATTERY,
    # bsk_rl: lambda: np.random.uniform(0.4, 1.0) * ...
    storedCharge_Init=rand.Uniform(0.4 * BATTERY, BATTERY),
    u_max=0.4,
    K1=0.25,
    K3=3.0,
    servo_P=150 / 5,
    nHat_B=[0, 0, -1],
    omega_max=math.radians(5.0),
    imageTargetMinimumElevation=math.atan(800 / 500),
    rwBasePower=20,
    maxWheelSpeed=1500,
    # bsk_rl: lambda: np.random.randint(0, 0.01 * dataStorageCapacity)
    storageInit=rand.Uniform(0.0, 0.01 * STORE),
    # bsk_rl: lambda: np.random.uniform(-1, 1, 3)
    wheelSpeeds=rand.Uniform(-1.0, 1.0, 3),
    dataStorageCapacity=STORE,
)


def make(
    num_envs: int = 1, sat_args: dict[str, Any] | None = None, **options: Any
) -> SatelliteTasking:
    """Return ``num_envs`` episodes of the problem; ``sat_args`` and ``options`` replace its own."""
    defaults = dict(
        scenario=AreaTargets((1000, 10_000)),
        rewarder=UncertaintyReward(),
        sim_rate=0.5,
        max_step_duration=PERIOD,  # long enough for every image
        time_limit=3 * PERIOD,
        failure_penalty=0.0,
    )
    # bsk_rl: SatelliteUncertaintyTargets(world_type=world.GroundStationWorldModel, ...
    return SatelliteTasking(
        satellite=Searcher("EO", SAT_ARGS | (sat_args or {})),
        num_envs=num_envs,  # bsk_rl: one episode
        **(defaults | options),
    )


def main() -> None:
    """Image targets at random until the time limit."""
    parser = argparse.ArgumentParser(description="Search for targets at random.")
    parser.add_argument("--num-envs", type=int, default=4, help="episodes at once")
    parser.add_argument(
        "--time-limit", type=float, default=3 * PERIOD, help="length of an episode, s"
    )
    parser.add_argument("--n-targets", type=int, default=1000)
    parser.add_argument("--backend", default="compiled", choices=["compiled", "eager"])
    parser.add_argument(
        "--figure",
        type=Path,
        help="file for a figure of the first episode at the end; needs the extra viz",
    )
    options = parser.parse_args()
    env = make(
        options.num_envs,
        scenario=AreaTargets(options.n_targets),
        time_limit=options.time_limit,
        backend=options.backend,
        seed=1,
    )
    td = env.reset()  # bsk_rl: env.reset(seed=1)
    total = torch.zeros(options.num_envs, 1)
    while not td["done"].any():
        td = env.rand_step(td)["next"]  # bsk_rl: env.step(np.random.randint(0, 32))
        total += td["reward"]
    print(
        "rewards:", total.squeeze(1).tolist()
    )  # bsk_rl: env.unwrapped.rewarder.cum_reward
    # bsk_rl: rewarder.data.imaged, rewarder.data.duplicates
    for name in ("found", "found_again"):
        print(f"{name}:", env.counts()[name].flatten().tolist())
    if options.figure is not None:
        from PIL import Image

        Image.fromarray(env.render(rows=0).numpy()).save(options.figure)


if __name__ == "__main__":
    main()
