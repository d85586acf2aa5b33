"""
Asynchronous multi-agent training
=================================

Four scanners learn one policy, each deciding when it finishes its own task.

On the command line::

    python examples/bsk_rl/async_multiagent_training.py --iterations 50 --num-envs 64

The problem of bsk_rl's page "Asynchronous Multiagent Decision Making". Comments mark lines that differ from it. RLlib needs three
connectors: one that lets busy satellites continue, and two that remove their steps from the experience. Here, ``action_mask``
allows busy satellites only to continue, and the loss includes only steps with a decision.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
from rllib_training import SAT_ARGS, ScanningSatellite, Show, task
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch import Tensor, nn
from torchrl.collectors import Collector
from torchrl.modules import MaskedCategorical, ProbabilisticActor, ValueOperator
from torchrl.objectives import ClipPPOLoss

# bsk_rl: from bsk_rl import act, data, obs, sats, scene
from bsk_torch import ConstellationTasking, act, formations
from bsk_torch.rl.training.advantages import write_advantages

AGENTS = "agents"
N_SATELLITES = 4


class AsynchronousScanner(ScanningSatellite):
    """As in ``rllib_training.py``, with other durations, and without the time."""

    observation_spec = ScanningSatellite.observation_spec[:-1]
    action_spec = [
        act.Scan(duration=150.0),
        act.Charge(duration=120.0),
        act.Downlink(duration=80.0),
        act.Desat(duration=45.0),
    ]


def make(
    num_envs: int = 1, sat_args: Sequence[dict[str, Any]] | None = None, **options: Any
) -> ConstellationTasking:
    """Return ``num_envs`` episodes of the problem.

    ``sat_args`` of each satellite replace what would be drawn, ``options`` those of the problem.
    """
    own = [{}] * N_SATELLITES if sat_args is None else sat_args
    # bsk_rl: walker_delta_args(n_planes=2, altitude=500)
    planes = formations.walker_delta_args(n_planes=2, altitude=500.0)
    defaults = task() | dict(sat_arg_randomizer=planes if sat_args is None else None)
    return ConstellationTasking(
        satellites=[
            AsynchronousScanner(f"Scanner{k + 1}", sat_args=SAT_ARGS | own[k])
            for k in range(N_SATELLITES)
        ],
        num_envs=num_envs,  # bsk_rl: one episode
        **(defaults | options),
    )


def mlp(inputs: int, outputs: int, width: int = 64) -> nn.Sequential:
    """Return a network with two hidden layers; bsk_rl: fcnet_hiddens=[2048, 2048]."""
    return nn.Sequential(
        nn.Linear(inputs, width),
        nn.Tanh(),
        nn.Linear(width, width),
        nn.Tanh(),
        nn.Linear(width, outputs),
    )


class Team:
    """One actor and one critic for all satellites; bsk_rl: policies={"p0"} for all agents."""

    def __init__(
        self, env: ConstellationTasking, gamma: float, lmbda: float, rate: float
    ) -> None:
        """Build new networks; ``gamma`` is per second, ``lmbda`` per decision of a satellite."""
        width, actions = (
            env.observation_spec[AGENTS, "observation"].shape[-1],
            env.action_spec[AGENTS, "action"].space.n,
        )
        self.gamma, self.lmbda = gamma, lmbda ** (1.0 / env.fleet.size)
        logits = TensorDictModule(
            mlp(width, actions), in_keys=["seen"], out_keys=["logits"]
        )
        self.actor = ProbabilisticActor(
            logits,
            in_keys={"logits": "logits", "mask": "action_mask"},
            distribution_class=MaskedCategorical,
            return_log_prob=True,
        )
        self.critic = ValueOperator(mlp(width, 1), in_keys=["seen"])
        self.loss = ClipPPOLoss(
            self.actor,
            self.critic,
            clip_epsilon=0.1,
            entropy_coeff=0.01,
            normalize_advantage=False,
        )
        self.loss.loss_mask_key = "decides"
        self.optimiser = torch.optim.Adam(self.loss.parameters(), rate)

    def policy(self) -> TensorDictSequential:
        """Return what chooses actions [N, S] in an environment; busy satellites can only continue."""

        def choose(observation: Tensor, action_mask: Tensor) -> tuple[Tensor, Tensor]:
            chosen = self.actor(
                TensorDict(
                    {"seen": observation, "action_mask": action_mask},
                    observation.shape[:-1],
                )
            )
            return chosen["action"], chosen["action_log_prob"]

        keys = [(AGENTS, "observation"), (AGENTS, "action_mask")]
        return TensorDictSequential(
            TensorDictModule(
                choose,
                in_keys=keys,
                out_keys=[(AGENTS, "action"), (AGENTS, "log_prob")],
            )
        )

    def learn(self, batch: TensorDictBase, epochs: int = 4) -> dict[str, float]:
        """Learn from a batch [N, T] of all satellites; return what is worth a line of a log."""
        team = self._experience(batch)
        # bsk_rl: TimeDiscountedGAEPPOTorchLearner, after CondenseMultiStepActions
        write_advantages(
            team,
            self.critic,
            self.gamma,
            self.lmbda,
            done="removed",
            terminated="satellite_terminated",
        )
        deviation, mean = torch.std_mean(team["advantage"][team["decides"]])
        team["advantage"] = (team["advantage"] - mean) / deviation.clamp(min=1e-4)
        for _ in range(epochs):
            losses = self.loss(team)
            self.optimiser.zero_grad()
            (
                losses["loss_objective"]
                + losses["loss_critic"]
                + losses["loss_entropy"]
            ).backward()
            nn.utils.clip_grad_norm_(self.loss.parameters(), 0.5)
            self.optimiser.step()
        reward = batch["next", AGENTS, "reward"].sum(1).mean()
        return {
            "reward": float(reward),
            "deciding": float(team["decides"].float().mean()),
        }

    @staticmethod
    def _experience(batch: TensorDictBase) -> TensorDict:
        """Return observations, actions and rewards [N, T, S, ...], and which satellites decided, [N, T, S]."""
        now, after = batch[AGENTS], batch["next", AGENTS]
        ended = batch["next", "done"].unsqueeze(-2)
        parts = {
            "seen": now["observation"],
            "action_mask": now["action_mask"],
            "action": now["action"],
            "action_log_prob": now["log_prob"],
            "decides": ~now["action_mask"][..., -1],  # bsk_rl: requires_retasking
            "next": {
                "seen": after["observation"],
                "reward": after["reward"],
                "duration": after["duration"],
                "done": batch["next", "done"],
                "removed": ended | ~after["mask"].unsqueeze(-1),
                "satellite_terminated": batch["next", "terminated"].unsqueeze(-2)
                | ~after["mask"].unsqueeze(-1),
            },
        }
        return TensorDict(parts, batch.batch_size, names=[None, "time"])


def main() -> None:
    """Train."""
    parser = argparse.ArgumentParser(description="Learn one policy for four scanners.")
    parser.add_argument("--num-envs", type=int, default=32, help="episodes at once")
    parser.add_argument(
        "--iterations", type=int, default=20, help="number of training batches"
    )
    parser.add_argument(
        "--rollout", type=int, default=32, help="steps of each episode in a batch"
    )
    parser.add_argument(
        "--time-limit", type=float, default=28500.0, help="length of an episode, s"
    )
    parser.add_argument("--backend", default="compiled", choices=["compiled", "eager"])
    parser.add_argument(
        "--figure",
        type=Path,
        help="file for a figure of the learning curve; needs the extra viz",
    )
    options = parser.parse_args()
    torch.manual_seed(0)
    env = make(
        options.num_envs, time_limit=options.time_limit, backend=options.backend, seed=0
    )
    team = Team(env, gamma=0.99997, lmbda=0.95, rate=1e-3)  # bsk_rl: lr=0.00003
    frames, show = options.num_envs * options.rollout, Show()
    # bsk_rl: tune.run("PPO", ...) with ContinuePreviousAction, MakeAddedStepActionValid and CondenseMultiStepActions
    for k, batch in enumerate(
        Collector(
            env,
            team.policy(),
            frames_per_batch=frames,
            total_frames=options.iterations * frames,
        )
    ):
        show((k + 1) * frames, team.learn(batch))
    show.draw(options.figure, "reward", "deciding")


if __name__ == "__main__":
    main()
