"""Properties and functions of users, written on tensors: in the kernel of observables where they can be, else on tensors."""

import logging

import numpy as np
import pytest
import torch

from bsk_torch import SatelliteTasking, act, dyn, obs, sats
from bsk_torch.astro.frames import angle_between
from bsk_torch.sim.readout.own import OwnFunction

SCALE = 2.0
AXIS = torch.tensor([0.0, 0.6, 0.8], dtype=torch.float64)
MATRIX = torch.arange(9.0, dtype=torch.float64).view(3, 3)
LIST = [1.0]


def scaled(x: torch.Tensor) -> torch.Tensor:
    return x / SCALE


TRACED = {
    "norm": lambda d: d.r_BN_N.norm(dim=-1),
    "norms": lambda d: torch.linalg.norm(d.v_BN_N, dim=-1) + torch.linalg.vector_norm(d.v_BN_N, dim=1),
    "helper": lambda d: scaled(d.r_BN_N).norm(dim=1),
    "mean": lambda d: d.wheel_speeds.abs().mean(-1),
    "amax": lambda d: d.wheel_speeds.abs().amax(dim=-1),
    "cross": lambda d: torch.linalg.cross(d.r_BN_N, d.v_BN_N)[:, 2],
    "einsum": lambda d: torch.einsum("nij,nj->ni", d.BN, d.r_BN_N),
    "einsum_constant": lambda d: torch.einsum("...ji,j->...i", d.BN, AXIS),
    "matrices": lambda d: d.BN @ d.BN.mT,
    "argument": lambda d: (d.BN.mT @ d.satellite.sat_args["nHat_B"].unsqueeze(-1)).squeeze(-1),
    "constant": lambda d: (MATRIX @ d.r_BN_N.unsqueeze(-1)).squeeze(-1),
    "row": lambda d: d.r_BN_N @ MATRIX,
    "column": lambda d: d.BN @ AXIS,
    "angle": lambda d: angle_between(d.r_BN_N, d.world.sun_direction_N),
    "where": lambda d: torch.where(d.r_BN_N[..., 2] > 0, d.battery_charge_fraction, -1.0),
    "stack": lambda d: torch.stack([d.battery_charge_fraction, d.r_BN_P[:, 0] / 1e6], dim=-1),
    "cat": lambda d: torch.cat([d.r_BN_P / 1e6, d.v_BN_N[:, :1]], dim=-1),
    "elements": lambda d: d.elements.a / 1e6,
    "normalize": lambda d: torch.nn.functional.normalize(d.r_BN_N, dim=-1),
    "unbind": lambda d: d.r_BN_N.unbind(-1)[1] * d.r_BN_N.unbind(1)[0],
    "mask": lambda d: ((d.battery_charge_fraction > 0.5) & (d.r_BN_N[:, 0] < 0)).double(),
    "power": lambda d: (d.r_BN_N / 7e6) ** 2 * torch.tensor([[1.0, 2.0, 3.0]]),
    "package": lambda d: d.BP[:, 0],
}

ON_TENSORS = {
    "branch": (lambda d: d.r_BN_N if bool((d.r_BN_N[:, 0] > 0).all()) else 1.0 * d.r_BN_N, "dim=None"),
    "rows": (lambda d: d.r_BN_N.sum(0) * 0.0 + d.r_BN_N, "dim=0"),
    "choice": (lambda d: d.r_BN_N[torch.arange(len(d.simulator.state.ticks))], "ticks"),
    "median": (lambda d: d.r_BN_N.median(-1).values, "Tensor.median"),
    "numpy": (lambda d: np.linalg.norm(d.r_BN_N, axis=-1), "Python cannot read"),
    "list": (lambda d: d.battery_charge_fraction * LIST[0], "'LIST', a list, which may change"),
    "half": (lambda d: d.battery_charge_fraction.float(), "Tensor.float"),
    "random": (lambda d: d.battery_charge_fraction + 1e-9 * float(torch.rand(())), "two calls compute different things"),
    "time": (lambda d: d.simulator.sim_time, "simulator.sim_time"),
    "nothing": (lambda d: AXIS[0].expand(len(d.simulator.ticks)), "simulator.ticks"),
}


class ScaledDynModel(dyn.BasicDynamicsModel):
    factor = 1.0

    @property
    def charge(self):
        """Of a base class, a method and a variable of the class."""
        return self._times(self.battery_charge_fraction)

    def _times(self, x):
        return x * self.factor

    @property
    def wheel_speeds_fraction(self):
        return super().wheel_speeds_fraction[:, 0] / 2.0


def environment(*entries: dict[str, object], backend: str = "compiled", observed: object = None) -> SatelliteTasking:
    class Own(sats.Satellite):
        observation_spec = (observed or obs.SatProperties(*entries),)
        action_spec = (act.Charge(duration=60.0),)
        dyn_type = ScaledDynModel

    return SatelliteTasking(Own("Own1"), num_envs=4, seed=3, backend=backend, dtype=torch.float64)


def of_dynamics(function):
    return lambda satellite: function(satellite.dynamics)


@pytest.mark.compiled
def test_functions_on_tensors_are_traced(caplog):
    """The kernel computes what torch does; what it cannot compute stays on tensors, and the log says why."""
    functions = TRACED | {name: function for name, (function, _) in ON_TENSORS.items()}
    with caplog.at_level(logging.INFO, "bsk_torch.sim"):  # the logger whose level Basilisk's own functions set
        env = environment(*(dict(prop=name, fn=of_dynamics(function)) for name, function in functions.items()))
    env.rollout(2)
    observer = env.simulator.observer
    traced = {function.__name__: function for function in observer._built().layout if isinstance(function, OwnFunction)}
    assert set(traced) == set(TRACED)
    assert not observer.missed
    for name, function in traced.items():
        value, expected = observer.read(function), function.on_tensors()
        torch.testing.assert_close(value, expected, rtol=1e-12, atol=1e-14 * float(expected.abs().max()), msg=name)
    told = [record.getMessage() for record in caplog.records if "computed on tensors" in record.getMessage()]
    assert len(told) == len(ON_TENSORS)
    for name, (_, why) in ON_TENSORS.items():
        assert any(f"'{name}'" in message and why in message for message in told), (name, told)


@pytest.mark.compiled
def test_properties_are_traced_until_a_variable_changes(monkeypatch):
    """Functions that name a variable whose value has changed are computed on tensors again."""
    factor = 3.0
    entries = (
        dict(prop="charge"),
        dict(prop="wheel_speeds_fraction", name="wheel"),
        dict(prop="global", fn=lambda satellite: satellite.dynamics.battery_charge_fraction * SCALE),
        dict(prop="enclosed", fn=lambda satellite: satellite.dynamics.battery_charge_fraction * factor),
    )
    env = environment(*entries, observed=obs.Noisy(obs.SatProperties(*entries)))
    env.reset()
    observer = env.simulator.observer
    names = ["charge", "wheel", "global", "enclosed"]
    assert [function.__name__ for function in observer._own] == names
    charge = env.satellite.dynamics.battery_charge_fraction
    wheel = env.satellite.dynamics.wheel_speeds_fraction
    torch.testing.assert_close(env.observe()["observation"], torch.stack([charge, wheel, charge * 2.0, charge * 3.0], 1))
    monkeypatch.setattr(ScaledDynModel, "factor", 5.0)
    monkeypatch.setitem(globals(), "SCALE", 7.0)
    factor = 11.0
    expected = torch.stack([charge * 5.0, wheel, charge * 7.0, charge * 11.0], 1)
    torch.testing.assert_close(env.observe()["observation"], expected)
    assert [function.__name__ for function in observer._own] == ["wheel"]
    env.satellite.dynamics.factor = 13.0
    assert env.observe()["observation"][0, 0] == charge[0] * 13.0


@pytest.mark.compiled
def test_attributes_of_instances_stay_on_tensors():
    """Nothing tells whether they change."""

    class KeptDynModel(ScaledDynModel):
        def __init__(self, *args):
            super().__init__(*args)
            self.factor = 2.0

    class Kept(sats.Satellite):
        observation_spec = (obs.SatProperties(dict(prop="charge"), dict(prop="battery_charge_fraction")),)
        action_spec = (act.Charge(duration=60.0),)
        dyn_type = KeptDynModel

    env = SatelliteTasking(Kept("Kept1"), num_envs=2, dtype=torch.float64)
    observed = env.reset()["observation"]
    assert torch.equal(observed[:, 0], 2.0 * observed[:, 1])
    env.satellite.dynamics.factor = 3.0
    assert torch.equal(env.observe()["observation"][:, 0], 3.0 * observed[:, 1])


def test_eager_environments_trace_nothing():
    env = environment(dict(prop="charge"), backend="eager")
    env.reset()
    assert not any(isinstance(function, OwnFunction) for function in env.simulator.observer.wanted)
