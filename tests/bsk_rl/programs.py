"""Programs of bsk_rl, written for a package whose name is given: ``bsk_rl`` on Basilisk, or ``bsk_torch.bsk_rl``."""

import importlib
from functools import cached_property
from types import SimpleNamespace
from typing import Any

import numpy as np

STEPS = 12


def load(root: str) -> SimpleNamespace:
    """Return the modules of a package by name."""
    names = ["act", "comm", "data", "obs", "sats", "scene", "scene.targets", "sim.dyn", "sim.fsw"]
    names += ["utils.functional", "utils.orbital"]
    package = importlib.import_module(root)
    found = {name.rpartition(".")[2]: importlib.import_module(f"{root}.{name}") for name in names}
    return SimpleNamespace(root=package, **found)


def scanning(b: Any) -> Any:
    """Return a scanner with ground stations, eclipses and a property of the user's."""

    class Model(b.dyn.ContinuousImagingDynModel, b.dyn.GroundStationDynModel):
        @property
        def sun_angle(self):
            world = self.simulator.world
            sun = world.gravFactory.spiceObject.planetStateOutMsgs[world.sun_index].read().PositionVector
            return np.arccos(np.dot(self.BN.T @ [0, 0, 1], np.array(sun) / np.linalg.norm(sun)))

    class Scanner(b.sats.AccessSatellite):
        observation_spec = [
            b.obs.SatProperties(
                dict(prop="storage_level_fraction"),
                dict(prop="battery_charge_fraction"),
                dict(prop="wheel_speeds_fraction"),
                dict(prop="r_BN_P", norm=7e6),
                dict(prop="sun_angle"),
                dict(prop="late", fn=lambda satellite: satellite.simulator.sim_time > 300.0),
            ),
            b.obs.Eclipse(norm=5700.0),
            b.obs.Time(),
            b.obs.OpportunityProperties(dict(prop="opportunity_open", norm=5700.0), type="ground_station", n_ahead_observe=2),
        ]
        action_spec = [b.act.Scan(duration=180.0), b.act.Charge(duration=120.0), b.act.Downlink(), b.act.Desat(duration=60.0)]
        dyn_type = Model
        fsw_type = b.fsw.ContinuousImagingFSWModel

    args = dict(storageInit=1000.0, maxWheelSpeed=6000.0, instrumentBaudRate=1e6, dataStorageCapacity=1e10)
    return b.root.SatelliteTasking(
        satellite=Scanner("Scanner", args),
        scenario=b.scene.UniformNadirScanning(),
        rewarder=b.data.ScanningTimeReward(),
        time_limit=lambda: np.random.uniform(1000.0, 2000.0),
        max_step_duration=300.0,
    )


def imaging(b: Any) -> Any:
    """Return two imagers that share what they know, a scenario of the user's, and a rewarder that counts."""

    class Counting(b.data.UniqueImageReward):
        def __init__(self):
            super().__init__(lambda priority: 10.0 * priority)
            self.calls = 0

        def calculate_reward(self, new_data_dict):
            self.calls += 1
            return {name: value + self.calls for name, value in super().calculate_reward(new_data_dict).items()}

    class Scattered(b.scene.UniformTargets):
        episodes = 0

        def regenerate_targets(self):
            self.episodes += 1
            x = np.random.normal(size=(self.n_targets, 3))
            x *= 6378136.6 / np.linalg.norm(x, axis=1, keepdims=True)
            self.targets = [b.targets.Target(f"t{k}", r, np.random.rand() + self.episodes) for k, r in enumerate(x)]

    class Imager(b.sats.ImagingSatellite):
        observation_spec = [
            b.obs.SatProperties(dict(prop="c_hat_P"), dict(prop="r_BN_P", norm=7e6)),
            b.obs.OpportunityProperties(
                dict(prop="priority"),
                dict(prop="r_LB_H", norm=1e6),
                dict(prop="opportunity_close", norm=300.0),
                dict(prop="target_angle"),
                dict(prop="target_angle_rate", norm=0.01),
                dict(name="length", fn=lambda sat, opp: opp["window"][1] - opp["window"][0], norm=300.0),
                n_ahead_observe=3,
            ),
        ]
        action_spec = [b.act.Image(n_ahead_image=5), b.act.Charge(duration=60.0)]
        fsw_type = b.fsw.ImagingFSWModel

    args = dict(imageAttErrorRequirement=0.05, imageRateErrorRequirement=0.05, u_max=0.5)
    return b.root.GeneralSatelliteTasking(
        satellites=[Imager(name, dict(args), generation_duration=300.0) for name in ("EO", "EO")],
        scenario=Scattered((600, 700)),
        rewarder=(Counting(), b.data.ResourceReward(resource_fn=lambda sat: sat.dynamics.battery_charge, reward_weight=1e-3)),
        communicator=b.comm.FreeCommunication(),
        sat_arg_randomizer=b.orbital.walker_delta_args(n_planes=1),
        time_limit=4000.0,
    )


def constellation(b: Any) -> Any:
    """Return agents that leave one another, one of them thrusting."""

    class Chief(b.sats.Satellite):
        observation_spec = [b.obs.SatProperties(dict(prop="sigma_BN"), dict(prop="omega_BH_H", norm=0.01))]
        action_spec = [b.act.Drift(duration=200.0), b.act.NadirPoint(duration=150.0)]
        dyn_type = b.dyn.DynamicsModel
        fsw_type = b.fsw.FSWModel

    class Deputy(b.sats.Satellite):
        observation_spec = [
            b.obs.RelativeProperties(dict(prop="r_DC_Hc", norm=1e3), dict(prop="v_DC_Hc"), chief_name="Chief"),
            b.obs.SatProperties(dict(prop="dv_available", norm=10.0)),
        ]
        action_spec = [b.act.ImpulsiveThrustHill(chief_name="Chief", max_dv=2.0, max_drift_duration=300.0)]
        dyn_type = (b.dyn.MaxRangeDynModel, b.dyn.BasicDynamicsModel)
        fsw_type = (b.fsw.BasicFSWModel, b.fsw.MagicOrbitalManeuverFSWModel)

    orbit = b.orbital.random_circular_orbit(i=30.0, alt=600.0, Omega=10.0, f=20.0)
    start = {"Deputy": lambda: np.array([200.0, *np.random.uniform(-50.0, 50.0, 2), 0.0, 0.0, 0.0])}
    return b.root.ConstellationTasking(
        satellites=[
            Chief("Chief"),
            Deputy("Deputy", dict(dv_available_init=30.0, chief_name="Chief", max_range_radius=3000.0)),
        ],
        rewarder=b.data.ResourceReward(
            resource_fn=lambda sat: sat.fsw.dv_available if isinstance(sat.fsw, b.fsw.MagicOrbitalManeuverFSWModel) else 0.0,
            reward_weight=1.0,
        ),
        sat_arg_randomizer=b.orbital.relative_to_chief("Chief", orbit, start),
        time_limit=3000.0,
        failure_penalty=-5.0,
    )


def extremes(b: Any) -> Any:
    """Return agents with arguments that mean little, but that Basilisk flies; one dies at once."""

    class Scanner(b.sats.AccessSatellite):
        observation_spec = [
            b.obs.SatProperties(
                dict(prop="storage_level_fraction"),
                dict(prop="battery_charge_fraction"),
                dict(prop="wheel_speeds", norm=600.0),
                dict(prop="omega_BN_B"),
            )
        ]
        action_spec = [b.act.Scan(duration=60.0), b.act.Charge(duration=60.0), b.act.Downlink(duration=60.0), b.act.Desat(60.0)]
        dyn_type = type("Model", (b.dyn.ContinuousImagingDynModel, b.dyn.GroundStationDynModel), {})
        fsw_type = b.fsw.ContinuousImagingFSWModel

    efficient = dict(panelEfficiency=1.5, rwElecToMechEfficiency=1.2, rwMechToElecEfficiency=1.1, dragCoeff=-1.0)
    stations = [dict(lat=lat, long=long, elev=0.0) for lat in (-40, 0, 40) for long in range(-180, 180, 40)]
    return b.root.ConstellationTasking(
        satellites=[
            Scanner("Turned", dict(disturbance_vector=[1.2, -0.4, 0.3])),
            Scanner("Efficient", efficient | dict(storedCharge_Init=1e4, batteryStorageCapacity=1e6)),
            Scanner("Filling", dict(transmitterBaudRate=1e5, storageInit=1e6, hs_min=-2.0)),
            Scanner("Dead", dict(maxWheelSpeed=0.0)),
        ],
        scenario=b.scene.UniformNadirScanning(),
        rewarder=b.data.ScanningTimeReward(),
        world_args=dict(groundStationsData=stations, gsMinimumElevation=0.1),
        time_limit=600.0,
        failure_penalty=-1.0,
    )


def horizon(b: Any) -> Any:
    """Return an imager of targets at any elevation."""

    class Imager(b.sats.ImagingSatellite):
        observation_spec = [
            b.obs.OpportunityProperties(
                dict(prop="opportunity_open", norm=300.0), dict(prop="opportunity_close", norm=300.0), n_ahead_observe=3
            )
        ]
        action_spec = [b.act.Image(n_ahead_image=4)]
        fsw_type = b.fsw.ImagingFSWModel

    return b.root.SatelliteTasking(
        satellite=Imager("Low", dict(imageTargetMinimumElevation=0.0, imageAttErrorRequirement=0.05, u_max=0.5)),
        scenario=b.scene.UniformTargets(100),
        rewarder=b.data.UniqueImageReward(),
        time_limit=3000.0,
    )


def mixed(b: Any) -> Any:
    """Return an inspection and imaging side by side, in two scenarios and with two channels of rewards.

    The imager Scout takes part in imaging but in no channel; the inspection ends before the episode does.
    """

    class Imager(b.sats.ImagingSatellite):
        observation_spec = [
            b.obs.SatProperties(dict(prop="r_BN_P", norm=7e6), dict(prop="storage_level_fraction")),
            b.obs.OpportunityProperties(dict(prop="priority"), dict(prop="opportunity_close", norm=300.0), n_ahead_observe=3),
        ]
        action_spec = [b.act.Image(n_ahead_image=3, max_duration=150.0), b.act.Charge(duration=60.0)]
        dyn_type = b.dyn.ImagingDynModel
        fsw_type = b.fsw.ImagingFSWModel

    class RSO(b.sats.Satellite):
        observation_spec = [b.obs.SatProperties(dict(prop="sigma_BN"))]
        action_spec = [b.act.NadirPoint(duration=1e9)]
        dyn_type = b.dyn.RSODynModel
        fsw_type = b.fsw.FSWModel

    class Inspector(b.sats.Satellite):
        observation_spec = [
            b.obs.SatProperties(dict(prop="storage_level_fraction"), dict(prop="wheel_speeds_fraction")),
            b.obs.RelativeProperties(dict(prop="r_DC_Hc", norm=100.0), dict(prop="v_DC_Hc"), chief_name="RSO"),
            b.obs.Time(),
        ]
        action_spec = [
            b.act.DiscreteFSWAction("action_inspect_rso", name="inspect", duration=50.0),
            b.act.Charge(duration=40.0),
        ]
        dyn_type = b.dyn.RSOInspectorDynModel
        fsw_type = (b.fsw.BasicFSWModel, b.fsw.RSOInspectorFSWModel)

    camera = dict(imageAttErrorRequirement=0.1, imageRateErrorRequirement=0.1, u_max=0.8)
    near = dict(imageAttErrorRequirement=1.0, imageRateErrorRequirement=None, instrumentBaudRate=1.0, dataStorageCapacity=1e6)
    orbit = b.orbital.random_circular_orbit(i=40.0, alt=600.0, Omega=10.0, f=200.0)
    start = {"Inspector": lambda: np.array([*np.random.uniform(-40.0, 40.0, 3), *np.random.uniform(-0.05, 0.05, 3)])}
    return b.root.ConstellationTasking(
        satellites=[
            Imager("EO", dict(camera), generation_duration=300.0),
            RSO("RSO"),
            Imager("Scout", dict(camera), generation_duration=300.0),
            Inspector("Inspector", near),
        ],
        scenario=b.scene.MixedScenario(
            {
                "ground": b.scene.UniformTargets((1200, 1300)),
                "rso": b.scene.SphericalRSO(n_points=40, theta_max=1.5, theta_solar_max=2.0),
            },
            {"ground": ["EO", "Scout"], "rso": ["RSO", "Inspector"]},
        ),
        rewarder=b.data.MixedReward(
            {
                "images": b.data.UniqueImageReward(),
                "points": b.data.RSOInspectionReward(
                    completion_bonus=3.0, completion_threshold=0.4, min_illuminated_for_completion=0.3
                ),
            },
            {"images": ["EO"], "points": ["Inspector"]},
            {"images": "ground", "points": "rso"},
        ),
        communicator=b.comm.FreeCommunication(),
        sat_arg_randomizer=b.orbital.relative_to_chief("RSO", orbit, start),
        world_args=dict(utc_init="2026 OCT 01 00:00:00.000 (UTC)"),
        time_limit=3000.0,
    )


def spacecraft(b: Any) -> Any:
    """Return two imagers of other satellites, with downlinks and a change of priorities.

    What images are worth depends on all that is recorded of them.
    """

    class Imager(b.sats.AccessSatellite):
        observation_spec = [
            b.obs.SatProperties(dict(prop="storage_level_fraction"), dict(prop="wheel_speeds_fraction")),
            b.obs.RSOTargetProperties(
                dict(prop="valid"), dict(prop="angle_to_target", norm=360.0, name="angle"), n_ahead_observe=6, name="all"
            ),
            b.obs.RSOTargetProperties(n_ahead_observe=3),
            b.obs.Eclipse(norm=5700.0),
            b.obs.Time(),
        ]
        action_spec = [
            b.act.ImageRSO(2, max_duration=120.0, min_pointing_hold_s=4.0, require_illumination_during_hold=False),
            b.act.Downlink(duration=45.0),
            b.act.Charge(duration=30.0),
        ]
        dyn_type = (b.dyn.SpaceToSpaceImagingDynModel, b.dyn.GroundStationDynModel)
        fsw_type = b.fsw.SpaceToSpaceImagingFSWModel

    class Target(b.sats.Satellite):
        observation_spec = [b.obs.SatProperties(dict(prop="sigma_BN"), dict(prop="wheel_speeds_fraction"))]
        action_spec = [b.act.Drift(duration=1e9)]
        dyn_type = b.dyn.RSOTargetDynModel
        fsw_type = b.fsw.FSWModel

    def state(angle, radius=7.0e6):
        along, up, speed = np.array([-0.6, 0.0, 0.8]), np.array([0.0, 1.0, 0.0]), (3.98600436e14 / radius) ** 0.5
        cosine, sine = np.cos(angle), np.sin(angle)
        return tuple(radius * (cosine * along + sine * up)), tuple(speed * (cosine * up - sine * along))

    def worth(record, target):
        arrival = 0.0 if record.delivery_time is None else record.delivery_time
        seen = record.capture_time / 1e3 + record.quality + record.hold_valid_time_s / 10.0 + record.size_bits / 1e6
        return target.priority * (1.0 + seen + arrival / 1e3)

    angles = (0.05, 0.1, -0.08, 2.5, -0.12, 0.2)
    targets = [
        b.scene.RSOTarget(f"object {k}", f"Target{k}", *state(angle, 7.05e6 + 1e4 * k), 1.0 + k, omega_init=(0.01, 0.0, 0.0))
        for k, angle in enumerate(angles)
    ]
    events = (b.scene.RSOPriorityEvent(0.0, (("object 1", 5.0),)), b.scene.RSOPriorityEvent(150.0, (("object 2", 0.25),)))
    camera = dict(
        oe=None,
        imageAttErrorRequirement=0.05,
        instrumentBaudRate=1e6,
        transmitterBaudRate=-3e4,
        dataStorageCapacity=3e6,
        batteryStorageCapacity=1e9,
        storedCharge_Init=1e9,
        u_max=0.8,
    )
    satellites = [Target(f"Target{k}") for k in range(3)]
    for k, angle in enumerate((0.0, -0.02)):
        r, v = state(angle)
        satellites.append(Imager(f"Imager{k}", camera | dict(rN=list(r), vN=list(v))))
    satellites += [Target(f"Target{k}") for k in range(3, len(targets))]
    return b.root.ConstellationTasking(
        satellites=satellites,
        scenario=b.scene.RSOTargets(
            b.scene.RSOTargetCatalog(targets, priority_events=events), ["Imager1", "Imager0"], block_pending_targets=False
        ),
        rewarder=b.data.RSOImageReward(worth, worth, quality_threshold=0.0, cooldown_s=200.0, multi_imager_credit="per_imager"),
        world_args=dict(utc_init="2026 OCT 01 00:00:00.000 (UTC)", gsMinimumElevation=np.radians(-90.0)),
        time_limit=3000.0,
    )


def events(b: Any) -> Any:
    """Return a satellite whose steps are interrupted, and whose model overrides what bsk_rl's has."""

    class Model(b.dyn.BasicDynamicsModel):
        _doubled = 1.0

        @property
        def inclination(self):
            return np.degrees(super().inclination)

        @property
        def true_anomaly(self):
            return np.sin(super().true_anomaly)

        @property
        def doubled(self):
            return 2.0 * self._doubled

        @doubled.setter
        def doubled(self, value):
            self._doubled = value

        @cached_property
        def known_since(self):
            return self.simulator.TotalSim.CurrentNanos * 1e-9 + 3.0

        @property
        def spin(self):
            return sum(self.rwStateEffector.rwSpeedOutMsg.read().wheelSpeeds)

    class Interrupted(b.act.Drift):
        def set_action(self, action, prev_action_key=None):
            key = super().set_action(action, prev_action_key)
            satellite, simulator = self.satellite, self.satellite.simulator
            now, model = simulator.sim_time, self.satellite.dynamics
            model.doubled = now
            satellite.seen = []

            def look(again):
                satellite.seen.append(model.battery_charge_fraction + simulator.sim_time)
                if again:
                    later(f"again {now}", simulator.sim_time + 10.0, lambda _: look(False))

            def later(name, seconds, effect):
                simulator.createNewEvent(name, int(1e9), True, conditionTime=int(seconds * 1e9), actionFunction=effect)

            later(f"late {now}", now - 5.0, lambda _: look(False))
            later(f"look {now}", now + 20.0, lambda _: look(True))
            later(f"switch {now}", now + 31.0, lambda _: satellite.fsw.action_charge())
            return key

    class Watched(b.sats.Satellite):
        seen: Any = ()
        observation_spec = [
            b.obs.SatProperties(
                dict(prop="inclination"),
                dict(prop="true_anomaly"),
                dict(prop="doubled"),
                dict(prop="known_since"),
                dict(prop="spin", norm=600.0),
                dict(prop="omega_BN_B"),
                dict(prop="battery_charge_fraction"),
                dict(prop="seen", fn=lambda satellite: float(np.sum(satellite.seen))),
                dict(prop="count", fn=lambda satellite: float(len(satellite.seen))),
            ),
            b.obs.Time(),
        ]
        action_spec = [Interrupted(duration=60.0), b.act.Charge(duration=45.0), b.act.Drift(name="instant", duration=0.0)]
        dyn_type = Model
        fsw_type = b.fsw.BasicFSWModel

    return b.root.SatelliteTasking(satellite=Watched("Watched"), time_limit=480.0)


def relays(b: Any) -> Any:
    """Return imagers with sensors of different ranges, which tell what they know by rules of the user's, and die of old age."""

    class Model(b.dyn.ImagingDynModel, b.dyn.LOSCommDynModel):
        @b.functional.aliveness_checker
        def young(self):
            return self.simulator.sim_time < 100.0 or self.satellite.name != "Eye2"

    class Often(b.comm.LOSCommunication):
        """Those who have seen one another in most of the step communicate at its end."""

        def reset_overwrite_previous(self):
            super().reset_overwrite_previous()
            self.ticks = self.pairs = 0

        def communication_pairs(self):
            logs = [log.hasAccess for seen in self.los_logs.values() for log in seen.values()]
            self.ticks += sum(map(sum, logs)) + len(logs[0])
            listed = super().communication_pairs()
            self.pairs += len(listed)
            return [(one, other) for one, other in listed if np.mean(self.los_logs[one][other].hasAccess) > 0.5]

    class Joined(b.comm.BroadcastCommunication, b.comm.MultiDegreeCommunication, Often):
        pass

    class Eye(b.sats.ImagingSatellite):
        observation_spec = [
            b.obs.SatProperties(
                dict(prop="known", fn=lambda satellite: len(satellite.data_store.data.imaged)),
                dict(prop="twice", fn=lambda satellite: satellite.data_store.data.duplicates),
                dict(prop="alive", fn=lambda satellite: satellite.dynamics.young(log_failure=True)),
            ),
            b.obs.OpportunityProperties(dict(prop="priority"), n_ahead_observe=2),
        ]
        action_spec = [b.act.Image(n_ahead_image=2), b.act.Charge(duration=80.0), b.act.Broadcast(duration=40.0)]
        dyn_type = Model
        fsw_type = b.fsw.ImagingFSWModel

    class Until(b.root.ConstellationTasking):
        def _get_info(self):
            info = super()._get_info()
            info["__common__"] = info["__common__"] | {"ticks": int(self.communicator.ticks), "pairs": self.communicator.pairs}
            return info

    args = dict(imageAttErrorRequirement=0.1, imageRateErrorRequirement=0.1)
    ranges = (2.2e6, -1.0, 3e6, 1e6)
    return Until(
        satellites=[Eye(f"Eye{k}", dict(args, losMaximumRange=reach)) for k, reach in enumerate(ranges)],
        scenario=b.scene.UniformTargets(900),
        rewarder=b.data.UniqueImageReward(),
        communicator=Joined(min_period=30.0),
        sat_arg_randomizer=b.orbital.walker_delta_args(n_planes=2, altitude=800.0, inc=60.0, clustersize=2, clusterspacing=15.0),
        time_limit=1100.0,
    )


PROGRAMS = {
    program.__name__: program
    for program in (events, relays, scanning, imaging, constellation, extremes, horizon, mixed, spacecraft)
}
"""Programs by name."""


def plain(value: Any) -> Any:
    """Return results as JSON has them: numbers, lists and dictionaries."""
    if isinstance(value, dict):
        return {str(name): plain(part) for name, part in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [plain(part) for part in value]
    return value.item() if isinstance(value, np.generic) else value


def chosen(name: str, rng: np.random.Generator) -> Any:
    """Return the next action of a program."""
    if name in ("scanning", "horizon"):
        return int(rng.integers(4))
    if name == "events":
        return int(rng.choice([0, 1, 2], p=[0.6, 0.2, 0.2]))
    if name == "relays":
        return {f"Eye{k}": int(action) for k, action in enumerate(rng.choice([0, 1, 3], p=[0.4, 0.2, 0.4], size=4))}
    if name == "imaging":
        return [int(action) for action in rng.integers(6, size=2)]
    if name == "extremes":
        return {agent: int(rng.integers(4)) for agent in ("Turned", "Efficient", "Filling", "Dead")}
    if name == "mixed":
        eo, scout, charge = map(int, rng.integers(4, size=3))
        return {"EO": eo, "RSO": 0, "Scout": scout, "Inspector": charge // 3}
    if name == "spacecraft":
        turn = int(rng.integers(3))
        slots = [int(slot) for slot in rng.integers(2, size=2)]
        acts = [slot if (turn + k) % 3 else 2 + (turn == 2) for k, slot in enumerate(slots)]
        return {f"Imager{k}": action for k, action in enumerate(acts)} | {f"Target{k}": 0 for k in range(6)}
    thrust = np.array([*rng.uniform(-1.0, 1.0, 3), rng.uniform(50.0, 250.0)])
    return {"Chief": int(rng.integers(2)), "Deputy": thrust}


def play(name: str, root: str, seeds: tuple[int, ...] = (3, 4)) -> list[Any]:
    """Return what the episodes of a program show: the results of resets and steps."""
    env, shown = PROGRAMS[name](load(root)), []
    for seed in seeds:
        rng = np.random.default_rng(seed)
        shown.append(plain(env.reset(seed=seed)))
        for _ in range(STEPS):
            shown.append(plain(env.step(chosen(name, rng))))
    return shown
