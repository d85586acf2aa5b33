"""Recorded episodes of bsk_rl's smaller models: attitudes that are imposed, composed models, a scanner without stations."""

import json
from typing import Any

import numpy as np
import pytest
import torch

from bsk_torch import NO_ACTION, ConstellationTasking, act, data, obs, rand, sats, scene
from bsk_torch.sim import dyn, fsw, world
from bsk_torch.sim.assembly.composition import compose
from tests.basilisk.replay import RECORDINGS
from tests.support.core_arguments import SPACECRAFT

BOUNDS = {"time": 0.0, "r": 1e-3, "v": 1e-6, "sigma": 1e-10, "omega": 1e-12, "observation": 1e-6, "reward": 1e-9}
"""Largest differences; an imposed attitude follows from the position on the arc alone."""

WHEELED = BOUNDS | {"sigma": 1e-7, "omega": 1e-8}
COLUMNS = {"time": slice(0, 1), "r": slice(1, 4), "v": slice(4, 7), "sigma": slice(7, 10), "omega": slice(10, 13)}


def load(name: str) -> tuple[dict[str, Any], list[dict[str, Any]], Any]:
    """Description of the environment, initial conditions of the episodes, and arrays."""
    file = np.load(RECORDINGS / f"{name}.npz")
    return json.loads(str(file["env"])), json.loads(str(file["ic"])), file


def satellite(name: str, kind: dict[str, Any], fixed: dict[str, Any], starts: list[dict[str, Any]]) -> sats.Satellite:
    """A satellite of the recorded kind, which starts where those of the episodes did."""
    attributes = {
        "observation_spec": [obs.SatProperties(*({"prop": prop} for prop in kind["properties"])), obs.Time()],
        "action_spec": [getattr(act, mode)(f"{mode}_{k}", duration=seconds) for k, (mode, seconds) in enumerate(kind["modes"])],
        "dyn_type": tuple(getattr(dyn, model) for model in kind["dyn"]),
        "fsw_type": tuple(getattr(fsw, model) for model in kind["fsw"]),
    }
    each = {key: rand.per_env(torch.tensor([start[key] for start in starts], dtype=torch.float64)) for key in starts[0]}
    return type("Recorded", (sats.Satellite,), attributes)(name, {**fixed, **each, "oe": None})


def environment(env: dict[str, Any], starts: list[dict[str, Any]], **options: Any) -> ConstellationTasking:
    """The satellites of a file under one agent, an environment for each episode."""
    kinds = env["satellites"]
    each = [[start["satellites"][k] for start in starts] for k in range(len(kinds))]
    members = [satellite(f"Sat{k}", kind, env["fixed"], mine) for k, (kind, mine) in enumerate(zip(kinds, each, strict=True))]
    scans = any("Scan" in mode for kind in kinds for mode, _ in kind["modes"])
    common = dict(num_envs=len(starts), joint=True, dtype=torch.float64, sim_rate=env["sim_rate"], seed=0)
    return ConstellationTasking(
        members,
        scenario=scene.UniformNadirScanning(),
        rewarder=data.ScanningTimeReward() if scans else data.NoReward(),
        world_args=dict(utc_init=rand.per_env([start["utc_init"] for start in starts])),
        **(common | options),
    )


def state_of(env: ConstellationTasking) -> np.ndarray:
    """The recorded quantities of the present state, [N, S, 13]."""
    parts = [
        env.fleet.each(lambda sat, read=read: read(sat).reshape(sat.simulator.state.rows, -1))
        for read in (
            lambda sat: sat.simulator.sim_time,
            *(lambda sat, name=name: getattr(sat.dynamics, name) for name in ("r_BN_N", "v_BN_N", "sigma_BN", "omega_BN_B")),
        )
    ]
    return torch.cat(parts, -1).numpy()


def differences(name: str, **options: Any) -> dict[str, float]:
    """Largest differences between a recording and its replay."""
    description, starts, file = load(name)
    env = environment(description, starts, **options)
    found = dict.fromkeys(BOUNDS, 0.0)

    def compare(quantity: str, values: Any, wanted: np.ndarray) -> None:
        found[quantity] = max(found[quantity], float(np.abs(np.asarray(values) - wanted).max()))

    td, actions = env.reset(), torch.tensor(file["action"])
    for k in range(actions.shape[1] + 1):
        state, wanted = state_of(env), file["state"][:, k]
        for quantity, columns in COLUMNS.items():
            compare(quantity, state[..., columns], wanted[..., columns])
        compare("observation", td["observation"], file["obs"][:, k])
        if k < actions.shape[1]:
            action = torch.where(actions[:, k] < 0, NO_ACTION, actions[:, k])
            td = env.step(td.empty().set("action", action))["next"]
            compare("reward", td["reward"].squeeze(-1), file["reward"][:, k])
    return found


def assert_close(found: dict[str, float], bounds: dict[str, float]) -> None:
    assert not {name: found[name] for name, bound in bounds.items() if not found[name] <= bound}


def test_an_attitude_without_actuators_is_that_of_the_last_reference():
    """NadirPoint and Drift in random order: B is H of one tick ago, and N for a tick after every other command."""
    assert_close(differences("models_pointing", backend="eager"), BOUNDS)


@pytest.mark.compiled
def test_an_imposed_attitude_is_the_same_in_kernels():
    assert_close(differences("models_pointing"), BOUNDS)


def test_wheels_turn_beside_passive_satellites_and_without_stations():
    assert_close(differences("models_spinning", backend="eager"), BOUNDS)
    # One points, one is never tasked, one has wheels and control; ticks of two seconds.
    assert_close(differences("models_passive_crew", backend="eager"), WHEELED)
    assert_close(differences("models_scanner", backend="eager"), WHEELED)


def test_the_recordings_contain_what_they_stand_for():
    pointing, crew, scanner = (load(name)[2] for name in ("models_pointing", "models_passive_crew", "models_scanner"))
    turned = np.abs(pointing["state"][..., 7:10]).max(-1) > 0.0
    assert turned.any()
    assert not turned.all()
    assert (crew["action"][..., 1] == -1).all()
    assert not crew["state"][:, :, 1, 7:].any()
    level = scanner["obs"][1][:, 0]
    assert level.max() > 0.9
    assert (np.diff(level) >= 0.0).all()
    assert (scanner["action"][1] == 2).any()


DEFAULTS = np.load(RECORDINGS / "models_defaults.npz")
MODELS, WORLDS = (json.loads(str(DEFAULTS[name])) for name in ("models", "worlds"))

OTHER = {"bufferNames", "groundLocationPlanetRadius"} | SPACECRAFT
"""Arguments whose defaults are compared elsewhere, that only name things in Basilisk, or that bsk_rl lacks."""


NATIVE = {"inst_pHat_B"}
"""Arguments that here all models have, and some models of bsk_rl."""


def composed(record: dict[str, Any]) -> type[sats.Satellite]:
    models = {
        "dyn_type": [getattr(dyn, name) for name in record["dyn"]],
        "fsw_type": [getattr(fsw, name) for name in record["fsw"]],
    }
    return type("Composed", (sats.Satellite,), models)


@pytest.mark.parametrize("record", MODELS, ids=lambda record: "-".join((*record["dyn"], *record["fsw"])))
def test_composed_models_inherit_in_the_order_of_bsk_rl(record):
    satellite = composed(record)
    ours = [[base.__name__ for base in model.__mro__] for model in (satellite.dyn_type, satellite.fsw_type)]
    for mine, theirs in zip(ours, record["orders"], strict=True):
        known = [name for name in theirs if name in vars(dyn) or name in vars(fsw)]
        assert known
        assert [name for name in mine if name in known] == known


@pytest.mark.parametrize("record", MODELS, ids=lambda record: "-".join((*record["dyn"], *record["fsw"])))
def test_default_sat_args_are_those_of_bsk_rl(record):
    ours, theirs = composed(record).default_sat_args(), record["sat_args"]
    assert_same_defaults(ours, theirs)


@pytest.mark.parametrize("record", WORLDS, ids=lambda record: "-".join(record["world"]))
def test_default_world_args_are_those_of_bsk_rl(record):
    model = compose([getattr(world, name) for name in record["world"]], world.WorldModel)
    assert_same_defaults(model.default_world_args(), record["world_args"])


def assert_same_defaults(ours: dict[str, Any], theirs: dict[str, Any]) -> None:
    """Raise unless both have the same names, and the same values where bsk_rl's are constants (None stands for a drawn one)."""
    assert set(ours) - OTHER - NATIVE == set(theirs) - OTHER - NATIVE
    assert NATIVE & set(theirs) <= set(ours)
    assert {name: ours[name] for name, value in theirs.items() if isinstance(value, str)} == strings(theirs)
    constants = [name for name in theirs if isinstance(theirs[name], int | float) or name == "controlAxes_B"]
    for name in set(constants) - OTHER:
        np.testing.assert_allclose(ours[name], theirs[name], rtol=1e-12, err_msg=name)


def strings(defaults: dict[str, Any]) -> dict[str, str]:
    return {name: value for name, value in defaults.items() if isinstance(value, str)}
