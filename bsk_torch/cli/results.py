"""Content of the files of results that commands read: evaluations of runs, and results of ``bsk-torch bench``."""

from __future__ import annotations

from typing import Annotated

from annotated_types import Interval, MinLen
from pydantic import AllowInfNan, ConfigDict
from typing_extensions import NotRequired, TypedDict

from bsk_torch.untrusted import Count, Word

Amount = Annotated[float, Interval(ge=-1e15, le=1e15)]
Share = Annotated[float, Interval(ge=0.0, le=1.0)]
Maybe = Annotated[float, AllowInfNan(True)]
"""A number that is infinite or NaN where episodes are too few."""


class Estimate(TypedDict):
    """A mean and the half width of its interval."""

    mean: Amount
    half_width: Maybe


class Measure(TypedDict):
    """The same of a measure, which may be unknown."""

    mean: Maybe
    half_width: Maybe


Summary = TypedDict(
    "Summary",
    {
        "return": Estimate,
        "episodes": NotRequired[Count],
        "survival": NotRequired[Share | None],
        "survival_interval": NotRequired[list[Share]],
        "collected": NotRequired[Maybe | None],
        "fill": NotRequired[Maybe | None],
        "decisions": NotRequired[Amount],
        "simulated_per_decision": NotRequired[Amount | None],
        "deaths": NotRequired[dict[Word, Count]],
        "counts": NotRequired[dict[Word, Amount]],
        "measures": NotRequired[dict[Word, Measure]],
        "gain": NotRequired[dict[Word, Estimate]],
    },
)
"""What an evaluation says of a policy; see :meth:`bsk_torch.rl.evaluation.evaluate.Evaluation.summary`."""


class Repeated(TypedDict):
    """Episodes that Basilisk has repeated, and how many are the same."""

    same: Count
    returns: list[Amount]


class Flown(Repeated):
    """The same with what ``bsk-torch bench`` prints."""

    decided: Word
    largest_difference: Maybe


class Returns(TypedDict):
    """A policy in a task, as the leaderboard reads it."""

    returns: Annotated[list[Amount], MinLen(1)]
    basilisk: NotRequired[Repeated]


class Played(Summary):
    """A policy in a task, as ``bsk-torch bench`` writes it, prints it again, and passes it on."""

    __pydantic_config__ = ConfigDict(extra="allow")  # type: ignore[misc]

    returns: Annotated[list[Amount], MinLen(1)]
    basilisk: NotRequired[Flown]
    score: NotRequired[Estimate]
    seconds_per_decision: Annotated[float, Interval(ge=0.0)]


class Results(TypedDict):
    """A file of results as the leaderboard reads it: ``policies`` by policy and task."""

    format: int
    suite: Word
    policies: dict[Word, dict[Word, Returns]]


class PlayedResults(TypedDict):
    """The same as ``bsk-torch bench`` reads it."""

    format: int
    suite: Word
    policies: dict[Word, dict[Word, Played]]
