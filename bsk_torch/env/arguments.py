"""Changes of satellite and world arguments between episodes."""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Sequence
from typing import Any, TypeVar

import torch
from tensordict import TensorDict
from torch import Tensor

from bsk_torch.env.assembly.trial import Made, Trial, taking_over
from bsk_torch.env.assembly.types import check_world
from bsk_torch.env.changes import Change, LiveArguments, changed, episodes, of_satellites, of_world, remembered
from bsk_torch.env.snapshots import Snapshots, fingerprint
from bsk_torch.sim.faults.declared import Fault
from bsk_torch.sim.names import nearest

Environment = TypeVar("Environment", bound="MadeOfArguments")


class MadeOfArguments(Snapshots):
    """Part of an environment: its arguments, their changes, and the construction of similar environments."""

    _arguments: dict[str, Any]
    """Arguments of the constructor by name."""

    _changes: list[Change]
    """Changes of arguments since then."""

    _trial: Trial | None
    """Trial episodes; None if they have tried user functions, which depend on the number of environments."""

    def set_sat_args(self, args: object, envs: object = None) -> None:
        """Change arguments of satellites for episodes started after this call; current episodes keep their values.

        Values are as in ``sat_args``, including ``rand.per_env`` for one value per environment. After editing its tensor in
        place, set it again, since the next episodes may already be prepared. Nothing is recompiled for arguments drawn from the
        start (a distribution, ``rand.per_env``, a callable), or that only set initial conditions. If a parameter of the tick was
        a constant, the tick is rebuilt once, and states saved before no longer fit.

        Args:
            args: New values by name of the argument, for all satellites; a dictionary of such dictionaries by name of the
                satellite; or a function that returns a dictionary.
            envs: Indices of the environments to change, [n], or a mask [N] (default: all).

        Raises:
            KeyError: For an unknown argument.
            ValueError: For a value that is not allowed, an argument that determines the structure of the simulation, or an
                unknown satellite.
        """
        rows, ids = episodes(envs, len(self.env_ids), self.env_ids)
        self._change(of_satellites(args, self.names, ids), rows)

    def set_world_args(self, args: object, envs: object = None) -> None:
        """Change arguments of the world, as :meth:`set_sat_args` does for satellites."""
        rows, ids = episodes(envs, len(self.env_ids), self.env_ids)
        changes = of_world(args, ids)
        check_world([change.name for change in changes], [s.type.arguments.world_args.table for s in self.fleet.simulators])
        self._change(changes, rows)

    def _change(self, changes: Sequence[Change], rows: Tensor | None = None) -> None:
        """Change arguments in ``rows`` [n] of the batch, or in all; if one change is invalid, nothing changes."""
        types = changed([simulator.type for simulator in self.fleet.simulators], changes, self.env_ids)
        self.fleet.change(types)
        if self.pool is not None:
            self.pool.change(types, rows)
        self._changes = remembered(self._changes, changes)
        self.fingerprint = fingerprint(self.fleet)

    def _show_arguments(self) -> None:
        for simulator, satellite in zip(self.fleet.simulators, self.satellites, strict=True):
            satellite.sat_args_generator = LiveArguments(  # type: ignore[assignment]  # of the description: Given
                lambda simulator=simulator: [simulator.type.arguments.sat_args],  # type: ignore[misc]
                functools.partial(self._set_type, [self.names[column] for column in simulator.columns]),
                "sat_args_generator",
            )

    def _set_type(self, names: Sequence[str], values: dict[str, object]) -> None:
        if len(names) > 1:
            raise TypeError(
                f"sat_args_generator belongs to {list(names)}; env.set_sat_args({{{names[0]!r}: {values}}}) sets one of them"
            )
        self.set_sat_args({names[0]: values})

    @property
    def world_args_generator(self) -> LiveArguments:
        """Values of all arguments of the world; setting one calls :meth:`set_world_args`."""
        return LiveArguments(
            lambda: [simulator.type.arguments.world_args for simulator in self.fleet.simulators],
            self.set_world_args,
            "world_args_generator",
        )

    def inject(self, fault: Fault | str, envs: object = None, satellite: str | None = None) -> None:
        """Let a fault begin now, in current episodes; it acts from the next tick on, for as long as it was declared to last.

        Args:
            fault: A fault of ``sat_args["faults"]``, or its name. One that is declared without a time never happens otherwise.
            envs: Indices of the environments, [n], or a mask [N] (default: all).
            satellite: Name of the satellite that has the fault (default: all that declare it).

        Raises:
            ValueError: For a fault that is not declared, or an unknown satellite.
            IndexError: For indices out of range.
            ResetNeededError: For episodes that have not begun.
        """
        name = fault.name if isinstance(fault, Fault) else fault
        if satellite is not None and satellite not in self.names:
            raise ValueError(f"inject: satellite={satellite!r} is unknown; {nearest(str(satellite), self.names)}")
        rows, _ = episodes(envs, len(self.env_ids), self.env_ids)
        rows = self.fleet.all_envs if rows is None else rows.to(self.device)
        if satellite is None:
            struck = [k for k in self.fleet.simulators if name in [fault.name for fault in k.state.argument("faults") or ()]]
        else:
            struck = [k for k in self.fleet.simulators if satellite in [self.names[column] for column in k.columns]]
        with self.guard:
            self.guard.check_begun("inject(fault)", torch.zeros_like(self.state.begun).index_fill(0, rows, True))
            for simulator in struck or self.fleet.simulators[:1]:  # which names what it has
                columns = [k for k, column in enumerate(simulator.columns) if satellite in (None, self.names[column])]
                struck_rows = rows.unsqueeze(-1) * simulator.count + torch.tensor(columns, device=self.device)
                simulator.strike(name, struck_rows.flatten())

    def like(self: Environment, num_envs: int, env_ids: Sequence[int] | Tensor | None = None) -> Environment:
        """Return another environment of the same kind, with separate episodes, seed 0 and no logs.

        Use :meth:`restore` to copy episodes from one to the other. Satellite types are shared, so nothing is traced or compiled.

        Args:
            num_envs: Number of its episodes.
            env_ids: Their indices in draws (default: 0 to ``num_envs`` - 1).

        Raises:
            ValueError: For an invalid argument, or if arguments of :func:`bsk_torch.rand.per_env` have too few rows.
            MemoryError: If the episodes do not fit into memory.
        """
        return self.remade(num_envs=num_envs, env_ids=env_ids, seed=0)

    def remade(self: Environment, **changes: Any) -> Environment:
        """Return another environment made of the same arguments of the constructor but for ``changes``, without logs.

        With ``num_envs``, ``env_ids`` are 0 to ``num_envs`` - 1 unless given. If only these and ``seed`` change, satellite types
        are shared, as by :meth:`like`. TypeError and ValueError as from the constructor.
        """
        kept = {name: value for name, value in self._arguments.items() if name not in ("log_level", "log_dir", "log_envs")}
        ids = {"env_ids": None} if "num_envs" in changes else {}
        plain = {name for name, value in changes.items() if isinstance(value, str | float | None) and kept.get(name) == value}
        shares = changes.keys() - plain <= {"num_envs", "env_ids", "seed"}
        types = Made([simulator.type for simulator in self.fleet.simulators], self._trial)
        with taking_over(types) if shares else contextlib.nullcontext():
            other = type(self)(**(kept | ids | changes))
        if shares:
            other._changes = list(self._changes)
        elif self._changes:
            other._change(self._changes)
        return other

    def __reduce__(self) -> tuple[object, ...]:
        state = self.state.seed, self.episode, self.get_extra_state()
        return _rebuild, (type(self), self._arguments, *state, self._changes)


def _rebuild(
    kind: type[MadeOfArguments],
    arguments: dict[str, Any],
    seeds: Tensor,
    episode: Tensor,
    state: TensorDict | None,
    changes: Sequence[Change] = (),
) -> MadeOfArguments:
    env = kind(**arguments)
    if changes:
        env._change(changes)
    env.state.seed, env.state.episode = seeds, episode
    env.set_extra_state(state)
    return env
