"""Short flights of the scanning satellite with given arguments."""

from typing import Any

import torch

from bsk_torch import SatelliteTasking
from bsk_torch.presets.nadir_scan import ScanningSatellite

SCAN, CHARGE, DOWNLINK, DESAT = range(4)
"""Numbers of actions."""


def fly(args: dict[str, Any], actions: tuple[int, ...] = (SCAN, DOWNLINK), **options: Any) -> SatelliteTasking:
    """Return an environment of three satellites after some actions, each of which lasts half a minute at the most."""
    short = {"num_envs": 3, "backend": "eager", "max_step_duration": 30.0}
    env = SatelliteTasking(ScanningSatellite("A", args), seed=0, time_limit=900.0, **short | options)
    td = env.reset()
    for action in actions:
        td = env.step(td.set("action", torch.full(env.batch_size, action)))["next"]
    return env
