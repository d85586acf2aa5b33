"""Areas on bsk_rl: their windows, what is observed of them, and the reward of Areas-v1.

Everything is computed in numpy from the definitions in the docstrings of ``bsk_torch.tasks.areas``, without its code; only what
episodes draw comes from there, as arrays.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from bsk_rl import data, obs, sats
from bsk_rl.utils.orbital import TrajectorySimulator
from numpy.typing import NDArray

Array = NDArray[np.float64]

EQUATOR, POLE = 6378137.0, 6378137.0 * (1.0 - 1.0 / 298.257223563)
"""Semi-axes of the WGS84 ellipsoid, m."""

AHEAD, FAR_AHEAD, STATIONS = 4, 24, 6
"""Numbers of areas and of passes over stations observed, the latter two of the outlook."""

ENDS = np.cumsum([60.0] * 8 + [120.0] * 8 + [300.0] * 8)
"""Ends of the intervals of the outlook, s."""

HORIZON, SOON = 5700.0, 240.0
"""Longest time observed, and the time that divides ``opens_soon`` by e, s."""

MINUTE = 60.0

FINE = 1.0
"""Step of the trajectory below which areas are observed, s: that of the simulation. In steps of 5 s, it is a meter off."""

SHORTEST = 0.1
"""Windows that last no longer are dropped, s."""


class Areas:
    """A areas of up to C cells.

    Attributes:
        cells: Earth-fixed positions, [A, C, 3] m.
        share: Share of its area that each cell stands for, [A, C]; 0 for padding.
        weight: Weights of the areas, [A].
        swath: Width of the recorded ground, m.
        revisit: Time after which a recorded cell pays again, s; None for never.
        center: Mean of the cells of each area, at the equatorial radius, [A, 3] m.
        reach: Largest distance of a cell from the center, and half a swath, [A] m.
        cosine: Cosine of the central angle of a chord as long as the reach, at the polar radius, [A].
    """

    def __init__(self, cells: Array, share: Array, weight: Array, swath: float, revisit: float | None = None) -> None:
        """Describe the areas of an episode."""
        self.cells, self.share, self.weight, self.swath, self.revisit = cells, share, weight, swath, revisit
        own = [place[part > 0.0] for place, part in zip(cells, share, strict=True)]
        self.center = EQUATOR * unit(np.array([place.mean(0) for place in own]))
        most = [np.linalg.norm(place - center, axis=1).max() for place, center in zip(own, self.center, strict=True)]
        self.reach = np.array(most) + 0.5 * swath
        self.cosine = np.cos(2.0 * np.arcsin(0.5 * self.reach / POLE))

    def windows(self, path: Callable[[Array], Array], times: Array) -> Iterator[tuple[int, tuple[float, float]]]:
        """Yield areas and their windows, s, between the first and the last of ``times``, samples of a path over the Earth."""

        def margin(area: NDArray[np.int64], time: Array) -> Array:
            return (unit(path(time)) * self.center[area]).sum(-1) / EQUATOR - self.cosine[area]

        times = np.pad(times, 1, mode="edge")
        f = self.center @ unit(path(times)).T / EQUATOR - self.cosine[:, None]
        f[:, [0, -1]] = -np.inf
        area, k = np.nonzero((f[:, 1:-1] <= 0.0) & (f[:, 1:-1] >= f[:, :-2]) & (f[:, 1:-1] > f[:, 2:]))
        low, high = times[k], times[k + 2]
        for _ in range(40):
            third = (high - low) / 3.0
            earlier = margin(area, low + third) > margin(area, high - third)
            low, high = np.where(earlier, low, low + third), np.where(earlier, high - third, high)
        above = np.concatenate([f.ravel(), margin(area, low)]) > 0.0  # at the samples, and at the maxima between them
        area = np.concatenate([np.repeat(np.arange(len(f)), len(times)), area])
        time = np.concatenate([np.tile(times, len(f)), low])
        order = np.lexsort((time, area))
        area, time, above = area[order], time[order], above[order]
        k = np.flatnonzero(above[1:] != above[:-1])
        inside, outside = np.where(above[k], (time[k], time[k + 1]), (time[k + 1], time[k]))
        for _ in range(60):
            middle = 0.5 * (outside + inside)
            above = margin(area[k], middle) > 0.0
            outside, inside = np.where(above, outside, middle), np.where(above, middle, inside)
        for number, (opens, closes) in zip(area[k][::2], inside.reshape(-1, 2), strict=True):
            if closes - opens > SHORTEST or opens == times[0] or closes == times[-1]:
                yield int(number), (opens, closes)


def unit(vectors: Array) -> Array:
    """Vectors [..., 3] divided by their lengths."""
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


class AreaSatellite(sats.AccessSatellite):
    """A satellite over the ``areas`` of its class, whose messages are recorded in every tick.

    Attributes:
        track: Earth-fixed positions at every minute, [M, 3] m.
    """

    areas: Areas

    def reset_pre_sim_init(self) -> None:
        """Called before Basilisk's modules are made."""
        super().reset_pre_sim_init()
        start = {name: self.sat_args[name] for name in ("utc_init", "rN", "vN", "oe", "mu")}
        self.fine = TrajectorySimulator(**start, dt=FINE)

    def reset_during_sim_init(self) -> None:
        """Called when Basilisk's modules exist."""
        super().reset_during_sim_init()
        world, dynamics = self.simulator.world, self.dynamics
        planet = world.gravFactory.spiceObject.planetStateOutMsgs[world.body_index]
        messages = dynamics.scObject.scStateOutMsg, dynamics.storageUnit.storageUnitDataOutMsg, planet
        self.recorders = [message.recorder() for message in messages]
        for recorder in self.recorders:
            self.simulator.AddModelToTask(dynamics.task_name, recorder, ModelPriority=0)  # after all others

    def calculate_additional_windows(self, duration: float) -> None:
        """Called for more windows."""
        start = self.window_calculation_time
        super().calculate_additional_windows(duration)
        end = self.window_calculation_time
        if end > start:
            path = self.trajectory.r_BP_P
            times = path.x[(path.x >= start - 1e-6) & (path.x <= end + 1e-6)]
            for area, window in self.areas.windows(path, times):
                self._add_window(area, window, type="area", r_LP_P=self.areas.center[area], merge_time=times[0])
            self.fine.extend_to(end + 2.0 * MINUTE)
            self.track = self.fine.r_BP_P(np.arange(0.0, end + 1.5 * MINUTE, MINUTE))


class AreaProperties(obs.Observation):
    """The areas whose windows close next."""

    def get_obs(self) -> dict[str, dict[str, float]]:
        """Called after a step."""
        ahead = self.satellite.find_next_opportunities(AHEAD, types="area")
        return {f"{self.name}_{k}": properties(self.satellite, area["object"], *area["window"]) for k, area in enumerate(ahead)}


def properties(satellite: Any, area: int, opens: float, closes: float) -> dict[str, float]:
    """What is observed of an area and a window."""
    areas, now = satellite.areas, satellite.simulator.sim_time
    minute = int(0.5 * (opens + closes) / MINUTE)
    left_axis = unit(np.cross(satellite.track[minute], satellite.track[minute + 1]))
    forward_axis = unit(np.cross(left_axis, satellite.dynamics.r_BN_P))
    opens, closes = (min(max(time - now, 0.0), HORIZON) for time in (opens, closes))
    cells, half, share = areas.cells[area], 0.5 * areas.swath, areas.share[area] * satellite.data_store.due(now)[area]
    visible = (np.abs(cells @ left_axis) <= half) & ((cells @ forward_axis >= -half) | (opens > 0.0))
    weight, gain = areas.weight[area], share[visible].sum()
    return {
        "opens": opens / HORIZON,
        "closes": closes / HORIZON,
        "weight": weight,
        "remaining": share.sum(),
        "gain": gain,
        "offset": areas.center[area] @ left_axis / areas.reach[area],
        "pays": weight * gain,
        "opens_soon": np.exp(-opens / SOON),
        "closes_soon": np.exp(-closes / SOON),
    }


class AreaOutlook(obs.Observation):
    """What scans would bring in each interval, and how much of it a station is in view."""

    def get_obs(self) -> dict[str, Array]:
        """Called after a step."""
        now, worth, in_view = self.simulator.sim_time, np.zeros(len(ENDS)), np.zeros(len(ENDS))
        for area in self.satellite.find_next_opportunities(FAR_AHEAD, pad=False, types="area"):
            opens, closes = area["window"]
            pays = properties(self.satellite, area["object"], opens, closes)["pays"]
            worth += pays * overlaps(opens - now, closes - now) / max(closes - max(opens, now), 1.0)
        for station in self.satellite.find_next_opportunities(STATIONS, pad=False, types="ground_station"):
            in_view += overlaps(*(time - now for time in station["window"]))
        return {"worth": worth, "in_view": np.minimum(in_view / np.diff(ENDS, prepend=0.0), 1.0)}


def overlaps(opens: float, closes: float) -> Array:
    """How long a window is open in each interval of the outlook, [K] s."""
    return np.diff(np.clip(ENDS, max(opens, 0.0), closes), prepend=max(opens, 0.0))


class Earned(float, data.base.Data):
    """What recorded cells are worth."""


class AreaStore(data.base.DataStore):
    """Cells recorded by a satellite; ``last`` [A, C] s is when, at the end of the step, and -inf for never."""

    data_type = Earned

    def __init__(self, satellite: Any, initial_data: Earned | None = None) -> None:
        """Begin without recorded cells."""
        super().__init__(satellite, initial_data)
        self.last = np.full(satellite.areas.share.shape, -np.inf)

    def due(self, now: float) -> Array:
        """To which part, from 0 to 1, cells are due, [A, C]."""
        revisit = self.satellite.areas.revisit
        return 1.0 * np.isinf(self.last) if revisit is None else np.minimum((now - self.last) / revisit, 1.0)

    def get_log_state(self) -> tuple[Array, Array]:
        """Levels of the store, [T] bit, and places where the axis of the instrument meets the ground, [T, 3] m, in a step."""
        body, store, planet = self.satellite.recorders
        level, r_N, s = (np.array(part) for part in (store.storageLevel, body.r_BN_N, body.sigma_BN))
        axis, square = np.array(self.satellite.fsw.locPoint.pHat_B).ravel(), (s * s).sum(-1, keepdims=True)
        turned = np.cross(s, axis)
        axis_N = axis + (8.0 * np.cross(s, turned) + 4.0 * (1.0 - square) * turned) / (1.0 + square) ** 2
        PN = np.array(planet.J20002Pfix)
        for recorder in self.satellite.recorders:
            recorder.clear()
        return level, footprint(*(np.einsum("tij,tj->ti", PN, vector) for vector in (r_N, axis_N)))

    def compare_log_states(self, old_state: tuple[Array, Array], new_state: tuple[Array, Array]) -> Earned:
        """Called after a step."""
        areas, now, (level, places) = self.satellite.areas, self.satellite.simulator.sim_time, new_state
        places = places[(np.diff(level, prepend=old_state[0][-1:]) > 0.0) & np.isfinite(places).all(-1)]
        hit = np.zeros_like(self.last, dtype=bool)
        if len(places):
            for area in np.flatnonzero((distances(areas.center, places) <= areas.reach[:, None]).any(1)):
                hit[area] = (distances(areas.cells[area], places) <= 0.5 * areas.swath).any(1)
        worth = (areas.weight[:, None] * areas.share * self.due(now))[hit].sum()
        self.last[hit] = now
        return Earned(worth)


def distances(places: Array, others: Array) -> Array:
    """Distances [n, m] m of places [n, 3] and [m, 3] m."""
    return np.linalg.norm(places[:, None] - others, axis=-1)


def footprint(r_P: Array, axis_P: Array) -> Array:
    """Where rays from ``r_P`` [T, 3] m along ``axis_P`` first meet the ellipsoid, [T, 3] m; nan where they miss it."""
    scale = np.array([EQUATOR, EQUATOR, POLE])
    r, d = r_P / scale, axis_P / scale
    half, square = (r * d).sum(-1, keepdims=True), (d * d).sum(-1, keepdims=True)
    inside = half * half - square * ((r * r).sum(-1, keepdims=True) - 1.0)
    distance = (-half - np.sqrt(np.where(inside > 0.0, inside, np.nan))) / square
    return np.where(distance > 0.0, r + distance * d, np.nan) * scale


class AreaReward(data.base.GlobalReward):
    """Weight of the area times share of every recorded cell, as far as it is due."""

    data_store_type = AreaStore

    def calculate_reward(self, new_data_dict: dict[str, Earned]) -> dict[str, float]:
        """Called after a step."""
        return {name: float(earned) for name, earned in new_data_dict.items()}
