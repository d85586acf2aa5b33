"""Information on satellites and current episodes of an environment: numbers, pictures, help."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from importlib import import_module
from typing import Any

import torch
from torch import Tensor

from bsk_torch._checks import whole
from bsk_torch.data import checked
from bsk_torch.env import messages
from bsk_torch.env.episodes import Episodes
from bsk_torch.env.satellite_group import SatelliteGroup
from bsk_torch.env.snapshots import rows_of
from bsk_torch.sim.arguments.table import ArgumentTable
from bsk_torch.sim.run.recording import Recording


class Present(Episodes):
    """Part of an environment: information on its satellites and its current episodes."""

    def __getattr__(self, name: str) -> Any:
        """Look up what a module of torch registers; AttributeError with advice for names of Gymnasium's environments."""
        if name in messages.ATTRIBUTES:
            raise messages.no_attribute(type(self).__name__, name)
        return super().__getattr__(name)

    @property
    def present(self) -> Tensor:
        """Satellites that take part in the present episodes, from their beginning to death or end, [N, S] bool."""
        present = self.fleet.present
        return torch.ones_like(self.state.removed) if present is None else present

    @property
    def dead(self) -> Tensor:
        """Satellites that have died, [N, S] bool."""
        return self.fleet.joined([satellite.task.dead for satellite in self.satellites])

    @property
    def requires_retasking(self) -> Tensor:
        """Satellites that have no task left, [N, S] bool."""
        return self.fleet.joined([satellite.task.requires_retasking for satellite in self.satellites])

    @property
    def truncated_by_time(self) -> Tensor:
        """Episodes whose time is up, [N]."""
        return self.fleet.ticks >= self.state.limit_ticks

    def counts(self) -> dict[str, Tensor]:
        """Return the counters of satellites and rewarder, [N, S] each, by name."""
        names = dict.fromkeys(name for satellite in self.satellites for name in satellite.counts())
        counted = {name: self.fleet.each(functools.partial(_counted, name)) for name in names}
        return counted | checked.counts(self.rewarder, counted)

    def record(
        self,
        fields: str | Sequence[str],
        rows: int | Sequence[int] | Tensor | None = None,
        every: int = 1,
        satellites: str | Sequence[str] | None = None,
    ) -> Recording:
        """Record fields of the state at the ticks of all steps from now on, until ``stop()`` of what is returned, or its context.

        The future of the episodes is not changed, and rows that are not recorded run as ever; see
        :mod:`bsk_torch.sim.run.recording`. Episodes that begin meanwhile are recorded, too.

        Args:
            fields: Names of fields, such as ``("sigma_BN", "omega_BN_B")``; ``env.simulator.state.layout.fields`` has them all.
            rows: Environments, or one (default: all).
            every: Ticks from one record to the next, counted from the beginning of an episode.
            satellites: Names of satellites, or one (default: all).

        Raises:
            IndexError: For a row that does not exist.
            KeyError: For a satellite that does not exist.
            ResetNeededError: For episodes that have not begun.
            ValueError: For no fields, an unknown one, or a wrong number of ticks.
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
            return Recording(self.fleet, fields, envs, every, names)

    def render(self, rows: int | Sequence[int] | None = None, height: int = 480) -> Tensor:
        """Draw the present: the Earth, the satellites and their tasks; the future of the episodes is not changed.

        TorchRL's ``PixelRenderTransform`` calls it, with ``rows=0`` for a video of one environment of many. It resets the
        environment to learn the shape of pictures: read ``env.observation_spec`` before a rollout.

        Args:
            rows: Environment to draw, or several; None for all, if they are 16 at most.
            height: Pixels from top to bottom, an even number from 120 on; there are 4/3 as many from left to right.

        Returns:
            Pixels [len(rows), height, width, 3], or [height, width, 3] of a single environment; uint8.

        Raises:
            ModuleNotFoundError: Without the extra ``viz``.
            ResetNeededError: For episodes that have not begun.
            ValueError: For a wrong argument.
        """
        with self.guard:
            return pictures().frames(self, rows, height)

    def default_sat_args(self) -> ArgumentTable:
        """Return every argument that ``sat_args`` accepts, with default, unit and meaning; print it to read it."""
        return self.builder.satellites[0].default_sat_args()

    def default_world_args(self) -> ArgumentTable:
        """Return every argument that ``world_args`` accepts, with default, unit and meaning; print it to read it."""
        return self.builder.default_world_args()

    @property
    def bytes_per_env(self) -> int:
        """Bytes of one environment's state, its prepared next episode included; the windows found add a little."""
        return (self.state.nbytes + (self.pool.fleet.state.nbytes if self.pool else 0)) // self.num_envs

    def check_finite(self) -> None:
        """Check the fields of all satellites; FloatingPointError that names environment, field and tick."""
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
    """Return the module that draws; ModuleNotFoundError without the extra ``viz``."""
    try:
        return import_module("bsk_torch.viz.render.frames")
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(f"render() needs {error.name}: pip install 'bsk_torch[viz]'", name=error.name) from error


def _counted(name: str, satellite: SatelliteGroup) -> Tensor:
    counts = satellite.counts()
    if name not in counts:
        raise AttributeError(f"{satellite.name} does not count {name!r}")
    return counts[name]
