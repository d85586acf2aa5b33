"""Fleets for the tests: satellites on given orbits, without an environment around them."""

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import torch

from bsk_torch.astro.orbit import Elements, elements_to_rv
from bsk_torch.comm.los import MAX_RANGE
from bsk_torch.rand import first_key
from bsk_torch.sats.bound import SatelliteFleet
from bsk_torch.sim import dyn, fsw
from tests.sim.simulators import make_simulator

UTC = "2021 MAR 05 07:12:33.250 (UTC)"


class Seeing(dyn.BasicDynamicsModel, dyn.LOSCommDynModel):
    """What satellites of these tests are; one class for each type."""


class AlsoSeeing(Seeing):
    """Another type."""


def states(oe: torch.Tensor) -> list[dict[str, Any]]:
    """Arguments of satellites with elements [S, 6]: a in m, e, angles in rad."""
    r, v = (x.stack().tolist() for x in elements_to_rv(Elements(*oe.unbind(-1))))
    return [{"rN": a, "vN": b} for a, b in zip(r, v, strict=True)]


def drawn_elements(n: int, eccentricity: float = 0.02) -> torch.Tensor:
    """Elements [n, 6] of random orbits, perigees from 400 to 1400 km up."""
    u = torch.rand(6, n, dtype=torch.float64)
    e = eccentricity * u[1]
    angles = torch.pi * torch.stack([u[2], 2 * u[3], 2 * u[4], 2 * u[5]])
    return torch.stack([(6.78e6 + 1e6 * u[0]) / (1.0 - e), e, *angles], -1)


def make_fleet(
    satellites: Sequence[dict[str, Any]],
    num_envs: int = 1,
    sim_rate: float = 1.0,
    backend: str = "eager",
    types: Sequence[Sequence[int]] | None = None,
    orbit: str = "arc",
) -> SatelliteFleet:
    """A fleet at the beginning of its episodes; ``types`` are the numbers of the satellites of each type."""
    types = types or [range(len(satellites))]
    models = Seeing, AlsoSeeing
    simulators = []
    for k, columns in enumerate(types):
        fixed = [satellites[c] for c in columns]
        options = {"num_envs": num_envs, "dtype": torch.float64, "horizon": 0.0}
        more = {"sim_rate": sim_rate, "orbit": orbit, "backend": backend, "columns": list(columns)}
        simulators.append(make_simulator(models[k], fsw.BasicFSWModel, fixed, {"utc_init": UTC}, **options, **more))
    fleet = SatelliteFleet(simulators, [f"Sat{k}" for k in range(len(satellites))])
    fleet.satellites = tuple(SimpleNamespace(dyn_type=models[k], simulator=part) for k, part in enumerate(fleet.simulators))
    key, none = first_key(num_envs), torch.zeros(num_envs, dtype=torch.float64)
    fleet.reset(fleet.all_envs, fleet.draw(key), [none] * len(types), none)
    return fleet


def step(fleet: SatelliteFleet, ticks: int | Sequence[int] | torch.Tensor) -> None:
    """A step of ``ticks`` (one number, or [N]) in which satellites only follow their arcs, which is all that they see."""
    fleet.since = fleet.ticks.clone()
    ticks = torch.as_tensor(ticks).expand(fleet.num_envs)
    for simulator in fleet.simulators:
        simulator.lookahead.reach(simulator.sim_time + simulator.of_env(ticks) * simulator.h, simulator.sim_time)
        simulator.state.ticks = simulator.ticks + simulator.of_env(ticks)


def with_ranges(satellites: Sequence[dict[str, Any]], reach: Sequence[float]) -> list[dict[str, Any]]:
    """The satellites with their longest ranges, m."""
    return [{**satellite, MAX_RANGE: float(x)} for satellite, x in zip(satellites, reach, strict=True)]


def recorded(file: dict[str, Any], backend: str = "eager") -> SatelliteFleet:
    """The fleet of a recording."""
    satellites = [{name: value for name, value in initial.items() if name != "utc_init"} for initial in file["ic"]]
    return make_fleet(with_ranges(satellites, file["ranges"]), sim_rate=file["env"]["sim_rate"], backend=backend)
