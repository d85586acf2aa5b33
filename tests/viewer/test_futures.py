"""Branches of recorded flights, and values of actions."""

import numpy as np
import pytest

import bsk_torch
from bsk_torch.recording.recording import decode
from bsk_torch.rl.policies.shared_policy import rule
from bsk_torch.viewer.futures import Futures
from tests.support.refusals import check_refusals, refusal


@pytest.fixture(scope="module")
def futures():
    env = bsk_torch.make("NadirScan-v1", num_envs=1, env_ids=[0], time_limit=2400.0)
    found = Futures(env, rule("rule", env), preset="NadirScan-v1", label="rule")
    found.episode(5)
    return found


@pytest.fixture(scope="module")
def forked(futures):
    choice = futures.flown[0].choices[4]
    other = (choice.action + 1) % len(choice.mask)
    return futures.branch(0, 4, other), other


def test_branch_shares_the_past_and_takes_the_other_action(futures, forked):
    track, other = forked
    first, second = (futures.flown[k].track for k in (0, track))
    time = first.arrays["decision_time"][4]
    assert second.parent == 0
    assert second.branch.time == time
    assert second.arrays["decision_action"][4] == other != first.arrays["decision_action"][4]
    assert (second.arrays["decision_action"][:4] == first.arrays["decision_action"][:4]).all()
    ticks = round(time / first.attitude_step) + 1
    assert (second.arrays["sigma"][:ticks] == first.arrays["sigma"][:ticks]).all()
    assert not np.array_equal(second.arrays["sigma"], first.arrays["sigma"])


def test_values_are_the_returns_of_branches(futures, forked):
    track, other = forked
    values = futures.values(0, 4)
    for k in (0, track):
        flown = futures.flown[k].track
        rest = flown.arrays["decision_reward"][4:].astype("f8").sum()
        assert values[flown.arrays["decision_action"][4]] == pytest.approx(rest, abs=1e-5)
    assert futures.flown[0].track.arrays["decision_action_value"][4, other] == pytest.approx(values[other])


def test_recording_holds_all_flights(futures, forked):
    read = decode(futures.recording().encode())
    assert [track.parent for track in read.tracks][:2] == [None, 0]
    assert read.tracks[1].branch.decision == 4
    assert "rule, seed 5" in read.title


def test_rejects_impossible_branches(futures):
    env = bsk_torch.make("CWDocking-v1", num_envs=1, env_ids=[0], time_limit=20.0)
    thrust = Futures(env, rule("glide", env))
    thrust.episode(0)
    table = [
        refusal(lambda: futures.branch(9, 0, 0), IndexError, "track=9"),
        refusal(lambda: futures.branch(0, 999, 0), IndexError, "decision=999"),
        refusal(lambda: futures.branch(0, 0, 99), ValueError, "action=99", "decision 0", [0, 1, 2, 3]),
        refusal(lambda: thrust.values(0, 0), ValueError, "decision 0", "real numbers"),
    ]
    check_refusals(table)


def test_branch_of_one_satellite_of_a_constellation():
    env = bsk_torch.make("HeteroCluster-v1", num_envs=1, env_ids=[0], time_limit=600.0)
    futures = Futures(env, rule("cooperative", env))
    futures.episode(1)
    choice = next(c for c in futures.flown[0].choices if c.satellite == 2)
    decision = futures.flown[0].choices.index(choice)
    other = next(k for k, legal in enumerate(choice.mask) if legal and k != choice.action)
    second = futures.flown[futures.branch(0, decision, other)].track
    assert second.arrays["decision_action"][decision] == other
    assert second.branch.satellite == 2
    values = futures.values(0, decision)
    assert values[other] == pytest.approx(sum(c.reward for c in futures.flown[1].choices if c.time >= choice.time), abs=1e-4)
