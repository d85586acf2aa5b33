"""Proximal policy optimisation of one environment, with a discount that depends on how long a step took.

Decisions last different times, so the problem is a semi-Markov decision process: with gamma per second and a step of t seconds,
the value of a state is the expectation of gamma^t (reward + value of the next state). The reward is discounted over its interval
too, as bsk_rl's ``TimeDiscountedGAE`` does.
"""

from __future__ import annotations

import dataclasses
import json
import logging
import time
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase, TensorDictSequential
from torch import Tensor, nn
from torchrl.collectors import Collector
from torchrl.data import LazyTensorStorage, ReplayBuffer, SamplerWithoutReplacement
from torchrl.envs import Compose, RewardSum, StepCounter, TransformedEnv
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE
from tqdm import tqdm

from bsk_torch.constants import DAY
from bsk_torch.env import SatelliteTasking
from bsk_torch.presets import make
from bsk_torch.rl.log import CsvLog
from bsk_torch.rl.policies import make_actor, make_critic, make_normaliser, make_policy, save_policy, sizes

logger = logging.getLogger(__name__)

POLICY, LOG, CONFIG = "policy.pt", "log.csv", "config.json"
"""Files of a run folder."""

REPORTED = ("entropy", "kl_approx", "clip_fraction", "explained_variance", "loss_critic")
"""What the log takes from the loss."""


@dataclass(frozen=True)
class PPOConfig:
    """What to train, for how long, and how.

    Args:
        preset: Name of the environment; see :func:`bsk_torch.make`.
        seconds: Training time after compilation, s; None for no limit.
        frames: Number of decisions; None for no limit. One of the two limits is needed.
        num_envs: Episodes at once.
        rollout: Decisions of each between two updates.
        seed: Seed of networks, actions and episodes.
        hidden: Width of every hidden layer.
        learning_rate: Adam's step at the start; it falls linearly to zero.
        gamma: Discount per second.
        lmbda: Decay of the advantage estimator, per decision.
        clip: Largest change of an action's probability, as a ratio's distance from one.
        entropy: Weight of the entropy at the start; it falls linearly to zero.
        epochs: Passes over a batch.
        minibatch: Decisions in a gradient step.
        gradient_norm: Gradients are scaled down to this norm.
        options: Arguments of the environment that differ from the preset's.
    """

    preset: str = "NadirScan-v1"
    seconds: float | None = 180.0
    frames: int | None = None
    num_envs: int = 1024
    rollout: int = 16
    seed: int = 0
    hidden: tuple[int, ...] = (64, 64)
    learning_rate: float = 1e-3
    gamma: float = 0.99999
    lmbda: float = 0.95
    clip: float = 0.2
    entropy: float = 0.01
    epochs: int = 8
    minibatch: int = 2048
    gradient_norm: float = 0.5
    options: dict[str, Any] = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        """Refuse training without end, and discounts that are none."""
        if self.seconds is None and self.frames is None:
            raise ValueError("seconds=None and frames=None: training needs a limit")
        if not 0.0 < self.gamma <= 1.0:
            raise ValueError(f"gamma={self.gamma} per second must lie in (0, 1]")

    @property
    def batch(self) -> int:
        """Decisions between two updates."""
        return self.num_envs * self.rollout

    def make_env(self) -> SatelliteTasking:
        """The environment to train in."""
        return make(self.preset, num_envs=self.num_envs, seed=self.seed, **self.options)


class Progress:
    """How much of its budget a training has used; the clock starts with :meth:`start`."""

    def __init__(self, config: PPOConfig) -> None:
        """Count towards the limits of ``config``."""
        self.config, self.frames, self.begin = config, 0, time.perf_counter()

    def start(self) -> None:
        """Start the clock."""
        self.begin = time.perf_counter()

    @property
    def seconds(self) -> float:
        """Time since the start, s."""
        return time.perf_counter() - self.begin

    @property
    def fraction(self) -> float:
        """Used part of the budget, 1 at the end."""
        used = [
            amount / limit for amount, limit in ((self.seconds, self.config.seconds), (self.frames, self.config.frames)) if limit
        ]
        return min(1.0, max(used))


class Recent:
    """Means over the episodes that ended last."""

    def __init__(self, size: int) -> None:
        """Remember ``size`` episodes."""
        self.episodes: deque[tuple[float, float, float]] = deque(maxlen=size)
        self.count = 0

    def add(self, batch: TensorDictBase) -> None:
        """Add the episodes that end in a batch [N, T]."""
        done = batch["next", "done"].squeeze(-1)
        columns = (batch["next", key].squeeze(-1)[done].tolist() for key in ("episode_reward", "truncated", "step_count"))
        ended = list(zip(*columns, strict=True))
        self.episodes.extend(ended)
        self.count += len(ended)

    def means(self) -> tuple[float, ...]:
        """Mean return, survival and number of decisions; nan before the first end."""
        if not self.episodes:
            return (float("nan"),) * 3
        return tuple(sum(column) / len(self.episodes) for column in zip(*self.episodes, strict=True))


def estimate_advantages(batch: TensorDictBase, estimator: GAE, gamma: float) -> None:
    """Write ``advantage`` and ``value_target`` of a batch [N, T], in semi-Markov time.

    Args:
        batch: Decisions in order of time, with ``reward`` and ``duration`` [N, T, 1] of each under ``next``.
        estimator: From :func:`make_estimator`.
        gamma: Discount per second.
    """
    reward, seconds = batch["next", "reward"], batch["next", "duration"]
    discounted = batch.clone(recurse=False)
    discounted["next", "reward"] = (reward.double() * gamma ** seconds.double()).to(reward.dtype)
    with torch.no_grad():
        estimator(discounted)
    for key in ("advantage", "value_target"):
        batch[key] = discounted[key].to(reward.dtype)


def make_estimator(critic: TensorDictModuleBase, gamma: float, lmbda: float) -> GAE:
    """Generalised advantage estimation that takes ``duration`` s as the exponent of ``gamma`` per second."""
    estimator = GAE(gamma=torch.tensor(gamma, dtype=torch.float64), lmbda=lmbda, value_network=critic)
    estimator.set_keys(steps_to_next_obs=("next", "duration"))
    return estimator


class Learner:
    """Actor, critic and their optimiser."""

    def __init__(self, config: PPOConfig, n_observed: int, n_actions: int) -> None:
        """Fresh networks for observations of width ``n_observed``."""
        self.config = config
        self.actor = make_actor(n_observed, n_actions, config.hidden)
        self.critic = make_critic(n_observed, config.hidden)
        self.estimator = make_estimator(self.critic, config.gamma, config.lmbda)
        self.loss = ClipPPOLoss(
            self.actor,
            self.critic,
            clip_epsilon=config.clip,
            entropy_coeff=config.entropy,
            normalize_advantage=True,
            loss_critic_type="l2",
        )
        self.optimiser = torch.optim.Adam(self.loss.parameters(), config.learning_rate, eps=1e-5)
        self.buffer = ReplayBuffer(
            storage=LazyTensorStorage(config.batch), sampler=SamplerWithoutReplacement(), batch_size=self._minibatch
        )

    @property
    def _minibatch(self) -> int:
        return min(self.config.minibatch, self.config.batch)

    @property
    def learning_rate(self) -> float:
        """Present step of the optimiser."""
        return float(self.optimiser.param_groups[0]["lr"])

    def anneal(self, fraction: float) -> None:
        """Set learning rate and weight of the entropy for a used ``fraction`` of the budget."""
        left = 1.0 - fraction
        self.optimiser.param_groups[0]["lr"] = self.config.learning_rate * left
        self.loss.entropy_coeff.fill_(self.config.entropy * left)

    def learn(self, batch: TensorDictBase) -> dict[str, float]:
        """Several passes over a batch [N, T]; means of what the loss reports."""
        estimate_advantages(batch, self.estimator, self.config.gamma)
        self.buffer.empty()
        self.buffer.extend(batch.reshape(-1))
        steps = self.config.epochs * (self.config.batch // self._minibatch)
        reports = [self._descend(self.buffer.sample()) for _ in range(steps)]
        means = torch.stack(reports).mean(0)
        return dict(zip(REPORTED, means.tolist(), strict=True))

    def _descend(self, sample: TensorDictBase) -> Tensor:
        """One gradient step; what the loss reports, [R]."""
        losses = self.loss(sample)
        self.optimiser.zero_grad()
        (losses["loss_objective"] + losses["loss_critic"] + losses["loss_entropy"]).backward()
        nn.utils.clip_grad_norm_(self.loss.parameters(), self.config.gradient_norm)
        self.optimiser.step()
        return torch.stack([losses[name].detach().mean().float() for name in REPORTED])


class Training:
    """A run: collects, learns, logs, and leaves policy, log and configuration in a folder."""

    def __init__(self, config: PPOConfig, out: Path) -> None:
        """Build environment and networks; nothing is simulated yet."""
        out.mkdir(parents=True, exist_ok=True)
        (out / CONFIG).write_text(json.dumps(dataclasses.asdict(config), indent=2) + "\n")
        self.config, self.out, self.days = config, out, 0.0
        torch.manual_seed(config.seed)
        self.env = config.make_env()
        self.n_observed, n_actions = sizes(self.env)
        self.learner = Learner(config, self.n_observed, n_actions)
        self.normaliser = make_normaliser()
        self.progress, self.recent = Progress(config), Recent(config.num_envs)

    @property
    def policy(self) -> TensorDictSequential:
        """The present policy, on raw observations; before training these are not normalised."""
        if not self.normaliser.initialized:
            return make_policy(self.learner.actor, torch.zeros(self.n_observed), torch.ones(self.n_observed))
        fixed = self.normaliser.to_observation_norm()
        return make_policy(self.learner.actor, fixed.loc, fixed.scale)

    def run(self) -> TensorDictSequential:
        """Train until the budget is used."""
        self._warm_up()
        with CsvLog(self.out / LOG) as log, self._bar() as bar:
            for iteration, (batch, collecting) in enumerate(self._batches()):
                begin = time.perf_counter()
                report = self.learner.learn(batch)
                self.progress.frames += batch.numel()
                row = self._row(batch, report) | {"iteration": iteration, "collect_seconds": collecting}
                row["update_seconds"] = time.perf_counter() - begin
                log.write(row)
                self._show(bar, row)
                if self.progress.fraction >= 1.0:
                    break
                self.learner.anneal(self.progress.fraction)
        save_policy(self.out / POLICY, self.policy, self.config.hidden)
        return self.policy

    def _warm_up(self) -> None:
        """Compile before the clock starts."""
        begin = time.perf_counter()
        self.env.rand_step(self.env.reset())
        self.env.set_seed(self.config.seed)
        logger.info("ready after %.1f s", time.perf_counter() - begin)

    def _batches(self) -> Iterator[tuple[TensorDictBase, float]]:
        """Batches [N, T] by the present actor, and the seconds that each took."""
        collector = Collector(
            TransformedEnv(self.env, Compose(RewardSum(), StepCounter(), self.normaliser)),
            self.learner.actor,
            frames_per_batch=self.config.batch,
            total_frames=-1,
            auto_register_policy_transforms=False,
            track_traj_ids=False,
        )
        self.progress.start()
        begin = time.perf_counter()
        for batch in collector:
            yield batch, time.perf_counter() - begin
            begin = time.perf_counter()

    def _row(self, batch: TensorDictBase, report: dict[str, float]) -> dict[str, float]:
        self.recent.add(batch)
        self.days += float(batch["next", "duration"].double().sum()) / DAY
        mean_return, survival, decisions = self.recent.means()
        return {
            "frames": self.progress.frames,
            "seconds": self.progress.seconds,
            "simulated_days": self.days,
            "episodes": self.recent.count,
            "return": mean_return,
            "survival": survival,
            "decisions": decisions,
            "kl": report["kl_approx"],
            "learning_rate": self.learner.learning_rate,
            "entropy_coefficient": float(self.learner.loss.entropy_coeff),
            **{name: report[name] for name in REPORTED if name != "kl_approx"},
        }

    def _bar(self) -> tqdm:
        return tqdm(total=100, desc="training", unit="%", bar_format="{desc} {percentage:3.0f}% |{bar}| {elapsed}{postfix}")

    def _show(self, bar: tqdm, row: dict[str, float]) -> None:
        bar.n = round(100.0 * self.progress.fraction, 1)
        bar.set_postfix_str(
            f"return {row['return']:.3f}, survival {row['survival']:.0%}, "
            f"{row['simulated_days'] / row['seconds']:.1f} simulated days/s"
        )


def train(config: PPOConfig, out: Path) -> TensorDictSequential:
    """Train a policy and leave it in folder ``out`` beside its log and configuration.

    Returns:
        The policy: writes ``action`` into a tensordict with ``observation`` and ``action_mask``.
    """
    return Training(config, out).run()
