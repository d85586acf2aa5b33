"""Requests: targets with times, looks of a required length, sensors and limits, which may change in flight."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from datetime import datetime, timedelta, timezone
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch._checks import no_gradient, text, whole
from bsk_torch.astro.epochs import read_epoch
from bsk_torch.formats.requests import read_requests
from bsk_torch.rand import Key
from bsk_torch.sats.bound import SatelliteFleet
from bsk_torch.sats.requests import MOST_SENSORS
from bsk_torch.sats.satellite import Satellite
from bsk_torch.scene.draws import Numbers, as_numbers, calls_user, check_numbers, check_positions, draw_numbers
from bsk_torch.scene.explicit import Targets
from bsk_torch.scene.overlaid import OverlaidTargets
from bsk_torch.scene.targets import ChangingTargets, TargetScenario
from bsk_torch.sim.names import nearest
from bsk_torch.sim.places import DrawnTargets, Places, PlaceTables, is_target
from bsk_torch.sim.places.requested import (
    DUE,
    DURATION,
    MAX_OFF_NADIR,
    MIN_ELEVATION,
    NO_OFF_NADIR,
    RELEASE,
    RequestPlaces,
)
from bsk_torch.sim.state import outside_inference

LATEST = 1e9
"""Bound of all times of requests, s: 32 years. It stands for no due time."""

SENSORS = "target_sensors"
"""Name of the drawn sensor types of requests: a sum of powers of two, by their number in ``sensor_types``; 0 for any sensor."""

VALUES: dict[str, tuple[float, float, str]] = {
    RELEASE: (-LATEST, LATEST, "s"),
    DUE: (-LATEST, LATEST, "s"),
    DURATION: (0.0, LATEST, "s"),
    MIN_ELEVATION: (0.0, 0.5 * torch.pi, "rad"),
    MAX_OFF_NADIR: (0.0, NO_OFF_NADIR, "rad"),
    SENSORS: (0.0, 2.0**MOST_SENSORS - 1.0, ""),
}
"""Smallest and largest value, and unit, of what is drawn for each request."""

Sensors = str | Collection[str] | None
"""Sensor types that may serve a request: the name of one, several names, or None for any."""


class Requests(OverlaidTargets):
    """Requests at the targets of another scenario, whose priorities are the weights of the requests.

    A request is served by a look of ``duration`` without a gap, between its release and its due time, by a satellite with one of
    its sensors, above its minimum elevation and within its off-nadir angle. The image is taken at the end of the look. Windows of
    opportunities are cut at release and due time, and are none if they are shorter than the look. All requests are known from
    the beginning of an episode, except those that :meth:`insert` adds.

    For :class:`bsk_torch.sats.RequestSatellite`, :class:`bsk_torch.act.ImageRequest` and :class:`bsk_torch.data.RequestReward`.

    Attributes:
        sensor_types: Sensor types that requests and satellites name, sorted.
        spare: Number of requests that may be inserted into an episode.
    """

    sensor_types: tuple[str, ...]
    _carried: Mapping[str, int] | None = None
    _codes: Tensor
    _fitting: Tensor | None = None

    def __init__(
        self,
        targets: TargetScenario,
        *,
        release: Numbers = 0.0,
        due: Numbers | None = None,
        window: Numbers | None = None,
        duration: Numbers = 0.0,
        sensors: Sensors | Sequence[Sensors] | Mapping[str, float] = None,
        min_elevation: Numbers = 0.0,
        max_off_nadir: Numbers = NO_OFF_NADIR,
        spare: int = 0,
    ) -> None:
        """Describe requests; ValueError for a wrong argument.

        Numbers are one for all, one for each target, or drawn for each target in each episode, as in :class:`UniformTargets`.

        Args:
            targets: Scenario that draws positions and weights.
            release: First time of a look, s since reset.
            due: Last time of a look, s since reset; None for no such time.
            window: Time from release to due time, s, instead of ``due``.
            duration: Time for which a look lasts, s; 0 for an image at the first moment at which all limits hold.
            sensors: Sensor types that may serve a request. For all requests: the name of a type, or None for any. For each: a
                list with a name, several names or None. Drawn: a dictionary of types with their probabilities, which are divided
                by their sum.
            min_elevation: Least elevation of the satellite above the target, rad, where that is more than the
                ``imageTargetMinimumElevation`` of the satellite.
            max_off_nadir: Largest angle, at the satellite, between the directions of target and Earth's center, rad; pi / 2 for
                no limit.
            spare: Requests that :meth:`insert` may add to each episode.
        """
        super().__init__(targets)
        self.spare = whole("spare", spare, 0)
        self.listed = targets.most_targets
        within = targets
        while isinstance(within, OverlaidTargets):
            within = within.targets
        if self.spare and isinstance(within, ChangingTargets):
            raise ValueError(f"spare={spare}: {type(within).__name__} decides which targets there are; leave it 0")
        self.most_targets = self.listed + self.spare
        if due is not None and window is not None:
            raise ValueError(f"due={due!r} and window={window!r} contradict each other; give one of them")
        self.times = {"release": release, "due": due, "window": window, "duration": duration}
        self.limits = {"min_elevation": min_elevation, "max_off_nadir": max_off_nadir}
        for name, value in (self.times | self.limits).items():
            if value is not None:
                check_numbers(name, value, self.listed, **_bounds_of(name))
        self.sensors = _checked_sensors(sensors, self.listed)
        self.sensor_types = _types_of(self.sensors)

    @classmethod
    def from_file(cls, path: str | Path, start: str | datetime | None = None, **options: object) -> Requests:
        """Return the requests in a YAML, JSON or CSV file; see :mod:`bsk_torch.formats.requests`.

        Places are on WGS84, with its vertical; see :meth:`bsk_torch.scene.Targets.from_geodetic`.

        Args:
            path: The file.
            start: Epoch of the episodes, as in ``world_args={"utc_init": start}``; needed for times of the calendar.
            **options: Other arguments, such as ``spare``.

        Raises:
            OSError: If the file cannot be read.
            ValueError: For other content, with the file, the line or entry, the field, its value, and what is allowed.
        """
        table = read_requests(path, None if start is None else _utc(start))
        values = table.values
        targets = Targets.from_geodetic(
            values["latitude"], values["longitude"], values["height"], values["weight"], names=table.ids
        )
        times = {name: values[name] for name in ("release", "due", "duration")}
        limits = {name: np.radians(values[name]) for name in ("min_elevation", "max_off_nadir")}
        return cls(targets, **(times | limits | {"sensors": list(table.sensors)} | options))

    @property
    @override
    def calls_user(self) -> bool:
        return super().calls_user or calls_user(*self.times.values(), *self.limits.values())

    @property
    @override
    def target_names(self) -> list[str]:
        return [*super().target_names, *(f"new-{k}" for k in range(self.spare))]

    @override
    def names(self, row: int) -> list[str]:
        return [*super().names(row), *(f"new-{k}" for k in range(self.spare))]

    def place_kinds(self, tables: PlaceTables) -> Mapping[str, Places]:
        """See :meth:`Scenario.place_kinds`; ValueError for an instrument with a separate maximum range."""
        kinds = dict(super().place_kinds(tables))
        for kind, places in kinds.items():
            if is_target(kind):
                if not isinstance(places, DrawnTargets) or places.clearances:
                    raise ValueError(
                        f"{kind!r}: scene.Requests has windows above elevations; leave out imageTargetMaximumRange of instruments"
                    )
                kinds[kind] = RequestPlaces.of(places)
        return kinds

    def validate_satellite_names(self, satellites: Sequence[Satellite]) -> None:
        """See :meth:`Scenario.validate_satellite_names`; ValueError for requests whose sensors no satellite carries."""
        carried = {satellite.name: getattr(satellite, "sensor_types", ()) for satellite in satellites}
        known = sorted({name for names in carried.values() for name in names})
        for name in self.sensor_types:
            if name not in known:
                raise ValueError(f"sensors={name!r} of requests is carried by no satellite; {_hint(name, known)}")
        self.sensor_types = tuple(known)
        self._carried = {satellite: _code(names, known) for satellite, names in carried.items()}

    def link(self, fleet: SatelliteFleet) -> None:
        """See :meth:`TargetScenario.link`; ValueError for satellites that cannot look at requests."""
        if self._carried is None:
            raise ValueError("scene.Requests must be the scenario itself, around others: Requests(CloudyTargets(...))")
        super().link(fleet)
        fleet.memory.declare("requests_inserted", 0, low=0, high=self.spare)
        self._codes = torch.tensor([self._carried[name] for name in fleet.names], device=fleet.device)
        imagers: list[Any] = list(fleet.satellites)  # of users' classes, too
        for part in imagers:
            if not hasattr(part, "target_types"):
                continue
            if "look_needed" not in part.simulator.state.layout.fields or part.simulator.type.compat:
                raise ValueError(
                    f"scene.Requests needs satellites that look at them, such as a sats.RequestSatellite with act.ImageRequest, "
                    f"and no compat=; {part.name} is a {type(part).__name__}"
                )
            if self.sensor_types:
                part.add_access_filter(partial(self._fits_type, part.type_index), part.target_types)

    # -- draws --------------------------------------------------------------------------------------------------------

    def draw(self, key: Key) -> dict[str, Tensor]:
        """See :class:`TargetScenario`; adds times, limits and sensors of the requests, [n or 1, T] each.

        ValueError for a request that is due before its release, or between them has no time for its look.
        """

        def numbers(name: str, value: Any) -> Tensor:
            return draw_numbers(name, value, key.named(f"target_{name}"), self.listed, **_bounds_of(name))

        release, duration = numbers("release", self.times["release"]), numbers("duration", self.times["duration"])
        due, window = self.times["due"], self.times["window"]
        if window is not None:
            last = (release + numbers("window", window)).clamp(max=LATEST)
        else:
            last = numbers("due", LATEST if due is None else due)
        check_times(release, last, duration, lambda row, k: f" of target {k} of environment {int(key.env_id[row])}")
        values = {RELEASE: release, DUE: last, DURATION: duration, SENSORS: self._draw_sensors(key.named(SENSORS))}
        values |= {f"target_{name}": numbers(name, value) for name, value in self.limits.items()}
        return {name: self._padded(name, value) for name, value in (super().draw(key) | values).items()}

    def _draw_sensors(self, key: Key) -> Tensor:
        if isinstance(self.sensors, Mapping):
            bounds = torch.tensor(list(self.sensors.values()), dtype=torch.float64).cumsum(0)
            codes = torch.tensor([_code([name], self.sensor_types) for name in self.sensors], dtype=torch.float64)
            chosen = torch.searchsorted(bounds / bounds[-1], key.uniform(self.listed), right=True)
            return codes[chosen.clamp(max=len(codes) - 1)]
        listed = self.sensors if isinstance(self.sensors, list) else [self.sensors] * self.listed
        return torch.tensor([[_code(names, self.sensor_types) for names in listed]], dtype=torch.float64)

    def _padded(self, name: str, value: Tensor) -> Tensor:
        """Return values of all listed targets with columns for spare ones."""
        if not self.spare or value.ndim < 2 or value.shape[1] != self.listed:
            return value
        blank = value[:, :1] if name == "target_r_LP_P" else torch.full_like(value[:, :1], PADDING.get(name, 0.0))
        return torch.cat([value, blank.expand(-1, self.spare, *value.shape[2:])], 1)

    @override
    def _bounds(self) -> dict[str, tuple[float, float]]:
        return super()._bounds() | {name: (low, high) for name, (low, high, _) in VALUES.items()}

    @property
    def release(self) -> Tensor:
        """First time of a look at each request, [N, T] s since reset."""
        return self.drawn(RELEASE)

    @property
    def due(self) -> Tensor:
        """Last time, [N, T] s since reset; :data:`LATEST` for none."""
        return self.drawn(DUE)

    @property
    def duration(self) -> Tensor:
        """Time for which a look at each request lasts, [N, T] s."""
        return self.drawn(DURATION)

    @property
    def inserted(self) -> Tensor:
        """Number of requests inserted into the current episodes, [N], at most ``spare``."""
        return self.memory["requests_inserted"]

    # -- sensors ------------------------------------------------------------------------------------------------------

    @property
    def fitting(self) -> Tensor:
        """Which satellites carry a sensor that may serve each request, [N, S, T] bool."""
        if self._fitting is None:
            code = self.drawn(SENSORS).long().unsqueeze(1)
            self._fitting = (code == 0) | ((code & self._codes.view(1, -1, 1)) != 0)
        return self._fitting

    def allows(self, place: Tensor) -> Tensor:
        """Return which of ``sensor_types`` may serve the requests ``place`` [N, n], [N, n, len(sensor_types)] bool."""
        code = self.look_up(self.drawn(SENSORS), place).long().unsqueeze(-1)
        bits = 2 ** torch.arange(len(self.sensor_types), device=place.device)
        return (code == 0) | ((code & bits) != 0)

    def _fits_type(self, part: int) -> Tensor:
        return self.fleet.rows_of(part, self.fitting)

    @override
    def _forget_draws(self, rows: Tensor) -> None:
        super()._forget_draws(rows)
        self._fitting = None

    # -- live requests ------------------------------------------------------------------------------------------------

    @outside_inference
    def insert(
        self,
        rows: Sequence[int] | Tensor,
        r_LP_P: object,
        *,
        release: object = None,
        due: object = None,
        duration: object = 0.0,
        weight: object = 1.0,
        sensors: Sensors | Sequence[Sensors] = None,
        min_elevation: object = 0.0,
        max_off_nadir: object = NO_OFF_NADIR,
    ) -> Tensor:
        """Add K requests to each of the running episodes ``rows``, between two steps; see the constructor for their values.

        ``env.observe()`` then returns observation and mask of the decision with them. Requests are part of the state, and are
        gone with the episode. An episode takes ``spare`` of them; canceling makes no room.

        Args:
            rows: Indices of environments, [n].
            r_LP_P: Earth-fixed positions, [K, 3] m for all rows, or [n, K, 3].
            release: Numbers are one, [K] or [n, K]; None is now. A release before now is now.
            due: Likewise; None for no due time.
            duration: Likewise.
            weight: Likewise; the priority.
            sensors: For all, or a list of K entries.
            min_elevation: Numbers, likewise.
            max_off_nadir: Likewise.

        Returns:
            Indices of the requests among the targets, [n, K], by which :meth:`cancel` and :meth:`reprioritize` know them.

        Raises:
            IndexError: For rows out of range, or listed twice.
            ValueError: For an episode that has not begun or has no room left, and for wrong values. Nothing has changed then.
        """
        index = self._running(rows)
        places, n = self._positions(r_LP_P, len(index)), len(index)
        k = places.shape[1]
        used = self.inserted[index]
        if len(index) and int(used.max()) + k > self.spare:
            row = int(used.argmax())
            raise ValueError(
                f"environment {int(index[row])} has room for {self.spare - int(used[row])} more requests, not for {k}: "
                f"{int(used[row])} of spare={self.spare} are in use"
            )

        def numbers(name: str, value: object) -> Tensor:
            return _broadcast(name, value, n, k, **_bounds_of(name)).to(self.fleet.device)

        now = self.fleet.sim_time[index].unsqueeze(1)
        first = now.expand(n, k) if release is None else torch.maximum(numbers("release", release), now)
        last, seconds = numbers("due", LATEST if due is None else due), numbers("duration", duration)
        check_times(first, last, seconds, lambda row, k: f" of request {k} for environment {int(index[row])}")
        if isinstance(sensors, Mapping):
            raise ValueError(f"sensors={sensors!r} are probabilities; give the sensor types of each inserted request")
        listed = _checked_sensors(sensors, k)
        for name in _types_of(listed):
            if name not in self.sensor_types:
                raise ValueError(f"sensors={name!r} is carried by no satellite; {_hint(name, self.sensor_types)}")
        each = listed if isinstance(listed, list) else [listed] * k
        codes = torch.tensor([_code(names, self.sensor_types) for names in each], dtype=torch.float64, device=first.device)
        values = {
            "target_r_LP_P": places,
            "target_priority": numbers("weight", weight),
            "target_exists": torch.ones_like(first),
            RELEASE: first,
            DUE: last,
            DURATION: seconds,
            MIN_ELEVATION: numbers("min_elevation", min_elevation),
            MAX_OFF_NADIR: numbers("max_off_nadir", max_off_nadir),
            SENSORS: codes.expand(n, k),
        }
        column = self.listed + used.unsqueeze(1) + torch.arange(k, device=index.device)
        self._write(index, column, values)
        self.memory["requests_inserted"] = self.inserted.index_copy(0, index, used + k)
        for part in self.fleet.satellites:
            simulator = part.simulator
            place = column.repeat_interleave(simulator.count, 0)
            for kind in filter(is_target, part.opportunity_types):
                simulator.lookahead.insert(kind, simulator.state.rows_of(index), place, simulator.sim_time)
        return column

    @outside_inference
    def cancel(self, rows: Sequence[int] | Tensor, ids: object) -> None:
        """Withdraw requests of running episodes: no satellite may choose them any more, and their images earn nothing.

        A satellite that looks at one continues until it chooses again.

        Args:
            rows: Indices of environments, [n].
            ids: Requests: an index or a name, K of them for all rows, or a table [n, K]; each exists in each row.

        Raises:
            IndexError: For rows out of range, or listed twice.
            ValueError: For an episode that has not begun, and for requests that do not exist. Nothing has changed then.
        """
        index = self._running(rows)
        column = self._columns(index, ids)
        self._write(index, column, {"target_exists": torch.zeros_like(column, dtype=torch.float64)})

    @outside_inference
    def reprioritize(self, rows: Sequence[int] | Tensor, ids: object, weight: object) -> None:
        """Change the weights of requests of running episodes; images from now on earn the new ones.

        Args:
            rows: Indices of environments, [n].
            ids: Requests, as for :meth:`cancel`.
            weight: Numbers: one, [K] or [n, K].

        Raises:
            IndexError, ValueError: As for :meth:`cancel`.
        """
        index = self._running(rows)
        column = self._columns(index, ids)
        weights = _broadcast("weight", weight, *column.shape).to(self.fleet.device)
        self._write(index, column, {"target_priority": weights})

    def _running(self, rows: object) -> Tensor:
        """Return the indices of running episodes, [n] int64."""
        if not hasattr(self, "fleet"):
            raise ValueError("this scenario is not that of an environment: call env.scenario.insert, cancel or reprioritize")
        index = torch.as_tensor(rows, device=self.fleet.device)
        n = self.fleet.num_envs
        whole_numbers = index.ndim == 1 and not (len(index) and (index.is_floating_point() or index.dtype == torch.bool))
        if not whole_numbers or len(index.unique()) < len(index) or bool(((index < 0) | (index >= n)).any()):
            raise IndexError(f"rows={index.tolist()!s:.60} must be a list of different numbers from 0 to {n - 1}")
        index, begun = index.long(), self.fleet.state["begun"]
        if not bool(begun[index].all()):
            row = int(index[~begun[index]][0])
            raise ValueError(f"environment {row} has no running episode: call env.reset() before its requests are changed")
        return index

    def _positions(self, r_LP_P: object, rows: int) -> Tensor:
        """Return positions, [rows, K, 3] m."""
        try:
            table = as_numbers(no_gradient("r_LP_P", r_LP_P))
        except (TypeError, ValueError, RuntimeError) as error:
            raise ValueError(f"r_LP_P={r_LP_P!r} must be positions [K, 3], m: {error}") from error
        if table.ndim not in (2, 3) or table.shape[-1] != 3 or (table.ndim == 3 and len(table) != rows) or not table.shape[-2]:
            raise ValueError(
                f"r_LP_P has shape {list(table.shape)}; it must be [K, 3] or [{rows}, K, 3], Earth-fixed positions in m"
            )
        check_positions(table.reshape(-1, 3))
        return table.expand(rows, *table.shape[-2:]).to(self.fleet.device)

    def _columns(self, index: Tensor, ids: object) -> Tensor:
        """Return the indices of existing requests, [n, K], of rows [n]."""
        listed: Any = ids.tolist() if isinstance(ids, Tensor) else ids
        listed = [listed] if isinstance(listed, str) or not isinstance(listed, Sequence) else list(listed)
        several = bool(listed) and all(isinstance(part, Sequence) and not isinstance(part, str) for part in listed)
        parts = [list(map(self._index_of, part)) for part in (listed if several else [listed])]
        if len({*map(len, parts)}) > 1:
            raise ValueError(f"ids={ids!r} must have rows of equal length")
        table = torch.tensor(parts, dtype=torch.int64)
        if len(table) not in (1, len(index)) or not table.shape[1]:
            raise ValueError(f"ids has shape {list(table.shape)}; it must be [K] or [{len(index)}, K], with K of at least 1")
        column = table.expand(len(index), -1).to(index.device)
        missing = torch.nonzero(self.drawn("target_exists")[index].gather(1, column) < 0.5)
        if len(missing):
            row, k = missing[0].tolist()
            number = int(column[row, k])
            raise ValueError(
                f"request {number} ({self.target_names[number]!r}) of environment {int(index[row])} does not exist, or has been "
                "canceled"
            )
        return column

    def _index_of(self, request: object) -> int:
        if isinstance(request, str):
            names = self.target_names
            if request not in names:
                raise ValueError(f"ids={request!r} is no request; {_hint(request, names)}")
            return names.index(request)
        return whole("ids", request, 0, self.most_targets - 1)

    def _write(self, index: Tensor, column: Tensor, values: Mapping[str, Tensor]) -> None:
        """Write drawn values [n, K, ...] of rows [n] and targets [n, K]; all that follows from them is computed again."""
        table = self.fleet.scenario_state
        for name, value in values.items():
            table[name][index.unsqueeze(1), column] = value.clone()  # which may be a part of the table
        table.touch()
        self._forget_draws(index)
        self._forget_time()
        self._keep_time()
        for part in self.fleet.satellites:
            part.memory.touch()


def _utc(start: str | datetime) -> datetime:
    epoch = read_epoch(start)
    if epoch.scale != "UTC":
        raise ValueError(f"start={start!r} is a time of {epoch.scale}; give one of UTC, as the times in files are")
    return epoch.minute.replace(tzinfo=timezone.utc) + timedelta(seconds=epoch.second)


PADDING = {"target_max_off_nadir": NO_OFF_NADIR}
"""Values of spare requests that are not zero."""


def _bounds_of(name: str) -> dict[str, Any]:
    if name in ("weight",):
        return {}
    low, high, unit = VALUES[DURATION if name == "window" else f"target_{name}"]
    return {"low": low, "high": high, "unit": unit}


def check_times(release: Tensor, due: Tensor, duration: Tensor, of: Callable[[int, int], str]) -> None:
    """Raise ValueError for requests [n or 1, K] that are due before their release, or have no time for their look between."""
    release, due, duration = torch.broadcast_tensors(release, due, duration)
    wrong = torch.nonzero(due < release + duration)
    if not len(wrong):
        return
    row, k = wrong[0].tolist()
    first, last, seconds = (table[row, k].item() for table in (release, due, duration))
    if last < first:
        raise ValueError(f"due={last:g} s{of(row, k)} comes before its release={first:g} s")
    raise ValueError(f"duration={seconds:g} s{of(row, k)} is longer than the {last - first:g} s from its release to its due time")


def _broadcast(name: str, value: object, n: int, k: int, low: float = -1e300, high: float = 1e300, unit: str = "") -> Tensor:
    """Return numbers as a table [n, k]."""
    try:
        table = as_numbers(no_gradient(name, value))
    except (TypeError, ValueError, RuntimeError) as error:
        raise ValueError(f"{name}={value!r} must be numbers: {error}") from error
    if tuple(table.shape) not in ((), (k,), (n, k)):
        raise ValueError(f"{name} has shape {list(table.shape)}; it must be one number, [{k}] or [{n}, {k}]")
    wrong = ~((table >= low) & (table <= high))
    if bool(wrong.any()):
        unit = f" {unit}" if unit else ""
        raise ValueError(f"{name}={table[wrong].flatten()[0].item():g}{unit} must lie in [{low:g}, {high:g}]{unit}")
    return table.expand(n, k)


def _checked_sensors(sensors: Any, count: int) -> Any:
    """Return sensors as None or a tuple of names for all requests, a list of these for each, or a mapping of shares."""
    if isinstance(sensors, Mapping):
        shares = {text("sensors", name): share for name, share in sensors.items()}
        wrong = [share for share in shares.values() if not isinstance(share, int | float) or not 0.0 <= share < 1e300]
        if wrong or not shares or sum(shares.values()) <= 0.0:
            raise ValueError(f"sensors={sensors!r} must have the probability of each sensor type, not negative, one above zero")
        return shares
    if sensors is None or isinstance(sensors, str):
        return _names_of(sensors)
    if not isinstance(sensors, Sequence) or len(sensors) != count:
        raise ValueError(
            f"sensors={sensors!r} must be the name of a sensor type, None, a list with an entry for each of {count} requests, or "
            "a dictionary of types with their probabilities"
        )
    return [_names_of(entry) for entry in sensors]


def _names_of(entry: object) -> tuple[str, ...] | None:
    if entry is None:
        return None
    if not isinstance(entry, str) and not (isinstance(entry, Collection) and entry):
        raise ValueError(f"sensors={entry!r} must be the name of a sensor type, a list of names, or None for any")
    return tuple(text("sensors", name) for name in ([entry] if isinstance(entry, str) else entry))


def _types_of(sensors: Any) -> tuple[str, ...]:
    """Return the sorted names of sensor types in :func:`_checked_sensors`."""
    listed = sensors if isinstance(sensors, list) else [tuple(sensors or ())]
    return tuple(sorted({name for names in listed for name in names or ()}))


def _code(names: Collection[str] | None, types: Sequence[str]) -> int:
    """Return the number that stands for sensor types; 0 for None."""
    return sum(2 ** types.index(name) for name in set(names or ()))


def _hint(name: str, known: Collection[str]) -> str:
    return nearest(name, known) if known else "give satellites their sensor_types"
