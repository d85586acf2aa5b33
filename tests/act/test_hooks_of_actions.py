"""Every hook of a subclass runs, whatever other actions a satellite has; what would not run is refused when it is defined."""

import pytest
import torch
from tensordict import TensorDict

from bsk_torch import SatelliteTasking, act, data, obs, sats, scene
from bsk_torch.presets.nadir_scan import ScanningSatellite
from tests.support.episodes import begun
from tests.support.refusals import check_refusals, refusal

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
        env = begun(make(Recorded(), kind))
        step(env, 0, 1)
        entry = env.satellite.actions.entries[0]
        assert entry.calls == [("begin", [True, False], [40.0, 50.0]), ("end", [True, False], [False, False])]

    def test_decide(self, kind):
        env = begun(make(Quick(), kind))
        assert step(env, 0, 1) == [7.0, 50.0]

    def test_table_and_names(self, kind):
        env = begun(make(Twice(), kind))
        assert env.satellite.action_description[:2] == ["short", "long"]
        assert (step(env, 0, 1), step(env, 2, 1)) == ([11.0, 13.0], [50.0, 13.0])

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
    env = begun(make(Twice(), "mixed"))
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


def define(*bases, **members):
    return type("Mine", bases or (act.Charge,), members)


def test_rejects_hooks_that_would_not_run():
    mixin = type("Mixin", (), dict(set_action=lambda self, action: None))
    decides = lambda self, index, mask, action, previous: None
    check_refusals(
        refusal(lambda: define(set_action=lambda self, action, prev_action_key=None: None), TypeError, "set_action", "decide"),
        refusal(lambda: define(set_action_override=lambda self, action: None), TypeError, "set_action_override", "bsk_rl"),
        refusal(lambda: define(reset_post_sim_init=lambda self: None), TypeError, "reset_post_sim_init", "bsk_torch.bsk_rl"),
        refusal(lambda: define(space=property(lambda self: None)), TypeError, "Mine.space", "n_actions"),
        refusal(lambda: define(decides=decides), TypeError, "Mine.decides", "'decide'"),
        refusal(lambda: define(ends=lambda self, mask, decision, event: None), TypeError, "Mine.ends", "'end'"),
        refusal(lambda: define(link_satelite=lambda self, satellite: None), TypeError, "link_satelite", "'link_satellite'"),
        refusal(lambda: define(begin=lambda self, mask: None), TypeError, "begin(self, mask)", "begin(mask, decision)"),
        refusal(lambda: define(end=lambda self, mask, decision: None), TypeError, "Mine.end", "end(mask, decision, event)"),
        refusal(lambda: define(names=["charge"]), TypeError, "Mine.names", "value", "method"),
        refusal(lambda: define(n_actions=lambda self: 2), TypeError, "Mine.n_actions", "method", "value"),
        refusal(lambda: define(decide=lambda self, *args: None, table=lambda self: None), TypeError, "table()", "decide()"),
        refusal(lambda: define(mixin, act.Charge), TypeError, "Mine.set_action"),
    )


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


def made(**members):
    return make(define(**members)(duration=40.0), "fixed")


def test_rejects_entries_that_do_not_fit():
    check_refusals(
        refusal(lambda: made(link_satellite=lambda self, satellite: None), TypeError, "super().link_satellite(satellite)"),
        refusal(lambda: made(n_actions=2, names=lambda self: ["one"]), ValueError, "names()", ["one"], "n_actions=2"),
        refusal(lambda: made(n_actions=0), ValueError, "Mine.n_actions", 0),
        refusal(lambda: made(n_actions=1.0), ValueError, "Mine.n_actions", 1.0),
    )


def test_rejects_results_that_do_not_fit():
    run = lambda **members: made(**members).rollout(1)
    decided = lambda **fields: run(decide=lambda self, *args: act.Charge.decide(self, *args)._replace(**fields))
    boolean, one = torch.ones(2, dtype=torch.bool), torch.ones(1)
    check_refusals(
        refusal(lambda: run(n_actions=2), TypeError, "Mine.table().mode", [2, 1], [2, 2]),
        refusal(lambda: run(table=lambda self: None), TypeError, "table()", None),
        refusal(lambda: decided(duration=one), TypeError, "duration", [1], "torch.float32", [2], "torch.float64"),
        refusal(lambda: decided(mode=3), TypeError, "mode", 3, [2]),
        refusal(lambda: run(mask=lambda self: boolean), TypeError, "mask()", [2], [2, 1]),
        refusal(lambda: run(mask=lambda self: torch.ones(2, 1)), TypeError, "mask()", "torch.float32", "torch.bool"),
    )
