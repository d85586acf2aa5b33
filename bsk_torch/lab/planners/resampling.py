"""Resampling of futures and hidden states, and random numbers of planners; all draws are determined by keys of the episodes."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from bsk_torch.env import Tasking
from bsk_torch.rand import Key
from bsk_torch.scene import CloudyTargets
from bsk_torch.scene.draws import draw_numbers

Redraw = Callable[[Tasking, Tensor, Key], None]
"""Function that redraws hidden quantities: ``redraw(env, envs, key)`` writes into rows ``envs`` [n] of the state of ``env``."""


def present_key(env: Tasking, rows: Tensor, env_ids: Tensor, name: str) -> Key:
    """Return the key of the current time of episodes, which differs at every time and is the same in every batch.

    Args:
        env: The environment, or a model of it.
        rows: Rows of the environment, [n].
        env_ids: Indices of their episodes in draws, [n].
        name: Name of the draw.
    """
    state, ticks = env.state, env.fleet.ticks
    return Key(state.seed[rows].cpu(), env_ids.cpu(), state.episode[rows].cpu(), name, moment=ticks[rows].cpu())


def reseed_copies(env: Tasking, rows: Tensor, lots: Tensor, key: Key, redraw: Redraw | None) -> None:
    """Set the seeds of copied episodes, draw their faults to come again, and redraw hidden states.

    Args:
        env: A model.
        rows: Its rows with the copies, [n].
        lots: Random numbers that determine the seeds, [n] in [0, 1).
        key: Key with the indices of the episodes, [n].
        redraw: Redraws hidden states.
    """
    seeds = (lots * 2.0**53).long()
    env.state.seed = env.state.seed.index_copy(0, rows, seeds.to(env.device))
    future = Key(seeds, key.env_id, key.episode)
    for simulator in env.fleet.simulators:
        simulator.draw_faults_again(rows, future)
    if redraw is not None:
        redraw(env, rows, future)


def redraw_clouds(env: Tasking, envs: Tensor, key: Key, candidates: int = 64) -> None:
    """Redraw the true cloud cover over all targets, given its forecast: a :data:`Redraw` for ``scene.CloudyTargets``.

    One of ``candidates`` covers from the scenario's distribution is chosen with a probability proportional to the likelihood of
    the forecast (sampling-importance resampling, Rubin 1987). Forecasts of 0 and 1 are clamped, so their likelihood is that of
    all values beyond.

    Raises:
        ValueError: For a scenario without clouds.
    """
    scenario = env.scenario
    if not isinstance(scenario, CloudyTargets):
        raise ValueError(f"redraw=redraw_clouds needs scene.CloudyTargets; the scenario is {type(scenario).__name__}")
    forecast, sigma = scenario.cloud_forecast[envs], scenario.cloud_forecast_sigma[envs].clamp(min=1e-6)
    best = torch.full_like(forecast, -torch.inf)
    chosen = forecast
    for k in range(candidates):  # in a loop, because all at once would need ``candidates`` times the memory
        cover = draw_numbers("cover", scenario.cover, key.named(f"redrawn cover {k}"), scenario.most_targets)
        cover = cover.clamp(0.0, 1.0).to(forecast.device)
        z = (forecast - cover) / sigma
        below, above = torch.special.log_ndtr(z), torch.special.log_ndtr(-z)
        weight = torch.where(forecast <= 0.0, below, torch.where(forecast >= 1.0, above, -0.5 * z.square() - sigma.log()))
        lot = key.named(f"redrawn lot {k}").uniform(forecast.shape[1]).to(forecast.device)
        weight = weight - torch.log(-torch.log(lot.clamp(1e-300, 1.0 - 1e-16)))  # Gumbel: the largest one is a draw by weights
        chosen, best = torch.where(weight > best, cover, chosen), torch.maximum(weight, best)
    env.fleet.scenario_state["cloud_cover"][envs] = chosen
    scenario.begin_episodes(envs)
