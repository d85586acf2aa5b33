"""No state, whoever has written it, crashes the process or changes half an environment; see ``crafted.py``."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
import torch

import bsk_torch
from bsk_torch.sim.state import StateTable
from tests.env import crafted

pytestmark = pytest.mark.compiled


def attack(columns: int, *names: str) -> dict[str, dict]:
    command = [sys.executable, "-m", "tests.env.crafted", str(columns), *names]
    run = subprocess.run(command, cwd=Path(__file__).parents[2], capture_output=True, text=True, timeout=900, check=False)
    assert run.returncode == 0, f"{run.returncode}: {run.stderr[-2000:]}"
    return json.loads(run.stdout.splitlines()[-1])


def assert_ended_well(result: dict) -> None:
    assert result["wrong"] == []
    assert result["ends"]["refused"] > 100
    assert result["ends"]["played"] > 10  # numbers that are possible


@pytest.mark.parametrize("name", ["NadirScan-v1", "Constellation-v1"])
@pytest.mark.nightly("Constellation-v1")
def test_spoilt_states(name):
    assert_ended_well(attack(1, name)[name])


@pytest.mark.parametrize("name", crafted.PRESETS)
@pytest.mark.nightly
def test_all_spoilt_states(name):
    assert_ended_well(attack(8, name)[name])


UNBOUNDED = {
    "seed": "every integer is one",
    "previous_action": "keys of users' actions may be any integers",
    "planes": "bounds of the components' fields",
    "parameters": "must follow from the arguments",
    "et": "must be the argument utc_init",
}


def unbounded(table: StateTable) -> set[str]:
    """Names of numbers without bounds in a tree of tables."""
    own = {name for name, field in table.fields.items() if field.low is None and table[name].dtype != torch.bool}
    return own.union(*(unbounded(part) for part in table.tables.values())) if table.tables else own


@pytest.mark.parametrize("name", crafted.PRESETS)
def test_every_number_of_a_state_has_bounds(name):
    env = bsk_torch.make(name, num_envs=2, **crafted.PRESETS[name])
    tables = [simulator.state.arguments for simulator in env.fleet.simulators]
    assert unbounded(env.state) - {"values"} <= set(UNBOUNDED)
    assert all(table.fields["values"].low is not None for table in tables)
