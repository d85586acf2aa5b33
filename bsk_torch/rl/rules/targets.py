"""Positions of targets in the actions and observations of an environment."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, cast

import torch
from torch import Tensor

from bsk_torch.act import Action
from bsk_torch.env import SatelliteTasking
from bsk_torch.env.action_forms import form
from bsk_torch.obs import OpportunityProperties
from bsk_torch.obs.candidates import CandidateProperties
from bsk_torch.sim.arguments.values import nearest

WIDTHS = {"site_code": 8, "site_others": 3, "r_LP_P": 3, "r_LB_H": 3, "rel_pos_vector_r_BR_H": 3, "rel_vel_vector_v_BR_H": 3}
"""Number of columns of target properties with more than one."""

Observation = Any
"""A vector [N, F], or a tensordict with its parts."""


def image_actions(env: SatelliteTasking) -> range:
    """Return the indices of the actions that image the next targets, on the ground or in orbit, or point at candidates.

    ValueError if there are none, or of several instruments.
    """
    if len(env.satellite.simulator.type.instruments) > 1:
        raise ValueError(f"{env.satellite.name} has several instruments, between which rules and scores of targets do not choose")
    first = 0
    for entry in env.satellite.actions.entries if form(env.satellite) is None else ():
        action = cast(Action, entry)
        if targets := action.target_actions:
            return range(first + targets.start, first + targets.stop)
        first += action.n_actions
    raise ValueError(f"{env.satellite.name} images no targets; its actions are {env.satellite.action_description}")


def read(observation: Observation, description: Sequence[str], path: str) -> Tensor:
    """Return an observed value, [N], by its path, such as ``"sat_props.storage_level_fraction"``; KeyError if it is missing.

    Args:
        observation: The observation.
        description: Paths of all entries of the vector.
        path: Names of the nested parts, joined by dots.
    """
    if path not in description:
        raise KeyError(f"{path!r} is not observed; {nearest(path, description)}")
    if isinstance(observation, Tensor):
        return observation[..., description.index(path)]
    return observation[tuple(path.split("."))]


def _properties(entry: OpportunityProperties | CandidateProperties) -> list[tuple[str, float]]:
    if isinstance(entry, CandidateProperties):
        return [(part.prop, part.norm) for part in entry.entries]
    return [(str(part.get("prop") or part["fn"].__name__), float(part["norm"])) for part in entry.entries]


class TargetReader:
    """Reads properties of the next n targets from observations."""

    def __init__(self, entry: OpportunityProperties | CandidateProperties, description: Sequence[str]) -> None:
        """Read the columns of ``entry`` in observations whose vector has the entries ``description``."""
        self.entry, self.name, self.n = entry, entry.name, entry.n_ahead_observe
        self.column: dict[str, int] = {}
        self.norm: dict[str, float] = {}
        width = 0
        for prop, norm in _properties(entry):
            self.column[prop], self.norm[prop] = width, norm
            width += WIDTHS.get(prop, 1)
        kind = f"{self.name}.rows[" if entry.as_set else f"{self.name}.{self.name}_"
        rows = [k for k, path in enumerate(description) if path.startswith(kind)]
        self._mask = [k for k, path in enumerate(description) if path.startswith(f"{self.name}.mask[")]
        if len(rows) != self.n * width:
            raise ValueError(f"{self.name!r} has {len(rows) // self.n} columns, not {width}: a function gives several")
        self._rows = slice(rows[0], rows[0] + len(rows))  # adjacent: those of one observation; a slice copies nothing

    @classmethod
    def of(cls, env: SatelliteTasking) -> TargetReader:
        """Return the reader for an environment; ValueError if no targets are observed, or nested but not as a set."""
        satellite = env.satellite
        for entry in satellite.observations.entries:
            if isinstance(entry, CandidateProperties) or (isinstance(entry, OpportunityProperties) and entry.type == "target"):
                if satellite.obs_type is dict and not entry.as_set:
                    raise ValueError(f"{entry.name!r} is read from vectors, or from nested observations with as_set=True")
                return cls(entry, satellite.observation_description)
        raise ValueError(f"{satellite.name} observes no targets")

    def rows(self, observation: Observation) -> Tensor:
        """Return all properties of the targets, [N, n, F], divided by their norms."""
        if isinstance(observation, Tensor):
            return observation[..., self._rows].unflatten(-1, (self.n, -1))
        return observation[self.name, "rows"]

    def exist(self, observation: Observation) -> Tensor:
        """Return a mask of existing targets [N, n]; all True if padding, which repeats the last target, is not marked."""
        if not self.entry.as_set:
            return torch.ones_like(self.rows(observation)[..., 0], dtype=torch.bool)
        mask = observation[..., self._mask] if isinstance(observation, Tensor) else observation[self.name, "mask"]
        return mask.bool()

    def read(self, observation: Observation, prop: str) -> Tensor:
        """Return a property of the targets, [N, n] in its unit; KeyError if it is not observed."""
        return self.rows(observation)[..., self._column(prop)] * self.norm[prop]

    def read_vector(self, observation: Observation, prop: str) -> Tensor:
        """Return a property of :data:`WIDTHS` columns, [N, n, 3] in its unit; KeyError if it is not observed."""
        first = self._column(prop)
        return self.rows(observation)[..., first : first + WIDTHS[prop]] * self.norm[prop]

    def _column(self, prop: str) -> int:
        if prop not in self.column:
            raise KeyError(f"{prop!r} of targets is not observed; {nearest(prop, self.column)}")
        return self.column[prop]
