"""Observations of the satellite itself: properties of its models, time, eclipses."""

from __future__ import annotations

import inspect
import itertools
import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch._checks import number, switch
from bsk_torch.obs.base import ADVICE, Observation, Values, side_by_side
from bsk_torch.obs.entries import is_own, parse_entries, parse_norm, scaled
from bsk_torch.sats.bound import BoundSatellite
from bsk_torch.sats.user_function import UserFunction
from bsk_torch.sim.arguments.values import nearest
from bsk_torch.sim.assembly.composition import having
from bsk_torch.sim.hooks import is_of_package
from bsk_torch.sim.readout.observables import Function, observable, vital
from bsk_torch.sim.readout.own import OwnFunction


class SatProperties(Observation):
    """Properties of the dynamics or flight-software model, including those added by a user's model.

    Each argument is a dictionary with ``prop`` (name of the property) or ``fn`` (function of the satellite that returns [N] or
    [N, width]), and optionally ``module`` (``"dynamics"`` or ``"fsw"``), ``norm`` (divisor; None for 1) and ``name``. With
    ``fn``, ``prop`` is just the label.

    Functions, and properties added by a user's model, are called for all satellites at once; see
    :class:`bsk_torch.sats.user_function.UserFunction`.
    """

    def __init__(self, *entries: Mapping[str, object], name: str = "sat_props") -> None:
        """See the class; ValueError for unknown keys or equal names."""
        super().__init__(name)
        self.entries = parse_entries(entries, {"prop", "fn", "module", "norm", "name"}, "obs.SatProperties")

    def link_satellite(self, satellite: BoundSatellite) -> None:
        """See :meth:`Observation.link_satellite`; ValueError for a property that does not exist."""
        super().link_satellite(satellite)
        self.modules = [None if "fn" in entry else self._module(entry) for entry in self.entries]
        self._functions = [self._function(entry, module) for entry, module in zip(self.entries, self.modules, strict=True)]
        self._own: dict[int, OwnFunction] = {}
        self._reads = [self._read(k) for k in range(len(self.entries))]
        self._arrange()

    def trace(self) -> None:
        """Let the kernel of observables compute the user functions that can be traced."""
        for k, function in enumerate(self._functions):
            if function is not None:
                own, observer = self._as_observable(k, function), self.simulator.observer
                if observer.kernels and observer.has_kernel(own):
                    self._own[k] = own
        if self._own:
            self.simulator.observer.want(self._own.values())
            self._arrange()

    def _as_observable(self, k: int, function: UserFunction) -> OwnFunction:
        entry, module = self.entries[k], self.modules[k]
        member = None if module is None else inspect.getattr_static(type(module), entry["prop"])
        user = entry["fn"] if module is None else getattr(member, "fget", member)
        return OwnFunction(user, module, self.satellite, partial(self._call, entry, module, function), entry["name"])

    def _arrange(self) -> None:
        """Find the runs of neighboring entries that the kernel computes together."""
        numbered = range(len(self.entries))
        runs = [list(run) for _, run in itertools.groupby(numbered, lambda k: self._observed(k) is None)]
        self._runs = [(run, tuple(quantity for k in run if (quantity := self._observed(k)) is not None)) for run in runs]
        self._norms: dict[tuple[Function, ...], Tensor] = {}

    @property
    @override
    def functions(self) -> list[UserFunction]:
        return [function for function in self._functions if function is not None]

    def _function(self, entry: dict[str, Any], module: object) -> UserFunction | None:
        """Return the user's function or property called by an entry; None for those of the package."""
        title = f"{entry['name']!r} of {self.name!r}"
        if module is None:
            return None if is_own(entry["fn"]) else UserFunction(title, ADVICE)
        owner = next(cls for cls in type(module).__mro__ if entry["prop"] in vars(cls))
        member = vars(owner)[entry["prop"]]
        packaged = is_of_package(owner) or isinstance(member, observable)
        return None if packaged else UserFunction(f"{title}, {owner.__name__}.{entry['prop']},", ADVICE)

    def _observed(self, k: int) -> Function | None:
        """Return the function of the k-th entry if it is an observable, or traced; vitals are read as methods."""
        if k in self._own:
            return self._own[k]
        member = None if self.modules[k] is None else getattr(type(self.modules[k]), self.entries[k]["prop"])
        return member.function if isinstance(member, observable) and not isinstance(member, vital) else None

    @override
    def observables(self) -> list[Function]:
        pairs = zip(self.entries, self.modules, strict=True)
        properties = [getattr(type(module), entry["prop"]) for entry, module in pairs if module is not None]
        return [member.function for member in properties if isinstance(member, observable)]

    def _module(self, entry: dict[str, Any]) -> Any:
        modules = {"dynamics": self.satellite.dynamics, "fsw": self.satellite.fsw}
        if "module" in entry:
            if entry["module"] not in modules:
                raise ValueError(f"module={entry['module']!r} must be one of {sorted(modules)}")
            modules = {entry["module"]: modules[entry["module"]]}
        for module in modules.values():
            if hasattr(type(module), entry["prop"]):
                return module
        names = {n for m in modules.values() for n in dir(type(m)) if isinstance(getattr(type(m), n, None), property)}
        models = having(entry["prop"])
        advice = f"{' or '.join(models)} has it" if models else nearest(entry["prop"], names)
        raise ValueError(f"prop={entry['prop']!r} is not a property of {self.satellite.name}; {advice}")

    def _read(self, k: int) -> Callable[[], Any]:
        """Return the reader of an entry: the column of an observable, a property, or a function, of the user or the package."""
        entry, module, function = self.entries[k], self.modules[k], self._functions[k]
        if function is not None:
            return partial(self._call, entry, module, function)
        if module is None:
            return partial(entry["fn"], self.satellite)
        member = getattr(type(module), entry["prop"])
        if isinstance(member, observable) and not isinstance(member, vital):
            return partial(self.simulator.observer.read, member.function)
        return partial(getattr, module, entry["prop"])

    @override
    def get_obs(self) -> Values:
        return {entry["name"]: scaled(self._number(k), entry["norm"]) for k, entry in enumerate(self.entries)}

    def _number(self, k: int) -> Any:
        own = self._own.get(k)
        return self._reads[k]() if own is None else self.simulator.observer.read(own)

    def get_vector(self) -> Tensor:
        """See :meth:`Observation.get_vector`; neighboring observables are read together."""
        parts = []
        for run, functions in self._runs:
            numbers = self.simulator.observer.read_together(functions)
            parts += [self._column(k) for k in run] if numbers is None else [numbers / self._norms_of(run, functions)]
        return torch.cat(parts, -1)

    def _column(self, k: int) -> Tensor:
        entry = self.entries[k]
        value = scaled(self._number(k), entry["norm"])
        return side_by_side(f"{self.name}.{entry['name']}", value, self.simulator.state.rows)

    def _norms_of(self, run: list[int], functions: tuple[Function, ...]) -> Tensor:
        """Return the norms of a run of entries, side by side like their ``functions``, [W]."""
        if functions not in self._norms:
            norms = [torch.as_tensor(self.entries[k]["norm"], dtype=torch.float64) for k in run]
            wide = [norm.expand(self._reads[k]()[:1].shape).flatten() for k, norm in zip(run, norms, strict=True)]
            self._norms[functions] = torch.cat(wide)
        return self._norms[functions]

    def _call(self, entry: dict[str, Any], module: object, function: UserFunction) -> Tensor:
        call = partial(entry["fn"], self.satellite) if module is None else partial(getattr, module, entry["prop"])
        return function((len(self.simulator.ticks),), self.simulator.device, call)


class Time(Observation):
    """Time since reset, or until the time limit, divided by ``norm``; [N]."""

    def __init__(self, norm: float | None = None, name: str = "time", observe_time_remaining: bool = False) -> None:
        """Observe the time since reset, or the one remaining, divided by ``norm``, s; None for the time limit."""
        super().__init__(name)
        self.norm = None if norm is None else number("obs.Time: norm", parse_norm(norm, "obs.Time: norm"))
        self.remaining = switch("observe_time_remaining", observe_time_remaining)

    def get_obs(self) -> Tensor:
        """See :meth:`Observation.get_obs`; with an infinite limit the elapsed fraction is 0 and the remaining one 1."""
        limit, time = self.satellite.time_limit, self.simulator.sim_time
        norm = limit if self.norm is None else torch.full_like(time, self.norm)
        if not self.remaining:
            return time / norm
        return torch.where(torch.isfinite(limit), (limit - time) / norm, torch.ones_like(time))


class Eclipse(Observation):
    """Time until the next start and until the next end of an eclipse, divided by ``norm`` seconds, or the period; [N, 2].

    They need not belong to the same eclipse: within one, the start is that of the next one. Where none starts, or ends, within
    1.1 revolutions, but at least 12,000 s and at most two days, that time is observed. See
    :meth:`~bsk_torch.sats.bound.BoundSatellite.next_eclipse`.
    """

    def __init__(self, norm: float | None = 1.0, name: str = "eclipse", sampled: bool = False) -> None:
        """Observe eclipses.

        Args:
            norm: Divisor, s, or None for the period of the satellite's current orbit.
            name: Name of the observation.
            sampled: Whether to observe samples, for policies trained with them: times on a grid of 30 s,
                and those of one second after reset, negative later, if its search of 6,000 s fails. It fails where there is no
                eclipse, and often on orbits with longer periods.
        """
        super().__init__(name)
        self.norm = None if norm is None else parse_norm(norm, "obs.Eclipse: norm")
        self.sampled = switch("sampled", sampled)

    @override
    def get_obs(self) -> Tensor:
        start, end = self.satellite.next_eclipse(self.sampled)
        seconds = torch.stack([start, end], -1) - self.simulator.state.sim_time.unsqueeze(-1)
        if self.norm is not None:
            return seconds / self.norm
        a, mu = self.satellite.dynamics.semi_major_axis, self.satellite.sat_args["mu"]
        return seconds / (2.0 * math.pi * torch.sqrt(a**3 / mu)).unsqueeze(-1)


class ResourceRewardWeight(Observation):
    """Weights of all :class:`bsk_torch.data.ResourceReward` of the environment in their order, divided by ``norm``; [N, K]."""

    def __init__(self, name: str = "resource_reward_weight", norm: object = 1.0) -> None:
        """Observe weights; ``norm`` is a number, or one for each weight."""
        super().__init__(name)
        self.norm = parse_norm(norm, "obs.ResourceRewardWeight: norm")

    def get_obs(self) -> Tensor:
        """See :meth:`Observation.get_obs`; ValueError without a resource reward, or for a wrong number of norms."""
        weights = getattr(self.satellite.rewarder, "resource_weights", ())
        if not weights:
            raise ValueError(
                f"{self.name!r} observes weights of data.ResourceReward, which the rewarder, a "
                f"{type(self.satellite.rewarder).__name__}, does not have"
            )
        if isinstance(self.norm, Tensor) and len(self.norm) != len(weights):
            raise ValueError(f"{self.name!r} has {len(self.norm)} norms for {len(weights)} weights; there must be equally many")
        return scaled(self.simulator.of_env(torch.stack(weights, -1)), self.norm)
