"""One satellite per episode, N episodes at once."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Mapping, Sequence

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Composite, Unbounded

from bsk_torch._checks import switch
from bsk_torch.act.builders import ContinuousBuilder
from bsk_torch.comm import CommunicationMethod
from bsk_torch.data.base import GlobalReward
from bsk_torch.env import messages
from bsk_torch.env.action_forms import action_spec, acts, mask_size, mask_spec, read
from bsk_torch.env.base import StepResult, Tasking
from bsk_torch.env.guard import Origin
from bsk_torch.env.native import NativePhases
from bsk_torch.env.options import TaskingOptions, parse, takes
from bsk_torch.env.satellite_group import SatelliteGroup
from bsk_torch.formations import Formation
from bsk_torch.obs.base import ObservationBuilder, Values
from bsk_torch.sats.satellite import Satellite
from bsk_torch.scene.base import Scenario


@takes(TaskingOptions)
class SatelliteTasking(Tasking):
    """N independent episodes of one satellite type.

    Keys: ``observation``, ``action``, ``action_mask``, ``reward``, ``done``, ``terminated``, ``truncated`` and ``duration``, the
    length of a step in s. Continuous actions have no ``action_mask``.
    """

    def __init__(
        self,
        satellite: Satellite | Sequence[Satellite],
        scenario: Scenario | None = None,
        rewarder: GlobalReward | Iterable[GlobalReward] | None = None,
        communicator: CommunicationMethod | None = None,
        sat_arg_randomizer: Formation | Callable[[list[Satellite]], Mapping[Satellite, Mapping[str, object]]] | None = None,
        **options: object,
    ) -> None:
        """Build the environment and check its arguments; nothing is simulated before the first reset.

        Args:
            satellite: The satellite, or a list containing only it; the environment uses a copy.
            scenario: Task of the satellite, or None.
            rewarder: Value of its data, or several rewarders to sum; None for zero.
            communicator: As in :class:`bsk_torch.ConstellationTasking`; one satellite has no partner.
            sat_arg_randomizer: Draws related arguments together: a formation of :mod:`bsk_torch.formations`, or a function of
                the list of the one satellite, called for each episode, that returns ``{satellite: {argument: value}}``.
            **options: ``generate_obs_retasking_only``, which has no effect with one satellite; for the others see
                :class:`bsk_torch.env.options.TaskingOptions`.
        """
        switch("generate_obs_retasking_only", options.get("generate_obs_retasking_only", False))
        parsed = parse(TaskingOptions, {name: value for name, value in options.items() if name != "generate_obs_retasking_only"})
        single = satellite[0] if isinstance(satellite, list | tuple) and len(satellite) == 1 else satellite
        if not isinstance(single, Satellite):
            raise ValueError(f"satellite={satellite!r} must be one satellite; several need a ConstellationTasking")
        self._build([single], scenario, rewarder, communicator, sat_arg_randomizer, parsed)
        parts = {"satellite": satellite, "scenario": scenario, "rewarder": rewarder, "communicator": communicator}
        self._arguments = {**parts, "sat_arg_randomizer": sat_arg_randomizer, **options}

    def _make_specs(self, trial: list[Values]) -> None:
        b, on, values = self.batch_size, {"device": self.device}, trial[0]
        self.satellite.observation_description = ObservationBuilder.describe(values)
        vector = ObservationBuilder.vector(values, self.dtype)
        size = mask_size(self.satellite)
        self.observation_spec = Composite(
            observation=self._tree(values, b) if self.satellite.obs_type is dict else self._leaf(vector, b),
            **({"action_mask": mask_spec(size, b).to(self.device)} if size else {}),
            duration=Unbounded((*b, 1), dtype=self.dtype, **on),
            shape=b,
            **on,
        )
        counts = {name: Unbounded((*b, 1), dtype=torch.int64, **on) for name in self.counts()}
        if counts:
            self.observation_spec["counts"] = Composite(counts, shape=b, **on)
        self.full_action_spec = Composite({"action": action_spec(self.satellite, b, self.dtype)}, shape=b).to(self.device)
        self.reward_spec = Unbounded((*b, 1), dtype=self.dtype, **on)
        self.full_done_spec = self._ends_spec()

    @functools.cached_property
    def satellite(self) -> SatelliteGroup:
        """The satellites of all environments."""
        return self.satellites[0]

    @functools.cached_property
    def native(self) -> NativePhases | None:
        """The phases of a step as kernels; None where they run on tensors, see :mod:`bsk_torch.env.native`."""
        return NativePhases.of(self)

    def _begin(self, envs: Tensor) -> None:
        _ = self.native  # as the images
        super()._begin(envs)

    @property
    def dead(self) -> Tensor:
        """Whether the satellite has died, [N]."""
        return self.satellite.task.dead

    @property
    def requires_retasking(self) -> Tensor:
        """Whether the satellite needs a task, [N]."""
        return self.satellite.task.requires_retasking

    def _step(self, tensordict: TensorDictBase) -> TensorDict:
        partial = tensordict.get("_step", None)
        action = messages.given_action(tensordict, "action")
        return self._wrapped(self.played(action, None if partial is None else partial.reshape(-1)))

    def play(self, action: object, moves: Tensor | None = None) -> TensorDict:
        """Execute ``action`` [N] where ``moves`` [N] is true, everywhere if None; return the entries of ``next``.

        Continuous actions are [N, A]; hybrid ones are a tensordict of their parts, or [N, A + 1] with the choice last.
        ``NO_ACTION`` continues the current task.
        """
        return self._wrapped(self.played(action, moves))

    def played(self, action: object, moves: Tensor | None = None) -> dict[str, object]:
        """Execute ``action`` as :meth:`play` does; return the entries as a dictionary, which is faster than a tensordict."""
        action = read("action", action, self.satellite, self.batch_size, ", one per environment")
        moves_all, moves = moves is None, torch.ones_like(self.dead) if moves is None else moves
        goes_on = isinstance(self.satellite.actions, ContinuousBuilder)  # numbers of actions have none that continues the task
        executed, all_act = moves & acts(action, self.satellite) if goes_on else moves, moves_all and not goes_on
        with self.guard:
            self.guard.check_begun("step()")
            if all_act and self.native is not None and self.native.applies and self.guard.origin is not Origin.RESTORED:
                outcome = self.native.advance(action)
                return self._entries(outcome.pop("duration"), **outcome)
            action = self.satellite.actions.checked(action, None if all_act else executed)
            result = self._advance([action], [executed], moves, all_act)
            duration = result.duration.to(self.dtype).unsqueeze(-1)
            parts = self._entries(duration, reward=result.reward.to(self.dtype), **self._ends(result))
            if self.guard.origin is Origin.RESTORED:
                self._proven(self._wrapped(parts))
            return parts

    def _outputs(self, result: StepResult | None, **parts: Tensor) -> TensorDict:
        return self._wrapped(self._entries(torch.zeros_like(self.fleet.sim_time).to(self.dtype).unsqueeze(-1), **parts))

    def _wrapped(self, entries: dict[str, object]) -> TensorDict:
        return TensorDict(entries, self.batch_size, device=self.device)

    def _entries(self, duration: Tensor, **parts: object) -> dict[str, object]:
        """Return ``parts`` with the observations of the present and the ``duration`` [N, 1] of a step, s; 0 after a reset."""
        observations = self.satellite.observations
        in_parts = self.satellite.obs_type is dict
        observation: object = (
            self._cast(observations.get_dict(), self.batch_size) if in_parts else observations.get_vector(self.dtype)
        )
        parts["observation"] = observation
        if self.satellite.actions.n_actions:
            parts["action_mask"] = self.satellite.action_mask()
        parts["duration"] = duration
        if counts := self.counts():
            parts["counts"] = counts
        return parts
