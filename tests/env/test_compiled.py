"""The compiled back end gives the eager one's numbers, with one library for every batch size."""

import logging
from collections import Counter
from collections.abc import Iterator

import pytest
import torch

import bsk_torch
from bsk_torch import act, obs, sats
from bsk_torch.codegen import build, cpp
from bsk_torch.codegen.build import INCLUDE
from bsk_torch.codegen.ir import Branch, Define
from bsk_torch.codegen.kept import Kept
from bsk_torch.codegen.kernel import Entry
from bsk_torch.codegen.passes import lower
from bsk_torch.rand import first_key
from bsk_torch.sim import dyn, fsw
from bsk_torch.sim.assembly import satellite_type
from bsk_torch.sim.component import Component, Field
from bsk_torch.sim.simulator import Simulator
from bsk_torch.sim.tick.loop import Tick
from tests.sim.simulators import make_simulator

pytestmark = pytest.mark.compiled

RELATIVE = 1e-12
"""Fused multiply-adds round differently; slews amplify that, so the comparison is over a few minutes."""

AMPLIFIED = {
    "omega_BN_B",
    "motor_torque_B",
    "motor_torque_command_B",
    "location_sigma_BR",
    "sun_sigma_BR",
    "illumination",
    "control_integral_B",
}
"""Small differences of large numbers: rates near zero, torques, pointing errors and the penumbra lose three digits more."""

PLAN = torch.tensor([[0, 1, 2, 3, 0], [3, 0, 1, 2, 1]])


def make(backend, n, **options):
    return bsk_torch.make("NadirScan-v1", num_envs=n, seed=4, backend=backend, dtype=torch.float64, time_limit=3000.0, **options)


def play(env, td, plan):
    for action in plan:
        td = env.step(td.select("observation").set("action", action))["next"]
    return td


def copy_state(source: Simulator, target: Simulator) -> None:
    """The same start on the same arcs: those of the two back ends differ by micrometres."""
    target.state.planes.copy_(source.state.planes)
    for name in ("flown", "planned", "ephemeris"):
        getattr(target.arcs, name).copy_(getattr(source.arcs, name))
    target.state.touch()


def assert_close(eager: Simulator, fast: Simulator) -> None:
    assert eager.tick.state.fields
    for name in eager.tick.state.fields:
        a, b = eager.read(name), fast.read(name)
        scale = a.abs().max().clamp(min=1e-3 if name.endswith("_sigma") else 1e-6)
        assert ((a - b).abs().max() / scale) < RELATIVE * (1e3 if name in AMPLIFIED else 1.0), name


@pytest.mark.parametrize("orbit", ["arc", "integrated"])
@pytest.mark.nightly("integrated")
def test_equals_eager(orbit):
    eager, fast = (make(backend, 5, orbit=orbit) for backend in ("eager", "compiled"))
    starts = eager.reset(), fast.reset()
    assert_close(eager.simulator, fast.simulator)
    copy_state(eager.simulator, fast.simulator)
    ends = [play(env, td, PLAN) for env, td in zip((eager, fast), starts, strict=True)]
    assert_close(eager.simulator, fast.simulator)
    # windows are those of the two back ends' own planned arcs, which differ by less than a metre: 0.1 ms of an orbit of 5700 s
    torch.testing.assert_close(ends[0]["observation"], ends[1]["observation"], rtol=0, atol=2e-8)
    torch.testing.assert_close(ends[0]["reward"], ends[1]["reward"], rtol=0, atol=1e-15)


def test_one_library_serves_every_batch_size_and_frozen_rows_stay(monkeypatch):
    first = make("compiled", 3)
    play(first, first.reset(), PLAN[:, :3])

    def refuse(source, path, name):
        raise AssertionError(f"another batch size builds the {name} again")

    monkeypatch.setattr(build, "_built", refuse)
    monkeypatch.setattr(build, "LOADED", {})
    for n in (1, 2, 17, 64):
        env = make("compiled", n)
        play(env, env.reset(), torch.randint(0, 4, (2, n)))
    env = make("compiled", 4)
    td = play(env, env.reset(), torch.tensor([[0, 1, 2, 3]]))
    before = env.simulator.state.planes.clone()
    mask = torch.tensor([[True], [False], [True], [False]])
    env.step(td.select("observation").set("action", torch.tensor([1, 1, 3, 3])).set("_step", mask))
    assert torch.equal(env.simulator.state.planes[:, 1::2], before[:, 1::2])
    assert not torch.equal(env.simulator.state.planes[:, ::2], before[:, ::2])


def lowered_tick(**options):
    return lower(make("eager", 2, **options).simulator.tick.trace())


@pytest.mark.parametrize("orbit", ["arc", "integrated"])
def test_the_tick_is_one_loop_over_blocks_and_one_over_ticks(orbit):
    """All others go over the lanes of a block."""
    loops = [line.strip() for line in cpp.source(lowered_tick(orbit=orbit), INCLUDE).splitlines() if "for (" in line]
    assert [line for line in loops if "int l = 0; l < W" not in line] == [
        "for (int64_t block = 0; block < blocks; ++block) {",
        "for (int64_t k = 1; k <= last; ++k) {",
    ]


def operations(statements) -> Iterator[str]:
    """Operations of statements and of those inside branches, and the branches."""
    for statement in statements:
        if isinstance(statement, Branch):
            yield from ("branch", *operations(statement.body))
        elif isinstance(statement, Define):
            yield statement.value.op


def test_constants_of_ticks_leave_their_loop():
    """The Earth turns; neither its pole nor the polynomial of the arc are computed again."""
    loop = lowered_tick()
    tick = Counter(operations(loop.body))
    assert tick["cos"] <= 1
    assert tick["sin"] <= 1
    # laws are skipped where no lane of a block needs them: three of guidance, the dump, shadow and penumbra
    assert tick["branch"] >= 6
    sky, arc = ([value.op for value in record.computed] for record in loop.records)
    assert {"cos", "sin"} <= set(sky)
    assert len(arc) > 50


def rank(bus) -> None:
    """The middle one of the body rates: sorting has no kernel."""
    bus.middle = torch.stack(list(bus.omega_BN_B)).sort(0).values[1]


class Ranked(dyn.DynamicsModel):
    """A rigid spacecraft with a component that only tensors can compute."""

    components = (
        Component(
            "rank",
            rank,
            state=(Field("middle"),),
            initial=lambda args: {"middle": torch.zeros(1, dtype=torch.float64)},
            after="los_comms",
        ),
    )


def simulate(backend) -> Simulator:
    options = dict(num_envs=3, dtype=torch.float64, sim_rate=1.0, horizon=600.0, backend=backend)
    simulator = make_simulator(Ranked, fsw.FSWModel, {}, {}, orbit="arc", segment=600.0, **options)
    values = simulator.type.arguments.draw(first_key(3))
    simulator.reset(simulator.state.all_rows, values, torch.zeros(3, dtype=torch.float64))
    return simulator


@pytest.mark.nightly
def test_components_without_a_kernel_are_compiled_by_inductor(caplog):
    eager = simulate("eager")
    with caplog.at_level(logging.WARNING, logger="bsk_torch"):
        fast = simulate("compiled")
    assert any("stack" in record.message and "inductor" in record.message for record in caplog.records)
    copy_state(eager, fast)
    for simulator in (eager, fast):
        simulator.run(torch.tensor([5, 0, 3]))
    assert_close(eager, fast)
    rates = fast.read("omega_BN_B")
    assert torch.equal(fast.read("middle")[[0, 2]], rates.sort(-1).values[[0, 2], 1])
    assert fast.read("middle")[1] == 0.0


@pytest.mark.parametrize(("preset", "libraries"), [("NadirScan-v1", [False]), ("RelayConstellation-v1", [False, True])])
def test_trials_batches_and_prepared_episodes_share_their_ticks(preset, libraries, monkeypatch):
    """A tick is traced once for a type of satellites, and compiled once: in lockstep for imagers, whose images end steps."""
    ticks, built, trace, of = [], [], Tick.trace, Entry.of

    def traced(tick, wakes=False):
        ticks.append(wakes)
        return trace(tick, wakes)

    def entry(loop, lockstep, name):
        if name.startswith("tick"):
            built.append(lockstep)
        return of(loop, lockstep, name)

    monkeypatch.setattr(satellite_type, "TICKS", Kept(4))
    monkeypatch.setattr(Tick, "trace", traced)
    monkeypatch.setattr(Entry, "of", staticmethod(entry))
    env = bsk_torch.make(preset, num_envs=64)
    env.reset()
    assert env.pool is not None
    assert (Counter(ticks), sorted(built)) == ({False: len(libraries), True: len(libraries)}, libraries)
    again = bsk_torch.make(preset, num_envs=3)  # the tick of the package's components is the same
    assert len(ticks) == 2 * len(libraries)
    assert [s.runners for s in again.fleet.simulators] == [s.runners for s in env.fleet.simulators]


GAIN = 1.0
"""What a cell of a notebook may change between two environments."""


def drift(bus) -> None:
    """Add a number that is read when the tick is built."""
    bus.drift = bus.drift + GAIN


class Drifting(dyn.DynamicsModel):
    """A spacecraft with a component of the user's."""

    components = (
        Component(
            "drift",
            drift,
            state=(Field("drift"),),
            initial=lambda args: {"drift": torch.zeros(1, dtype=torch.float64)},
            after="los_comms",
        ),
    )


def test_ticks_of_users_components_are_built_for_each_environment_and_shared_by_its_copies(monkeypatch):
    """A global that a component reads may have changed since; a copy of an environment is what the environment was."""
    specs = {"observation_spec": (obs.Time(),), "action_spec": (act.Drift(),)}
    satellite = type("Drifts", (sats.Satellite,), {"dyn_type": Drifting, "fsw_type": fsw.FSWModel, **specs})
    envs = []
    for gain in (1.0, 2.0):
        monkeypatch.setitem(globals(), "GAIN", gain)
        envs.append(bsk_torch.SatelliteTasking(satellite("A"), seed=1))
    monkeypatch.setitem(globals(), "GAIN", 3.0)
    envs.append(envs[1].like(2))
    for env, gain in zip(envs, (1.0, 2.0, 2.0), strict=True):
        env.reset()
        env.simulator.run(torch.full((env.num_envs,), 5))
        assert env.simulator.read("drift").tolist() == [5.0 * gain] * env.num_envs
