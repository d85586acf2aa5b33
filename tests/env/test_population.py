"""Episodes in which some satellites take no part: the others are as if they were alone, and nothing is done for the absent."""

from __future__ import annotations

from collections.abc import Sequence

import pytest
import torch
from tensordict import TensorDict
from torch import Tensor

from bsk_torch import ConstellationTasking, act, comm, data, obs, sats, scene
from bsk_torch.rand import Key
from bsk_torch.sim import dyn, fsw

pytestmark = pytest.mark.compiled

BACKENDS = ["eager", "compiled"]
LIMIT = 600.0
NUMBERS = (3, 1, 5, 2)
"""Satellites of each environment, where the first ones are present."""


class Linked(dyn.ImagingDynModel, dyn.LOSCommDynModel):
    pass


class Imager(sats.ImagingSatellite):
    observation_spec = (
        obs.SatProperties(dict(prop="storage_level_fraction"), dict(prop="r_BN_P", norm=7e6), dict(prop="battery_charge")),
        obs.OpportunityProperties(dict(prop="priority"), dict(prop="target_angle"), n_ahead_observe=3),
        obs.Eclipse(),
        obs.Time(),
    )
    action_spec = (act.Charge(duration=47.0), act.Drift(duration=31.0), act.Image(n_ahead_image=3))
    dyn_type = Linked
    fsw_type = fsw.ImagingFSWModel


class RelayDynModel(dyn.BasicDynamicsModel, dyn.LOSCommDynModel):
    pass


class Relay(sats.Satellite):
    observation_spec = (obs.SatProperties(dict(prop="battery_charge_fraction")), obs.Time())
    action_spec = (act.Charge(duration=40.0), act.Drift(duration=25.0))
    dyn_type = RelayDynModel


class Scanner(sats.Satellite):
    observation_spec = (obs.SatProperties(dict(prop="battery_charge_fraction"), dict(prop="r_BN_P", norm=7e6)), obs.Time())
    action_spec = (act.Scan(duration=60.0), act.Charge(duration=120.0))
    dyn_type = dyn.ContinuousImagingDynModel
    fsw_type = fsw.ContinuousImagingFSWModel


ARGS = dict(imageAttErrorRequirement=0.2, imageRateErrorRequirement=0.2, u_max=0.4, imageTargetMinimumElevation=0.2)


class FirstOnes(scene.UniformTargets):
    """As many satellites as ``NUMBERS`` says, the first of the list."""

    def present(self, key: Key, names: Sequence[str]) -> Tensor:
        numbers = torch.tensor(NUMBERS)[key.env_id % len(NUMBERS)]
        return torch.arange(len(names)) < numbers.unsqueeze(1)


def imagers(count: int) -> list[sats.Satellite]:
    return [Imager(f"EO{k}", ARGS, may_see_nothing=True) for k in range(count)]


def mixed(count: int) -> list[sats.Satellite]:
    """Imagers and relays by turns."""
    return [Relay(f"R{k}") if k % 2 else Imager(f"EO{k}", ARGS, may_see_nothing=True) for k in range(count)]


def build(
    satellites: list[sats.Satellite], scenario: type[scene.Scenario] = FirstOnes, **options: object
) -> ConstellationTasking:
    given: dict[str, object] = dict(
        num_envs=4, seed=5, time_limit=LIMIT, max_step_duration=200.0, world_args=dict(utc_init="2018 SEP 29 21:00:00.000 (UTC)")
    )
    link = comm.LOSMultiCommunication()
    return ConstellationTasking(satellites, scenario(300), data.UniqueImageReward(), link, **{**given, **options})


def scanners(count: int, n: int = 4, **options: object) -> ConstellationTasking:
    given: dict[str, object] = dict(num_envs=n, seed=3, time_limit=LIMIT)
    satellites = [Scanner(f"S{k}") for k in range(count)]
    return ConstellationTasking(satellites, scene.UniformNadirScanning(), data.ScanningTimeReward(), **{**given, **options})


def choose(env: ConstellationTasking, td: TensorDict, step: int) -> TensorDict:
    """Give legal actions that depend on environment, satellite's number and step alone."""
    for group in env.groups:
        mask = td[group.name, "action_mask"]
        wish = (env.env_ids.unsqueeze(1) * 7 + group.members[:, 0] * 3 + step * 5) % mask.shape[-1]
        order = (torch.arange(mask.shape[-1]) - wish.unsqueeze(-1)) % mask.shape[-1]
        td[group.name, "action"] = torch.where(mask, order, 1000).argmin(-1)
    return td


def history(env: ConstellationTasking, steps: int) -> list[TensorDict]:
    td = env.reset()
    seen = [td.clone()]
    for step in range(steps):
        td = env.step(choose(env, td, step))["next"]
        seen.append(td.clone())
        begin = td["done"].squeeze(-1)
        if bool(begin.any()):
            td = env.reset(TensorDict({"_reset": td["done"]}, env.batch_size))
    return seen


def of_satellites(env: ConstellationTasking, td: TensorDict, row: int) -> dict[str, dict[str, Tensor]]:
    """Return all that the agents of an environment were shown, by name of the satellite."""
    found = {}
    for group in env.groups:
        for k, agent in enumerate(group.agents):
            found[agent] = {
                ".".join([key] if isinstance(key, str) else key): v[row, k] for key, v in td[group.name].items(True, True)
            }
    return found


# -- the present ones are as if they were alone -------------------------------------------------------------------------------


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("satellites", [imagers, mixed])
def test_satellites_that_are_present_are_as_if_the_others_did_not_exist(satellites, backend) -> None:
    env = build(satellites(5), backend=backend)
    whole = history(env, 8)
    for row, number in enumerate(NUMBERS):
        alone = build(satellites(number), scene.UniformTargets, num_envs=1, env_ids=[row], backend=backend)
        for one, many in zip(history(alone, 8), whole, strict=True):
            theirs, mine = of_satellites(alone, one, 0), of_satellites(env, many, row)
            for name, leaves in theirs.items():
                for leaf, value in leaves.items():
                    assert torch.equal(value, mine[name][leaf]), (name, leaf)
            for key in ("done", "terminated", "truncated", "duration"):
                assert torch.equal(one[key][0], many[key][row])


@pytest.mark.parametrize("satellites", [imagers, mixed])
def test_both_back_ends_agree_on_who_is_present(satellites) -> None:
    eager, compiled = (history(build(satellites(5), backend=backend), 6) for backend in BACKENDS)
    for one, other in zip(eager, compiled, strict=True):
        for key, leaf in one.items(True, True):
            assert torch.allclose(leaf.double(), other[key].double(), rtol=1e-5, atol=1e-6), key


def test_whoever_is_absent_makes_no_difference() -> None:
    """Of five satellites with given arguments, the second and the fourth fly as the two alone, after as many steps."""

    class Some(scene.UniformNadirScanning):
        def present(self, key: Key, names: Sequence[str]) -> Tensor:
            return torch.tensor([False, True, False, True, False]).expand(len(key), -1)

    def scanner(name: str) -> Scanner:
        spin = 0.01 * int(name[1:])
        start = dict(rN=[7e6, 0.0, 0.0], vN=[0.0, 5e3 + 100.0 * spin, 5.6e3], sigma_init=[0.1, spin, 0.3], storedCharge_Init=2e5)
        return Scanner(
            name, start | dict(omega_init=[0.0, spin, 0.0], wheelSpeeds=[0.0, 10.0, 20.0], disturbance_vector=[0.0, 0.0, 1e-4])
        )

    def make(names: Sequence[str], scenario: scene.Scenario) -> ConstellationTasking:
        when = dict(utc_init="2018 SEP 29 21:00:00.000 (UTC)")
        satellites = [scanner(name) for name in names]
        return ConstellationTasking(
            satellites, scenario, data.ScanningTimeReward(), num_envs=2, seed=1, time_limit=LIMIT, world_args=when
        )

    seen = []
    many, two = make([f"S{k}" for k in range(5)], Some()), make(["S1", "S3"], scene.UniformNadirScanning())
    for env, columns in ((many, [1, 3]), (two, [0, 1])):
        td, states = env.reset(), []
        for step in range(4):
            action = torch.full((2, env.fleet.size), 2)
            action[:, columns] = torch.tensor([step % 2, (step + 1) % 2])
            td["agents", "action"] = action
            td = env.step(td)["next"]
            states.append(td["agents"][:, columns].clone())
        seen.append(states)
    for one, other in zip(*seen, strict=True):
        assert (one == other).all()
