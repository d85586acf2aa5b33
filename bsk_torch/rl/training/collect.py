"""Collection of experience: in this process, in several on this machine, or on a Ray cluster; and its resumption."""

from __future__ import annotations

import logging
import signal
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from multiprocessing import parent_process
from typing import Any, cast

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.collectors import BaseCollector, Collector, MultiSyncCollector
from torchrl.data import Categorical, Composite, Unbounded
from torchrl.envs import Compose, InitTracker, TensorDictPrimer, Transform, TransformedEnv
from torchrl.weight_update import SharedMemWeightSyncScheme, WeightSyncScheme

from bsk_torch.env.base import Tasking
from bsk_torch.presets import PRESETS
from bsk_torch.rand import Key
from bsk_torch.rl.networks.plans import CLOCKS, INIT, MEMORY
from bsk_torch.rl.training.advantages import CUT
from bsk_torch.rl.training.cluster import cluster_cores, share_of_core
from bsk_torch.rl.training.config import PPOConfig

logger = logging.getLogger(__name__)

SHORTEST = 0.02
"""Least fraction of an episode after which it is cut by :class:`Stagger`."""

ANSWER = 60.0
"""Time within which a process takes new weights, s; that needs milliseconds."""

ENDLESS = 2**62
"""More decisions than are ever collected: Ray's collector does not accept -1."""


HOUR = 3600.0
"""Unit of the time limit on the clock, s."""

COLLECTED_CLOCK = "clock"
"""Key of what :class:`Clock` writes; critics read it at :data:`~bsk_torch.rl.networks.normaliser.CLOCK`."""


class Clock(Transform):
    """Writes how much of each episode is left, for critics: satellites need not observe it.

    ``clock`` [N, 2] is the fraction of the time limit that is left, from 1 to 0, and the logarithm to base 10 of the limit in
    hours; 1 and 0 without a limit. Returns that end at the limit depend on the time left. A critic that does not see it
    attributes them to what changes along the episode, such as the level of the data buffer.
    """

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add ``clock``."""
        shape, device = observation_spec.shape, observation_spec.device
        return observation_spec.set(COLLECTED_CLOCK, Unbounded((*shape, CLOCKS), device=device, dtype=torch.float32))

    def _read(self, situations: TensorDictBase) -> TensorDictBase:
        env = _environment(self)
        limit = env.time_limit
        remaining = (1.0 - env.fleet.sim_time / limit).clamp(min=0.0)
        size = torch.where(limit.isinf(), 0.0, (limit / HOUR).log10())
        return situations.set(COLLECTED_CLOCK, torch.stack([remaining, size], -1).float())

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        return self._read(next_tensordict)

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        return self._read(tensordict_reset)


class Stagger(Transform):
    """Truncates the first episode of every environment at a random time, so that batches mix early and late decisions.

    Without it all episodes of a batch start together, and a batch has nothing but early decisions, or late ones. The key ``cut``
    [N, 1] marks its own ends.
    """

    def __init__(self, env: Tasking) -> None:
        """Draw when to cut the first episodes of ``env``; never where they have no time limit."""
        super().__init__()
        key = Key(env.state.seed.cpu(), env.env_ids.cpu(), torch.zeros_like(env.env_ids, device="cpu"))
        drawn = key.named("stagger").uniform(1).squeeze(-1)
        self.fraction = (SHORTEST + (1.0 - SHORTEST) * drawn).to(env.device)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add ``cut``."""
        shape, device = observation_spec.shape, observation_spec.device
        return observation_spec.set(CUT, Categorical(2, shape=(*shape, 1), device=device, dtype=torch.bool))

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        env = _environment(self)
        late = (env.episode == 0) & (env.fleet.sim_time >= self.fraction * env.time_limit)
        cut = late.unsqueeze(-1) & ~next_tensordict["done"]
        for key in ("truncated", "done"):
            next_tensordict[key] = next_tensordict[key] | cut
        return next_tensordict.set(CUT, cut)

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        return tensordict_reset.set(CUT, torch.zeros_like(tensordict_reset["done"]))


def _environment(transform: Transform) -> Tasking:
    return cast("Tasking", cast(TransformedEnv, transform.parent).base_env)


class Bookmark(Transform):
    """Keeps in the collector's ``state_dict`` what collecting depends on, and starts from it instead of with new episodes."""

    def __init__(self, saved: Mapping[str, Any] | None) -> None:
        """Continue from ``saved``, which :func:`bookmarks` returned; None starts from the beginning."""
        super().__init__()
        self.saved = saved
        self._last: TensorDictBase = TensorDict()
        self._begun: tuple[TensorDictBase, Tensor] | None = None

    def get_extra_state(self) -> dict[str, Any]:
        """State of the environment and of the generator that draws actions, and what the next decision is made on.

        That is not observed again: an eclipse that was out of sight of the first query may be known to the second.
        """
        state, generator = _environment(self).get_state().to_dict(), torch.get_rng_state()
        return {"state": state, "generator": generator, "seen": self._situation().to_dict()}

    def _situation(self) -> TensorDictBase:
        """What the last step left, and the beginnings of episodes after it."""
        if self._begun is None:
            return self._last
        begun, rows = self._begun

        def newest(new: Tensor, old: Tensor) -> Tensor:
            return torch.where(rows.view(-1, *[1] * (new.ndim - 1)), new, old)

        return begun.apply(newest, self._last.select(*begun.keys(True, True)))

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        self._last, self._begun = next_tensordict.copy(), None
        return next_tensordict

    def set_extra_state(self, state: object) -> None:
        """Nothing: see the constructor."""

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        if self.saved is None:
            rows = tensordict.get("_reset", None)
            if rows is None:
                self._last, self._begun = tensordict_reset.copy(), None
            else:
                self._begun = tensordict_reset.copy(), rows.reshape(-1)
            return tensordict_reset
        saved, self.saved = self.saved, None
        env = _environment(self)
        env.restore(saved["state"])
        torch.set_rng_state(saved["generator"].cpu())
        situation = TensorDict(saved["seen"], env.batch_size).select(*tensordict_reset.keys(True, True), strict=False)
        self._last, self._begun = tensordict_reset.update(situation).copy(), None
        return tensordict_reset.update(saved["carried"])


def prepared(env: Tasking, config: PPOConfig, saved: Mapping[str, object] | None) -> TransformedEnv:
    """An environment for a collector, which can resume it; recurrent policies start episodes with an empty memory."""
    transforms: list[Transform] = [Clock(), *([Stagger(env)] if config.stagger else [])]
    if config.network == "gru":
        memory = Unbounded((1, config.hidden[-1]), dtype=torch.float32, device=env.device)
        transforms += [InitTracker(), TensorDictPrimer({MEMORY: memory}, default_value=0.0, expand_specs=True)]
    return TransformedEnv(env, Compose(*transforms, Bookmark(saved)))  # type: ignore[call-overload]


def start_worker(
    config: PPOConfig, first: int, count: int, saved: Mapping[str, object] | None, preset: Callable[..., object]
) -> TransformedEnv:
    """In its own process: ``count`` episodes from number ``first`` on, and random numbers for their actions.

    ``preset`` makes the environment of the configuration, which this process may not have among its presets.
    """
    if parent_process() is not None:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the learner, which ends its workers
    torch.set_num_threads(1)
    torch.manual_seed(config.seed + first)
    PRESETS[config.preset] = preset
    return prepared(config.make_env(first, count), config, saved)


class SharedWeights(SharedMemWeightSyncScheme):
    """TorchRL's way to send weights to processes, which would wait forever for a lost one."""

    def _wait_for_ack(self, worker_ids: Any = None, timeout: float | None = None) -> None:
        begin = time.monotonic()
        super()._wait_for_ack(worker_ids, ANSWER)
        if time.monotonic() - begin >= ANSWER:
            raise RuntimeError(f"a process has not taken new weights within {ANSWER:g} s")


def update_weights(collector: Any) -> None:
    """Let all processes act by the current policy; RuntimeError if one of them is lost."""
    for k, process in enumerate(getattr(collector, "procs", ())):
        if not process.is_alive():
            raise RuntimeError(f"process {k} has ended with exit code {process.exitcode}")
    collector.update_policy_weights_()


def make_collector(
    config: PPOConfig, env: Tasking, actor: TensorDictModuleBase, saved: Sequence[Mapping[str, object]] | None
) -> BaseCollector:
    """Return a collector that yields batches by ``actor`` without end; see :func:`merged`.

    Args:
        config: Settings of where to collect, and how much at once; for Ray, call this inside of
            :func:`~bsk_torch.rl.training.cluster.connected`.
        env: The environment to play in if that is this process; others make their own shares of it.
        actor: Writes actions and their log-probabilities.
        saved: Result of :func:`bookmarks` to resume from; None to start.
    """
    common: dict[str, Any] = dict(frames_per_batch=config.batch, total_frames=ENDLESS - ENDLESS % config.batch)
    each: dict[str, Any] = dict(auto_register_policy_transforms=False, use_buffers=False)
    count = config.processes
    marks: Sequence[Mapping[str, Any] | None] = [None] * count if saved is None else saved
    if config.collector == "single":
        return Collector(prepared(env, config, marks[0]), actor, track_traj_ids=False, **common, **each)
    share = config.num_envs // count
    starts: list[Callable[[], TransformedEnv]] = [
        partial(start_worker, config, k * share, share, m, PRESETS[config.preset]) for k, m in enumerate(marks)
    ]
    if config.collector == "multi":
        weights: dict[str, WeightSyncScheme] = {"policy": SharedWeights()}
        return MultiSyncCollector(starts, actor, cat_results="stack", weight_sync_schemes=weights, **common, **each)
    from torchrl.collectors.distributed import RayCollector
    from torchrl.collectors.distributed.ray import DEFAULT_REMOTE_CLASS_CONFIG

    cores = cluster_cores()
    if count > sum(cores):
        logger.warning("workers=%d is more than the cores of the Ray cluster, %d, which they share", count, sum(cores))
    remote = {name: value for name, value in DEFAULT_REMOTE_CLASS_CONFIG.items() if name != "memory"}
    remote["num_cpus"] = share_of_core(count, cores)
    return RayCollector(starts, actor, sync=True, num_collectors=count, collector_kwargs=each, remote_configs=remote, **common)


class Batches:
    """The batches of a collector, the next of which may be collected while one is learned from.

    With ``config.ahead`` the weights are sent and the next batch begins when one is taken. Its decisions are therefore by the
    policy before the update that learns from the batch taken, exactly one update old in every iteration. Nothing depends on
    how fast either side is.
    """

    def __init__(
        self, collector: BaseCollector, ahead: bool, renew: Callable[[], object], begun: TensorDictBase | None = None
    ) -> None:
        """Prepare the first batch.

        Args:
            collector: Collects.
            ahead: Whether it collects while a batch is learned from. Its policy must then be a copy: other processes share the
                memory of the weights, and would act by every gradient step.
            renew: Copies the present weights into that policy.
            begun: What :meth:`newest` returned, to resume from it.
        """
        self.collector, self.ahead, self.renew, self._iterator = collector, ahead, renew, iter(collector)
        self._thread = ThreadPoolExecutor(1, "collect")
        self._next: Future[TensorDictBase] = Future()
        if begun is not None:
            self._next.set_result(begun)
        elif self.ahead:
            self._next = self._thread.submit(self._collect)

    def _collect(self) -> TensorDictBase:
        return merged(next(self._iterator))

    def take(self) -> TensorDictBase:
        """Return a batch [N, T], and begin the next with the present weights if batches are collected ahead."""
        if not self.ahead:
            update_weights(self.collector)
            return self._collect()
        batch = self._next.result()
        self.renew()
        update_weights(self.collector)
        self._next = self._thread.submit(self._collect)
        return batch

    def newest(self, batch: TensorDictBase) -> TensorDictBase:
        """Return the batch that was collected last, when it is complete: the one after ``batch``, or that itself."""
        return self._next.result() if self.ahead else batch

    def close(self) -> None:
        """Wait for a batch that is being collected; it is dropped."""
        self._thread.shutdown()


def merged(batch: TensorDictBase) -> TensorDictBase:
    """A batch [N, T] of one by several processes, [processes, N / processes, T]."""
    return batch.flatten(0, 1) if batch.ndim > 2 else batch


def bookmarks(collector: BaseCollector, batch: TensorDictBase) -> list[dict[str, Any]]:
    """Return the state from which a collector continues after its last ``batch`` [N, T], for each of its processes."""
    state = collector.state_dict()
    parts = state if isinstance(state, list) else [part for name, part in state.items() if name.startswith("worker")] or [state]
    marks = [next(v for k, v in part["env_state_dict"].items() if k.endswith("_extra_state")) for part in parts]
    carried = _carried(batch[:, -1]["next"]).chunk(len(marks))
    return [dict(mark) | {"carried": some.to_dict()} for mark, some in zip(marks, carried, strict=True)]


def _carried(last: TensorDictBase) -> TensorDictBase:
    """Return the hidden state [N] that a recurrent policy carries into its next decision; nothing for other policies."""
    if MEMORY not in last.keys():  # noqa: SIM118  - a tensordict
        return last.select()
    ended = last["done"]
    return TensorDict({MEMORY: last[MEMORY].masked_fill(ended.unsqueeze(-1), 0.0), INIT: ended.clone()}, last.batch_size)
