"""Episodes as tools: the in-memory client of the protocol's library, and the command over standard input and output."""

import asyncio
import sys

import pytest
import torch
from mcp import Client, StdioServerParameters

import bsk_torch
from bsk_torch.lab.agents.game import MOST_ACTIONS, MOST_PLANS, Game
from bsk_torch.lab.agents.server import serve
from bsk_torch.rl.evaluation.evaluate import evaluate
from tests.support.episodes import unchanged
from tests.support.refusals import check_refusals, refusal

pytestmark = pytest.mark.compiled

SCAN, CHARGE = "action_nadir_scan", "action_charge"


@pytest.fixture(scope="module")
def env():
    return bsk_torch.make("NadirScan-v1", num_envs=1, env_ids=[0], time_limit=600.0)


def called(server, *calls):
    """Return the content of each call of a tool, or its error's text."""

    async def call():
        async with Client(server) as client:
            results = [await client.call_tool(name, arguments) for name, arguments in calls]
        return [r.content[0].text if r.is_error else r.structured_content for r in results]

    return asyncio.run(call())


def test_what_happens_is_what_was_looked_at(env):
    """Whatever the other plans are; and nothing is changed by looking."""
    game = Game(env, [4])
    with unchanged(env):
        looked = game.what_if([[CHARGE], [SCAN, CHARGE, SCAN], [CHARGE] * MOST_ACTIONS])
    assert [future["taken"] for future in looked] == [1, 3, 5]  # five steps of 120 s reach the end of 600 s
    assert [future["ended"] for future in looked] == [False, False, True]
    done = game.commit([SCAN, CHARGE, SCAN])
    assert {name: looked[1][name] for name in ("taken", "reward", "seconds", "ended")} == done
    assert game.observe()["observation"] == looked[1]["observation"]


def test_cases_follow_one_another_and_are_those_of_evaluations(env):
    server = serve(Game(env, [4, 5]), "Scan")
    steps = [("observe", {}), ("commit", {"actions": [SCAN] * 4}), ("observe", {}), ("commit", {"actions": [SCAN] * 8})]
    first, ended, second, last, report, after = called(server, *steps, ("report", {}), ("observe", {}))
    assert (first["case"], first["seed"], second["case"], second["seed"]) == (1, 4, 2, 5)
    assert ended["ended"]
    assert last["taken"] == 4
    assert after == {"finished": True, "cases": 2}
    assert [result["seed"] for result in report["results"]] == [4, 5]
    scans = lambda td: td.set("action", torch.zeros(td.batch_size, dtype=torch.int64))
    returns = evaluate(scans, env, seeds=[4, 5]).returns
    assert [result["return"] for result in report["results"]] == pytest.approx(returns.tolist(), rel=1e-5)


def test_a_plan_stops_before_an_illegal_action(env):
    game = Game(env, [4])
    game.situation["action_mask"][0, game.names.index(CHARGE)] = False  # here every action is legal at all times
    assert [future["taken"] for future in game.what_if([[CHARGE], [SCAN, CHARGE]])] == [0, 2]
    check_refusals(refusal(lambda: game.commit([CHARGE]), ValueError, CHARGE, "illegal now"))


def test_wrong_calls_are_answered_by_texts(env):
    calls = {
        "nadir_scan": ("what_if", {"plans": [["action_nadir_scam"]]}),
        "at least 1": ("what_if", {"plans": [[]]}),
        f"at most {MOST_PLANS}": ("what_if", {"plans": [[SCAN]] * (MOST_PLANS + 1)}),
        f"at most {MOST_ACTIONS}": ("commit", {"actions": [SCAN] * (MOST_ACTIONS + 1)}),
        "at most 200": ("commit", {"actions": ["x" * 1000]}),
        "valid string": ("commit", {"actions": [3]}),
        "all cases have ended": ("list_actions", {}),
    }
    *wrong, late = calls.values()
    *texts, _, too_late = called(serve(Game(env, [0]), "Scan"), *wrong, ("commit", {"actions": [SCAN] * 4}), late)
    for expected, text in zip(calls, [*texts, too_late], strict=True):
        assert expected in text


def test_rejects_what_has_no_numbered_actions():
    team = bsk_torch.make("Constellation-v1", n_satellites=3, n_targets=100, backend="eager")
    check_refusals(refusal(lambda: Game(team, [0]), ValueError, "one satellite"))


def test_the_command_serves_over_standard_input_and_output():
    program = "from bsk_torch.cli import app; app()"
    server = StdioServerParameters(command=sys.executable, args=["-c", program, "mcp", "NadirScan-v1", "--seeds", "3:5"])
    (observed,) = called(server, ("observe", {}))
    assert (observed["seed"], observed["cases"]) == (3, 2)
