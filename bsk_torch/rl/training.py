"""A training run from end to end: collect, learn, log, and leave everything in a folder."""

from __future__ import annotations

import json
import logging
import time
from collections import deque
from collections.abc import Iterator
from pathlib import Path

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase, TensorDictSequential
from torchrl.collectors import Collector
from torchrl.envs import Compose, RewardSum, StepCounter, TransformedEnv
from tqdm import tqdm

from bsk_torch.constants import DAY
from bsk_torch.rl.log import CsvLog
from bsk_torch.rl.policies import save_policy
from bsk_torch.rl.ppo import REPORTED, Learner, PPOConfig

logger = logging.getLogger(__name__)

POLICY, LOG, CONFIG = "policy.pt", "log.csv", "config.json"
"""Files of a run folder."""


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
        used = (self.seconds, self.config.seconds), (self.frames, self.config.frames)
        return min(1.0, max(amount / limit for amount, limit in used if limit is not None))


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


class Training:
    """A run: collects, learns, logs, and leaves policy, log and configuration in a folder."""

    def __init__(self, config: PPOConfig, out: Path) -> None:
        """Build environment and networks; nothing is simulated yet."""
        out.mkdir(parents=True, exist_ok=True)
        kept = {name: getattr(config, name) for name in config.__dataclass_fields__}
        (out / CONFIG).write_text(json.dumps(kept, indent=2, default=repr) + "\n")
        self.config, self.out, self.days = config, out, 0.0
        torch.manual_seed(config.seed)
        self.env = config.make_env()
        self.learner = self.make_learner()
        self.progress, self.recent = Progress(config), Recent(config.num_envs)

    def make_learner(self) -> Learner:
        """What learns in the environment."""
        return Learner(self.config, self.env)

    @property
    def policy(self) -> TensorDictSequential:
        """The present policy; it goes on learning while training does."""
        return self.learner.networks.policy

    @property
    def actor(self) -> TensorDictModuleBase:
        """What decides while experience is collected: writes actions and their log-probabilities."""
        return self.policy.select_out_keys("action", "action_log_prob")

    def run(self) -> TensorDictSequential:
        """Train until the budget is used, or the user interrupts."""
        self._warm_up()
        with CsvLog(self.out / LOG) as log, self._bar() as bar:
            try:
                for iteration, (batch, collecting) in enumerate(self._batches()):
                    row = self._learn(batch) | {"iteration": iteration, "collect_seconds": collecting}
                    log.write(row)
                    self._show(bar, row)
                    if self.progress.fraction >= 1.0:
                        break
            except KeyboardInterrupt:
                logger.info("stopped; the policy learned so far is kept")
        save_policy(self.out / POLICY, self.learner.plan, self.learner.networks)
        return self.policy

    def _warm_up(self) -> None:
        """Compile before the clock starts."""
        begin = time.perf_counter()
        self.env.step(self.actor(self.env.reset()))
        self.env.set_seed(self.config.seed)
        torch.manual_seed(self.config.seed)
        logger.info("ready after %.1f s", time.perf_counter() - begin)

    def _batches(self) -> Iterator[tuple[TensorDictBase, float]]:
        """Batches [N, T] by the present actor, and the seconds that each took."""
        collector = Collector(
            TransformedEnv(self.env, Compose(RewardSum(), StepCounter())),
            self.actor,
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

    def _learn(self, batch: TensorDictBase) -> dict[str, float]:
        """Learn from a batch [N, T]; a row of the log."""
        begin = time.perf_counter()
        self.learner.anneal(self.progress.fraction)
        report = self.learner.learn(batch)
        self.progress.frames += batch.numel()
        self.days += float(batch["next", "duration"].double().sum()) / DAY
        self.recent.add(batch)
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
            "update_seconds": time.perf_counter() - begin,
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
