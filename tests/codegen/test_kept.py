"""Which compiled functions a process keeps, and for how long."""

import functools

import pytest

from bsk_torch.codegen.kept import Kept, of_package
from bsk_torch.sim.dyn import hub
from bsk_torch.sim.dyn.power import balance as power


def test_the_values_that_were_used_last_are_kept_but_none_whose_making_fails():
    kept, made = Kept(2), []

    def get(key):
        return kept.get(key, lambda: made.append(key) or key)

    for key in ("a", "b", "a", "c", "a", "b"):
        assert get(key) == key
    assert made == ["a", "b", "c", "b"]  # b was the one that had not been used for longest when c came
    kept = Kept(2)
    with pytest.raises(ZeroDivisionError):
        kept.get("a", lambda: 1 / 0)
    assert kept.get("a", lambda: 1) == 1


def enclosing(function):
    def update(bus):
        function(bus)

    update.__module__ = hub.__name__
    return update


def test_functions_of_the_package():
    """Those that enclose functions of the package, or plain values, are too; all others may change."""
    sinks = [part.update for part in vars(power).values() if getattr(part, "slot", None) == "base_power"]
    assert sinks
    assert sinks[0].__closure__
    assert of_package([hub.rotate, *sinks, enclosing(hub.rotate)])
    for function in (enclosing, enclosing(enclosing), functools.partial(hub.rotate), abs):
        assert not of_package([hub.rotate, function])
