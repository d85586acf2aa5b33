"""``bsk-torch build-kernels``: compile the kernels of presets for machines without a compiler."""

from __future__ import annotations

from pathlib import Path

import torch
from tensordict import TensorDict

from bsk_torch.cli.shared import made
from bsk_torch.cli.terminal import echo, fail, working
from bsk_torch.codegen import shipped
from bsk_torch.env import Tasking
from bsk_torch.presets import PRESETS

BATCHES = (1, 4)
"""Sizes of the batches that are played; kernels do not depend on them, but what is prepared in advance does."""

STEPS = 3


def build_kernels(presets: list[str] | None, out: Path, isa: str | None, mixed: bool) -> None:
    """Compile the kernels of presets for machines without a compiler; see :mod:`bsk_torch.cli.main`."""
    for preset in presets or ():
        if preset not in PRESETS:
            fail(f"{preset!r} is no preset; they are {', '.join(PRESETS)}")
    try:
        with shipped.building(out, isa) as target:
            for preset in presets or PRESETS:
                for dtype in (torch.float64, torch.float32)[: 1 + mixed]:
                    with working(f"compiling and playing {preset}, {target.isa}, {dtype}"):
                        for batch in BATCHES:
                            play(made(preset, batch, {"sim_dtype": dtype, "seed": 0}))
                echo(f"{preset}: built for {target.isa}")
    except ValueError as error:
        fail(str(error))
    libraries = list(target.folder.glob("*.so"))
    echo(f"{target.folder}: {len(libraries)} kernels, {sum(path.stat().st_size for path in libraries) / 1e6:.1f} MB")


def play(env: Tasking) -> None:
    """Play some random steps, whole and partial, with resets in between: whatever an environment needs is compiled then."""
    td = env.reset()
    for _ in range(STEPS):
        td = env.step_and_maybe_reset(env.rand_action(td))[1]
    some = torch.zeros(env.num_envs, 1, dtype=torch.bool)
    some[0] = True
    td = env.rand_action(td).set("_step", some.squeeze(-1))
    env.step(td)
    env.reset(TensorDict({"_reset": some}, [env.num_envs]))
