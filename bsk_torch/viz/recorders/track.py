"""Recorder of one episode of a policy with the satellite's track, for maps."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch.astro.frames import fixed_to_lla
from bsk_torch.env import SatelliteTasking
from bsk_torch.env.rollout import Policy
from bsk_torch.sim.access.visibility.planned import position_between, take_rows
from bsk_torch.sim.environment.ephemeris import EPHEMERIS_TRACK, fixed
from bsk_torch.sim.orbit.arcs import ARC, Arcs, segments_for
from bsk_torch.sim.places import FixedPlaces
from bsk_torch.sim.simulator import Simulator
from bsk_torch.viz.recorders.episode import Episode, Recorder

SAMPLE = 30.0
"""Seconds between the samples of a ground track."""


@dataclass(frozen=True, kw_only=True)
class TrackEpisode(Episode):
    """An :class:`Episode` of T decisions with the track; positions are Earth-fixed, m.

    Attributes:
        r_BN_P: The satellite at the decision boundaries, [T + 1, 3].
        track_times: Times of the track, [M] s since reset: every :data:`SAMPLE` seconds from each decision on, and the end.
        track: The satellite then, [M, 3].
        stations: Ground stations, [S, 3].
    """

    r_BN_P: Tensor
    track_times: Tensor
    track: Tensor
    stations: Tensor

    def columns(self) -> dict[str, Tensor]:
        """See :meth:`Episode.columns`; with the positions ``r_BN_P``."""
        return super().columns() | {"r_BN_P": self.r_BN_P}


def ground(r_P: Tensor) -> tuple[Tensor, Tensor]:
    """Longitude and latitude, degrees, below Earth-fixed positions [..., 3]."""
    latitude, longitude, _ = fixed_to_lla(r_P)
    return torch.rad2deg(longitude), torch.rad2deg(latitude)


class TrackRecorder(Recorder):
    """Also notes the orbit."""

    @override
    def look(self) -> dict[str, Tensor]:
        dynamics = self.satellite.dynamics
        return super().look() | {name: getattr(dynamics, name)[0] for name in ("r_BN_N", "v_BN_N", "r_BN_P")}

    @override
    def episode(self) -> TrackEpisode:
        track_times, track = self._track()
        return TrackEpisode(
            **vars(super().episode()),
            r_BN_P=self.noted("r_BN_P"),
            track_times=track_times,
            track=track,
            stations=self._stations(),
        )

    def _stations(self) -> Tensor:
        access = self.simulator.access
        stations = None if access is None else access.kinds.get("ground_station")
        return stations.r_LP_P[0].cpu() if isinstance(stations, FixedPlaces) else torch.empty(0, 3, dtype=torch.float64)

    def _track(self) -> tuple[Tensor, Tensor]:
        """Times [M] and Earth-fixed positions [M, 3] along the whole orbit."""
        times, device = self.noted("times"), self.simulator.device
        r_N, v_N = self.noted("r_BN_N")[:-1], self.noted("v_BN_N")[:-1]
        counts = torch.ceil(times.diff() / SAMPLE).long()
        row = torch.repeat_interleave(torch.arange(len(counts)), counts)
        elapsed = SAMPLE * (torch.arange(len(row)) - (counts.cumsum(0) - counts)[row]).double()
        r_P = between(self.simulator, times[:-1].to(device), r_N.to(device), v_N.to(device), row.to(device), elapsed.to(device))
        return torch.cat([times[row] + elapsed, times[-1:]]), torch.cat([r_P.cpu(), self.noted("r_BN_P")[-1:]])


def between(simulator: Simulator, times: Tensor, r_N: Tensor, v_N: Tensor, row: Tensor, elapsed: Tensor) -> Tensor:
    """Return the positions of the satellite of row 0, Earth-fixed [M, 3] m, from its states at a few times.

    Each stretch of the orbit is solved again from its beginning, which has no effect on the simulation, does not depend on how
    far back that keeps arcs, and follows orbits with drag.

    Args:
        simulator: Of the episode.
        times: Seconds since reset, [T].
        r_N: Position in N then, [T, 3] m.
        v_N: Velocity in N then, [T, 3] m/s.
        row: From which of the T times to continue, [M].
        elapsed: For how long, [M] s.
    """
    arcs = Arcs(len(times), segments_for(float(elapsed.max()) + SAMPLE), simulator.arcs.solver)
    arcs.solve(torch.arange(len(times), device=times.device), simulator.arcs.et[0] + times, r_N, v_N)
    flown, sky = (take_rows(samples, row) for samples in arcs.tracks((ARC, EPHEMERIS_TRACK)))
    r, around = position_between(flown, sky, elapsed)
    return fixed(around, r).stack()


def record_track(policy: Policy, env: SatelliteTasking, *, seed: int) -> TrackEpisode:
    """Play the first episode of ``seed`` in row 0 of ``env``, with the most probable actions."""
    recorder = TrackRecorder(env)
    recorder.play(policy, seed)
    return recorder.episode()
