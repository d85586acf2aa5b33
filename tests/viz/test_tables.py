"""Recorded episodes as NumPy arrays and CSV files."""

from __future__ import annotations

import csv

import numpy as np
import pytest
import torch

import bsk_torch
from bsk_torch.recording.table import Tasks, satellite_columns
from bsk_torch.viz.episodes import record


@pytest.mark.compiled
def test_an_episode_is_a_table(tmp_path):
    env = bsk_torch.make("NadirScan-v1", num_envs=1, time_limit=900.0)
    episode = record(bsk_torch.rule("rule", env), env, seed=3)
    table = episode.to_numpy()
    rows = len(episode.times)
    assert rows > 3
    assert {len(column) for column in table.values()} == {rows}
    assert table["time"].tolist() == episode.times.tolist()
    assert np.nansum(table["reward"]) == pytest.approx(episode.total)
    assert set(table["action"][:-1]) <= set(episode.names)
    assert np.allclose(table["wheel_speeds_fraction_2"], episode.series["wheel_speeds_fraction"][:, 2])
    assert np.linalg.norm([table[f"r_BN_P_{k}"][0] for k in range(3)]) > 6.6e6
    path = episode.to_csv(tmp_path / "episode.csv")
    with path.open() as file:
        read = list(csv.DictReader(file))
    assert len(read) == rows
    assert [float(row["battery_charge_fraction"]) for row in read] == table["battery_charge_fraction"].tolist()
    assert read[-1]["action"] == ""


@pytest.mark.compiled
def test_an_episode_of_a_constellation_is_a_table(tmp_path):
    env = bsk_torch.make("RelayConstellation-v1", num_envs=2, time_limit=600.0)
    episode = record(bsk_torch.rule("random", env), env, seed=3)
    table = episode.to_numpy()
    names, steps = env.fleet.names, len(episode.times)
    assert steps > 3
    assert {len(column) for column in table.values()} == {steps * len(names)}
    assert table["satellite"].tolist() == list(names) * steps
    assert table["time"].reshape(steps, -1)[:, 0].tolist() == episode.times.tolist()
    assert np.nansum(table["reward"]) == pytest.approx(float(env.returns[0]))
    actions = table["action"].reshape(steps, -1)
    assert (actions[:-1] != "").all()
    assert (actions[-1] == "").all()
    assert table["decided"].sum() == len(episode.tasks.kind)
    assert table["decided"].reshape(steps, -1)[0].all()
    battery = env.fleet.each(lambda part: part.dynamics.battery_charge_fraction)[0]
    assert torch.equal(torch.from_numpy(table["battery_charge_fraction"].reshape(steps, -1)[-1]), battery)
    longitude = table["longitude"].reshape(steps, -1)
    assert np.allclose(longitude, episode.longitude.T)
    path = episode.to_csv(tmp_path / "team.csv")
    with path.open() as file:
        assert len(list(csv.DictReader(file))) == steps * len(names)


def test_satellites_without_a_quantity_have_nan():
    dead = ["a", "b"]
    times = torch.tensor([0.0, 10.0, 20.0])
    tasks = Tasks(
        torch.tensor([0, 1, 0]), torch.tensor([[0.0, 10.0], [0.0, 20.0], [10.0, 20.0]]), torch.tensor([0, 0, 1]), ["x", "y"]
    )
    deaths = torch.tensor([torch.inf, 10.0])
    table = satellite_columns(dead, times, deaths, tasks, {"reward": torch.tensor([[1.0, 2.0], [3.0, torch.nan]])})
    assert table["action"].tolist() == ["x", "x", "y", "", "", ""]
    assert table["decided"].tolist() == [True, True, True, False, False, False]
    assert table["alive"].tolist() == [True, True, True, False, True, False]
    assert table["reward"][:3].tolist() == [1.0, 3.0, 2.0]
    assert np.isnan(table["reward"][3:]).all()


@pytest.mark.compiled
@pytest.mark.parametrize("actions", ["thrust", "waypoints"])
def test_an_inspection_is_a_table(actions):
    env = bsk_torch.make("MultiInspection-v1", num_envs=1, time_limit=3000.0, actions=actions)
    episode = record(bsk_torch.rule("random", env), env, seed=1)
    table, rows = episode.to_numpy(), len(episode.times) * len(episode.names)
    assert {len(column) for column in table.values()} == {rows}
    of_the_rso = env.failure_penalty * float(env.dead[0, env.scenario.rso_column])  # which is an agent, but no inspector
    assert np.nansum(table["reward"]) == pytest.approx(float(env.returns[0]) - of_the_rso)
    decided = table["decided"]
    assert decided[: len(episode.names)].all()
    assert ("action_0" in table) == (actions == "thrust")
    fuel = table["fuel"].reshape(-1, len(episode.names))
    if actions == "thrust":
        numbers = np.stack([table[f"action_{k}"] for k in range(4)], 1)
        assert np.isfinite(numbers[decided]).all()
        assert np.isnan(numbers[~decided]).all()
        asked = np.linalg.norm(numbers[:, :3], axis=1).reshape(fuel.shape)[:-1]
        spent = -np.diff(fuel, axis=0)
        at = np.isfinite(asked)
        assert np.allclose(spent[at], np.minimum(asked[at], 1.0), rtol=1e-5)  # which is the longest thrust
    last = torch.stack([episode.rho_H[k, -1] for k in range(len(episode.names))])
    assert np.allclose(table["rho_H_0"].reshape(fuel.shape)[-1], last[:, 0])
    assert table["inspected"][-1] == int(torch.isfinite(episode.inspected_at).sum())
