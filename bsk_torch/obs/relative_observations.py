"""Observations of a satellite relative to another one of its episode, and the observed functions.

D is the deputy, the observing satellite; C is the chief. Names denote the quantity and the axes: N inertial, C and D of
the two bodies, Hc and Hd of their Hill frames (radial, along the track, orbit normal), Hs of the Hill frame of the Earth's orbit
about the Sun. Velocities are relative to the named frame; in a rotating frame F they are
``[FN] (v_D - v_C - omega_FN x (r_D - r_C))`` (Schaub and Junkins, sections 1.3 and 14.2). Attitudes are MRPs with a length of at
most one.

All functions take satellites of batches, with tensors [N, ...].
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import torch
from torch import Tensor

from bsk_torch._checks import text
from bsk_torch.astro.attitude import dcm_to_mrp, mrp_to_dcm
from bsk_torch.astro.orbit import hill_frame, hill_rate
from bsk_torch.astro.relative import cd2hill, vectors
from bsk_torch.constants import MU_EARTH
from bsk_torch.obs.base import ADVICE, Observation, Values
from bsk_torch.obs.entries import is_own, parse_entries, scaled
from bsk_torch.sats.bound import BoundSatellite, SatelliteLike
from bsk_torch.sats.user_function import UserFunction
from bsk_torch.sim.names import nearest
from bsk_torch.vec3 import Mat3, Vec3


def states(*satellites: SatelliteLike) -> list[Vec3]:
    """Return position, m, and velocity, m/s, of each satellite, one after the other."""
    return vectors(*(value for satellite in satellites for value in _orbit(satellite)))


def _orbit(satellite: SatelliteLike) -> tuple[Any, Any]:
    return satellite.dynamics.r_BN_N, satellite.dynamics.v_BN_N


def _times(a: Mat3, b: Mat3) -> Mat3:
    columns = b.mT
    return Mat3(*(columns @ row for row in a))


def _body(satellite: SatelliteLike) -> Mat3:
    return mrp_to_dcm(*vectors(satellite.dynamics.sigma_BN))


def _hill(satellite: SatelliteLike) -> Mat3:
    """Return the DCM [HN] of a satellite's Hill frame."""
    return hill_frame(*states(satellite))


def r_DC_N(deputy: SatelliteLike, chief: SatelliteLike) -> Tensor:
    """Return the position of the deputy relative to the chief, ``r_D - r_C``, m in N, [N, 3]."""
    r_D, _, r_C, _ = states(deputy, chief)
    return (r_D - r_C).stack()


def v_DC_N(deputy: SatelliteLike, chief: SatelliteLike) -> Tensor:
    """Return the inertial velocity of the deputy relative to the chief, ``v_D - v_C``, m/s in N, [N, 3]."""
    _, v_D, _, v_C = states(deputy, chief)
    return (v_D - v_C).stack()


def r_DC_Hc(deputy: SatelliteLike, chief: SatelliteLike) -> Tensor:
    """Return the position of the deputy relative to the chief in the chief's Hill frame, m, [N, 3]."""
    return cd2hill(*_orbit(chief), *_orbit(deputy))[0]


def v_DC_Hc(deputy: SatelliteLike, chief: SatelliteLike) -> Tensor:
    """Return the velocity of the deputy relative to the chief as seen in the chief's Hill frame, m/s, [N, 3]."""
    return cd2hill(*_orbit(chief), *_orbit(deputy))[1]


def r_DC_Hd(deputy: SatelliteLike, chief: SatelliteLike) -> Tensor:
    """Return the position of the deputy relative to the chief in the deputy's Hill frame, m, [N, 3]."""
    return -cd2hill(*_orbit(deputy), *_orbit(chief))[0]


def v_DC_Hd(deputy: SatelliteLike, chief: SatelliteLike) -> Tensor:
    """Return the velocity of the deputy relative to the chief as seen in the deputy's Hill frame, m/s, [N, 3]."""
    return -cd2hill(*_orbit(deputy), *_orbit(chief))[1]


def _in_body(body: SatelliteLike, deputy: SatelliteLike, chief: SatelliteLike) -> tuple[Vec3, Vec3]:
    """Return relative position and velocity of the deputy as seen in the axes of a ``body``, one of the two."""
    r_D, v_D, r_C, v_C = states(deputy, chief)
    BN, (omega_BN_B,) = _body(body), vectors(body.dynamics.omega_BN_B)
    r_DC_B = BN @ (r_D - r_C)
    return r_DC_B, BN @ (v_D - v_C) - omega_BN_B.cross(r_DC_B)


def r_DC_C(deputy: SatelliteLike, chief: SatelliteLike) -> Tensor:
    """Return the position of the deputy relative to the chief in the chief's body axes, m, [N, 3]."""
    return _in_body(chief, deputy, chief)[0].stack()


def v_DC_C(deputy: SatelliteLike, chief: SatelliteLike) -> Tensor:
    """Return the velocity of the deputy relative to the chief as seen in the chief's body axes, m/s, [N, 3]."""
    return _in_body(chief, deputy, chief)[1].stack()


def r_DC_D(deputy: SatelliteLike, chief: SatelliteLike) -> Tensor:
    """Return the position of the deputy relative to the chief in the deputy's body axes, m, [N, 3]."""
    return _in_body(deputy, deputy, chief)[0].stack()


def v_DC_D(deputy: SatelliteLike, chief: SatelliteLike) -> Tensor:
    """Return the velocity of the deputy relative to the chief as seen in the deputy's body axes, m/s, [N, 3]."""
    return _in_body(deputy, deputy, chief)[1].stack()


def sigma_DC(deputy: SatelliteLike, chief: SatelliteLike) -> Tensor:
    """Return the attitude of the deputy's body relative to the chief's, the MRP of ``[DN] [CN]^T``, [N, 3]."""
    return dcm_to_mrp(_times(_body(deputy), _body(chief).mT)).stack()


def sigma_DHc(deputy: SatelliteLike, chief: SatelliteLike) -> Tensor:
    """Return the attitude of the deputy's body relative to the chief's Hill frame, the MRP of ``[DN] [HcN]^T``, [N, 3]."""
    return dcm_to_mrp(_times(_body(deputy), _hill(chief).mT)).stack()


def sigma_HdC(deputy: SatelliteLike, chief: SatelliteLike) -> Tensor:
    """Return the attitude of the deputy's Hill frame relative to the chief's body, the MRP of ``[HdN] [CN]^T``, [N, 3]."""
    return dcm_to_mrp(_times(_hill(deputy), _body(chief).mT)).stack()


def sigma_HdHc(deputy: SatelliteLike, chief: SatelliteLike) -> Tensor:
    """Return the attitude of the deputy's Hill frame relative to the chief's, the MRP of ``[HdN] [HcN]^T``, [N, 3]."""
    return dcm_to_mrp(_times(_hill(deputy), _hill(chief).mT)).stack()


def rso_sigma_BH(deputy: SatelliteLike, chief: SatelliteLike) -> Tensor:
    """Return the attitude of the chief's body relative to its own Hill frame, the MRP of ``[CN] [HcN]^T``, [N, 3]."""
    return dcm_to_mrp(_times(_body(chief), _hill(chief).mT)).stack()


def rso_omega_BH(deputy: SatelliteLike, chief: SatelliteLike) -> Tensor:
    """Return the rate of the chief's body relative to its own Hill frame, rad/s in that frame, [N, 3].

    ``omega_BH_H = [HN] [BN]^T omega_BN_B - omega_HN_H`` with ``omega_HN_H = (0, 0, |r x v| / |r|^2)``.
    """
    r_C, v_C = states(chief)
    (omega_BN_B,) = vectors(chief.dynamics.omega_BN_B)
    turning = _hill(chief) @ (_body(chief).mT @ omega_BN_B)
    return Vec3(turning.x, turning.y, turning.z - hill_rate(r_C, v_C)).stack()


def sun_hat_Hc(deputy: SatelliteLike, chief: SatelliteLike) -> Tensor:
    """Return the direction from the Earth to the Sun in the chief's Hill frame, ``[HcN] r_SN / |r_SN|``, [N, 3]."""
    (r_SN_N,) = vectors(deputy.simulator.world.r_SN_N)
    return (_hill(chief) @ r_SN_N.unit()).stack()


def _sun_hill(satellite: SatelliteLike) -> Mat3:
    """Return the DCM [HsN] of the Hill frame of the Earth's motion about the Sun."""
    world = satellite.simulator.world
    r_SN_N, v_SN_N = vectors(world.r_SN_N, world.v_SN_N)
    return hill_frame(-r_SN_N, -v_SN_N)


def r_Hs(deputy: SatelliteLike, chief: SatelliteLike) -> Tensor:
    """Return the chief's position in the Hill frame of the Earth's motion about the Sun, ``[HsN] r_C``, m, [N, 3]."""
    return (_sun_hill(deputy) @ states(chief)[0]).stack()


def h_Hs(deputy: SatelliteLike, chief: SatelliteLike) -> Tensor:
    """Return the chief's angular momentum ``[HsN] (r_C x v_C)``, m^2/s, [N, 3]; for Hs see :func:`r_Hs`."""
    r_C, v_C = states(chief)
    return (_sun_hill(deputy) @ r_C.cross(v_C)).stack()


def eccentricity_Hs(deputy: SatelliteLike, chief: SatelliteLike) -> Tensor:
    """Return the chief's eccentricity vector ``[HsN] (v_C x h_C / mu - r_C / |r_C|)``, [N, 3]; for Hs see :func:`r_Hs`.

    ``mu`` is the Earth's, regardless of the value used by ``sat_args`` to convert elements.
    """
    r_C, v_C = states(chief)
    return (_sun_hill(deputy) @ (v_C.cross(r_C.cross(v_C)) / MU_EARTH - r_C.unit())).stack()


RelativeFunction = Callable[[Any, Any], Any]

FUNCTIONS: dict[str, RelativeFunction] = {
    function.__name__: function
    for function in (
        *(r_DC_N, r_DC_C, r_DC_D, r_DC_Hc, r_DC_Hd, v_DC_N, v_DC_C, v_DC_D, v_DC_Hc, v_DC_Hd),
        *(sigma_DC, sigma_DHc, sigma_HdC, sigma_HdHc, rso_sigma_BH, rso_omega_BH),
        *(sun_hat_Hc, r_Hs, h_Hs, eccentricity_Hs),
    )
}
"""Functions of deputy and chief, the allowed values of ``prop``."""

__all__ = ["FUNCTIONS", "RelativeProperties", *FUNCTIONS]


class RelativeProperties(Observation):
    """Properties of the satellite, the deputy, relative to another one of its episode, the chief.

    Each argument is a dictionary with ``prop`` (name of a function of this module, one of :data:`FUNCTIONS`) or ``fn`` (function
    of deputy and chief that returns [N] or [N, width]), and optionally ``norm`` (divisor; None for 1) and ``name``, which is
    ``prop`` by default, with ``_normd`` where a norm divides. With ``fn``, ``prop`` is just the label.

    The chief may be any satellite, the deputy itself included. Functions see it as
    :class:`~bsk_torch.sats.bound.OtherSatellite`; see :class:`bsk_torch.sats.user_function.UserFunction`.
    """

    def __init__(self, *entries: Mapping[str, object], chief_name: str, name: str = "rel_props") -> None:
        """Observe ``entries``, see the class, of the satellite relative to the one called ``chief_name``."""
        super().__init__(name)
        self.chief_name = text("chief_name", chief_name)
        self.entries = parse_entries(entries, {"prop", "fn", "norm", "name"}, "obs.RelativeProperties")
        for entry in self.entries:
            if "fn" not in entry and entry["prop"] not in FUNCTIONS:
                raise ValueError(f"prop={entry['prop']!r} is not a relative property; {nearest(str(entry['prop']), FUNCTIONS)}")
        self._calls = [entry["fn"] if "fn" in entry else FUNCTIONS[entry["prop"]] for entry in self.entries]

    def link_satellite(self, satellite: BoundSatellite) -> None:
        """See :meth:`Observation.link_satellite`; ValueError for an unknown chief."""
        super().link_satellite(satellite)
        places = satellite.fleet.places
        if self.chief_name not in places:
            raise ValueError(
                f"obs.RelativeProperties: chief_name={self.chief_name!r} is not a satellite of the environment; "
                f"{nearest(self.chief_name, places)}"
            )
        titles = (f"{entry['name']!r} of {self.name!r}" for entry in self.entries)
        self._functions = [None if is_own(c) else UserFunction(t, ADVICE) for c, t in zip(self._calls, titles, strict=True)]

    @property
    def chief(self) -> Any:
        """The chief, aligned with the rows of the satellite."""
        return self.satellite.others[self.chief_name]

    @property
    def functions(self) -> list[UserFunction]:
        """See :attr:`Observation.functions`.

        None if the chief is of the deputy's type: trials simulate one satellite of each type, which would be its own chief and
        cannot test functions of two satellites. These are tried at the first reset.
        """
        if self.satellite.fleet.place_of(self.chief_name)[0] == self.satellite.type_index:
            return []
        return [function for function in self._functions if function is not None]

    def get_obs(self) -> Values:
        """See :meth:`Observation.get_obs`; zeros where the chief is not present."""
        values, chief = {}, self.chief
        for entry, call, function in zip(self.entries, self._calls, self._functions, strict=True):
            value = call(self.satellite, chief) if function is None else self._call(call, chief, function)
            if self.satellite.fleet.varies:
                value = torch.where(chief.present.view(-1, *[1] * (value.ndim - 1)), value, 0.0)
            values[entry["name"]] = scaled(value, entry["norm"])
        return values

    def _call(self, call: RelativeFunction, chief: SatelliteLike, function: UserFunction) -> Tensor:
        return function((len(self.simulator.ticks),), self.simulator.device, lambda: call(self.satellite, chief))
