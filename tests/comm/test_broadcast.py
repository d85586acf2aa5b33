"""The action; what becomes of its messages is in test_comm."""

from types import SimpleNamespace

import torch

from bsk_torch import act
from bsk_torch.act.base import LONGEST, ActionBuilder
from bsk_torch.act.discrete import PENDING
from bsk_torch.sim.state import StateTable

DRIFT, NADIR = 0, 3
MOVES = torch.ones(4, dtype=torch.bool)


def make_satellite(n: int = 4) -> SimpleNamespace:
    """As much of a satellite as actions look at; it has been pointing at nadir."""
    simulator = SimpleNamespace(
        memory=StateTable(n),
        mode=torch.full((n,), NADIR),
        ticks=torch.zeros(n, dtype=torch.int64),
        state=SimpleNamespace(arguments=SimpleNamespace(version=0)),
        type=SimpleNamespace(commands={"drift": None}),
        mode_names=("drift", "charge", "scan", "nadir"),
        check_command=lambda command: None,
        mode_index=lambda command: torch.full((n,), DRIFT),
    )
    return SimpleNamespace(simulator=simulator)


def make_actions(*spec: act.Action) -> tuple[ActionBuilder, StateTable]:
    satellite = make_satellite()
    return ActionBuilder(spec, satellite), satellite.simulator.memory


def test_broadcasts_wait_and_are_pending_where_satellites_move():
    """Rows: drift, broadcast, the same broadcast again, drift after a broadcast."""
    actions, _ = make_actions(act.Drift(), act.Broadcast(duration=30.0))
    decision = actions.decide(torch.tensor([0, 1, 1, 0]), torch.tensor([-1, 0, 1, 1]), MOVES)
    assert decision.retask.tolist() == [True, False, False, True]
    assert decision.mode.tolist() == [DRIFT, NADIR, NADIR, DRIFT]
    assert decision.duration.tolist() == [LONGEST, 30.0, 30.0, LONGEST]
    assert decision.key.tolist() == [0, 1, 1, 0]
    actions, memory = make_actions(act.Drift(), act.Broadcast())
    action, moves = torch.tensor([0, 1, 1, 0]), torch.tensor([True, True, False, False])
    assert not memory[PENDING].any()
    actions.begin(action, moves, actions.decide(action, torch.full((4,), -1), moves))
    assert memory[PENDING].tolist() == [False, True, False, False]
    actions.begin(torch.zeros_like(action), moves, actions.decide(torch.zeros_like(action), action, moves))
    assert memory[PENDING].tolist() == [False, True, False, False]  # another action does not call it back
    memory.reset(torch.tensor([1]))
    assert not memory[PENDING].any()


def test_names_and_two_broadcasts_of_one_satellite():
    """They share what is pending."""
    actions, memory = make_actions(act.Broadcast(), act.Broadcast("shout", duration=5.0))
    assert actions.description == ["action_broadcast", "shout"]
    action = torch.tensor([0, 1, 1, 0])
    moves = torch.tensor([True, True, False, False])
    actions.begin(action, moves, actions.decide(action, action, moves))
    assert memory[PENDING].tolist() == [True, True, False, False]
