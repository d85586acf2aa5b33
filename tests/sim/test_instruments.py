"""Several instruments on one satellite: each step is that of a satellite with the chosen one alone."""

import math
import re
from typing import Any

import pytest
import torch

from bsk_torch import SatelliteTasking, act, data, obs, rand, sats, scene
from bsk_torch.bsk_rl import act as literal_act
from bsk_torch.bsk_rl import obs as literal_obs
from bsk_torch.bsk_rl import sats as literal_sats
from bsk_torch.lab.bounds.windows import satellite_positions
from bsk_torch.rl.rules.targets import image_actions
from bsk_torch.sim import dyn, faults, fsw
from bsk_torch.sim.arguments.sources import hint
from tests.sim.instrument_steps import assert_steps_are_equal, choose
from tests.support.episodes import begun
from tests.support.refusals import check_refusals, refusal

N, TARGETS = 2, 300
PACKET = {"transmitterPacketSize": -1e6}
WIDE, NARROW = (
    {"imageAttErrorRequirement": 0.02, "instrumentBaudRate": 3e6},
    {
        "inst_pHat_B": [0.6, 0.0, 1.6],
        "imageAttErrorRequirement": 0.004,
        "imageRateErrorRequirement": 0.01,
        "imageTargetMinimumElevation": 0.9,
        "instrumentBaudRate": 1.5e6,
        "instrumentPowerDraw": -80.0,
    },
)
PAIR = [dyn.Instrument("wide", **WIDE), dyn.Instrument("narrow", **NARROW)]
NEAR = dyn.Instrument("near", imageTargetMaximumRange=8e5)
LIT = dyn.Instrument("lit", imageTargetMinimumSunElevation=0.2)


def environment(
    args: dict[str, Any] | None = None, actions: tuple[Any, ...] | None = None, observed: tuple[Any, ...] = (), **options: Any
) -> SatelliteTasking:
    args = {"instruments": PAIR, **PACKET} if args is None else args
    named = [part.name for part in args.get("instruments") or ()] or [None] if actions is None else []
    images = tuple(act.Image(3, 25.0, instrument=name) for name in named)

    class Imager(sats.ImagingSatellite):
        observation_spec = (obs.Time(), *observed)
        action_spec = (*images, act.Charge(duration=20.0)) if actions is None else actions
        dyn_type = dyn.GroundStationDynModel
        fsw_type = fsw.ImagingFSWModel

    return SatelliteTasking(
        Imager("A", args),
        **{
            "scenario": scene.UniformTargets(TARGETS),
            "rewarder": data.UniqueImageReward(),
            "num_envs": N,
            "time_limit": 1500.0,
            "seed": 0,
            "backend": "eager",
            **options,
        },
    )


def play(env: SatelliteTasking, actions: tuple[int, ...]) -> list[torch.Tensor]:
    """Rewards, observations and fields of all steps."""
    td, found = env.reset(), []
    for action in actions:
        td = env.step(td.set("action", torch.full((len(env.env_ids),), action)))["next"]
        planes = [env.simulator.read(name) for name in ("sigma_BN", "charge", "storage", "images", "r_LP_P")]
        found += [td["reward"].clone(), td["observation"].clone(), env.simulator.ticks.clone(), *planes]
    return found


def assert_same(one: list[torch.Tensor], other: list[torch.Tensor], rows: slice = slice(None)) -> None:
    assert all(torch.equal(a[rows], b[rows]) for a, b in zip(one, other, strict=True))


def test_one_instrument_is_that_of_bsk_rl():
    angle = (obs.OpportunityProperties(dict(prop="target_angle"), dict(prop="priority"), n_ahead_observe=3),)
    own = {"inst_pHat_B": [0, 0, 1], "imageAttErrorRequirement": 0.01, "instrumentBaudRate": 8e6}
    listed = None, [dyn.Instrument("a")], [dyn.Instrument("a", **own)]
    flown = [play(environment({**PACKET, "instruments": one}, observed=angle), (0, 3)) for one in listed]
    assert_same(flown[0], flown[1])
    assert_same(flown[0], flown[2])


@pytest.mark.parametrize(
    ("backend", "ticks", "numbers"),
    [("eager", 12, (1, 0)), pytest.param("compiled", 150, (0, 1, 1, 0, 1, 0), marks=pytest.mark.compiled)],
)
@pytest.mark.nightly("eager")
def test_each_step_is_that_of_a_satellite_with_the_chosen_instrument(backend, ticks, numbers):
    both = environment(backend=backend)
    alone = [environment({**own, **PACKET}, backend=backend) for own in (WIDE, NARROW)]
    for env in (both, *alone):
        env.reset()
    everywhere, places = torch.ones(N, dtype=torch.bool), both.satellite.find_windows(1200.0)

    def image(simulator, step):
        simulator.command(everywhere, torch.full((N,), simulator.mode_names.index("image")))
        simulator.write("r_LP_P", everywhere, both.scenario.r_LP_P[torch.arange(N), places.place[:, step]])

    grew = assert_steps_are_equal(both, alone, numbers, ticks, image)
    assert backend == "eager" or any(grew)


def test_axes_and_angles_are_those_of_the_instrument():
    env = environment(observed=(_angles(None), _angles("wide"), _angles("narrow")))
    alone = environment({**NARROW, **PACKET}, observed=(_angles(None),))
    for each in (env, alone):
        each.reset()
    narrow = alone.satellite.observations.entries[1].get_vector()
    for number, axis in enumerate(([0.0, 0.0, 1.0], NARROW["inst_pHat_B"])):
        choose(env, number)
        dynamics, axis_B = env.satellite.dynamics, torch.tensor(axis, dtype=torch.float64)
        axis_P = dynamics.BP.mT @ (axis_B / axis_B.norm())
        torch.testing.assert_close(env.satellite.fsw.c_hat_P, axis_P, rtol=0, atol=1e-14)
        torch.testing.assert_close(
            env.satellite.fsw.c_hat_H, dynamics.HN @ dynamics.BN.mT @ axis_B / axis_B.norm(), rtol=0, atol=1e-12
        )
        last, wide, other = (entry.get_vector() for entry in env.satellite.observations.entries[1:])
        assert torch.allclose(last, wide, rtol=0, atol=1e-12) == (number == 0)  # of the same windows
        torch.testing.assert_close(other, narrow, rtol=0, atol=1e-12)
    assert env.satellite.observation_description[-1] == "target_narrow.target_narrow_1.target_angle"


def _angles(instrument: str | None) -> obs.OpportunityProperties:
    return obs.OpportunityProperties(dict(prop="target_angle"), n_ahead_observe=2, instrument=instrument)


@pytest.mark.parametrize("broken", [None, [faults.instrument(0.0, instrument="narrow", at=0.0)]], ids=["whole", "broken"])
def test_power_and_data_are_those_of_the_chosen_instrument(broken):
    """A command that is not withdrawn takes an image in every tick, of which a broken instrument has no data."""
    free = {"basePowerDraw": 0.0, "rwBasePower": 0.0, "panelArea": 1e-9, "u_max": 1e-6, "dataStorageCapacity": 1e12}
    env = begun(environment({"instruments": PAIR, **PACKET, **free, "faults": broken}))
    simulator, everywhere = env.simulator, torch.ones(N, dtype=torch.bool)
    simulator.run(torch.full((N,), 1))
    for number, power in ((0, -30.0), (1, -80.0)):
        choose(env, number)
        simulator.command(everywhere, torch.full((N,), simulator.mode_names.index("image")))
        charge = simulator.read("charge")
        simulator.run(torch.full((N,), 3))
        torch.testing.assert_close(simulator.read("charge") - charge, torch.full((N,), 3.0 * power).double(), rtol=0, atol=0.1)
        simulator.command(everywhere, torch.full((N,), simulator.mode_names.index("drift")))
        simulator.write("instrument_command", everywhere, torch.ones(N))
        level = simulator.read("storage")
        simulator.run(torch.full((N,), 2))
        size = (WIDE, NARROW)[number]["instrumentBaudRate"]
        lost = broken is not None and number == 1
        assert (simulator.read("storage") - level).tolist() == [0.0 if lost else 2.0 * size] * N
        assert env.satellite.dynamics.instrument_baud.tolist() == [size] * N
        assert env.satellite.dynamics.instrument_index.tolist() == [number] * N


def test_the_same_target_with_another_instrument_is_another_task():
    env = environment({"instruments": [dyn.Instrument("a"), dyn.Instrument("b", inst_pHat_B=[1, 0, 1])], **PACKET})
    td = env.reset()
    assert env.satellite.action_description[::3] == ["action_image_a_0", "action_image_b_0", "action_charge"]
    a, b = env.satellite.actions.entries[:2]
    index, mask = torch.zeros(N, dtype=torch.int64), torch.ones(N, dtype=torch.bool)
    one = a.decide(index, mask, index, torch.full((N,), -1))
    again, other = a.decide(index, mask, index, one.key), b.decide(index, mask, index + 3, one.key)
    assert not again.retask.any()
    assert other.retask.all()
    target = a.keys(one.key)
    assert torch.equal(b.keys(other.key), target + TARGETS)
    env.step(td.set("action", torch.full((N,), 3)))
    assert torch.equal(env.satellite.latest_target, target)
    saved = environment({"instruments": [dyn.Instrument("a"), dyn.Instrument("b", inst_pHat_B=[1, 0, 1])], **PACKET})
    saved.restore(env.get_state())
    assert saved.satellite.dynamics.instrument_index.tolist() == [1.0] * N


def test_commands_to_another_instrument_are_withdrawn():
    env = begun(environment())
    everywhere, first = torch.ones(N, dtype=torch.bool), torch.zeros(N, dtype=torch.int64)
    wide, narrow = env.satellite.actions.entries[:2]
    env.simulator.write("instrument_command", everywhere, torch.ones(N))
    for entry, left in ((wide, 1.0), (narrow, 0.0)):
        entry.begin(everywhere, entry.decide(first, everywhere, first, first))
        assert env.simulator.read("instrument_command").tolist() == [left] * N


def test_images_of_one_instrument_hide_targets_from_the_others():
    env = begun(environment())
    rows = torch.arange(N).unsqueeze(-1)
    seen = {kind: env.satellite.find_next_opportunities(2, kind).place for kind in ("target", "target@narrow")}
    env.rewarder.memory["imaged_targets"] = env.rewarder.imaged.scatter(1, torch.cat([*seen.values()], 1), True)
    env.simulator.memory.touch()
    for kind, place in seen.items():
        left = env.satellite.find_next_opportunities(2, kind).place
        assert not env.rewarder.imaged[rows, left].any()
        assert not (left == place).any()


def test_targets_by_their_index_are_imaged_by_the_first_instrument():
    env = environment()
    td = env.reset()
    target = env.satellite.find_next_opportunities(3).place[:, 2]
    choose(env, 1)
    env.step(td.set("action", act.image_target(target)))
    assert torch.equal(env.satellite.latest_target, target)
    assert env.satellite.dynamics.instrument_index.tolist() == [0.0] * N


def test_windows_are_those_of_satellites_with_the_instrument_and_shared_without_limits():
    both, alone = environment(), environment({**NARROW, **PACKET})
    for env in (both, alone):
        env.reset()
    assert both.satellite.opportunity_types == ("ground_station", "target", "target@narrow")
    windows = both.satellite.find_windows(3000.0, "target@narrow"), alone.satellite.find_windows(3000.0)
    assert all(torch.equal(one, other) for one, other in zip(*windows, strict=True))
    env = environment({"instruments": [dyn.Instrument("a"), dyn.Instrument("b", instrumentBaudRate=1e6)]})
    assert env.satellite.opportunity_types == ("ground_station", "target")
    env = environment({"instruments": [dyn.Instrument("b", imageTargetMinimumElevation=0.9)]}, (act.Image(2),))
    assert env.satellite.opportunity_types == ("ground_station", "target@b")


def test_windows_of_an_instrument_with_a_range_are_where_it_reaches():
    env = begun(environment({"instruments": [dyn.Instrument("all"), NEAR], "imageTargetMinimumElevation": 0.5}))
    passes, near = (env.satellite.find_windows(3000.0, kind) for kind in ("target", "target@near"))
    there, counts = torch.isfinite(passes.close), [0, 0]
    for share in torch.linspace(0.02, 0.98, 7).tolist():
        time = torch.where(there, passes.open + share * (passes.close - passes.open), 0.0)
        away = torch.stack([_distance(env, time[:, k], passes.place[:, k]) for k in range(time.shape[1])], 1)
        clear = there & ((away - 8e5).abs() > 10.0)
        same = near.place.unsqueeze(1) == passes.place.unsqueeze(-1)
        moment = time.unsqueeze(-1)
        inside = (same & (near.open.unsqueeze(1) <= moment) & (moment <= near.close.unsqueeze(1))).any(-1)
        assert torch.equal(inside[clear], (away < 8e5)[clear])
        counts = [counts[0] + int(inside[clear].sum()), counts[1] + int((~inside)[clear].sum())]
    assert min(counts) > 10


def _distance(env: SatelliteTasking, time: torch.Tensor, place: torch.Tensor) -> torch.Tensor:
    r_BN_P = satellite_positions(env.satellite, torch.arange(N), time)
    return (r_BN_P - env.scenario.r_LP_P[torch.arange(N), place]).norm(dim=-1)


def test_light_limits_one_instrument():
    both = environment({"instruments": [dyn.Instrument("any"), LIT]})
    alone = environment({"imageTargetMinimumSunElevation": 0.2})
    for env in (both, alone):
        env.reset()
    windows = both.satellite.find_windows(1500.0, "target@lit"), alone.satellite.find_windows(1500.0)
    assert all(torch.equal(one, other) for one, other in zip(*windows, strict=True))
    simulator = both.simulator
    sines = simulator.uniform[simulator.tick.shared.slices["target_least_sun_of_instruments"]].flatten().tolist()
    assert sines == pytest.approx([-2.0, math.sin(0.2)])


AXES = rand.Choice([[0.0, 1.0, 1.0], [1.0, 0.0, 2.0]])
DRAWN = [
    dyn.Instrument("wide", imageAttErrorRequirement=rand.Uniform(0.01, 0.03)),
    dyn.Instrument("narrow", inst_pHat_B=AXES, instrumentBaudRate=rand.Uniform(1e6, 2e6)),
]


def test_drawn_instruments_do_not_depend_on_the_batch():
    args = {"instruments": DRAWN, **PACKET}
    many, few = (play(environment(args, num_envs=n), (3, 0)) for n in (4, N))
    assert all(torch.equal(a[:N], b) for a, b in zip(many, few, strict=True))
    env = begun(environment(args))
    sizes = env.satellite.sat_args["instruments.narrow.instrumentBaudRate"]
    assert len({*sizes.tolist()}) == N
    choose(env, 1)
    assert torch.equal(env.satellite.dynamics.instrument_baud, sizes)


@pytest.mark.compiled
def test_compiled_and_eager_agree():
    args = {"instruments": DRAWN, **PACKET, "faults": [faults.instrument(0.5, instrument="narrow", at=30.0)]}
    eager, compiled = (play(environment(args, backend=backend), (0, 3, 4)) for backend in ("eager", "compiled"))
    assert len(eager) == 24  # rewards, observations, ticks and five fields of three steps
    for one, other in zip(eager, compiled, strict=True):
        torch.testing.assert_close(one, other, rtol=1e-9, atol=1e-9)


def test_rejects_wrong_instruments():
    def listed(instruments, **args):
        return environment({"instruments": instruments, **args}, (act.Charge(duration=60.0),))

    def own(**values):
        return listed([dyn.Instrument("a", **values)])

    lost, mine = faults.instrument(0.0), faults.instrument(0.0, instrument="a")
    literal = "bsk_torch.bsk_rl", "bsk_torch.sats"
    spec = {"observation_spec": [literal_obs.Time()], "action_spec": [literal_act.Image(n_ahead_image=2)]}
    imager = type("Imager", (literal_sats.ImagingSatellite,), spec)
    check_refusals(
        refusal(lambda: listed(3), ValueError, "instruments=3", "dyn.Instrument"),
        refusal(lambda: listed([]), ValueError, "instruments=[]", "dyn.Instrument"),
        refusal(lambda: listed([dyn.Instrument("a")] * 2), ValueError, "2 instruments", "'a'"),
        refusal(lambda: own(inst_pHat_B=[0, 0, 0]), ValueError, "instrument 'a'", "inst_pHat_B=[0, 0, 0]"),
        refusal(lambda: own(instrumentBaudRate=-1.0), ValueError, "instruments.a.instrumentBaudRate=-1 bit"),
        refusal(lambda: own(imageTargetMinimumElevation=2.0), ValueError, "'a'", "MinimumElevation=2 rad", "[0, pi/2)"),
        refusal(lambda: listed(PAIR, faults=[lost]), ValueError, "'wide'", "'instruments.wide.instrumentBaudRate'"),
        refusal(lambda: listed([dyn.Instrument("a")], faults=[mine]), ValueError, "'instruments.a.instrumentBaudRate'"),
        refusal(lambda: imager("A", {"instruments": PAIR}), ValueError, "['instruments']", *literal),
        refusal(lambda: image_actions(environment()), ValueError, "A has", "instruments", "rules"),
    )


def test_rejects_instruments_that_the_satellite_lacks():
    def imaging(*args, **instrument):
        return environment(*args, actions=(act.Image(3, **instrument),))

    station = {"type": "ground_station", "n_ahead_observe": 2, "instrument": "wide"}
    observe = obs.OpportunityProperties
    check_refusals(
        refusal(lambda: imaging(instrument="narow"), ValueError, "act.Image", "instrument='narow'", "'narrow'"),
        refusal(lambda: imaging(instrument=2), ValueError, "act.Image", "instrument=2", "narrow, wide"),
        refusal(lambda: imaging(), ValueError, "act.Image", "instrument=", "['wide', 'narrow']"),
        refusal(lambda: imaging({}, instrument="wide"), ValueError, "act.Image", "instrument='wide'", "instruments=["),
        refusal(lambda: environment({}, observed=(_angles("wide"),)), ValueError, "instrument='wide'", "instruments=["),
        refusal(lambda: observe(dict(prop="r_LP_P"), **station), ValueError, "instrument='wide'", "'ground_station'"),
    )


def test_instruments_have_names_numbers_and_the_smallest_packet():
    env = environment(actions=(act.Image(2, 5.0, instrument=0), act.Image(2, 5.0, instrument=1)))
    td = env.reset()
    env.step(td.set("action", torch.full((N,), 2)))
    assert env.satellite.dynamics.instrument_index.tolist() == [1.0] * N
    check_refusals(refusal(lambda: dyn.Instrument(3), ValueError, "name=3"))
    assert dyn.Instrument("a", inst_pHat_B=[0, 0, 1]) == dyn.Instrument("a", inst_pHat_B=(0, 0, 1))
    simulator = environment({"instruments": PAIR}).simulator
    assert simulator.uniform[simulator.tick.shared.slices["packet_size"]].item() == -1.5e6


def test_satellites_without_an_instrument_have_no_list():
    class Bus(sats.Satellite):
        observation_spec = (obs.Time(),)
        action_spec = (act.Charge(),)
        dyn_type = dyn.BasicDynamicsModel
        fsw_type = fsw.BasicFSWModel

    with pytest.raises(KeyError, match=re.escape("it belongs to dyn.ImagingDynModel")):
        SatelliteTasking(Bus("A", {"instruments": PAIR}))
    assert hint("instruments", ()).startswith("it belongs to dyn.ImagingDynModel")
