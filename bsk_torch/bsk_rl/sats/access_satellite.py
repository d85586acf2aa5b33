"""Satellites that see places on the ground: windows of access, and the imaging of targets.

Windows are found by the search of bsk_rl: places near the predicted orbit, sampled every 30 s, and roots and minima of the
elevation by Brent's methods. So they are the windows of bsk_rl, including those that it loses.
"""

from __future__ import annotations

import bisect
import logging
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Sequence
from typing import Any, ClassVar

import numpy as np

from bsk_torch.bsk_rl.sats.satellite import SatAct, Satellite, SatObs
from bsk_torch.bsk_rl.scene.targets import Target
from bsk_torch.bsk_rl.sim import dyn, fsw
from bsk_torch.bsk_rl.sim.simulator import Simulator
from bsk_torch.bsk_rl.utils.functional import valid_func_name
from bsk_torch.sim.access.passes.literal_search import Window, elevation_error, near_samples, near_spans, windows_in
from bsk_torch.sim.fsw.target import SUN_LIMITS

__all__ = ["AccessSatellite", "ImagingSatellite", "SatAct", "SatObs"]

logger = logging.getLogger(__name__)

Opportunity = dict[str, Any]
Filter = Callable[[Any], object]
"""Whether an opportunity, a dictionary, counts."""

Types = str | Collection[str] | None
"""Type of opportunities, several types, or None for all."""

ENDLESS = 1e9
"""Seconds of a task without a limit."""


class OpportunityQueries(ABC):
    """Queries of windows by object; opportunities are listed by their time of closing."""

    opportunities: Any
    upcoming_opportunities: Any

    @abstractmethod
    def _accepts(self, types: Types, filter: Any) -> Filter:
        """Return the function that determines whether an opportunity counts in a query."""

    def opportunities_dict(self, types: Types = None, filter: object = None) -> dict[object, list[Window]]:
        """Return all windows by object; ``filter`` is a function of an opportunity, or a list of objects to leave out."""
        return self._by_object(self.opportunities, self._accepts(types, filter))

    def upcoming_opportunities_dict(self, types: Types = None, filter: object = None) -> dict[object, list[Window]]:
        """Return the windows that have not closed by object."""
        return self._by_object(self.upcoming_opportunities, self._accepts(types, filter))

    @staticmethod
    def _by_object(opportunities: Sequence[Opportunity], accepts: Filter) -> dict[object, list[Window]]:
        windows: dict[object, list[Window]] = {}
        for opportunity in opportunities:
            if accepts(opportunity):
                windows.setdefault(opportunity["object"], []).append(opportunity["window"])
        return windows

    def next_opportunities_dict(
        self, types: Types = None, filter: object = None, min_needed: int | None = None
    ) -> dict[object, Window]:
        """Return the next window of every object; of the first ``min_needed`` objects, if given."""
        accepts, windows = self._accepts(types, filter), dict[object, Window]()
        for opportunity in self.upcoming_opportunities:
            if accepts(opportunity):
                windows.setdefault(opportunity["object"], opportunity["window"])
            if min_needed is not None and len(windows) >= min_needed:
                break
        return windows


class AccessSatellite(OpportunityQueries, Satellite):
    """Adds windows of access to places.

    Attributes:
        opportunities: All windows that have been found, by their time of closing.
        window_calculation_time: Time up to which windows have been searched, s.
        locations_for_access_checking: The places.
    """

    def __init__(
        self,
        *args: Any,
        generation_duration: float = 600.0,
        initial_generation_duration: float | None = None,
        max_generation_duration_beyond_initial: float = float("inf"),
        **kwargs: Any,
    ) -> None:
        """Search windows at reset for ``initial_generation_duration`` s, and further by ``generation_duration`` s.

        Args:
            *args: See :class:`Satellite`.
            generation_duration: Seconds by which the search is extended where a query needs more.
            initial_generation_duration: Seconds searched at reset; None for the time limit, or nothing without one.
            max_generation_duration_beyond_initial: Seconds beyond which queries stop to search.
            **kwargs: See :class:`Satellite`.
        """
        super().__init__(*args, **kwargs)
        self.generation_duration = generation_duration
        self.initial_generation_duration: Any = initial_generation_duration
        self.max_generation_duration_beyond_initial = max_generation_duration_beyond_initial
        self.access_filter_functions: list[Filter] = []

    def reset_overwrite_previous(self) -> None:
        """Forget places and windows of the last episode."""
        super().reset_overwrite_previous()
        self.opportunities: list[Opportunity] = []
        self.window_calculation_time: float = 0.0
        self.locations_for_access_checking: list[dict[str, Any]] = []

    def set_dynamics(self, dyn_rate: float) -> object:
        """See :meth:`Satellite.set_dynamics`; ground stations are places."""
        model = super().set_dynamics(dyn_rate)
        if issubclass(self.dyn_type, dyn.GroundStationDynModel):
            for station in self.simulator.world.groundStations:
                self.add_location_for_access_checking(
                    station.ModelTag, np.ravel(station.r_LP_P_Init), station.minimumElevation, "ground_station"
                )
        return model

    def add_location_for_access_checking(
        self, object: object, r_LP_P: object, min_elev: float, type: str, start_time: float = 0.0
    ) -> None:
        """Add a place, which counts in later searches.

        Args:
            object: What the place is.
            r_LP_P: Its position, m, Earth-fixed.
            min_elev: Least elevation, rad.
            type: Type of its opportunities.
            start_time: Time from which on it is searched, s.
        """
        place = {"r_LP_P": r_LP_P, "min_elev": min_elev, "type": type, "object": object, "start_time": start_time}
        self.locations_for_access_checking.append({type: object, **place})

    def reset_post_sim_init(self) -> None:
        """Search the first windows."""
        super().reset_post_sim_init()
        if self.initial_generation_duration is None:
            limit = self.simulator.time_limit
            self.initial_generation_duration = 0 if limit == float("inf") else limit
        self.calculate_additional_windows(self.initial_generation_duration)

    # -- search -------------------------------------------------------------------------------------------------------

    def calculate_additional_windows(self, duration: float) -> None:
        """Search windows for ``duration`` s more, rounded up to whole times of ``generation_duration``."""
        if duration <= 0:
            return
        start = self.window_calculation_time
        end = start + max(duration, self.trajectory.dt * 2, self.generation_duration)
        end = self.generation_duration * np.ceil(end / self.generation_duration)
        self.logger.info("Finding opportunity windows from %.2f to %.2f seconds", start, end)
        self.trajectory.extend_to(end)
        self.window_calculation_time = end
        if self.locations_for_access_checking:
            self._search(start, end)

    def _search(self, start: float, end: float) -> None:
        track, places = self.trajectory.r_BP_P, self.locations_for_access_checking
        span = (track.x >= start - 1e-9) & (track.x <= end + 1e-9)
        times, positions = track.x[span], track.y[span]
        r_LP_P = np.array([place["r_LP_P"] for place in places], dtype=float).reshape(-1, 3)
        least = np.array([place["min_elev"] for place in places], dtype=float)
        for place, near in zip(places, near_samples(positions, r_LP_P, least), strict=True):
            first = max(int(np.searchsorted(times, place["start_time"], side="right")) - 1, 0)
            error = elevation_error(track, place["r_LP_P"], place["min_elev"])
            for candidate in near_spans(near[first:], times[first:]):
                for window in windows_in(error, candidate, (times[first], times[-1]), logger):
                    self._add_window(place["object"], window, place["type"], place["r_LP_P"], times[first])

    def _add_window(self, object: object, new_window: Window, type: str, r_LP_P: object, merge_time: float | None = None) -> None:
        if merge_time is None or new_window[0] == merge_time:
            for k, last in enumerate(self.opportunities):
                if last["type"] == type and last["object"] == object and last["window"][1] == new_window[0]:
                    del self.opportunities[k]
                    last["window"] = (last["window"][0], new_window[1])
                    bisect.insort(self.opportunities, last, key=_closing)
                    return
        window = {"object": object, "window": new_window, "type": type, "r_LP_P": r_LP_P}
        bisect.insort(self.opportunities, window, key=_closing)

    # -- queries ------------------------------------------------------------------------------------------------------

    @property
    def upcoming_opportunities(self) -> list[Opportunity]:
        """Windows that have not closed, by their time of closing."""
        first = bisect.bisect_left(self.opportunities, self.simulator.sim_time + 1e-12, key=_closing)
        return self.opportunities[first:]

    def _accepts(self, types: Types, filter: Any) -> Filter:
        kinds = [types] if isinstance(types, str) else types
        if isinstance(filter, list):
            keeps: Filter = lambda opportunity: opportunity["object"] not in filter  # noqa: E731
        else:
            keeps = filter or self.default_access_filter
        return lambda opportunity: (kinds is None or opportunity["type"] in kinds) and keeps(opportunity)

    def find_next_opportunities(
        self,
        n: int,
        pad: bool = True,
        max_lookahead: int = 100,
        types: Types = None,
        filter: object = None,
    ) -> list[Opportunity]:
        """Return the ``n`` windows that close next; the last is repeated where there are fewer.

        Raises:
            RuntimeError: If there is none, or too few without ``pad``.
        """
        if n == 0:
            return []
        accepts, chosen = self._accepts(types, filter), list[Opportunity]()
        for _ in range(max_lookahead):
            chosen = []
            for opportunity in self.upcoming_opportunities:
                if accepts(opportunity):
                    chosen.append(opportunity)
                if len(chosen) >= n:
                    return chosen
            searched = self.initial_generation_duration + self.max_generation_duration_beyond_initial
            if self.window_calculation_time >= searched:
                break
            self.calculate_additional_windows(self.generation_duration)
        if not (pad and chosen):
            raise RuntimeError("No opportunities found! Use add_location_for_access_checking to add locations.")
        self.logger.info("Only %d opportunities found, padding to %d.", len(chosen), n)
        return chosen + [chosen[-1]] * (n - len(chosen))

    # -- filters ------------------------------------------------------------------------------------------------------

    def add_access_filter(self, access_filter_fn: Filter, types: Types = None, prepend: bool = False) -> None:
        """Let only windows count for which a function of an opportunity is true, of some types or of all."""
        kinds = [types] if isinstance(types, str) else types

        def keeps(opportunity: Opportunity) -> object:
            return (kinds is not None and opportunity["type"] not in kinds) or access_filter_fn(opportunity)

        self.access_filter_functions.insert(0 if prepend else len(self.access_filter_functions), keeps)

    def get_access_filter(self) -> object:
        """Raise DeprecationWarning, as bsk_rl does."""
        raise DeprecationWarning("get_access_filter is deprecated. Use add_access_filter and default_access_filter instead.")

    @property
    def default_access_filter(self) -> Filter:
        """Whether a window passes all filters."""
        return lambda opportunity: all(keeps(opportunity) for keeps in self.access_filter_functions)


def _closing(opportunity: Opportunity) -> float:
    return opportunity["window"][1]


class ImagingSatellite(AccessSatellite):
    """Adds the imaging of targets.

    Attributes:
        imaged: Images of the episode.
        missed: Windows that have closed without one.
        latest_target: Target of the last task.
        target_types: Types of opportunities that can be imaged.
    """

    buffer_name: ClassVar[str] = "image_buffer"
    dyn_type: ClassVar[Any] = dyn.ImagingDynModel
    fsw_type: ClassVar[Any] = fsw.ImagingFSWModel

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        """See :class:`AccessSatellite`; ValueError for limits of light, which bsk_rl does not have."""
        super().__init__(*args, **kwargs)
        for name in (arg.name for arg in SUN_LIMITS):
            if self.sat_args_generator.get(name) is not None:
                raise ValueError(
                    f"sat_args[{name!r}] does not limit the windows of bsk_torch.bsk_rl, which are those of bsk_rl; "
                    "leave it out, or use a satellite of bsk_torch.sats"
                )
        self.target_types: str | Sequence[str] = "target"
        self.latest_target: Any = None

    @property
    def known_targets(self) -> Sequence[Target]:
        """Targets that the satellite knows of."""
        try:
            return self.data_store.data.known
        except AttributeError:
            return []

    def reset_overwrite_previous(self) -> None:
        """See :meth:`AccessSatellite.reset_overwrite_previous`; counters start at zero."""
        super().reset_overwrite_previous()
        self._image_event_name: str | None = None
        self.imaged = self.missed = 0

    def reset_pre_sim_init(self) -> None:
        """See :meth:`AccessSatellite.reset_pre_sim_init`; images go to one partition of the store."""
        super().reset_pre_sim_init()
        self.sat_args["bufferNames"] = [self.buffer_name]
        self.sat_args["transmitterNumBuffers"] = 1

    def parse_target_selection(self, target_query: Any) -> Target:
        """Return the target of the k-th next opportunity, or that of an id, or the target itself.

        Raises:
            ValueError: For an unknown id.
            TypeError: For anything else.
        """
        if np.issubdtype(type(target_query), np.integer):
            return self.find_next_opportunities(n=target_query + 1, types=self.target_types)[-1]["object"]
        if isinstance(target_query, Target):
            return target_query
        if isinstance(target_query, str):
            for target in self.known_targets:
                if target.id == target_query:
                    return target
            raise ValueError(f"Target {target_query} is not a known target")
        raise TypeError(f"target_query={target_query!r} must be an index, a Target or its id")

    def task_target_for_imaging(self, target: Target, max_duration: float | None = None) -> None:
        """Image a target, for at most ``max_duration`` s."""
        self.logger.info("%s tasked for imaging", target)
        self.fsw.action_image(target.r_LP_P, self.buffer_name)
        self.enable_target_window(target, max_duration=max_duration)
        self.draw_imaging_line(target)
        self.latest_target = target

    def enable_target_window(self, target: Target, max_duration: float | None = None) -> None:
        """Let the task end with the image, with the target's window, or after ``max_duration`` s.

        Raises:
            ValueError: For a target without an upcoming window.
        """
        windows = [each["window"] for each in self.upcoming_opportunities if each["object"] == target]
        if not windows:
            raise ValueError(f"{target} is in none of the windows that are known up to {self.window_calculation_time} s")
        self._update_image_event(target)
        window = windows[0]
        self.logger.info("%s window enabled: %.1f to %.1f", target, *window)

        def over(simulator: Simulator) -> None:
            if np.isclose(simulator.sim_time, window[1], atol=1e-9):
                self.missed += 1
            self.remove_imaging_line()

        until = min(window[1], self.simulator.sim_time + (ENDLESS if max_duration is None else max_duration))
        self.update_timed_terminal_event(until, info=f"for {target} window", extra_actions=over)

    def _update_image_event(self, target: Target) -> None:
        if self._image_event_name in self.simulator.eventMap:
            self.simulator.delete_event(str(self._image_event_name))
        self._image_event_name = valid_func_name(f"image_{self.name}_{target.id}")

        def taken(simulator: Simulator) -> None:
            self.logger.info("imaged %s", target)
            self.imaged += 1
            self.requires_retasking = True
            self.remove_imaging_line()

        self.simulator.add_image_event(self._image_event_name, self, taken, bool(self.variable_interval))

    def draw_imaging_line(self, target: object, **_: object) -> None:
        """Do nothing: pictures for Vizard are not made."""

    def remove_imaging_line(self, **_: object) -> None:
        """Do nothing, likewise."""
