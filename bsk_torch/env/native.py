"""The phases of a step of one satellite as kernels of rows.

What surrounds a run is a hundred operations on N numbers: which modes actions enter, when tasks end, who has died, what has been
earned. :class:`NativePhases` traces the functions of these phases themselves (``decide`` and ``command``, the ticks to run,
``settle``, ``died``, the judgment) into three loops over the rows (:mod:`bsk_torch.codegen.rows`), so each rule is written once,
and the numbers are torch's bit for bit. Environments whose phases call users' code, or have events, keep the phases on tensors;
:func:`reason_for_tensors` names the reason, and ``bsk-torch schedule`` prints it.
"""

from __future__ import annotations

import functools
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from bsk_torch.act.base import ActionBuilder, ActionTable
from bsk_torch.codegen.kept import of_package
from bsk_torch.codegen.kernel import Kernel
from bsk_torch.codegen.rows import RowKernel, RowTrace
from bsk_torch.constants import NANO
from bsk_torch.data.composed import add_totals
from bsk_torch.env.satellite_group import command, first_task_end, settle
from bsk_torch.sats.bound import BoundSatellite
from bsk_torch.sim.fleet import ticks_to_run
from bsk_torch.sim.orbit.arcs import REACH_AROUND
from bsk_torch.sim.readout.model import Model

if TYPE_CHECKING:
    from bsk_torch.env.base import Tasking
    from bsk_torch.env.tasking import SatelliteTasking

TICKS, NUMBER, TRUTH = torch.int64, torch.float64, torch.bool

NUMBERS = ("h_ns", "longest", "h", "penalty", "limit_ends", "modes", "actions")
"""Numbers that kernels read from one tensor, so that other values need no other kernel: length of a tick in ns and s and of the
longest step in ticks, penalty of failures, whether the time limit terminates, number of modes and of actions."""


def _number(trace: RowTrace, name: str) -> Any:
    return trace.table("numbers", NUMBER)[NUMBERS.index(name)]


def reason_for_tensors(env: Tasking) -> str | None:
    """Return why the phases of a step run on tensors; None if kernels of rows compute them, where there are kernels."""
    satellite, fleet = env.satellites[0], env.fleet
    simulator, actions = satellite.simulator, satellite.actions
    models = satellite.dynamics, satellite.fsw
    own_checks = [name for model in models for name in model.checks() if not of_package([model.vitals().get(name, print)])]
    reasons = {
        "agents of a constellation": not hasattr(type(env), "native"),
        "a log of the episodes": env.log is not None,
        "communication": not env.communicator.is_silent,
        "continuous actions": not isinstance(actions, ActionBuilder),
        "actions that are more than a table": isinstance(actions, ActionBuilder) and not actions.is_table,
        "hooks for the ends of actions": satellite.hears_ends,
        "events that end actions": simulator.has_events or simulator.tick.stops,
        "maneuvers": simulator.has_tank,
        "satellites that are traced or followed": fleet.traced or fleet.varies or bool(simulator.tick.supplied),
        "custom aliveness checks": bool(own_checks)
        or any(getattr(type(satellite), name) is not getattr(BoundSatellite, name) for name in ("is_alive", "aliveness"))
        or any(type(model).aliveness is not Model.aliveness for model in models),
        "a rewarder that ends episodes": env.checked.terminates or env.checked.truncates,
    }
    return next((reason for reason, holds in reasons.items() if holds), None)


class NativePhases:
    """The phases of a step of a :class:`~bsk_torch.env.tasking.SatelliteTasking`, in three kernels."""

    @classmethod
    def of(cls, env: SatelliteTasking) -> NativePhases | None:
        """Return the phases of an environment as kernels; None where they run on tensors."""
        compiled = isinstance(env.simulator.runners.run, Kernel) and env.simulator.observer.kernels
        return cls(env) if compiled and reason_for_tensors(env) is None else None

    def __init__(self, env: SatelliteTasking) -> None:
        """Build the kernels; :func:`reason_for_tensors` must be None."""
        self.env, self.satellite = env, env.satellite
        self.simulator, self.n = env.simulator, env.num_envs
        self.everywhere = torch.ones(self.n, dtype=TRUTH)
        self.vitals = (*self.satellite.dynamics.vitals().values(), *self.satellite.fsw.vitals().values())
        actions: Any = self.satellite.actions
        self.begin = _begin_kernel(len(self.simulator.type.resets[0]), actions.keys is not None, self.satellite.variable_interval)
        self.settle = _settle_kernel()
        self.judge = _judge_kernel(type(env), len(self.vitals))
        self._values_of_numbers: tuple[float, ...] = ()

    @property
    def applies(self) -> bool:
        """Whether nothing that reads traces of runs has been added since the environment was built."""
        fleet = self.env.fleet
        return not (fleet.recordings or fleet.stop_conditions or fleet.flight_observers or self.simulator.sources)

    @property
    def numbers(self) -> Tensor:
        """Numbers that all rows share, see :data:`NUMBERS`."""
        simulator, env = self.simulator, self.env
        modes, size = len(simulator.mode_names), self.satellite.actions.n_actions
        values = simulator.h_ns, env.longest_ticks, simulator.h, env.failure_penalty, env.terminate_on_time_limit, modes, size
        if values != self._values_of_numbers:
            self._values_of_numbers, self._numbers = values, torch.tensor(values, dtype=NUMBER)
        return self._numbers

    def advance(self, action: Tensor) -> dict[str, Tensor]:
        """Execute ``action`` [N] int64 in every episode; return reward, ends and duration, [N, 1] each."""
        env, state, task, n = self.env, self.simulator.state, self.satellite.task, self.n
        actions: Any = self.satellite.actions
        episodes, checked = env.state, env.checked
        action = action.clone(memory_format=torch.contiguous_format)
        since, limit = state.ticks, episodes.limit_ticks
        env.fleet.since = since
        before, (modes, again, durations) = checked.log(), actions.table()
        env.guard.change(self.everywhere)
        numbers, (planes, resets, values) = self.numbers, self.simulator.type.resets
        arguments = dict(
            numbers=numbers, action=action, previous=task.previous_action, modes=modes, again=again, durations=durations,
            keys=actions.keys, now=since, limit=limit, mode=state.mode, planes=state.planes,
            arcs_end=self.simulator.lookahead.flight.end, reset_planes=planes, resets=resets, reset_values=values,
        )  # fmt: skip
        (ends, expected, duration, key, requires, mode, counts), (most, late) = self.begin(n, arguments)
        if most == torch.inf:
            env.guard.change(None)
            actions.checked(action, None)  # which names the wrong action
        task.put(ends=ends, expected=expected, action=action, task_duration=duration, previous_action=key)
        state.put(mode=mode)
        state.touch()
        self.simulator.fly(counts, int(most), bool(late))
        arguments = dict(numbers=numbers, since=since, counts=counts, limit=limit, ends=ends, requires=requires)
        (ticks, time, ended, requires), _ = self.settle(n, arguments)
        state.set_clock(ticks, time)
        task.put(ends=ended, requires_retasking=requires)
        reward = checked.reward(before, checked.log()).double().contiguous()
        add_totals(env.rewarder, reward, self.everywhere)
        env.scenario.finish_step(time)
        self.satellite.memory.touch()
        observed = self.simulator.observer.table()
        assert observed is not None  # there are kernels, and vitals are wanted
        table, kernel = observed
        arguments = dict(
            numbers=numbers, table=table, columns=kernel.places(self.vitals), ticks=ticks, limit=limit, counts=counts,
            dead=task.dead, reward=reward, returns=episodes.returns,
        )  # fmt: skip
        (dead, returns, reward, terminated, truncated, done, duration), _ = self.judge(n, arguments)
        task.put(dead=dead)
        episodes.put(returns=returns)
        flags = {"terminated": terminated, "truncated": truncated, "done": done}
        return {"reward": reward.to(env.dtype), **flags, "duration": duration.to(env.dtype)}


@functools.cache
def _begin_kernel(resets: int, has_keys: bool, ends_step: bool) -> RowKernel:
    """Decide, command, and the ticks to run of all episodes, with the reset of planes of the state that modes want."""
    trace = RowTrace()
    h_ns, longest, h, modes, size = (_number(trace, name) for name in ("h_ns", "longest", "h", "modes", "actions"))
    action, previous = trace.row("action", TICKS), trace.row("previous", TICKS)
    table = ActionTable(trace.columns("modes", TICKS), trace.table("again", TRUTH), trace.table("durations", NUMBER))  # type: ignore[arg-type]
    keys = trace.table("keys", TICKS) if has_keys else None
    builder: Any = SimpleNamespace(_deciding=(), entries=(None,), n_negative_actions=0, keys=keys, table=lambda: table)
    now, limit, mode = trace.row("now", TICKS), trace.row("limit", TICKS), trace.row("mode", TICKS)
    planes, wants, values = "reset_planes", trace.table("resets", TRUTH), trace.table("reset_values", NUMBER)
    entered: dict[str, Any] = {}

    def enter(rows: Any, new: Any) -> None:
        entered["rows"], entered["mode"] = rows, torch.where(rows, new, mode)

    everywhere = torch.ones_like(now, dtype=TRUTH)
    task = SimpleNamespace(requires_retasking=everywhere)
    simulator = SimpleNamespace(command=enter, state=SimpleNamespace(ticks=now), h_ns=h_ns, has_tank=False, count=1)
    group: Any = SimpleNamespace(
        task=task, simulator=simulator, actions=SimpleNamespace(begin=lambda *_: None), variable_interval=ends_step
    )
    decision = ActionBuilder.decide(builder, action, previous, everywhere)
    command(group, action, everywhere, decision, everywhere, all_act=True)
    counts, _ = ticks_to_run(now, limit, first_task_end([group], now + longest), everywhere)
    reached = (now * h_ns).double() * NANO + counts.double() * h + REACH_AROUND
    stored = {}
    for k in range(resets):
        plane = trace.plane("planes", planes, k)
        place = float(k) * modes + entered["mode"]
        stored[k] = plane, torch.where(wants[place] & entered["rows"], values[place], plane)
    outputs = {
        "ends": (task.ends, TICKS),
        "expected": (task.expected, TICKS),
        "duration": (task.task_duration, NUMBER),
        "key": (task.previous_action, TICKS),
        "requires": (task.requires_retasking, TRUTH),
        "mode": (entered["mode"], TICKS),
        "counts": (counts, TICKS),
    }
    late = ~(reached <= trace.row("arcs_end", NUMBER))
    return RowKernel("start of a step", trace, outputs, (counts, late.double()), stored, (action < 0) | (action >= size))


@functools.cache
def _settle_kernel() -> RowKernel:
    """The clocks after a run, and the tasks that have ended."""
    trace = RowTrace()
    h_ns = _number(trace, "h_ns")
    ticks = trace.row("since", TICKS) + trace.row("counts", TICKS)
    limit = trace.row("limit", TICKS)
    task = SimpleNamespace(ends=trace.row("ends", TICKS), requires_retasking=trace.row("requires", TRUTH))
    group: Any = SimpleNamespace(task=task, simulator=SimpleNamespace(state=SimpleNamespace(ticks=ticks)), hears_ends=False)
    settle(group, None, torch.ones_like(limit, dtype=TRUTH), ticks >= limit)
    outputs = {"ticks": (ticks, TICKS), "time": ((ticks * h_ns).double() * NANO, NUMBER)}
    outputs |= {"ends": (task.ends, TICKS), "requires": (task.requires_retasking, TRUTH)}
    return RowKernel("end of a run", trace, outputs)


@functools.cache
def _judge_kernel(of: type[Tasking], vitals: int) -> RowKernel:
    """Who has died, and the outcome of a step."""
    trace = RowTrace()
    table, columns = trace.columns("table", NUMBER), trace.table("columns", TICKS)
    ticks, limit = trace.row("ticks", TICKS), trace.row("limit", TICKS)
    checks = {str(k): table[columns[k]] > 0.5 for k in range(vitals)}
    simulator = SimpleNamespace(state=SimpleNamespace(ticks=ticks))
    group: Any = SimpleNamespace(simulator=simulator, aliveness=lambda: checks)
    group.task = SimpleNamespace(dead=trace.row("dead", TRUTH) | ~BoundSatellite.is_alive(group))
    state = SimpleNamespace()
    env: Any = SimpleNamespace(
        state=state,
        fleet=SimpleNamespace(joined=lambda parts: parts[0].unsqueeze(1), size=1, present=None),
        satellites=[group],
        failure_penalty=_number(trace, "penalty"),
        checked=SimpleNamespace(terminates=False, truncates=False),
    )
    env._over, env._all_agents_ended = (functools.partial(getattr(of, name), env) for name in ("_over", "_all_agents_ended"))
    true = torch.ones_like(ticks, dtype=TRUTH)
    duration, reward = trace.row("counts", TICKS).double() * _number(trace, "h"), trace.row("reward", NUMBER).unsqueeze(1)
    results = []
    for env.terminate_on_time_limit in (False, True):
        state.returns = trace.row("returns", NUMBER)
        results.append(of._judge(env, duration, reward, true, ~true, ticks >= limit))
    result = results[0]
    terminated = torch.where(_number(trace, "limit_ends") > 0.5, results[1].terminated, result.terminated)
    outputs = {
        "dead": (group.task.dead, TRUTH),
        "returns": (state.returns, NUMBER),
        "reward": (result.reward, NUMBER, 1),
        "terminated": (terminated, TRUTH, 1),
        "truncated": (result.truncated, TRUTH, 1),
        "done": (terminated | result.truncated, TRUTH, 1),
        "duration": (result.duration, NUMBER, 1),
    }
    return RowKernel("judgment of a step", trace, outputs)
