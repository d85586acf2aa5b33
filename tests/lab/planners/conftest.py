"""Small tasks to plan in."""

from __future__ import annotations

import math

import pytest
import torch
from tensordict.nn import TensorDictModule

import bsk_torch

ENDLESS = {"horizon": math.inf, "gamma": 1.0}
"""Options of planners that look ahead to the end of the episode and add up rewards: their model is exact."""


def scanning(n=3, limit=1500.0, **options):
    """Episodes by seed of NadirScan-v1."""
    return bsk_torch.make("NadirScan-v1", num_envs=n, env_ids=[0] * n, time_limit=limit, seed=0, **options)


def always(action):
    """A policy that knows one action."""
    return TensorDictModule(
        lambda mask: torch.full(mask.shape[:1], action, dtype=torch.int64), in_keys=["action_mask"], out_keys=["action"]
    )


def same(one, other):
    """Whether two states are equal, bit for bit, but for how far orbits have been solved ahead."""
    found, wanted = ({key: value for key, value in part.items(True, True) if "lookahead" not in key} for part in (one, other))
    return found.keys() == wanted.keys() and all(torch.equal(_bits(value), _bits(wanted[key])) for key, value in found.items())


def _bits(value):
    return value.view(torch.int64) if value.dtype == torch.float64 else value


@pytest.fixture(scope="module")
def env():
    """Three episodes at once."""
    return scanning()
