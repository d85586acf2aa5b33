"""Relative properties: identities that hold in any motion, and derivatives."""

import functools
import math
from types import SimpleNamespace

import pytest
import torch
from tensordict import TensorDict

from bsk_torch import ConstellationTasking, act, dyn, fsw, obs, sats
from bsk_torch.astro.attitude import dcm_to_mrp, mrp_to_dcm
from bsk_torch.astro.orbit import Elements, elements_to_rv
from bsk_torch.constants import MU_EARTH
from bsk_torch.formations import relative_to_chief
from bsk_torch.obs.relative_observations import FUNCTIONS
from bsk_torch.rand import random_orbit
from bsk_torch.vec3 import Mat3, Vec3
from tests.support.refusals import check_refusals, refusal

RELATIVE = FUNCTIONS.keys() - {"rso_imaged_regions"}
"""Functions that need no rewarder of inspections."""

OF_SUN = ("sun_hat_Hc", "r_Hs", "h_Hs", "eccentricity_Hs")


def spinning(oe, rate, start, t):
    """A satellite on a circular orbit, whose body spins about its third axis at a constant rate."""
    n = math.sqrt(MU_EARTH / oe[0] ** 3)
    elements = Elements(*(torch.tensor(x, dtype=torch.float64) for x in oe))
    r, v = elements_to_rv(elements._replace(f=elements.f + n * t))
    angle = rate * t
    cos, sin = torch.cos(angle), torch.sin(angle)
    zero, one = torch.zeros_like(cos), torch.ones_like(cos)
    spin = torch.stack([torch.stack(row, -1) for row in ((cos, sin, zero), (-sin, cos, zero), (zero, zero, one))], -2)
    BN = spin @ mrp_to_dcm(Vec3(*torch.tensor(start, dtype=torch.float64))).stack()
    omega = torch.tensor([0.0, 0.0, rate], dtype=torch.float64).expand(len(t), 3)
    dynamics = SimpleNamespace(
        r_BN_N=r.stack(), v_BN_N=v.stack(), sigma_BN=dcm_to_mrp(Mat3.of(BN)).stack(), omega_BN_B=omega, BN=BN
    )
    return SimpleNamespace(dynamics=dynamics)


def pair(t):
    deputy = spinning((7000e3, 0.0, 0.8, 1.0, 0.0, 0.5), 0.03, (0.1, -0.2, 0.3), t)
    return deputy, spinning((7001e3, 0.0, 0.8001, 1.0001, 0.0, 0.4999), -0.02, (-0.4, 0.2, 0.1), t)


NOW = torch.zeros(1, dtype=torch.float64)


@pytest.mark.parametrize("frame", ["N", "C", "D", "Hc", "Hd"])
def test_velocities_are_derivatives_of_positions_in_their_frame(frame):
    """Central differences over 0.2 s: their error is h^2 / 6 times the third derivative, 3e-5 of |r| times the spin's cube."""
    dt = 0.1
    t = torch.tensor([-dt, 0.0, dt], dtype=torch.float64)
    r, v = (FUNCTIONS[f"{what}_DC_{frame}"](*pair(t)) for what in ("r", "v"))
    assert torch.allclose((r[2] - r[0]) / (2 * dt), v[1], rtol=0.0, atol=1e-4)
    assert float(v[1].norm()) > 0.5
    distance = FUNCTIONS["r_DC_N"](*pair(t)).norm(dim=-1)
    assert torch.allclose(r.norm(dim=-1), distance, rtol=1e-13)


def test_attitudes_compose():
    """[DC] = [D Hc] [Hc Hd] [Hd C], all MRPs with a length of at most one."""
    sigmas = {name: FUNCTIONS[name](*pair(NOW)) for name in ("sigma_DC", "sigma_DHc", "sigma_HdHc", "sigma_HdC", "rso_sigma_BH")}
    D_C, D_Hc, Hd_Hc, Hd_C, C_Hc = (mrp_to_dcm(Vec3.of(sigma)).stack()[0] for sigma in sigmas.values())
    assert torch.allclose(D_C, D_Hc @ Hd_Hc.mT @ Hd_C, atol=1e-14)
    assert torch.allclose(C_Hc, Hd_C.mT @ Hd_Hc, atol=1e-14)
    assert all(float(sigma.norm()) <= 1.0 for sigma in sigmas.values())
    deputy, chief = pair(NOW)
    assert torch.allclose(D_C, (deputy.dynamics.BN @ chief.dynamics.BN.mT)[0], atol=1e-14)


def test_a_deputy_relative_to_itself():
    deputy = pair(NOW)[0]
    names = RELATIVE - {"rso_sigma_BH", "rso_omega_BH", "sigma_DHc", "sigma_HdC", *OF_SUN}
    assert len(names) == 12
    for name in names:
        assert torch.allclose(FUNCTIONS[name](deputy, deputy), torch.zeros(1, 3, dtype=torch.float64), atol=1e-15), name


def test_the_sun_turns_with_its_frames():
    """On 20 March the Sun lies along the first axis of N; the axes of Hs are the Earth's position, motion and orbit normal."""
    tilt = math.radians(23.44)
    sun = torch.tensor([[1.5e11, 0.0, 0.0]], dtype=torch.float64)
    along = torch.tensor([[0.0, 3e4 * math.cos(tilt), 3e4 * math.sin(tilt)]], dtype=torch.float64)
    deputy, chief = pair(NOW)
    chief = spinning((7000e3, 0.0, 0.8, 1.0, 0.0, 0.0), 0.0, (0.0, 0.0, 0.0), NOW)
    deputy.simulator = SimpleNamespace(world=SimpleNamespace(r_SN_N=sun, v_SN_N=along))
    r, v = chief.dynamics.r_BN_N[0], chief.dynamics.v_BN_N[0]
    assert FUNCTIONS["sun_hat_Hc"](deputy, chief)[0, 0].item() == pytest.approx(float(r[0] / r.norm()), abs=1e-15)
    pole = torch.tensor([0.0, -math.sin(tilt), math.cos(tilt)], dtype=torch.float64)
    seen = FUNCTIONS["r_Hs"](deputy, chief)[0]
    assert seen.tolist() == pytest.approx(
        [float(-r[0]), float(r @ torch.linalg.cross(pole, -sun[0] / sun.norm())), float(r @ pole)]
    )
    h = FUNCTIONS["h_Hs"](deputy, chief)[0]
    assert float(h.norm()) == pytest.approx(math.sqrt(MU_EARTH * 7000e3), rel=1e-12)
    assert float(h @ seen) == pytest.approx(0.0, abs=1e-3 * float(h.norm()))
    assert FUNCTIONS["eccentricity_Hs"](deputy, chief).abs().max().item() < 1e-14
    chief.dynamics.v_BN_N = chief.dynamics.v_BN_N * math.sqrt(1.1)  # now at perigee, with e = 0.1
    e = FUNCTIONS["eccentricity_Hs"](deputy, chief)[0]
    assert torch.allclose(e, 0.1 * seen / seen.norm(), atol=1e-13)
    assert float(v.norm()) > 0.0


class Chief(sats.Satellite):
    observation_spec = (obs.Time(),)
    action_spec = (act.NadirPoint(duration=1e9),)
    dyn_type, fsw_type = dyn.DynamicsModel, fsw.FSWModel


def distance_of_all(deputy, chief):
    return (deputy.dynamics.r_BN_N - chief.dynamics.r_BN_N).norm(dim=-1)


def make(*entries, num_envs=3, chief_name="RSO", kind=Chief, **options):
    spec = (obs.RelativeProperties(*entries, chief_name=chief_name),)
    deputy = type("Deputy", (kind,), {"observation_spec": spec, "action_spec": (act.Drift(duration=30.0),)})
    states = {"A": [100.0, 0.0, 0.0, 0.0, 0.0, 0.0], "B": [0.0, -200.0, 40.0, 0.1, 0.0, 0.0]}
    return ConstellationTasking(
        [deputy("A", obs_type=dict), Chief("RSO"), deputy("B", obs_type=dict)],
        sat_arg_randomizer=relative_to_chief("RSO", random_orbit(), states),
        num_envs=num_envs,
        **(dict(seed=3, backend="eager", time_limit=300.0, dtype=torch.float64) | options),
    )


def observed(env, td):
    group = next(name for name, agents in env.group_map.items() if "A" in agents)
    return td[group, "observation", "rel_props"]


@pytest.mark.parametrize("norm", [1.0, 500.0])
def test_initial_states_are_observed_as_they_were_given(norm):
    env = make(dict(prop="r_DC_Hc", norm=norm), dict(prop="v_DC_Hc"), dict(prop="r_DC_N", name="mine"))
    seen = observed(env, env.reset())
    assert set(seen.keys()) == {"r_DC_Hc" if norm == 1.0 else "r_DC_Hc_normd", "v_DC_Hc", "mine"}
    wanted = torch.tensor([[100.0, 0.0, 0.0], [0.0, -200.0, 40.0]], dtype=torch.float64).expand(3, 2, 3)
    # elements and back move a satellite by some 1e-9 of a metre
    assert torch.allclose(seen["r_DC_Hc" if norm == 1.0 else "r_DC_Hc_normd"] * norm, wanted, atol=2e-8)
    assert torch.allclose(seen["v_DC_Hc"][:, 1], torch.tensor([0.1, 0.0, 0.0], dtype=torch.float64), atol=1e-10)


def test_functions_of_deputy_and_chief_and_arguments_can_be_filled_in():
    entries = (dict(prop="all", fn=distance_of_all), dict(fn=FUNCTIONS["r_DC_C"]))
    filled = functools.partial(FUNCTIONS["r_DC_N"])
    env = make(
        *entries, dict(prop="filled", fn=filled), dict(prop="names", fn=lambda d, c: [d.sat_args["mass"], c.sat_args["mass"]])
    )
    td = env.reset()
    for _ in range(2):
        seen = observed(env, td)
        assert torch.allclose(seen["filled"].norm(dim=-1), seen["all"], rtol=1e-12)
        assert torch.allclose(seen["prop_1"].norm(dim=-1), seen["all"], rtol=1e-12)
        assert seen["names"].shape == (3, 2, 2)
        td = env.rand_step(td)["next"]


def test_a_chief_of_the_same_type_is_another_satellite():
    """Functions are tried at the first reset, since a trial has one satellite of each type."""
    env = make(dict(prop="all", fn=distance_of_all), chief_name="B")
    seen = observed(env, env.reset())
    assert (seen["all"][:, 0] > 200.0).all()
    assert (seen["all"][:, 1] == 0.0).all()


def test_rows_do_not_depend_on_the_batch():
    entries = [dict(prop=name) for name in sorted(RELATIVE)]
    whole, alone = make(*entries, num_envs=5), make(*entries, num_envs=1, env_ids=[3])
    first, single = observed(whole, whole.reset()), observed(alone, alone.reset())
    for name in RELATIVE:
        assert torch.equal(first[name][3:4], single[name]), name
    assert not torch.equal(first["r_DC_N"][0], first["r_DC_N"][1])


def test_partial_steps_leave_the_others_relative_states():
    env = make(dict(prop="r_DC_Hc"))
    td = env.reset()
    before = observed(env, td).clone()
    action = {
        name: TensorDict({"action": torch.zeros(3, len(agents), dtype=torch.int64)}, [3, len(agents)])
        for name, agents in env.group_map.items()
    }
    td = env.step(TensorDict({**action, "_step": torch.tensor([True, False, True])}, [3]))["next"]
    after = observed(env, td)
    assert torch.equal(after["r_DC_Hc"][1], before["r_DC_Hc"][1])
    assert not torch.equal(after["r_DC_Hc"][0], before["r_DC_Hc"][0])


def test_rejects_unknown_chiefs():
    check_refusals(refusal(lambda: make(dict(prop="r_DC_N"), chief_name="RS0"), ValueError, "chief_name", "'RS0'", "'RSO'"))
