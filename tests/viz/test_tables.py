"""Recorded episodes as NumPy arrays and CSV files."""

from __future__ import annotations

import csv

import numpy as np
import pytest

import bsk_torch
from bsk_torch.viz.episodes import record


def test_an_episode_is_a_table(tmp_path):
    env = bsk_torch.make("NadirScan-v1", num_envs=1, time_limit=900.0, backend="eager")
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
