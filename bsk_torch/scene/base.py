"""Base class of scenarios."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from typing import Any, ClassVar, TypeVar, cast

import numpy as np
import torch
from torch import Tensor
from typing_extensions import final

from bsk_torch._checks import no_gradient, number
from bsk_torch.rand import Key
from bsk_torch.sats.bound import BoundSatellite, SatelliteFleet
from bsk_torch.sats.satellite import Satellite
from bsk_torch.scene.recorded import RecordedTargets
from bsk_torch.sim.hooks import FLEET_MEMORY, ChangeGuard, check_class, check_linked, check_tensor, is_of_package, overrides
from bsk_torch.sim.instruments import Instrument
from bsk_torch.sim.names import nearest
from bsk_torch.sim.places import (
    TARGET_KIND,
    TARGETS,
    AboveElevation,
    DrawnTargets,
    Places,
    PlaceTables,
    SunElevation,
    WithinRange,
    instrument_kind,
)
from bsk_torch.sim.state import StateTable

Value = TypeVar("Value")


class Memo:
    """Results for the current state of the satellites and the memory of the episodes, each computed once."""

    def __init__(self) -> None:
        """Begin without results."""
        self._results: dict[Hashable, tuple[tuple[int, ...], object]] = {}

    def once(self, name: Hashable, fleet: SatelliteFleet, find: Callable[[], Value], further: tuple[int, ...] = ()) -> Value:
        """Return what ``find`` returns, which is called only where the state is another than at the last call with ``name``.

        ``further`` are versions of other tables that it depends on.
        """
        tables = [table for part in fleet.simulators for table in (part.state, part.memory)]
        key = (*(table.version for table in (*tables, fleet.memory)), *further)
        entry = self._results.get(name)
        if entry is None or entry[0] != key:
            entry = self._results[name] = (key, find())
        return cast(Value, entry[1])


Drawn = TypeVar("Drawn")

HOOKS = (
    *("validate_satellite_names", "calls_user", "draw", "place_kinds", "present", "link", "reset", "after_step"),
    *("recorded_targets", "sees", "redraw"),
)
"""Members of :class:`Scenario` that subclasses may define."""


def _same(one: Any, other: Any) -> bool:
    return one[2:] == other[2:] and bool((one[1] == other[1]).all())


FARTHEST = 1e12
"""Range, m, that stands for no limit."""


def target_places(tables: PlaceTables) -> dict[str, Places]:
    """Return a scenario's drawn targets as kinds of places, for satellites with a minimum elevation of targets.

    There is one kind for each of several instruments with its own limits, and one for all the others.
    """
    if TARGETS not in tables.drawn or "imageTargetMinimumElevation" not in tables.arguments:
        return {}
    if not tables.instruments:
        return {TARGET_KIND: _targets(tables, None)}
    return {instrument_kind(instrument): _targets(tables, instrument) for instrument in tables.instruments}


def _targets(tables: PlaceTables, instrument: Instrument | None) -> Places:
    """Return a scenario's drawn targets as one of several instruments, or the single one, sees them."""
    arguments = tables.arguments

    def limit(name: str) -> str:
        return name if instrument is None else instrument.argument(name)

    def sine(name: str) -> Callable[[Tensor], Tensor]:
        return lambda rows: torch.sin(arguments[limit(name)][rows])

    def reach(rows: Tensor) -> Tensor:
        distance = arguments[limit("imageTargetMaximumRange")][rows]
        return torch.where(distance < 0.0, FARTHEST, distance)

    least, advice = sine("imageTargetMinimumElevation"), "ask for more targets, lower imageTargetMinimumElevation"
    names = ("imageTargetMinimumSunElevation", "imageTargetMaximumSunElevation")
    light = [SunElevation(sine(name), name == names[1], tables.vertical) for name in names if limit(name) in arguments]
    near = [WithinRange(reach)] if instrument is not None and "imageTargetMaximumRange" in instrument.own else []
    return DrawnTargets(
        tables,
        lambda rows: least(rows).unsqueeze(-1),
        light,
        clearances=[AboveElevation(least, tables.vertical), *near] if near else [],
        advice=f"all have been imaged, or too few lie below the orbit{' in the light wanted' if light else ''}: {advice}",
    )


class Scenario:
    """The task of the satellites. The base class defines no task.

    Episodes differ only in the values returned by :meth:`draw` and in time. Environments prepare, save and restore episodes from
    these values, so a scenario must not store values of episodes in its attributes. Keep them in ``self.fleet.memory``, a
    :class:`bsk_torch.sim.state.StateTable`, which is reset, saved and restored with the episodes. Public tensor attributes must
    not change between steps. Names of caches, which can be recomputed at any time, begin with an underscore.

    N is the number of environments.

    Attributes:
        fleet: The satellites, once an environment has been built.
    """

    fleet: SatelliteFleet
    _link_needs_super: ClassVar[bool] = False
    _form: Mapping[str, torch.Size] | None = None
    _tried: frozenset[str] = frozenset()

    def __init_subclass__(cls, **options: object) -> None:
        super().__init_subclass__(**options)
        check_class(cls, Scenario, HOOKS)

    # -- hooks --------------------------------------------------------------------------------------------------------

    @property
    def calls_user(self) -> bool:
        """Whether :meth:`draw` or :meth:`present` calls user functions, or uses NumPy's global generator.

        They are then called for one environment at a time, with the generator seeded, and only for episodes that begin now.
        """
        return False

    def draw(self, key: Key) -> dict[str, Tensor]:
        """Draw the values that differ between episodes.

        Use random numbers of ``key.named("...")`` only; see :class:`bsk_torch.rand.Key`. Every call must return the same names.
        The environment stores the values with leading dimension N, once for all satellites of an episode.

        Args:
            key: Key of the n environments whose episodes begin.

        Returns:
            Values by name: float64 tensors [n or 1, ...] on the CPU. Names must differ from those of ``sat_args`` and
            ``world_args``.
        """
        return {}

    def place_kinds(self, tables: PlaceTables) -> Mapping[str, Places]:
        """Return the scenario's places visible to satellites, by kind; the names are types of opportunities.

        Called once for every simulation, before :meth:`link`. By default, the drawn values ``target_r_LP_P`` are targets;
        overriding methods add ``super().place_kinds(tables)``.

        Args:
            tables: Tables that places may read. Draws change at resets, so read ``tables.drawn[name]`` only when positions are
                requested.
        """
        return target_places(tables)

    def present(self, key: Key, names: Sequence[str]) -> Tensor:
        """Draw which satellites take part in each episode (default: all of them).

        An absent satellite is neither dead nor alive: it runs no ticks and does not communicate, its agent's ``mask`` is False,
        and its observations and rewards are zero. Use random numbers of ``key.named("...")`` only, as in :meth:`draw`.

        Args:
            key: Key of the n environments whose episodes begin.
            names: Names of the S satellites of the environment.

        Returns:
            Present satellites, [n, S] bool on the CPU, at least one in each episode.
        """
        return torch.ones(len(key), len(names), dtype=torch.bool)

    def validate_satellite_names(self, satellites: Sequence[Satellite]) -> None:
        """Raise ValueError for unsuitable names of satellites; called first when an environment is built."""

    def link(self, fleet: SatelliteFleet) -> None:
        """Prepare for the satellites of an environment; called once when it is built.

        Overriding methods call ``super().link(fleet)`` first, and raise ValueError for unsuitable satellites.
        """
        self.fleet = fleet

    def reset(self, rows: Tensor) -> None:
        """React to new drawn values; called at the reset of the episodes ``rows``, indices [n], and when a state is restored."""

    def after_step(self, sim_time: Tensor) -> None:
        """Advance to ``sim_time`` [N] s; called after the reward of a step and before communication and observation."""

    def redraw(self, rows: Tensor, key: Key, time: Tensor) -> dict[str, Tensor]:
        """Draw hidden values again, for copies of episodes in which a planner looks ahead (default: all keep their true values).

        A planner with ``futures`` sees the true values of whatever is not drawn again: weather behind a forecast, or arrivals to
        come. Draw from the distribution given what is known at ``time``: keep what has shown itself, and draw arrivals to come
        given that they have not come yet. ``self.drawn(name)[rows]`` are the present values.

        Args:
            rows: Environments of the copies, indices [n].
            key: Key of the n futures; use ``key.named("...")`` only, as in :meth:`draw`.
            time: Time since reset, [n] s.

        Returns:
            New values of :meth:`draw` by name, [n or 1, ...]. Positions of targets cannot change, because windows follow from
            them.
        """
        return {}

    @property
    def memory(self) -> StateTable:
        """Tensors [N, ...] reset with every episode; ``memory.declare(name, initial, *shape)`` in ``link`` adds one."""
        return self.fleet.memory

    def drawn(self, name: str) -> Tensor:
        """Return a value drawn by :meth:`draw` for the current episodes, [N, ...]; KeyError for an unknown name."""
        return self.fleet.scenario_state[name]

    def recorded_targets(self, env: int) -> RecordedTargets | None:
        """Return the targets of the current episode of environment ``env``, for recordings and films; None without any."""
        ground: Any = self
        if not hasattr(ground, "most_targets"):
            return None
        r_P = torch.where(ground.drawn("target_exists")[env].unsqueeze(-1) > 0.5, ground.r_LP_P[env], torch.nan).cpu()
        priority = ground.priority[env].cpu() if hasattr(ground, "priority") else torch.ones(len(r_P), dtype=torch.float64)
        cloud = ground.cloud_cover[env].cpu() if hasattr(ground, "cloud_cover") else None
        names = ground.names(env) if hasattr(ground, "names") else ()
        numbered = names == [f"tgt-{k}" for k in range(len(names))]
        return RecordedTargets(places="ground", r=r_P, priority=priority, cloud=cloud, names=() if numbered else names)

    def sees(self, satellite: BoundSatellite, target: Tensor) -> Tensor:
        """Return whether satellites of a type can see the targets ``target`` [n] at which they look, [n] bool (default: all)."""
        return torch.ones_like(target, dtype=torch.bool)

    def _own_arguments(self, satellite: Satellite) -> dict[str, object]:
        """Return the ``sat_args`` of a satellite that follow from the scenario, whatever the user has given."""
        return {}

    def _bounds(self) -> dict[str, tuple[float, float]]:
        """Return the minimum and maximum of the values returned by :meth:`draw`, by name, for restored states.

        Values of users' scenarios have no bounds and are not checked.
        """
        return {}

    # -- calls by the environment -------------------------------------------------------------------------------------

    @final
    def attach(self, fleet: SatelliteFleet) -> None:
        """Call :meth:`link`; not to be overridden."""
        self.link(fleet)
        if self._link_needs_super:
            check_linked(self, "link(fleet)", fleet)
        self.fleet = fleet

    def group_of(self, name: str) -> Hashable:
        """Return what differs between satellites that are simulated as different types; not to be overridden."""
        return None

    def place_kinds_of(self, names: Sequence[str], tables: PlaceTables) -> Mapping[str, Places]:
        """Return :meth:`place_kinds` for the satellites of one type, by their names; not to be overridden."""
        return self.place_kinds(tables)

    def seen_by(self, names: Sequence[str]) -> Scenario:
        """Return the scenario of the satellites of one type, by their names; not to be overridden."""
        return self

    @final
    def draw_checked(self, key: Key) -> dict[str, Tensor]:
        """Call :meth:`draw`; not to be overridden."""
        values = self._drawn_from_key("draw(key)", lambda: self.draw(key))
        self._check_drawn(values, len(key))
        form = {name: value.shape[1:] for name, value in values.items()}
        if self._form is None:
            self._form = form
        if form != self._form:
            forms = (", ".join(f"{name} {list(shape)}" for name, shape in each.items()) for each in (form, self._form))
            raise ValueError(f"{type(self).__name__}.draw(key) returns {' but earlier '.join(forms)}; all calls must agree")
        return values

    def _check_drawn(self, values: object, rows: int) -> None:
        title = f"{type(self).__name__}.draw(key)"
        if not isinstance(values, Mapping):
            raise TypeError(f"{title} returns {values!r}; it must return a dictionary of tensors, {{name: tensor}}")
        for name, value in values.items():
            if not isinstance(name, str) or not isinstance(value, Tensor):
                raise TypeError(f"{title}[{name!r}] is {value!r}; it must be a tensor, under a name that is a string")
            if value.ndim == 0 or len(value) not in (1, rows):
                raise ValueError(
                    f"{title}[{name!r}] is of shape {list(value.shape)}; it needs a row for each environment, [{rows}, ...], or "
                    "one for all, [1, ...]"
                )
            if not is_of_package(type(self)) and bool(torch.isnan(value).any()):
                raise ValueError(f"{title}[{name!r}] is NaN in {int(torch.isnan(value).sum())} of {value.numel()} numbers")

    @final
    def draw_again(self, rows: Tensor, key: Key, time: Tensor) -> None:
        """Call :meth:`redraw` and write its values; not to be overridden."""
        title = f"{type(self).__name__}.redraw(rows, key, time)"
        values = self._drawn_from_key("redraw(rows, key, time)", lambda: self.redraw(rows, key, time))
        table = self.fleet.scenario_state
        for name, value in values.items():
            if name not in table or name == TARGETS:
                allowed = [known for known in table if known != TARGETS]
                raise ValueError(f"{title} returns {name!r}, which cannot be drawn again; {nearest(str(name), allowed)}")
            if value.shape[1:] != table[name].shape[1:] or len(value) not in (1, len(rows)) or not bool(value.isfinite().all()):
                shape = [len(rows), *table[name].shape[1:]]
                raise ValueError(f"{title}[{name!r}] has shape {list(value.shape)}; it must be of finite numbers {shape}")
            table[name][rows] = value.to(table[name])
        if values:
            table.touch()
            self.begin_episodes(rows)

    @property
    def varies_population(self) -> bool:
        """Whether :meth:`present` is defined by a subclass."""
        return overrides(self, Scenario, "present")

    @final
    def present_checked(self, key: Key, names: Sequence[str]) -> Tensor:
        """Call :meth:`present`; not to be overridden."""
        title = f"{type(self).__name__}.present(key, names)"
        present = self._drawn_from_key("present(key, names)", lambda: self.present(key, names))
        check_tensor(f"the result of {title}", present, (len(key), len(names)), torch.bool)
        if empty := torch.nonzero(~present.any(1)).squeeze(-1).tolist():
            envs = key.env_id[empty].tolist()
            raise ValueError(
                f"{title} returns no satellite for environments {envs[:5]} ({len(envs)} in all); each episode needs at least one"
            )
        return present

    def _drawn_from_key(self, call: str, draw: Callable[[], Drawn]) -> Drawn:
        """Return the values drawn by a hook."""
        # once, since another thread, such as that of a learner, may draw numbers at the same time
        torch_before = None if call in self._tried or is_of_package(type(self)) else torch.get_rng_state()
        before = None if self.calls_user else np.random.get_state()
        with torch.enable_grad():  # so that a value that depends on parameters can be told
            values = no_gradient(f"{type(self).__name__}.{call}", draw())
        if torch_before is not None and not torch.equal(torch_before, torch.get_rng_state()):
            torch.set_rng_state(torch_before)
            raise TypeError(
                f"{type(self).__name__}.{call} used torch's global generator, so episodes would depend on the batch; draw from "
                'key.named("...").uniform(count) or .normal(count)'
            )
        if before is not None and not _same(before, np.random.get_state()):
            np.random.set_state(before)
            raise TypeError(
                f"{type(self).__name__}.{call} used NumPy's global generator, so episodes would depend on the batch; draw "
                'from key.named("..."), or set calls_user = True: it is then called for one environment at a time, and seeded'
            )
        self._tried |= {call}
        return values

    @final
    def begin_episodes(self, rows: Tensor) -> None:
        """Call :meth:`reset` and update values derived from drawn values; not to be overridden."""
        self._forget_draws(rows)
        self._forget_time()
        self.reset(rows)
        self._keep_time()

    @final
    def finish_step(self, sim_time: Tensor) -> None:
        """Call :meth:`after_step` and update values that depend on time; not to be overridden.

        Raises:
            TypeError: If a public tensor attribute has changed; values of episodes belong in ``fleet.memory``.
        """
        self._forget_time()
        self.after_step(sim_time)
        self._keep_time()
        self.__dict__.setdefault("_guard", ChangeGuard()).check(self, FLEET_MEMORY)

    # The package's scenarios keep values derived from draws and time. Their hooks update them, but the two methods above do not
    # rely on this, because an override of a hook need not call super().

    def _forget_draws(self, rows: Tensor) -> None:
        """Drop values derived from drawn ones; ``rows`` [n] have new ones."""

    def _forget_time(self) -> None:
        """Drop values that depend on time."""

    def _keep_time(self) -> None:
        """Compute the values valid until the end of the next step, unless a hook has done so."""


class UniformNadirScanning(Scenario):
    """Recorded data have the same value everywhere: ``value_per_second`` for every second of recording."""

    def __init__(self, value_per_second: float = 1.0) -> None:
        """Set the value of one second of recorded data; ValueError unless it is a finite number."""
        self.value_per_second = number("value_per_second", value_per_second)
