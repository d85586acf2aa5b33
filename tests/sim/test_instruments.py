"""Several instruments on one satellite: each step is that of a satellite with the chosen one alone."""

from __future__ import annotations

import math
import re
from typing import Any

import pytest
import torch

from bsk_torch import SatelliteTasking, act, data, obs, rand, sats, scene
from bsk_torch.bsk_rl import act as literal_act
from bsk_torch.bsk_rl import obs as literal_obs
from bsk_torch.bsk_rl import sats as literal_sats
from bsk_torch.plan.bounds.windows import satellite_positions
from bsk_torch.rl.rules.targets import image_actions
from bsk_torch.sim import dyn, faults, fsw
from bsk_torch.sim.arguments.sources import hint

N, TARGETS = 4, 600
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
    named = [part.name for part in args.get("instruments") or ()] or [None]
    images = tuple(act.Image(3, instrument=name) for name in named)

    class Imager(sats.ImagingSatellite):
        observation_spec = (obs.Time(), *observed)
        action_spec = (*images, act.Charge(duration=120.0)) if actions is None else actions
        dyn_type = dyn.GroundStationDynModel
        fsw_type = fsw.ImagingFSWModel

    return SatelliteTasking(
        Imager("A", args),
        **{
            "scenario": scene.UniformTargets(TARGETS),
            "rewarder": data.UniqueImageReward(),
            "num_envs": N,
            "time_limit": 6000.0,
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


# -- each step is that of one instrument ------------------------------------------------------------------------------------


@pytest.mark.parametrize("backend", ["eager", pytest.param("compiled", marks=pytest.mark.compiled)])
@pytest.mark.parametrize(
    "one",
    [
        dyn.Instrument("only"),
        dyn.Instrument("only", inst_pHat_B=[0, 0, 1], imageAttErrorRequirement=0.01, instrumentBaudRate=8e6),
    ],
)
def test_one_instrument_is_that_of_bsk_rl(one, backend):
    angle = (obs.OpportunityProperties(dict(prop="target_angle"), dict(prop="priority"), n_ahead_observe=3),)
    flown = [
        play(environment(args, observed=angle, backend=backend), (0, 1, 0, 3, 2))
        for args in ({**PACKET}, {"instruments": [one], **PACKET})
    ]
    assert_same(*flown)


@pytest.mark.parametrize("backend", ["eager", pytest.param("compiled", marks=pytest.mark.compiled)])
def test_each_step_is_that_of_a_satellite_with_the_chosen_instrument(backend):
    both = environment(backend=backend)
    alone = [environment({**own, **PACKET}, backend=backend) for own in (WIDE, NARROW)]
    for env in (both, *alone):
        env.reset()
    everywhere, places = torch.ones(N, dtype=torch.bool), both.satellite.find_windows(1200.0)
    simulators = [env.simulator for env in (both, *alone)]
    layout, took = simulators[1].state.layout, 0.0
    for step, number in enumerate((0, 1, 1, 0, 1, 0)):
        target = both.scenario.r_LP_P[torch.arange(N), places.place[:, step]]
        simulators[0].write("instrument_index", everywhere, torch.full((N,), float(number)))
        other = simulators[1 + number]
        for name in layout.fields:  # the same state
            other.state.planes[layout.slices[name]] = simulators[0].state.planes[simulators[0].state.layout.slices[name]]
        other.state.ticks = simulators[0].ticks.clone()
        before = simulators[0].read("storage").sum()
        for simulator in (simulators[0], other):
            simulator.command(everywhere, torch.full((N,), simulator.mode_names.index("image")))
            simulator.write("r_LP_P", everywhere, target)
            simulator.run(torch.full((N,), 150))
        for name in layout.fields:
            assert torch.equal(simulators[0].read(name), other.read(name)), name
        took += float(simulators[0].read("storage").sum() - before)
    assert took > 0.0


def test_the_chosen_instrument_points_at_the_target():
    env = environment(observed=(_angles(None), _angles("wide")))
    td = env.reset()
    for action in (0, 3, 4, 1):
        td = env.step(td.set("action", torch.full((N,), action)))["next"]
        dynamics, r_LP_P = env.satellite.dynamics, env.simulator.read("r_LP_P")
        line = torch.nn.functional.normalize(r_LP_P - dynamics.r_BN_P, dim=-1)
        axis = torch.tensor([0.0, 0.0, 1.0] if action < 3 else NARROW["inst_pHat_B"], dtype=torch.float64)
        axis = (dynamics.BP.mT @ (axis / axis.norm())).expand(N, 3)
        torch.testing.assert_close(env.satellite.fsw.c_hat_P, axis, rtol=0, atol=1e-12)
        took = env.requires_retasking & (env.satellite.imaged > 0)
        limit = 4.0 * math.atan(WIDE["imageAttErrorRequirement"] if action < 3 else NARROW["imageAttErrorRequirement"])
        angle = torch.acos((line * axis).sum(-1).clamp(-1.0, 1.0))
        assert bool((angle[took] < limit + 0.05).all())  # a tick or two later
        shown, wide = td["observation"][:, 1:].chunk(2, -1)  # of the same windows
        assert torch.allclose(shown, wide, rtol=0, atol=1e-12) == (action < 3)


def _angles(instrument: str | None) -> obs.OpportunityProperties:
    return obs.OpportunityProperties(dict(prop="target_angle"), n_ahead_observe=2, instrument=instrument)


def test_observed_angles_are_those_of_a_satellite_with_the_instrument():
    both, alone = environment(observed=(_angles("narrow"),)), environment({**NARROW, **PACKET}, observed=(_angles(None),))
    torch.testing.assert_close(both.reset()["observation"], alone.reset()["observation"], rtol=0, atol=1e-12)
    assert both.satellite.observation_description[1] == "target_narrow.target_narrow_0.target_angle"


def test_power_and_data_are_those_of_the_chosen_instrument():
    free = {"basePowerDraw": 0.0, "rwBasePower": 0.0, "panelArea": 1e-9, "u_max": 1e-6, "dataStorageCapacity": 1e12}
    env = environment({"instruments": PAIR, **PACKET, **free})
    for number, power in ((0, -30.0), (1, -80.0)):
        env.reset()
        simulator, everywhere = env.simulator, torch.ones(N, dtype=torch.bool)
        simulator.write("instrument_index", everywhere, torch.full((N,), float(number)))
        simulator.command(everywhere, torch.full((N,), simulator.mode_names.index("image")))
        before = simulator.read("charge")
        simulator.run(torch.full((N,), 10))
        torch.testing.assert_close(simulator.read("charge") - before, torch.full((N,), 10.0 * power).double(), rtol=0, atol=0.5)
        baud = torch.full((N,), (WIDE, NARROW)[number]["instrumentBaudRate"]).double()
        assert torch.equal(env.satellite.dynamics.instrument_baud, baud)
        assert env.satellite.dynamics.instrument_index.tolist() == [number] * N


def test_packets_are_as_small_as_the_smallest_image():
    env = environment({"instruments": PAIR})
    assert env.simulator.uniform[env.simulator.tick.shared.slices["packet_size"]].item() == -1.5e6


# -- actions ----------------------------------------------------------------------------------------------------------------


def test_the_same_target_with_another_instrument_is_another_task():
    env = environment({"instruments": [dyn.Instrument("a"), dyn.Instrument("b", inst_pHat_B=[1, 0, 1])], **PACKET})
    td = env.reset()
    assert env.satellite.action_description[:4] == [
        "action_image_a_0",
        "action_image_a_1",
        "action_image_a_2",
        "action_image_b_0",
    ]
    a, b = (env.satellite.actions.entries[k] for k in (0, 1))
    index, mask = torch.zeros(N, dtype=torch.int64), torch.ones(N, dtype=torch.bool)
    one = a.decide(index, mask, index, torch.full((N,), -1))
    again, other = a.decide(index, mask, index, one.key), b.decide(index, mask, index + 3, one.key)
    assert not again.retask.any()
    assert other.retask.all()
    assert torch.equal(a.targets(one.key), b.targets(other.key))
    env.step(td.set("action", torch.full((N,), 3)))
    assert torch.equal(env.satellite.latest_target, b.targets(other.key))


def test_what_was_commanded_to_another_instrument_is_withdrawn():
    env = environment()
    env.reset()
    everywhere, first = torch.ones(N, dtype=torch.bool), torch.zeros(N, dtype=torch.int64)
    wide, narrow = env.satellite.actions.entries[:2]
    env.simulator.write("instrument_command", everywhere, torch.ones(N))
    for entry, left in ((wide, 1.0), (narrow, 0.0)):
        entry.begin(everywhere, entry.decide(first, everywhere, first, first))
        assert env.simulator.read("instrument_command").tolist() == [left] * N


def test_images_of_one_instrument_hide_targets_from_the_others():
    env = environment({"instruments": [dyn.Instrument("a"), dyn.Instrument("b", imageTargetMinimumElevation=0.5)], **PACKET})
    td = env.reset()
    for _ in range(4):
        td = env.step(td.set("action", torch.zeros(N, dtype=torch.int64)))["next"]
    imaged, rows = env.rewarder.imaged, torch.arange(N).unsqueeze(-1)
    assert imaged.any()
    for kind in ("target", "target@b"):
        assert not imaged[rows, env.satellite.find_next_opportunities(5, kind).place].any()


def test_targets_by_their_index_are_imaged_by_the_first_instrument():
    env = environment()
    td = env.reset()
    target = env.satellite.find_next_opportunities(3).place[:, 2]
    env.step(td.set("action", act.image_target(target)))
    assert torch.equal(env.satellite.latest_target, target)
    assert env.satellite.dynamics.instrument_index.tolist() == [0.0] * N


# -- windows ----------------------------------------------------------------------------------------------------------------


def test_windows_are_those_of_a_satellite_with_the_instrument():
    both, alone = environment(), environment({**NARROW, **PACKET})
    for env in (both, alone):
        env.reset()
    assert both.satellite.opportunity_types == ("ground_station", "target", "target@narrow")
    for one, other in zip(
        both.satellite.find_windows(3000.0, "target@narrow"), alone.satellite.find_windows(3000.0), strict=True
    ):
        assert torch.equal(one, other)


def test_instruments_without_limits_share_windows():
    env = environment({"instruments": [dyn.Instrument("a"), dyn.Instrument("b", instrumentBaudRate=1e6)]})
    assert env.satellite.opportunity_types == ("ground_station", "target")
    env = environment({"instruments": [dyn.Instrument("b", imageTargetMinimumElevation=0.9)]}, (act.Image(2),))
    assert env.satellite.opportunity_types == ("ground_station", "target@b")
    env.reset()


def test_windows_of_an_instrument_with_a_range_are_where_it_reaches():
    env = environment({"instruments": [dyn.Instrument("all"), NEAR], "imageTargetMinimumElevation": 0.5})
    env.reset()
    passes, near = (env.satellite.find_windows(6000.0, kind) for kind in ("target", "target@near"))
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
    assert min(counts) > 50


def _distance(env: SatelliteTasking, time: torch.Tensor, place: torch.Tensor) -> torch.Tensor:
    r_BN_P = satellite_positions(env.satellite, torch.arange(N), time)
    return (r_BN_P - env.scenario.r_LP_P[torch.arange(N), place]).norm(dim=-1)


def test_light_limits_one_instrument():
    both = environment({"instruments": [dyn.Instrument("any"), LIT]})
    alone = environment({"imageTargetMinimumSunElevation": 0.2}, (act.Image(3),))
    for env in (both, alone):
        env.reset()
    windows = both.satellite.find_windows(2000.0, "target@lit"), alone.satellite.find_windows(2000.0)
    assert all(torch.equal(one, other) for one, other in zip(*windows, strict=True))
    simulator = both.simulator
    sines = simulator.uniform[simulator.tick.shared.slices["target_least_sun_of_instruments"]].flatten().tolist()
    assert sines == pytest.approx([-2.0, math.sin(0.2)])


# -- draws, backends, batches -----------------------------------------------------------------------------------------------

DRAWN = [
    dyn.Instrument("wide", imageAttErrorRequirement=rand.Uniform(0.01, 0.03)),
    dyn.Instrument(
        "narrow", inst_pHat_B=rand.Choice([[0.0, 1.0, 1.0], [1.0, 0.0, 2.0]]), instrumentBaudRate=rand.Uniform(1e6, 2e6)
    ),
]


def test_drawn_instruments_do_not_depend_on_the_batch():
    args = {"instruments": DRAWN, **PACKET}
    many, few = (play(environment(args, num_envs=n), (0, 3, 4, 1)) for n in (4, 2))
    assert all(torch.equal(a[:2], b) for a, b in zip(many, few, strict=True))
    env = environment(args)
    env.reset()
    sizes = env.satellite.sat_args["instruments.narrow.instrumentBaudRate"]
    assert len({*sizes.tolist()}) == N
    assert torch.equal(env.satellite.dynamics.instrument_baud, torch.full((N,), 8e6).double())


@pytest.mark.compiled
def test_compiled_and_eager_agree():
    args = {"instruments": DRAWN, **PACKET, "faults": [faults.instrument(0.5, instrument="narrow", at=300.0)]}
    eager, compiled = (play(environment(args, backend=backend), (0, 3, 4, 1, 3)) for backend in ("eager", "compiled"))
    for one, other in zip(eager, compiled, strict=True):
        torch.testing.assert_close(one, other, rtol=1e-9, atol=1e-9)


def test_one_instrument_fails_alone():
    args = {"instruments": PAIR, **PACKET}
    whole, broken = (
        environment(args | {"faults": listed}) for listed in (None, [faults.instrument(0.0, instrument="narrow", at=0.0)])
    )
    assert broken.satellite.sat_args["faults"][0].name == "instrument_narrow"
    grown = []
    for env in (whole, broken):
        td, levels = env.reset(), []
        for action in (0, 0, 0, 3, 3, 3):
            td = env.step(td.set("action", torch.full((N,), action)))["next"]
            levels.append(env.satellite.dynamics.storage_level.clone())
        grown.append((levels[2], levels[5] - levels[2]))
    assert torch.equal(grown[0][0], grown[1][0])
    assert grown[0][1].sum() > 0.0
    assert grown[1][1].sum() == 0.0


def test_saved_states_keep_the_instrument():
    env = environment()
    td = env.reset()
    env.step(td.set("action", torch.full((N,), 3)))
    other = environment()
    other.restore(env.get_state())
    assert other.satellite.dynamics.instrument_index.tolist() == [1.0] * N


# -- errors -----------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("args", "message"),
    [
        ({"instruments": 3}, "instruments=3 must be a list of instruments, such as"),
        ({"instruments": []}, "must be a list of instruments"),
        ({"instruments": [dyn.Instrument("a"), dyn.Instrument("a")]}, "2 instruments are named 'a'; give each another name"),
        ({"instruments": [dyn.Instrument("a", inst_pHat_B=[0, 0, 0])]}, "instrument 'a': inst_pHat_B=[0, 0, 0] has no direction"),
        (
            {"instruments": [dyn.Instrument("a", instrumentBaudRate=-1.0)]},
            "instruments.a.instrumentBaudRate=-1 bit is not allowed",
        ),
        (
            {"instruments": [dyn.Instrument("a", imageTargetMinimumElevation=2.0)]},
            "instrument 'a': imageTargetMinimumElevation=2 rad must lie between 0 and pi/2",
        ),
        (
            {"instruments": PAIR, "faults": [faults.instrument(0.0)]},
            "changes instrumentBaudRate, but instrument 'wide' has its own; change 'instruments.wide.instrumentBaudRate'",
        ),
        (
            {"instruments": [dyn.Instrument("a")], "faults": [faults.instrument(0.0, instrument="a")]},
            "changes the unknown argument 'instruments.a.instrumentBaudRate'",
        ),
    ],
)
def test_wrong_instruments_are_rejected(args, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        environment(args, (act.Charge(duration=60.0),))


@pytest.mark.parametrize(
    ("action", "message"),
    [
        (act.Image(3, instrument="narow"), "instrument='narow', which the satellite lacks; did you mean 'narrow'?"),
        (act.Image(3, instrument=2), "instrument=2, which the satellite lacks"),
        (act.Image(3), "does not say which instrument it uses; give instrument= one of ['wide', 'narrow']"),
    ],
)
def test_actions_name_an_instrument_that_exists(action, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        environment(actions=(action,))


def test_instruments_by_number():
    env = environment(actions=(act.Image(2, instrument=0), act.Image(2, instrument=1)))
    td = env.reset()
    env.step(td.set("action", torch.full((N,), 2)))
    assert env.satellite.dynamics.instrument_index.tolist() == [1.0] * N


def test_a_satellite_with_one_instrument_has_none_to_choose():
    with pytest.raises(ValueError, match=re.escape("instrument='wide', but the satellite has a single one")):
        environment({}, (act.Image(3, instrument="wide"),))
    with pytest.raises(ValueError, match=re.escape("instrument='wide', but the satellite has a single one")):
        environment({}, observed=(_angles("wide"),))
    with pytest.raises(ValueError, match="those of type 'ground_station' have none"):
        obs.OpportunityProperties(dict(prop="r_LP_P"), n_ahead_observe=2, type="ground_station", instrument="wide")


def test_an_instrument_needs_a_name():
    with pytest.raises(ValueError, match="Instrument: name=3 must be a string"):
        dyn.Instrument(3)
    assert dyn.Instrument("a", inst_pHat_B=[0, 0, 1]) == dyn.Instrument("a", inst_pHat_B=(0, 0, 1))


def test_scanning_satellites_have_one_instrument():
    class Scanner(sats.Satellite):
        observation_spec = (obs.Time(),)
        action_spec = (act.Scan(),)
        dyn_type = dyn.ContinuousImagingDynModel
        fsw_type = fsw.ContinuousImagingFSWModel

    with pytest.raises(KeyError, match=re.escape("it belongs to dyn.ImagingDynModel")):
        SatelliteTasking(Scanner("A", {"instruments": PAIR}))
    assert hint("instruments", ()).startswith("it belongs to dyn.ImagingDynModel")


def test_satellites_of_bsk_rl_have_one_instrument():
    spec = {"observation_spec": [literal_obs.Time()], "action_spec": [literal_act.Image(n_ahead_image=2)]}
    imager = type("Imager", (literal_sats.ImagingSatellite,), spec)
    with pytest.raises(ValueError, match=re.escape("satellites of bsk_torch.bsk_rl have one")):
        imager("A", {"instruments": PAIR})


def test_rules_do_not_choose_instruments():
    with pytest.raises(ValueError, match="several instruments, between which rules"):
        image_actions(environment())
