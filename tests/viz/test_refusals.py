"""Environments that are not recorded, for want of what is drawn."""

import pytest

pytest.importorskip("matplotlib")

import bsk_torch
from bsk_torch.viz.episodes import record
from tests.support.refusals import check_refusals, refusal


def test_rejects_environments_that_cannot_be_drawn():
    made = lambda name, **options: bsk_torch.make(name, num_envs=1, backend="eager", **options)
    requests = made("AEOSConstellation-v1", joint=True)
    crew = made("Constellation-v1", n_satellites=3, n_targets=300, joint=True, time_limit=60.0)
    table = [
        refusal(lambda: record(lambda td: td, requests, seed=0), ValueError, "env", "joint=True"),
        refusal(lambda: record(lambda td: td, crew, seed=1), ValueError, "env", "joint=True"),
    ]
    check_refusals(table)
