"""Flights of one environment under one policy, and other futures from their decisions."""

from __future__ import annotations

import dataclasses
import math

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase

from bsk_torch.env import Tasking
from bsk_torch.env.rollout import ACTION_VALUE
from bsk_torch.plan import ActionValues
from bsk_torch.plan.planner import Planner
from bsk_torch.viewer.recorder import Flight, Flown, branched, recording_of
from bsk_torch.viewer.recording import Recording, Scene
from bsk_torch.viewer.scenes import crafts_of

__all__ = ["Futures"]

AFTER = 1e-6
"""Added to the time of a decision to fly its step, and no other, s."""


class Futures:
    """Records flights of row 0 of an environment, and branches of them.

    A branch flies the episode again from its beginning with the recorded actions, takes another action at one decision, and
    leaves all later decisions to the policy. Its track contains the common past.

    Attributes:
        flown: The flights so far, in the order of the tracks.
    """

    def __init__(
        self, env: Tasking, policy: TensorDictModuleBase, *, preset: str = "", label: str = "policy", until: float | None = None
    ) -> None:
        """Fly ``env`` with ``policy``, each time for ``until`` seconds; see also :func:`bsk_torch.viewer.record`."""
        self.env, self.policy, self.preset, self.label, self.until = env, policy, preset, label, until
        self.flown: list[Flown] = []
        self.scenes: list[Scene] = []

    def episode(self, seed: int) -> int:
        """Record the first episode of ``seed``; return the index of its track."""
        flight = Flight(self.env, self.policy)
        flown = flight.fly(seed, self.until)
        self.scenes.append(flight.scene)
        return self._add(flown, scene=len(self.scenes) - 1)

    def branch(self, track: int, decision: int, action: int) -> int:
        """Record the future in which another action is taken; return the index of its track.

        Args:
            track: The flight to leave.
            decision: Which of its decisions.
            action: The action taken there instead.

        Raises:
            IndexError: For a track or decision that does not exist.
            ValueError: For an illegal action, or a decision of real numbers.
        """
        parent = self._known(track)
        where = branched(parent, decision, action, track)
        choice = parent.choices[decision]
        flight = Flight(self.env, self.policy)
        group, number, _ = flight.slots[choice.slot]

        def change(step: int, tensordict: TensorDictBase) -> None:
            if step == choice.step and group is None:
                tensordict["action"][0] = action
            elif step == choice.step:
                tensordict[group, "action"][0, number] = action

        flown = flight.fly(parent.seed, self.until, parent.actions[: choice.step + 1], change)
        craft = crafts_of(self.env)[choice.satellite]
        label = f"{craft.name}: {craft.actions[action]} at {choice.time:,.0f} s"
        return self._add(flown, scene=parent.track.scene, parent=track, branch=where, label=label)

    def values(self, track: int, decision: int) -> list[float]:
        """Return the return that follows each action at a decision, [A], if the policy acts afterwards; NaN for illegal actions.

        For a planner, its base policy acts afterwards. The values are also kept in the recording. Errors are those of
        :meth:`branch`.
        """
        flown = self._known(track)
        branched(flown, decision, None, track)
        choice = flown.choices[decision]
        asked = ActionValues(self.env, self.policy.base if isinstance(self.policy, Planner) else self.policy)
        found: list[torch.Tensor] = []

        def ask(step: int, tensordict: TensorDictBase) -> None:
            if step == choice.step:
                found.append(asked(tensordict.clone())[ACTION_VALUE][0, choice.slot])

        Flight(self.env, self.policy).fly(flown.seed, choice.time + AFTER, flown.actions[: choice.step + 1], ask)
        row = flown.track.arrays["decision_action_value"][decision]
        known = found[0].double().tolist()
        row[: len(known)] = known[: len(row)]
        values: list[float] = row.astype("f8").tolist()
        return values

    @property
    def meaning(self) -> str:
        """What :meth:`values` are, for readers of the page."""
        follows = "base policy of the planner" if isinstance(self.policy, Planner) else "policy"
        return f"The rest of the return of the episode, if this action is taken and the {follows} decides afterwards."

    def recording(self) -> Recording:
        """Return all flights so far as a recording."""
        seeds = ", ".join(str(scene.seed) for scene in self.scenes)
        title = f"{self.preset or 'An episode'}, {self.label}, seed{'s' * (len(self.scenes) > 1)} {seeds}"
        return recording_of(self.env, self.scenes, [flown.track for flown in self.flown], title, self.preset, self.label)

    def _add(self, flown: Flown, **changes: object) -> int:
        self.flown.append(dataclasses.replace(flown, track=dataclasses.replace(flown.track, **changes)))  # type: ignore[arg-type]
        return len(self.flown) - 1

    def _known(self, track: int) -> Flown:
        if not 0 <= track < len(self.flown):
            raise IndexError(f"track={track} must lie from 0 to {len(self.flown) - 1}")
        return self.flown[track]


def finite(values: list[float]) -> list[float | None]:
    """Return values for JSON, with None for NaN."""
    return [value if math.isfinite(value) else None for value in values]
