"""Record and draw one episode, whatever the kind of environment."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from torch import Tensor
from typing_extensions import Self

from bsk_torch import recording as recordings
from bsk_torch._rooms import resolve
from bsk_torch.env import Tasking
from bsk_torch.recording.reading import Reading
from bsk_torch.recording.recording import Recording
from bsk_torch.recording.scenes import QUANTITIES
from bsk_torch.recording.table import Columns, Tabular, Tasks, satellite_columns
from bsk_torch.viz.figures.style import WIDTH
from bsk_torch.wrappers.policies import Actor

KINDS = {
    "timeline": "bsk_torch.viz.figures.timeline:TrackEpisode",
    "ground_track": "bsk_torch.viz.figures.ground_track:ImagingEpisode",
    "constellation": "bsk_torch.viz.figures.constellation:ConstellationEpisode",
    "inspection": "bsk_torch.tasks.inspection.figure:InspectionEpisode",
    "areas": "bsk_torch.tasks.areas.figure:AreaEpisode",
    "rso_imaging": "bsk_torch.tasks.objects.figure:RSOImagingEpisode",
}
"""Module and class of what figures show of a recording, by its kind."""


class Picture(NamedTuple):
    """A picture of an episode: a function of a path, a title and a width, its caption, its description, and a usual title."""

    draw: Callable[..., Path]
    caption: str
    alternative: str
    title: str = ""


class Episode(Tabular):
    """What figures and tables show of one flight of a recording. Subclasses are dataclasses of tensors on the CPU."""

    @classmethod
    @abstractmethod
    def of(cls, recording: Recording, track: int = 0) -> Self:
        """Return the episode of a track."""

    @property
    @abstractmethod
    def outcome(self) -> str:
        """Outcome of the episode as text."""

    @abstractmethod
    def pictures(self) -> list[Picture]:
        """Return the pictures of the episode in a report, of which the last one shows all of it."""


@dataclass(frozen=True, kw_only=True)
class TeamEpisode(Episode):
    """An episode of S satellites with B boundaries of steps; times are seconds since the reset.

    Attributes:
        names: Names of the satellites.
        times: The boundaries, ascending, [B].
        rewards: Reward of each satellite's agent in the steps, [S, B - 1]; NaN for further satellites of the same agent.
        deaths: When each satellite died, infinite for survivors, [S].
        tasks: What they did.
        series: Quantities at the boundaries by name, [S, B, width] each; see :data:`bsk_torch.recording.scenes.QUANTITIES`.
        actions: Actions of real numbers in the steps, [S, B - 1, A]; NaN for none. None without such actions.
    """

    names: Sequence[str]
    times: Tensor
    rewards: Tensor
    deaths: Tensor
    tasks: Tasks
    series: Mapping[str, Tensor]
    actions: Tensor | None = None

    @staticmethod
    def flown(reading: Reading) -> dict[str, Any]:
        """Return the attributes that episodes of all kinds have."""
        names = ("names", "times", "rewards", "deaths", "tasks", "actions")
        series = {name: values for name in QUANTITIES if (values := reading.values(name)) is not None}
        return {name: getattr(reading, name) for name in names} | {"series": series}

    def table(self, numbers: Mapping[str, Tensor]) -> Columns:
        """Return the table of :func:`~bsk_torch.recording.table.satellite_columns` with rewards, actions and other numbers."""
        actions = {} if self.actions is None else {"action": self.actions}
        columns = {"reward": self.rewards, **actions, **numbers}
        return satellite_columns(self.names, self.times, self.deaths, self.tasks, columns)


def episode_of(recording: Recording, track: int = 0) -> Episode:
    """Return what figures and tables show of a track; ValueError for a recording of an older version."""
    if recording.kind not in KINDS:
        raise ValueError(f"kind={recording.kind!r} is none of {list(KINDS)}: record the episode again with this version")
    kind: type[Episode] = resolve(KINDS[recording.kind])
    return kind.of(recording, track)


def record(policy: Actor, env: Tasking, *, seed: int) -> Episode:
    """Play the first episode of ``seed`` in row 0 of ``env``, with the most probable actions.

    Its class is that of :data:`KINDS`: of a constellation, or of the task of its rewarder, such as an inspection; of a satellite
    with the action :class:`~bsk_torch.act.Image`, or of any other one. See :func:`bsk_torch.recording.record` for errors.
    """
    return episode_of(recordings.record(env, policy, seed=seed))


def draw(episode: Episode, path: Path | str, title: str = "", width: float = WIDTH) -> Path:
    """Draw a recorded episode to the file ``path``, .png, .svg or .pdf, and return its path.

    A constellation is drawn on a map with tasks over time, an inspection as paths around the RSO with its points, imaging in
    orbit as images and downlinks over time, an imager on a map with its targets, and any other satellite as modes and resources
    over time. ``title`` is the headline, and ``width`` in inches, such as :data:`~bsk_torch.viz.figures.style.COLUMN`.
    """
    return episode.pictures()[-1].draw(Path(path), title=title, width=width)
