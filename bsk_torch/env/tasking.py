"""One satellite per episode, N episodes at once."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Binary, Categorical, Composite, Unbounded
from torchrl.envs import EnvBase

from bsk_torch.data.base import GlobalReward
from bsk_torch.env.base import Played, Tasking, TimeLimit
from bsk_torch.env.machine import existing_device
from bsk_torch.obs.base import ObservationBuilder, Values
from bsk_torch.sats.satellite import Satellite
from bsk_torch.scene.base import Scenario


class SatelliteTasking(Tasking):
    """N independent episodes of one satellite type, as bsk_rl's ``SatelliteTasking`` plays one.

    Keys: ``observation``, ``action``, ``action_mask``, ``reward``, ``done``, ``terminated``, ``truncated`` and ``duration``, the
    seconds that a step took.
    """

    def __init__(
        self,
        satellite: Satellite,
        scenario: Scenario | None = None,
        rewarder: GlobalReward | None = None,
        *,
        num_envs: int = 1,
        world_args: dict[str, Any] | None = None,
        sim_rate: float = 1.0,
        max_step_duration: float = 1e9,
        failure_penalty: float = -1.0,
        time_limit: TimeLimit = float("inf"),
        terminate_on_time_limit: bool = False,
        device: torch.device | str = "cpu",
        seed: int | None = None,
        env_ids: Sequence[int] | Tensor | None = None,
        dtype: torch.dtype = torch.float32,
        sim_dtype: torch.dtype = torch.float64,
        orbit: str | None = None,
        backend: str = "compiled",
        log_level: int | str | None = None,
    ) -> None:
        """Build the environment and check its arguments; nothing is simulated before the first reset.

        Args:
            satellite: The satellite; the environment works on a copy.
            scenario: What is asked of it; None for nothing.
            rewarder: What its data are worth; None for nothing.
            num_envs: Number of episodes N.
            world_args: Arguments of the world, like ``sat_args``; see :meth:`default_world_args`.
            sim_rate: Length of a tick, s.
            max_step_duration: Longest step, s.
            failure_penalty: Added to the reward of a step at whose end the satellite is dead.
            time_limit: Seconds after which an episode is truncated, rounded up to whole ticks; a number, a distribution or a
                callable without arguments.
            terminate_on_time_limit: Whether the time limit also terminates.
            device: Where the simulation runs.
            seed: Seed of all draws; None for a random one.
            env_ids: Index of each episode in the draws, 0 to N - 1 unless given.
            dtype: Type of observations, rewards and durations.
            sim_dtype: float64 for parity with Basilisk; float32 for mixed precision: attitude, wheels and flight software in
                float32, orbit, time and accumulators in float64.
            orbit: ``"arc"`` (in advance), ``"integrated"`` (in every tick, with drag), or None for what the model says.
            backend: ``"compiled"``, or ``"eager"`` for debugging.
            log_level: Level of the package's logger; None leaves it.
        """
        if num_envs < 1:
            raise ValueError(f"num_envs={num_envs} must be at least 1")
        if not isinstance(satellite, Satellite):
            raise ValueError(f"satellite={satellite!r} must be one satellite; several need a ConstellationTasking")
        EnvBase.__init__(self, device=existing_device(device), batch_size=[num_envs])
        self._arguments = {k: v for k, v in locals().items() if k not in ("self", "__class__")}
        given = {k: v for k, v in self._arguments.items() if k not in ("satellite", "scenario", "rewarder")}
        self._build([satellite], scenario, rewarder, **given)

    def _make_specs(self, trial: list[Values]) -> None:
        b, on, values = self.batch_size, {"device": self.device}, trial[0]
        n_actions = self.satellite.actions.n_actions
        self.satellite.observation_description = ObservationBuilder.describe(values)
        vector = ObservationBuilder.vector(values, self.dtype)
        self.observation_spec = Composite(
            observation=self._tree(values, b) if self.satellite.obs_type is dict else self._leaf(vector, b),
            action_mask=Binary(n_actions, shape=(*b, n_actions), dtype=torch.bool, **on),
            duration=Unbounded((*b, 1), dtype=self.dtype, **on),
            shape=b,
            **on,
        )
        counts = {name: Unbounded((*b, 1), dtype=torch.int64, **on) for name in self.counts()}
        if counts:
            self.observation_spec["counts"] = Composite(counts, shape=b, **on)
        self.action_spec = Categorical(n_actions, shape=b, dtype=torch.int64, **on)
        self.reward_spec = Unbounded((*b, 1), dtype=self.dtype, **on)
        self.full_done_spec = self._ends_spec()

    # -- what agents see of the first and only squad ------------------------------------------------------------------

    @property
    def satellite(self) -> Satellite:
        """The satellite, as it lives in the environment."""
        return self.squads[0].satellite

    @property
    def dead(self) -> Tensor:
        """Whether the satellite has died, [N]."""
        return self.squads[0].dead

    @property
    def requires_retasking(self) -> Tensor:
        """Whether the satellite has nothing left to do, [N]."""
        return self.squads[0].requires_retasking

    # -- step ---------------------------------------------------------------------------------------------------------

    def _step(self, tensordict: TensorDictBase) -> TensorDict:
        partial = tensordict.get("_step", None)
        return self.play(tensordict.get("action"), None if partial is None else partial.reshape(-1))

    @torch.no_grad()
    def play(self, action: Tensor, moves: Tensor | None = None) -> TensorDict:
        """Do ``action`` [N] where ``moves`` [N] is true, everywhere if None; what ``step`` puts under ``next``."""
        if action.dtype.is_floating_point or action.dtype == torch.bool:
            raise TypeError(f"action has dtype {action.dtype}; it must be an integer tensor, such as torch.int64")
        if action.shape != self.batch_size:
            raise ValueError(f"action has shape {list(action.shape)}; it must be {list(self.batch_size)}, one per environment")
        every = torch.ones_like(self.dead)
        action = self.squads[0].checked(action, every)
        all_act, moves = moves is None, every if moves is None else moves
        played = self._play([action], [moves], moves, all_act)
        reward = played.reward.squeeze(1) + self.failure_penalty * (self.dead & moves)
        self.returns = self.returns + reward
        truncated = self.truncated_by_time | self.rewarder.is_truncated().squeeze(1)
        terminated = self.dead | self.rewarder.is_terminated().squeeze(1)
        if self.terminate_on_time_limit:
            terminated = terminated | truncated
        return self._outputs(
            played,
            reward=reward.to(self.dtype).unsqueeze(-1),
            terminated=terminated.unsqueeze(-1),
            truncated=truncated.unsqueeze(-1),
            done=(terminated | truncated).unsqueeze(-1),
        )

    @torch.no_grad()
    def _outputs(self, played: Played | None, **parts: Tensor) -> TensorDict:
        observations = self.satellite.observations
        in_parts = self.satellite.obs_type is dict
        observation: Any = (
            self._cast(observations.get_dict(), self.batch_size) if in_parts else observations.get_vector(self.dtype)
        )
        duration = torch.zeros_like(self.fleet.sim_time) if played is None else played.duration
        parts |= {"observation": observation, "action_mask": self.satellite.action_mask()}
        parts["duration"] = duration.to(self.dtype).unsqueeze(-1)
        if counts := self.counts():
            parts["counts"] = TensorDict(counts, self.batch_size, device=self.device)
        return TensorDict(parts, self.batch_size, device=self.device)
