"""Dynamics models of satellites that must not collide, or must not lose one another: see :mod:`bsk_torch.sim.run.encounters`."""

from __future__ import annotations

from typing import ClassVar

import torch
from torch import Tensor

from bsk_torch.sim.component import Arg, Component, Values
from bsk_torch.sim.dyn.models import DynamicsModel
from bsk_torch.sim.readout.model import aliveness_checker

SHORTEST = 1e-9  # smallest radius, m, and time between two looks, s


def _check_looks(args: Values) -> None:
    rate, exact = torch.broadcast_tensors(args["conjunction_check_rate"], args["conjunction_exact"])
    both = (exact > 0.0) & (rate > SHORTEST)
    if bool(both.any()):
        raise ValueError(
            f"conjunction_check_rate={rate[both][0].item():g} s and conjunction_exact=True: between ticks the distance is looked "
            "at in all of them; leave conjunction_check_rate out"
        )


def _check_chief(args: Values) -> None:
    chief = args["chief_name"]
    if not (chief is None or isinstance(chief, str)):
        raise ValueError(f"chief_name={chief!r} must be the name of a satellite, or None")


CONJUNCTION = Component(
    slot="conjunction",
    args=(
        Arg("conjunction_radius", 10.0, "m", "radius; satellites collide within the sum of theirs", low=SHORTEST, high=1e9),
        Arg(
            "conjunction_check_rate",
            None,
            "s",
            "time between two looks at the distance to earlier satellites; None for every tick",
            low=SHORTEST,
            high=1e9,
            missing=SHORTEST,
        ),
        Arg("conjunction_exact", False, "-", "whether distances also count between ticks", "choice", choices=(False, True)),
    ),
    check=_check_looks,
)

MAX_RANGE = Component(
    slot="max_range",
    args=(
        Arg("max_range_radius", 5000.0, "m", "distance from the chief at which the satellite is lost", low=SHORTEST, high=1e9),
        Arg("chief_name", None, "-", "name of the chief; None for no limit", "constant"),
        Arg("enforce_range_on_chief", False, "-", "whether the chief is lost, too", "choice", choices=(False, True)),
    ),
    check=_check_chief,
)


class ConjunctionDynModel(DynamicsModel):
    """Satellites with this model collide if their distance is at most the sum of their radii.

    Distances are checked at the start of a step and after its ticks: every tick, or at intervals of ``conjunction_check_rate``;
    with ``conjunction_exact`` also between ticks, assuming uniform relative motion. For two satellites, the settings of the later
    one in the list apply. A collision ends the step of all satellites in that tick, and both die. Each pair collides at most once
    in an episode.

    If an episode begins with a collision, its first step has zero length and ends with the deaths.
    """

    components: ClassVar[tuple[Component, ...]] = (CONJUNCTION,)

    @property
    def conjunctions(self) -> Tensor:
        """Satellites of the episode with which each one has collided, [N, S] bool, in the order of the environment's list."""
        return self.satellite.fleet.encounters.conjunctions(self.satellite.type_index)

    @aliveness_checker
    def conjunction_valid(self) -> Tensor:
        """Whether the satellite has not collided, [N]."""
        return ~self.conjunctions.any(-1)


class MaxRangeDynModel(DynamicsModel):
    """A satellite that is lost if its distance from its chief is ``max_range_radius`` or more.

    Distances are checked at the start of a step and after each of its ticks. The loss of a satellite ends the step of all
    satellites in that tick. The satellite dies, and with ``enforce_range_on_chief`` the chief also dies. A satellite is lost at
    most once in an episode.
    """

    components: ClassVar[tuple[Component, ...]] = (MAX_RANGE,)

    @property
    def out_of_ranges(self) -> Tensor:
        """The chief from which each satellite was too far away, [N, S] bool by satellite of the episode."""
        return self.satellite.fleet.encounters.out_of_ranges(self.satellite.type_index)

    @aliveness_checker
    def range_valid(self) -> Tensor:
        """Whether the satellite has kept its range, [N]."""
        return ~self.out_of_ranges.any(-1)
