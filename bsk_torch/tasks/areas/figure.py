"""Figure of an episode over areas: the timeline of the satellite, and a map of the cells and of what became of them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import torch
from torch import Tensor
from typing_extensions import Self, override

from bsk_torch.recording.reading import Reading
from bsk_torch.recording.recording import Recording
from bsk_torch.viz.episodes import Picture
from bsk_torch.viz.figures.style import PALETTE
from bsk_torch.viz.figures.timeline import TrackEpisode, track_map

OPEN, DONE = "#9aa3af", PALETTE[2]
"""Colors of cells that have not been recorded, and of those that have."""


@dataclass(frozen=True, kw_only=True)
class AreaEpisode(TrackEpisode):
    """A :class:`~bsk_torch.viz.figures.timeline.TrackEpisode` over areas of C cells."""

    r_CP_P: Tensor  # Earth-fixed positions of the cells, [C, 3] m
    recorded_at: Tensor  # end of the step in which each was first recorded, infinite for never, [C] s

    @override
    @classmethod
    def of(cls, recording: Recording, track: int = 0) -> Self:
        reading = Reading(recording, track)
        done = reading.array("mark_time")[:, reading.track.marks.index("done")]
        return cls(**vars(TrackEpisode.of(recording, track)), r_CP_P=reading.of_scene("targets_P"), recorded_at=done)

    @property
    @override
    def outcome(self) -> str:
        return f"{int(torch.isfinite(self.recorded_at).sum())} of {len(self.recorded_at)} cells recorded, {super().outcome}"

    @override
    def pictures(self) -> list[Picture]:
        """Return the timeline, and the map of track and cells."""
        done = torch.isfinite(self.recorded_at)
        places = ("cell", OPEN, self.r_CP_P[~done]), ("recorded", DONE, self.r_CP_P[done])
        caption = (
            "Where the satellite flew, colored by mode, and the cells of the areas: gray, or green where they were recorded."
        )
        world = Picture(partial(track_map, self, places=places), caption, "World map with ground track and areas")
        return [super().pictures()[-1], world]
