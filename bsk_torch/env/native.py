"""The phases of a step of one satellite as kernels of rows.

What surrounds a run is a hundred operations on N numbers: which modes actions enter, when tasks end, who has died, what has been
earned. :class:`NativePhases` traces the functions of these phases themselves (``decide`` and ``command``, the ticks to run,
``settle``, ``died``, the judgment) into three loops over the rows (:mod:`bsk_torch.codegen.rows`), so each rule is written once,
and the numbers are torch's bit for bit. Environments whose phases call users' code, or have events, keep the phases on tensors;
:func:`reason_for_tensors` names the reason, and ``bsk-torch schedule`` prints it. Also in these, :class:`NativeImages` decides
and commands satellites that only image, alone or in a constellation.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, cast

import torch
from torch import Tensor

from bsk_torch.act.base import ActionBuilder, ActionTable
from bsk_torch.act.image import Image
from bsk_torch.codegen.kept import of_package
from bsk_torch.codegen.kernel import Kernel
from bsk_torch.codegen.rows import Columns, RowKernel, RowTrace
from bsk_torch.constants import NANO
from bsk_torch.data.composed import add_totals
from bsk_torch.env.satellite_group import SatelliteGroup, command, first_task_end, settle
from bsk_torch.sats.bound import BoundSatellite
from bsk_torch.sats.imaging import BoundImagingSatellite
from bsk_torch.sats.opportunities import Opportunities
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


def only_images(satellite: SatelliteGroup) -> bool:
    """Return whether :class:`~bsk_torch.act.Image`, with one instrument and no tank, is all that satellites of one type do."""
    simulator, actions = satellite.simulator, satellite.actions
    images = isinstance(actions, ActionBuilder) and [type(entry) for entry in actions.entries] == [Image]
    plain = getattr(type(satellite), "note_events", None) is BoundImagingSatellite.note_events
    return images and plain and not (simulator.type.instruments or simulator.has_tank)


class NativeImages:
    """Decides and commands satellites that only image, in one kernel; targets chosen by their index are left to tensors."""

    @classmethod
    def of(cls, satellite: SatelliteGroup) -> NativeImages | None:
        """Return the kernel of satellites of one type; None without kernels, or where they do not only image."""
        simulator = satellite.simulator
        compiled = isinstance(simulator.runners.run, Kernel) and simulator.observer.kernels
        return cls(satellite) if compiled and only_images(satellite) else None

    def __init__(self, satellite: SatelliteGroup) -> None:
        """Build the kernels."""
        self.satellite: Any = satellite
        self.entry = cast("Image", self.satellite.actions.entries[0])
        simulator = satellite.simulator
        resets, layout = simulator.type.resets[0], simulator.state.layout
        written = [*range(layout.size)[layout.slices["r_LP_P"]], *range(layout.size)[layout.slices["image_level"]]]
        planes = list(dict.fromkeys([*resets.tolist(), *written]))
        self.planes = torch.tensor(planes)
        values = (
            *(simulator.h_ns, len(simulator.mode_names), simulator.mode_names.index(self.entry.flight_mode)),
            *(self.entry.max_duration, satellite.segment),
        )
        self.numbers = torch.tensor(values, dtype=NUMBER)
        self.kernel = _image_kernel(self.entry.n_actions, len(resets), tuple(planes.index(plane) for plane in written))

    def settle(self, event: Tensor, moves: Tensor, last: Tensor) -> None:
        """See :func:`~bsk_torch.env.satellite_group.settle`."""
        task, state = self.satellite.task, self.satellite.simulator.state
        inputs = dict(
            numbers=self.numbers, ticks=state.ticks, event=event, moves=moves, last=last, ends=task.ends,
            requires=task.requires_retasking, duration=task.task_duration, key=task.previous_action,
            imaged=state.memory["imaged"], missed=state.memory["missed"],
        )  # fmt: skip
        ends, requires, state.memory["imaged"], state.memory["missed"] = _image_end_kernel()(len(event), inputs)[0]
        task.put(ends=ends, requires_retasking=requires)

    def prepared(self, action: Tensor, acts: Tensor) -> Callable[[Tensor, bool], None] | None:
        """Return the function that begins ``action`` [N] where ``acts`` [N] holds, as :func:`command`; None for an index."""
        entry, satellite = self.entry, self.satellite
        if entry.by_index:
            return None
        windows = satellite.find_next_opportunities(entry.n_actions, entry.kind, (action + 1) * acts)
        level = satellite.dynamics.partition_levels[:, 0].contiguous()
        return functools.partial(self._begin, action, acts.contiguous(), windows, level)

    def _begin(self, action: Tensor, acts: Tensor, windows: Opportunities, level: Tensor, moves: Tensor, _: bool) -> None:
        task, state = self.satellite.task, self.satellite.simulator.state
        memory, (_, resets, values) = state.memory, self.satellite.simulator.type.resets
        inputs = dict(
            numbers=self.numbers, chosen=action, acts=acts, moves=moves.contiguous(), place=windows.place, open=windows.open,
            close=windows.close, found=windows.found, sites=windows.r_LP_P.flatten(1), level=level, now=state.ticks,
            time=state.sim_time, mode=state.mode, planes=state.planes, reset_planes=self.planes, resets=resets,
            reset_values=values, latest=memory[Image.aim], dead=task.dead,
            **{name: task[name] for name in TASK},
        )  # fmt: skip
        mode, memory[Image.aim], *new = self.kernel(len(action), inputs)[0]
        task.put(**dict(zip(TASK, new, strict=True)))
        state.put(mode=mode)
        state.touch()


TASK = {
    **{"requires_retasking": TRUTH, "ends": TICKS, "expected": TICKS, "action": TICKS},
    **{"task_duration": NUMBER, "previous_action": TICKS},
}
"""Tensors of tasks that a command changes."""


class _Traced(SimpleNamespace):
    """A table of a state, or what has its members, while a kernel is traced."""

    def __getitem__(self, name: str) -> Any:
        return getattr(self, name)

    def __setitem__(self, name: str, value: object) -> None:
        setattr(self, name, value)


@functools.cache
def _image_kernel(choices: int, resets: int, written: tuple[int, ...]) -> RowKernel:
    """Decide and command among ``choices`` windows; r_LP_P and ``image_level`` are the planes number ``written``."""
    trace = RowTrace()
    h_ns, modes, image, max_duration, segment = (trace.table("numbers", NUMBER)[k] for k in range(5))
    action, acts, moves = trace.row("chosen", TICKS), trace.row("acts", TRUTH), trace.row("moves", TRUTH)
    times = {name: Columns(trace.columns(name, NUMBER), choices) for name in ("open", "close")}
    windows = SimpleNamespace(place=Columns(trace.columns("place", TICKS), choices), found=trace.row("found", TICKS), **times)
    sites = trace.columns("sites", NUMBER)
    r_LP_P = torch.stack([sites[action * 3 + axis] for axis in range(3)], -1).unsqueeze(1)
    task = _Traced(**{name: trace.row(name, dtype) for name, dtype in TASK.items()}, dead=trace.row("dead", TRUTH))
    before, memory, mode = task.previous_action, _Traced(latest_target=trace.row("latest", TICKS)), trace.row("mode", TICKS)
    wants, values = trace.table("resets", TRUTH), trace.table("reset_values", NUMBER)
    stored = {k: trace.plane("planes", "reset_planes", k) for k in sorted({*range(resets), *written})}
    new, fields, entered = dict(stored), {"r_LP_P": written[:3], "image_level": written[3:]}, [mode]

    def enter(rows: Any, mode: Any) -> None:
        entered[0] = torch.where(rows, mode, entered[0])
        for k in range(resets):
            place = float(k) * modes + mode
            new[k] = torch.where(wants[place] & rows, values[place], new[k])

    def write(name: str, rows: Any, value: Any) -> None:
        for k, part in zip(fields[name], value.unbind(-1) if value.ndim > 1 else (value,), strict=True):
            new[k] = torch.where(rows, part, new[k])

    state = SimpleNamespace(ticks=trace.row("now", TICKS))
    simulator = SimpleNamespace(
        **{"state": state, "h_ns": h_ns, "has_tank": False, "sim_time": trace.row("time", NUMBER), "memory": memory},
        **{"mode_names": SimpleNamespace(index=lambda _: image), "command": enter, "write": write},
    )
    level = trace.row("level", NUMBER).unsqueeze(-1)
    satellite = SimpleNamespace(
        **{"simulator": simulator, "segment": segment, "dynamics": SimpleNamespace(partition_levels=level)},
        **{"find_next_opportunities": lambda *_: windows, "positions": lambda *_: r_LP_P},
    )
    entry: Any = SimpleNamespace(
        **{"satellite": satellite, "by_index": False, "n_actions": choices, "kind": "", "keys": Image.keys, "_first": 0},
        **{"flight_mode": Image.flight_mode, "max_duration": max_duration, "_number": None, "aim": Image.aim},
    )
    entry.remember = functools.partial(Image.remember, entry)
    decision = Image.decide(entry, action, acts, action, before)
    actions = SimpleNamespace(begin=lambda _, rows, commands: Image.begin(entry, rows, commands))
    group: Any = SimpleNamespace(task=task, simulator=simulator, actions=actions)
    command(group, action, acts, decision, moves)
    outputs = {"mode": (entered[0], TICKS), "latest": (memory[Image.aim], TICKS)}
    outputs |= {name: (task[name], dtype) for name, dtype in TASK.items()}
    return RowKernel("start of images", trace, outputs, (), {k: (plane, new[k]) for k, plane in stored.items()})


@functools.cache
def _image_end_kernel() -> RowKernel:
    """The tasks that have ended, and windows that have closed without an image."""
    trace = RowTrace()
    max_duration, truths = trace.table("numbers", NUMBER)[3], (trace.row(name, TRUTH) for name in ("event", "moves", "last"))
    task = SimpleNamespace(
        ends=trace.row("ends", TICKS), requires_retasking=trace.row("requires", TRUTH), action=None,
        task_duration=trace.row("duration", NUMBER), previous_action=trace.row("key", TICKS),
    )  # fmt: skip
    memory = _Traced(imaged=trace.row("imaged", TICKS), missed=trace.row("missed", TICKS))
    state = SimpleNamespace(ticks=trace.row("ticks", TICKS), mode=None)
    simulator = SimpleNamespace(state=state, memory=memory)
    entry: Any = SimpleNamespace(satellite=SimpleNamespace(simulator=simulator), max_duration=max_duration)
    actions = SimpleNamespace(end=lambda _, *ended: Image.end(entry, *ended))
    group: Any = SimpleNamespace(task=task, simulator=simulator, actions=actions, memory=memory, imaged=memory.imaged)
    group.note_events = functools.partial(BoundImagingSatellite.note_events, group)
    settle(group, *truths)
    outputs = {"ends": (task.ends, TICKS), "requires": (task.requires_retasking, TRUTH)}
    outputs |= {name: (memory[name], TICKS) for name in ("imaged", "missed")}
    return RowKernel("end of images", trace, outputs)


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
