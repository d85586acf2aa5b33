"""The kernels of the default tests, which are built before these on all cores: ``python -m tests.support.kernels``."""

import json
import logging
import os
import sys
from multiprocessing import get_context
from pathlib import Path

FIRST = ("NadirScan-v1", "RSOInspection-v1", "Services-v1", "HeteroCluster-v1", "ThreeSensors-v1", "AEOSBench-v1")
"""Presets that share the fewest kernels with others, built first, so that two processes do not compile the same kernel."""


def listed() -> frozenset[str]:
    """Names of the kernels that have been built for the default tests."""
    file = _file()
    return frozenset(json.loads(file.read_text())) if file.exists() else frozenset()


def _file() -> Path:
    from bsk_torch.codegen.cache import cache_folder

    return cache_folder() / "default_tests.json"


def build(preset: str) -> list[str]:
    """Compile and play a preset; returns the names of its kernels."""
    import torch

    import bsk_torch
    from bsk_torch.cli.kernels import play
    from bsk_torch.codegen import build

    torch.set_num_threads(1)
    logging.disable()  # random actions have much to log
    build.LOADED.clear()  # of the preset that this process has built before
    play(bsk_torch.make(preset, num_envs=2, seed=0))
    return [Path(name).stem for name in build.LOADED]


def main() -> None:
    """Build what the cache lacks."""
    from bsk_torch.presets import PRESETS

    presets = [*FIRST, *(name for name in PRESETS if name not in FIRST)]
    try:
        with get_context("spawn").Pool(os.cpu_count()) as pool:
            names = {name for kernels in pool.imap_unordered(build, presets) for name in kernels}
    except RuntimeError as error:
        sys.exit(str(error))
    _file().write_text(json.dumps(sorted(names)))


if __name__ == "__main__":
    main()
