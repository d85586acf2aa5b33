"""Errors of navigation: their random numbers, their statistics, and who sees them; flights with Basilisk: tests/basilisk."""

import math

import pytest
import torch

from bsk_torch import SatelliteTasking, act, dyn, faults, fsw, obs, rand, sats
from bsk_torch.sim.dyn.generators import combined_normals, combined_uniform, minstd_start, modulo, polar_normals
from bsk_torch.sim.dyn.navigation import ERRORS
from tests.support.refusals import check_refusals, refusal

NOISE = dyn.navigation_numbers(position=0.05, velocity=1e-4, attitude=2e-6, rate=5e-7)


class Navigating(sats.Satellite):
    observation_spec = (obs.Time(),)
    action_spec = (act.NadirPoint(duration=8.0), act.NadirPoint(name="long", duration=400.0))
    dyn_type = (dyn.NavigationErrorsDynModel, dyn.BasicDynamicsModel)
    fsw_type = fsw.BasicFSWModel


def navigating(args: dict, n: int = 1, **options) -> SatelliteTasking:
    given = {"num_envs": n, "backend": "eager", "time_limit": 1000.0, "seed": 0, "dtype": torch.float64} | options
    return SatelliteTasking(Navigating("A", {"wheelSpeeds": [0.0, 0.0, 0.0]} | args), **given)


def walked(env: SatelliteTasking, steps: int = 1) -> torch.Tensor:
    """Errors of every tick from the reset on, [T + 1, N, 18]."""
    td, n = env.reset(), env.num_envs
    with env.record(("nav_errors",)) as recording:
        for _ in range(steps):
            td = env.step(td.set("action", torch.zeros(n, dtype=torch.int64)))["next"]
    return torch.stack([recording.of(k)["nav_errors"] for k in range(n)], 1)


def test_generators_are_those_of_the_literature():
    """First numbers from 12345 six times, as the implementations of L'Ecuyer and others print them."""
    state, found = (torch.full((1,), 12345.0, dtype=torch.float64),) * 6, []
    for _ in range(4):
        u, state = combined_uniform(state)
        found.append(float(u))
    assert found == pytest.approx([0.127011122046577, 0.318527565396794, 0.309186015583270, 0.825846862927113], abs=1e-14)
    # ISO C++ [rand.predef]: the 10000th number of minstd_rand is 399268537.
    x = minstd_start(torch.tensor([1.0, 2147483648.0, 0.0, 2147483647.0], dtype=torch.float64))
    for _ in range(10_000):
        x = modulo(48271.0 * x, 2147483647.0)
    assert x.tolist() == [399268537.0] * 4


def test_polar_normals_are_those_of_a_loop():
    """libstdc++'s normal_distribution, with as many attempts as it needs."""
    seeds = [1, 464374481, 7, 123456789]
    ours, wanted = torch.tensor(seeds, dtype=torch.float64), []
    for _ in range(30):
        normals, ours = polar_normals(ours, 9)
        wanted.append(torch.stack(normals, -1))
    for row, seed in enumerate(seeds):
        x, found = seed, []

        def uniform():
            nonlocal x
            x = low = 48271 * x % 2147483647
            x = high = 48271 * x % 2147483647
            return (low - 1.0 + (high - 1.0) * 2147483646.0) / (2147483646.0 * 2147483646.0)

        while len(found) < 30 * ERRORS:
            X, Y = 2.0 * uniform() - 1.0, 2.0 * uniform() - 1.0
            q = X * X + Y * Y
            if 0.0 < q <= 1.0:
                m = math.sqrt(-2.0 * math.log(q) / q)
                found += [Y * m, X * m]
        torch.testing.assert_close(torch.cat(wanted)[row :: len(seeds)].flatten(), torch.tensor(found, dtype=torch.float64))


def test_combined_normals_are_normal():
    """Moments of 180,000 numbers within 5 of their standard deviations; numbers of a tick and of rows are independent."""
    state, found = (
        tuple(torch.rand(100, dtype=torch.float64, generator=torch.Generator().manual_seed(0)) * 4e9 // 1 for _ in "123456"),
        [],
    )
    for _ in range(100):
        normals, state = combined_normals(state, 9)
        found.append(torch.stack(normals, -1))
    z = torch.stack(found)  # [100, 100, 18]
    count = z.numel()
    assert abs(float(z.mean())) < 5 / math.sqrt(count)
    assert abs(float((z * z).mean()) - 1.0) < 5 * math.sqrt(2 / count)
    assert abs(float((z**4).mean()) - 3.0) < 5 * math.sqrt(96 / count)
    mixed = torch.corrcoef(z.flatten(0, 1).T) - torch.eye(ERRORS, dtype=torch.float64)
    assert float(mixed.abs().max()) < 5 / math.sqrt(10_000)
    rows = torch.corrcoef(z.transpose(0, 1).flatten(1)) - torch.eye(100, dtype=torch.float64)
    assert float(rows.abs().max()) < 5.5 / math.sqrt(1800)


def test_steps_have_the_covariance_of_the_matrix_and_stay_within_bounds():
    deviations = torch.tensor([1.0] * 3 + [0.1] * 3 + [1e-6] * 3 + [1e-7] * 9, dtype=torch.float64)
    mixed = (
        torch.eye(ERRORS, dtype=torch.float64)
        + 0.05 * torch.arange(ERRORS, dtype=torch.float64).outer(torch.ones(ERRORS).double()) / ERRORS
    )
    P = deviations.unsqueeze(1) * mixed
    bounds = dyn.navigation_numbers(velocity=0.3)
    x = walked(navigating({"PMatrix": P.tolist(), "walkBounds": bounds}, n=64), steps=5) / deviations
    steps = torch.cat([x[:1], x.diff(dim=0)])  # the first errors are those of tick 0
    free = [k for k in range(ERRORS) if not bounds[k]]
    z = steps[..., free].flatten(0, 1)
    wanted = (mixed @ mixed.T)[free][:, free]
    torch.testing.assert_close(z.T @ z / len(z), wanted, rtol=0, atol=6 * float(wanted.max()) * math.sqrt(2 / len(z)))
    assert float(z.mean(0).abs().max()) < 5 * math.sqrt(float(wanted.max()) / len(z))
    velocity = x[..., 3:6].abs() * 0.1
    assert float(velocity.max()) <= 0.3
    assert float((velocity > 0.3 * (1 - 1e-12)).double().mean()) > 0.1  # they stick there


def test_cross_terms_add_errors_of_velocity_and_rate():
    given = {"PMatrix": NOISE, "RNGSeed": 11}
    plain, crossed = (walked(navigating(given | {"crossTrans": on, "crossAtt": on}), steps=2)[:, 0] for on in (False, True))
    for to, source in ((0, 3), (6, 9)):
        added = torch.cumsum(crossed[:-1, source : source + 3], 0)
        torch.testing.assert_close(crossed[1:, to : to + 3] - plain[1:, to : to + 3], added, rtol=1e-9, atol=1e-15)


def test_matrices_of_errors_may_be_diagonals_or_drawn():
    matrices = NOISE, torch.diag(torch.tensor(NOISE, dtype=torch.float64)).tolist()
    one, other = (walked(navigating({"PMatrix": P})) for P in matrices)
    assert torch.equal(one, other)
    env = navigating(
        {"PMatrix": rand.per_env([MIXED, (2.0 * torch.tensor(MIXED, dtype=torch.float64)).tolist()]), "RNGSeed": 7}, n=2
    )
    one, double = walked(env).unbind(1)
    torch.testing.assert_close(double, 2.0 * one, rtol=1e-12, atol=0)
    env = navigating({"PMatrix": rand.Uniform(0.0, 1e-6, ERRORS)}, n=3)
    assert float(walked(env).abs().max()) > 0.0


MIXED = (torch.diag(torch.tensor(NOISE, dtype=torch.float64)) + 1e-7 * torch.ones(ERRORS, ERRORS, dtype=torch.float64)).tolist()


@pytest.mark.parametrize("P", [NOISE, MIXED], ids=["diagonal", "matrix"])
def test_drawn_matrices_act_as_given_ones(P):
    given, *drawn = (
        walked(navigating({"PMatrix": each}, n=2)) for each in (P, rand.Choice([P]), rand.per_env([P, P]), lambda: P)
    )
    assert [torch.equal(each, given) for each in drawn] == [True] * 3


def test_errors_of_episodes_are_their_own_or_those_of_a_seed():
    many, few = (walked(navigating({"PMatrix": NOISE}, n=n)) for n in (5, 2))
    assert torch.equal(many[:, :2], few)
    assert not torch.allclose(many[:, 0], many[:, 1], rtol=1e-3)  # every episode has its own
    env = navigating({"PMatrix": NOISE, "RNGSeed": 464374481}, n=2)
    first, second = walked(env), walked(env)
    assert torch.equal(first[:, 0], first[:, 1])
    assert torch.equal(first, second)


@pytest.mark.compiled
def test_kernels_draw_the_same_numbers():
    """Generators are exact; logarithms and sines of kernels differ by rounding."""
    for seed in (None, 5):
        eager, compiled = (walked(navigating({"PMatrix": NOISE, "RNGSeed": seed}, n=3, backend=b)) for b in ("eager", "compiled"))
        torch.testing.assert_close(compiled, eager, rtol=1e-12, atol=1e-18)


def test_copies_go_on_with_the_same_errors():
    env = navigating({"PMatrix": NOISE}, n=2)
    walked(env)
    other = env.like(2)
    other.reset()
    other.restore(env, [1, 0], [1, 0])
    for each in (env, other):
        each.step(each.full_action_spec.zero().update(each.fake_tensordict().exclude("next")))
    assert torch.equal(env.satellite.dynamics.navigation_errors, other.satellite.dynamics.navigation_errors)


def pointing_error(env: SatelliteTasking) -> torch.Tensor:
    """Sine of the angle between the third axes of B and of the Hill frame after 400 s, [N]."""
    td = env.reset()
    env.step(td.set("action", torch.ones(env.num_envs, dtype=torch.int64)))
    model = env.satellite.dynamics
    return torch.linalg.cross(model.BN[:, 2], model.HN[:, 2]).norm(dim=-1)


@pytest.mark.compiled
def test_the_true_attitude_has_the_opposite_of_a_constant_error():
    """A rotation of 4 atan(0.01) about the first axis of B, once known to the guidance, turns the satellite back by it."""
    bias = dyn.navigation_numbers(attitude=[0.01, 0.0, 0.0])
    error = pointing_error(navigating({"navigationBias": bias}, backend="compiled"))
    assert float(error) == pytest.approx(math.sin(4.0 * math.atan(0.01)), rel=2e-3)
    assert float(pointing_error(navigating({}, backend="compiled"))) < 1e-4


def test_a_fault_of_navigation_begins_in_the_tick_after_its_time():
    plain = walked(navigating({"PMatrix": NOISE, "RNGSeed": 3}))[:, 0]
    noisy = walked(navigating({"PMatrix": NOISE, "RNGSeed": 3, "faults": [faults.navigation(noise=10.0, at=5.0)]}))[:, 0]
    grown = noisy.diff(dim=0) / plain.diff(dim=0)
    torch.testing.assert_close(grown[:5, :12], torch.ones(5, 12, dtype=torch.float64))
    torch.testing.assert_close(grown[5:, :12], torch.full_like(grown[5:, :12], 10.0))


@pytest.mark.compiled
def test_a_bias_that_begins_turns_the_satellite():
    bias = faults.navigation(dyn.navigation_numbers(attitude=[0.01, 0.0, 0.0]), at=faults.Sometimes(0.5, 100.0))
    env = navigating({"faults": [bias]}, n=6, backend="compiled")
    error = pointing_error(env)
    struck = env.satellite.dynamics.fault_severity[:, 0] > 0.0
    assert 0 < int(struck.sum()) < 6
    assert torch.equal(error > 0.03, struck)


def test_models_without_it_have_no_errors():
    class Plain(Navigating):
        dyn_type = dyn.BasicDynamicsModel

    env = SatelliteTasking(Plain("A"), num_envs=1, backend="eager")
    assert not any(name.startswith("nav_") for name in env.simulator.state.layout.fields)
    with pytest.raises(KeyError, match=r"PMatrix.*belongs to dyn\.NavigationErrorsDynModel; add that to dyn_type"):
        SatelliteTasking(Plain("A", {"PMatrix": NOISE}), num_envs=1, backend="eager")
    with pytest.raises(ValueError, match=r"navigationNoise.*belongs to dyn\.NavigationErrorsDynModel"):
        SatelliteTasking(Plain("A", {"faults": [faults.navigation(noise=2.0)]}), num_envs=1, backend="eager")


def test_rejects_wrong_errors_of_navigation():
    check_refusals(
        refusal(lambda: navigating({"PMatrix": [1.0] * 17}), ValueError, "PMatrix", "18 numbers", "[17]"),
        refusal(lambda: navigating({"PMatrix": [[1.0, 2.0], [3.0, 4.0]]}), ValueError, "PMatrix", "[18, 18]", "[2, 2]"),
        refusal(lambda: navigating({"PMatrix": [math.nan] * 18}), ValueError, "PMatrix=nan"),
        refusal(lambda: navigating({"PMatrix": lambda: [1.0] * 17}), ValueError, "PMatrix", "[18, 18]", "[17]"),
        refusal(lambda: navigating({"walkBounds": [1.0]}), ValueError, "walkBounds", "18 numbers", "[1]"),
        refusal(lambda: navigating({"RNGSeed": 1.5}), ValueError, "RNGSeed=1.5", "whole number", "[0, 4.29497e+09]"),
        refusal(lambda: navigating({"RNGSeed": -1}), ValueError, "RNGSeed=-1", "whole number", "[0, 4.29497e+09]"),
        refusal(lambda: navigating({"crossAtt": "yes"}), ValueError, "crossAtt='yes'", "[True, False]"),
        refusal(lambda: faults.navigation(), ValueError, "faults.navigation", "bias=None", "noise=None"),
        refusal(lambda: dyn.navigation_numbers(attitude=[1.0]), ValueError, "attitude=[1.0]", "one number", "three"),
    )
