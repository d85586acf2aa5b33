"""Plays presets with kernels of another compiler, other vector instructions or sanitizers, beside the eager back end.

Usage: python -m tests.codegen.other_builds PRESET ... [--sanitize] [--aarch64] [--eager=FOLDER]

``CXX`` and ``BSK_TORCH_ISA`` choose compiler and instructions. A line for each preset has the largest differences of observations
and rewards; the exit status is 1 where they are too large. What the eager back end shows is kept in FOLDER, and read from it by
later builds. With ``--sanitize`` kernels check addresses and undefined behaviour, which needs the runtime of the sanitizers in
``LD_PRELOAD``; a report ends the process. With ``--aarch64`` kernels are built for that processor and run in an
emulator, whatever the variables are.
"""

import sys
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase

import bsk_torch
from bsk_torch.codegen import build
from tests.codegen import emulated
from tests.support.choices import legal_actions

STEPS, ENVS = 6, 5

LARGEST = 1e-7
"""Largest difference of an observation or a reward: orbits solved in another order of rounding differ by micrometres, and
times of windows, over 5,700 s in an observation, by less than a millisecond."""

SANITIZE = ("-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-fno-omit-frame-pointer", "-O1")


def play(preset: str, backend: str) -> list[TensorDictBase]:
    """Return what a few steps of a preset show; in the middle, two episodes begin again and two stand still."""
    options: dict[str, Any] = dict(num_envs=ENVS, seed=3, dtype=torch.float64, backend=backend, time_limit=3000.0)
    env = bsk_torch.make(preset, **options)
    td, seen = env.reset(), []
    for step in range(STEPS):
        td = legal_actions(td, env.action_keys, step)
        if step == STEPS // 2:
            td["_step"] = torch.arange(ENVS).unsqueeze(1) >= 2 if env.batch_size == (ENVS, 1) else torch.arange(ENVS) >= 2
        td = env.step(td)["next"]
        seen.append(td.clone())
        if step == 1:
            td = env.reset(td.set("_reset", (torch.arange(ENVS) < 2).unsqueeze(1)))
    return seen


def played_eagerly(preset: str, folder: Path | None) -> list[TensorDictBase]:
    """Return what a few steps show in the eager back end, which no build changes; read from ``folder`` if it is there."""
    if folder is None:
        return play(preset, "eager")
    path = folder / f"{preset}.pt"
    if not path.exists():
        torch.save([td.exclude("state").to_dict() for td in play(preset, "eager")], path)
    return [TensorDict(kept) for kept in torch.load(path)]


def differences(preset: str, folder: Path | None) -> dict[str, float]:
    """Return the largest difference of each output of the two back ends."""
    worst: dict[str, float] = {}
    for eager, compiled in zip(played_eagerly(preset, folder), play(preset, "compiled"), strict=True):
        for key in eager.keys(True, True):
            name = key if isinstance(key, str) else key[-1]
            if name in ("observation", "reward", "duration"):
                worst[name] = max(worst.get(name, 0.0), float((eager[key] - compiled[key]).abs().max()))
    return worst


def main(presets: list[str], options: list[str], folder: Path | None) -> int:
    """Play the presets; return the exit status."""
    torch.set_num_threads(1)
    if "--sanitize" in options:
        build.FLAGS = (*build.FLAGS, *SANITIZE)
    if "--aarch64" in options:
        emulated.install()
    failed = 0
    for preset in presets:
        found = differences(preset, folder)
        failed |= not found or max(found.values()) > LARGEST
        sys.stdout.write(f"{preset} {found}\n")
        sys.stdout.flush()
    return int(failed)


if __name__ == "__main__":
    given = sys.argv[1:]
    options = [word for word in given if word.startswith("--")]
    folders = [Path(word.removeprefix("--eager=")) for word in options if word.startswith("--eager=")]
    sys.exit(main([word for word in given if word not in options], options, folders[0] if folders else None))
