"""The component that lets faults act: in every tick, it replaces parameters of other components before these run.

A fault changes arguments. What a tick reads are parameters, which components compute from the arguments in ``prepare``; so
``prepare`` of the same components computes them again from the changed arguments, and in the tick the parameters of the time are
selected. Every argument of which a parameter follows can therefore change, also in components that know nothing about faults.

Parameters that the same faults change are a :class:`Group`. Its faults begin and end at known ticks; with these in order, e_1 to
e_E, and the parameters P_j that follow from the faults that act after e_j, a parameter of tick k is P_j of the last ``e_j < k``.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from bsk_torch import _checks
from bsk_torch.sim.arguments.sources import hint
from bsk_torch.sim.arguments.values import is_fixed
from bsk_torch.sim.component import Arg, Bus, Component, Field, Layout, Values, asked
from bsk_torch.sim.faults.declared import CHANGING, NEVER, Fault, ticks_of
from bsk_torch.sim.names import check_unique

SLOT = "faults"

FAULTS_ARG = Arg(SLOT, None, "-", "faults that may happen, a list of faults.Fault", "constant")

FAULTS = Component(slot=SLOT, args=(FAULTS_ARG,))  # no faults, unless the arguments declare some: with_faults
UNLIMITED = ("u_max", "rwPMax", "rwOmegaMax")  # arguments that mean no limit where they are not positive


class Group(NamedTuple):
    """Parameters of a tick that the same faults change."""

    faults: tuple[int, ...]  # numbers of the faults
    fields: tuple[Field, ...]
    planes: tuple[int, ...]  # planes of these fields that change, in their Layout
    events: int  # number of times at which faults of the group begin or end
    grows: bool  # whether some changes grow over time

    @property
    def exact(self) -> bool:
        """Whether the parameters are always float64."""
        return self.fields[0].exact


def declared_faults(arguments: Mapping[str, object], table: Mapping[str, Arg]) -> tuple[Fault, ...]:
    """Return the faults that arguments as given, with their entries in a ``table``, declare.

    ValueError for entries that are not faults, equal names, and arguments that do not exist or cannot change.
    """
    if arguments[SLOT] is None:
        return ()
    what = "a list of faults, such as [faults.wheel_torque(0, at=600.0)]"
    listed = _checks.parts("sat_args: faults", arguments[SLOT], Fault, what, empty=True)
    check_unique([fault.name for fault in listed], "faults")
    for fault in listed:
        for name in fault.arguments:
            if name not in table:
                raise ValueError(f"fault {fault.name!r} changes the unknown argument {name!r}; {hint(name, table)}")
            if is_fixed(table[name]) or table[name].kind in ("utc", "orbit"):
                raise ValueError(
                    f"fault {fault.name!r} changes {name!r}, which is used only when an environment is built, or an episode "
                    "starts; faults change numbers that a tick reads"
                )
    return listed


def changing(arguments: Mapping[str, object], faults: Iterable[Fault]) -> dict[str, object]:
    """Return given arguments in which those that faults change may be anything, so that no component relies on their values."""
    return dict(arguments) | {name: CHANGING for fault in faults for name in fault.arguments}


def with_faults(parts: Iterable[Component], faults: tuple[Fault, ...]) -> tuple[Component, ...]:
    """Return the parts, whose structure is final, with the arguments that the draws of faults are."""
    parts = tuple(parts)
    if not faults:
        return parts
    table = {arg.name: arg for part in parts for arg in part.args}
    args = [arg for fault in faults for arg in _drawn_args(fault, table)]
    return tuple(dataclasses.replace(part, args=(*part.args, *args)) if part.slot == SLOT else part for part in parts)


def _drawn_args(fault: Fault, table: Mapping[str, Arg]) -> list[Arg]:
    """Return the arguments that hold when a fault begins, how long it lasts, and its values or factors."""
    title, never = f"fault {fault.name}", float("inf")
    args = [Arg(fault.drawn("at"), fault.at, "s", f"{title}: when it begins", low=0.0, missing=never, endless=True)]
    if fault.ends:
        args.append(Arg(fault.drawn("lasts"), fault.lasts, "s", f"{title}: how long it lasts", low=0.0, endless=True))
    for k, name in enumerate(fault.arguments):
        arg, what = table[name], "value" if fault.factor is None else "factor"
        settings = {"name": fault.drawn(name), "default": fault.change(k), "doc": f"{title}: {what} of {name}", "missing": None}
        if fault.index is not None:
            if not arg.shape:
                raise ValueError(f"{title}: index={fault.index} of {name}, which is one number of a satellite; leave index out")
            if arg.shape[0] is not None and fault.index >= arg.shape[0]:
                raise ValueError(
                    f"{title}: index={fault.index} does not exist: the satellite has {arg.shape[0]} such parts, from 0 to "
                    f"{arg.shape[0] - 1}"
                )
            settings |= {"shape": arg.shape[1:] or None, "spread": False}
        if fault.factor is not None:
            settings |= {"kind": "scalar", "shape": None, "spread": False, "unit": "-", "low": 0.0, "high": 1e9, "whole": False}
        args.append(dataclasses.replace(arg, **settings))
    return args


def _value_of(fault: Fault, name: str, old: Tensor, drawn: Tensor) -> Tensor:
    """Return the value [n or 1, ...] of an argument with a fault; ``drawn`` is the new value, or the factor, of the rows."""
    where = slice(None) if fault.index is None else fault.index
    rows = max(len(old), len(drawn))
    new = old.expand(rows, *old.shape[1:]).clone()
    part = new[:, where] if new.ndim > 1 else new
    amount = drawn.expand(rows, *drawn.shape[1:])
    if fault.factor is not None:
        changed = part * amount.view(-1, *[1] * (part.ndim - 1))
    else:
        changed = amount.expand_as(part) if amount.ndim == part.ndim else amount.unsqueeze(-1).expand_as(part)
    if new.ndim > 1:
        new[:, where] = changed
        return new
    return changed


def _changed(faults: Sequence[Fault], numbers: Iterable[int], active: Mapping[int, Tensor], values: Values, slot: str) -> Values:
    """Return the arguments that a component has while faults are ``active``, masks [n or 1] by their numbers, in their order."""
    changed = dict(values)
    for k in numbers:
        fault = faults[k]
        if fault.slots is not None and slot not in fault.slots:
            continue
        for name in fault.arguments:
            old = changed[name]
            new = _value_of(fault, name, old, values[fault.drawn(name)])
            changed[name] = torch.where(active[k].view(-1, *[1] * (new.ndim - 1)), new, old)
    return changed


def _parameters(part: Component, values: Values) -> dict[str, Tensor]:
    [(_, arguments)] = asked([part], values)
    parameters = part.prepare(arguments)  # type: ignore[misc]
    return {field.name: parameters[field.name].reshape(-1, field.width) for field in part.params}


@dataclasses.dataclass(frozen=True)
class Plan:
    """What the faults of a type of satellites change."""

    faults: tuple[Fault, ...]
    groups: tuple[Group, ...]
    parts: tuple[tuple[Component, ...], ...]  # components with parameters of each group
    h_ns: int  # length of a tick, ns

    def prepare(self, values: Values) -> dict[str, Tensor]:
        """Return the ticks at which parameters change, and their values from there on; see :func:`fault_update`."""
        begins, ends = self.begins_and_ends(values)
        parameters = {}
        for g, (group, parts) in enumerate(zip(self.groups, self.parts, strict=True)):
            ending = [k for k in group.faults if self.faults[k].ends]
            ticks = torch.stack([*(begins[k] for k in group.faults), *(ends[k] for k in ending)], -1)
            ticks, order = ticks.sort(dim=-1, stable=True)
            versions = []
            for event in ticks.unbind(-1):
                active = {k: (begins[k] <= event) & (event < ends[k]) for k in group.faults}
                versions.append(self._version(group, parts, values, active))
            rows = max(len(version) for version in versions)
            parameters[f"fault_ticks_{g}"] = ticks
            parameters[f"fault_values_{g}"] = torch.cat([version.expand(rows, -1) for version in versions], -1)
            if group.grows:
                ticks_over = [max(self.faults[k].over * 1e9 / self.h_ns, 1.0) for k in group.faults]
                rate = 1.0 / torch.tensor([*ticks_over, *[1.0] * len(ending)], dtype=torch.float64)
                parameters[f"fault_growth_{g}"] = rate[order]
        return parameters

    def begins_and_ends(self, values: Values) -> tuple[list[Tensor], list[Tensor]]:
        """Return the ticks, [n or 1] for each fault, after which it acts, and after which it no longer does."""
        begins, ends = [], []
        for fault in self.faults:
            at: Tensor = values[fault.drawn("at")]
            begins.append(ticks_of(at, self.h_ns))
            lasts = values[fault.drawn("lasts")] if fault.ends else torch.full_like(at, torch.inf)
            ends.append(ticks_of(at + lasts, self.h_ns))
        rows = max(map(len, (*begins, *ends)), default=1)
        return [ticks.expand(rows) for ticks in begins], [ticks.expand(rows) for ticks in ends]

    def _version(self, group: Group, parts: Iterable[Component], values: Values, active: Mapping[int, Tensor]) -> Tensor:
        """Return the changing planes of a group, [n or 1, P], while faults are active."""
        parameters: dict[str, Tensor] = {}
        for part in parts:
            parameters |= _parameters(part, _changed(self.faults, group.faults, active, values, part.slot))
        tables = [parameters[field.name] for field in group.fields]
        rows = max(map(len, tables))
        return torch.cat([table.expand(rows, -1) for table in tables], -1)[:, group.planes]

    def check(self, values: Values) -> None:
        """Check the values that arguments have with each fault; ValueError for those that are not allowed."""
        table = {arg.name: arg for parts in self.parts for part in parts for arg in part.args}
        for fault in self.faults:
            for name in fault.arguments:
                if name not in table:  # of an argument that only the faults' parameters depend on
                    continue
                new, arg = _value_of(fault, name, values[name], values[fault.drawn(name)]), table[name]
                wrong = (new < arg.low) | (new > arg.high) | torch.isnan(new)
                if bool(wrong.any()):
                    raise ValueError(
                        f"fault {fault.name!r}: {name}={new[wrong][0].item():g} is not allowed; it must {arg.allowed}"
                    )
                zero = (new if fault.index is None else new[:, fault.index]) == 0.0
                if name in UNLIMITED and bool(zero.any()):
                    raise ValueError(
                        f"fault {fault.name!r}: {name}=0 means that there is no limit; give a small positive number: 1e-12"
                    )


def planned(parts: Sequence[Component], faults: tuple[Fault, ...], values: Values, h_ns: int) -> tuple[Component, ...]:
    """Return the parts, with the arguments of :func:`with_faults`, with the component that lets faults act.

    The ``values`` of a trial draw show what depends on what. ValueError for a fault that changes nothing in a tick.
    """
    if not faults:
        return tuple(parts)
    touched: dict[tuple[str, int], set[int]] = {}
    fields: dict[str, Field] = {}
    homes: dict[str, Component] = {}
    others = [part for part in parts if part.slot != SLOT and part.params]
    for k, fault in enumerate(faults):
        for name in fault.arguments:
            if not isinstance(values[name], Tensor):
                raise ValueError(f"fault {fault.name!r} changes {name}={values[name]!r}; give it a number in sat_args")
        changed = [(part, *plane) for part in others for plane in _touched(part, faults, k, values)]
        if not changed:
            where = f" in {list(fault.slots)}" if fault.slots is not None else ""
            having = [part.slot for part in parts if any(arg.name in fault.arguments for arg in part.args)]
            raise ValueError(
                f"fault {fault.name!r} changes nothing{where}: no tick reads {', '.join(fault.arguments)} there, or its value is "
                f"that of the satellite anyway; slots that have it: {', '.join(having)}"
            )
        for part, field, plane in changed:
            touched.setdefault((field.name, plane), set()).add(k)
            fields[field.name], homes[field.name] = field, part
    sets: dict[tuple[tuple[int, ...], bool], list[tuple[str, int]]] = {}
    for (name, plane), numbers in touched.items():
        sets.setdefault((tuple(sorted(numbers)), fields[name].exact), []).append((name, plane))
    groups, members = [], []
    for (together, _), planes in sets.items():
        names = tuple(dict.fromkeys(name for name, _ in planes))
        layout = Layout(fields[name] for name in names)
        changing_planes = tuple(layout.slices[name].start + plane for name, plane in planes)
        events = len(together) + sum(faults[k].ends for k in together)
        group_fields = tuple(fields[name] for name in names)
        groups.append(Group(together, group_fields, changing_planes, events, any(faults[k].over > 0.0 for k in together)))
        members.append(tuple({homes[name].slot: homes[name] for name in names}.values()))
    plan = Plan(faults, tuple(groups), tuple(members), h_ns)
    return tuple(_acting(part, plan) if part.slot == SLOT else part for part in parts)


def _touched(part: Component, faults: Sequence[Fault], k: int, values: Values) -> list[tuple[Field, int]]:
    """Return the planes of the parameters of a part that a fault changes: with its value, or with others."""
    fault = faults[k]
    probes = [values]
    for scale, shift in ((1.25, 0.125), (0.5, 0.0)):
        others = {name: values[name] * scale + shift for name in map(fault.drawn, fault.arguments)}
        probes.append({**values, **others})
    before, always = _parameters(part, values), {k: torch.ones(1, dtype=torch.bool)}
    touched = []
    for probe in probes:
        after = _parameters(part, _changed(faults, (k,), always, probe, part.slot))
        for field in part.params:
            differs = ~torch.isclose(before[field.name], after[field.name], rtol=0.0, atol=0.0, equal_nan=True)
            touched += [(field, plane) for plane in torch.nonzero(differs.any(0)).flatten().tolist()]
    return list(dict.fromkeys(touched))


def _acting(part: Component, plan: Plan) -> Component:
    params = []
    for g, group in enumerate(plan.groups):
        params.append(Field(f"fault_ticks_{g}", group.events, "-", many=True, exact=True))
        params.append(Field(f"fault_values_{g}", group.events * len(group.planes), many=True, exact=group.exact))
        if group.grows:
            params.append(Field(f"fault_growth_{g}", group.events, "-", many=True, exact=True))
    changed = (name for fault in plan.faults for name in fault.arguments)
    reads = (*changed, *(name for members in plan.parts for member in members for name in member.arguments))
    return dataclasses.replace(
        part, update=fault_update(plan.groups), params=tuple(params), reads=reads, prepare=plan.prepare, check=plan.check
    )


@functools.cache
def fault_update(groups: tuple[Group, ...]) -> Callable[[Bus], None]:
    """Return the update that replaces parameters by those of the faults that act."""
    layouts = [Layout(group.fields) for group in groups]

    def let_faults_act(bus: Bus) -> None:
        """Replace parameters by those of the faults that act.

        With the parameters P_j that follow from the faults after their j-th event, at the end of tick e_j, a parameter P of tick
        k becomes ``P + s (P_j - P)`` for each ``e_j < k`` in turn, with ``s = min((k - e_j) h / over, 1)``; s is 1 for changes
        that act at once.
        """
        for g, (group, layout) in enumerate(zip(groups, layouts, strict=True)):
            planes, values = layout.gather(bus), getattr(bus, f"fault_values_{g}")
            for j, event in enumerate(getattr(bus, f"fault_ticks_{g}")):
                acts = bus.ticks > event
                for p, plane in enumerate(group.planes):
                    new = values[j * len(group.planes) + p]
                    if group.grows:
                        share = ((bus.ticks - event) * getattr(bus, f"fault_growth_{g}")[j]).to(new.dtype)
                        new = torch.where(share < 1.0, planes[plane] + share * (new - planes[plane]), new)
                    planes[plane] = torch.where(acts, new, planes[plane])
            layout.put(bus, planes)

    return let_faults_act


def severities(faults: Sequence[Fault], values: Values, ticks: Tensor, h_ns: int) -> Tensor:
    """Return the share of the change of each fault that acts after so many ``ticks`` [n], from 0 to 1, [n, F]."""
    plan, now = Plan(tuple(faults), (), (), h_ns), ticks.double()
    shares = []
    for fault, begin, end in zip(faults, *plan.begins_and_ends(values), strict=True):
        acts = ((begin <= now) & (now < end) & (begin < NEVER)).double()
        grown = ((now - begin) * (h_ns * 1e-9 / fault.over)).clamp(0.0, 1.0) if fault.over > 0.0 else 1.0
        shares.append(acts * grown)
    return torch.stack(shares, -1)
