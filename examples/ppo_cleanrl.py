"""
Single-file PPO
===============

CleanRL-style PPO on the Gymnasium vector environment: torch only, with action masks and a discount per second.

On the command line::

    python examples/ppo_cleanrl.py
    python examples/ppo_cleanrl.py --preset AEOSPower-v1 --num-envs 256 --rollout 32 --gamma 0.997

Decisions vary in duration, so gamma is a discount per second: after a step of t seconds, future rewards are multiplied by
gamma^t. ``info["duration"]`` is t, and ``info["action_mask"]`` marks legal actions.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import gymnasium
import torch
from torch import Tensor, nn
from torch.distributions import Categorical

from bsk_torch.rl.durations import estimate_advantages

FRESH = 1_000_003
"""Added to the training seed for evaluation, so that evaluation episodes are unseen."""

LEAST = 0.05
"""Final fraction of learning rate and entropy weight."""


# -- agent ------------------------------------------------------------------------------------------------------------


class Agent(nn.Module):
    """Actor and critic, on observations normalized by running statistics."""

    def __init__(self, n_observed: int, n_actions: int, hidden: int) -> None:
        """Networks of two layers of ``hidden`` units; the untrained actor is nearly uniform."""
        super().__init__()
        self.actor, self.critic = (
            nn.Sequential(
                nn.Linear(n_observed, hidden),
                nn.Tanh(),
                nn.Linear(hidden, hidden),
                nn.Tanh(),
                nn.Linear(hidden, n_out),
            )
            for n_out in (n_actions, 1)
        )
        nn.init.orthogonal_(self.actor[-1].weight, 0.01)
        self.register_buffer("count", torch.ones((), dtype=torch.float64))
        self.register_buffer("mean", torch.zeros(n_observed, dtype=torch.float64))
        self.register_buffer("square", torch.ones(n_observed, dtype=torch.float64))

    def look(self, observation: Tensor) -> None:
        """Update the normalization with observations [..., F]."""
        rows = observation.flatten(0, -2).double()
        self.count += len(rows)
        self.mean += (rows.mean(0) - self.mean) * len(rows) / self.count
        self.square += (rows.square().mean(0) - self.square) * len(rows) / self.count

    def normalised(self, observation: Tensor) -> Tensor:
        """Observations [..., F] of mean 0 and variance 1, within ten standard deviations."""
        deviation = (self.square - self.mean.square()).clamp(min=1e-8).sqrt()
        return ((observation - self.mean) / deviation).clamp(-10.0, 10.0).float()

    def policy(self, observation: Tensor, mask: Tensor) -> Categorical:
        """Distribution over the actions that ``mask`` [..., n] allows."""
        logits = self.actor(self.normalised(observation))
        return Categorical(
            logits=logits.masked_fill(~mask, torch.finfo(logits.dtype).min)
        )

    def value(self, observation: Tensor) -> Tensor:
        """Expected return from observations [..., F], [...]."""
        return self.critic(self.normalised(observation)).squeeze(-1)


# -- experience -------------------------------------------------------------------------------------------------------


@dataclass
class Step:
    """A step of N environments, each [N, ...]; ``following`` is the value of what came next."""

    observation: Tensor
    mask: Tensor
    action: Tensor
    log_prob: Tensor
    value: Tensor
    reward: Tensor
    seconds: Tensor
    ended: Tensor
    terminated: Tensor
    following: Tensor


class Collector:
    """Steps the vector environment, and keeps the returns of recent episodes."""

    def __init__(
        self, env: gymnasium.vector.VectorEnv, agent: Agent, seed: int
    ) -> None:
        """Start the first episodes of ``seed``."""
        self.env, self.agent = env, agent
        self.observation, self.info = env.reset(seed=seed)
        self.running = torch.zeros(env.num_envs, dtype=torch.float64)
        self.returns: list[float] = []

    @torch.no_grad()
    def step(self) -> Step:
        """Step every environment with the agent's actions."""
        observation, mask = self.observation, self.info["action_mask"].bool()
        chosen = self.agent.policy(observation, mask)
        action = chosen.sample()
        self.observation, reward, terminated, truncated, self.info = self.env.step(
            action
        )
        ended = terminated | truncated
        self._count(reward, ended)
        # finished environments already show their next episode
        last = self.info.get("final_obs", self.observation)
        seconds = torch.where(
            ended,
            self.info.get("final_info", self.info)["duration"],
            self.info["duration"],
        )
        following = self.agent.value(
            torch.where(ended.unsqueeze(-1), last, self.observation)
        )
        value = self.agent.value(observation)
        return Step(
            observation,
            mask,
            action,
            chosen.log_prob(action),
            value,
            reward,
            seconds,
            ended,
            terminated,
            following,
        )

    def _count(self, reward: Tensor, ended: Tensor) -> None:
        self.running += reward
        self.returns = (self.returns + self.running[ended].tolist())[-len(ended) :]
        self.running = self.running.masked_fill(ended, 0.0)


# -- learning ---------------------------------------------------------------------------------------------------------


def learn(
    agent: Agent,
    optimiser: torch.optim.Optimizer,
    steps: list[Step],
    options: argparse.Namespace,
    left: float,
) -> None:
    """Make several passes over the steps of a rollout; ``left`` scales the entropy weight."""
    batch = {
        name: torch.stack([getattr(step, name) for step in steps])
        for name in Step.__annotations__
    }
    estimated = estimate_advantages(
        *(batch.pop(name) for name in ("reward", "seconds")),
        batch["value"],
        *(batch.pop(name) for name in ("following", "ended", "terminated")),
        gamma=options.gamma,
        lmbda=options.lmbda,
        time_dim=0,
    )
    batch |= zip(("advantage", "target"), estimated, strict=True)
    batch = {name: value.flatten(0, 1) for name, value in batch.items()}
    for _ in range(options.epochs):
        for rows in torch.randperm(len(batch["value"])).split(options.minibatch):
            loss = ppo_loss(
                agent,
                {name: value[rows] for name, value in batch.items()},
                options.clip,
                options.entropy * left,
            )
            optimiser.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(agent.parameters(), options.gradient_norm)
            optimiser.step()
    # only now: the stored probabilities use the old normalization
    agent.look(batch["observation"])


def ppo_loss(
    agent: Agent, part: dict[str, Tensor], clip: float, entropy: float
) -> Tensor:
    """Clipped surrogate, squared error of the values, and a bonus for entropy."""
    policy = agent.policy(part["observation"], part["mask"])
    ratio = (policy.log_prob(part["action"]) - part["log_prob"]).exp()
    advantage = (part["advantage"] - part["advantage"].mean()) / (
        part["advantage"].std() + 1e-8
    )
    gain = torch.minimum(
        ratio * advantage, ratio.clamp(1.0 - clip, 1.0 + clip) * advantage
    ).mean()
    error = (agent.value(part["observation"]) - part["target"]).square().mean()
    return error - gain - entropy * policy.entropy().mean()


# -- evaluation -------------------------------------------------------------------------------------------------------


@torch.no_grad()
def evaluate(
    env: gymnasium.vector.VectorEnv, agent: Agent | None, seed: int
) -> tuple[Tensor, Tensor]:
    """Play one episode per environment (randomly without an agent): returns [N], and whether the time limit ended it [N]."""
    observation, info = env.reset(seed=seed)
    returns, over, lasted = (
        torch.zeros(env.num_envs, dtype=kind)
        for kind in (torch.float64, torch.bool, torch.bool)
    )
    while not bool(over.all()):
        mask = info["action_mask"]
        policy = (
            Categorical(probs=mask.float())
            if agent is None
            else agent.policy(observation, mask.bool())
        )
        action = policy.sample() if agent is None else policy.probs.argmax(-1)
        observation, reward, terminated, truncated, info = env.step(action)
        returns += torch.where(over, 0.0, reward)
        lasted = lasted | (truncated & ~over)
        over = over | terminated | truncated
    return returns, lasted


def show(title: str, returns: Tensor, lasted: Tensor) -> None:
    """Print the mean return of an evaluation with its 95 % confidence interval, and the survival."""
    half = 1.96 * returns.std() / len(returns) ** 0.5
    print(
        f"{title:>10}: return {returns.mean():.3f} ± {half:.3f}, survival {lasted.double().mean():.1%}"
    )


def draw(curve: list[tuple[int, float]], path: Path) -> None:
    """Plot the return of recent episodes over the decisions to a file."""
    from bsk_torch.viz.figures import style

    figure, (panel,) = style.panels([3.0])
    panel.plot(*zip(*curve, strict=True), color=style.PALETTE[0])
    style.label(panel, "return while training")
    panel.set_xlabel("decisions")
    style.save(figure, path)


def arguments(line: Sequence[str] | None = None) -> argparse.Namespace:
    """Parse the command line, or ``line``."""
    parser = argparse.ArgumentParser(
        description="PPO in one file, on the Gymnasium vector environment."
    )
    parser.add_argument(
        "--preset",
        default="NadirScan-v1",
        help="single-satellite preset with vector observations",
    )
    parser.add_argument(
        "--steps", type=int, default=2_000_000, help="number of training decisions"
    )
    parser.add_argument("--num-envs", type=int, default=1024, help="episodes at once")
    parser.add_argument(
        "--rollout",
        type=int,
        default=16,
        help="decisions per episode between two updates",
    )
    parser.add_argument(
        "--hidden", type=int, default=64, help="width of the two hidden layers"
    )
    parser.add_argument(
        "--learning-rate",
        type=float,
        default=2.5e-3,
        help="initial value; decreases linearly",
    )
    parser.add_argument(
        "--gamma", type=float, default=0.99999, help="discount per second"
    )
    parser.add_argument(
        "--lmbda",
        type=float,
        default=0.95,
        help="decay of the advantage estimator, per decision",
    )
    parser.add_argument(
        "--clip",
        type=float,
        default=0.2,
        help="maximum change of an action's probability ratio",
    )
    parser.add_argument(
        "--entropy",
        type=float,
        default=0.01,
        help="initial entropy weight; decreases linearly",
    )
    parser.add_argument("--epochs", type=int, default=8, help="passes over a rollout")
    parser.add_argument(
        "--minibatch", type=int, default=2048, help="decisions in a gradient step"
    )
    parser.add_argument(
        "--gradient-norm",
        type=float,
        default=0.5,
        help="gradients are scaled down to this norm",
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--episodes", type=int, default=1024, help="unseen episodes per evaluation"
    )
    parser.add_argument(
        "--time-limit",
        type=float,
        help="length of an episode, s (default: the preset's)",
    )
    parser.add_argument("--backend", default="compiled", choices=["compiled", "eager"])
    parser.add_argument("--out", type=Path, help="file for the agent's weights")
    parser.add_argument(
        "--figure",
        type=Path,
        help="file for a figure of the learning curve; needs the extra viz",
    )
    options = parser.parse_args(line)
    known = [
        name
        for name, spec in gymnasium.registry.items()
        if name.startswith("bsk_torch/") and spec.vector_entry_point
    ]
    if f"bsk_torch/{options.preset}" not in known:
        names = ", ".join(name.removeprefix("bsk_torch/") for name in known)
        parser.error(
            f"--preset {options.preset!r} is no environment of one satellite; these are {names}"
        )
    return options


def make_env(options: argparse.Namespace, num_envs: int) -> gymnasium.vector.VectorEnv:
    """Return episodes of the preset; its name is registered by the import of bsk_torch."""
    limit = {} if options.time_limit is None else {"time_limit": options.time_limit}
    return gymnasium.make_vec(
        f"bsk_torch/{options.preset}",
        num_envs=num_envs,
        backend=options.backend,
        output="torch",
        autoreset_mode="SameStep",
        **limit,
    )


def train(options: argparse.Namespace) -> tuple[Agent, list[tuple[int, float]]]:
    """Train; return the agent, and returns while training by the number of decisions."""
    torch.manual_seed(options.seed)
    env = make_env(options, options.num_envs)
    agent = Agent(
        env.single_observation_space.shape[0],
        int(env.single_action_space.n),
        options.hidden,
    )
    optimiser = torch.optim.Adam(agent.parameters(), options.learning_rate, eps=1e-5)
    collector = Collector(env, agent, options.seed)
    per_update, begin = options.num_envs * options.rollout, time.perf_counter()
    curve: list[tuple[int, float]] = []
    for update in range(max(1, options.steps // per_update)):
        left = max(LEAST, 1.0 - update * per_update / options.steps)
        optimiser.param_groups[0]["lr"] = options.learning_rate * left
        learn(
            agent,
            optimiser,
            [collector.step() for _ in range(options.rollout)],
            options,
            left,
        )
        if collector.returns:
            curve.append(
                (
                    (update + 1) * per_update,
                    sum(collector.returns) / len(collector.returns),
                )
            )
        if update % 10 == 9 and curve:
            recent = curve[-1][1]
            print(
                f"{(update + 1) * per_update:>9} steps, {time.perf_counter() - begin:4.0f} s: return {recent:.3f}"
            )
    return agent, curve


def main() -> None:
    """Train and evaluate."""
    options = arguments()
    torch.set_num_threads(1)
    agent, curve = train(options)
    fresh = make_env(options, options.episodes)
    show("random", *evaluate(fresh, None, options.seed + FRESH))
    show("trained", *evaluate(fresh, agent, options.seed + FRESH))
    if options.out is not None:
        torch.save(agent.state_dict(), options.out)
    if options.figure is not None:
        draw(curve, options.figure)


if __name__ == "__main__":
    main()
