"""Tick-by-tick comparison with a recording."""

import json

import numpy as np
import torch

from bsk_torch.presets.nadir_scan import ScanningDownlinkDynModel
from bsk_torch.rand import Key
from bsk_torch.sim import fsw
from bsk_torch.sim.simulator import Simulator
from tests.basilisk.replay import RECORDINGS
from tests.sim.simulators import make_simulator

COLUMNS = {
    "r": "r_BN_N",
    "v": "v_BN_N",
    "sigma": "sigma_BN",
    "omega": "omega_BN_B",
    "Omega": "Omega_WB_B",
    "u": "motor_torque_B",
    "battery": "charge",
    "storage": "storage",
    "illum": "illumination",
}
COMMANDS = {"Scan": "nadir_scan", "Charge": "charge", "Downlink": "downlink", "Desat": "desat"}


def make(arguments: dict, orbit: str) -> Simulator:
    """A simulation of one spacecraft from recorded arguments."""
    models = ScanningDownlinkDynModel, fsw.ContinuousImagingFSWModel
    known = {arg.name for model in models for part in model.all_components() for arg in part.args}
    values = {name: value for name, value in arguments.items() if name in known} | {"oe": None}
    options = dict(num_envs=1, dtype=torch.float64, sim_rate=1.0, horizon=600.0, backend="eager")
    simulator = make_simulator(*models, values, {"utc_init": arguments["utc_init"]}, orbit=orbit, **options)
    zero = torch.zeros(1, dtype=torch.int64)
    simulator.reset(
        simulator.state.all_rows,
        simulator.type.arguments.draw(Key(zero, zero, zero)),
        torch.full((1,), 600.0, dtype=torch.float64),
    )
    return simulator


def compare_ticks(name: str, ticks: int, orbit: str) -> dict[str, float]:
    """Largest absolute differences over the first ``ticks`` ticks of a recording."""
    file = np.load(RECORDINGS / f"{name}.npz")
    arguments = json.loads(str(file["fixed"])) | json.loads(str(file["init"]))
    simulator = make(arguments, orbit)
    starts = {round(start): action for start, _, action, *_ in json.loads(str(file["actions"]))}
    largest = dict.fromkeys((*COLUMNS, "access"), 0.0)
    previous = None
    for k in range(ticks):
        if k in starts and (starts[k] != previous or starts[k] == "Desat"):
            simulator.command(torch.ones(1, dtype=torch.bool), simulator.mode_index(COMMANDS[starts[k]]))
        previous = starts.get(k, previous)
        simulator.run(torch.ones(1, dtype=torch.int64))
        for column, field in COLUMNS.items():
            error = np.abs(simulator.read(field)[0].numpy() - file[column][k]).max()
            largest[column] = max(largest[column], float(error))
        access = abs(float(simulator.read("station_access")[0]) - float(file["access"][k].max()))
        largest["access"] = max(largest["access"], access)
    return largest
