"""Scenarios of point targets on the ground."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch._checks import number, text, vector
from bsk_torch.astro.geodetic import Vertical
from bsk_torch.rand import first_key
from bsk_torch.sats.bound import SatelliteFleet
from bsk_torch.sats.satellite import Satellite
from bsk_torch.scene.base import Scenario
from bsk_torch.scene.draws import check_positions
from bsk_torch.sim.fsw.target import VERTICAL
from bsk_torch.sim.hooks import check_class
from bsk_torch.sim.names import nearest
from bsk_torch.sim.orbit.arcs import FARTHEST
from bsk_torch.sim.state import FINITE, look_up


class Target:
    """A point on the ground with a priority.

    Further attributes may be set. Numbers, and arrays of numbers of equal shape, become drawn values of the episodes; see
    :meth:`bsk_torch.scene.TargetScenario.target_attribute`.

    Attributes:
        name: Name, which need not be unique.
        r_LP_P: Earth-fixed position, [3] m.
        priority: Value of an image.
    """

    def __init__(self, name: str, r_LP_P: Sequence[float] | np.ndarray, priority: float) -> None:
        """See the attributes; ValueError unless position and priority are finite numbers."""
        self.r_LP_P = np.array(vector("r_LP_P", r_LP_P, zero=True))
        self.name, self.priority = text("name", name), number("priority", priority)

    _place: tuple[int, int] | None = None
    """Environment and index of a target in an environment, used for comparison."""

    def __eq__(self, other: object) -> bool:
        return self is other if self._place is None else getattr(other, "_place", None) == self._place

    def __hash__(self) -> int:
        return id(self) if self._place is None else hash(self._place)

    @property
    def id(self) -> str:
        """Name and number of the object: unique."""
        return f"{self.name}_{id(self)}"

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.name})"


TARGET_HOOKS = ("target_names", "names", "r_LP_P", "priority", "available")
"""Members of :class:`TargetScenario` that subclasses may define in addition to the hooks of :class:`Scenario`."""


class TargetScenario(Scenario):
    """Point targets, with T columns in every environment; environments with fewer targets are padded.

    Subclasses set :attr:`most_targets` and define ``draw(key)``, which returns at least

    - ``target_r_LP_P`` [n or 1, T, 3]: Earth-fixed positions, m; finite and outside the Earth, also for padding;
    - ``target_priority`` [n or 1, T]: priority, the value of a target;
    - ``target_exists`` [n or 1, T]: 1.0, or 0.0 for padding.
    """

    most_targets: int
    """Number of columns T."""

    vertical: Vertical = "radius"
    """Direction from which elevations over targets are counted; see :class:`Targets`."""

    _available: Tensor | None = None
    _drawn_again: tuple[Tensor, ...] = ()
    """Rows whose targets have been drawn since :attr:`available` was computed."""
    _link_needs_super = True

    @override
    def __init_subclass__(cls, **options: object) -> None:
        super().__init_subclass__(**options)
        check_class(cls, TargetScenario, TARGET_HOOKS, {})

    @property
    def target_names(self) -> list[str]:
        """Names of the columns: ``"tgt-0"`` and so on."""
        return [f"tgt-{k}" for k in range(self.most_targets)]

    def names(self, row: int) -> list[str]:
        """Return the names of the columns in the current episode of environment ``row``."""
        return self.target_names

    def link(self, fleet: SatelliteFleet) -> None:
        """See :meth:`Scenario.link`; ValueError if no satellite sees targets, or ``draw`` returns values of a wrong shape."""
        if not any(hasattr(part, "target_types") for part in fleet.satellites):
            are = ", ".join(f"{part.name} is a {type(part).__name__}" for part in fleet.satellites)
            raise ValueError(
                f"scene.{type(self).__name__} needs a satellite that sees targets, such as a sats.ImagingSatellite; {are}"
            )
        self._check_draw()
        self._objects: dict[int, dict[int, Target]] = {}
        super().link(fleet)

    def _check_draw(self) -> None:
        values = self.draw(first_key(1))
        t = self.most_targets
        for name, shape in (("target_r_LP_P", (1, t, 3)), ("target_priority", (1, t)), ("target_exists", (1, t))):
            got = tuple(values[name].shape) if name in values else None
            if got != shape:
                raise ValueError(
                    f"{type(self).__name__}.draw(key) gives {name!r} {f'of shape {list(got)}' if got else 'not at all'}; "
                    f"one environment with most_targets={t} needs shape {list(shape)}"
                )
        check_positions(values["target_r_LP_P"][0])

    @property
    def r_LP_P(self) -> Tensor:
        """Earth-fixed positions, [N, T, 3] m."""
        return self.drawn("target_r_LP_P")

    @property
    def priority(self) -> Tensor:
        """Priority of every target at the current decision, [N, T]; 0 for padding."""
        return self.drawn("target_priority")

    def priority_of(self, target: Tensor) -> Tensor:
        """Return the :attr:`priority` of targets [num_envs, n]; where it is the drawn one, read as the table stores it."""
        if type(self).priority is TargetScenario.priority:
            return self.fleet.scenario_state.look_up("target_priority", target)
        return self.priority.gather(1, target)

    @property
    def available(self) -> Tensor:
        """Whether a target exists and can be selected at the current decision, [N, T] bool."""
        if self._available is None or self._drawn_again:
            exists, owner = self.fleet.scenario_state.shared("target_exists")
            if self._available is None or owner is not None:
                self._available = exists.bool() if owner is None else exists.bool()[owner]
            else:
                rows = torch.cat(self._drawn_again)
                self._available = self._available.index_copy(0, rows, exists[rows].bool())
            self._drawn_again = ()
        return self._available

    @override
    def _own_arguments(self, satellite: Satellite) -> dict[str, object]:
        return {VERTICAL: self.vertical} if VERTICAL in satellite.default_sat_args() and self.vertical != "radius" else {}

    @override
    def _bounds(self) -> dict[str, tuple[float, float]]:
        return {"target_r_LP_P": (-FARTHEST, FARTHEST), "target_priority": (-FINITE, FINITE), "target_exists": (0.0, 1.0)}

    def target_attribute(self, name: str) -> Tensor:
        """Return an attribute of all targets, [N, T, ...]; AttributeError for an unknown name.

        The attribute is a property of the scenario with a value for every target, such as ``priority``; a value returned by
        :meth:`draw` as ``target_<name>`` or ``<name>``; or a numeric attribute of targets generated by
        :meth:`UniformTargets.regenerate_targets`.
        """
        value = None if name.startswith("_") else getattr(self, name, None)
        if isinstance(value, Tensor) and value.shape[:2] == self.drawn("target_exists").shape:
            return value
        for drawn in (f"target_{name}", name):
            if drawn in self._attributes():
                return self.drawn(drawn)
        names = ["priority", "r_LP_P", "id", "name", *(drawn.removeprefix("target_") for drawn in self._attributes())]
        raise AttributeError(
            f"targets have no attribute {name!r}, which {type(self).__name__}.draw(key) may give them, "
            f"[n, {self.most_targets}]; {nearest(name, names)}"
        )

    def _attributes(self) -> list[str]:
        drawn = ((name, self.drawn(name)) for name in self.fleet.scenario_state)
        each = [name for name, value in drawn if value.ndim > 1 and value.shape[1] == self.most_targets]
        return [name for name in each if name not in ("target_r_LP_P", "target_priority", "target_exists", "target_key")]

    def look_up(self, table: Tensor | str, target: Tensor) -> Tensor:
        """Return entries [N, n, ...] of a table [N, T, ...], or of a :meth:`target_attribute`, for indices of targets [N, n]."""
        return look_up(self.target_attribute(table) if isinstance(table, str) else table, target)

    def target_objects(self, row: int) -> list[Target]:
        """Return the targets of environment ``row``, without padding, as objects, the same until it is reset or restored.

        Priorities are the initial ones.
        """
        if row not in self._objects:
            self._objects[row] = dict(self._make_objects(row))
            for index, target in self._objects[row].items():
                target._place = row, index
        return list(self._objects[row].values())

    def target_object(self, row: int, target: int) -> Target:
        """Return a target of :meth:`target_objects` by its index; KeyError for padding."""
        self.target_objects(row)
        return self._objects[row][target]

    def _make_objects(self, row: int) -> Iterable[tuple[int, Target]]:
        exists = self.drawn("target_exists")[row].bool().tolist()
        names, r_LP_P, priority = self.names(row), self.r_LP_P[row].cpu().numpy(), self.drawn("target_priority")[row].tolist()
        made = [Target(*column) for column in zip(names, r_LP_P, priority, strict=True)]
        for name in self._attributes():
            for target, value in zip(made, self.drawn(name)[row].cpu().numpy(), strict=True):
                setattr(target, name.removeprefix("target_"), value.item() if value.ndim == 0 else value)
        return ((k, target) for k, target in enumerate(made) if exists[k])

    @override
    def reset(self, rows: Tensor) -> None:
        super().reset(rows)
        self._forget_draws(rows)

    @override
    def _forget_draws(self, rows: Tensor) -> None:
        super()._forget_draws(rows)
        self._drawn_again = (*self._drawn_again, rows)
        if sum(map(len, self._drawn_again)) > self.fleet.num_envs:
            self._available, self._drawn_again = None, ()
        for row in rows.tolist() if self._objects else ():
            self._objects.pop(row, None)


class ChangingTargets(TargetScenario):
    """Targets that appear, disappear or change their priority. Subclasses define :meth:`at`.

    Priorities are computed once for each decision. The reward of an image depends on the priority at the decision to take it.
    List this class before another scenario to change the targets of that scenario::

        class Deadlines(scene.ChangingTargets, scene.UniformTargets):
            def draw(self, key):
                deadline = 5400.0 * key.named("deadline").uniform(self.most_targets)
                return super().draw(key) | {"target_deadline": deadline}

            def at(self, time):
                return self.drawn("target_priority"), time.unsqueeze(-1) < self.drawn("target_deadline")
    """

    _present: tuple[Tensor, Tensor] | None = None

    @override
    def __init_subclass__(cls, **options: object) -> None:
        super().__init_subclass__(**options)
        check_class(cls, ChangingTargets, ("at",), {})

    def at(self, time: Tensor) -> tuple[Tensor, Tensor]:
        """Return priority [N, T] and availability [N, T] bool of the targets at ``time`` [N] s since reset.

        The result may depend only on drawn values (see :meth:`drawn`), ``time`` and ``fleet.memory``. The method must not have
        side effects. Values of padding are ignored.
        """
        raise NotImplementedError(f"{type(self).__name__} must implement at(time)")

    def _update(self, time: Tensor) -> tuple[Tensor, Tensor]:
        exists = super().available
        priority, available = self.at(time)
        if priority.shape != exists.shape or available.shape != exists.shape or available.dtype != torch.bool:
            raise ValueError(
                f"{type(self).__name__}.at(time) gives priorities of shape {list(priority.shape)} and availability of shape "
                f"{list(available.shape)}, {available.dtype}; both must be {list(exists.shape)}, and availability torch.bool"
            )
        self._present = torch.where(exists, priority, 0.0), available & exists
        return self._present

    def _at_decision(self) -> tuple[Tensor, Tensor]:
        """Return priority and availability at the current decision; before the first reset, at the current time."""
        return self._update(self.fleet.sim_time) if self._present is None else self._present

    @property
    @override
    def priority(self) -> Tensor:
        return self._at_decision()[0]

    @property
    @override
    def available(self) -> Tensor:
        return self._at_decision()[1]

    @override
    def reset(self, rows: Tensor) -> None:
        super().reset(rows)
        self._update(self.fleet.sim_time)

    @override
    def after_step(self, sim_time: Tensor) -> None:
        super().after_step(sim_time)
        self._update(sim_time)

    @override
    def _forget_time(self) -> None:
        super()._forget_time()
        self._present = None

    @override
    def _keep_time(self) -> None:
        super()._keep_time()
        self._at_decision()
