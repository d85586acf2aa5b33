"""Observations of imagers that know different images: their task, what they have to tell, and the other imagers."""

from __future__ import annotations

import torch
from torch import Tensor

from bsk_torch._checks import number, whole
from bsk_torch.astro.orbit import hill_frame
from bsk_torch.obs.base import Observation, Values
from bsk_torch.sats.bound import BoundSatellite
from bsk_torch.scene.rso_records import AGO
from bsk_torch.scene.rso_targets import RSOTargets, check_imager
from bsk_torch.sim.fleet import NEVER
from bsk_torch.vec3 import Vec3

MODES = (("charge",), ("downlink",), ("desat_sun", "desat_nadir", "desat_none"), ("transmit_rso",), ("image_rso",))
"""Flight modes of the tasks, in the order in which they are observed."""

LONG = 12000.0
"""Time by which times are divided, s; about two orbits."""


class RSOTaskStatus(Observation):
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

    def link_satellite(self, satellite: BoundSatellite) -> None:
        """See :meth:`Observation.link_satellite`; ValueError unless it is an imager of a catalog."""
        super().link_satellite(satellite)
        check_imager(satellite, f"obs.RSOTaskStatus {self.name!r}")

    def get_obs(self) -> Values:
        """See :meth:`Observation.get_obs`."""
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
        known = last > AGO
        return {
            "task": kind,
            "elapsed": torch.where(busy > 0.0, task.task_duration - remaining, 0.0) / self.norm,
            "remaining": remaining / self.norm,
            "held": self._held() * busy,
            "untold": scenario.of_imagers(satellite, untold),
            "exchange_age": torch.where(known, simulator.sim_time - last, 0.0) / self.norm,
            "exchange_known": known.double(),
            "busy": busy,
        }

    def _held(self) -> Tensor:
        """Return the time held as a fraction of what is needed, [n]."""
        simulator = self.simulator
        found = torch.zeros_like(simulator.sim_time)
        for mode, held, needed in (("image_rso", "rso_held", "rso_hold"), ("transmit_rso", "radio_held", "radio_hold")):
            if mode in simulator.mode_names:
                fraction = simulator.state.read(held) / simulator.state.read(needed).clamp(min=simulator.h)
                on = simulator.mode == simulator.mode_names.index(mode)
                found = torch.where(on, fraction.double().clamp(max=1.0), found)
        return found


class RSOPeers(Observation):
    """The other imagers in the order of :class:`~bsk_torch.act.TransmitCatalog`; 12 numbers each.

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

    def link_satellite(self, satellite: BoundSatellite) -> None:
        """See :meth:`Observation.link_satellite`; ValueError unless it is an imager of a catalog."""
        super().link_satellite(satellite)
        check_imager(satellite, f"obs.RSOPeers {self.name!r}")

    def get_obs(self) -> Values:
        """See :meth:`Observation.get_obs`."""
        satellite = self.satellite
        scenario: RSOTargets = satellite.scenario
        records, peers = scenario.known_records, scenario.peers
        if peers.shape[2] != self.n_peers:
            raise ValueError(f"obs.RSOPeers {self.name!r} has n_peers={self.n_peers}, but each imager has {peers.shape[2]} peers")

        def mine(table: Tensor) -> Tensor:
            index = peers.expand(len(table), -1, -1)
            index = index.view(*index.shape, *[1] * (table.ndim - 3)).expand(*index.shape, *table.shape[3:])
            return scenario.of_imagers(satellite, table.gather(2, index))

        r_N, v_N = scenario.imager_states()
        rho, dv = (mine(part.unsqueeze(1) - part.unsqueeze(2)) for part in (r_N, v_N))
        dynamics = satellite.dynamics
        HN = hill_frame(Vec3.of(dynamics.r_BN_N), Vec3.of(dynamics.v_BN_N)).stack()
        distance = rho.norm(dim=-1)
        cosine = (rho * scenario.axis_N(satellite).unsqueeze(1)).sum(-1) / distance.clamp(min=1.0)
        news = (records.news() > 0).sum(1)
        last = mine(torch.maximum(records.exchanged, records.exchanged.mT))
        known = last > AGO
        valid = mine((news > 0) & scenario.linked & scenario.imagers_alive.unsqueeze(1)).double()
        now = self.simulator.sim_time.unsqueeze(1)
        columns = {
            "r_H": (rho @ HN.mT) / 15960e3,
            "v_H": (dv @ HN.mT) / 12e3,
            "angle": torch.rad2deg(torch.acos(cosine.clamp(-1.0, 1.0))) / 180.0,
            "distance": distance / 15960e3,
            "news": mine(news.double()) / scenario.n_targets,
            "exchange_age": torch.where(known, now - last, 0.0) / LONG,
            "exchange_known": known.double(),
            "valid": valid,
        }
        shown = {name: value * (valid.unsqueeze(-1) if value.ndim == 3 else valid) for name, value in columns.items()}
        return {f"{self.name}_{k}": {name: value[:, k] for name, value in shown.items()} for k in range(self.n_peers)}
