"""Recordings and pictures of episodes, by the kind of environment; they need the extra ``viz``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from bsk_torch.cli.shared import extra

if TYPE_CHECKING:
    from tensordict.nn import TensorDictModuleBase

    from bsk_torch.env import Tasking

EPISODES = "bsk_torch.viz.episodes"

FILES = {
    "ConstellationEpisode": "constellation.png",
    "InspectionEpisode": "inspection.png",
    "RSOImagingEpisode": "rso_imaging.png",
    "ImagingEpisode": "ground_track.png",
    "TrackEpisode": "timeline.png",
}
"""Name of the picture by the kind of the recorded episode."""


def record(policy: TensorDictModuleBase, env: Tasking, seed: int) -> Any:
    """Record the first episode of ``seed`` in row 0 of ``env``: of a constellation, an inspection, an imager, ..."""
    return extra(EPISODES).record(policy, env, seed=seed)


def draw_episode(episode: object, folder: Path, title: str) -> Path:
    """Draw a recorded episode into ``folder``: satellites on a map, about an RSO, above targets, or modes over time."""
    return extra(EPISODES).draw(episode, folder / FILES[type(episode).__name__], title)
