"""Simulation of branches, copies of episodes in another environment of the same kind; the model of all planners."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from bsk_torch.env import Tasking
from bsk_torch.env.rollout import decide
from bsk_torch.lab.planners.agent_table import AgentTable
from bsk_torch.lab.planners.resampling import present_key
from bsk_torch.rl.networks.plans import MEMORY
from bsk_torch.rl.rules.baselines import LOT

Value = Callable[[TensorDictBase], TensorDictBase]
"""Module that writes ``state_value`` [n, 1], the discounted future return, into tensordicts [n] with observations."""


Watch = Callable[[TensorDictBase], TensorDictBase]
"""Function from observations [M] to the values to record, [M]."""

Price = Callable[[Tasking, TensorDictBase], Tensor]
"""Function of an environment and its observations [M] to the worth of the states at which branches are cut, [M]."""

STEPS = 2
"""Number of decisions that are compared to check that episodes can be copied."""


@dataclass(frozen=True)
class Discounting:
    """Returns of semi-Markov decision processes; see :mod:`bsk_torch.rl.durations`.

    Attributes:
        gamma: Discount per second.
        at_end: Whether the reward of a step counts at its end; otherwise at its start.
    """

    gamma: float = 1.0
    at_end: bool = True

    def after(self, seconds: Tensor) -> Tensor:
        """Return gamma^t after t seconds, float64."""
        return torch.full_like(seconds, self.gamma) ** seconds

    def before(self, reward: Tensor, seconds: Tensor, rest: Tensor) -> Tensor:
        """Return G = gamma^t (r + G'), or r + gamma^t G', for a step of t seconds with reward r, followed by a return G'."""
        factor = self.after(seconds)
        return factor * (reward + rest) if self.at_end else reward + factor * rest


class Jobs(NamedTuple):
    """J branches to simulate.

    Attributes:
        rows: Rows of the environment with the initial states, [J].
        env_ids: Indices of the episodes in draws, [J].
        slot: Agent whose actions are given, [J]; see :data:`bsk_torch.lab.planners.agent_table.NO_AGENT`.
        plan: First D actions of the agent, discrete [J, D] or continuous [J, D, W]. The base policy decides after them, and
            instead of actions that are illegal at their time, negative, or NaN.
        first: Actions of all agents in the first step, [J]; None for those of the base policy.
        limit: Ticks since reset at which branches are cut, [J]; None for the ends of episodes.
        carried: Memory of the base policy, [J]; None for none.
        judged: Time after which the value network evaluates the state, s, [J]; 0 for the end of the first step. None to count
            all rewards up to the limit.
        decided: Branches that take the actions ``first``, [J] (default: all).
    """

    rows: Tensor
    env_ids: Tensor
    slot: Tensor
    plan: Tensor
    first: TensorDictBase | None = None
    limit: Tensor | None = None
    carried: TensorDictBase | None = None
    judged: Tensor | None = None
    decided: Tensor | None = None


class Flown(NamedTuple):
    """Results of J branches.

    Attributes:
        reward: Reward of the first step, [J].
        seconds: Duration of the first step, [J] s.
        done: Whether the episode or the look-ahead ended with the first step, [J].
        rest: Return after the first step, discounted to its end, [J].
        simulated: Simulated time, [J] s.
        summary: Result of ``watch`` after the first step, [J]; None without it.
        acted: For continuous actions, the first D actions of the agent, [J, D, W].
        executed: For continuous actions, the number of those that were executed, [J].
    """

    reward: Tensor
    seconds: Tensor
    done: Tensor
    rest: Tensor
    simulated: Tensor
    summary: TensorDictBase | None
    acted: Tensor | None
    executed: Tensor | None

    @classmethod
    def joined(cls, parts: Sequence[Flown]) -> Flown:
        """Return the branches of all parts, in order."""
        columns = (None if column[0] is None else torch.cat(column) for column in zip(*parts, strict=True))
        return cls(*columns)  # type: ignore[arg-type]

    def take(self, first: int, end: int) -> Flown:
        """Return the branches from ``first`` on, before ``end``."""
        columns = (None if column is None else column[first:end] for column in self)
        return Flown(*columns)  # type: ignore[arg-type]


class Branches:
    """Simulates copies of episodes: one or several given actions, then the base policy to the end of the look-ahead.

    Attributes:
        model: The environment of the copies, with M rows.
        discounting: Discounting of rewards.
    """

    def __init__(
        self,
        env: Tasking,
        slots: AgentTable,
        base: TensorDictModuleBase,
        rows: int,
        discounting: Discounting,
        value: Value | None,
        price: Price | None = None,
    ) -> None:
        """Create the rows; ``value`` evaluates the last states of branches cut after some time, ``price`` of others."""
        self.slots, self.base, self.discounting, self.value, self.price = slots, base, discounting, value, price
        self.model = env.like(rows)
        self.all_rows = torch.arange(rows, device=env.device)

    def fly(
        self,
        source: Tasking,
        jobs: Jobs,
        keep: tuple[Tasking, Tensor] | None = None,
        watch: Watch | None = None,
    ) -> Flown:
        """Simulate branches, M at a time; results are independent of each other.

        Args:
            source: Environment with their initial states.
            jobs: The branches.
            keep: Environment, and its rows [J], for the states after the first step.
            watch: Function of the observations after the first step, [M].
        """
        parts = [
            self._fly(source, jobs, index, keep, watch)
            for index in torch.arange(len(jobs.rows), device=self.all_rows.device).split(len(self.all_rows))
        ]
        return Flown.joined(parts)

    def _fly(self, source: Tasking, jobs: Jobs, index: Tensor, keep: tuple[Tasking, Tensor] | None, watch: Watch | None) -> Flown:
        model, slots, m = self.model, self.slots, len(index)
        job = torch.nn.functional.pad(index, (0, len(self.all_rows) - m), value=int(index[0]))  # spare rows repeat a job
        flying = self.all_rows < m
        model.restore(source, self.all_rows, jobs.rows[job])
        if jobs.limit is not None:
            model.state.limit_ticks = torch.minimum(model.state.limit_ticks, jobs.limit[job])
        slot, plan, env_ids = jobs.slot[job], jobs.plan[job], jobs.env_ids[job]
        real, length = plan.ndim == 3, plan.shape[1]
        count = torch.zeros_like(job)
        acted = torch.zeros_like(plan)
        now: TensorDictBase = model.observe()
        if jobs.carried is not None:
            now.update(jobs.carried[job])
        elapsed, total = torch.zeros_like(model.fleet.sim_time), torch.zeros_like(model.returns)
        edge: list[Tensor] = []
        summary = None
        while True:
            self._draw_lots(now, env_ids)
            now = decide(self.base, now)
            if not edge and jobs.first is not None:
                self._take(now, jobs.first[job], None if jobs.decided is None else jobs.decided[job])
            planned = (count < length) & (flying if not edge else flying & self._decides(now, slot))
            at = count.clamp(max=length - 1)
            action = plan[self.all_rows, at]
            slots.put(now, slot, action, planned & (~torch.isnan(action).any(1) if real else self._allowed(now, slot, action)))
            if real:
                numbers = slots.at(slots.numbers(now), slot)
                place = (at.unsqueeze(1) == torch.arange(length, device=at.device)) & planned.unsqueeze(1)
                acted = torch.where(place.unsqueeze(-1), numbers.to(acted.dtype).unsqueeze(1), acted)
            count = count + planned.long()
            now, reward, lasted = self._step(now, flying)
            if edge:
                gain = self.discounting.before(reward, lasted, torch.zeros_like(reward))
                total = total + self.discounting.after(elapsed) * gain
                elapsed = elapsed + lasted
            done = now["done"].squeeze(-1)
            if not edge:
                edge = [reward, lasted, done]
                if keep is not None:
                    keep[0].restore(model, keep[1][index], self.all_rows[:m])
                if watch is not None:
                    self._draw_lots(now, env_ids)
                    summary = watch(now)[:m]
            if self.price is not None and bool((cut := flying & done & self._cut()).any()):
                worth = self.price(model, now).to(total.dtype)
                total = torch.where(cut, total + self.discounting.after(elapsed) * worth, total)
            flying = flying & ~done
            if jobs.judged is not None:
                late = flying & (edge[1] + elapsed >= jobs.judged[job])
                if bool(late.any()):
                    worth = self._judge(now).to(total.dtype)
                    total = torch.where(late, total + self.discounting.after(elapsed) * worth, total)
                    flying = flying & ~late
            if not bool(flying.any()):
                break
        reward, lasted, done = (part[:m] for part in edge)
        taken = (acted[:m], count[:m].clone()) if real else (None, None)
        return Flown(reward, lasted, done, total[:m], lasted + elapsed[:m], summary, *taken)

    def _draw_lots(self, now: TensorDictBase, env_ids: Tensor) -> None:
        """Draw the random numbers of the base policy, determined by episode and time."""
        if LOT in self.base.in_keys:
            key = present_key(self.model, self.all_rows, env_ids, "lot of a branch")
            now[LOT] = key.uniform(1).squeeze(1).to(self.model.device)

    @staticmethod
    def _take(now: TensorDictBase, first: TensorDictBase, where: Tensor | None) -> None:
        for key in first.keys(True, True):
            action = first[key]
            if where is not None:
                action = torch.where(where.view(-1, *[1] * (action.ndim - 1)), action, now[key])
            now.set(key, action)

    def _decides(self, now: TensorDictBase, slot: Tensor) -> Tensor:
        return self.slots.at(self.slots.deciding(now), slot) & (slot >= 0)

    def _allowed(self, now: TensorDictBase, slot: Tensor, action: Tensor) -> Tensor:
        legal = self.slots.at(self.slots.legal(now), slot)
        return legal.gather(1, action.clamp(min=0).unsqueeze(1)).squeeze(1) & (action >= 0)

    def _step(self, now: TensorDictBase, flying: Tensor) -> tuple[TensorDictBase, Tensor, Tensor]:
        """Step the rows ``flying`` [M]; return the next tensordict, rewards summed over satellites, and durations."""
        model = self.model
        returns, ticks = model.returns, model.fleet.ticks
        following = self.slots.play(model, now, flying)
        if "next" in now.keys():  # noqa: SIM118  - a tensordict; what the policy remembers
            following.update(now["next"])
        return following, model.returns - returns, (model.fleet.ticks - ticks).double() * model.fleet.h

    def _cut(self) -> Tensor:
        """Return where the limit of a branch has been reached, before the episode's own limit and alive, [M]."""
        model, state = self.model, self.model.state
        earlier = (state.limit_ticks + 1).double() * model.fleet.h <= state.time_limit
        return earlier & (model.fleet.ticks >= state.limit_ticks) & ~model.dead.view(len(earlier), -1).all(1)

    def _judge(self, now: TensorDictBase) -> Tensor:
        assert self.value is not None
        with torch.no_grad():
            return self.value(now.clone(recurse=False))["state_value"].squeeze(-1)


def carried(td: TensorDictBase, base: TensorDictModuleBase, env: Tasking) -> TensorDictBase:
    """Return the memory of the base policy, [N]: inputs that are neither observed nor drawn."""
    observed = set(env.observation_spec.keys(True, True)) | {LOT}
    observed |= {key[:n] for key in observed if isinstance(key, tuple) for n in range(1, len(key))}  # also what nests them
    present = set(td.keys(True, True))
    keys = [key for key in base.in_keys if key in present and key not in observed and (key,) not in observed]
    memory = [key for key in (MEMORY,) if key in present]
    return TensorDict({key: td[key] for key in dict.fromkeys([*keys, *memory])}, td.batch_size, device=td.device)


def check_copyable(env: Tasking, slots: AgentTable) -> None:
    """Check that equal seeds start equal episodes, and that equal states have equal futures.

    In a separate environment, two rows start the same episode twice and execute the same decisions twice.

    Raises:
        TypeError: For an object that is not an environment of this package.
        ValueError: If anything differs; the message names it. The cause is a user function that draws random numbers without a
            seed, or keeps values outside the state.
    """
    twins = env.like(2, env_ids=[0, 0])
    starts = []
    for _ in range(2):
        twins.set_seed(0)
        twins.reset()
        starts.append(twins.get_state())
    _compare(starts, "two episodes of the same seed begin with different")
    ends = []
    for _ in range(2):
        twins.restore(starts[0])
        now: TensorDictBase = twins.observe()
        for _ in range(STEPS):
            slots.neutral(now)
            now = slots.play(twins, now, ~now["done"].squeeze(-1))
        ends.append(now)
    _compare(ends, "copies of one state are followed by different")


def _compare(states: list[TensorDictBase], words: str) -> None:
    """ValueError unless both tensordicts [2] are equal, and their rows, too, but for how far orbits have been solved ahead."""
    first, second = (dict(part.items(True, True)) for part in states)
    for key, value in first.items():
        if "lookahead" in key:
            continue
        if not (_same(value[0], value[1]) and _same(value, second[key])):
            name = key if isinstance(key, str) else ".".join(key)
            raise ValueError(
                f"the environment cannot be copied: {words} {name!r}. Planning needs functions that repeat their results for an "
                "episode: draw random numbers from a key of bsk_torch.rand or, at reset, from the seeded global generators of "
                "NumPy or Python, and declare values kept within an episode (fleet.memory.declare)"
            )


def _same(one: Tensor, other: Tensor) -> bool:
    return torch.equal(torch.nan_to_num(one), torch.nan_to_num(other)) if one.is_floating_point() else torch.equal(one, other)
