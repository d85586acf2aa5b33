"""Draws of the arguments of the satellites of one type, and what trial draws show."""

from __future__ import annotations

import dataclasses
import logging
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import torch
from torch import Tensor

from bsk_torch.constants import NANO
from bsk_torch.rand import Key, first_key
from bsk_torch.sim.arguments.sources import Answers
from bsk_torch.sim.arguments.values import Arguments, Overrides, merge
from bsk_torch.sim.assembly.initial_orbits import check_orbits
from bsk_torch.sim.component import Arg, Component, Values, asked

logger = logging.getLogger(__name__)

ArgumentChange = tuple[int, str, object, Sequence[int] | None]  # see bsk_torch.sim.arguments.values.Arguments.changed


class TrialDraw(NamedTuple):
    """What a trial draw shows."""

    values: Values  # arguments of one or two environments by name
    parameters: dict[str, Tensor]  # parameters that follow from them by name
    uniform: set[str]  # names of the parameters that are the same for all rows


@dataclass(frozen=True)
class TypeArguments:
    """Arguments of the satellites of one type and of their world, and their draws."""

    sat_args: Arguments  # arguments of the models
    world_args: Arguments
    parts: tuple[Component, ...]  # components of world and satellites, which check them, in the order of a tick
    h_ns: int  # length of a tick, ns
    orbit: str  # how orbits are computed: `"arc"`, `"integrated"` or `"free"`
    controlled: bool  # whether actions may switch attitude control on, so that its gains matter
    randomize: Callable[[Key], Overrides]  # draws arguments that replace those of some satellites
    taken: frozenset[str]  # names of what the scenario draws
    lenient: bool = False  # whether values that do not fit the length of a tick are logged only, as Basilisk runs with them
    _logged: set[str] = field(default_factory=set)
    """What has been logged about arguments."""
    _checked: set[str] = field(default_factory=set)
    """Slots of the components whose arguments have been checked."""

    @property
    def count(self) -> int:
        """Number of satellites of the type in an environment."""
        return len(self.sat_args.columns)

    def is_new(self, about: str) -> bool:
        """Return whether nothing has been logged about a part yet, so that the caller logs it once."""
        new = about not in self._logged
        self._logged.add(about)
        return new

    def argument(self, name: str) -> Arg:
        """Return the entry of an argument of satellites or world."""
        return self.sat_args.table[name] if name in self.sat_args.table else self.world_args.table[name]

    def draw(
        self,
        key: Key,
        world: Mapping[str, object] | None = None,
        overrides: Overrides | None = None,
        answers: Sequence[Answers] | None = None,
    ) -> Values:
        """Return the arguments from which episodes of the key's n environments start; raises before anything has changed.

        Values of satellites and world are [1, ...] or [n * count, ...] by name. Arguments of the ``world`` may have been drawn
        already, such as by a simulation of other satellites; ``overrides`` ones replace those of some satellites. User functions
        are called now, unless ``answers`` has what they returned for each environment.
        """
        around, count = self.world_args.draw(key, world, answers), self.count
        random = self.world_args.random.intersection(around) if count > 1 else ()
        values = {**around, **{name: around[name].repeat_interleave(count, 0) for name in random}}
        values |= self.sat_args.draw(key, None, answers, around.get("utc_init"))
        for name, (columns, replaced) in (overrides or {}).items():
            values[name] = self.sat_args.override(name, values.get(name), columns, replaced)
        if taken := sorted(values.keys() & self.taken):
            raise ValueError(f"the scenario draws {taken}, which are arguments of satellite or world; give them other names")
        self._check(values, overrides or ())
        return values

    def draw_some(self, names: Sequence[str], key: Key) -> dict[str, object]:
        """Return only the arguments ``names`` of satellites, as :meth:`draw` returns them, unchecked."""
        values = self.sat_args.draw_some(names, key)
        for name, (columns, replaced) in self.randomize(key).items():
            if name in values:
                values[name] = self.sat_args.override(name, values[name], columns, replaced)
        return values

    def _check(self, values: dict[str, object], replaced: Collection[str]) -> None:
        """Ask components what values mean together, and for the length of a tick: once where they are constant.

        ``replaced`` are the names of arguments that are replaced of some satellites. Marginal values are logged once for each
        component.
        """
        changing = self.sat_args.random.union(self.world_args.random, replaced)
        constant = {part.slot for part in self.parts if changing.isdisjoint(part.arguments)}
        checking = (part for part in self.parts if part.check or part.check_tick)
        pairs = asked([part for part in checking if part.slot not in constant & self._checked], values)
        for part, part_values in pairs:
            if part.check is not None and (result := part.check(part_values)) is not None:
                raise TypeError(
                    f"check(args) of the component in slot {part.slot!r} returns {result!r}; it must raise ValueError for "
                    "arguments that do not fit together, and return None"
                )
        wrong = []
        for part, part_values in pairs:
            if part.check_tick is None or (part.slot == "control" and not self.controlled):
                continue
            try:
                words = part.check_tick(part_values, self.h_ns * NANO)
            except ValueError as error:
                words = str(error)
                if not self.lenient:
                    wrong.append(words)
                    continue
            if words and self.is_new(part.slot):
                logger.warning("sat_args: %s", words)
        if wrong:
            raise ValueError(f"sat_args: {'; and '.join(wrong)}")
        check_orbits(values, self.orbit)
        self._checked.update(constant)

    def check_per_env(self, env_ids: Tensor) -> None:
        """Check the values of ``rand.per_env`` in all environments, [n] indices in draws, with those of the first for the rest.

        ValueError for too few rows, and values that are not allowed.
        """
        key = dataclasses.replace(first_key(len(env_ids)), env_id=env_ids.cpu())
        around = self.world_args.draw_per_env(key)
        et = self.world_args.draw_some(["utc_init"], key)["utc_init"] if "utc_init" in self.world_args.table else None
        sat_values = self.sat_args.draw_per_env(key, et)
        if not around and not sat_values:
            return
        first = key.take([0])
        overrides = self.randomize(first)
        others = {
            name: value.repeat(len(key), *[1] * (value.ndim - 1)) if isinstance(value, Tensor) and len(value) > 1 else value
            for name, value in self.draw(first, overrides=overrides).items()
        }
        around = {name: value.repeat_interleave(self.count, 0) for name, value in around.items()}
        per_env = {name: value for name, value in (around | sat_values).items() if name not in overrides}
        self._check(others | per_env, overrides)

    def changed(self, satellite: Sequence[ArgumentChange], world: Sequence[ArgumentChange]) -> TypeArguments:
        """Return arguments with other values; these remain unchanged. KeyError, ValueError for wrong changes."""
        return dataclasses.replace(self, sat_args=self.sat_args.changed(satellite), world_args=self.world_args.changed(world))

    def trial(self, num_envs: int, envs: Sequence[int] = ()) -> TrialDraw:
        """Return a trial draw of a batch of ``num_envs`` environments; the first of ``envs`` takes part in it."""
        key = first_key(min(2, num_envs))
        if envs:
            key = dataclasses.replace(key, env_id=torch.tensor([envs[0], *envs[-1:]])[: len(key)])
        overrides = self.randomize(key)
        values = self.draw(key, overrides=overrides)
        parameters = merge(values, self.parts, "prepare")
        uniform = {name for name, value in parameters.items() if len(value) == 1}
        if num_envs * self.count == 1:  # a batch of one shows only so what follows from no random argument
            random = self.sat_args.random.union(self.world_args.random, overrides)
            double = {
                name: torch.cat([value, value]) if name in random and isinstance(value, Tensor) else value
                for name, value in values.items()
            }
            uniform &= {name for name, value in merge(double, self.parts, "prepare").items() if len(value) == 1}
        return TrialDraw(values, parameters, uniform)
