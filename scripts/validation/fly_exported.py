"""Fly a policy exported as C: in bsk_torch, next to the policy of the package, and on Basilisk, where the C code decides.

    python scripts/validation/fly_exported.py runs/scan --here 0:200 --seeds 0:10
    python scripts/validation/fly_exported.py bsk_torch/rl/policies/AEOS-v1.pt --seeds 0:10

Both are asked at every decision, and the actions are compared. Where they differ, the lead of the package's action over that of
the C code is printed, in logits. On Basilisk, the episodes are those of ``fly_on_basilisk.py``, and need the extra ``basilisk``;
``--seeds none`` leaves them out. A C compiler, ``$CC`` or ``cc``, is needed.
"""

from __future__ import annotations

import argparse
import ctypes
import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import torch
from flight_policy import policy_pilot, recruit
from fly_on_basilisk import seeds_of
from tensordict import TensorDict
from torch import Tensor

from bsk_torch.env import SatelliteTasking
from bsk_torch.env.rollout import play_episodes
from bsk_torch.lab.basilisk.certificate import as_sets
from bsk_torch.lab.basilisk.flight import lacking, problem_of, starts_of
from bsk_torch.lab.export import export_policy
from bsk_torch.presets import make
from bsk_torch.rl.evaluation.evaluate import start_episodes
from bsk_torch.rl.policies.files import policy_of_file

BATCH = 50
"""Episodes at once in bsk_torch."""


class Reader:
    """The C function of an exported folder, and the memory of a recurrent policy in each episode."""

    def __init__(self, folder: Path, shapes: Mapping[str, Sequence[int]]) -> None:
        """Compile it, and repeat its record; CalledProcessError if the compiler or the record fails. ``shapes`` are of inputs."""
        compiler, flags = os.environ.get("CC", "cc"), ["-std=c99", "-Wall", "-Wextra", "-Werror", "-O2"]
        library, replay = folder / "policy.so", folder / "replay"
        subprocess.run([compiler, *flags, "-s", "-shared", "-fPIC", folder / "policy.c", "-o", library, "-lm"], check=True)
        sources = [folder / "policy.c", folder / "replay.c"]
        subprocess.run([compiler, *flags, *sources, "-o", replay, "-lm"], check=True)
        self.replayed = subprocess.run([replay], check=True, capture_output=True, text=True).stdout.strip()
        self.bytes = library.stat().st_size
        self.act = ctypes.CDLL(str(library)).bsk_policy_act
        self.paths = [tuple(name.split(".")) for name in shapes if name not in ("memory", "action_mask")]
        self.width = shapes["memory"][-1] if "memory" in shapes else 0

    def start(self, episodes: int) -> None:
        """Start episodes, which clears their memory."""
        self.memory = np.zeros((episodes, self.width), np.float32)

    def __call__(self, seen: TensorDict, episodes: Sequence[int]) -> Tensor:
        """Return the actions [N] for observations and masks of N of the episodes."""
        vector = torch.cat([seen[path].float().flatten(1) for path in self.paths], -1).contiguous().numpy()
        mask = seen["action_mask"].to(torch.uint8).contiguous().numpy()
        out = np.empty(mask.shape[-1], np.float32)
        actions = []
        for k, episode in enumerate(episodes):
            rows = (vector[k], mask[k], *([self.memory[episode]] if self.width else []), out)
            actions.append(self.act(*(ctypes.c_void_p(row.ctypes.data) for row in rows)))
        return torch.tensor(actions)


class Agreement:
    """Counts decisions, and those in which the package and the C code choose the same."""

    def __init__(self) -> None:
        """Start without decisions."""
        self.decisions, self.same, self.least = 0, 0, float("inf")
        self.leads: list[float] = []

    def add(self, ours: Tensor, theirs: Tensor, logits: Tensor, mask: Tensor) -> None:
        """Compare actions [N], with the package's logits [N, A] and the mask [N, A]."""
        self.decisions, self.same = self.decisions + len(ours), self.same + int((ours == theirs).sum())
        some = logits.masked_fill(~mask, -torch.inf)
        two = some[mask.sum(-1) > 1].topk(2).values
        self.least = min(self.least, float((two[:, 0] - two[:, 1]).min())) if len(two) else self.least
        apart = ours != theirs
        self.leads += (some.gather(1, ours[:, None]) - some.gather(1, theirs[:, None]))[apart, 0].tolist()

    def __str__(self) -> str:
        text = f"{self.same:,} of {self.decisions:,} decisions the same; least lead of an action {self.least:.1e} in logits"
        return text + (f"; leads where they differ: {self.leads}" if self.leads else "")


def fly_here(policy_file: str, preset: str, options: dict[str, object], reader: Reader, seeds: range) -> Agreement:
    """Fly episodes by the package's policy, and ask the C code at each decision."""
    agreement, policy = Agreement(), policy_of_file(policy_file)
    for first in range(0, len(seeds), BATCH):
        some = seeds[first : first + BATCH]
        env = make(preset, num_envs=len(some), env_ids=[0] * len(some), **options)
        reader.start(len(some))
        for playing, step in play_episodes(env, policy, start_episodes(env, some)):
            asked = step[playing]
            agreement.add(asked["action"], reader(asked, playing.nonzero()[:, 0].tolist()), asked["logits"], asked["action_mask"])
    return agreement


def fly_there(env: SatelliteTasking, preset: str, policy_file: str, is_set: bool, reader: Reader, seeds: range) -> Agreement:
    """Let the C code fly episodes on Basilisk, and ask the package's policy at each decision."""
    from bsk_torch.lab.basilisk.reference_env import fly_there as fly

    start_episodes(env, seeds)
    problem, agreement = problem_of(env, preset), Agreement()
    package = policy_pilot(policy_of_file(policy_file), problem.observed if is_set else ())

    def pilot(seen: TensorDict, asked: Sequence[int], step: int) -> tuple[Tensor, Tensor]:
        ours, logits = package(seen, asked, step)
        vector = seen["observation"].float()
        what = as_sets(vector, problem.observed) if is_set else vector
        if step == 0:
            reader.start(1)
        theirs = reader(TensorDict({"observation": what, "action_mask": seen["action_mask"]}, seen.batch_size), [0])
        agreement.add(ours, theirs, logits, seen["action_mask"])
        return theirs, logits

    starts, terminal = starts_of(env, seeds), os.dup(1)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # Basilisk talks
    for start in starts:
        flight = fly(problem, start, pilot)
        print(f"  seed {flight.seed}: return {flight.returns:.4f}, {flight.decisions} decisions", file=sys.stderr)
    os.dup2(terminal, 1)
    return agreement


def main(given: list[str] | None = None) -> None:
    """Export, compile, fly and print."""
    parser = argparse.ArgumentParser(description="Fly a policy exported as C, here and on Basilisk.")
    parser.add_argument("policy", metavar="POLICY", help="folder of a training or its policy.pt")
    parser.add_argument("--here", type=seeds_of, default=range(200), metavar="A:B", help="episodes in bsk_torch (default: 0:200)")
    parser.add_argument("--seeds", default="0:10", metavar="A:B", help="episodes on Basilisk, or 'none' (default: 0:10)")
    options = parser.parse_args(given)
    torch.set_num_threads(1)
    flyer = recruit(options.policy, None)
    if options.seeds != "none" and (missing := lacking()):
        sys.exit(missing)
    with tempfile.TemporaryDirectory() as folder:
        (contract,) = export_policy(options.policy, folder, ["c"]).values()
        reader = Reader(Path(folder), {row["name"]: row["shape"] for row in contract["inputs"]})
    print(
        f"{flyer.preset}: {reader.replayed}; {contract['network']['parameters'] * 4:,} bytes of weights, {reader.bytes:,} in all"
    )
    here = fly_here(options.policy, flyer.preset, flyer.options, reader, options.here)
    print(f"{len(options.here)} episodes in bsk_torch: {here}", flush=True)
    if options.seeds != "none":
        seeds = seeds_of(options.seeds)
        env = flyer.environment(len(seeds))
        there = fly_there(env, flyer.preset, options.policy, bool(flyer.options.get("as_set")), reader, seeds)
        print(f"{len(seeds)} episodes on Basilisk, flown by the C code: {there}")
        sys.exit(there.same < there.decisions or here.same < here.decisions)
    sys.exit(here.same < here.decisions)


if __name__ == "__main__":
    main()
