"""``bsk-torch build-kernels``: compile the kernels of presets for machines without a compiler."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bsk_torch._listed import LISTED
from bsk_torch.cli.declaration import flag
from bsk_torch.cli.names import check_preset
from bsk_torch.cli.shared import made
from bsk_torch.cli.terminal import echo, refusing, working

if TYPE_CHECKING:
    from bsk_torch.env import Tasking

BATCHES = (1, 4)
"""Sizes of the batches that are played; kernels do not depend on them, but what is prepared in advance does."""

STEPS = 3


def build_kernels(
    presets: Annotated[list[str] | None, typer.Argument(help="Environments; default: all.", show_default=False)] = None,
    out: Annotated[
        Path,
        flag("FOLDER", "Output folder; set BSK_TORCH_KERNELS to its path on the other machines."),
    ] = Path("kernels"),
    isa: Annotated[
        str | None, flag("NAME", "'avx512', 'avx2', or 'default' (plain C++); default: the best of this machine.")
    ] = None,
    mixed: Annotated[bool, typer.Option("--mixed", help="Also compile kernels for mixed precision (sim_dtype=float32).")] = False,
) -> None:
    """Compile the kernels of presets for machines without a compiler.

    The other machines need the same versions of torch and bsk_torch, processors with the same instructions, and a C library at
    least as new.

    Examples:
        bsk-torch build-kernels NadirScan-v1 --isa avx2 --out kernels
        export BSK_TORCH_KERNELS=$PWD/kernels
    """
    for preset in presets or ():
        check_preset(preset)
    with working("starting"):
        import torch

        from bsk_torch.codegen import shipped
    with refusing(), shipped.building(out, isa) as target:
        for preset in presets or LISTED:
            for dtype in (torch.float64, torch.float32)[: 1 + mixed]:
                with working(f"compiling and playing {preset}, {target.isa}, {dtype}"):
                    for batch in BATCHES:
                        play(made(preset, batch, {"sim_dtype": dtype, "seed": 0}))
            echo(f"{preset}: built for {target.isa}")
    libraries = list(target.folder.glob("*.so"))
    echo(f"{target.folder}: {len(libraries)} kernels, {sum(path.stat().st_size for path in libraries) / 1e6:.1f} MB")


def play(env: Tasking) -> None:
    """Play some random steps, whole and partial, with resets in between: whatever an environment needs is compiled then."""
    import torch
    from tensordict import TensorDict

    td = env.reset()
    for _ in range(STEPS):
        td = env.step_and_maybe_reset(env.rand_action(td))[1]
    some = torch.zeros(env.num_envs, 1, dtype=torch.bool)
    some[0] = True
    td = env.rand_action(td).set("_step", some.squeeze(-1))
    env.step(td)
    env.reset(TensorDict({"_reset": some}, [env.num_envs]))
