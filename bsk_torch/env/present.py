"""Information on satellites and current episodes of an environment: numbers, pictures, help."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from importlib import import_module
from typing import Any

import torch
from torch import Tensor

from bsk_torch._checks import whole
from bsk_torch.env import messages
from bsk_torch.env.episodes import Episodes
from bsk_torch.env.satellite_group import SatelliteGroup
from bsk_torch.env.snapshots import rows_of
from bsk_torch.sim.arguments.table import ArgumentTable
from bsk_torch.sim.hooks import check_tensor
from bsk_torch.sim.run.recording import Recording


class Present(Episodes):
    """Part of an environment: information on its satellites and its current episodes."""

    def __getattr__(self, name: str) -> Any:
        if name in messages.ATTRIBUTES:
            why = f"for it is an environment of TorchRL: {messages.ATTRIBUTES[name]}"
            raise AttributeError(f"{type(self).__name__} has no attribute {name!r}, {why}")
        return super().__getattr__(name)

    @property
    def present(self) -> Tensor:
        """Satellites taking part in the current episodes, from the start to their death or the end, [N, S] bool."""
        present = self.fleet.present
        return torch.ones_like(self.state.removed) if present is None else present

    @property
    def dead(self) -> Tensor:
        """Satellites that have died, [N, S] bool."""
        return self.fleet.joined([satellite.task.dead for satellite in self.satellites])

    @property
    def requires_retasking(self) -> Tensor:
        """Satellites without a task, [N, S] bool."""
        return self.fleet.joined([satellite.task.requires_retasking for satellite in self.satellites])

    @property
    def truncated_by_time(self) -> Tensor:
        """Episodes at their time limit, [N]."""
        return self.fleet.ticks >= self.state.limit_ticks

    def counts(self) -> dict[str, Tensor]:
        """Return the counters of satellites and rewarder, [N, S] each, by name."""
        each = [_counted(satellite) for satellite in self.satellites]
        counted: dict[str, Tensor] = {}
        for name in dict.fromkeys(itertools.chain(*each)):
            parts = zip(each, self.satellites, strict=True)
            tables = [counts[name] if name in counts else torch.zeros_like(group.task.ends) for counts, group in parts]
            counted[name] = self.fleet.joined(tables)
        return counted | self.checked.counts(counted)

    def record(
        self,
        fields: str | Sequence[str],
        rows: int | Sequence[int] | Tensor | None = None,
        every: int = 1,
        satellites: str | Sequence[str] | None = None,
    ) -> Recording:
        """Record fields of the state at every tick from now on, until ``stop()`` of the recording or the end of its context.

        Recording does not change the episodes, and rows that are not recorded run as before; see
        :mod:`bsk_torch.sim.run.recording`. Episodes that begin later are also recorded.

        Args:
            fields: Names of fields, such as ``("sigma_BN", "omega_BN_B")``, listed by ``env.simulator.state.layout.fields``,
                or of properties of the models, such as ``"nadir_pointing_error"``, written as an ``observable``.
            rows: Environments, or one environment (default: all).
            every: Ticks from one record to the next, counted from the start of an episode.
            satellites: Names of satellites, or one name (default: all).

        Raises:
            IndexError: For a row out of range.
            KeyError: For an unknown satellite.
            ResetNeededError: For episodes that have not begun.
            ValueError: For an empty or unknown list of fields, or an invalid number of ticks.
        """
        fields = (fields,) if isinstance(fields, str) else tuple(fields)
        if not fields:
            raise ValueError("fields=() must name at least one field of the state, such as 'sigma_BN'")
        every = whole("every", every, 1)
        chosen = self.fleet.all_envs if rows is None else [rows] if isinstance(rows, int) else rows
        envs = rows_of("rows", chosen, self.num_envs, torch.device(self.device)).unique()
        names = self.names if satellites is None else (satellites,) if isinstance(satellites, str) else tuple(satellites)
        with self.guard:
            self.guard.check_begun("record()", torch.zeros_like(self.state.begun).index_fill(0, envs, True))
            models = [(type(satellite.fsw), type(satellite.dynamics)) for satellite in self.satellites]
            observables = [fsw.observables() | dynamics.observables() for fsw, dynamics in models]
            return Recording(self.fleet, fields, envs, every, names, observables)

    def render(self, rows: int | Sequence[int] | None = None, height: int = 480) -> Tensor:
        """Draw the current state: the Earth, the satellites and their tasks. Rendering does not change the episodes.

        TorchRL's ``PixelRenderTransform`` calls this method; with ``rows=0``, it records one environment of a batch. It resets
        the environment to determine the shape of pictures, so read ``env.observation_spec`` before a rollout.

        Args:
            rows: Environment to draw, or several; None for all, at most 16.
            height: Height in pixels, an even number of at least 120; the width is 4/3 of it.

        Returns:
            Pixels [len(rows), height, width, 3], or [height, width, 3] of a single environment; uint8.

        Raises:
            ModuleNotFoundError: Without the extra ``viz``.
            ResetNeededError: For episodes that have not begun.
            ValueError: For an invalid argument.
        """
        with self.guard:
            return pictures().frames(self, rows, height)

    def default_sat_args(self) -> ArgumentTable:
        """Return every argument of ``sat_args`` of the first satellite with its default; printed, the changed ones come first."""
        first = next(satellite for satellite in self.satellites if 0 in satellite.simulator.columns)
        return self.builder.satellites[0].default_sat_args().beside(first.sat_args_generator)

    def default_world_args(self) -> ArgumentTable:
        """Return every argument accepted in ``world_args``, with its default; printed as :meth:`default_sat_args`."""
        return self.builder.default_world_args().beside(self.world_args_generator)

    @property
    def bytes_per_env(self) -> int:
        """Bytes of one environment's state, including its prepared next episode; windows found later add a little."""
        return (self.state.nbytes + (self.pool.nbytes if self.pool else 0)) // self.num_envs

    def check_finite(self) -> None:
        """Check the fields of all satellites; FloatingPointError with environment, field and tick for NaN or infinity."""
        for satellite in self.satellites:
            state = satellite.simulator.state
            for name in state.layout.fields:
                value = state.read(name).reshape(state.rows, -1)
                bad = torch.nonzero(~torch.isfinite(value).all(-1)).squeeze(-1).tolist()
                if bad:
                    row = bad[0]
                    raise FloatingPointError(
                        f"{name!r} of {satellite.title(row)} is {value[row].tolist()} at tick {int(state.ticks[row])} "
                        f"({len(bad)} of them in all)"
                    )


def pictures() -> Any:
    """Return the module for drawing; ModuleNotFoundError without the extra ``viz``."""
    try:
        return import_module("bsk_torch.viz.render.frames")
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(f"render() needs {error.name}: pip install 'bsk_torch[viz]'", name=error.name) from error


def _counted(satellite: SatelliteGroup) -> dict[str, Tensor]:
    counts, shape = satellite.counts(), satellite.simulator.state.ticks.shape
    for name, count in counts.items():
        check_tensor(f"{type(satellite).__name__}.counts()[{name!r}]", count, shape, torch.int64)
    return counts
