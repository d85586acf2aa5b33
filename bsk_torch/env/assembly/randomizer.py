"""Arguments drawn for all satellites of an episode together: formations, or user functions."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import cast

import torch
from torch import Tensor

from bsk_torch._checks import no_gradient
from bsk_torch.formations import Formation
from bsk_torch.rand import Key, seeded
from bsk_torch.sats.satellite import Satellite
from bsk_torch.sim.arguments.sources import Answers
from bsk_torch.sim.arguments.values import nearest, numbers

Draws = dict[str, tuple[Sequence[int], Tensor]]
"""By argument: the satellites [c] for which it is set, and its values [n, c, ...]."""


class Randomizer:
    """Draws the arguments of a ``sat_arg_randomizer`` for the key's n environments."""

    def __init__(
        self,
        source: Formation | Callable[[list[Satellite]], Mapping[Satellite, Mapping[str, object]]],
        satellites: Sequence[Satellite],
    ) -> None:
        """Check the names of the ``satellites``; the formation may raise an error."""
        self.source, self.satellites = source, list(satellites)
        self.names = [satellite.name for satellite in satellites]
        if isinstance(source, Formation):
            source.check(self.names)

    @property
    def calls_user(self) -> bool:
        """Whether a user function is called; these are called only for episodes that begin now."""
        return not isinstance(self.source, Formation)

    def __call__(self, key: Key, answers: Sequence[Answers] | None = None) -> Draws:
        """Return the drawn arguments by name, from the ``answers`` of an earlier call of the user function or from a call now."""
        if isinstance(self.source, Formation):
            return self.source.draw_checked(key, self.names)
        if answers:
            return self._stacked([answer["sat_arg_randomizer"] for answer in answers])
        with seeded(key.named("sat_arg_randomizer")) as rows:
            return self._stacked([self.ask() for _ in rows])

    def ask(self) -> dict[tuple[str, int], object]:
        """Return the values of the user function for one episode, by argument and satellite."""
        answer = cast(Callable[[list[Satellite]], object], self.source)(self.satellites)
        if not isinstance(answer, Mapping):
            raise TypeError(f"sat_arg_randomizer returned {answer!r}; it must return {{satellite: {{argument: value}}}}")
        return {(name, self._number(who)): value for who, args in answer.items() for name, value in args.items()}

    def _number(self, who: object) -> int:
        name = getattr(who, "name", who)
        if name not in self.names:
            raise ValueError(
                f"sat_arg_randomizer sets arguments of {name!r}, which is not a satellite; {nearest(str(name), self.names)}"
            )
        return self.names.index(name)

    @staticmethod
    def _stacked(episodes: list[dict[tuple[str, int], object]]) -> Draws:
        if any(episode.keys() != episodes[0].keys() for episode in episodes):
            raise ValueError(
                "sat_arg_randomizer sets other arguments in one episode than in another; it must set the same in all"
            )
        draws: Draws = {}
        for name in dict.fromkeys(name for name, _ in episodes[0]):
            columns = [k for other, k in episodes[0] if other == name]
            rows = [
                torch.stack([numbers(no_gradient(f"sat_arg_randomizer: {name}", episode[name, k])) for k in columns])
                for episode in episodes
            ]
            draws[name] = columns, torch.stack(rows)
        return draws


def make_randomizer(source: object, satellites: Sequence[Satellite]) -> Randomizer | None:
    """Return the sampler of a ``sat_arg_randomizer``; TypeError unless it is a formation or a function."""
    if source is None:
        return None
    if not isinstance(source, Formation) and not callable(source):
        raise TypeError(
            f"sat_arg_randomizer={source!r} must be a formation, such as formations.walker_delta_args(3), or a function of the "
            "list of satellites that returns {satellite: {argument: value}}"
        )
    return Randomizer(source, satellites)
