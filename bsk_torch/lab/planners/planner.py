"""Base class of planners, policies that improve the decisions of a base policy, agent by agent."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import ClassVar

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from typing_extensions import TypedDict

from bsk_torch._checks import number, whole
from bsk_torch.env import Tasking
from bsk_torch.env.rollout import ACTION_VALUE, decide
from bsk_torch.lab.planners.agent_table import AgentTable
from bsk_torch.lab.planners.base_policies import Base, base_of
from bsk_torch.lab.planners.branches import Branches, Discounting, Flown, Jobs, Price, Value, carried, check_copyable
from bsk_torch.lab.planners.resampling import present_key, reseed_copies
from bsk_torch.rl.evaluation.evaluate import SIMULATED
from bsk_torch.rl.policies.readers import reader
from bsk_torch.rl.training.config import REWARD_TIMES
from bsk_torch.sim.names import one_of

ROWS = 512
"""Default number of copies simulated at once."""

ENDLESS = 2**62
"""Tick beyond the end of all branches."""


class PlanCache:
    """Planned actions after the last decision of each of N episodes, a lower bound for the next decision.

    Without it, a planner over several actions may take the first action of a sequence and then not find the second one again, so
    its returns could be worse than those of its base policy. Source: fortified rollout, D. P. Bertsekas, J. N. Tsitsiklis, C. Wu,
    J. Heuristics 3, 1997.

    Attributes:
        plan: Discrete actions [N, D], padded with -1, or continuous actions [N, D, W], padded with NaN.
        slot: Agent, [N].
        stamp: Seed, episode and tick of the decision, [N, 3].
    """

    def __init__(self, num_envs: int, blank: Tensor) -> None:
        """Start without plans; ``blank`` is an empty plan, [D] or [D, W]."""
        self.blank = blank
        self.plan = blank.expand(num_envs, *blank.shape).clone()
        self.slot = torch.full((num_envs,), -1, device=blank.device)
        self.stamp = torch.full((num_envs, 3), -1, device=blank.device)

    def keep(self, env: Tasking, rows: Tensor, slot: Tensor, plan: Tensor) -> None:
        """Keep the actions after the first one of ``plan`` [n, D, ...] for the episodes ``rows`` [n]."""
        remainder = torch.cat([plan[:, 1:], self.blank[:1].expand(len(rows), 1, *self.blank.shape[1:])], 1)
        self.plan[rows], self.slot[rows], self.stamp[rows] = remainder.to(self.plan.dtype), slot, self._now(env, rows)

    def look_up(self, env: Tasking, rows: Tensor, slot: Tensor) -> tuple[Tensor, Tensor]:
        """Return plans [n, D, ...] of agents ``slot`` [n] from earlier in the same episode, and whether they exist, [n]."""
        stamp, now, plan = self.stamp[rows], self._now(env, rows), self.plan[rows]
        current = (stamp[:, :2] == now[:, :2]).all(1) & (stamp[:, 2] < now[:, 2]) & (self.slot[rows] == slot)
        first = plan[:, 0]
        exists = ~torch.isnan(first).any(1) if first.ndim == 2 else first >= 0
        return plan, current & exists

    @staticmethod
    def _now(env: Tasking, rows: Tensor) -> Tensor:
        return torch.stack([env.state.seed[rows], env.state.episode[rows], env.fleet.ticks[rows]], 1)


class PlannerOptions(TypedDict, total=False):
    """Further arguments of all planners; see :class:`Planner`."""

    reward_time: str
    value: Value | None
    futures: int | None
    price: Callable[[Tasking], Tensor] | Mapping[str, float] | None
    seed: int
    rows: int


class DiscountOptions(PlannerOptions, total=False):
    """The same, and the discount, where its default is that of :class:`Planner`."""

    gamma: float


class Planner(TensorDictModuleBase):
    """Improves the decisions of a base policy by simulating copies of the current episodes. Subclasses select the branches.

    A planner belongs to one environment, whose current episodes it copies. It writes the actions of all agents into the
    tensordict returned by ``reset`` or ``step`` of this environment, and ``simulated_seconds`` [N], the simulated time of flight
    for the decision. Planners of discrete actions also write ``action_value`` [N, S, A]: the return up to the horizon that they
    have found for each action of the S agents, NaN where they have tried none. The environment itself is left unchanged, and
    decisions do not depend on other rows.

    In a constellation, agents deciding at the same time are improved one after the other, in the order of the groups. In the
    branches of an agent, the agents before it take the actions already decided, and all others follow the base policy (Bertsekas,
    "Multiagent rollout algorithms and reinforcement learning", 2019). Rewards are summed over all satellites.

    By default, copies have the draws of the true episode, including future ones: if observations are noisy, faults are to come,
    or part of the state is hidden, such as clouds, the planner has perfect information. In fully observed presets (most of them),
    this makes no difference. With ``futures``, each decision is planned in several resampled futures and averaged over them:
    copies get separate seeds, which determine the noise, faults that have not happened yet are drawn again, and so are hidden
    values of the scenario, by :meth:`bsk_torch.scene.Scenario.redraw`. Faults that act are known to the planner, even if they are
    not observed.
    """

    name: ClassVar[str]
    """Name on the command line, after ``plan:``."""

    real: ClassVar[bool] = False
    """Whether the planner is for continuous actions."""

    in_keys: list[str | tuple[str, ...]]
    out_keys: list[str | tuple[str, ...]]
    _worth: Tensor

    def __init__(
        self,
        env: Tasking,
        base: Base = None,
        *,
        horizon: float,
        gamma: float = 0.997,
        reward_time: str = "end",
        value: Value | None = None,
        price: Callable[[Tasking], Tensor] | Mapping[str, float] | None = None,
        futures: int | None = None,
        seed: int = 0,
        rows: int = ROWS,
    ) -> None:
        """Check arguments, and that the environment can be copied; nothing is planned yet.

        Args:
            env: The environment in which the planner acts.
            base: The base policy; see :func:`bsk_torch.lab.planners.base_of`.
            horizon: Length of branches from the decision, s; infinity for the rest of the episode. Branches are cut there, even
                during a task, so all branches are compared over the same time.
            gamma: Discount per second; 1 for sums of rewards.
            reward_time: When the reward of a step counts: at its ``"end"`` or its ``"start"``.
            value: A module that writes ``state_value`` [n, 1] for observations [n], used instead of rewards beyond the horizon;
                branches then end with the first step that reaches it.
            price: Worth of the state in which a branch is cut at the horizon, in rewards, added there to its return: a function
                of an environment with the copies that returns [N]; or for one satellite the worth per unit of observed quantities
                by name, see :func:`bsk_torch.reader`, such as ``{"battery_charge_fraction": 0.2}``. Without it, the state at
                the horizon has no worth. States of dead satellites and at the end of the episode have none.
            futures: Number of futures drawn for each decision; None for the true one.
            seed: Seed of futures and samples.
            rows: Number of copies simulated at once, which affects memory and speed but not results.

        Raises:
            TypeError: If ``env`` is not an environment, or ``base`` is not a policy.
            ValueError: For other invalid arguments, an environment that cannot be copied, or unsuitable actions.
        """
        super().__init__()
        self.horizon = number("horizon", horizon, 0.0, unit="s", above=True, finite=False)
        gamma = number("gamma", gamma, 0.0, 1.0, above=True)
        one_of("reward_time", reward_time, REWARD_TIMES)
        if value is not None and not callable(value):
            raise ValueError(f"value={value!r} must be a module that writes 'state_value', or None")
        self.futures = None if futures is None else whole("futures", futures, 1)
        self.seed = whole("seed", seed, 0)
        self._most_rows = whole("rows", rows, 1)
        if not isinstance(env, Tasking):
            raise TypeError(f"env={env!r} must be an environment of bsk_torch; of a transformed one give base_env")
        slots = AgentTable(env)
        self._check_actions(slots)
        if value is not None and slots.size > 1:
            raise ValueError(f"value= judges observations of one satellite; the environment has {slots.size}")
        self._price = None if price is None else _as_price(price, env, slots, self.horizon, value)
        policy = base_of(base, env)
        check_copyable(env, slots)
        self._outside = (env, slots)  # not a submodule: an environment is not part of its policy
        self.base, self._value = policy, value
        self._discounting = Discounting(gamma, reward_time == "end")
        self._branches: Branches | None = None
        self._stores: list[Tasking] = []  # one at most; in a list as it is not a submodule either
        self._plans: PlanCache | None = None
        kinds = zip(slots.real, slots.n_actions, strict=True)
        self._plannable = slots.of([real if self.real else n > 1 for real, n in kinds], env.device)
        self.in_keys = list(policy.in_keys)
        self.out_keys = list(dict.fromkeys([*policy.out_keys, SIMULATED, *([] if self.real else [ACTION_VALUE])]))

    def _check_actions(self, slots: AgentTable) -> None:
        titles = ", ".join(dict.fromkeys(slots.acting))
        if any(real and n for real, n in zip(slots.real, slots.n_actions, strict=True)):
            raise ValueError(
                f"planner {self.name!r}: the actions of {titles} have real numbers and a choice, which is not planned"
            )
        if self.real and not any(slots.real):
            raise ValueError(f"planner {self.name!r} plans real numbers; {titles} chooses numbered actions: use 'rollout'")
        if not self.real and not any(n > 1 for n in slots.n_actions):
            raise ValueError(f"planner {self.name!r} tries numbered actions; those of {titles} are real numbers: use 'cem'")

    # -- deciding -----------------------------------------------------------------------------------------------------

    @property
    def env(self) -> Tasking:
        """The environment in which the planner acts."""
        return self._outside[0]

    @property
    def slots(self) -> AgentTable:
        """The agents of the environment."""
        return self._outside[1]

    @property
    def branches(self) -> Branches:
        """Copies of episodes, created at the first decision, and again after changes of the environment's arguments."""
        if self._branches is None or not torch.equal(self._branches.model.fingerprint, self.env.fingerprint):
            rows = min(self._most_rows, self.env.num_envs * (self.futures or 1) * self._branching())
            self._branches = Branches(self.env, self.slots, self.base, rows, self._discounting, self._value, self._price)
        return self._branches

    def _store(self, least: int) -> Tasking:
        for store in self._stores:
            if store.num_envs >= least and torch.equal(store.fingerprint, self.env.fingerprint):
                return store
        self._stores = [self.env.like(least)]
        return self._stores[0]

    def _cached_plans(self, blank: Tensor) -> PlanCache:
        """Return the remainders of earlier plans; ``blank`` is an empty plan, [D] or [D, W]."""
        if self._plans is None:
            self._plans = PlanCache(self.env.num_envs, blank)
        return self._plans

    def _branching(self) -> int:
        """Return the largest number of branches of one episode simulated together."""
        raise NotImplementedError(f"{type(self).__name__} must implement _branching()")

    @torch.no_grad()
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the actions, ``simulated_seconds`` and, if they are discrete, ``action_value``.

        Raises:
            ValueError: For a tensordict of another batch size than the planner's environment.
        """
        env, slots = self.env, self.slots
        if tensordict.batch_size != env.batch_size:
            size = list(tensordict.batch_size)
            raise ValueError(f"the planner acts in an environment of {env.num_envs} episodes; the tensordict has {size}")
        memory = carried(tensordict, self.base, env)
        decide(self.base, tensordict)
        memory = memory if len(memory.keys()) else carried(tensordict, self.base, env)
        deciding = slots.deciding(tensordict) & self._plannable
        simulated = torch.zeros(env.num_envs, dtype=torch.float64, device=env.device)
        self._worth = torch.full(
            (env.num_envs, slots.size, slots.most_actions), torch.nan, dtype=torch.float64, device=env.device
        )
        order = deciding.cumsum(1)
        for turn in range(int(deciding.sum(1).max())):
            acting = deciding & (order == turn + 1)
            rows = torch.nonzero(acting.any(1)).squeeze(1)
            slot = acting[rows].long().argmax(1)
            action, seconds = self._improved(tensordict, memory, rows, slot)
            simulated = simulated.index_add(0, rows, seconds)
            whole_batch = torch.zeros(env.num_envs, *action.shape[1:], dtype=action.dtype, device=env.device)
            everybody = torch.zeros_like(simulated, dtype=torch.int64).index_copy(0, rows, slot)
            slots.put(tensordict, everybody, whole_batch.index_copy(0, rows, action), acting.any(1))
        if not self.real:
            tensordict.set(ACTION_VALUE, self._worth)
        return tensordict.set(SIMULATED, simulated)

    def _improved(self, td: TensorDictBase, memory: TensorDictBase, rows: Tensor, slot: Tensor) -> tuple[Tensor, Tensor]:
        """Return actions of the agents ``slot`` [n] in the episodes ``rows`` [n], [n] or [n, W], and simulated seconds [n].

        ``td`` [N] has the observations and the actions decided so far, ``memory`` [N] what the base policy remembers.
        """
        raise NotImplementedError(f"{type(self).__name__} must implement _improved(td, memory, rows, slot)")

    # -- roots --------------------------------------------------------------------------------------------------------

    @property
    def _copies(self) -> int:
        return self.futures or 1

    def _limit(self, rows: Tensor) -> Tensor | None:
        """Return the ticks at which branches of episodes ``rows`` [n] are cut; None with a value network."""
        if self._value is not None:
            return None
        if math.isinf(self.horizon):
            return torch.full_like(rows, ENDLESS)
        return self.env.fleet.ticks[rows] + max(1, round(self.horizon / self.env.fleet.h))

    def _judged(self, elapsed: Tensor) -> Tensor | None:
        """Return the time until the value network evaluates branches starting after ``elapsed`` [J] s; None without one."""
        return None if self._value is None else (self.horizon - elapsed).clamp(min=0.0)

    def _plant(self, store: Tasking, places: Tensor, rows: Tensor) -> None:
        """Copy episodes ``rows`` [n] into the rows ``places`` [n * futures] of another environment, once per future."""
        sources = rows.repeat_interleave(self._copies)
        store.restore(self.env, places, sources)
        if self.futures is not None:
            number = torch.arange(self._copies, device=rows.device).repeat(len(rows))
            key = present_key(self.env, sources, self.env.env_ids[sources], f"future {self.seed}")
            lots = key.uniform(self._copies).gather(1, number.cpu().unsqueeze(1)).squeeze(1)
            reseed_copies(store, places, lots, key)

    def _jobs(self, td: TensorDictBase, memory: TensorDictBase, real: Tensor, slot: Tensor, plan: Tensor, rows: Tensor) -> Jobs:
        """Return branches of the episodes ``real`` [J] from their copies in ``rows`` [J], with plans [J, D, ...] of agents."""
        carry = memory[real] if len(memory.keys()) else None
        judged = self._judged(torch.zeros_like(real, dtype=torch.float64))
        return Jobs(rows, self.env.env_ids[real], slot, plan, self.slots.actions(td)[real], self._limit(real), carry, judged)

    def _flown(
        self, td: TensorDictBase, memory: TensorDictBase, rows: Tensor, slot: Tensor, which: Tensor, plan: Tensor
    ) -> tuple[Tensor, Flown]:
        """Return the returns [J, futures] of plans [J, D, ...] in each future, and the branches, [J * futures].

        ``which`` [J] are places of their episodes in ``rows`` [n], and of their agents in ``slot`` [n].
        """
        copies, source = self._copies, self.env
        index = which.repeat_interleave(copies)
        places = rows[index]
        if self.futures is not None:
            source, number = self._store(len(rows) * copies), torch.arange(len(rows) * copies, device=rows.device)
            self._plant(source, number, rows)
            places = index * copies + torch.arange(copies, device=rows.device).repeat(len(which))
        jobs = self._jobs(td, memory, rows[index], slot[index], plan.repeat_interleave(copies, 0), places)
        flown = self.branches.fly(source, jobs)
        return self._discounting.before(flown.reward, flown.seconds, flown.rest).view(-1, copies), flown

    def _no_worse(
        self, td: TensorDictBase, memory: TensorDictBase, rows: Tensor, slot: Tensor, action: Tensor, worth: Tensor, plan: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Return actions at least as good as the remainder of the last plan, [n], and simulated seconds [n].

        ``plan`` [n, D] are sequences with the returns ``worth`` [n] that begin with ``action`` [n]; -1 for the base policy.
        """
        plans = self._cached_plans(torch.full_like(plan[0], -1))
        cached, exists = plans.look_up(self.env, rows, slot)
        index = torch.nonzero(exists).squeeze(1)
        simulated = torch.zeros_like(worth)
        if len(index):
            total, flown = self._flown(td, memory, rows, slot, index, cached[index])
            simulated[index] = flown.simulated
            better = torch.zeros_like(exists).index_copy(0, index, total.squeeze(1) > worth[index])
            action, plan = torch.where(better, cached[:, 0], action), torch.where(better.unsqueeze(1), cached, plan)
        plans.keep(self.env, rows, slot, plan)
        return action, simulated

    @property
    def _keeps_plans(self) -> bool:
        """Whether returns are exact, and all actions of a sequence those of one agent."""
        return self._value is None and self.futures is None and self.slots.size == 1

    # -- decisions ----------------------------------------------------------------------------------------------------

    def _note(self, rows: Tensor, slot: Tensor, q: Tensor) -> None:
        """Keep the returns ``q`` [n * futures, A] of the agents ``slot`` [n] for ``action_value``."""
        mean = q.view(len(rows), self._copies, -1).mean(1)
        self._worth[rows, slot] = mean.masked_fill(~torch.isfinite(mean), torch.nan)

    def _preferred(self, q: Tensor, base: Tensor) -> Tensor:
        """Return the action of the best return ``q`` [n * futures, A], [n]: that of ``base`` [n] unless another is better."""
        mean = q.view(len(base), self._copies, -1).mean(1)
        best, action = mean.max(1)
        return torch.where(best > mean.gather(1, base.unsqueeze(1)).squeeze(1), action, base)


def _as_price(
    price: Callable[[Tasking], Tensor] | Mapping[str, float], env: Tasking, slots: AgentTable, horizon: float, value: Value | None
) -> Price:
    """Return a price as a function of an environment and its observations; ValueError for a wrong one."""
    if value is not None or math.isinf(horizon):
        other = "value= judges it already" if value is not None else "horizon=inf cuts nothing"
        raise ValueError(f"price= is for states at the horizon: {other}")
    if callable(price):
        return lambda model, now: price(model)
    if not isinstance(price, Mapping) or not price or slots.size > 1:
        raise ValueError(
            f"price={price!r:.80} must be a function of an environment; or, for one satellite, numbers by observed quantity"
        )
    see = reader(env)
    worth = {name: number(f"price[{name!r}]", each) for name, each in price.items()}
    for name in worth:
        try:
            several = see.quantity(name).shape
        except KeyError as error:
            raise ValueError(f"price: {error.args[0]}") from error
        if several:
            raise ValueError(f"price: {name!r} has several numbers; give a function of an environment")

    def of_observation(model: Tasking, now: TensorDictBase) -> Tensor:
        parts = [value * see(now["observation"], name).double() for name, value in worth.items()]
        return torch.stack(parts).sum(0)

    return of_observation


def check_no_planner(policy: object) -> None:
    """Raise ValueError for a planner, where a policy is to act in copies of the environment."""
    if isinstance(policy, Planner):
        raise ValueError(f"policy={policy.name!r} plans in its own environment, and not in copies of it; give another policy")
