"""Proximal policy optimization (Schulman et al. 2017, arXiv:1707.06347) with a discount per second.

See :mod:`~bsk_torch.rl.durations` for the returns of decisions that last different times.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import partial
from itertools import chain
from pathlib import Path

import torch
from tensordict import TensorDictBase
from tensordict.nn import ProbabilisticTensorDictSequential, TensorDictModuleBase
from torch import Tensor, nn
from torchrl.modules import set_recurrent_mode

from bsk_torch.env import SatelliteTasking
from bsk_torch.rl.networks.normaliser import CLOCK
from bsk_torch.rl.networks.plans import INIT, MEMORY, NORMALISER, PLANS, Networks, Plan
from bsk_torch.rl.networks.precision import reduced
from bsk_torch.rl.policies.files import save_policy
from bsk_torch.rl.training.advantages import FINAL, final, make_value_norm, standardize, write_advantages
from bsk_torch.rl.training.collect import COLLECTED_CLOCK
from bsk_torch.rl.training.config import PPOConfig
from bsk_torch.rl.training.imitation import TAUGHT, find_teacher, imitation_loss, taught
from bsk_torch.rl.training.loss import Terms, clipped_loss, unjudged

REPORTED = ("entropy", "kl_approx", "clip_fraction", "explained_variance", "loss_critic")
"""Logged terms of the loss."""

LEARNED = ("acting", "critic", "optimiser", "value_norm")
"""Attributes of a learner that checkpoints keep."""

LEARNED_FROM = ("seen", "action_mask", "action", "action_log_prob")
"""Keys of a batch that gradient steps need; real numbers as actions have no mask."""

VALUED = ("advantage", "value_target")
"""Further keys, where values are learned."""


def existing_keys(keys: Iterable[str], batch: TensorDictBase) -> list[str]:
    """Return the keys without ``"action_mask"`` where a batch has none."""
    masked = "action_mask" in batch.keys()  # noqa: SIM118  - a tensordict
    return [key for key in keys if masked or key != "action_mask"]


def averages(reports: Sequence[Tensor]) -> dict[str, float]:
    """Return means over gradient steps of the terms of the loss, [R] each, by name."""
    return dict(zip(Terms._fields, torch.stack(list(reports)).mean(0).tolist(), strict=True))


class Learner:
    """Actor, critic and their optimizer.

    The critic sees the clock, unless values look beyond the time limit, where what it shows has never been seen.
    """

    def __init__(self, config: PPOConfig, env: SatelliteTasking) -> None:
        """Build new networks for an environment; ValueError if it does not fit them."""
        self.config = config
        self.computing = reduced(config.precision, env.device)
        self.plan = self.make_plan(env)
        self.networks: Networks = self.plan.build().to(env.device)
        self.entropy_coefficient = config.entropy
        self.value_norm = make_value_norm().to(env.device)
        self.teacher = self.make_teacher(env)
        self.imitates, self.judges = False, True
        self.recurrent = self.networks.unit is not None
        self._learn_by(self.networks.actor, self.networks.critic)

    def _learn_by(self, actor: ProbabilisticTensorDictSequential, critic: TensorDictModuleBase) -> None:
        self.acting, self.critic = actor, critic
        self.weights = [list(part.parameters()) for part in (actor, critic)]
        self.optimiser = torch.optim.Adam(chain(*self.weights), self.config.learning_rate, eps=1e-5, fused=True)

    def make_plan(self, env: SatelliteTasking) -> Plan:
        """Return how the networks for an environment are built; ValueError if it does not fit them."""
        return PLANS[self.config.network].of(env, self.config.hidden)

    def make_teacher(self, env: SatelliteTasking) -> TensorDictModuleBase | None:
        """Return the rule to imitate first; None for none. ValueError if it does not fit an environment."""
        config = self.config
        return find_teacher(config.imitate, env, config.imitation_temperature) if config.imitate else None

    @property
    def _length(self) -> int:
        """Decisions that stay together: the whole rollout of an environment for networks that remember."""
        return self.config.rollout if self.recurrent else 1

    @property
    def policy(self) -> TensorDictModuleBase:
        """The current policy; it continues to learn during training."""
        return self.networks.policy

    def policy_state(self) -> dict[str, object]:
        """Return the policy's weights; see :meth:`~bsk_torch.rl.networks.plans.Networks.policy_state`."""
        return self.networks.policy_state()

    def load_policy_state(self, state: Mapping[str, object]) -> None:
        """Restore what :meth:`policy_state` returned."""
        self.networks.load_policy_state(state)

    def save_policy(self, path: Path, training: Mapping[str, int | float]) -> None:
        """Write the file of the current policy, with what its ``training`` has cost."""
        save_policy(path, self.plan, self.networks, self.config.preset, self.config.options, training)

    def anneal(self, fraction: float) -> None:
        """Set learning rate, weight of the entropy and what is learned for a used ``fraction`` of the budget."""
        config = self.config
        self.imitates = self.teacher is not None and fraction < config.imitation
        self.judges = not self.imitates or config.imitation < 1.0  # else values are never needed
        self.optimiser.param_groups[0]["lr"], self.entropy_coefficient = config.annealed(fraction)

    def state_dict(self) -> dict[str, object]:
        """Networks, normalizers and optimizer."""
        return {name: getattr(self, name).state_dict() for name in LEARNED} | {NORMALISER: self.networks.normaliser.state_dict()}

    def _settings(self) -> list[dict[str, object]]:
        """Return the settings of the optimizer, but for the learning rate, which follows a schedule."""
        return [{k: v for k, v in group.items() if k not in ("lr", "params")} for group in self.optimiser.param_groups]

    def load_state_dict(self, state: Mapping[str, object]) -> None:
        """Restore what :meth:`state_dict` returned; RuntimeError, ValueError or KeyError if it does not fit."""
        groups = self._settings()
        for name in LEARNED:
            getattr(self, name).load_state_dict(state[name])
        if self._settings() != groups:
            raise ValueError(f"the optimizer has the settings {self._settings()!s:.200}, not {groups!s:.200}")
        for weight, moments in self.optimiser.state.items():  # the optimizer itself does not look at shapes
            for name, value in moments.items():
                if isinstance(value, Tensor) and value.ndim and value.shape != weight.shape:
                    raise ValueError(f"{name} has shape {tuple(value.shape)}, its weight {tuple(weight.shape)}")
        self.networks.normaliser.load_state_dict(state[NORMALISER])

    def clock(self, situations: TensorDictBase) -> Tensor:
        """Return the clock of ``situations``, [..., 2], as the critic sees it.

        Zeros where values look beyond the time limit, and for situations collected without the transform ``Clock``.
        """
        clock = situations.get(COLLECTED_CLOCK, None)
        if clock is None or self.config.beyond_limit:
            return torch.zeros(*situations.batch_size, 2, dtype=torch.float32, device=situations.device)
        return clock

    def learn(self, batch: TensorDictBase) -> dict[str, float]:
        """Several passes over a batch [N, T]; means of the terms of the loss."""
        self.networks.normaliser(batch)
        if self.judges:
            self._estimate(batch)
        if self.imitates:
            batch[TAUGHT] = taught(self.teacher, batch)
        keys = [*existing_keys(LEARNED_FROM, batch), *self._further_keys(), *((MEMORY, INIT) if self.recurrent else ())]
        rows = batch.select(*keys)
        with set_recurrent_mode(self.recurrent):
            reports = [self._descend(sample) for sample in self._samples(rows if self.recurrent else rows.reshape(-1))]
        self.networks.normaliser.update(batch)  # afterwards: networks learn from what they saw when they decided
        return averages(reports)

    def _estimate(self, batch: TensorDictBase) -> None:
        """Write advantages and value targets of a batch [N, T] with normalized observations."""
        config = self.config
        self.networks.normaliser(batch["next"])
        for situations in (batch, batch["next"]):
            situations[CLOCK] = self.clock(situations)
        batch["next", FINAL] = final(batch, config.beyond_limit)
        write_advantages(
            batch,
            self.critic,
            config.gamma,
            config.lmbda,
            config.reward_time,
            terminated=FINAL,
            value_norm=self.value_norm,
        )
        standardize(batch, self.value_norm)

    def _further_keys(self) -> list[str]:
        """Return the keys of a batch that gradient steps need in addition to :data:`LEARNED_FROM`."""
        return [*(VALUED if self.judges else ()), *([TAUGHT] if self.imitates else ())]

    def _samples(self, rows: TensorDictBase) -> Iterator[TensorDictBase]:
        """Yield the samples of all gradient steps: every pass visits each decision once, in random order."""
        size = max(min(self.config.minibatch, self.config.batch), self._length) // self._length
        count = len(rows) // size
        for _ in range(self.config.epochs):
            order = torch.randperm(len(rows))[: count * size].to(rows.device)
            shuffled = rows.apply(partial(torch.index_select, dim=0, index=order), batch_size=[len(order), *rows.shape[1:]])
            yield from shuffled.split(size)  # of one copy: rows of every key for each sample would take twice as long

    def counts(self, sample: TensorDictBase) -> Tensor | None:
        """Return which decisions of a sample count; None for all."""
        return None

    def _descend(self, sample: TensorDictBase) -> Tensor:
        """Take a gradient step; return the terms of the loss, [R]."""
        counts = self.counts(sample)
        with self.computing:
            if self.judges:
                terms = clipped_loss(self.acting, self.critic, sample, self.config.clip, counts)
                played = terms.objective - self.entropy_coefficient * terms.entropy
                loss = (imitation_loss(sample, counts) if self.imitates else played) + terms.loss_critic
            else:
                terms = unjudged(self.acting, sample, counts)
                loss = imitation_loss(sample, counts)
        self.optimiser.zero_grad()
        loss.backward()
        # clipped one by one, so that errors of values do not slow the actor
        for weights in self.weights:
            nn.utils.clip_grad_norm_(weights, self.config.gradient_norm)
        self.optimiser.step()
        return torch.stack([value.detach() for value in terms])
