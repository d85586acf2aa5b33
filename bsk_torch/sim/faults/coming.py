"""Faults that have not happened yet, drawn again as far as the past does not rule it out; for planners that do not know them."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from bsk_torch.rand import Key
from bsk_torch.sim.component import Values
from bsk_torch.sim.faults.declared import Fault, ticks_of

ROUNDS = 14  # rounds of candidates, 1, 2, 4 ... for each episode that has none that fits: 16,383 in all.

Draw = Callable[[Sequence[str], Key], Values]
"""Function that returns the arguments of some names, drawn for the key's n environments: [n * S, ...], or [1, ...] if equal."""


def drawn_again(faults: Sequence[Fault], values: Values, ticks: Tensor, h_ns: int, key: Key, draw: Draw) -> dict[str, Tensor]:
    """Return the arguments of faults, [n * S, ...] by name, with what has not happened yet drawn again with a key of n.

    A fault that has not begun gets another beginning, duration and change; one that acts another duration, if it has one. These
    follow the given distributions on the condition that nothing happens before now: of candidates drawn from the distributions,
    the first one that fits is taken (rejection sampling). What has happened remains, and so do beginnings and durations that no
    candidate fits, which are the last instants in which something can happen at all. ``values`` are arguments of S satellites
    in n episodes, [n * S, ...] each, which are ``ticks`` [n * S] of ``h_ns`` nanoseconds old.
    """
    redrawn: dict[str, Tensor] = {}
    for fault in faults:
        redrawn |= _drawn_again(fault, values, ticks.double().view(len(key), -1), h_ns, key, draw)
    return redrawn


def _drawn_again(fault: Fault, values: Values, now: Tensor, h_ns: int, key: Key, draw: Draw) -> dict[str, Tensor]:
    at, lasts = fault.drawn("at"), fault.drawn("lasts") if fault.ends else None
    names = [at, *([lasts] if lasts else ()), *map(fault.drawn, fault.arguments)]
    redrawn: dict[str, Tensor] = {name: values[name].unflatten(0, now.shape).clone() for name in names}
    comes = ticks_of(redrawn[at], h_ns) > now
    open_ = comes | (ticks_of(redrawn[at] + redrawn[lasts], h_ns) > now) if lasts else comes
    waits = open_
    for number in range(ROUNDS):
        episodes = torch.nonzero(waits.any(1)).squeeze(1)
        if not len(episodes):
            break
        drawn = _candidates(names, episodes, 2**number, now.shape[1], key, draw)
        begins = torch.where(comes[episodes].unsqueeze(1), drawn[at], redrawn[at][episodes].unsqueeze(1))
        happens = torch.where(comes[episodes].unsqueeze(1), begins, begins + drawn[lasts]) if lasts else begins
        fits = ticks_of(happens, h_ns) > now[episodes].unsqueeze(1)
        taken, first = fits.any(1) & waits[episodes], fits.long().argmax(1)
        episode, satellite = torch.arange(len(episodes)).unsqueeze(1), torch.arange(now.shape[1])
        for name in names:
            where = taken & (open_ if name == lasts else comes)[episodes]
            old, new = redrawn[name][episodes], drawn[name][episode, first, satellite]
            redrawn[name][episodes] = torch.where(where.view(*where.shape, *[1] * (new.ndim - 2)), new, old)
        waits = waits.index_copy(0, episodes, waits[episodes] & ~taken)
    return {name: value.flatten(0, 1) for name, value in redrawn.items()}


def _candidates(names: Sequence[str], episodes: Tensor, several: int, count: int, key: Key, draw: Draw) -> dict[str, Tensor]:
    """Return ``several`` candidates for the arguments of each of the ``episodes`` [e] of a key, [e, several, S, ...]."""
    each = key.take(episodes.repeat_interleave(several).tolist())
    number = torch.arange(several, 2 * several).repeat(len(episodes))  # which no other round has
    drawn = draw(names, dataclasses.replace(each, episode=each.episode + (number << 32)))
    shape = len(episodes), several, count
    return {name: drawn[name].expand(len(each) * count, *drawn[name].shape[1:]).unflatten(0, shape) for name in names}
