"""A small dataset that several tests read."""

from __future__ import annotations

import pytest

from bsk_torch.lab.offline import Behavior, Recipe, open_dataset, write_dataset
from bsk_torch.rl.policies.pretrained import pretrained
from bsk_torch.rl.policies.shared_policy import rule
from tests.lab.planners.conftest import scanning

LIMIT = 1800.0
"""Length of the episodes, s."""


def recipe(env, **changed):
    """Two episodes of three behaviors, valued for the pretrained policy and the rule."""
    policy = pretrained("NadirScan-v1")
    given = dict(
        preset="NadirScan-v1",
        behaviors=[Behavior("random", None, 1.0), Behavior("pretrained", policy), Behavior("pretrained,random=0.4", policy, 0.4)],
        seeds=range(11, 14),
        share=0.3,
        options={"time_limit": LIMIT},
    )
    if "targets" not in changed:
        given["targets"] = {"pretrained": policy, "rule": rule("rule", env)}
    return Recipe(**(given | changed))


@pytest.fixture(scope="session")
def written(tmp_path_factory):
    """The dataset, also in Minari's format."""
    pytest.importorskip("minari")
    folder = tmp_path_factory.mktemp("offline") / "scan"
    env = scanning(2, LIMIT)
    write_dataset(folder, env, recipe(env, minari=True))
    return open_dataset(folder)
