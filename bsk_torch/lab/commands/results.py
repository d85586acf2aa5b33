"""Content of the files of results of ``bsk-torch bench``, as bench and leaderboard read them."""

from __future__ import annotations

from typing import Annotated

from annotated_types import Interval, MinLen
from pydantic import ConfigDict
from typing_extensions import NotRequired, TypedDict

from bsk_torch.cli.run_folder import Amount, Estimate, Maybe, Summary
from bsk_torch.untrusted import Count, Word


class Training(TypedDict):
    """What the training of a policy has cost; None for what is not recorded."""

    decisions: Count
    core_seconds: Annotated[float, Interval(ge=0.0)]
    tuning_runs: Count | None


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
    library: NotRequired[Word]
    training: NotRequired[Training | None]
    basilisk: NotRequired[Repeated]


class Played(Summary):
    """A policy in a task, as ``bsk-torch bench`` writes it, prints it again, and passes it on."""

    __pydantic_config__ = ConfigDict(extra="allow")  # type: ignore[misc]

    returns: Annotated[list[Amount], MinLen(1)]
    library: NotRequired[Word]
    training: NotRequired[Training | None]
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
