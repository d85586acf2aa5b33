"""Recordings and pictures of episodes, by the kind of environment; they need the extra ``viz``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from bsk_torch.cli.shared import extra
from bsk_torch.env import SatelliteTasking, Tasking
from bsk_torch.rl.rules.targets import image_actions

if TYPE_CHECKING:
    from tensordict.nn import TensorDictModuleBase

RECORDERS = {
    "constellation": ("bsk_torch.viz.recorders.constellation", "record_constellation"),
    "imaging": ("bsk_torch.viz.recorders.imaging", "record_imaging_episode"),
    "track": ("bsk_torch.viz.recorders.track", "record_track"),
}
"""Modules and functions that record an episode, by what is shown of it."""


def record(policy: TensorDictModuleBase, env: Tasking, seed: int) -> Any:
    """Record the first episode of ``seed`` in row 0 of ``env``: of a constellation, an imager or another satellite."""
    module, function = RECORDERS[_kind(env)]
    return getattr(extra(module), function)(policy, env, seed=seed)


def _kind(env: Tasking) -> str:
    """Return the name of the recorder that fits, one of :data:`RECORDERS`."""
    if not isinstance(env, SatelliteTasking):
        return "constellation"
    try:
        image_actions(env)
    except ValueError:  # no targets
        return "track"
    return "imaging"


def draw_episode(episode: Any, folder: Path, title: str) -> Path:
    """Draw a recorded episode into ``folder``: all satellites on a map, one above its targets, or modes over time."""
    if isinstance(episode, extra("bsk_torch.viz.figures.constellation").ConstellationEpisode):
        return extra("bsk_torch.viz.figures.constellation").constellation_figure(episode, folder / "constellation.png", title)
    if isinstance(episode, extra("bsk_torch.viz.recorders.imaging").ImagingEpisode):
        return extra("bsk_torch.viz.figures.ground_track").ground_track(episode, folder / "ground_track.png", title)
    return extra("bsk_torch.viz.figures.timeline").timeline(episode, folder / "timeline.png", title)
