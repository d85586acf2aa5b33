"""Settings of sphinx-gallery: the folders of tutorials and examples, and how these are executed."""

from __future__ import annotations

import logging
import os
import shlex
import shutil
import tempfile
import warnings
from pathlib import Path
from typing import Any

WIDEST = 84
"""Characters in a line of output that a page shows."""

PICTURES = {".png", ".webp"}
"""Endings of the files that scripts write to be shown."""

ARGUMENTS: dict[str, str] = {
    "examples/areas.py": "--figure areas.png",
    "examples/curriculum.py": "--num-envs 256 --steps 400 --figure curriculum.png",
    "examples/learners_torchrl.py": "--steps 400000 --episodes 256 --figure episode.png",
    "examples/live_requests.py": "--num-envs 16 --steps 200",
    "examples/mappo_benchmarl.py": "--iterations 6 --num-envs 64 --episodes 64 --out {tmp} --figure episode.png",
    "examples/offline_cql.py": "--episodes 32 --time-limit 5700 --steps 2000 --iterations 100",
    "examples/ppo_cleanrl.py": "--steps 400000 --episodes 256 --figure episode.png",
    "examples/ppo_sb3.py": "--num-envs 256 --rollout 32 --steps 400000 --episodes 256 --out {tmp} --figure episode.png",
    "examples/share_intent.py": "--minutes 0.4 --episodes 32 --n-satellites 6 --n-targets 2000 --out {tmp} --figure episode.png",
    "examples/bsk_rl/aeos.py": "S3 --num-envs 4 --figure episode.png",
    "examples/bsk_rl/async_multiagent_training.py": "--iterations 20 --num-envs 32 --figure episode.png",
    "examples/bsk_rl/cloud_environment.py": "--num-envs 4 --figure episode.png",
    "examples/bsk_rl/cloud_environment_with_reimaging.py": "--num-envs 2 --steps 60 --figure episode.png",
    "examples/bsk_rl/communication_action.py": "--num-envs 2 --figure episode.png",
    "examples/bsk_rl/continuous_orbit_maneuvers.py": "--num-envs 4 --figure episode.png",
    "examples/bsk_rl/curriculum_learning.py": "--num-envs 256 --iterations 40 --figure curve.png",
    "examples/bsk_rl/fault_environment.py": "--num-envs 4 --figure episode.png",
    "examples/bsk_rl/mixed_environment.py": "--num-envs 4 --figure episode.png",
    "examples/bsk_rl/multiagent_envs.py": "--num-envs 2 --figure episode.png",
    "examples/bsk_rl/rllib_training.py": "--num-envs 256 --iterations 40 --figure episode.png",
    "examples/bsk_rl/rso_inspection.py": "--num-envs 4 --figure episode.png",
    "examples/bsk_rl/satellite_configuration.py": "--num-envs 2 --figure episode.png",
    "examples/bsk_rl/simple_environment.py": "--num-envs 4 --figure episode.png",
    "examples/bsk_rl/space_to_space_rso_imaging.py": "--num-envs 4 --figure episode.png",
    "examples/bsk_rl/target_location_uncertainty.py": "--num-envs 4 --figure episode.png",
    "examples/bsk_rl/time_discounted_gae.py": "--num-envs 256 --iterations 40 --figure episode.png",
    "examples/bsk_rl/training_with_shield.py": "--num-envs 64 --iterations 20 --figure episode.png",
}
"""Arguments of each example when the site is built, small enough for about a minute; ``{tmp}`` is an empty folder."""

NOT_EXECUTED = ("ppo_rllib",)
"""Scripts shown with what they printed last, since they need a separate environment."""


def name_of(path: str | Path) -> str:
    """Name of a script in :data:`ARGUMENTS`: its path from the folder ``examples`` on."""
    parts = Path(path).parts
    return (
        "/".join(parts[parts.index("examples") :]) if "examples" in parts else parts[-1]
    )


def arguments(gallery_conf: dict[str, Any], script_vars: dict[str, Any]) -> list[str]:
    """Return the command line with which a script is executed."""
    keep_quiet()
    line = ARGUMENTS.get(name_of(script_vars["src_file"]), "")
    return shlex.split(
        line.replace("{tmp}", tempfile.mkdtemp()) if "{tmp}" in line else line
    )


def keep_quiet() -> None:
    """Keep messages of TorchRL out of the pages, which show all output, and make tables fit them."""
    from torchrl import logger

    os.environ["COLUMNS"] = str(WIDEST)
    logger.setLevel(logging.WARNING)
    warnings.filterwarnings("ignore", module="torchrl", category=FutureWarning)


def written_pictures(
    block: Any, block_vars: dict[str, Any], gallery_conf: dict[str, Any]
) -> str:
    """Show the command of an example, and the figures written by a block into its working directory.

    They are shown in the order of their making, and moved away.
    """
    from sphinx_gallery.scrapers import figure_rst

    found = [path for path in Path.cwd().iterdir() if path.suffix in PICTURES]
    moved = []
    for path in sorted(found, key=lambda path: path.stat().st_mtime_ns):
        place = Path(next(block_vars["image_path_iterator"])).with_suffix(path.suffix)
        shutil.move(path, place)
        moved.append(str(place))
    return executed(block_vars["src_file"]) + figure_rst(moved, gallery_conf["src_dir"])


def executed(path: str) -> str:
    """Return the command line of an example as text of a page; nothing for tutorials."""
    name = name_of(path)
    if name not in ARGUMENTS:
        return ""
    command = f"python {name} {ARGUMENTS[name].replace('{tmp}', 'runs/example')}"
    return f"\nExecuted as\n\n.. code-block:: text\n\n    {command}\n\n"


SOURCES = {"tutorials": "_tutorials", "../examples": "gallery"}
"""Folders of programs, and the folders that their pages go to."""


def settings(execute: bool) -> dict[str, Any]:
    """Return sphinx-gallery's settings, with which programs are executed or only shown."""
    return {
        "examples_dirs": list(SOURCES),
        "gallery_dirs": list(SOURCES.values()),
        "plot_gallery": execute,
        "filename_pattern": rf"/(?!{'|'.join(NOT_EXECUTED)})[^/]*\.py$",
        "within_subsection_order": "FileNameSortKey",
        "image_scrapers": ("matplotlib", written_pictures),
        "reset_argv": arguments,
        "capture_repr": (),
        "remove_config_comments": True,
        "thumbnail_size": (400, 280),
        "min_reported_time": 1,
        "only_warn_on_example_error": False,
        "download_all_examples": False,
        "show_signature": False,
        "write_computation_times": False,  # a page that loads scripts from elsewhere
        "backreferences_dir": None,
    }
