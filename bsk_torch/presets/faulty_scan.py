"""FaultyScan-v1: NadirScan-v1 on a satellite whose parts fail at random times.

Observation, 21 numbers: the 12 of NadirScan-v1 (:mod:`bsk_torch.presets.nadir_scan`), and, unless ``observed=False``:

======================  ==========================================================================================
``fault_severity`` (9)  share of the change of each fault that acts now, from 0 to 1; not how large the change is
======================  ==========================================================================================

Actions, reward and termination: those of NadirScan-v1.

Random at reset: as in NadirScan-v1, and faults of five kinds. Panel, battery and transmitter fail with probability 0.3 each, and
each of the three wheels with probability 0.1 by each of its two kinds of faults, all independently. A fault starts at a time
uniform in the first three of five orbits, and does not end.

===============  ==========================================================  =========================
kind             change                                                      range
===============  ==========================================================  =========================
``wheel``        largest torque of a wheel, from 0.2 N m                     0.002 to 0.02 N m
``friction``     Coulomb friction of a wheel, which grows for half an orbit  0.01 to 0.05 N m
``panel``        power of the panel                                          multiplied by 0.3 to 0.7
``battery``      capacity of the battery                                     multiplied by 0.2 to 0.6
``transmitter``  data rate of the transmitter                                multiplied by 0.02 to 0.2
===============  ==========================================================  =========================
"""

from __future__ import annotations

from collections.abc import Collection

import torch

from bsk_torch import obs, rand
from bsk_torch._checks import number
from bsk_torch.env import SatelliteTasking
from bsk_torch.presets.nadir_scan import ORBIT, ScanningSatellite, scanning_args, scanning_environment
from bsk_torch.sim import faults
from bsk_torch.sim.arguments.values import nearest
from bsk_torch.sim.faults import Fault, Sometimes

KINDS = ("wheel", "friction", "panel", "battery", "transmitter")
"""Kinds of faults."""

CHANCE = 0.3
"""Expected number of faults of a kind in an episode."""

LATEST = 3 * ORBIT
"""Latest time at which a fault starts, s."""

WHEELS = 3
"""Number of wheels of the satellite."""


def scanning_faults(kinds: Collection[str] = KINDS, chance: float = CHANCE) -> list[Fault]:
    """Return the faults of the satellite.

    Args:
        kinds: Kinds that occur, of :data:`KINDS`. Those of other kinds start only by ``env.inject``.
        chance: Expected number of faults of each of these kinds in an episode, from 0 to 1.
    """
    chance = number("chance", chance, 0.0, 1.0)
    if isinstance(kinds, str):
        raise ValueError(f"kinds={kinds!r} must be a list of kinds of faults, such as [{kinds!r}]")
    for kind in kinds:
        if kind not in KINDS:
            raise ValueError(f"kinds: {kind!r} is not a kind of fault; {nearest(kind, KINDS)}")

    def at(kind: str, parts: int = 1) -> Sometimes | None:
        return Sometimes(chance / parts, rand.Uniform(0.0, LATEST)) if kind in kinds else None

    torque, coulomb = rand.Uniform(0.002, 0.02), rand.Uniform(0.01, 0.05)
    return [
        *(faults.wheel_torque(k, torque, at=at("wheel", WHEELS)) for k in range(WHEELS)),
        *(faults.wheel_friction(k, coulomb, at=at("friction", WHEELS), over=ORBIT / 2) for k in range(WHEELS)),
        faults.panel(rand.Uniform(0.3, 0.7), at=at("panel")),
        faults.battery(rand.Uniform(0.2, 0.6), at=at("battery")),
        faults.transmitter(rand.Uniform(0.02, 0.2), at=at("transmitter")),
    ]


def faulty_scan(
    *,
    kinds: Collection[str] = KINDS,
    chance: float = CHANCE,
    observed: bool = True,
    sat_args: dict[str, object] | None = None,
    obs_type: type = torch.Tensor,
    **options: object,
) -> SatelliteTasking:
    """Return FaultyScan-v1; see the module, :func:`scanning_faults`, and :func:`bsk_torch.presets.nadir_scan.nadir_scan`.

    The severity of faults is part of the observation unless ``observed`` is False.
    """
    arguments = scanning_args() | dict(faults=scanning_faults(kinds, chance)) | (sat_args or {})
    severity = (obs.SatProperties(dict(prop="fault_severity"), name="faults"),) if observed else ()
    spec = (*ScanningSatellite.observation_spec, *severity)
    return scanning_environment(ScanningSatellite("Scanner1", arguments, obs_type=obs_type, observation_spec=spec), options)
