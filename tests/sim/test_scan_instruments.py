"""Several instruments on a satellite that scans: each step is that of a satellite with the chosen one alone."""

from typing import Any

import pytest
import torch

from bsk_torch import SatelliteTasking, act, data, obs, rand, scene
from bsk_torch.bsk_rl import act as literal_act
from bsk_torch.bsk_rl import obs as literal_obs
from bsk_torch.bsk_rl import sats as literal_sats
from bsk_torch.bsk_rl.sim import dyn as literal_dyn
from bsk_torch.bsk_rl.sim import fsw as literal_fsw
from bsk_torch.lab.bounds.scanning import check_scanning
from bsk_torch.presets.nadir_scan import ScanningSatellite
from bsk_torch.sim import dyn, faults, fsw
from bsk_torch.tasks.inspection import RSOInspectorDynModel
from tests.sim.instrument_steps import assert_steps_are_equal, choose
from tests.support.refusals import check_refusals, refusal

N = 2
STILL = {"sigma_init": [0.1, -0.2, 0.3], "omega_init": [0.0, 0.0, 0.0]}
FIXED = {"imageAttErrorRequirement": 0.1, "dataStorageCapacity": 1e12, "transmitterPacketSize": -1e6, **STILL}
SWATH, RADAR = (
    {"instrumentBaudRate": 3e6},
    {
        "inst_pHat_B": [0.6, 0.0, 1.6],
        "imageAttErrorRequirement": 0.05,
        "imageRateErrorRequirement": 0.01,
        "imageTargetMaximumRange": 7.2e6,
        "instrumentBaudRate": 1.5e6,
        "instrumentPowerDraw": -80.0,
    },
)
PAIR = [dyn.Instrument("swath", **SWATH), dyn.Instrument("radar", **RADAR)]


def environment(args: dict[str, Any] | None = None, actions: tuple[Any, ...] | None = None, **options: Any) -> SatelliteTasking:
    args = {"instruments": PAIR} if args is None else args
    named = [part.name for part in args.get("instruments") or ()] or [None] if actions is None else []
    scans = tuple(act.Scan(duration=60.0, instrument=name) for name in named)

    class Scanner(ScanningSatellite):
        observation_spec = (obs.Time(), obs.SatProperties(dict(prop="instrument_pointing_error")))
        action_spec = (*scans, act.Charge(duration=20.0)) if actions is None else actions

    return SatelliteTasking(
        Scanner("A", {**FIXED, **args}),
        **{
            "scenario": scene.UniformNadirScanning(),
            "rewarder": data.ScanningTimeReward(),
            "num_envs": N,
            "time_limit": 3000.0,
            "seed": 0,
            "backend": "eager",
            **options,
        },
    )


def step(env: SatelliteTasking, td: Any, action: int) -> Any:
    return env.step(td.set("action", torch.full((N,), action)))["next"]


@pytest.mark.parametrize(
    ("backend", "ticks", "numbers"),
    [("eager", 12, (1, 0)), pytest.param("compiled", 150, (0, 1, 1, 0, 1), marks=pytest.mark.compiled)],
)
@pytest.mark.nightly("eager")
def test_each_step_is_that_of_a_satellite_with_the_chosen_instrument(backend, ticks, numbers):
    both = environment(backend=backend)
    alone = [environment(own, backend=backend) for own in (SWATH, RADAR)]
    for env in (both, *alone):
        env.reset()

    def scan(simulator, step):
        simulator.command(torch.ones(N, dtype=torch.bool), torch.full((N,), simulator.mode_names.index("nadir_scan")))

    grew = assert_steps_are_equal(both, alone, numbers, ticks, scan)
    assert backend == "eager" or all(grew)


@pytest.mark.compiled
def test_steps_of_one_instrument_are_those_of_a_satellite_without_a_list():
    listed = {"instruments": [dyn.Instrument("radar", **RADAR)]}, RADAR
    flown = []
    for args in listed:
        env = environment(args, backend="compiled")
        td, found = env.reset(), []
        for action in (0, 0, 1, 0):
            td = step(env, td, action)
            found += [
                td["reward"].clone(),
                td["observation"].clone(),
                env.simulator.read("charge"),
                env.simulator.read("storage"),
            ]
        flown.append(found)
    assert all(torch.equal(a, b) for a, b in zip(*flown, strict=True))
    assert any(bool((value > 0).all()) for value in flown[0][::4])


@pytest.mark.compiled
def test_rewards_are_seconds_of_the_chosen_instrument():
    env = environment(backend="compiled")
    td = env.reset()
    for action, own in ((0, SWATH), (0, SWATH), (1, RADAR), (1, RADAR), (0, SWATH)):
        level = env.simulator.read("storage")
        td = step(env, td, action)
        seconds = (env.simulator.read("storage") - level) / own["instrumentBaudRate"]
        torch.testing.assert_close(td["reward"].flatten(), seconds, rtol=0, atol=1e-9, check_dtype=False)
        assert env.satellite.dynamics.instrument_index.tolist() == [float(action)] * N
    assert bool((seconds > 0.0).all())


@pytest.mark.parametrize("broken", [None, [faults.instrument(0.0, instrument="radar", at=0.0)]], ids=["whole", "broken"])
def test_power_and_data_are_those_of_the_chosen_instrument(broken):
    free = {"basePowerDraw": 0.0, "rwBasePower": 0.0, "panelArea": 1e-9, "u_max": 1e-6, "imageAttErrorRequirement": 1.0}
    open_ended = {"imageAttErrorRequirement": 1.0, "imageRateErrorRequirement": 1e3, "imageTargetMaximumRange": -1.0}
    listed = [PAIR[0], dyn.Instrument("radar", **RADAR | open_ended)]
    env = environment({"instruments": listed, **free, "imageRateErrorRequirement": 1e3, "faults": broken})
    env.reset()
    simulator, everywhere = env.simulator, torch.ones(N, dtype=torch.bool)
    for number, power in ((0, -30.0), (1, -80.0)):
        choose(env, number)
        simulator.command(everywhere, torch.full((N,), simulator.mode_names.index("nadir_scan")))
        simulator.run(torch.full((N,), 2))  # the command comes a tick after the access of the first
        charge, level = simulator.read("charge"), simulator.read("storage")
        simulator.run(torch.full((N,), 3))
        torch.testing.assert_close(simulator.read("charge") - charge, torch.full((N,), 3.0 * power).double(), rtol=0, atol=0.1)
        rate = 0.0 if broken and number else (SWATH, RADAR)[number]["instrumentBaudRate"]
        assert (simulator.read("storage") - level).tolist() == [3.0 * rate] * N
        assert env.satellite.dynamics.instrument_baud.tolist() == [(SWATH, RADAR)[number]["instrumentBaudRate"]] * N


def test_only_the_same_instrument_continues_a_scan():
    again = act.Scan(name="again", duration=30.0, instrument="radar")
    env = environment(actions=(act.Scan(instrument="swath"), act.Scan(instrument="radar"), act.Charge(), again))
    env.reset()
    assert env.satellite.action_description == [
        "action_nadir_scan_swath",
        "action_nadir_scan_radar",
        "action_charge",
        "again_radar",
    ]
    everywhere, actions = torch.ones(N, dtype=torch.bool), env.satellite.actions
    first = actions.decide(torch.ones(N, dtype=torch.int64), torch.full((N,), -1), everywhere)
    for action, retasks in ((0, True), (1, False), (2, True), (3, False)):
        decision = actions.decide(torch.full((N,), action), first.key, everywhere)
        assert decision.retask.tolist() == [retasks] * N


def test_commands_to_another_instrument_are_withdrawn():
    env = environment()
    td = env.reset()
    everywhere, zeros = torch.ones(N, dtype=torch.bool), torch.zeros(N, dtype=torch.int64)
    env.simulator.write("instrument_command", everywhere, torch.ones(N))
    for entry, left in ((0, 1.0), (1, 0.0)):
        scan = env.satellite.actions.entries[entry]
        scan.begin(everywhere, scan.decide(zeros, everywhere, zeros + entry, zeros))
        assert env.simulator.read("instrument_command").tolist() == [left] * N
    rows = torch.tensor([True, False])
    scan = env.satellite.actions.entries[0]
    scan.begin(rows, scan.decide(zeros, rows, zeros, zeros))
    assert env.satellite.dynamics.instrument_index.tolist() == [0.0, 1.0]
    step(env, td, 0)
    other = environment()
    other.restore(env.get_state())
    assert other.satellite.dynamics.instrument_index.tolist() == [0.0, 0.0]


def test_pointing_errors_are_those_of_the_chosen_instrument():
    both = environment()
    alone = environment(RADAR)
    for env in (both, alone):
        env.reset()
    choose(both, 1)
    assert torch.equal(both.satellite.dynamics.instrument_pointing_error, alone.satellite.dynamics.instrument_pointing_error)
    choose(both, 0)
    assert not torch.equal(both.satellite.dynamics.instrument_pointing_error, alone.satellite.dynamics.instrument_pointing_error)


@pytest.mark.compiled
def test_drawn_instruments_do_not_depend_on_the_batch_and_backends_agree():
    drawn = [PAIR[0], dyn.Instrument("radar", instrumentBaudRate=rand.Uniform(1e6, 2e6), imageAttErrorRequirement=0.05)]
    flown = []
    for options in ({"backend": "compiled"}, {"backend": "compiled", "num_envs": 2 * N}, {"backend": "eager"}):
        env = environment(
            {"instruments": drawn}, (act.Scan(duration=8.0, instrument=0), act.Scan(duration=8.0, instrument=1)), **options
        )
        td = env.reset()
        for action in (1, 0):
            td = env.step(td.set("action", torch.full((len(env.env_ids),), action)))["next"]
        flown.append([env.simulator.read(name)[:N] for name in ("sigma_BN", "charge", "storage")])
    assert all(torch.equal(a, b) for a, b in zip(flown[0], flown[1], strict=True))
    for a, b in zip(flown[0], flown[2], strict=True):
        torch.testing.assert_close(a, b, rtol=1e-9, atol=1e-9)


def test_rejects_wrong_instruments():
    def scan(*args, **instrument):
        return environment(*args, actions=(act.Scan(**instrument),))

    def radar(name):
        return environment({"instruments": [dyn.Instrument("radar", **{name: 0.2})]})

    class Inspector(ScanningSatellite):
        observation_spec, action_spec = (obs.Time(),), (act.Charge(),)
        dyn_type, fsw_type = (RSOInspectorDynModel,), fsw.ContinuousImagingFSWModel

    class Scanner(literal_sats.Satellite):
        observation_spec, action_spec = (literal_obs.Time(),), (literal_act.Scan(duration=60.0),)
        dyn_type, fsw_type = literal_dyn.ContinuousImagingDynModel, literal_fsw.ContinuousImagingFSWModel

    pair, elevation, light = {"instruments": PAIR}, "imageTargetMinimumElevation", "imageTargetMinimumSunElevation"
    lost = pair | {"faults": [faults.instrument(0.0)]}
    bounded = environment(scenario=scene.UniformNadirScanning(value_per_second=1.0), failure_penalty=-1.0)
    bounded.reset()
    check_refusals(
        refusal(lambda: scan(instrument="rader"), ValueError, "act.Scan", "instrument='rader'", "'radar'"),
        refusal(lambda: scan(instrument=2), ValueError, "act.Scan", "instrument=2", "radar, swath"),
        refusal(lambda: scan(), ValueError, "act.Scan 'action_nadir_scan'", "instrument=", "['swath', 'radar']"),
        refusal(lambda: scan({}, instrument="radar"), ValueError, "act.Scan", "instrument='radar'", "instruments=["),
        refusal(lambda: radar(elevation), ValueError, "instrument 'radar'", elevation),
        refusal(lambda: radar(light), ValueError, "instrument 'radar'", light),
        refusal(lambda: environment(lost), ValueError, "instrument 'swath'", "'instruments.swath.instrumentBaudRate'"),
        refusal(lambda: check_scanning(bounded), ValueError, "bound of scanning", "one instrument", "list of instruments"),
        refusal(lambda: Scanner("A", pair), ValueError, "['instruments']", "bsk_torch.bsk_rl", "bsk_torch.sats"),
        refusal(lambda: SatelliteTasking(Inspector("A", pair)), KeyError, "['instruments']", "dyn.ImagingDynModel"),
    )
