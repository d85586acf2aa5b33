"""
Curriculum per environment
==========================

Raise the difficulty of an environment after every survived episode, and lower it after every death.

On the command line::

    python examples/curriculum.py
    python examples/curriculum.py --num-envs 64 --steps 400 --rise 0.05 --fall 0.1

At higher levels, the satellite of NadirScan-v1 starts with less charge and faster wheels. A rule is used instead of a learning
policy. The curriculum runs between a step and the following resets:

- Arguments that depend on the level are ``rand.per_env`` tensors, with one or three numbers per environment.
- When episodes end, their levels and the tensors are updated, and ``env.set_sat_args(..., envs=ended)`` makes these environments
  draw again. This needs no recompilation.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from torchrl.envs.utils import step_mdp

import bsk_torch
from bsk_torch import rand
from bsk_torch.presets.nadir_scan import BATTERY

SCAN, CHARGE, DOWNLINK, DESAT = range(4)

CHARGES = 0.9, 0.1
"""Initial charge at levels 0 and 1, as a fraction of the battery's capacity."""

SPEEDS = 500.0, 5900.0
"""Initial speed of the wheels at levels 0 and 1, rpm."""


class Curriculum:
    """Difficulty levels [N] from 0 to 1, and the corresponding satellite arguments."""

    def __init__(self, num_envs: int, rise: float, fall: float) -> None:
        """Start at level 0; a success adds ``rise``, a failure subtracts ``fall``."""
        self.rise, self.fall = rise, fall
        self.level = torch.zeros(num_envs, dtype=torch.float64)
        self.charge, self.wheels = (
            torch.zeros_like(self.level),
            torch.zeros(num_envs, 3, dtype=torch.float64),
        )
        self.args = {
            "storedCharge_Init": rand.per_env(self.charge),
            "wheelSpeeds": rand.per_env(self.wheels),
        }
        self._write()

    def record(self, ended: Tensor, survived: Tensor) -> None:
        """Change the levels of the episodes that ``ended`` [N], by whether they ``survived`` [N]."""
        change = torch.where(survived, self.rise, -self.fall)
        self.level = torch.where(ended, self.level + change, self.level).clamp(0.0, 1.0)
        self._write()

    def _write(self) -> None:
        self.charge.copy_(
            BATTERY
            * torch.lerp(
                torch.full_like(self.level, CHARGES[0]),
                self.level.new_tensor(CHARGES[1]),
                self.level,
            )
        )
        speed = SPEEDS[0] + (SPEEDS[1] - SPEEDS[0]) * self.level
        self.wheels.copy_(speed.unsqueeze(-1) * speed.new_tensor([1.0, -1.0, 1.0]))


def rule(satellite: Any) -> Tensor:
    """Return actions [N]: charge below 40 %, slow down wheels above 70 %, downlink above 90 %, else scan."""
    state = satellite.dynamics
    action = torch.full(state.battery_charge_fraction.shape, SCAN)
    action[state.storage_level_fraction > 0.9] = DOWNLINK
    action[state.wheel_speeds_fraction.abs().amax(-1) > 0.7] = DESAT
    action[state.battery_charge_fraction < 0.4] = CHARGE
    return action


def draw(levels: Tensor, path: Path) -> None:
    """Plot mean and range of levels [T, N] over the steps to a file."""
    from bsk_torch.viz.figures import style

    figure, (panel,) = style.panels([3.0])
    steps = range(1, len(levels) + 1)
    panel.fill_between(
        steps,
        levels.amin(1),
        levels.amax(1),
        color=style.PALETTE[0],
        alpha=0.15,
        linewidth=0,
    )
    panel.plot(steps, levels.mean(1), color=style.PALETTE[0])
    style.label(panel, "level: mean, least and largest")
    panel.set_xlabel("steps")
    style.save(figure, path)


def main() -> None:
    """Play, and print the levels."""
    parser = argparse.ArgumentParser(
        description="Let the difficulty of each environment follow its success."
    )
    parser.add_argument("--num-envs", type=int, default=32)
    parser.add_argument("--steps", type=int, default=200)
    parser.add_argument("--time-limit", type=float, default=5700.0, help="s")
    parser.add_argument("--rise", type=float, default=0.1)
    parser.add_argument("--fall", type=float, default=0.2)
    parser.add_argument("--backend", choices=("compiled", "eager"), default="compiled")
    parser.add_argument(
        "--figure",
        type=Path,
        help="file for a figure of the levels; needs the extra viz",
    )
    args = parser.parse_args()

    curriculum = Curriculum(args.num_envs, args.rise, args.fall)
    env = bsk_torch.make(
        "NadirScan-v1",
        num_envs=args.num_envs,
        sat_args=curriculum.args,
        time_limit=args.time_limit,
        backend=args.backend,
        seed=1,
    )
    kernel, episodes, successes = env.simulator.tick, 0, 0
    levels, state = [], env.reset()
    for step in range(1, args.steps + 1):
        state["action"] = rule(env.satellite)
        state = step_mdp(env.step(state))
        ended = state["done"].squeeze(-1)
        if ended.any():
            survived = ~env.dead
            curriculum.record(ended, survived)
            env.set_sat_args(curriculum.args, envs=ended)
            episodes, successes = (
                episodes + int(ended.sum()),
                successes + int((ended & survived).sum()),
            )
            state = env.maybe_reset(state)
        levels.append(curriculum.level.clone())
        if step % max(1, args.steps // 10) == 0:
            mean, low, high = (
                curriculum.level.mean(),
                curriculum.level.min(),
                curriculum.level.max(),
            )
            print(
                f"step {step}: {episodes} episodes, {successes} survived, level {mean:.2f} ({low:.2f} to {high:.2f})"
            )
    print(
        "nothing was rebuilt" if env.simulator.tick is kernel else "a tick was rebuilt"
    )
    if args.figure is not None:
        draw(torch.stack(levels), args.figure)


if __name__ == "__main__":
    main()
