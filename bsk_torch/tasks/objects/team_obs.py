"""Observations of imagers that know different images: their task, what they have to tell, and the other imagers."""

from __future__ import annotations

import functools

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch._checks import number, whole
from bsk_torch.astro.orbit import hill_frame
from bsk_torch.obs.base import Observation, Values
from bsk_torch.sats.bound import BoundSatellite
from bsk_torch.sim.run.encounters import NEVER
from bsk_torch.sim.state import FINITE
from bsk_torch.tasks.objects.records import AGO, CAPTURED, RecordBook
from bsk_torch.tasks.objects.scene import RSOTargets, check_imager
from bsk_torch.vec3 import Vec3

MODES = (("charge",), ("downlink",), ("desat_sun", "desat_nadir", "desat_none"), ("transmit_rso",), ("image_rso",))
"""Flight modes of the tasks, in the order in which they are observed."""

LONG = 12000.0
"""Time by which times are divided, s; about two orbits."""

DISTANCE, SPEED = 15960e3, 12e3
"""Distance, m, and speed, m/s, by which those of other imagers are divided."""

HEARD = "rso_team_heard"
"""Memory of what each imager has heard of the state of each other one last, [n, peers, 5]."""


def task_in_progress(satellite: BoundSatellite) -> tuple[Tensor, Tensor]:
    """Return when each satellite's task ends, s, and its place in :data:`MODES`, [n] each; now and their number without a task.

    A task without an end counts as none.
    """
    simulator, task = satellite.simulator, satellite.task
    busy = ~task.requires_retasking & (task.ends < NEVER)
    kinds = [next((k for k, modes in enumerate(MODES) if name in modes), len(MODES)) for name in simulator.mode_names]
    kind = torch.tensor(kinds, device=simulator.device)[simulator.mode]
    ends = torch.where(busy, task.ends.clamp(max=2**52).double() * simulator.h, simulator.sim_time)
    return ends, torch.where(busy, kind, len(MODES)).double()


def check_peers(satellite: BoundSatellite, n_peers: int, title: str) -> None:
    """ValueError, which begins with ``title``, unless each imager has ``n_peers`` others."""
    peers = satellite.scenario.peers.shape[2]
    if peers != n_peers:
        raise ValueError(f"{title} has n_peers={n_peers}, but each imager has {peers} peers")


def of_peers(satellite: BoundSatellite, table: Tensor) -> Tensor:
    """Return the entries of each satellite by peer, [n, peers, ...], of a table [N, A, A, ...] by imager and imager."""
    scenario: RSOTargets = satellite.scenario
    index = scenario.peers.expand(len(table), -1, -1)
    index = index.view(*index.shape, *[1] * (table.ndim - 3)).expand(*index.shape, *table.shape[3:])
    return scenario.of_imagers(satellite, table.gather(2, index))


class ImagerObservation(Observation):
    """An observation of imagers of a catalog only."""

    @override
    def link_satellite(self, satellite: BoundSatellite) -> None:
        super().link_satellite(satellite)
        check_imager(satellite, f"{type(self).__name__} {self.name!r}")


class RSOTaskStatus(ImagerObservation):
    """The task of an imager, and what others have not been told; 12 numbers.

    ====================  ============================================================================================
    ``task`` (5)          1 for the task in progress: charge, downlink, desaturate, transmit, image
    ``elapsed``           time since it began
    ``remaining``         time until it ends at the latest
    ``held``              time held of an image or a packet, as a fraction of what is needed
    ``untold``            records that some other imager has not been told of, as a fraction of the number of targets
    ``exchange_age``      time since the last message from or to any other imager
    ``exchange_known``    1 if there was one
    ``busy``              1 if a task is in progress
    ====================  ============================================================================================

    Times are divided by ``norm``. Without a task, the first eight numbers are zero.
    """

    def __init__(self, norm: float = LONG, name: str = "task_status") -> None:
        """Divide times by ``norm``, s; ValueError unless it is positive."""
        super().__init__(name)
        self.norm = number("norm", norm, 0.0, unit="s", above=True)

    @override
    def get_obs(self) -> Values:
        satellite, simulator, task = self.satellite, self.simulator, self.satellite.task
        scenario: RSOTargets = satellite.scenario
        records = scenario.known_records
        busy = (~task.requires_retasking & (task.ends < NEVER)).double()
        kinds = [[name in modes for name in simulator.mode_names] for modes in MODES]
        kind = torch.tensor(kinds, device=simulator.device).double().mT[simulator.mode] * busy.unsqueeze(1)
        remaining = (task.ends.clamp(max=2**52) - simulator.ticks).double() * simulator.h
        remaining = torch.where(busy > 0.0, remaining, 0.0)
        untold = (records.news() > 0).any(3).sum(1).double() / scenario.n_targets
        last = torch.maximum(records.exchanged, records.exchanged.mT).amax(2)
        last = scenario.of_imagers(satellite, last)
        exchanged = last > AGO
        return {
            "task": kind,
            "elapsed": torch.where(busy > 0.0, task.task_duration - remaining, 0.0) / self.norm,
            "remaining": remaining / self.norm,
            "held": self._held() * busy,
            "untold": scenario.of_imagers(satellite, untold),
            "exchange_age": torch.where(exchanged, simulator.sim_time - last, 0.0) / self.norm,
            "exchange_known": exchanged.double(),
            "busy": busy,
        }

    def _held(self) -> Tensor:
        """Return the time held as a fraction of what is needed, [n]."""
        simulator = self.simulator
        share = torch.zeros_like(simulator.sim_time)
        for mode, held, hold in (("image_rso", "rso_held", "rso_hold"), ("transmit_rso", "radio_held", "radio_hold")):
            if mode in simulator.mode_names:
                fraction = simulator.state.read(held) / simulator.state.read(hold).clamp(min=simulator.h)
                on = simulator.mode == simulator.mode_names.index(mode)
                share = torch.where(on, fraction.double().clamp(max=1.0), share)
        return share


class RSOPeers(ImagerObservation):
    """The other imagers in the order of :class:`~bsk_torch.tasks.objects.TransmitCatalog`; 12 numbers each.

    =====================  =======================================================================================
    ``r_H`` (3)            position relative to the imager in its Hill frame, divided by 15,960 km
    ``v_H`` (3)            difference of the inertial velocities in the same frame, divided by 12 km/s
    ``angle``              angle between the instrument and the peer, divided by 180 degrees
    ``distance``           distance, divided by 15,960 km
    ``news``               records that the peer has not been told of, as a fraction of the number of targets
    ``exchange_age``       time since the last message between both, divided by 12,000 s
    ``exchange_known``     1 if there was one
    ``valid``              1 if there is something to tell the peer, it lives, and the Earth is not between both
    =====================  =======================================================================================

    All numbers of a peer that is not valid are zero.
    """

    def __init__(self, n_peers: int, name: str = "peers") -> None:
        """Observe ``n_peers`` others; ValueError unless there are as many."""
        super().__init__(name)
        self.n_peers = whole("n_peers", n_peers, 1)

    @override
    def get_obs(self) -> Values:
        satellite = self.satellite
        scenario: RSOTargets = satellite.scenario
        records = scenario.known_records
        check_peers(satellite, self.n_peers, f"RSOPeers {self.name!r}")
        select = functools.partial(of_peers, satellite)
        r_N, v_N = scenario.imager_states()
        rho, dv = (select(part.unsqueeze(1) - part.unsqueeze(2)) for part in (r_N, v_N))
        dynamics = satellite.dynamics
        HN = hill_frame(Vec3.of(dynamics.r_BN_N), Vec3.of(dynamics.v_BN_N)).stack()
        distance = rho.norm(dim=-1)
        cosine = (rho * scenario.axis_N(satellite).unsqueeze(1)).sum(-1) / distance.clamp(min=1.0)
        news = (records.news() > 0).sum(1)
        last = select(torch.maximum(records.exchanged, records.exchanged.mT))
        exchanged = last > AGO
        valid = select((news > 0) & scenario.linked & scenario.imagers_alive.unsqueeze(1)).double()
        now = self.simulator.sim_time.unsqueeze(1)
        columns = {
            "r_H": (rho @ HN.mT) / DISTANCE,
            "v_H": (dv @ HN.mT) / SPEED,
            "angle": torch.rad2deg(torch.acos(cosine.clamp(-1.0, 1.0))) / 180.0,
            "distance": distance / DISTANCE,
            "news": select(news.double()) / scenario.n_targets,
            "exchange_age": torch.where(exchanged, now - last, 0.0) / LONG,
            "exchange_known": exchanged.double(),
            "valid": valid,
        }
        masked = {name: value * (valid.unsqueeze(-1) if value.ndim == 3 else valid) for name, value in columns.items()}
        return {f"{self.name}_{k}": {name: value[:, k] for name, value in masked.items()} for k in range(self.n_peers)}


class RSOTeamState(ImagerObservation):
    """A summary of the other imagers from which there has been a message, however many there are; 24 numbers.

    ======================  =======================================================================================
    ``distance`` (2)        distance, divided by 15,960 km
    ``radial_rate`` (2)     rate of the distance, divided by 12 km/s
    ``battery`` (2)         battery charge as a fraction of the capacity
    ``storage`` (2)         data in the store as a fraction of the capacity
    ``wheels`` (2)          speed of the fastest wheel as a fraction of the maximum
    ``remaining`` (2)       time until its task ends at the latest, divided by ``norm``
    ``message_age`` (2)     time since the last message from it, divided by ``norm``
    ``capture_age`` (2)     time since its latest capture that the imager knows of, divided by ``norm``
    ``linked`` (2)          1 if the Earth is not between both
    ``tasks`` (6)           shares of those that charge, downlink, desaturate, transmit, image, or have no task
    ======================  =======================================================================================

    Pairs are the mean and the maximum over these imagers. Battery, storage, wheels and task are those at the time of the last
    message; its end may have passed, and then no time remains. Distance, rate and link are present ones, which follow from the
    orbits. Without a capture, its age is the time since the episode began. All numbers are zero without a message.

    A public branch of BSK-RL has a summary of as many numbers; the definitions above are those of this package.
    """

    def __init__(self, n_peers: int, norm: float = LONG, name: str = "team_state") -> None:
        """Summarize ``n_peers`` others, and divide times by ``norm``, s; ValueError for other numbers of peers, or no time."""
        super().__init__(name)
        self.n_peers = whole("n_peers", n_peers, 1)
        self.norm = number("norm", norm, 0.0, unit="s", above=True)

    @override
    def link_satellite(self, satellite: BoundSatellite) -> None:
        super().link_satellite(satellite)
        if HEARD in satellite.simulator.memory:
            raise ValueError(f"{satellite.name!r} has two observations RSOTeamState; one summarizes all peers")
        satellite.simulator.memory.declare(HEARD, 0.0, self.n_peers, 5, low=0.0, high=FINITE)

    def get_obs(self) -> Values:
        """See :meth:`Observation.get_obs`; what has just been heard is remembered."""
        satellite, now = self.satellite, self.simulator.sim_time.unsqueeze(1)
        scenario: RSOTargets = satellite.scenario
        check_peers(satellite, self.n_peers, f"RSOTeamState {self.name!r}")
        records, select = scenario.known_records, functools.partial(of_peers, satellite)
        last = select(records.exchanged.mT)
        exchanged, heard = last > AGO, satellite.simulator.memory[HEARD]
        heard = torch.where((last == now).unsqueeze(2), select(states_by_peer(scenario)), heard)
        satellite.simulator.memory[HEARD] = heard
        battery, storage, wheels, ends, kind = heard.unbind(2)
        r_N, v_N = scenario.imager_states()
        rho, dv = (select(part.unsqueeze(1) - part.unsqueeze(2)) for part in (r_N, v_N))
        distance = rho.norm(dim=-1)
        columns = {
            "distance": distance / DISTANCE,
            "radial_rate": (rho * dv).sum(-1) / distance.clamp(min=1.0) / SPEED,
            "battery": battery,
            "storage": storage,
            "wheels": wheels,
            "remaining": (ends - now).clamp(min=0.0) / self.norm,
            "message_age": (now - last) / self.norm,
            "capture_age": (now - select(latest_captures(records))) / self.norm,
            "linked": select(scenario.linked.double()),
        }
        kinds = (kind.unsqueeze(2) == torch.arange(len(MODES) + 1, device=kind.device)) & exchanged.unsqueeze(2)
        shares = kinds.double().sum(1) / exchanged.sum(1, keepdim=True).clamp(min=1)
        return {name: mean_and_most(value, exchanged) for name, value in columns.items()} | {"tasks": shares}


def states_by_peer(scenario: RSOTargets) -> Tensor:
    """Return battery, storage, fastest wheel, end of the task, s, and its place in :data:`MODES`, [N, A, A, 5].

    The second imager has this state, whichever the first is.
    """
    columns = scenario.each_imager(
        lambda satellite: torch.stack(
            [
                satellite.dynamics.battery_charge_fraction,
                satellite.dynamics.storage_level_fraction,
                satellite.dynamics.wheel_speeds_fraction.abs().amax(1),
                *task_in_progress(satellite),
            ],
            1,
        )
    )
    return columns.unsqueeze(1).expand(-1, columns.shape[1], -1, -1)


def latest_captures(records: RecordBook) -> Tensor:
    """Return the time of the latest capture by the second imager that the first knows of, [N, A, A] s; zero for none."""
    by = torch.nn.functional.one_hot(records.source, records.sensors).bool().unsqueeze(2)
    counts = (records.known >= CAPTURED).unsqueeze(3) & by
    return torch.where(counts, records.capture.view(*records.capture.shape, 1, 1), 0.0).amax(1)


def mean_and_most(value: Tensor, valid: Tensor) -> Tensor:
    """Return mean and maximum, [n, 2], of the values [n, peers] of ``valid`` peers [n, peers]; zeros where there are none."""
    exists = valid.any(1)
    mean = torch.where(valid, value, 0.0).sum(1) / valid.sum(1).clamp(min=1)
    most = torch.where(valid, value, -torch.inf).amax(1)
    return torch.stack([mean, torch.where(exists, most, 0.0)], 1)
