"""The tank, the change of velocity, and death by an empty tank."""

import logging

import pytest
import torch

from bsk_torch.sim.fsw.manoeuvre import burn
from tests.support.manoeuvring import R_N, V_N, Imager, Kick, every, make, push, step
from tests.support.refusals import check_refusals, refusal


@pytest.fixture(params=["integrated", "arc"])
def orbit(request):
    return request.param


def test_burns_are_clipped_to_the_tank_which_is_composed_with_other_software():
    dv_N, remaining, clipped = burn(
        torch.tensor([[3.0, 4.0, 0.0], [3.0, 4.0, 0.0], [0.0, 0.0, 0.0]]).double(), torch.tensor([10.0, 2.5, 0.0]).double()
    )
    assert torch.allclose(dv_N, torch.tensor([[3.0, 4.0, 0.0], [1.5, 2.0, 0.0], [0.0, 0.0, 0.0]]).double(), atol=1e-15)
    assert (remaining.tolist(), clipped.tolist()) == ([5.0, 0.0, 0.0], [False, True, False])
    names = [component.slot for component in Imager.get_fsw_type().all_components()]
    assert "manoeuvre" in names
    assert "location_pointing" in names
    assert Kick().name == "kick"


@pytest.mark.nightly("integrated")
def test_the_message_keeps_the_old_velocity_until_the_next_tick(orbit):
    env = make(orbit=orbit, sim_rate=0.5)
    td = env.reset()
    push(env, 1.0, 2.0, -2.0)
    fsw_model = env.satellite.fsw
    assert env.simulator.read("v_BN_N").tolist() == [V_N]
    assert (fsw_model.dv_available.tolist(), fsw_model.thrust_count.tolist()) == ([97.0], [1.0])
    env.fleet.run(torch.ones(1, dtype=torch.bool), torch.tensor([1]), torch.tensor([1]))
    fall = -3.986004415e14 / 6.9e6**2 * 0.5
    wanted = torch.tensor([[1.0 + fall, V_N[1] + 2.0, V_N[2] - 2.0]]).double()
    assert torch.allclose(env.simulator.read("v_BN_N"), wanted, atol=0.02)  # J2 and the curvature of half a second
    assert torch.allclose(env.simulator.read("r_BN_N"), torch.tensor([R_N]).double() + 0.5 * wanted, atol=3.0)
    td = step(env, td, 0)
    assert env.simulator.read("delta_v_N").tolist() == [[0.0, 0.0, 0.0]]


@pytest.mark.parametrize("compat", [None, "bsk_rl"])
@pytest.mark.nightly("integrated-bsk_rl")
def test_a_second_manoeuvre_at_the_same_time(orbit, compat):
    """Is added; with the errors of bsk_rl it replaces the first, and both are paid for (double thrust)."""
    twice, once = make(orbit=orbit, compat=compat), make(orbit=orbit, compat=compat)
    tds = [env.reset() for env in (twice, once)]
    push(twice, 1.0, 0.0, 0.0)
    push(twice, 0.0, 2.0, 0.0)
    push(once, 0.0 if compat else 1.0, 2.0, 0.0)
    assert twice.satellite.fsw.dv_available.tolist() == [97.0]
    assert twice.satellite.fsw.thrust_count.tolist() == [2.0]
    for env, td in zip((twice, once), tds, strict=True):
        step(env, td, 0)
    r_N = [env.simulator.read("r_BN_N") for env in (twice, once)]
    torch.testing.assert_close(*r_N, rtol=0.0, atol=0.0 if orbit == "integrated" else 1e-5)  # an arc is read once more


def test_a_burn_beyond_the_tank_is_clipped_and_kills(orbit, caplog):
    """The drift is flown and the penalty paid once, by a satellite that is dead from the manoeuvre on."""
    env = make(2, orbit=orbit, sat_args={"dv_available_init": 2.5})
    td = env.reset()
    with caplog.at_level(logging.WARNING):
        for k in range(3):
            td = step(env, td, 1, 0)
            assert td["reward"][:, 0].tolist() == [0.0 if k < 2 else -1.0, 0.0]
    assert "requests 1 m/s but 0.5 m/s remain" in caplog.text
    assert env.satellite.fsw.dv_available.tolist() == [0.0, 2.5]
    assert env.satellite.fsw.thrust_count.tolist() == [3.0, 0.0]
    assert env.simulator.sim_time.tolist() == [180.0, 180.0]
    assert td["terminated"].squeeze(-1).tolist() == [True, False]


def test_empty_tanks_kill():
    env = make(sat_args={"dv_available_init": 1.0})
    td = env.reset()
    dead = []
    run = env.fleet.run

    def watch(*args):
        dead.append(env.dead.flatten().tolist())
        return run(*args)

    env.fleet.run = watch
    step(env, td, 1)
    assert dead == [[True]]
    env = make(sat_args={"dv_available_init": 0.0})
    td = env.reset()
    assert (env.dead.tolist(), step(env, td, 0)["reward"].item()) == ([True], -1.0)


def test_thirty_manoeuvres_use_a_tank_up():
    """Thirty times 0.1 of 3 m/s leave nothing that counts."""
    env = make(sat_args={"dv_available_init": 3.0})
    env.reset()
    for k in range(30):
        assert env.satellite.fsw.fuel_remaining().item()
        push(env, 0.0, 0.0, 0.1 if k % 2 else -0.1)
    assert not env.satellite.fsw.fuel_remaining().item()


@pytest.mark.nightly("integrated")
def test_manoeuvres_touch_no_other_rows(orbit):
    many, alone = make(3, orbit=orbit), make(1, orbit=orbit, env_ids=[1])
    tds = [env.reset() for env in (many, alone)]
    rows = torch.tensor([True, False, True])
    push(many, 1.0, 0.0, 0.0, rows=rows)
    push(alone, 1.0, 0.0, 0.0, rows=rows[1:2])
    for env, td in zip((many, alone), tds, strict=True):
        step(env, td, 0)
    assert torch.equal(many.simulator.read("r_BN_N")[1:2], alone.simulator.read("r_BN_N"))
    assert many.satellite.fsw.dv_available.tolist() == [99.0, 100.0, 99.0]


def test_rejects_wrong_burns():
    env = make()
    env.reset()
    check_refusals(
        refusal(lambda: push(env, float("nan"), 0.0, 0.0), ValueError, "dv_N", "[0]", "[nan, 0.0, 0.0]"),
        refusal(lambda: env.simulator.thrust(every(env), torch.zeros(3)), ValueError, "[1]"),
        refusal(lambda: make(sat_args={"dv_available_init": -1.0}), ValueError, "dv_available_init"),
    )
    assert env.satellite.fsw.dv_available.tolist() == [100.0]
