"""Flights of one environment under one policy, and other futures from their decisions."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase

from bsk_torch._rooms import resolve
from bsk_torch.env import Tasking
from bsk_torch.env.rollout import ACTION_VALUE
from bsk_torch.recording.recorder import Flight, Flown, branched, recording_of
from bsk_torch.recording.recording import Recording, Scene
from bsk_torch.recording.scenes import crafts_of

__all__ = ["Futures"]

VALUES = "bsk_torch.lab.planners:ActionValues"
"""Policy that plays a branch for each action; it is needed only by :meth:`Futures.values`."""

AFTER = 1e-6
"""Added to the time of a decision to fly its step, and no other, s."""


class Futures:
    """Records flights of row 0 of an environment, and branches of them.

    A branch flies the episode again from its beginning with the recorded actions, takes another action at one decision, and
    leaves all later decisions to the policy. Its track contains the common past.

    Attributes:
        flown: The flights by number, in the order of the tracks.
        scenes: Their surroundings by number.
    """

    def __init__(
        self, env: Tasking, policy: TensorDictModuleBase, *, preset: str = "", label: str = "policy", until: float | None = None
    ) -> None:
        """Fly ``env`` with ``policy``, each time for ``until`` seconds; see also :func:`bsk_torch.recording.record`."""
        self.env, self.policy, self.preset, self.label, self.until = env, policy, preset, label, until
        self.flown: dict[int, Flown] = {}
        self.scenes: dict[int, Scene] = {}

    def episode(self, seed: int) -> int:
        """Record the first episode of ``seed``; return the number of the flight."""
        flight = Flight(self.env, self.policy)
        flown = flight.fly(seed, self.until)
        scene = _following(self.scenes)
        self.scenes[scene] = flight.scene
        return self._add(flown, scene=scene)

    def branch(self, track: int, decision: int, action: int) -> int:
        """Record the future in which another action is taken; return the number of the flight.

        Args:
            track: Number of the flight to leave.
            decision: Which of its decisions.
            action: The action taken there instead.

        Raises:
            IndexError: For a track or decision that does not exist.
            ValueError: For an illegal action, or a decision of real numbers.
        """
        parent = self._flight(track)
        where = branched(parent, decision, action, track)
        choice = parent.choices[decision]
        flight = Flight(self.env, self.policy)
        group, number, _, _ = flight.slots[choice.slot]

        def change(step: int, tensordict: TensorDictBase) -> None:
            if step == choice.step and group is None:
                tensordict["action"][0] = action
            elif step == choice.step:
                tensordict[group, "action"][0, number] = action

        flown = flight.fly(parent.seed, self.until, parent.actions[: choice.step + 1], change)
        craft = crafts_of(self.env)[choice.satellite]
        label = f"{craft.name}: {craft.actions[action].removeprefix('action_').replace('_', ' ')} at {choice.time:,.0f} s"
        return self._add(flown, scene=parent.track.scene, parent=track, branch=where, label=label)

    def values(self, track: int, decision: int) -> list[float]:
        """Return the return that follows each action at a decision, [A], if the policy acts afterwards; NaN for illegal actions.

        For a planner, its base policy acts afterwards. The values are also kept in the recording. Errors are those of
        :meth:`branch`.
        """
        flown = self._flight(track)
        branched(flown, decision, None, track)
        choice = flown.choices[decision]
        planner = resolve(VALUES)(self.env, getattr(self.policy, "base", self.policy))
        answers: list[torch.Tensor] = []

        def ask(step: int, tensordict: TensorDictBase) -> None:
            if step == choice.step:
                answers.append(planner(tensordict.clone())[ACTION_VALUE][0, choice.slot])

        Flight(self.env, self.policy).fly(flown.seed, choice.time + AFTER, flown.actions[: choice.step + 1], ask)
        row = flown.track.arrays["decision_action_value"][decision]
        numbers = answers[0].double().tolist()
        row[: len(numbers)] = numbers[: len(row)]
        values: list[float] = row.astype("f8").tolist()
        return values

    @property
    def meaning(self) -> str:
        """What :meth:`values` are, for readers of the page."""
        follows = "base policy of the planner" if hasattr(self.policy, "base") else "policy"
        return f"The rest of the return of the episode, if this action is taken and the {follows} decides afterwards."

    def recording(self) -> Recording:
        """Return the flights as a recording; a branch of a flight that was dropped has no parent."""
        place: dict[int | None, int] = {number: k for k, number in enumerate(self.flown)}
        scenes = {number: k for k, number in enumerate(self.scenes)}
        tracks = [
            dataclasses.replace(flown.track, scene=scenes[flown.track.scene], parent=place.get(flown.track.parent))
            for flown in self.flown.values()
        ]
        seeds = ", ".join(str(scene.seed) for scene in self.scenes.values())
        title = f"{self.preset or 'An episode'}, {self.label}, seed{'s' * (len(self.scenes) > 1)} {seeds}"
        return recording_of(self.env, list(self.scenes.values()), tracks, title, self.preset, self.label)

    def drop_old(self, most: int) -> None:
        """Drop the oldest flights until ``most`` are left; the first one, the newest one and its parent are kept."""
        first, *_, newest = self.flown if len(self.flown) > 1 else [0, 0]
        keep = {first, newest, self.flown[newest].track.parent}
        for number in [number for number in self.flown if number not in keep][: max(len(self.flown) - most, 0)]:
            del self.flown[number]
        scenes = {flown.track.scene for flown in self.flown.values()}
        self.scenes = {number: scene for number, scene in self.scenes.items() if number in scenes}

    def _add(self, flown: Flown, **changes: object) -> int:
        number = _following(self.flown)
        self.flown[number] = dataclasses.replace(flown, track=dataclasses.replace(flown.track, **changes))  # type: ignore[arg-type]
        return number

    def _flight(self, track: int) -> Flown:
        if track not in self.flown:
            raise IndexError(f"track={track} must be one of the flights {', '.join(map(str, self.flown))}; others were dropped")
        return self.flown[track]


def _following(numbers: Iterable[int]) -> int:
    return max(numbers, default=-1) + 1
