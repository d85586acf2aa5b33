"""Programs of bsk_rl play the episodes here that bsk_rl plays on Basilisk under the same seeds."""

import copy
import json
import logging
import os
import subprocess
import sys
from abc import ABCMeta
from pathlib import Path

import gymnasium
import numpy as np
import pytest

from bsk_torch.bsk_rl import ConstellationTasking, GeneralSatelliteTasking, SatelliteTasking, act, comm, data, obs, sats, scene
from bsk_torch.bsk_rl.basilisk.architecture import bskLogging, messaging
from bsk_torch.bsk_rl.basilisk.utilities import macros
from bsk_torch.bsk_rl.sim import dyn, fsw, world
from bsk_torch.bsk_rl.utils import functional
from bsk_torch.bsk_rl.utils.orbital import random_circular_orbit, relative_to_chief
from tests.bsk_rl import programs
from tests.support.refusals import check_refusals, refusal

RECORDED = Path(__file__).parent / "data"

TOLERANCE = 1e-6
"""Largest difference of a result: predicted orbits differ by up to 0.2 m, which is 1e-7 of distances to targets."""


FEWEST = {"horizon": 250}
"""Least count of numbers in the results of short programs."""


def leaves(value, path=()):
    """Yield the numbers of a result with their places."""
    if isinstance(value, dict | list):
        for name, part in value.items() if isinstance(value, dict) else enumerate(value):
            yield from leaves(part, (*path, name))
    else:
        yield path, value


@pytest.mark.compiled
@pytest.mark.parametrize("name", programs.PROGRAMS)
def test_a_seed_gives_the_episode_of_bsk_rl(name):
    wanted = dict(leaves(json.loads((RECORDED / f"{name}.json").read_text())))
    found = dict(leaves(json.loads(json.dumps(programs.play(name, "bsk_torch.bsk_rl")))))
    assert found.keys() == wanted.keys()
    assert len(wanted) > FEWEST.get(name, 400)
    for path, value in wanted.items():
        assert found[path] == pytest.approx(value, abs=TOLERANCE), path


class Drifter(sats.Satellite):
    observation_spec = [obs.SatProperties(dict(prop="r_BN_N")), obs.Time()]
    action_spec = [act.Drift(duration=60.0), act.Charge(duration=30.0)]
    dyn_type = (dyn.ConjunctionDynModel, dyn.BasicDynamicsModel)
    fsw_type = fsw.BasicFSWModel


@pytest.fixture(scope="module")
def env():
    made = SatelliteTasking(Drifter("Drifter"), time_limit=100.0, backend="eager")
    made.reset(seed=0)
    return made


def test_attributes_can_be_set_and_read(env):
    env.satellite.mine = 3
    env.reset(seed=1)
    assert env.satellite.mine == 3
    env.satellite.variable_interval, env.max_step_duration = False, 20.0
    env.reset(seed=1)
    assert env.step(0)[4]["d_ts"] == 20.0
    env.satellite.variable_interval, env.max_step_duration = True, 1e9
    env.satellite.observation_builder.obs_type = dict
    assert set(env.satellite.get_obs()) == {"sat_props", "time"}
    env.satellite.observation_builder.obs_type = np.ndarray


def test_satellites_are_abstract_base_classes():
    assert isinstance(sats.Satellite, ABCMeta)


def test_models_are_instances_of_their_classes(env):
    assert isinstance(env.satellite.dynamics, dyn.BasicDynamicsModel)
    assert isinstance(env.satellite.fsw, fsw.BasicFSWModel)
    assert not isinstance(env.satellite.fsw, fsw.ImagingFSWModel)


def test_steps_after_the_end_take_no_time(env):
    env.reset(seed=0)
    while not env.step(0)[3]:
        pass
    assert env.step(1)[4]["d_ts"] == 0.0


def test_a_battery_can_be_emptied_by_its_message(env):
    env.reset(seed=0)
    model = env.satellite.dynamics
    model.powerMonitor.batPowerOutMsg.write(messaging.PowerStorageStatusMsgPayload(storageLevel=0.0))
    assert not model.battery_valid()
    assert not env.satellite.is_alive()
    assert env.satellite.time_of_death == 0.0
    with pytest.raises(TypeError, match="follows from the simulation"):
        model.scObject.scStateOutMsg.write(None)


def test_vectors_that_are_lists_in_bsk_rl_are_lists(env):
    env.reset(seed=0)
    model = env.satellite.dynamics
    state = model.r_BN_N + model.v_BN_N
    assert len(json.loads(json.dumps(state))) == 6
    assert all(isinstance(vector, list) for vector in (model.sigma_BN, model.omega_BN_B))
    assert isinstance(model.r_BN_P, np.ndarray)


def test_arguments_that_models_keep_can_be_read(env):
    env.reset(seed=0)
    model, world = env.satellite.dynamics, env.simulator.world
    assert model.maxWheelSpeed == env.satellite.sat_args["maxWheelSpeed"]
    assert (model.mu, env.satellite.fsw.desatAttitude) == (3.98600436e14, "sun")
    assert model.conjunction_radius == 10.0
    assert not hasattr(model, "max_range_radius")
    assert not hasattr(world, "gsMinimumElevation")
    with pytest.raises(AttributeError, match="give it in sat_args"):
        model.maxWheelSpeed = 3.0


@pytest.mark.compiled
def test_the_shadow_factor_is_read_from_its_message():
    class Long(Drifter):
        action_spec = [act.Drift(duration=600.0)]

    night = SatelliteTasking(Long("D"), time_limit=12000.0)
    night.reset(seed=3)
    factors, expected = [], []
    for _ in range(10):
        night.step(0)
        model, world = night.satellite.dynamics, night.simulator.world
        factors.append(world.eclipseObject.eclipseOutMsgs[model.eclipse_index].read().shadowFactor)
        sun = np.array(world.gravFactory.spiceObject.planetStateOutMsgs[world.sun_index].read().PositionVector)
        sun /= np.linalg.norm(sun)
        place = np.array(model.r_BN_N)
        along = place @ sun
        expected.append(not (along < 0.0 and np.linalg.norm(place - along * sun) < 6.378e6))  # a cylinder of shadow
    assert factors == [float(lit) for lit in expected]
    assert {0.0, 1.0} == set(factors)


def test_access_to_a_station_is_read_from_its_messages():
    class Downlinker(Drifter):
        dyn_type = dyn.GroundStationDynModel

    fleet = GeneralSatelliteTasking([Drifter("D"), Downlinker("G")], time_limit=60.0, backend="eager")
    fleet.reset(seed=0)
    world, place = fleet.simulator.world, fleet.get_satellite("G").dynamics.r_BN_P
    assert world.groundStations
    for station in world.groundStations:
        (message,) = station.accessOutMsgs
        found, at = message.read(), np.ravel(station.r_LP_P_Init)
        up = at / np.linalg.norm(at)
        assert found.slantRange == pytest.approx(np.linalg.norm(place - at))
        assert np.sin(found.elevation) * found.slantRange == pytest.approx(up @ (place - at))
        assert found.hasAccess == (found.elevation >= world.gsMinimumElevation)


def test_models_of_users_extend_properties_and_count():
    class Model(dyn.BasicDynamicsModel):
        def __init__(self, *args, **kwargs):
            super().__init__(*args, **kwargs)
            self.readings = []

        @property
        def wheel_speeds(self):
            return 2.0 * super().wheel_speeds

        @property
        def r_BN_N(self):
            return [*super().r_BN_N, 0.0]

        @property
        def read(self):
            self.readings.append(self.simulator.sim_time)
            return len(self.readings)

    class Counter(Drifter):
        dyn_type = Model
        observation_spec = [obs.SatProperties(dict(prop="wheel_speeds"), dict(prop="read"))]

    args = dict(wheelSpeeds=[10.0, 20.0, 30.0])
    fleet = GeneralSatelliteTasking([Counter("A", args), Counter("B", args)], time_limit=60.0, backend="eager")
    for _ in range(2):
        first, second = fleet.reset(seed=0)[0]
        np.testing.assert_allclose(first[:3], np.array([20.0, 40.0, 60.0]) * np.pi / 30.0)
        assert first[3] == second[3]
        assert len(fleet.satellites[0].dynamics.r_BN_N) == 4
    before = fleet.satellites[0].dynamics.read
    assert (fleet.satellites[0].dynamics.read, fleet.satellites[1].dynamics.read) == (before + 1, before)


def test_satellites_may_be_beyond_the_moon():
    start = dict(oe=None, rN=[2.4e9, 0.0, 0.0], vN=[0.0, 400.0, 0.0])
    far = SatelliteTasking(Drifter("D", start), time_limit=60.0, backend="eager")
    far.reset(seed=0)
    far.step(0)
    assert far.satellite.dynamics.r_BN_N == pytest.approx([2.4e9, 24000.0, 0.0], abs=0.5)  # it falls by 0.12 m


def test_events_happen_at_times_and_when_conditions_hold(env):
    with pytest.raises(NotImplementedError, match="conditionFunction"):
        env.simulator.createNewEvent("mine", conditionList=["self.TotalSim.CurrentNanos > 0"])
    env.reset(seed=0)
    seen = []
    note = lambda sim: seen.append(sim.sim_time)
    charge = env.satellite.dynamics.battery_charge
    add = lambda name, **when: env.simulator.createNewEvent(name, macros.sec2nano(2.0), True, **when)
    add("clock", conditionFunction=lambda sim: sim.TotalSim.CurrentNanos >= 5e9, actionFunction=note)
    add("state", conditionFunction=lambda sim: env.satellite.dynamics.battery_charge != charge, actionFunction=note)
    add("mine", conditionTime=macros.sec2nano(7.0), actionFunction=note, terminal=True)
    assert env.step(0)[4]["d_ts"] == 7.0
    assert seen == [2.0, 6.0, 7.0]


def test_groups_of_agents_are_left_as_they_were_given():
    groups = {"pair": ["A", "B"]}
    made = ConstellationTasking([Drifter(name) for name in "ABC"], backend="eager", meta_agent_groupings=groups)
    assert made.possible_agents == ["pair", "C"]
    assert groups == {"pair": ["A", "B"]}


def test_the_log_file_of_an_earlier_environment_is_closed(tmp_path):
    SatelliteTasking(Drifter("Drifter"), backend="eager", log_dir=str(tmp_path / "log"))
    root = logging.getLogger("bsk_torch.bsk_rl")
    first = next(handler for handler in root.handlers if isinstance(handler, logging.FileHandler))
    SatelliteTasking(Drifter("Drifter"), backend="eager")
    assert first not in root.handlers
    assert first.stream is None or first.stream.closed


IMAGER = """
from bsk_torch.bsk_rl import SatelliteTasking, act, data, obs, sats, scene
from bsk_torch.bsk_rl.sim import dyn, fsw

class Imager(sats.ImagingSatellite):
    observation_spec = [obs.OpportunityProperties(dict(prop="priority"), n_ahead_observe=2), obs.Eclipse()]
    action_spec = [act.Image(n_ahead_image=2)]
    dyn_type, fsw_type = dyn.ImagingDynModel, fsw.ImagingFSWModel

env = SatelliteTasking(Imager("I"), scene.UniformTargets(500), data.UniqueImageReward(), time_limit=600.0, backend="eager")
env.reset(seed=1)
import sys
print(env.step(0)[0].shape, "torchrl" in sys.modules, "tensordict" in sys.modules)
"""


def test_the_eager_back_end_needs_no_compiler(tmp_path):
    """Orbits are predicted without one as well; nor does the drop-in import TorchRL, which takes longer than the rest."""
    environment = os.environ | {"CXX": "/bin/false", "BSK_TORCH_CACHE": str(tmp_path / "kernels")}
    shown = subprocess.run([sys.executable, "-c", IMAGER], env=environment, capture_output=True, text=True, check=False)
    assert shown.stdout == "(4,) False False\n", shown.stderr
    assert not (tmp_path / "kernels").exists()


def test_satellites_at_rest_fall_and_meet():
    args = [dict(rN=[1e8 + 30.0, 0, 0], vN=[-1.0, 0, 0], oe=None), dict(rN=[1e8, 0, 0], vN=[0, 0, 0], oe=None)]
    made = ConstellationTasking([Drifter("A", args[0]), Drifter("B", args[1])], time_limit=50.0, backend="eager")
    made.reset(seed=0)
    terminated = made.step({"A": 0, "B": 0})[2]
    a, b = made.satellites
    assert a.dynamics.conjunctions == [b]
    assert terminated == {"A": True, "B": True}
    assert made.agents == []


def test_ids_of_gymnasium_are_those_of_bsk_rl():
    made = gymnasium.make("SatelliteTasking-v1", satellite=Drifter("D"), time_limit=60.0, backend="eager")
    assert isinstance(made.unwrapped, SatelliteTasking)
    assert made.observation_space == gymnasium.spaces.Box(-1e16, 1e16, (4,), dtype=np.float64)


def test_the_command_of_the_guide_replaces_the_package_wherever_it_is_named(tmp_path):
    guide = Path(__file__).parents[2] / "docs" / "migration.md"
    (command,) = (line for line in guide.read_text().splitlines() if line.startswith("perl "))
    program = tmp_path / "program.py"
    program.write_text(
        "import bsk_rl\nimport bsk_rl.sim.dyn\nprint(bsk_rl.sim.dyn.BasicDynamicsModel, bsk_rl.SatelliteTasking)\n"
    )
    subprocess.run(command.replace("program.py", str(program)), shell=True, check=True)
    found = subprocess.run([sys.executable, str(program)], capture_output=True, text=True, check=True).stdout
    assert "bsk_torch.bsk_rl.gym.SatelliteTasking" in found


def test_log_levels_are_those_of_the_simulation():
    before = bskLogging.getDefaultLogLevel()
    bskLogging.setDefaultLogLevel(bskLogging.BSK_ERROR)
    assert bskLogging.getDefaultLogLevel() == bskLogging.BSK_ERROR
    bskLogging.setDefaultLogLevel(before)
    with pytest.raises(ValueError, match="level=9"):
        bskLogging.setDefaultLogLevel(9)


def test_a_reward_of_some_satellites_is_enough():
    class Half(data.NoReward):
        def calculate_reward(self, new_data_dict):
            return {"B": 1.0}

    made = ConstellationTasking([Drifter("A"), Drifter("B")], scene.UniformTargets(0), Half(), time_limit=50.0, backend="eager")
    made.reset(seed=0)
    _, reward, *_, info = made.step({"A": 0, "B": 0})
    assert reward == {"A": 0.0, "B": 1.0}
    assert set(info) == {"A", "B", "__common__"}


def test_a_battery_starts_with_no_more_than_its_capacity():
    made = SatelliteTasking(Drifter("D", dict(storedCharge_Init=4e5, batteryStorageCapacity=3e5)), backend="eager")
    made.reset(seed=0)
    assert made.satellite.dynamics.battery_charge == 3e5


class Looker(sats.ImagingSatellite):
    observation_spec = [
        obs.OpportunityProperties(
            *(dict(prop=name) for name in ("priority", "r_LP_P", "opportunity_open", "opportunity_mid", "opportunity_close")),
            n_ahead_observe=1,
        )
    ]
    action_spec = [act.Image(n_ahead_image=1), act.Charge(duration=10.0)]
    dyn_type = dyn.ImagingDynModel
    fsw_type = fsw.ImagingFSWModel


def looking(**sat_args):
    return SatelliteTasking(
        Looker("L", sat_args), scene.UniformTargets(np.int64(300)), data.UniqueImageReward(), time_limit=20.0, backend="eager"
    )


def test_environments_can_be_copied_before_their_first_reset():
    env = looking()
    other = copy.deepcopy(env)
    assert np.array_equal(env.reset(seed=1)[0], other.reset(seed=1)[0])
    assert np.array_equal(env.step(1)[0], other.step(1)[0])
    with pytest.raises(TypeError, match="copy the environment before its first reset"):
        copy.deepcopy(env)


def test_payloads_and_clocks_have_what_programs_of_bsk_rl_read(env):
    env.reset(seed=0)
    model, simulator = env.satellite.dynamics, env.simulator
    assert len(model.rwStateEffector.rwSpeedOutMsg.read().wheelSpeeds) == 36
    env.step(0)
    assert simulator.TotalSim.CurrentNanos == 60_000_000_000
    with pytest.raises(AttributeError, match=r"'omega_dot' of a message .* known are \['wheelSpeeds'\]"):
        model.rwStateEffector.rwSpeedOutMsg.read().omega_dot  # noqa: B018
    env.satellite.info.append("seen")
    env.step(1)
    assert env.satellite.info == []


def test_properties_of_models_are_set_as_their_class_says(env):
    env.reset(seed=0)
    model = env.satellite.dynamics
    with pytest.raises(AttributeError, match=r"property 'battery_charge_fraction' of .* has no setter"):
        model.battery_charge_fraction = 0.1
    model.noted = 5.0
    assert model.noted == 5.0


def test_worlds_of_programs_have_attributes_and_flight_software_any_method():
    class Dated(Drifter):
        class Model(dyn.BasicDynamicsModel):
            @property
            def tag(self):
                return self.world.tag + self.fsw.write()

        class Software(fsw.BasicFSWModel):
            def write(self):
                return 4.0

        observation_spec = [obs.SatProperties(dict(prop="tag"))]
        dyn_type, fsw_type = Model, Software

    class World(world.EclipseWorldModel, world.AtmosphereWorldModel):
        def __init__(self, *args, **kwargs):
            super().__init__(*args, **kwargs)
            self.tag = 3.0

    made = SatelliteTasking(Dated("D"), world_type=World, time_limit=200.0, backend="eager")
    assert made.reset(seed=0)[0].tolist() == [7.0]
    made.step(1)
    made.satellite.fsw.action_charge()


def test_steps_are_logged_as_bsk_rl_logs_them(caplog):
    made = SatelliteTasking(Drifter("D"), time_limit=100.0, backend="eager", log_level="INFO")
    made.reset(seed=0)
    with caplog.at_level(logging.INFO):
        made.step(0)
        made.step(0)
    said = [record.getMessage() for record in caplog.records]
    assert said.count("=== STARTING STEP ===") == 2
    assert [line for line in said if line.startswith("Step reward")] == ["Step reward: 0.0"] * 2
    assert [line for line in said if line.startswith("Episode")] == ["Episode terminated: False", "Episode truncated: True"]
    assert "Satellite D requires retasking" in said


def test_the_log_has_the_lines_of_bsk_rl(caplog):
    class Dark(sats.ImagingSatellite):
        observation_spec = [obs.Time()]
        action_spec = [act.Charge(duration=60.0), act.Image(n_ahead_image=1)]
        dyn_type = dyn.ImagingDynModel
        fsw_type = fsw.ImagingFSWModel

    args = dict(storedCharge_Init=500.0, panelArea=0.0, basePowerDraw=-20.0)
    made = ConstellationTasking(
        satellites=[Dark("A"), Dark("B", args)],
        scenario=scene.UniformTargets(500),
        rewarder=data.UniqueImageReward(),
        communicator=comm.FreeCommunication(),
        meta_agent_groupings={"both": ["A", "B"]},
        time_limit=400.0,
        max_step_duration=40.0,
        backend="eager",
        log_level="INFO",
    )
    made.reset(seed=3)
    caplog.clear()
    with caplog.at_level(logging.INFO):
        made.step({"both": [0, 0]})
    assert caplog.messages == [
        "=== STARTING STEP ===",
        "Decomposing action for meta agent both",
        "action_charge tasked for 60.0 seconds",
        "setting timed terminal event at 60.0",
        "action_charge tasked for 60.0 seconds",
        "setting timed terminal event at 60.0",
        "Max step duration reached",
        "Total reward: {}",
        "Communicating data in 2 directions.",
        "Optimizing data communication between all pairs of satellites",
        "failed battery_valid check",
        "Step reward: {'both': -1.0}",
        "Episode terminated: ['both']",
    ]
    made.reset(seed=3)
    with caplog.at_level(logging.INFO):
        made.satellites[0].set_action(1)
    target, window = made.satellites[0].latest_target, made.satellites[0].find_next_opportunities(1)[0]["window"]
    until = f"{window[0]:.1f} to {window[1]:.1f}"
    assert caplog.messages[-2:] == [
        f"{target} window enabled: {until}",
        f"setting timed terminal event at {window[1]:.1f}",
    ]


def test_checks_stop_at_the_first_failure_as_in_bsk_rl(caplog):
    class Model(dyn.BasicDynamicsModel):
        calls = 0

        @functional.aliveness_checker
        def a_first(self):
            return self.simulator.sim_time == 0.0

        @functional.aliveness_checker
        def b_second(self):
            self.calls += 1
            return True

    class Watched(Drifter):
        dyn_type = Model

    made = SatelliteTasking(Watched("W"), time_limit=300.0, backend="eager")
    made.reset(seed=0)
    model = made.satellite.dynamics
    assert model.battery_valid(log_failure=True)
    assert model.is_alive()
    made.step(0)
    counted = model.calls
    assert not made.satellite.is_alive()
    assert not model.is_alive(log_failure=True)
    assert model.calls == counted
    assert caplog.messages == ["failed a_first check"] * 2


def test_environments_of_programs_may_cut_episodes():
    class Cut(SatelliteTasking):
        def _get_truncated(self):
            return super()._get_truncated() or self.simulator.sim_time > 50.0

    class CutAll(ConstellationTasking):
        def _get_truncated(self):
            return {agent: cut or self.simulator.sim_time > 50.0 for agent, cut in super()._get_truncated().items()}

    made = Cut(Drifter("D"), time_limit=300.0, terminate_on_time_limit=True, backend="eager")
    made.reset(seed=0)
    assert made.step(0)[2:4] == (True, True)
    several = CutAll(satellites=[Drifter("D")], time_limit=300.0, terminate_on_time_limit=True, backend="eager")
    several.reset(seed=0)
    assert several.step({"D": 0})[2:4] == ({"D": False}, {"D": True})
    assert several.agents == ["D"]


def test_continuous_actions_are_described_by_a_property_or_a_method():
    class Turn(act.AttitudeSetpoint):
        def action_description(self):
            return ["x", "y", "z"]

    def described(action):
        satellite = type("Turning", (Drifter,), {"action_spec": [action]})("T")
        return satellite.action_description

    assert described(act.AttitudeSetpoint()) == ["mrp_1", "mrp_2", "mrp_3"]
    assert described(Turn()) == ["x", "y", "z"]


def test_lines_of_sight_are_logged_until_they_are_used():
    class Kept(comm.LOSCommunication):
        def communicate(self):
            self.kept = {
                one.name: {other.name: log.hasAccess for other, log in seen.items()} for one, seen in self.los_logs.items()
            }
            super().communicate()

    class Seeing(Drifter):
        dyn_type = (dyn.BasicDynamicsModel, dyn.LOSCommDynModel)

    orbits = [random_circular_orbit(i=45.0, alt=800.0, Omega=0.0, f=f) for f in (0.0, 20.0)]
    made = ConstellationTasking(
        satellites=[Seeing(f"S{k}", dict(oe=oe, losMaximumRange=[-1.0, 1e6][k])) for k, oe in enumerate(orbits)],
        communicator=Kept(),
        time_limit=300.0,
        backend="eager",
    )
    made.reset(seed=0)
    made.step({"S0": 0, "S1": 1})
    kept = made.communicator.kept
    assert kept["S0"]["S1"].tolist() == [1] * 30
    assert kept["S1"]["S0"].tolist() == [0] * 30
    assert made.communicator.los_logs[made.satellites[0]][made.satellites[1]].hasAccess.tolist() == []
    access = [satellite.dynamics.losComms.accessOutMsgs[0].read().hasAccess for satellite in made.satellites]
    assert access == [1, 0]
    assert [satellite.dynamics.los_comms_ids for satellite in made.satellites] == [["S1"], ["S0"]]
    pairs = made.communicator.communication_pairs()
    assert [(one.name, other.name) for one, other in pairs] == [("S0", "S1"), ("S1", "S0")]


def relative(states):
    """Return a function for ``sat_arg_randomizer`` that places satellites relative to the satellite A, [6] m and m/s each."""
    orbit = random_circular_orbit(i=40.0, alt=600.0, Omega=0.0, f=0.0)
    return relative_to_chief("A", orbit, {name: np.array(state, dtype=float) for name, state in states.items()})


def test_collisions_are_booked_and_logged_as_in_bsk_rl(caplog):
    args = dict(conjunction_radius=50.0)
    made = ConstellationTasking(
        satellites=[Drifter(name, args) for name in "ABC"],
        sat_arg_randomizer=relative({"B": [10, 0, 0, 0, 0, 0], "C": [0, 120, 0, 0, -1, 0]}),
        time_limit=400.0,
        backend="eager",
        log_level="INFO",
    )
    made.reset(seed=1)
    caplog.clear()
    with caplog.at_level(logging.INFO):
        for _ in range(3):
            made.step(dict.fromkeys(made.agents, 0))
    said = [(record.name[-1], record.getMessage()) for record in caplog.records]
    meetings = [f"{name} {text}" for name, text in said if text.startswith("collided")]
    assert meetings == ["B collided with A", "A collided with B"] + ["C collided with B", "B collided with C"] * 2
    assert ("B", "Collision occurred at t=0, may incorrectly report failure type") in said
    booked = [[other.name for other in satellite.dynamics.conjunctions] for satellite in made.satellites]
    assert booked == [["B"], ["A", "C", "C"], ["B", "B"]]  # bsk_rl books the later satellite of a pair with the one before it


def test_a_range_that_is_left_is_logged(caplog):
    class Near(Drifter):
        dyn_type = (dyn.MaxRangeDynModel, dyn.BasicDynamicsModel)

    made = ConstellationTasking(
        satellites=[Near("A"), Near("B", dict(chief_name="A", max_range_radius=550.0, enforce_range_on_chief=True))],
        sat_arg_randomizer=relative({"B": [500, 0, 0, 2, 0, 0]}),
        time_limit=400.0,
        backend="eager",
        log_level="INFO",
    )
    made.reset(seed=1)
    caplog.clear()
    with caplog.at_level(logging.INFO):
        result = made.step({"A": 0, "B": 0})
    assert result[2] == {"A": True, "B": True}
    assert "Exceeded maximum range of 550.0 m from A" in caplog.messages
    warned = [record.name.rpartition(".")[2] for record in caplog.records if record.getMessage() == "failed range_valid check"]
    assert sorted(warned) == ["A", "B"]


def test_a_maneuver_beyond_the_fuel_is_logged(caplog):
    class Tug(Drifter):
        action_spec = [act.ImpulsiveThrust(max_dv=5.0, max_drift_duration=100.0)]
        fsw_type = (fsw.BasicFSWModel, fsw.MagicOrbitalManeuverFSWModel)

    made = SatelliteTasking(Tug("T", dict(dv_available_init=1.5)), time_limit=300.0, backend="eager")
    made.reset(seed=0)
    made.step(np.array([2.0, 0.0, 0.0, 20.0]))
    assert "Maneuver exceeds available Delta V (2.0/1.5 m/s)." in caplog.messages
    assert made.satellite.fsw.dv_available == 0.0
    with pytest.raises(AttributeError, match="has no attribute 'losComms'"):
        made.satellite.dynamics.losComms  # noqa: B018


def test_limits_of_the_simulation_may_change_during_an_episode(env):
    env.reset(seed=0)
    env.simulator.max_step_duration = 25.0
    assert env.step(0)[4]["d_ts"] == 25.0
    env.simulator.max_step_duration, env.time_limit, env.simulator.time_limit = 1e9, 70.0, 70.0
    assert env.step(0)[3:] == (True, {"d_ts": 45.0, "requires_retasking": False})


def test_rejects_what_is_not_in_the_simulation(env):
    class Imager(sats.ImagingSatellite):
        observation_spec = [obs.Time()]
        action_spec = [act.Image(n_ahead_image=1)]
        dyn_type, fsw_type = dyn.ImagingDynModel, fsw.ImagingFSWModel

    imaging = SatelliteTasking(satellite=Imager("I"), scenario=scene.UniformTargets(400), time_limit=600.0, backend="eager")
    imaging.reset(seed=0)
    seen = {opportunity["object"] for opportunity in imaging.satellite.opportunities}
    unseen = next(target for target in imaging.scenario.targets if target not in seen)
    env.reset(seed=0)
    sat = env.satellite
    table = [
        refusal(lambda: imaging.satellite.enable_target_window(unseen), ValueError, unseen, "windows", "600.0 s"),
        refusal(lambda: sat.dynamics.rwFactory, AttributeError, "rwFactory", "Component"),
        refusal(lambda: sat.dynamics.scObject.gravField, AttributeError, "'gravField'", "'ModelTag'"),
        refusal(lambda: sat.fsw.action_charg, AttributeError, "'action_charg'", "'action_charge'"),
        refusal(lambda: setattr(sat.dynamics.solarPanel, "nHat_B", 1), AttributeError, "'nHat_B'", "sat_args"),
        refusal(lambda: sat.update_timed_terminal_event(float("nan")), ValueError, "nan s", "max_step_duration"),
    ]
    check_refusals(table)


def test_rejects_wrong_programs():
    drifter = lambda **options: SatelliteTasking(Drifter("D"), backend="eager", **options)
    declared = lambda name, *actions: type(name, (Drifter,), {"action_spec": [*actions]})("S")
    model = lambda init: type("Given", (dyn.BasicDynamicsModel,), {"__init__": init})
    charge, kinds = dict(storedCharge_Init="100000"), (act.Drift(), act.AttitudeSetpoint())
    table = [
        refusal(lambda: declared("Mixed", *kinds), NotImplementedError, "Mixed.action_spec", "Continuous", "Discrete"),
        refusal(lambda: declared("Idle"), ValueError, "Idle.action_spec", "action"),
        refusal(lambda: model(lambda self, satellite, dyn_rate, **k: None), TypeError, "Given", "satellite, dyn_rate", "*args"),
        refusal(lambda: drifter(sim_rate=0), ValueError, "sim_rate=0", "[0.001, 60] s"),
        refusal(lambda: looking(**charge).reset(seed=0), ValueError, "sat_args", "storedCharge_Init", "'100000'", "W s"),
        refusal(lambda: looking(oe=float("nan")).reset(seed=0), ValueError, "sat_args", "oe=nan", "a, e, i, Omega, omega, f"),
    ]
    check_refusals(table)
