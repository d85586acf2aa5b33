from __future__ import annotations

import pytest
import torch

from bsk_torch.rand import first_key
from bsk_torch.sim import dyn, fsw
from bsk_torch.sim.component import Bus, Field
from bsk_torch.sim.names import RENAMED, current_name
from bsk_torch.sim.simulator import Simulator


class Checking(dyn.ImagingDynModel):
    """A model whose observable uses names of release 0.1."""

    @dyn.observable
    def old_names(now) -> torch.Tensor:
        """Numbers that depend on several fields, [N]."""
        return now.r.dot(now.v) + now.sigma.dot(now.omega) + now.Omega.dot(now.r_sun)

    @dyn.observable
    def new_names(now) -> torch.Tensor:
        """The same, [N]."""
        return now.r_BN_N.dot(now.v_BN_N) + now.sigma_BN.dot(now.omega_BN_B) + now.Omega_WB_B.dot(now.r_SN_N)


@pytest.fixture(scope="module")
def simulator() -> Simulator:
    options = dict(num_envs=2, device=torch.device("cpu"), dtype=torch.float64, sim_rate=1.0, horizon=600.0, backend="eager")
    options |= dict(orbit="integrated")  # on an arc, position and velocity cannot be written
    simulator = Simulator(Checking, fsw.ImagingFSWModel, {}, {}, **options)
    simulator.reset(simulator.state.all_rows, simulator.draw(first_key(2)), torch.zeros(2, dtype=torch.float64))
    return simulator


def test_present_names_are_kept_and_do_not_warn(recwarn):
    assert [current_name(name) for name in (*RENAMED.values(), "charge")] == [*RENAMED.values(), "charge"]
    assert not recwarn.list


def test_old_names_of_fields_are_read_and_written_with_a_warning(simulator):
    fields = simulator.tick.state.fields
    renamed = {old: new for old, new in RENAMED.items() if new in fields}
    assert {"r", "v", "sigma", "omega", "Omega", "motor_torque", "target_r_P", "sun_sigma"} <= renamed.keys()
    for k, (old, new) in enumerate(renamed.items()):
        value = torch.full((2, fields[new].width), float(k + 1), dtype=torch.float64)
        with pytest.warns(DeprecationWarning, match=f"'{old}' is now called '{new}'"):
            simulator.write(old, torch.tensor([True, False]), value)
        with pytest.warns(DeprecationWarning, match=f"'{old}' is now called '{new}'"):
            read = dyn.DynamicsModel(simulator).state(old)
        assert torch.equal(read, simulator.read(new))
        assert (read[0] == k + 1).all()
        assert (read[1] != k + 1).any()


def test_old_names_on_the_bus_mean_the_present_ones():
    bus, value = Bus(1), torch.ones(3)
    with pytest.warns(DeprecationWarning, match="'sigma' is now called 'sigma_BN'"):
        bus.sigma = value
    assert bus.sigma_BN is value
    with pytest.warns(DeprecationWarning, match="'sigma' is now called 'sigma_BN'"):
        assert bus.sigma is value
    with pytest.raises(AttributeError, match="no component has written 'r_BN_N'"), pytest.warns(DeprecationWarning, match="'r'"):
        _ = bus.r


def test_old_names_in_observables(simulator):
    model = Checking(simulator)
    with pytest.warns(DeprecationWarning, match="'r_sun' is now called 'r_SN_N'"):
        old = model.old_names
    assert torch.equal(old, model.new_names)


def test_old_names_in_modes():
    with pytest.warns(DeprecationWarning, match="'sun_sigma' is now called 'sun_sigma_BR'"):
        mode = fsw.Mode(("sun_on",), {"sun_sigma": 0.0, "sun_fresh": 1.0})
    assert mode.resets == {"sun_sigma_BR": 0.0, "sun_fresh": 1.0}


def test_the_sun_of_the_world(simulator):
    with pytest.warns(DeprecationWarning, match="World.*r_sun_N is deprecated .* use World.*r_SN_N"):
        old = simulator.world.r_sun_N
    assert torch.equal(old, simulator.world.r_SN_N)


def test_fields_cannot_take_old_names():
    with pytest.raises(ValueError, match="a field cannot be called 'pole', the old name of 'EN'"):
        Field("pole")
