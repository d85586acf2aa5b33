"""Observations of one satellite, and their builder."""

from __future__ import annotations

import logging
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Sequence
from copy import deepcopy
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from gymnasium import spaces
from typing_extensions import override

from bsk_torch.bsk_rl.utils.functional import Part, ResetableGroup, numbers_of, vectorize_nested_dict

if TYPE_CHECKING:
    from numpy.typing import DTypeLike

    from bsk_torch.bsk_rl.sats.access_satellite import Opportunity
    from bsk_torch.bsk_rl.sats.satellite import Satellite


logger = logging.getLogger(__name__)

LARGEST = 1e16
"""Bound of the numbers of observation spaces, as in bsk_rl."""

Entry = dict[str, Any]
"""An observed quantity: ``prop``, ``fn``, ``norm``, ``name``, ``module``."""


def nested_obs_to_space(obs_dict: Any, dtype: Any) -> spaces.Space[Any]:
    """Return the space of an observation; TypeError for what is no array, number, list or dictionary of such."""
    if isinstance(obs_dict, dict):
        return spaces.Dict({name: nested_obs_to_space(part, dtype) for name, part in obs_dict.items()})
    if isinstance(obs_dict, list):
        shape: tuple[int, ...] = (len(obs_dict),)
    elif isinstance(obs_dict, np.ndarray):
        shape = obs_dict.shape
    elif isinstance(obs_dict, float | int | np.number):
        shape = (1,)
    else:
        raise TypeError(f"Cannot convert {obs_dict} to gym space.")
    return spaces.Box(low=-LARGEST, high=LARGEST, shape=shape, dtype=dtype)


def checked_entries(entries: tuple[Entry, ...], keys: tuple[str, ...]) -> None:
    """Raise ValueError for an unknown key of an entry; give entries without one a norm."""
    for entry in entries:
        for key in entry:
            if key not in keys:
                raise ValueError(f"Invalid property key: {key}; valid are {list(keys)}")
        entry.setdefault("norm", 1.0)


def name_entry(entry: Entry, name: str) -> None:
    """Name an entry, unless it has a name; names of normalized ones have a suffix."""
    entry.setdefault("name", name if entry["norm"] == 1.0 else f"{name}_normd")


class ObservationBuilder(ResetableGroup):
    """Combines the observations of a satellite.

    Attributes:
        obs_type: ``np.ndarray``, ``list`` or ``dict``; it may be set at any time.
        dtype: Type of vectors.
        observation_spec: The observations, copies of those of the satellite's class.
    """

    def __init__(self, satellite: Satellite, obs_type: type = np.ndarray, dtype: DTypeLike = np.float64) -> None:
        """Copy and link the observations of a satellite; those of the same name get numbers."""
        self.obs_type, self.dtype, self.satellite = obs_type, dtype, satellite
        self.simulator: Any = None
        self.obs_dict_cache: dict[str, object] | None = None
        self.obs_cache_time = 0.0
        self.observation_spec: list[Observation] = deepcopy(list(satellite.observation_spec))
        counts = Counter[str]()
        for entry in self.observation_spec:
            counts[entry.name] += 1
            if counts[entry.name] > 1:
                entry.name += f"_{counts[entry.name]}"
            entry.link_satellite(satellite)

    @override
    def _parts(self) -> list[Observation]:
        return self.observation_spec

    @override
    def reset_post_sim_init(self) -> None:
        self.simulator, self.obs_dict_cache = self.satellite.simulator, None
        for entry in self.observation_spec:
            entry.link_simulator(self.simulator)
        super().reset_post_sim_init()

    def obs_dict(self) -> dict[str, object]:
        """Return the observations by name; they are computed once at each time."""
        return deepcopy(self._obs_dict())

    def _obs_dict(self) -> dict[str, object]:
        if self.obs_dict_cache is None or self.simulator.sim_time != self.obs_cache_time:
            self.obs_dict_cache = {}
            for entry in self.observation_spec:
                value = entry.get_obs()
                self.obs_dict_cache[entry.name] = value.astype(self.dtype) if isinstance(value, np.ndarray) else value
            self.obs_cache_time = self.simulator.sim_time
        return self.obs_dict_cache

    def obs_ndarray(self) -> np.ndarray:
        """Return the observations as one vector."""
        return numbers_of(self._obs_dict())

    def obs_array_keys(self) -> list[str]:
        """Return the names of the entries of :meth:`obs_ndarray`."""
        return vectorize_nested_dict(self.obs_dict())[0]

    def obs_list(self) -> list[object]:
        """Return the observations as a list of numbers."""
        return list(self.obs_ndarray())

    def get_obs(self) -> object:
        """Return the observations in the form of ``obs_type``; ValueError for an unknown one."""
        forms: dict[type, Callable[[], object]] = {dict: self.obs_dict, np.ndarray: self.obs_ndarray, list: self.obs_list}
        if self.obs_type not in forms:
            raise ValueError(f"Invalid observation type: {self.obs_type}; valid are dict, np.ndarray and list")
        return forms[self.obs_type]()

    @cached_property
    def observation_space(self) -> spaces.Space[object]:
        """Space of the observations."""
        return nested_obs_to_space(self.get_obs(), dtype=self.dtype)

    @cached_property
    def observation_description(self) -> list[str]:
        """Names of the entries of the vector."""
        return self.obs_array_keys()


class Observation(ABC, Part):
    """Part of an observation. Subclasses define :meth:`get_obs`."""

    def __init__(self, name: str = "obs") -> None:
        self.name = name

    @abstractmethod
    def get_obs(self) -> object:
        """Return the current observation."""


class SatProperties(Observation):
    """Properties of the satellite's models, and functions of the satellite."""

    def __init__(self, *obs_properties: Entry, name: str = "sat_props") -> None:
        """Observe quantities.

        Args:
            *obs_properties: Dictionaries with ``prop``, the name of a property; ``module``, ``"dynamics"`` or ``"fsw"``
                (default: the one that has it); ``norm``, a divisor; ``name``; and ``fn``, a function of the satellite in place
                of a property.
            name: Name of the observation.
        """
        super().__init__(name=name)
        checked_entries(obs_properties, ("prop", "module", "norm", "name", "fn"))
        for entry in obs_properties:
            if "name" not in entry:
                name_entry(entry, entry["prop"])
        self.obs_properties = obs_properties

    def reset_post_sim_init(self) -> None:
        """Find the models that have the properties; AttributeError if none has."""
        for entry in self.obs_properties:
            if "module" not in entry and "fn" not in entry:
                for module in ("dynamics", "fsw"):
                    if hasattr(getattr(self.satellite, module), entry["prop"]):
                        entry["module"] = module
                        break
                else:
                    raise AttributeError(f"Property {entry['prop']} not found")

    @override
    def get_obs(self) -> dict[str, object]:
        observation = {}
        for entry in self.obs_properties:
            if "fn" in entry:
                value = entry["fn"](self.satellite)
            else:
                value = getattr(getattr(self.satellite, entry["module"]), entry["prop"])
            observation[entry["name"]] = (np.array(value) if isinstance(value, list) else value) / entry["norm"]
        return observation


class Time(Observation):
    """Time since reset, or until the time limit."""

    def __init__(self, norm: float | None = None, name: str = "time", observe_time_remaining: bool = False) -> None:
        """Initialize the observation; time is divided by ``norm`` s, or by the time limit if it is None."""
        super().__init__(name=name)
        self.norm, self.return_time_remaining = norm, observe_time_remaining

    def reset_post_sim_init(self) -> None:
        """Find the unit."""
        self._norm = self.simulator.time_limit if self.norm is None else self.norm

    @override
    def get_obs(self) -> float:
        now = self.simulator.sim_time
        return (self.simulator.time_limit - now if self.return_time_remaining else now) / self._norm


def _places(opportunities: Sequence[Opportunity]) -> np.ndarray:
    return np.array([opportunity["object"].r_LP_P for opportunity in opportunities], dtype=float)


def _target_angles(satellite: Satellite, opportunities: Sequence[Opportunity]) -> np.ndarray:
    lines_P = np.array([opportunity["r_LP_P"] for opportunity in opportunities]) - satellite.dynamics.r_BN_P
    return np.arccos(lines_P @ satellite.fsw.c_hat_P / np.linalg.norm(lines_P, axis=-1))


def _target_angle_rates(satellite: Satellite, opportunities: Sequence[Opportunity]) -> np.ndarray:
    model = satellite.dynamics
    lines_P = _places(opportunities) - model.r_BN_P
    turning = np.cross(model.v_BN_P, lines_P) / (lines_P**2).sum(-1, keepdims=True)
    return np.linalg.norm(model.omega_BP_P - turning, axis=-1)


def _lines_H(satellite: Satellite, opportunities: Sequence[Opportunity]) -> np.ndarray:
    model = satellite.dynamics
    return (_places(opportunities) @ satellite.simulator.world.PN - np.array(model.r_BN_N)) @ np.array(model.HN).T


def _of_one(function: Callable[[Satellite, Sequence[Opportunity]], np.ndarray]) -> Callable[[Satellite, Opportunity], object]:
    """Return the function of one opportunity that a function of several stands for."""

    def of_one(satellite: Satellite, opportunity: Opportunity) -> object:
        return function(satellite, [opportunity])[0]

    of_one.of_all = function  # type: ignore[attr-defined]
    return of_one


class OpportunityProperties(Observation):
    """Properties of the next opportunities."""

    _fn_map: ClassVar[dict[str, Callable[[Satellite, Opportunity], object]]] = {
        "priority": lambda sat, opp: opp["object"].priority,
        "r_LP_P": lambda sat, opp: opp["r_LP_P"],
        "r_LB_H": _of_one(_lines_H),
        "opportunity_open": lambda sat, opp: opp["window"][0] - sat.simulator.sim_time,
        "opportunity_mid": lambda sat, opp: sum(opp["window"]) / 2 - sat.simulator.sim_time,
        "opportunity_close": lambda sat, opp: opp["window"][1] - sat.simulator.sim_time,
        "target_angle": _of_one(_target_angles),
        "target_angle_rate": _of_one(_target_angle_rates),
    }

    def __init__(self, *target_properties: Entry, n_ahead_observe: int, type: str = "target", name: str | None = None) -> None:
        """Observe the next opportunities.

        Args:
            *target_properties: Dictionaries with ``prop``, one of bsk_rl's names, or ``fn``, a function of satellite and
                opportunity; ``norm``, a divisor; and ``name``.
            n_ahead_observe: Number of opportunities.
            type: Type of opportunities.
            name: Name of the observation; that of the type unless given.
        """
        super().__init__(name=type if name is None else name)
        self.type, self.target_properties, self.n_ahead_observe = type, target_properties, int(n_ahead_observe)
        checked_entries(target_properties, ("fn", "norm", "name", "prop"))
        for k, entry in enumerate(target_properties):
            if "fn" not in entry:
                if entry.get("prop") not in self._fn_map:
                    raise ValueError(
                        f"Property prop={entry.get('prop')} is not predefined and no `fn` was provided; "
                        f"predefined are {list(self._fn_map)}"
                    )
                entry["fn"] = self._fn_map[entry["prop"]]
            elif entry.get("prop") in self._fn_map:
                logger.warning("Ignoring default function for `%s` when `fn` is provided.", entry["prop"])
            name_entry(entry, entry.get("prop", f"prop_{k}"))

    @override
    def get_obs(self) -> dict[str, object]:
        opportunities = self.satellite.find_next_opportunities(n=self.n_ahead_observe, types=self.type, pad=True)
        columns = {entry["name"]: self._column(entry, opportunities) for entry in self.target_properties}
        return {f"{self.name}_{k}": {name: column[k] for name, column in columns.items()} for k in range(len(opportunities))}

    def _column(self, entry: Entry, opportunities: Sequence[Opportunity]) -> np.ndarray | list[object]:
        function, norm = entry["fn"], entry["norm"]
        if hasattr(function, "of_all") and opportunities:
            return function.of_all(self.satellite, opportunities) / norm
        return [function(self.satellite, opportunity) / norm for opportunity in opportunities]


class Eclipse(Observation):
    """Times until the next eclipse starts, and until the next one ends."""

    def __init__(self, norm: float = 1.0, name: str = "eclipse") -> None:
        """Initialize the observation; both times are divided by ``norm`` s."""
        super().__init__(name=name)
        self.norm = norm

    @override
    def get_obs(self) -> list[float]:
        now = self.simulator.sim_time
        return [(time - now) / self.norm for time in self.satellite.trajectory.next_eclipse(now)]


class ResourceRewardWeight(Observation):
    """Weights of all :class:`~bsk_torch.bsk_rl.data.ResourceReward`, in their order."""

    weight_vector: list[float]

    def __init__(self, name: str = "resource_reward_weight", norm: object = 1.0) -> None:
        """Initialize the observation; weights are divided by ``norm``, a number or a vector."""
        super().__init__(name=name)
        self.norm = norm

    def reset_overwrite_previous(self) -> None:
        """Forget the weights of the last episode; rewarders append theirs."""
        self.weight_vector = []

    @override
    def get_obs(self) -> object:
        return np.array(self.weight_vector) / self.norm
