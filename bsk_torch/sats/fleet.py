"""A fleet with the satellites of each type, which rewarders, scenarios, communicators and other satellites read."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import TYPE_CHECKING, Any

from torch import Tensor

from bsk_torch.sim.fleet import Fleet

if TYPE_CHECKING:
    from bsk_torch.sats.bound import BoundSatellite
    from bsk_torch.sats.others import OtherSatellite


class SatelliteFleet(Fleet):
    """The satellites of N episodes, S in each.

    Attributes:
        satellites: The satellites of each type, once an environment has made them.
    """

    satellites: tuple[BoundSatellite, ...] = ()

    @cached_property
    def shape(self) -> tuple[int, int]:
        """Number of episodes N and of satellites S, of tables [N, S]."""
        return self.num_envs, self.size

    def found(self, name: str) -> tuple[BoundSatellite, int]:
        """Return the satellites of the type of a named one, and the number of that one within the type.

        Raises:
            KeyError: For an unknown name.
            RuntimeError: While the satellites are being made.
        """
        k, number = self.place_of(name)
        if not self.satellites:
            raise RuntimeError(f"satellite {name!r} is not there yet: others are seen in get_obs(), not in link_satellite()")
        return self.satellites[k], number

    def satellite(self, name: str) -> OtherSatellite:
        """Return a satellite of every episode by its name: its tensors are [N, ...], a row for each episode.

        See :class:`bsk_torch.sats.others.OtherSatellite`; KeyError for an unknown name, with the nearest one.
        """
        whole, number = self.found(name)
        return whole.member(number)

    def each(self, read: Callable[[Any], Tensor], missing: float = 0.0) -> Tensor:
        """Return the value of ``read`` for every satellite, [N, S, ...]; ``missing`` for types without such an attribute.

        Raises:
            AttributeError: If no type has it.
        """
        if len(self.satellites) == 1:
            return self.joined([read(self.satellites[0])])
        found: list[Tensor | None] = []
        lacking: AttributeError | None = None
        for satellite in self.satellites:
            try:
                found.append(read(satellite))
            except AttributeError as error:
                found.append(None)
                lacking = error
        there = [value for value in found if value is not None]
        if not there:
            raise lacking or AttributeError("there are no satellites")
        blank = there[0].new_full((1, *there[0].shape[1:]), missing)
        return self.joined(
            [
                blank.expand(simulator.state.rows, *blank.shape[1:]) if value is None else value
                for value, simulator in zip(found, self.simulators, strict=True)
            ]
        )
