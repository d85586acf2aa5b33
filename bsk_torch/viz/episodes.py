"""Record and draw one episode, whatever the kind of environment."""

from __future__ import annotations

from pathlib import Path

from bsk_torch.act import Image
from bsk_torch.env import ConstellationTasking, SatelliteTasking, Tasking
from bsk_torch.tasks.inspection.figure import InspectionEpisode, inspection_figure
from bsk_torch.tasks.objects.figure import RSOImagingEpisode, services_figure
from bsk_torch.viz.figures.constellation import ConstellationEpisode, constellation_figure
from bsk_torch.viz.figures.ground_track import ground_track
from bsk_torch.viz.figures.style import WIDTH
from bsk_torch.viz.figures.timeline import timeline
from bsk_torch.viz.recorders.constellation import record_constellation
from bsk_torch.viz.recorders.imaging import ImagingEpisode, record_imaging_episode
from bsk_torch.viz.recorders.inspection import inspects, record_inspection
from bsk_torch.viz.recorders.rso_imaging import images_objects, record_rso_imaging
from bsk_torch.viz.recorders.track import TrackEpisode, record_track
from bsk_torch.wrappers.policies import Actor, policy_of_one

Recorded = TrackEpisode | ConstellationEpisode | InspectionEpisode | RSOImagingEpisode
"""Recorded episode of one satellite (an :class:`ImagingEpisode` where it images targets), of a constellation, or of imagers or
inspectors of others."""


def record(policy: Actor, env: Tasking, *, seed: int) -> Recorded:
    """Play the first episode of ``seed`` in row 0 of ``env``, with the most probable actions.

    The recorder is chosen by the environment: :func:`~bsk_torch.viz.recorders.constellation.record_constellation`,
    :func:`~bsk_torch.viz.recorders.inspection.record_inspection` for one with the points of an RSO,
    :func:`~bsk_torch.viz.recorders.rso_imaging.record_rso_imaging` for one with a catalog of objects,
    :func:`~bsk_torch.viz.recorders.imaging.record_imaging_episode` for a satellite with the action
    :class:`~bsk_torch.act.Image`, or :func:`~bsk_torch.viz.recorders.track.record_track`. With one satellite, the policy is what
    :func:`~bsk_torch.wrappers.policies.policy_of_one` takes; with many, a module that writes the actions of all agents.
    """
    if isinstance(env, ConstellationTasking):
        if images_objects(env):
            return record_rso_imaging(policy, env, seed=seed)
        return (record_inspection if inspects(env) else record_constellation)(policy, env, seed=seed)
    assert isinstance(env, SatelliteTasking)
    policy = policy_of_one(policy, env.satellite)
    images = any(isinstance(entry, Image) for entry in env.satellite.actions.entries)
    return (record_imaging_episode if images else record_track)(policy, env, seed=seed)


def draw(episode: Recorded, path: Path | str, title: str = "", width: float = WIDTH) -> Path:
    """Draw a recorded episode to the file ``path``, .png, .svg or .pdf, and return its path.

    A constellation is drawn on a map with tasks over time, an inspection as paths around the RSO with its points, imaging in
    orbit as images and downlinks over time, an imager on a map with its targets, and any other satellite as modes and resources
    over time. ``title`` is the headline, and ``width`` in inches, such as :data:`~bsk_torch.viz.figures.style.COLUMN`.
    """
    path = Path(path)
    if isinstance(episode, ConstellationEpisode):
        return constellation_figure(episode, path, title, width)
    if isinstance(episode, InspectionEpisode):
        return inspection_figure(episode, path, title, width)
    if isinstance(episode, RSOImagingEpisode):
        return services_figure(episode, path, title, width)
    if isinstance(episode, ImagingEpisode):
        return ground_track(episode, path, title, width)
    return timeline(episode, path, title, width=width)
