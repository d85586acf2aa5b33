"""Models, worlds and commands that programs of bsk_rl define, and what they read of Basilisk's objects."""

import importlib
import logging
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from bsk_torch.bsk_rl import GeneralSatelliteTasking, SatelliteTasking, act, data, obs, sats, scene
from bsk_torch.bsk_rl.sim import dyn, fsw, world
from bsk_torch.bsk_rl.sim.setup import NotSimulatedError
from bsk_torch.bsk_rl.utils.functional import collect_default_args, default_args
from tests.support.refusals import check_refusals, refusal

CHARGED = dict(storedCharge_Init=2e5, wheelSpeeds=[100.0, -200.0, 300.0])


class Rest(act.DiscreteFSWAction):
    def __init__(self, name="action_rest", duration=10.0):
        super().__init__(fsw_action="action_rest", name=name, duration=duration)


class Software(fsw.BasicFSWModel):
    @fsw.action
    def action_rest(self):
        self.sunPoint.Reset(self.simulator.sim_time_ns)
        self.simulator.enableTask(self.SunPointTask.name + self.satellite.name)

    @fsw.action
    def action_heat(self):
        self.action_charge()
        self.dynamics.thrusterPowerSink.powerStatus = 1

    @fsw.action
    def action_let_go(self):
        super().action_nadir_point()
        self.simulator.disableTask(self.MRPControlTask.name + self.satellite.name)


def flying(dyn_type=dyn.BasicDynamicsModel, fsw_type=Software, args=None, actions=(), **options):
    actions = actions or [
        act.Charge(duration=10.0),
        Rest(),
        *(act.DiscreteFSWAction(f"action_{n}", None, 10.0) for n in ("heat", "let_go")),
    ]
    body = dict(observation_spec=[obs.SatProperties(dict(prop="sigma_BN"), dict(prop="battery_charge"))], action_spec=actions)
    kind = type("Sat", (sats.Satellite,), {**body, "dyn_type": dyn_type, "fsw_type": fsw_type})
    env = SatelliteTasking(kind("S", {**CHARGED, **(args or {})}), time_limit=600.0, backend="eager", **options)
    env.reset(seed=1)
    return env


@pytest.fixture(scope="module")
def env():
    return flying(args=dict(thrusterPowerDraw=-100.0))


def flown(env, action):
    env.reset(seed=1)
    return env.step(action)[0]


def test_commands_of_programs_arrange_what_the_package_has(env):
    charged, rested, heated, loose = (flown(env, k) for k in range(4))
    assert np.array_equal(charged, rested)
    assert np.array_equal(charged[:3], heated[:3])
    assert heated[3] - charged[3] == pytest.approx(-100.0 * 10.0)
    assert env.satellite.fsw.flags_on == ("nadir_on",)
    assert not np.allclose(loose[:3], charged[:3])
    with pytest.raises(NotSimulatedError, match="@action"):
        env.simulator.enableTask("sunPointTaskS")


def test_values_of_basilisks_objects_are_those_of_the_simulation(env):
    env.reset(seed=1)
    env.step(0)
    sat, sky = env.satellite, env.simulator.world
    dynamics, software = sat.dynamics, sat.fsw
    line_N = np.array(sky.r_SN_N) - dynamics.r_BN_N
    axis_N = np.array(dynamics.BN).T @ dynamics.solarPanel.nHat_B
    sigma = np.array(software.attGuidMsg.read().sigma_BR)
    angle = np.arccos(axis_N @ line_N / np.linalg.norm(line_N))
    assert 4.0 * np.arctan(np.linalg.norm(sigma)) == pytest.approx(angle, abs=1e-6)
    light = sky.eclipseObject.eclipseOutMsgs[0].read().illuminationFactor
    flux = 1361.0 * (149597870693.0 / np.linalg.norm(line_N)) ** 2
    assert dynamics.solarPanel.nodePowerOutMsg.read().netPower == pytest.approx(flux * 0.2 * light * max(np.cos(angle), 0.0))
    assert software.attRefMsg.read().sigma_RN != [0.0, 0.0, 0.0]
    assert len(software.rwMotorTorque.rwMotorTorqueOutMsg.read().motorTorque) == 36
    assert (sky.planet.mu, sky.gravFactory.gravBodies["earth"].radEquator) == (3.986004360e14, 6378136.6)
    assert (dynamics.scObject.hub.mHub, dynamics.I_mat[0]) == (330.0, pytest.approx(82.115))
    assert (software.mrpFeedbackControl.K, software.sunPoint.pHat_B.tolist()) == (7.0, [0.0, 0.0, -1.0])
    with pytest.raises(AttributeError, match="omega_BR_B"):
        software.attGuidMsg.read().omega_BR_B  # noqa: B018
    with pytest.raises(AttributeError, match="sat_args"):
        dynamics.thrusterPowerSink.powerStatus = 1


def test_recorders_keep_every_tick(env):
    env.reset(seed=1)
    recorder = env.satellite.dynamics.scObject.scStateOutMsg.recorder(int(2e9))
    env.simulator.AddModelToTask(env.satellite.dynamics.task_name, recorder)
    env.step(1)
    assert recorder.times().tolist() == [int(k * 2e9) for k in range(6)]
    assert recorder.r_BN_N.shape == (6, 3)
    assert recorder.r_BN_N[-1].tolist() == env.satellite.dynamics.r_BN_N


class Mortal(dyn.BasicDynamicsModel):
    def is_alive(self, log_failure=False):
        return super().is_alive(log_failure) and self.simulator.sim_time < self.end

    def reset_post_sim_init(self):
        super().reset_post_sim_init()
        self.end = self.simulator.sim_time + 15.0


def test_hooks_of_models_run():
    made = flying(Mortal, args=dict(storedCharge_Init=1e5))
    assert isinstance(made.satellite.dynamics, dyn.BasicDynamicsModel)
    assert [made.step(0)[2] for _ in range(2)] == [False, True]
    made.reset(seed=1)
    assert made.satellite.is_alive()


class Stations(world.GroundStationWorldModel, world.EclipseWorldModel):
    @classmethod
    def default_world_args(cls, **kwargs):
        merged = world.EclipseWorldModel.default_world_args()
        merged.update(world.GroundStationWorldModel.default_world_args())
        merged["groundStationsData"] = [*merged["groundStationsData"][:1], dict(name="Here", lat=46.0, long=7.0)]
        return merged | kwargs


def test_worlds_have_plain_arguments_that_programs_change():
    defaults = world.GroundStationWorldModel.default_world_args(gsMaximumRange=-2)
    assert defaults["utc_init"]().endswith("(UTC)")
    defaults["groundStationsData"].append(dict(name="Here", lat=46.0, long=7.0))
    assert (
        len(world.GroundStationWorldModel.default_world_args()["groundStationsData"]) == len(defaults["groundStationsData"]) - 1
    )
    assert list(collect_default_args(world.AtmosphereWorldModel)) == ["planetRadius", "baseDensity", "scaleHeight", "utc_init"]
    made = flying(world_type=(Stations, world.AtmosphereWorldModel))
    assert [station.ModelTag for station in made.simulator.world.groundStations] == ["GroundStationBoulder", "GroundStationHere"]
    made.world_args_generator = made.world_type.default_world_args()
    made.reset(seed=1)
    assert isinstance(made.world_args["utc_init"], str)
    with pytest.raises(KeyError, match="gsMaximumRange"):
        world.GroundStationWorldModel.default_world_args(gsMaximumRang=1)


class Thick(world.AtmosphereWorldModel):
    @default_args(baseDensity=1.5, scaleHeight=8000.0, planetRadius=6378136.6)
    def setup_atmosphere_density_model(self, baseDensity, **kwargs):
        super().setup_atmosphere_density_model(baseDensity=2.0 * baseDensity, **kwargs)


class Heavy(dyn.BasicDynamicsModel):
    @classmethod
    def _requires_world(cls):
        return [*super()._requires_world(), Thick]

    def _setup_dynamics_objects(self, **kwargs):
        super()._setup_dynamics_objects(**{**kwargs, "mass": 100.0})
        self.scObject.hub.IHubPntBc_B = [50.0, 0.0, 0.0, 0.0, 50.0, 0.0, 0.0, 0.0, 60.0]


def test_setup_methods_change_arguments():
    made = flying(Heavy)
    assert made.simulator.world.densityModel.baseDensity == 3.0
    assert float(made.simulator.fleet.simulators[0].state.arguments["mass"][0]) == 100.0
    hub = made.satellite.dynamics.scObject.hub
    assert (hub.mHub, np.diag(hub.IHubPntBc_B).tolist()) == (100.0, [50.0, 50.0, 60.0])
    assert made.satellite.sat_args["mass"] == 330


def test_wheels_that_a_program_makes_are_read():
    """As Basilisk's ``rwFactory`` lists them; without Basilisk, an object of the same name stands for one."""
    wheel = dict(RWModel=0, Omega=10.0, u_max=0.1, u_min=0.0, Omega_max=600.0, Js=0.08, P_max=-1.0, fCoulomb=0.0, fStatic=0.0)
    numbers = [SimpleNamespace(**wheel, betaStatic=-1.0, cViscous=0.0, gsHat_B=axis) for axis in np.eye(3)]

    class Wheeled(dyn.BasicDynamicsModel):
        def setup_reaction_wheel_dyn_effector(self, **kwargs):
            self.rwFactory = type("rwFactory", (), {"rwList": dict(enumerate(numbers))})()

    kind = type("Sat", (sats.Satellite,), dict(observation_spec=[obs.Time()], action_spec=[act.Charge(duration=10.0)]))
    kind.dyn_type, kind.fsw_type = Wheeled, fsw.BasicFSWModel
    made = SatelliteTasking(kind("S", dict(storedCharge_Init=2e5)), time_limit=60.0, backend="eager")
    made.reset(seed=1)
    assert made.satellite.dynamics.wheel_speeds == pytest.approx([10.0, 10.0, 10.0])
    assert "wheelSpeeds" not in made.satellite.sat_args


def defined(base, name, value):
    return type("Own", (base,), {name: value})


def test_rejects_parts_that_are_not_simulated():
    module = type("ThermalSensor", (), {})

    class Adding(dyn.BasicDynamicsModel):
        def _setup_dynamics_objects(self, **kwargs):
            super()._setup_dynamics_objects(**kwargs)
            self.simulator.AddModelToTask(self.task_name, module())

    class Late(dyn.BasicDynamicsModel):
        def reset_post_sim_init(self):
            self.simulator.AddModelToTask(self.task_name, module())

    omitted = defined(dyn.BasicDynamicsModel, "setup_thruster_dyn_effector", lambda self, **kwargs: None)
    incomplete = defined(dyn.BasicDynamicsModel, "_setup_dynamics_objects", lambda self, **kwargs: None)
    setting = lambda self, **kwargs: setattr(self.thrDump, "fireTime", 1.0)
    both = lambda self: [self.action_charge(), self.action_nadir_point()]
    confused = defined(fsw.BasicFSWModel, "action_rest", fsw.action(both))
    task = lambda **body: type("OwnTask", (fsw.Task,), body)
    table = [
        refusal(lambda: flying(Adding), NotSimulatedError, "Adding", "ThermalSensor", "Component"),
        refusal(lambda: flying(Late), NotSimulatedError, "AddModelToTask", "ThermalSensor", "Component"),
        refusal(lambda: flying(omitted), NotSimulatedError, "Own.setup_thruster_dyn_effector", "super()"),
        refusal(lambda: flying(incomplete), NotSimulatedError, "Own._setup_dynamics_objects", "super()"),
        refusal(
            lambda: flying(defined(dyn.BasicDynamicsModel, "setup_density_model", setting)), NotSimulatedError, "thrDump.fireTime"
        ),
        refusal(lambda: flying(fsw_type=confused, actions=[Rest()]).step(0), NotSimulatedError, ["nadir_on", "sun_on"]),
        refusal(lambda: task(name="ownTask"), TypeError, "OwnTask", "Component"),
        refusal(lambda: task(_setup_fsw_objects=setting), TypeError, "OwnTask._setup_fsw_objects", "Component"),
        refusal(lambda: defined(dyn.BasicDynamicsModel, "_create_process", setting), TypeError, "_create_process", "Component"),
    ]
    check_refusals(table)


OLD = {
    "data": ["UniqueImagingManager", "NoDataManager", "DataManager"],
    "scene": ["StaticTargets", "UniformNadirFeature", "EnvironmentFeatures"],
    "sim.world": ["BasicWorldModel"],
}


def test_names_of_older_versions_are_answered():
    spec = dict(observation_spec=[obs.Time()], action_spec=[act.Drift()], dyn_type=dyn.BasicDynamicsModel, fsw_type=Software)
    sat = type("Sat", (sats.Satellite,), spec)("S")
    load = lambda name: importlib.import_module(f"bsk_torch.bsk_rl.{name}")
    names = [(module, name) for module, names in OLD.items() for name in names]
    table = [
        *(refusal(lambda m=m, n=n: getattr(load(m), n), ImportError, n, "before 1.3", "write") for m, n in names),
        *(
            refusal(lambda m=m: load(m), ModuleNotFoundError, "before 1.3", "import")
            for m in ("env.gym_env", "env.scenario.data")
        ),
        refusal(lambda: GeneralSatelliteTasking([sat], env_features=scene.Scenario()), TypeError, "env_features", "scenario"),
        refusal(lambda: GeneralSatelliteTasking([sat], data_manager=data.NoReward()), TypeError, "data_manager", "rewarder"),
        refusal(lambda: SatelliteTasking(satellites=sat), TypeError, "satellites", "satellite now"),
        refusal(lambda: act.Image(n_ahead_act=3), TypeError, "n_ahead_act", "n_ahead_image"),
    ]
    check_refusals(table)
    assert not hasattr(sys.modules["bsk_torch.bsk_rl.obs"], "nothing")


def test_modules_of_basilisk_are_answered():
    read = lambda place, name: getattr(importlib.import_module(f"bsk_torch.bsk_rl.basilisk.{place}"), name)
    names = dict(simulation="msisAtmosphere", fswAlgorithms="hillPoint", utilities="simIncludeRW", architecture="sysModel")
    check_refusals([refusal(lambda p=p, n=n: read(p, n), ImportError, n, "Component") for p, n in names.items()])


def test_what_costs_much_is_said_at_every_log_level():
    with pytest.warns(UserWarning, match="bsk-torch view"):
        flying(vizard_dir="/tmp/x", vizard_settings={"showLocationLabels": 0}, log_level="ERROR")
    logging.getLogger("bsk_torch.bsk_rl").setLevel(logging.WARNING)  # which other tests read
