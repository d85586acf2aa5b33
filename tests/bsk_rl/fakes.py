"""Satellites that scenarios, rewarders and communicators can be tried with, without a simulation."""

import logging
from types import SimpleNamespace

from bsk_torch.bsk_rl.scene import UniformTargets
from bsk_torch.bsk_rl.scene.targets import Target
from bsk_torch.sim.dyn import GroundStationDynModel, LOSCommDynModel
from bsk_torch.sim.fsw import ImagingFSWModel


class Imager(GroundStationDynModel, LOSCommDynModel):
    """Dynamics of the satellites here."""


class Fake:
    """A satellite whose store, time and lines of sight a test sets."""

    dyn_type, fsw_type = Imager, ImagingFSWModel

    def __init__(self, name, simulator=None, **more):
        self.name = name
        self.logger = logging.getLogger(name)
        self.simulator = simulator or SimpleNamespace(sim_time=0.0, pairs=[])
        self.sat_args_generator = {"imageTargetMinimumElevation": 0.5, "mu": 3.98600436e14}
        self.filters, self.places, self.latest_target = [], [], None
        self.levels, self.baud = [0.0], 10.0
        self.action_builder = SimpleNamespace(action_spec=[])
        self.observation_builder = SimpleNamespace(observation_spec=[])
        self.__dict__.update(more)

    @property
    def dynamics(self):
        message = SimpleNamespace(storedData=list(self.levels), storageLevel=sum(self.levels))
        unit = SimpleNamespace(storageUnitDataOutMsg=SimpleNamespace(read=lambda: message))
        return SimpleNamespace(storageUnit=unit, instrument=SimpleNamespace(nodeBaudRate=self.baud))

    def add_access_filter(self, function, types=None, prepend=False):
        self.filters.append(function)

    def add_location_for_access_checking(self, **place):
        self.places.append(place)


def fleet(count, simulator=None):
    """Return satellites Sat0, Sat1, ... with one simulator, whose ``pairs`` see one another."""
    simulator = simulator or SimpleNamespace(sim_time=0.0, pairs=[])
    simulator.visible_pairs = lambda: {*simulator.pairs, *(pair[::-1] for pair in simulator.pairs)}
    return [Fake(f"Sat{k}", simulator) for k in range(count)]


def begin(rewarder, scenario, satellites):
    """Reset a rewarder and its scenario, in the order of an environment."""
    for part in (scenario, rewarder):
        part.reset_overwrite_previous()
    for part in (scenario, rewarder):
        part.reset_pre_sim_init()
    for satellite in satellites:
        rewarder.create_data_store(satellite)
        rewarder.data += rewarder.initial_data(satellite)
    for part in (scenario, rewarder):
        part.reset_during_sim_init()
    for part in (scenario, rewarder):
        part.reset_post_sim_init()
    for satellite in satellites:
        satellite.data_store.update_from_logs()


def step(rewarder, satellites):
    """Return the reward of a step."""
    return rewarder.reward({satellite.name: satellite.data_store.update_from_logs() for satellite in satellites})


class Copied(UniformTargets):
    """Targets at given places."""

    def __init__(self, r_LP_P, priority):
        super().__init__(len(priority))
        self.given = list(zip(r_LP_P, priority, strict=True))

    def regenerate_targets(self):
        self.targets = [Target(f"tgt-{k}", *place) for k, place in enumerate(self.given)]


def targets_of(vector, k):
    """Return the targets of environment ``k`` of a batch."""
    exists = vector.core.scenario.drawn("target_exists")[k].bool()
    return Copied(*(getattr(vector.core.scenario, name)[k][exists].numpy() for name in ("r_LP_P", "priority")))
