"""Every hook of a subclass runs, whatever other actions a satellite has; what would not run is refused when it is defined."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict

from bsk_torch import SatelliteTasking, act, data, obs, sats, scene
from bsk_torch.presets.nadir_scan import ScanningSatellite

FIELDS = act.Decision._fields[:5]  # the last one is for continuous actions


class Recorded(act.Charge):
    """Notes the calls of its hooks, and charges for 40 s."""

    def __init__(self):
        super().__init__(duration=40.0)
        self.calls = []

    def begin(self, mask, decision):
        self.calls.append(("begin", mask.tolist(), decision.duration.tolist()))

    def end(self, mask, decision, event):
        self.calls.append(("end", mask.tolist(), event.tolist()))


class Quick(act.Charge):
    def decide(self, index, mask, action, previous):
        return super().decide(index, mask, action, previous)._replace(duration=torch.full((len(index),), 7.0).double())


class Twice(act.Charge):
    """Two charges of different durations, in one table."""

    n_actions = 2

    def table(self):
        mode, reset, _ = super().table()
        return act.ActionTable(mode.expand(-1, 2), reset.expand(2), torch.tensor([11.0, 13.0], dtype=torch.float64))

    def names(self):
        return ["short", "long"]


class Masked(act.Charge):
    def mask(self):
        return torch.tensor([[True], [False]])


SPECS = {
    "fixed": (act.Scan(duration=50.0), act.Drift(duration=30.0)),
    "mixed": (act.Scan(duration=50.0), act.Image(2, max_duration=30.0)),
}
"""Lists that come with the subclass: of fixed commands only, and with one that decides in every step."""


pytestmark = pytest.mark.compiled


def make(entry, kind, num_envs=2):
    rest = SPECS[kind] if kind == "fixed" else (act.NadirPoint(duration=50.0), SPECS[kind][1])
    attributes = {"action_spec": (entry, *rest), "observation_spec": (obs.Time(norm=1.0),)}
    if kind == "fixed":
        satellite, scenario = type("Scanner", (ScanningSatellite,), attributes)("A"), scene.Scenario()
    else:
        satellite, scenario = type("Imager", (sats.ImagingSatellite,), attributes)("A"), scene.UniformTargets(400)
    return SatelliteTasking(satellite, scenario, data.NoReward(), num_envs=num_envs, time_limit=600.0, seed=1)


def step(env, *action):
    return env.step(TensorDict({"action": torch.tensor(action)}, env.batch_size))["next"]["duration"].flatten().tolist()


@pytest.mark.parametrize("kind", SPECS)
class TestHooksRun:
    def test_begin_and_end(self, kind):
        env = make(Recorded(), kind)
        env.reset()
        step(env, 0, 1)
        entry = env.satellite.actions.entries[0]
        assert entry.calls == [
            ("begin", [True, False], [40.0, 50.0]),
            ("end", [True, False], [False, False]),
        ]

    def test_decide(self, kind):
        env = make(Quick(), kind)
        env.reset()
        assert step(env, 0, 1) == [7.0, 50.0]

    def test_table_and_names(self, kind):
        env = make(Twice(), kind)
        env.reset()
        assert env.satellite.action_description[:2] == ["short", "long"]
        assert step(env, 0, 1) == [11.0, 13.0]
        assert step(env, 2, 1) == [50.0, 13.0]

    def test_mask(self, kind):
        env = make(Masked(), kind)
        assert env.reset()["action_mask"].tolist()[1][0] is False
        assert env.reset()["action_mask"].all(1).tolist() == [True, False]

    def test_an_instance_may_have_hooks_of_its_own(self, kind):
        env = make(act.Charge(duration=40.0), kind)
        entry, calls = env.satellite.actions.entries[0], []
        entry.end = lambda mask, decision, event: calls.append(mask.tolist())
        env.satellite.actions.__init__(env.satellite.actions.entries, env.satellite)
        env.reset()
        step(env, 0, 1)
        assert calls == [[True, False]]


def test_fixed_commands_are_those_of_every_entry_alone():
    """A mixed list gives each entry's action the commands that the entry has alone."""
    env = make(Twice(), "mixed")
    env.reset()
    actions = env.satellite.actions
    every, previous = torch.ones(2, dtype=torch.bool), torch.tensor([0, 2])
    for number, entry, index in ((0, 0, 0), (1, 0, 1), (2, 1, 0), (3, 2, 0), (4, 2, 1), (-3, 2, 0)):
        action = torch.full((2,), number)
        if number == -3:
            action = act.image_target(env.satellite.find_next_opportunities(1).place.squeeze(1))
        mine = actions.entries[entry].decide(torch.full((2,), index), every, action, previous)
        for field, one, other in zip(FIELDS, actions.decide(action, previous, every), mine, strict=False):
            assert torch.equal(one, other), (number, field)
        assert actions.entry_of(number) == entry


def define(base=act.Charge, **members):
    return type("Mine", (base,), members)


@pytest.mark.parametrize(
    ("members", "words"),
    [
        (dict(set_action=lambda self, action, prev_action_key=None: None), "set_action is never used; define decide"),
        (dict(set_action_override=lambda self, action: None), "integers"),
        (dict(reset_post_sim_init=lambda self: None), r"memory\.declare"),
        (dict(reset_pre_sim_init=lambda self: None), r"memory\.declare"),
        (dict(space=property(lambda self: None)), "set n_actions"),
        (dict(explicit=property(lambda self: 3)), "n_negative_actions"),
        (dict(decides=lambda self, index, mask, action, previous: None), "did you mean 'decide'"),
        (dict(ends=lambda self, mask, decision, event: None), "did you mean 'end'"),
        (dict(link_satelite=lambda self, satellite: None), "did you mean 'link_satellite'"),
        (dict(begin=lambda self, mask: None), r"begin\(self, mask\) cannot be called as begin\(mask, decision\)"),
        (dict(end=lambda self, mask, decision: None), r"cannot be called as end\(mask, decision, event\)"),
        (dict(names=["charge"]), "names is a value; it must be a method"),
        (dict(n_actions=lambda self: 2), "n_actions is a method; it must be a value"),
        (dict(decide=lambda self, *args: None, table=lambda self: None), "both table.. and decide"),
    ],
)
def test_what_would_not_run_is_refused_at_the_definition(members, words):
    with pytest.raises(TypeError, match=words):
        define(**members)


def test_what_is_refused_in_a_mixin():
    class Mixin:
        def set_action(self, action):
            pass

    with pytest.raises(TypeError, match=r"Mine\.set_action is never used"):
        type("Mine", (Mixin, act.Charge), {})


def test_helpers_are_free():
    class Mine(act.Charge):
        limit = 3

        def ends(self):  # is no hook: it takes other arguments
            return 3

        def _begins(self, mask, decision):
            pass

        def describe(self):
            return self.ends()

    assert Mine().describe() == 3


@pytest.mark.parametrize(
    ("members", "error", "words"),
    [
        (dict(link_satellite=lambda self, satellite: None), TypeError, r"must call super\(\)\.link_satellite\(satellite\)"),
        (dict(n_actions=2, names=lambda self: ["one"]), ValueError, r"must return n_actions=2 names"),
        (dict(n_actions=0), ValueError, "n_actions is 0"),
        (dict(n_actions=1.0), ValueError, r"n_actions is 1\.0"),
    ],
)
def test_what_does_not_fit_is_refused_when_it_is_linked(members, error, words):
    with pytest.raises(error, match=words):
        make(define(**members)(), "fixed")


@pytest.mark.parametrize(
    ("members", "words"),
    [
        (dict(n_actions=2), r"Mine\.table\(\)\.mode is a tensor of shape \[2, 1\] .* shape \[2, 2\]"),
        (dict(table=lambda self: None), r"table\(\) returns None"),
        (
            dict(decide=lambda self, *args: act.Charge.decide(self, *args)._replace(duration=torch.ones(1))),
            r"duration is a tensor of shape \[1\] and dtype torch.float32; .* shape \[2\] and dtype torch.float64",
        ),
        (dict(decide=lambda self, *args: act.Charge.decide(self, *args)._replace(mode=3)), "mode is 3; it must be a tensor"),
        (dict(mask=lambda self: torch.ones(2, dtype=torch.bool)), r"mask\(\) is a tensor of shape \[2\] .* shape \[2, 1\]"),
        (dict(mask=lambda self: torch.ones(2, 1)), "dtype torch.bool"),
    ],
)
def test_results_of_wrong_shape_or_dtype_are_named(members, words):
    env = make(define(**members)(duration=40.0), "fixed")
    with pytest.raises(TypeError, match=words):
        env.rollout(1)
