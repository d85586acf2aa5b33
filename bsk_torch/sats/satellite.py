"""The satellite: a list of observations, a list of actions, and the models that simulate it."""

from __future__ import annotations

import copy
import difflib
import functools
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor
from typing_extensions import Self, TypedDict

from bsk_torch._checks import switch, text
from bsk_torch.astro.element_sets import MAX_AGE_DAYS
from bsk_torch.formats.orbits import read_orbits
from bsk_torch.formats.tle import read_tle
from bsk_torch.sim.arguments.sources import Given, expand
from bsk_torch.sim.arguments.table import ArgumentTable
from bsk_torch.sim.assembly.composition import compose
from bsk_torch.sim.dyn.models import BasicDynamicsModel, DynamicsModel
from bsk_torch.sim.fsw.models import BasicFSWModel, FSWModel
from bsk_torch.sim.hooks import check_class
from bsk_torch.sim.names import name_fault, one_of

LARGEST_OBSERVED = 1e10
"""Types of observations hold numbers up to this: in float16 all from 65520 on are infinite."""

DEFAULT_DTYPE = torch.float32
"""Type where neither the environment nor a satellite names one."""


def as_dtype(dtype: Any) -> torch.dtype | None:
    """Return a floating-point type of torch from one of torch or NumPy (``np.float32``, ``"float32"``), or None for None."""
    if dtype is None:
        return None
    try:
        kind = dtype if isinstance(dtype, torch.dtype) else torch.from_numpy(np.empty(0, np.dtype(dtype))).dtype
    except (TypeError, ValueError):
        kind = torch.bool
    if not kind.is_floating_point or torch.finfo(kind).max < LARGEST_OBSERVED:
        raise ValueError(
            f"dtype={dtype!r} must be a floating-point type, such as torch.float32 or np.float64, that holds positions in m"
        )
    return kind


def common_dtype(dtype: object, satellites: Iterable[Satellite]) -> torch.dtype:
    """Return the type of observations of an environment: ``dtype`` or, if None, the one that its satellites name."""
    if (kind := as_dtype(dtype)) is not None:
        return kind
    named = {satellite.name: satellite.dtype for satellite in satellites if satellite.dtype is not None}
    if len(set(named.values())) > 1:
        each = ", ".join(f"{name}: {dtype}" for name, dtype in named.items())
        raise ValueError(f"satellites have observations of different types ({each}); an environment has one: pass dtype= to it")
    return next(iter(named.values()), DEFAULT_DTYPE)


SPECS = ("observation_spec", "action_spec", "dyn_type", "fsw_type", "target_types", "sees_through_clouds", "sensor_types")
"""Values that satellite classes define."""

HOOKS = ("on_bind", "note_events", "legal_actions", "action_mask", "counts", "generation")
"""Methods of satellites that subclasses may define."""


def check_satellite(cls: type, base: type) -> None:
    """Raise TypeError, with advice, for a satellite class with definitions that would never be used."""
    check_class(cls, base, HOOKS)
    for name in vars(cls):
        meant = difflib.get_close_matches(name, SPECS, n=1, cutoff=0.85)
        if meant and name not in SPECS and not any(name in vars(other) for other in cls.__mro__[1:]):
            raise TypeError(f"{cls.__name__}.{name} is never used; did you mean {meant[0]!r}?")


def _on_orbit(sat_args: Any, orbit: object) -> Any:
    """Return arguments of a satellite with an orbit at an epoch; ValueError if they have another one."""
    if callable(sat_args):
        return functools.partial(_called_on_orbit, sat_args, orbit)
    given = dict(sat_args or {})
    if others := [name for name in ("oe", "rN", "vN") if given.get(name) is not None]:
        raise ValueError(f"sat_args has {others}, but the orbit is that of the file; leave them out")
    return {**given, "oe": orbit}


def _called_on_orbit(function: Callable[[], Mapping[str, object]], orbit: object) -> object:
    return _on_orbit(function(), orbit)


class SatelliteOptions(TypedDict, total=False):
    """Further arguments of all satellites; see :class:`Satellite`."""

    obs_type: type
    dtype: object
    variable_interval: bool
    observation_spec: Sequence[Any]
    action_spec: Sequence[Any]


class Satellite:
    """Description of a satellite. Subclasses set ``observation_spec``, ``action_spec``, ``dyn_type`` and ``fsw_type``.

    From a description, an environment creates a :class:`bsk_torch.sats.bound.BoundSatellite` of the same class, for all
    satellites of the type, with ``simulator``, ``dynamics``, ``fsw``, ``memory``, ``sat_args`` and other attributes. Hooks of
    subclasses run on this object, and actions, observations and user functions receive it.

    ``dyn_type`` and ``fsw_type`` are a class of :mod:`bsk_torch.sim.dyn` or :mod:`bsk_torch.sim.fsw`, or a tuple of classes in
    order of precedence; reading them returns the composed class.
    """

    observation_spec: ClassVar[Sequence[Any]] = ()
    action_spec: ClassVar[Sequence[Any]] = ()
    dyn_type: ClassVar[Any] = BasicDynamicsModel
    fsw_type: ClassVar[Any] = BasicFSWModel
    bound_type: ClassVar[type[Satellite]]

    def __init_subclass__(cls, **options: object) -> None:
        super().__init_subclass__(**options)
        check_satellite(cls, Satellite)
        cls._compose_models()

    def __init__(
        self,
        name: str,
        sat_args: Mapping[str, object] | Callable[[], Mapping[str, object]] | None = None,
        *,
        obs_type: type = torch.Tensor,
        dtype: object = None,
        variable_interval: bool = True,
        observation_spec: Sequence[Any] | None = None,
        action_spec: Sequence[Any] | None = None,
    ) -> None:
        """Describe a satellite; an environment makes its own copy and simulates that.

        Args:
            name: Up to 100 characters that can be shown, such as ``"GREENSAT-1 (A)"``.
            sat_args: Arguments of the models that differ from :meth:`default_sat_args`: constants, distributions of
                :mod:`bsk_torch.rand`, or callables without arguments; or one callable that returns a dictionary of them, for
                values that depend on one another.
            obs_type: ``torch.Tensor`` for one vector, ``dict`` for named observations; ``np.ndarray`` and ``list`` mean one
                vector, too.
            dtype: Type of observations, of torch or NumPy, unless the environment names one; all satellites of an environment
                have the same.
            variable_interval: Whether the end of an action ends the step; else steps last ``max_step_duration``.
            observation_spec: Observations in place of those of the class; satellites of one type share the list.
            action_spec: Actions, likewise.
        """
        if fault := name_fault(text("name", name)):
            raise ValueError(f"name={name!r} {fault}")
        for spec, own in (("observation_spec", observation_spec), ("action_spec", action_spec)):
            if own is not None:
                setattr(self, spec, own)
            entries = getattr(self, spec)
            if not isinstance(entries, Sequence) or isinstance(entries, str):
                raise ValueError(f"{type(self).__name__}.{spec} = {entries!r}; it must be a list, also of a single entry")
        if not any(obs_type is kind for kind in (dict, torch.Tensor, np.ndarray, list)):
            raise ValueError(f"obs_type={obs_type!r} must be dict, or one of torch.Tensor, np.ndarray and list for one vector")
        self.name, self.obs_type = name, dict if obs_type is dict else torch.Tensor
        self.variable_interval = switch("variable_interval", variable_interval)
        self.dtype = as_dtype(dtype)
        self._compose_models()
        self.sat_args_generator = Given(expand(sat_args, "sat_args"), type(self).default_sat_args(), "sat_args")

    @classmethod
    def from_tle(cls, source: str | Path, sat_args: Any = None, **options: Any) -> list[Self]:
        """Return the satellites of a file of two-line element sets, or of its text; see :meth:`from_orbits`."""
        return cls._on_orbits(read_tle, source, sat_args, **options)

    @classmethod
    def from_orbits(cls, source: str | Path, sat_args: Any = None, **options: Any) -> list[Self]:
        """Return the satellites of a file of orbits: two-line sets, OMM (JSON, CSV, XML), OEM, OPM; or of its text.

        Their orbits are evaluated at the epoch of each episode, ``world_args["utc_init"]``: element sets by SGP4, ephemerides by
        interpolation.

        Args:
            source: Path of a file, or the text.
            sat_args: Arguments of all satellites, as of ``__init__``, without an orbit.
            options: ``names``, a list of those satellites of the file that are wanted; ``gravity`` and ``max_age_days`` of
                :func:`bsk_torch.formats.tle.read_tle`; and options of ``__init__``.

        Raises:
            OSError: If the file cannot be read.
            ValueError: For wrong content, a name that the file does not have, or an orbit in ``sat_args``.
        """
        return cls._on_orbits(read_orbits, source, sat_args, **options)

    @classmethod
    def _on_orbits(
        cls,
        reader: Callable[..., Sequence[Any]],
        source: str | Path,
        sat_args: Mapping[str, object] | Callable[[], Mapping[str, object]] | None,
        names: Sequence[str] | None = None,
        gravity: str = "wgs72",
        max_age_days: float = MAX_AGE_DAYS,
        **options: Any,
    ) -> list[Self]:
        orbits = {orbit.name: orbit for orbit in reader(source, gravity=gravity, max_age_days=max_age_days)}
        for name in names or ():
            one_of("names", name, orbits)
        return [cls(name, _on_orbit(sat_args, orbits[name]), **options) for name in names or orbits]

    @classmethod
    def default_sat_args(cls, **overrides: object) -> ArgumentTable:
        """Return every argument accepted in ``sat_args``, with its default or the given value."""
        cls._compose_models()
        return ArgumentTable((*cls.dyn_type.all_components(), *cls.fsw_type.all_components()), overrides)

    @classmethod
    def get_dyn_type(cls) -> type[DynamicsModel]:
        """Return the dynamics model composed from ``dyn_type``."""
        cls._compose_models()
        return cls.dyn_type

    @classmethod
    def get_fsw_type(cls) -> type[FSWModel]:
        """Return the flight-software model composed from ``fsw_type``."""
        cls._compose_models()
        return cls.fsw_type

    @classmethod
    def _compose_models(cls) -> None:
        """Replace tuples of models, where they were written, by the classes that they stand for; TypeError for what is none."""
        for name, base in (("dyn_type", DynamicsModel), ("fsw_type", FSWModel)):
            owner = next(other for other in cls.__mro__ if name in vars(other))
            setattr(owner, name, compose(getattr(owner, name), base, owner.__name__))

    def generation(self, limit: Tensor) -> Tensor:
        """Return the seconds for which access windows are generated at reset, given time limits [n]; zero here."""
        return torch.zeros_like(limit)

    @property
    def segment(self) -> float:
        """Seconds by which access windows are extended."""
        return 600.0

    def as_given(self) -> Satellite:
        """Return a copy that later changes of ``sat_args_generator`` do not reach, with the flight software of its actions."""
        copied = copy.copy(self)
        copied.sat_args_generator = copy.copy(self.sat_args_generator)
        added = [entry.fsw_type for entry in self.action_spec if getattr(entry, "fsw_type", None) is not None]
        if added:
            copied.fsw_type = compose((self.fsw_type, *added), FSWModel)  # type: ignore[misc]
        return copied

    # -- hooks, which run on the satellites in an environment -----------------------------------------------------------

    def on_bind(self) -> None:
        """Declare memory and the like; called once in an environment, before actions and observations are linked."""

    def note_events(self, event: Tensor) -> None:
        """Record the events of a run; ``event`` [N] is true if an event ended the action waiting for it."""

    def legal_actions(self) -> Tensor | None:
        """Return which actions are legal now, in addition to the actions' masks, [N, n_actions]; None for all of them."""
        return None

    def action_mask(self) -> Tensor:
        """Return which actions are legal now, [N, n_actions] bool: by :meth:`legal_actions` and masks, or all if none is."""
        raise RuntimeError(f"{self.name!r} is in no environment; env.satellite.action_mask() is that of the current episodes")

    def counts(self) -> dict[str, Tensor]:
        """Return the counters of the current episodes, [N] each, by name."""
        return {}
