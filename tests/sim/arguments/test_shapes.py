"""Arguments and fields of any shape, in a component that takes as many panels as it is given."""

import dataclasses

import pytest
import torch

from bsk_torch import SatelliteTasking, act, dyn, obs, rand, sats
from bsk_torch.sim.component import Arg, Bus, Component, Field, Layout
from bsk_torch.vec3 import Vec3
from tests.support.refusals import check_refusals, refusal

NORMALS = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, -1.0))


def collect(bus: Bus) -> None:
    """Note how much sunlight each panel gets."""
    s_B = bus.BN @ (bus.r_SN_N - bus.r_BN_N).unit()
    bus.sunlight = tuple(torch.clamp(n_B.dot(s_B), min=0.0) for n_B in bus.cell_normals_B)


def panels(count: int) -> Component:
    return Component(
        slot="cells",
        after="navigation",
        update=collect,
        args=(Arg("cellNormals_B", NORMALS, "-", "normals of the panels", shape=(None, 3), low=-1.0, high=1.0),),
        state=(Field("sunlight", count, "-", "cosine of each panel's angle to the Sun", many=True),),
        params=(Field("cell_normals_B", 3 * count, vectors=True),),
        initial=lambda args: {"sunlight": torch.zeros(1, count, dtype=torch.float64)},
        prepare=lambda args: {"cell_normals_B": args["cellNormals_B"]},
    )


def fitted(given) -> Component:
    value = given["cellNormals_B"]
    return panels(value.shape[0] if isinstance(value, rand.Distribution) else len(value))


class PanelsDynModel(dyn.BasicDynamicsModel):
    components = (dataclasses.replace(panels(len(NORMALS)), fit=fitted),)

    @dyn.observable
    def sunlight(now):  # noqa: N805
        return now.sunlight


class PanelSatellite(sats.Satellite):
    observation_spec = (obs.SatProperties(dict(prop="sunlight")),)
    action_spec = (act.Charge(duration=20.0),)
    dyn_type = PanelsDynModel


def environment(normals, n: int = 3, backend: str = "eager") -> SatelliteTasking:
    args = {"cellNormals_B": normals, "sigma_init": [0.1, 0.2, 0.3]}
    return SatelliteTasking(PanelSatellite("A", args), num_envs=n, seed=0, time_limit=300.0, backend=backend)


@pytest.mark.parametrize("backend", ["eager", pytest.param("compiled", marks=pytest.mark.compiled)])
@pytest.mark.parametrize("count", [1, 3, 4])
def test_as_many_panels_as_are_given(count, backend):
    env = environment(NORMALS[:count], backend=backend)
    seen = env.rollout(2)["next", "observation"]
    assert (seen.shape, env.satellite.sat_args["cellNormals_B"].shape) == ((3, 2, count), (3, count, 3))
    s_N = env.simulator.world.r_SN_N - env.satellite.dynamics.r_BN_N
    s_B = (env.satellite.dynamics.BN @ (s_N / s_N.norm(dim=-1, keepdim=True)).unsqueeze(-1)).squeeze(-1)
    expected = (s_B @ torch.tensor(NORMALS[:count], dtype=torch.float64).mT).clamp(min=0.0)
    torch.testing.assert_close(env.simulator.state.read("sunlight").view(3, -1), expected, rtol=0, atol=1e-9)


def test_values_differ_between_environments_and_go_with_saved_states():
    values = [torch.tensor(NORMALS), torch.tensor(NORMALS).flip(0), torch.tensor(NORMALS).roll(1, 0)]
    drawn: list[int] = []

    def draw():
        drawn.append(0)
        return values[len(drawn) % 3]

    args = {"cellNormals_B": draw, "sigma_init": [0.1, 0.2, 0.3]}
    model = type("FourPanels", (dyn.BasicDynamicsModel,), {"components": (panels(4),)})
    satellite = type("Mine", (PanelSatellite,), {"dyn_type": model, "observation_spec": (obs.Time(),)})
    env = SatelliteTasking(satellite("A", args), num_envs=3, seed=0, time_limit=300.0, backend="eager")
    env.reset()
    normals = env.satellite.sat_args["cellNormals_B"]
    assert normals.shape == (3, 4, 3)
    assert len({tuple(row.flatten().tolist()) for row in normals}) == 3
    saved = env.get_state()
    env.rollout(2)
    env.reset()
    env.restore(saved)
    torch.testing.assert_close(env.satellite.sat_args["cellNormals_B"], normals, rtol=0, atol=0)
    saved["satellites_0", "arguments", "values"][1, env.simulator.state.arguments.places["cellNormals_B"]] = 7.0
    check_refusals(refusal(lambda: env.restore(saved), ValueError, "saved state"))


def test_rejects_wrong_shapes():
    def argument(**options):
        return Arg("x", None, "-", "something", **options)

    check_refusals(
        refusal(lambda: environment([1.0, 0.0, 0.0]), ValueError, "cellNormals_B", "[any, 3]", "[3]"),
        refusal(lambda: environment([[1.0, 0.0]]), ValueError, "cellNormals_B", "[any, 3]", "[1, 2]"),
        refusal(lambda: environment([[1.0, 0.0, 2.0]]), ValueError, "cellNormals_B=2", "[-1, 1]"),
        refusal(lambda: argument(shape=[3]), ValueError, "'x'", "shape=[3]", "(4, 3)"),
        refusal(lambda: argument(shape=(0, 3)), ValueError, "'x'", "shape=(0, 3)", "(4, 3)"),
        refusal(lambda: argument(shape=(3,), kind="vector"), ValueError, "'x'", "kind='vector'", "shape=(3,)"),
        refusal(lambda: argument(shape=(None,), missing=0.0), ValueError, "'x'", "missing=0.0", "shape=(None,)"),
    )


def test_fields_of_several_vectors():
    layout = Layout([Field("a"), Field("b", 6, vectors=True), Field("c", 3, vectors=True)])
    planes = [torch.full((2,), float(k)) for k in range(layout.size)]
    bus = Bus(1)
    layout.put(bus, planes)
    assert bus.b == (Vec3(*planes[1:4]), Vec3(*planes[4:7]))
    assert bus.c == (Vec3(*planes[7:10]),)
    assert layout.gather(bus) == planes
