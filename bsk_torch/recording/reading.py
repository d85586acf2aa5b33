"""A recorded flight as tensors, from which figures and tables are made."""

from __future__ import annotations

from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from bsk_torch.astro.frames import rotate_z
from bsk_torch.recording.recording import Array, Recording
from bsk_torch.recording.scenes import CHIEF
from bsk_torch.recording.table import Tasks
from bsk_torch.vec3 import Vec3

__all__ = ["Reading"]


class Reading:
    """The satellites of a track that took part in its episode, [S], at the B boundaries of its steps, as tensors on the CPU.

    Attributes:
        track: The track.
        scene: Its surroundings.
        columns: Numbers of the satellites in the recording.
        names: Their names.
        times: The boundaries, [B] s since reset.
    """

    def __init__(self, recording: Recording, track: int = 0, viewers: bool = False) -> None:
        """Read a track; only the satellites that image or inspect the targets with ``viewers``.

        ValueError for a recording without steps, which is of an older version.
        """
        self.track = recording.tracks[track]
        self.scene, self.crafts = recording.scenes[self.track.scene], recording.satellites
        if "step_time" not in self.track.arrays:
            raise ValueError(f"track {track} has no steps, which figures show: record the episode again with this version")
        r_N = self.track.arrays["r_N"]
        present = [k for k, craft in enumerate(self.crafts) if np.isfinite(r_N[:, k]).all() and craft.kind != CHIEF]
        self.columns = [k for k in self.scene.viewers if k in present] if viewers else present
        self.names = [self.crafts[k].name for k in self.columns]
        self.times = self.array("step_time")

    def array(self, name: str) -> Tensor:
        """Return an array of the track, float64, int64 or bool."""
        return _tensor(self.track.arrays[name])

    def of_scene(self, name: str) -> Tensor:
        """Return an array of the scene."""
        return _tensor(self.scene.arrays[name])

    @cached_property
    def rewards(self) -> Tensor:
        """Rewards of the steps, [S, B - 1]; NaN for satellites but the first of an agent."""
        return self.array("step_reward")[:-1, self.columns].mT

    def values(self, name: str) -> Tensor | None:
        """Return a quantity at the boundaries, [S, B, width]; None where it was not recorded."""
        indices = [k for k, column in enumerate(self.track.quantities) if name in (column, column.rpartition("_")[0])]
        return self.array("step_values")[:, self.columns][..., indices].transpose(0, 1) if indices else None

    @cached_property
    def deaths(self) -> Tensor:
        """When each satellite died, [S] s; infinite for survivors."""
        times = {death.satellite: death.time for death in self.track.deaths}
        return torch.tensor([times.get(k, torch.inf) for k in self.columns], dtype=torch.float64)

    @cached_property
    def tasks(self) -> Tasks:
        """What the satellites did; a task ends with the satellite's next one."""
        number = {column: k for k, column in enumerate(self.columns)}
        who = self.array("decision_satellite").tolist()
        rows = [row for row, satellite in enumerate(who) if satellite in number]
        kinds = self.array("decision_task").tolist()
        labels = [self.crafts[who[row]].tasks[kinds[row]] for row in rows]
        names = list(dict.fromkeys(labels))
        return Tasks(
            satellite=torch.tensor([number[who[row]] for row in rows], dtype=torch.int64),
            spans=torch.stack([self.array("decision_time"), self.array("decision_end")], -1)[rows],
            kind=torch.tensor([names.index(name) for name in labels], dtype=torch.int64),
            names=names,
        )

    @cached_property
    def actions(self) -> Tensor | None:
        """Real numbers chosen at the boundaries, [S, B - 1, A]; NaN for none. None if all actions are numbered."""
        if "decision_control" not in self.track.arrays:
            return None
        control = self.array("decision_control")
        table = torch.full((len(self.crafts), len(self.times), control.shape[1]), torch.nan, dtype=torch.float64)
        table[self.array("decision_satellite"), torch.searchsorted(self.times, self.array("decision_time"))] = control
        return table[self.columns, :-1]

    @cached_property
    def events(self) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Times, satellites, targets and kinds of the events, [E] each; see :data:`bsk_torch.recording.recording.EVENTS`."""
        time, who, target, kind = (self.array(f"event_{name}") for name in ("time", "satellite", "target", "kind"))
        number = torch.full((len(self.crafts),), -1).index_put((torch.tensor(self.columns),), torch.arange(len(self.columns)))
        rows = number[who] >= 0
        return time[rows], number[who[rows]], target[rows], kind[rows]

    @cached_property
    def links(self) -> Tensor | None:
        """Satellites in contact at the boundaries, [B, S, S] bool, in one direction; None if they never are."""
        a, b, start, end = (self.array(f"link_{name}") for name in ("a", "b", "start", "end"))
        if not len(a):
            return None
        last = self.times[-1]
        linked = torch.zeros(len(self.times), len(self.crafts), len(self.crafts), dtype=torch.bool)
        for first, second, since, until in zip(a.tolist(), b.tolist(), start.tolist(), end.tolist(), strict=True):
            linked[(self.times >= since) & ((self.times < until) | (last == until)), first, second] = True
        return linked[:, self.columns][:, :, self.columns]

    def intervals(self, name: str, column: int) -> Tensor:
        """Return start and end of the ``passes`` or ``eclipses`` of a satellite, by its number in the recording, [n, 2] s."""
        return self.array(name)[self.array(f"{name}_satellite") == column]

    def r_N(self, times: Tensor, columns: list[int] | None = None) -> Tensor:
        """Return positions of satellites in N, [S, M, 3] m, at ``times`` [M] s: cubic Hermite polynomials between keyframes.

        Args:
            times: The times.
            columns: Numbers of the satellites in the recording (default: :attr:`columns`).
        """
        chosen = self.columns if columns is None else columns
        r, v = (self.array(name)[:, chosen] for name in ("r_N", "v_N"))
        return hermite(self.array("key_times"), r, v, times).transpose(0, 1)

    def r_P(self, times: Tensor) -> Tensor:
        """Return Earth-fixed positions of the satellites, [S, M, 3] m, at ``times`` [M] s."""
        turn, PN0 = self.scene.rate * times, torch.tensor(self.scene.PN0, dtype=torch.float64).view(3, 3)
        return rotate_z(Vec3.of(self.r_N(times) @ PN0.mT), torch.cos(turn), torch.sin(turn)).stack()


def _tensor(array: Array) -> Tensor:
    tensor = torch.from_numpy(np.array(array))
    return tensor.double() if tensor.is_floating_point() else tensor.long()


def hermite(keys: Tensor, r: Tensor, v: Tensor, times: Tensor) -> Tensor:
    """Return positions [M, S, 3] at ``times`` [M] from positions and velocities [K, S, 3] at ascending ``keys`` [K] s."""
    if len(keys) == 1:
        return r + v * (times - keys).view(-1, 1, 1)
    k = (torch.searchsorted(keys, times, right=True) - 1).clamp(0, len(keys) - 2)
    h = (keys[k + 1] - keys[k]).view(-1, 1, 1)
    u = (times - keys[k]).view(-1, 1, 1) / h
    begin = (1.0 + 2.0 * u) * (1.0 - u) ** 2 * r[k] + u * (1.0 - u) ** 2 * h * v[k]
    return begin + u**2 * (3.0 - 2.0 * u) * r[k + 1] + u**2 * (u - 1.0) * h * v[k + 1]
