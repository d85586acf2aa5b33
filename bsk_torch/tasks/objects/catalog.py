"""Catalogs of resident space objects (RSO) as targets of imagers, and their files."""

from __future__ import annotations

import functools
import json
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import MISSING, asdict, dataclass, field, fields
from pathlib import Path
from typing import Any, TypeVar

import torch
from torch import Tensor

from bsk_torch._checks import number, text, vector, whole
from bsk_torch.astro.atmosphere import top_radius
from bsk_torch.astro.ephemeris import parse_utc
from bsk_torch.astro.orbit import Elements, elements_to_rv, periapsis_radius
from bsk_torch.constants import R_EARTH
from bsk_torch.files import write_file
from bsk_torch.rand import Distribution, Key, Uniform, random_orbit
from bsk_torch.scene.draws import calls_user, check_numbers, draw_numbers
from bsk_torch.sim.dyn.models import BasicDynamicsModel
from bsk_torch.sim.names import nearest
from bsk_torch.tasks.objects.mixture import RSOMixture
from bsk_torch.untrusted import MOST_JSON, Json, parse_json, read_bytes
from bsk_torch.vec3 import Vec3

Saved = TypeVar("Saved")

HEADER = {"schema_version": 1, "frame": "Earth-centered J2000", "position_unit": "m", "velocity_unit": "m/s"}
"""What every file says of itself."""

FARTHEST, FASTEST = 1e9, 1e6
"""Largest distance from the Earth's center, m, and speed, m/s, of a target."""

PHYSICAL = ("mass", "width", "depth", "height", "mu", "min_orbital_radius", "dragCoeff", "panelArea", "u_max")
"""Names of physical parameters of targets."""

FULL_CHARGE = 288000.0
"""Charge and capacity of the battery of satellites in the place of targets, W s."""

MOST_OF_HINT = 160
"""Characters of a hint from which on it does not list all ids."""

MOST_TARGETS = 1000
"""Largest number of targets: imagers have a partition for each."""


@functools.cache
def _physical_defaults() -> dict[str, float]:
    defaults = {arg.name: arg.default for part in BasicDynamicsModel.all_components() for arg in part.args}
    return {name: float(defaults[name]) for name in sorted(PHYSICAL)}


def _pairs(title: str, pairs: object) -> tuple[tuple[Any, Any], ...]:
    """Return pairs of a name and a number; ValueError for something else, which ``title`` names."""
    try:
        items = pairs.items() if isinstance(pairs, Mapping) else pairs
        entries = [tuple(pair) for pair in items]  # type: ignore[attr-defined]
    except TypeError:
        entries = [()]
    if isinstance(pairs, str | Tensor) or not all(len(pair) == 2 and isinstance(pair[0], str) for pair in entries):
        raise ValueError(f"{title}={pairs!r} must be a list of pairs of a name and a number")
    return tuple((name, value) for name, value in entries)


def _events(title: str, events: object) -> tuple[RSOPriorityEvent, ...]:
    """Return changes of priorities as a tuple; ValueError for something else, which ``title`` names."""
    entries = tuple(events) if isinstance(events, Iterable) and not isinstance(events, Tensor) else (None,)
    if not all(isinstance(part, RSOPriorityEvent) for part in entries):
        raise ValueError(f"{title}={events!r} must be a list of RSOPriorityEvent")
    return entries


def _unique(names: Sequence[str], what: str) -> None:
    twice = sorted(name for name, count in Counter(names).items() if count > 1)
    if twice:
        raise ValueError(f"{what} must be unique; {twice} occur more than once")


@dataclass(frozen=True)
class RSOTarget:
    """A resident space object as a target: an orbit, without attitude.

    Attributes:
        id: Name by which catalogs, rewards and actions refer to it.
        satellite_name: Name of a satellite in its place. Here no satellite flies there, and none may have the name.
        rN: Position in N at the epoch, m.
        vN: Velocity in N at the epoch, m/s.
        priority: Priority, not negative.
        sigma_init: Attitude; without effect, like the three attributes that follow.
        omega_init: Rate, rad/s.
        wheel_speeds_rpm: Wheel speeds.
        disturbance_torque_Nm: Disturbance torque.
        physical_parameters: Pairs of a name in :data:`PHYSICAL` and its value; defaults of satellites are added. They do
            not affect the orbit, which has no drag.
    """

    id: str
    satellite_name: str
    rN: tuple[float, float, float]
    vN: tuple[float, float, float]
    priority: float = 1.0
    sigma_init: tuple[float, float, float] = (0.0, 0.0, 0.0)
    omega_init: tuple[float, float, float] = (0.0, 0.0, 0.0)
    wheel_speeds_rpm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    disturbance_torque_Nm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    physical_parameters: tuple[tuple[str, float], ...] = ()

    def __post_init__(self) -> None:
        title = f"RSOTarget({text('RSOTarget: id', self.id)!r})"
        text(f"{title}: satellite_name", self.satellite_name)
        for name, bound in (("rN", FARTHEST), ("vN", FASTEST)):
            object.__setattr__(self, name, vector(f"{title}: {name}", getattr(self, name), zero=True, longest=bound))
        for name in ("sigma_init", "omega_init", "wheel_speeds_rpm", "disturbance_torque_Nm"):
            object.__setattr__(self, name, vector(f"{title}: {name}", getattr(self, name), zero=True))
        object.__setattr__(self, "priority", number(f"{title}: priority", self.priority, 0.0))
        r_N, v_N = (torch.tensor([part], dtype=torch.float64) for part in (self.rN, self.vN))
        check_orbits(r_N, v_N, lambda _: title)
        pairs = _pairs(f"{title}: physical_parameters", self.physical_parameters)
        _unique([name for name, _ in pairs], f"{title}: physical_parameters")
        for name, value in pairs:
            if name not in PHYSICAL:
                raise ValueError(f"{title}: physical_parameters has {name!r}; {nearest(name, PHYSICAL)}")
            number(f"{title}: {name}", value, 0.0, above=True)
        object.__setattr__(self, "physical_parameters", tuple((_physical_defaults() | dict(pairs)).items()))

    def sat_args(self) -> dict[str, object]:
        """Return the arguments that bsk_rl's scenario, and that of ``bsk_torch.bsk_rl``, give the satellite in its place."""
        state = {name: list(getattr(self, name)) for name in ("rN", "vN", "sigma_init", "omega_init")}
        idle = dict.fromkeys(("basePowerDraw", "rwBasePower"), 0.0)
        full = dict.fromkeys(("batteryStorageCapacity", "storedCharge_Init"), FULL_CHARGE)
        turns = {"wheelSpeeds": list(self.wheel_speeds_rpm), "disturbance_vector": list(self.disturbance_torque_Nm)}
        return {**state, "oe": None, **turns, **idle, **full, **dict(self.physical_parameters)}


def check_orbits(r_N: Tensor, v_N: Tensor, title: Callable[[int], str]) -> None:
    """Raise ValueError for states [n, 3] m, m/s in N that are on no orbit above the atmosphere; ``title(row)`` names one."""
    lowest = top_radius(R_EARTH, 1.22, 8000.0)
    periapsis = periapsis_radius(Vec3.of(r_N), Vec3.of(v_N))
    bad = torch.nonzero(~(periapsis >= lowest)).flatten()
    if len(bad):
        row = int(bad[0])
        raise ValueError(
            f"{title(row)}: the orbit comes down to {float(periapsis[row]) / 1e3:.0f} km from the Earth's center; it must stay "
            f"above {lowest / 1e3:.0f} km, because targets have no drag (rN in m, vN in m/s)"
        )


@dataclass(frozen=True)
class RSOPriorityEvent:
    """New priorities of some targets, which hold from the first decision at or after a time.

    Attributes:
        time_s: Time since reset, s.
        priorities: Pairs of the id of a target and its new priority.
    """

    time_s: float
    priorities: tuple[tuple[str, float], ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "time_s", number("RSOPriorityEvent: time_s", self.time_s, 0.0, unit="s"))
        title = "RSOPriorityEvent: priorities"
        pairs = tuple(
            (text(f"{title}: id", key), number(f"{title}: of {key!r}", value, 0.0))
            for key, value in _pairs(title, self.priorities)
        )
        _unique([key for key, _ in pairs], "RSOPriorityEvent: targets")
        object.__setattr__(self, "priorities", pairs)


def among(key: str, ids: Sequence[str]) -> str:
    """Return a hint at ids close to a wrong one, or at some of many."""
    hint = nearest(key, ids)
    return hint if len(hint) < MOST_OF_HINT else f"the catalog has {len(ids)} targets, such as {', '.join(map(repr, ids[:3]))}"


def check_events(ids: Sequence[str], events: Sequence[RSOPriorityEvent]) -> None:
    """Raise ValueError for changes of priorities of other targets than those with the ``ids``, or that are not in order."""
    for event in events:
        for key, _ in event.priorities:
            if key not in ids:
                raise ValueError(f"RSOPriorityEvent at {event.time_s:g} s changes target {key!r}; {among(key, ids)}")
    times = [event.time_s for event in events]
    if times != sorted(times):
        raise ValueError(f"priority_events have the times {times} s; they must be in ascending order")


@dataclass(frozen=True)
class RSOTargetCatalog:
    """Targets in a given order, with their epoch and coming changes of their priorities.

    Attributes:
        targets: The targets, whose ids and satellite names are unique.
        utc_init: Epoch of their states, which the world's argument ``utc_init`` must equal; None for that of each episode.
        priority_events: Changes of priorities, in the order of their times.
    """

    targets: tuple[RSOTarget, ...]
    utc_init: str | None = None
    priority_events: tuple[RSOPriorityEvent, ...] = field(default=())

    def __post_init__(self) -> None:
        items = tuple(self.targets) if isinstance(self.targets, Iterable) and not isinstance(self.targets, Tensor) else (None,)
        if not all(isinstance(part, RSOTarget) for part in items):
            raise ValueError(f"RSOTargetCatalog: targets={self.targets!r} must be a list of RSOTarget")
        object.__setattr__(self, "targets", items)
        object.__setattr__(self, "priority_events", _events("RSOTargetCatalog: priority_events", self.priority_events))
        if not 0 < len(self.targets) <= MOST_TARGETS:
            raise ValueError(f"RSOTargetCatalog: targets has {len(self.targets)} entries; it must have 1 to {MOST_TARGETS}")
        _unique([target.id for target in self.targets], "RSOTargetCatalog: ids of targets")
        _unique([target.satellite_name for target in self.targets], "RSOTargetCatalog: satellite names of targets")
        if self.utc_init is not None:
            epoch = text("RSOTargetCatalog: utc_init", self.utc_init)
            try:
                parse_utc(epoch)
            except ValueError as error:
                raise ValueError(f"RSOTargetCatalog: utc_init: {error}") from None
        check_events(self.ids, self.priority_events)

    @property
    def ids(self) -> tuple[str, ...]:
        """Ids of the targets."""
        return tuple(target.id for target in self.targets)

    def tables(self) -> tuple[Tensor, Tensor, Tensor]:
        """Return positions [G, 3] m, velocities [G, 3] m/s, and priorities [G]."""
        rows = [[*target.rN, *target.vN, target.priority] for target in self.targets]
        table = torch.tensor(rows, dtype=torch.float64)
        return table[:, :3], table[:, 3:6], table[:, 6]

    def to_dict(self) -> dict[str, object]:
        """Return the catalog as numbers, strings, lists and dictionaries, in the schema of files, version 1."""
        return {**HEADER, **asdict(self)}

    def save(self, path: str | Path) -> None:
        """Write the catalog to a JSON file, without rounding."""
        write_file(path, json.dumps(self.to_dict(), indent=2, allow_nan=False) + "\n")

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> RSOTargetCatalog:
        """Return the catalog of a dictionary; ValueError for another schema, frame or units, or missing or unknown entries."""
        if not isinstance(values, Mapping):
            raise ValueError(f"a catalog must be a dictionary, not {type(values).__name__}")
        for name, expected in HEADER.items():
            if values.get(name) != expected:
                raise ValueError(f"a catalog has {name}={values.get(name)!r}; it must be {expected!r}")
        targets = _read(RSOTarget, values, "targets")
        return cls(targets, values.get("utc_init"), _read(RSOPriorityEvent, values, "priority_events"))

    @classmethod
    def load(cls, path: str | Path) -> RSOTargetCatalog:
        """Return the catalog of a JSON file; see :meth:`from_dict`, whose errors name the file."""
        try:
            return cls.from_dict(parse_json(read_bytes(path, MOST_JSON), Json))
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from error


def _read(kind: Callable[..., Saved], values: Mapping[str, object], name: str) -> tuple[Saved, ...]:
    """Return the entries of ``values[name]`` as objects of a kind; ValueError for missing or unknown keys."""
    entries, schema = values.get(name), {part.name: part for part in fields(kind)}  # type: ignore[arg-type]
    if not isinstance(entries, list | tuple) or not all(isinstance(entry, Mapping) for entry in entries):
        raise ValueError(f"a catalog has {name}={entries!r}; it must be a list of dictionaries")
    objects = []
    for k, entry in enumerate(map(_named_as_now, entries)):
        for key in entry:
            if key not in schema:
                raise ValueError(f"entry {k} of {name} has the key {key!r}; {nearest(str(key), schema)}")
        if missing := [key for key, part in schema.items() if part.default is MISSING and key not in entry]:
            raise ValueError(f"entry {k} of {name} lacks {missing}")
        objects.append(kind(**entry))
    return tuple(objects)


def _named_as_now(entry: Mapping[str, object]) -> dict[str, object]:
    """Return the entries of a target with the names of today; ValueError where old and new names disagree."""
    target = dict(entry)
    if "spacecraft_name" in target:
        old = target.pop("spacecraft_name")
        if target.setdefault("satellite_name", old) != old:
            raise ValueError(f"a target has satellite_name={target['satellite_name']!r} and spacecraft_name={old!r}; give one")
    return target


class RandomRSOCatalog:
    """Targets on random orbits, others in each episode; their ids are ``"rso-0"`` and so on."""

    def __init__(
        self,
        n_targets: int,
        oe: Distribution | Sequence[Distribution] | RSOMixture | None = None,
        priority: object = Uniform(0.0, 1.0),
        priority_events: Sequence[RSOPriorityEvent] = (),
        priority_sum: float | None = None,
    ) -> None:
        """Choose what is drawn; ValueError for a wrong argument.

        Args:
            n_targets: Number of targets.
            oe: Distribution of orbital elements, such as ``rand.random_orbit(alt=700)`` (the default), from which each target is
                drawn; a list of ``n_targets`` of them, one for each; or an :class:`RSOMixture`.
            priority: Priority of each target: a number, ``n_targets`` numbers, a distribution, or a function without arguments.
            priority_events: Changes of priorities; see :class:`RSOTargetCatalog`.
            priority_sum: Sum of the priorities, to which they are scaled before changes; None for no scaling.
        """
        self.n_targets = whole("n_targets", n_targets, 1, MOST_TARGETS)
        orbits = random_orbit(alt=700.0) if oe is None else oe
        entries = [orbits] if isinstance(orbits, Distribution | RSOMixture) else orbits
        mixed = isinstance(orbits, RSOMixture)
        if not isinstance(entries, Sequence) or not all(mixed or isinstance(part, Distribution) for part in entries):
            raise ValueError(
                f"oe={oe!r} must be a distribution of orbital elements, such as rand.random_orbit(), a list of them, or a "
                "RSOMixture"
            )
        if len(entries) not in (1, n_targets):
            raise ValueError(f"oe lists {len(entries)} distributions; it must list one for each of {n_targets} targets")
        self.oe, self.priority, self.priority_events = tuple(entries), priority, _events("priority_events", priority_events)
        self.ids = tuple(f"rso-{k}" for k in range(n_targets))
        check_events(self.ids, self.priority_events)
        check_numbers("priority", priority, self.n_targets, low=0.0, high=FARTHEST)
        self.priority_sum = priority_sum
        if priority_sum is not None:
            self.priority_sum = number("priority_sum", priority_sum, 0.0, FARTHEST)

    @property
    def calls_user(self) -> bool:
        """Whether priorities are drawn by a user function."""
        return calls_user(self.priority)

    def draw(self, key: Key) -> tuple[Tensor, Tensor, Tensor]:
        """Return positions [n, G, 3] m, velocities [n, G, 3] m/s, and priorities [n or 1, G] of the episodes of a key."""
        oe = self._elements(key.named("rso_oe"))
        r_N, v_N = (part.stack() for part in elements_to_rv(Elements(*oe.unbind(-1))))
        title = "RandomRSOCatalog: an orbit drawn from oe"
        check_orbits(r_N.flatten(0, 1), v_N.flatten(0, 1), lambda _: title)
        priority = draw_numbers("priority", self.priority, key.named("rso_priority"), self.n_targets, 0.0, FARTHEST)
        return r_N, v_N, priority if self.priority_sum is None else scaled_to(priority, self.priority_sum)

    def _elements(self, key: Key) -> Tensor:
        """Return the orbital elements of the targets of the episodes of a key, [n, G, 6]."""
        if isinstance(self.oe[0], RSOMixture):
            return self.oe[0].draw(key, self.n_targets)
        oe = torch.empty(len(key), self.n_targets, 6, dtype=torch.float64)
        for distribution in dict.fromkeys(map(id, self.oe)):
            targets = [k for k in range(self.n_targets) if id(self.oe[k % len(self.oe)]) == distribution]
            drawn = self.oe[targets[0] % len(self.oe)].draw(key.of_satellites(torch.tensor(targets)))
            table = torch.as_tensor(drawn, dtype=torch.float64)
            if table.shape != (len(key) * len(targets), 6):
                raise ValueError(f"oe draws {list(table.shape)}; it must draw six elements for each target, [n, 6]")
            oe[:, targets] = table.view(len(key), len(targets), 6)
        return oe


def scaled_to(priority: Tensor, total: float) -> Tensor:
    """Return priorities [n, G] times a factor with which they sum up to ``total``; what rounding leaves goes to the last.

    ValueError if all priorities of an episode are zero.
    """
    current = priority.sum(1, keepdim=True)
    if total > 0.0 and not bool((current > 0.0).all()):
        raise ValueError(f"priority_sum={total:g}: all priorities of an episode are zero, which no factor scales")
    scaled = priority * (total / current) if total > 0.0 else torch.zeros_like(priority)
    scaled[:, -1:] = (total - scaled[:, :-1].sum(1, keepdim=True)).clamp(min=0.0)
    return scaled
