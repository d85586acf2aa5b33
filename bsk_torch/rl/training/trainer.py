"""A training run from end to end: collect, learn, evaluate, log, and leave everything in a folder."""

from __future__ import annotations

import copy
import logging
import reprlib
import shlex
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, nullcontext
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.collectors import BaseCollector

from bsk_torch import __version__
from bsk_torch._checks import number, whole
from bsk_torch.constants import DAY
from bsk_torch.files import PART, unwritable
from bsk_torch.rl.evaluation.evaluate import Evaluation, evaluate
from bsk_torch.rl.networks.plans import MEMORY
from bsk_torch.rl.policies.checksummed import load_checksummed, save_checksummed
from bsk_torch.rl.policies.files import POLICY, plain
from bsk_torch.rl.training.advice import hardships
from bsk_torch.rl.training.cluster import check_ray, connected
from bsk_torch.rl.training.collect import Batches, bookmarks, make_collector
from bsk_torch.rl.training.config import AUTO, CONFIG, PPOConfig, save_config
from bsk_torch.rl.training.episodes import RecentEpisodes
from bsk_torch.rl.training.lock import LOCK, FolderLock
from bsk_torch.rl.training.log import RunLog, check_loggers
from bsk_torch.rl.training.ppo import REPORTED, Learner
from bsk_torch.rl.training.progress import Progress, TrainingBar, interruptible, unbroken
from bsk_torch.rl.training.workers import lost_process, warn_of_few_cores, with_workers

logger = logging.getLogger(__name__)

CHECKPOINT = "checkpoint.pt"
"""File of a run folder to resume from."""

FIXED = ("preset", "algorithm", "network", "hidden", "num_envs", "collector", "workers", "ahead", "seed", "options")
"""Settings that must not change when a run is resumed, because its checkpoint depends on them."""

VALIDATION = 2_000_003
"""Added to the seed of training to get that of the evaluations by which the best policy is chosen."""

LEVEL = "storage_level_fraction"
"""Observation of the fill level of the data buffer."""


@contextmanager
def one_thread() -> Iterator[None]:
    """Use one thread of torch: the order of long sums, and of MKL's on processors of Intel, follows the number of threads."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


class Training:
    """A run: collects, learns, evaluates, logs, and leaves policy, logs, checkpoint and configuration in a folder."""

    def __init__(self, config: PPOConfig, out: Path, resume: bool = False) -> None:
        """Build environment and networks; nothing is simulated yet, and nothing is written until all is checked.

        Args:
            config: What to train and how.
            out: The folder; it must not hold anything yet, unless a run in it is resumed.
            resume: Resume from the checkpoint in ``out``, with the same result as without interruption; start if there is no
                checkpoint yet.

        Raises:
            FileExistsError: If ``out`` is not empty, or no folder.
            FileNotFoundError: If there is no run to resume.
            FolderInUseError: If another process works in ``out``.
            ConnectionError: If the Ray cluster that the environment names cannot be reached.
            ModuleNotFoundError: If a logger or Ray that the configuration names is not installed.
            OSError: If ``out`` cannot be written to.
            ValueError: If the checkpoint is damaged, of another version, or of other settings that cannot change.
        """
        check_loggers(config.loggers)
        if config.collector == "ray":
            check_ray()
        (check_resumable if resume else check_folder)(out)
        if resume and config.workers == AUTO:
            raise ValueError(f"workers={AUTO!r} is for new runs; the run in {str(out)!r} has a number, which cannot change")
        config = with_workers(config)
        warn_of_few_cores(config)
        self.config, self.out = config, out
        self.enough: Callable[[], bool] | None = None
        with ExitStack() as undo:
            if resume:
                self.lock = FolderLock(out)
                undo.callback(self.lock.release)
            self._build(read_checkpoint(out, config) if resume else None)
            if not resume:
                out.mkdir(parents=True, exist_ok=True)
                self.lock = FolderLock(out)
                undo.callback(self.lock.release)
                check_empty(out)  # another process may have come first
            save_config(config, out / CONFIG)
            undo.pop_all()

    def _build(self, saved: dict[str, Any] | None) -> None:
        config = self.config
        self.days, self.iteration, self.interrupted = 0.0, 0, False
        self.best: dict[str, Any] = {"return": float("-inf"), "waited": 0, "networks": None}
        torch.manual_seed(config.seed)
        self.env = config.make_env() if config.collector == "single" else config.make_env(0, 1)
        self.judge: Any = config.make_env(0, config.evaluate_episodes) if config.evaluate_every else None
        self.learner = self.make_learner()
        self.progress, self.recent = Progress(config), RecentEpisodes(config.num_envs, self.env.failure_penalty)
        self.marks: list[dict[str, Any]] | None = None
        self.begun: TensorDictBase | None = None
        if saved is not None:
            self._restore(saved)

    # -- what differs for constellations ------------------------------------------------------------------------------

    def make_learner(self) -> Any:
        """Return the learner for the environment, a :class:`Learner` or what has its attributes."""
        return Learner(self.config, self.env)

    @property
    def policy(self) -> TensorDictModuleBase:
        """The current policy; it continues to learn during training."""
        return self.learner.policy

    @property
    def actor(self) -> TensorDictModuleBase:
        """Policy that collects experience: it writes actions and their log-probabilities."""
        memory = [("next", MEMORY)] if self.learner.recurrent else []
        return self.policy.select_out_keys("action", "action_log_prob", *memory)

    def evaluate(self) -> Evaluation:
        """The current policy in unseen episodes, the same every time."""
        return evaluate(self.policy, self.judge, seed=self.config.seed + VALIDATION)

    def survived(self, batch: TensorDictBase) -> Tensor:
        """Return where the satellite is alive at the end of an episode, [N, T]."""
        return batch["next", "truncated"].squeeze(-1)

    def rewards(self, batch: TensorDictBase) -> Tensor:
        """Rewards of a batch, [N, T]."""
        return batch["next", "reward"].squeeze(-1)

    def fill(self, batch: TensorDictBase) -> Tensor | None:
        """Return the level of the data buffer after each step, fraction [N, T]; None if no vector shows it."""
        names = [name.split(".")[-1] for name in self.env.satellite.observation_description]
        observation = batch["next", "observation"]
        return observation[..., names.index(LEVEL)] if LEVEL in names and isinstance(observation, Tensor) else None

    # -- running ------------------------------------------------------------------------------------------------------

    def run(self, bar: bool = True, enough: Callable[[], bool] | None = None) -> TensorDictModuleBase:
        """Train until the budget is used, patience is at its end, or the user interrupts; the best policy.

        Args:
            bar: Whether to show the progress.
            enough: Called at the start and after each update, while the clock of the budget stands still; training ends when it
                returns True. Random numbers drawn in it do not change the training.

        Raises:
            RuntimeError: If the training diverges, or a process that collects fails or is lost. The run can be resumed.
            OSError: If the last checkpoint or the policy cannot be written, or the Ray cluster is not reached; likewise.
        """
        self.enough = enough
        try:
            with connected() if self.config.collector == "ray" else nullcontext():
                self._train(bar)
            return self._finish()
        finally:
            self.lock.release()

    def _train(self, shown: bool) -> None:
        self._warm_up()
        actor = copy.deepcopy(self.actor) if self.config.ahead else self.actor
        with self._collecting():
            collector = make_collector(self.config, self.env, actor, self.marks)
        if self.marks is not None:
            torch.set_rng_state(self.generator)
        batches = Batches(collector, self.config.ahead, lambda: actor.load_state_dict(self.actor.state_dict()), self.begun)
        try:
            with (
                RunLog(self.out, self.config.loggers, self.progress.frames) as log,
                TrainingBar(shown) as bar,
                interruptible() as stop,
                unbroken(),
            ):
                self.progress.start()
                self._loop(batches, log, bar, stop)
                self.interrupted = stop.is_set()
        finally:
            batches.close()
            shut_down(collector)

    @contextmanager
    def _collecting(self, collector: BaseCollector | None = None) -> Iterator[None]:
        """Add to errors in collecting processes which process was lost, if one was, and how to resume."""
        try:
            yield
        except Exception as error:
            if self.config.collector == "single":
                raise
            reason = lost_process(collector) or [type(error).__name__, *str(error).strip().splitlines()[:1]][-1]
            raise RuntimeError(f"a process that collects experience has failed ({reason}); {resumption(self.out)}") from error

    def _loop(self, batches: Batches, log: RunLog, bar: TrainingBar, stop: threading.Event) -> None:
        if self._reached():
            return
        while self.progress.fraction < 1.0:
            begin = time.perf_counter()
            with self._collecting(batches.collector):
                batch = batches.take()
            row = {"iteration": self.iteration, "collect_seconds": time.perf_counter() - begin} | self._learn(batch)
            self.iteration += 1
            log.iteration(row)
            bar.show(self.progress, row, len(self.recent.ended))
            if self._due(self.config.evaluate_every) or (self.config.evaluate_every and self.progress.fraction >= 1.0):
                log.evaluated(self._judge())
            stale = self.config.patience is not None and self.best["waited"] >= self.config.patience
            if self.enough is not None:
                with self._collecting(batches.collector):
                    batches.newest(batch)  # else it would be collected while the clock stands still
            reached = self._reached()
            last = stop.is_set() or stale or reached or self.progress.fraction >= 1.0
            if last or self._due(self.config.checkpoint_every):
                self._save(batches, batch, last)
            if stop.is_set() or stale or reached:
                early = "early, because enough() returned True" if reached else "early, because the return has not grown any more"
                logger.info("stopped %s", "by the user" if stop.is_set() else early)
                return

    def _reached(self) -> bool:
        """Whether the function that watches the run ends it; its time and random numbers do not count."""
        if self.enough is None:
            return False
        with self.progress.paused(), torch.random.fork_rng(devices=[]):
            return self.enough()

    def _due(self, every: int | None) -> bool:
        """Whether a multiple of ``every`` frames has been passed in the last iteration."""
        return (
            every is not None
            and every > 0
            and self.progress.frames // every > (self.progress.frames - self.config.batch) // every
        )

    def _warm_up(self) -> None:
        """Compile before the clock starts."""
        with torch.no_grad():
            self.env.step(self.actor(self.env.reset()))
        self.env.set_seed(self.config.seed)
        torch.manual_seed(self.config.seed)

    def _learn(self, batch: TensorDictBase) -> dict[str, float]:
        """Learn from a batch [N, T]; a row of the log."""
        begin = time.perf_counter()
        if self.iteration == 0:
            for hardship in hardships(self.config, self.env, self.rewards(batch), batch["next", "duration"].squeeze(-1)):
                logger.warning(hardship)
        self.recent.add(self.rewards(batch), batch["next", "done"].squeeze(-1), self.survived(batch), self.fill(batch))
        self.days += float(batch["next", "duration"].double().sum()) / DAY
        fraction = self.progress.fraction
        self.learner.anneal(fraction)
        learning_rate, entropy_coefficient = self.config.annealed(fraction)
        with one_thread():
            report = self.learner.learn(batch)
        if not _finite(self.learner.policy_state()):
            raise RuntimeError(
                f"the training has diverged after {self.progress.frames} frames: weights are not finite; try a smaller "
                f"learning_rate than {self.config.learning_rate}"
            )
        self.progress.frames += batch.numel()
        return {
            "frames": self.progress.frames,
            "seconds": self.progress.seconds,
            "simulated_days": self.days,
            "episodes": self.recent.count,
            **self.recent.means(),
            "kl": report["kl_approx"],
            "learning_rate": learning_rate,
            "entropy_coefficient": entropy_coefficient,
            "update_seconds": time.perf_counter() - begin,
            **{name: report[name] for name in REPORTED if name != "kl_approx"},
        }

    # -- evaluation ---------------------------------------------------------------------------------------------------

    def _judge(self) -> dict[str, float]:
        with torch.random.fork_rng(devices=[]):  # seeding an environment seeds torch
            result = self.evaluate()
        estimate = result.mean_return
        if estimate.mean > self.best["return"]:
            self.best = {"return": estimate.mean, "waited": 0, "networks": self._networks()}
            with self._unless_last(False, POLICY):
                self._save_policy()
        else:
            self.best["waited"] += 1
        return {
            "frames": self.progress.frames,
            "seconds": self.progress.seconds,
            "return": estimate.mean,
            "return_half_width": estimate.half_width,
            "survival": result.survival,
            "collected": float(result.collected.double().mean()),
            "fill": float("nan") if result.fill is None else float(result.fill.double().mean()),
        }

    def _networks(self) -> dict[str, object]:
        return copy.deepcopy(self.learner.policy_state())

    def _finish(self) -> TensorDictModuleBase:
        """The best policy, or the last one if none has been evaluated."""
        if self.best["networks"] is not None:
            self.learner.load_policy_state(self.best["networks"])
        self._save_policy()
        return self.policy

    def _save_policy(self) -> None:
        self.learner.save_policy(self.out / POLICY, self.progress.record)

    # -- checkpoints --------------------------------------------------------------------------------------------------

    def _save(self, batches: Batches, batch: TensorDictBase, last: bool) -> None:
        """Write a checkpoint from which a run continues bit for bit; it may fail unless it is the ``last`` one."""
        with self._collecting(batches.collector):
            newest = batches.newest(batch)
            marks = bookmarks(batches.collector, newest)
        state = {
            "bsk_torch": __version__,
            **fixed(self.config),
            "learner": self.learner.state_dict(),
            "collected": marks,
            "begun": newest.state_dict() if self.config.ahead else None,
            "generator": torch.get_rng_state(),
            "recent": self.recent.state_dict(),
            "progress": (self.progress.frames, self.progress.seconds, self.progress.cpu_seconds, self.days, self.iteration),
            "best": self.best,
        }
        with self._unless_last(last, CHECKPOINT):
            save_checksummed(self.out / CHECKPOINT, state)

    @contextmanager
    def _unless_last(self, last: bool, name: str) -> Iterator[None]:
        """Continue without a file that will be rewritten later; the previous one remains."""
        try:
            yield
        except OSError as error:
            if last:
                raise
            logger.warning("no new %s after %d frames: %s; training continues", name, self.progress.frames, error)

    def _restore(self, saved: dict[str, Any]) -> None:
        """Resume from a checkpoint; ValueError, naming it, if it does not fit this environment and these networks."""
        try:
            self.learner.load_state_dict(saved["learner"])
            self.recent.load_state_dict(saved["recent"])
            frames, seconds, cpu, days, iteration = saved["progress"]
            self.progress.frames, self.iteration = (whole("progress", part, 0, 2**62) for part in (frames, iteration))
            times = (number("progress", part, 0.0) for part in (seconds, cpu, days))
            self.progress.before, self.progress.cpu_before, self.days = times
            self.marks, self.generator, self.best = saved["collected"], saved["generator"], self._checked_best(saved["best"])
            for generator in (self.generator, *(mark["generator"] for mark in self.marks)):
                torch.Generator().set_state(generator.cpu())
            if len(self.marks) != self.config.processes:
                raise ValueError(f"it was collected by {len(self.marks)} processes instead of {self.config.processes}")
            if self.config.ahead:
                self.begun = TensorDict().load_state_dict(saved["begun"], strict=False).refine_names(..., "time")
            rows = torch.arange(self.env.num_envs)  # one where processes collect, which restore their rows themselves
            for mark in self.marks:
                self.env.restore(mark["state"], rows, rows)
                for name in ("seen", "carried"):
                    TensorDict(mark[name], [self.config.num_envs // self.config.processes])
        except (AttributeError, IndexError, KeyError, RecursionError, RuntimeError, TypeError, ValueError) as error:
            reason = str(error).partition("\n")[0] if isinstance(error, ValueError | RuntimeError) else repr(error)
            raise ValueError(f"{str(self.out / CHECKPOINT)!r} does not fit this training: {reason}") from error

    def _checked_best(self, best: Mapping[str, Any]) -> dict[str, object]:
        """Return what is known of the best policy; ValueError for other weights than those of these networks."""
        networks = best["networks"]
        if networks is not None and not (_alike(networks, self._networks()) and _finite(networks)):
            raise ValueError("the best policy has other weights, or weights that are not finite")
        value = number("best return", best["return"], finite=False)
        return {"return": value, "waited": whole("best waited", best["waited"], 0), "networks": networks}


def _alike(state: Any, other: Any) -> bool:
    """Whether nested dictionaries have the same keys, and tensors of the same shapes and types."""
    if isinstance(other, dict):
        return isinstance(state, dict) and state.keys() == other.keys() and all(_alike(state[key], other[key]) for key in other)
    return isinstance(state, torch.Tensor) and (state.shape, state.dtype) == (other.shape, other.dtype)


def _finite(state: dict[str, Any] | Tensor) -> bool:
    return all(map(_finite, state.values())) if isinstance(state, dict) else bool(state.isfinite().all())


def resumption(out: Path) -> str:
    """Return how to resume the run in a folder."""
    return f"resume from the last checkpoint with: bsk-torch train {shlex.quote(str(out))} --resume"


def shut_down(collector: BaseCollector) -> None:
    """End a collector and its processes; that some are lost already is no separate error."""
    try:
        collector.shutdown()
    except Exception as error:
        logger.info("the collector did not end in order: %s", error)


def check_folder(out: Path) -> None:
    """Check that a run can begin in a folder, which need not exist.

    Raises:
        FileExistsError: If there is something in it, or ``out`` is no folder.
        FolderInUseError: If another process works in it.
        PermissionError: If it cannot be written to.
    """
    if not out.is_dir() and (out.exists() or out.is_symlink()):
        raise FileExistsError(f"{str(out)!r} is not a folder; name one for the results")
    if (out / LOCK).exists():
        FolderLock(out).release()
    check_empty(out)
    parent = next(folder for folder in (out, *out.absolute().parents) if folder.exists())
    if (why := unwritable(parent) if parent.is_dir() else f"{str(parent)!r} is not a folder") is not None:
        raise PermissionError(f"{str(out)!r} cannot be written: {why}")


def check_empty(out: Path) -> None:
    """Raise FileExistsError for a non-empty folder, except for files left by a process killed before it started."""
    if out.is_dir() and any(path.name != LOCK and not PART.fullmatch(path.name) for path in out.iterdir()):
        raise FileExistsError(f"{str(out)!r} is not empty; choose another folder, or resume the run in it")


def check_resumable(out: Path) -> None:
    """FileNotFoundError if there is no run in a folder."""
    if not any((out / name).is_file() for name in (CHECKPOINT, CONFIG)):
        raise FileNotFoundError(f"{str(out)!r} holds no {CHECKPOINT} to resume from")


def fixed(config: PPOConfig) -> dict[str, object]:
    """Return the settings :data:`FIXED` of a configuration; of the options those that files keep."""
    return {name: getattr(config, name, None) for name in FIXED} | {"options": _as_tuples(plain(config.options))}


def _as_tuples(value: Any) -> Any:
    """Return the value with tuples for its lists, which files have in the place of tuples."""
    if isinstance(value, Mapping):
        return {name: _as_tuples(part) for name, part in value.items()}
    return tuple(map(_as_tuples, value)) if isinstance(value, list | tuple) else value


def read_checkpoint(out: Path, config: PPOConfig) -> dict[str, Any] | None:
    """The checkpoint in a run's folder, None if there is none yet; see :class:`Training` for errors."""
    path = out / CHECKPOINT
    if not path.is_file():
        logger.warning("%s holds no %s; the run begins again", out, CHECKPOINT)
        return None
    saved = load_checksummed(path, "checkpoint")
    for name, value in {"bsk_torch": __version__, **fixed(config)}.items():
        try:
            differs = bool(saved.get(name) != value)
        except (RecursionError, RuntimeError):  # of tensors, or deep lists, in the place of settings
            differs = True
        if differs:
            stored = reprlib.repr(saved.get(name))
            raise ValueError(f"the checkpoint in {str(out)!r} has {name}={stored}, and cannot be resumed as {value!r}")
    return saved
