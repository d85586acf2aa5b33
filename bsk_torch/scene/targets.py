"""Point targets on the ground: what all scenarios of them share."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor

from bsk_torch.rand import first_key
from bsk_torch.scene.base import Scenario
from bsk_torch.scene.draws import check_positions

if TYPE_CHECKING:
    from bsk_torch.sim.fleet import Fleet


class TargetScenario(Scenario):
    """Point targets, T columns in every environment; where an environment has fewer, the rest is padding that does not exist.

    Subclasses set :attr:`most_targets` and implement ``draw(key)``, which returns at least

    - ``target_r_LP_P`` [n or 1, T, 3]: Earth-fixed positions, m, finite and outside the Earth for padding too;
    - ``target_priority`` [n or 1, T]: worth;
    - ``target_exists`` [n or 1, T]: 1.0, or 0.0 for padding.
    """

    most_targets: int
    """Number of columns T."""

    fleet: Fleet
    _available: Tensor | None = None

    @property
    def target_names(self) -> list[str]:
        """Name of every column, ``"tgt-0"`` and so on."""
        return [f"tgt-{k}" for k in range(self.most_targets)]

    def names(self, row: int) -> list[str]:
        """Name of every column in the present episode of environment ``row``."""
        return self.target_names

    def link(self, fleet: Fleet) -> None:
        """See :meth:`Scenario.link`; ValueError without a satellite that sees targets, or for a draw of wrong form."""
        if not any(hasattr(part, "target_types") for part in fleet.parts):
            are = ", ".join(f"{part.name} is a {type(part).__name__}" for part in fleet.parts)
            raise ValueError(
                f"scene.{type(self).__name__} needs a satellite that sees targets, such as a sats.ImagingSatellite; {are}"
            )
        self._check_draw()
        self.fleet = fleet

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

    def drawn(self, name: str) -> Tensor:
        """What :meth:`draw` gave for the present episodes, [N, ...]."""
        return self.fleet.tables[name]

    @property
    def r_LP_P(self) -> Tensor:
        """Earth-fixed positions, [N, T, 3] m."""
        return self.drawn("target_r_LP_P")

    @property
    def priority(self) -> Tensor:
        """What every target is worth at the present decision, [N, T]; 0 for padding."""
        return self.drawn("target_priority")

    @property
    def available(self) -> Tensor:
        """Whether a target exists and can be selected at the present decision, [N, T] bool."""
        if self._available is None:
            self._available = self.drawn("target_exists").bool()
        return self._available

    def reset(self, rows: Tensor) -> None:
        """See :meth:`Scenario.reset`."""
        self._available = None


class ChangingTargets(TargetScenario):
    """Targets that appear, vanish or change priority: subclasses implement :meth:`at`.

    An agent is paid by the priorities that it saw when it decided: they are computed once for each decision. Put it before
    another scenario to change the targets of that one::

        class Deadlines(scene.ChangingTargets, scene.UniformTargets):
            def draw(self, key):
                deadline = 5400.0 * key.named("deadline").uniform(self.most_targets)
                return super().draw(key) | {"target_deadline": deadline}

            def at(self, time):
                return self.drawn("target_priority"), time.unsqueeze(-1) < self.drawn("target_deadline")
    """

    _present: tuple[Tensor, Tensor] | None = None

    def at(self, time: Tensor) -> tuple[Tensor, Tensor]:
        """Priority [N, T] and whether a target can be selected [N, T] bool, at ``time`` [N] s since reset.

        A function of drawn tensors (see :meth:`drawn`) and of ``time`` only, and without effects; padding may have any value.
        """
        raise NotImplementedError(f"{type(self).__name__} must implement at(time)")

    def _now(self) -> tuple[Tensor, Tensor]:
        return self._update(self.fleet.sim_time) if self._present is None else self._present

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

    @property
    def priority(self) -> Tensor:
        """See :attr:`TargetScenario.priority`."""
        return self._now()[0]

    @property
    def available(self) -> Tensor:
        """See :attr:`TargetScenario.available`."""
        return self._now()[1]

    def reset(self, rows: Tensor) -> None:
        """See :meth:`Scenario.reset`."""
        super().reset(rows)
        self._update(self.fleet.sim_time)

    def after_step(self, sim_time: Tensor) -> None:
        """See :meth:`Scenario.after_step`."""
        self._update(sim_time)
