"""Observations of one satellite relative to another one: the deputy observes the chief."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np
import torch
from typing_extensions import override

from bsk_torch.astro.attitude import dcm_to_mrp
from bsk_torch.bsk_rl.obs.observations import Entry, Observation, checked_entries, name_entry
from bsk_torch.bsk_rl.utils.orbital import rv2omega
from bsk_torch.vec3 import Mat3

if TYPE_CHECKING:
    from bsk_torch.bsk_rl.sats.satellite import Satellite


__all__ = [
    "RelativeProperties",
    "r_DC_C",
    "r_DC_D",
    "r_DC_Hc",
    "r_DC_Hd",
    "r_DC_N",
    "rso_imaged_regions",
    "rso_omega_BH",
    "rso_sigma_BH",
    "sigma_DC",
    "sigma_DHc",
    "sigma_HdC",
    "sigma_HdHc",
    "v_DC_C",
    "v_DC_D",
    "v_DC_Hc",
    "v_DC_Hd",
    "v_DC_N",
]

AXES = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]])
"""Centers of the six regions of a surface that are told apart by default."""


def _mrp(matrix: object) -> np.ndarray:
    return dcm_to_mrp(Mat3.of(torch.as_tensor(np.asarray(matrix, dtype=float)))).stack().numpy()


def _rate_N(satellite: Satellite) -> np.ndarray:
    """Return the rate of the Hill frame, rad/s in N."""
    return rv2omega(satellite.dynamics.r_BN_N, satellite.dynamics.v_BN_N)


def r_DC_N(deputy: Satellite, chief: Satellite) -> np.ndarray:
    """Return the deputy's position relative to the chief, m in N."""
    return np.array(deputy.dynamics.r_BN_N) - np.array(chief.dynamics.r_BN_N)


def v_DC_N(deputy: Satellite, chief: Satellite) -> np.ndarray:
    """Return the deputy's velocity relative to the chief, m/s in N."""
    return np.array(deputy.dynamics.v_BN_N) - np.array(chief.dynamics.v_BN_N)


def r_DC_Hc(deputy: Satellite, chief: Satellite) -> np.ndarray:
    """Return the relative position in the chief's Hill frame, m."""
    return chief.dynamics.HN @ r_DC_N(deputy, chief)


def v_DC_Hc(deputy: Satellite, chief: Satellite) -> np.ndarray:
    """Return the relative velocity as seen from the chief's Hill frame, m/s in that frame."""
    return chief.dynamics.HN @ (v_DC_N(deputy, chief) - np.cross(_rate_N(chief), r_DC_N(deputy, chief)))


def r_DC_Hd(deputy: Satellite, chief: Satellite) -> np.ndarray:
    """Return the relative position in the deputy's Hill frame, m."""
    return deputy.dynamics.HN @ r_DC_N(deputy, chief)


def v_DC_Hd(deputy: Satellite, chief: Satellite) -> np.ndarray:
    """Return the relative velocity as seen from the deputy's Hill frame, m/s in that frame."""
    return deputy.dynamics.HN @ (v_DC_N(deputy, chief) - np.cross(_rate_N(deputy), r_DC_N(deputy, chief)))


def r_DC_C(deputy: Satellite, chief: Satellite) -> np.ndarray:
    """Return the relative position in the chief's body frame, m."""
    return chief.dynamics.BN @ r_DC_N(deputy, chief)


def r_DC_D(deputy: Satellite, chief: Satellite) -> np.ndarray:
    """Return the relative position in the deputy's body frame, m."""
    return deputy.dynamics.BN @ r_DC_N(deputy, chief)


def v_DC_C(deputy: Satellite, chief: Satellite) -> np.ndarray:
    """Return the relative velocity as seen from the chief's body frame, m/s in that frame."""
    velocity_N = v_DC_N(deputy, chief) - np.cross(chief.dynamics.BN.T @ chief.dynamics.omega_BN_B, r_DC_N(deputy, chief))
    return chief.dynamics.BN @ velocity_N


def v_DC_D(deputy: Satellite, chief: Satellite) -> np.ndarray:
    """Return the relative velocity as seen from the deputy's body frame, m/s in that frame."""
    velocity_N = v_DC_N(deputy, chief) - np.cross(deputy.dynamics.BN.T @ deputy.dynamics.omega_BN_B, r_DC_N(deputy, chief))
    return deputy.dynamics.BN @ velocity_N


def sigma_DC(deputy: Satellite, chief: Satellite) -> np.ndarray:
    """Return the attitude of the deputy's body relative to the chief's, an MRP."""
    return _mrp(deputy.dynamics.BN @ chief.dynamics.BN.T)


def sigma_DHc(deputy: Satellite, chief: Satellite) -> np.ndarray:
    """Return the attitude of the deputy's body relative to the chief's Hill frame, an MRP."""
    return _mrp(deputy.dynamics.BN @ chief.dynamics.HN.T)


def sigma_HdC(deputy: Satellite, chief: Satellite) -> np.ndarray:
    """Return the attitude of the deputy's Hill frame relative to the chief's body, an MRP."""
    return _mrp(deputy.dynamics.HN @ chief.dynamics.BN.T)


def sigma_HdHc(deputy: Satellite, chief: Satellite) -> np.ndarray:
    """Return the attitude of the deputy's Hill frame relative to the chief's, an MRP."""
    return _mrp(deputy.dynamics.HN @ chief.dynamics.HN.T)


def rso_sigma_BH(_: object, rso: Satellite) -> np.ndarray:
    """Return the attitude of the chief's body relative to its Hill frame, an MRP."""
    return _mrp(rso.dynamics.BN @ rso.dynamics.HN.T)


def rso_omega_BH(_: object, rso: Satellite) -> np.ndarray:
    """Return the rate of the chief's body relative to its Hill frame, rad/s in that frame."""
    return rso.dynamics.omega_BH_H


def rso_imaged_regions(
    servicer: Satellite,
    chief: Satellite,
    region_centers: Sequence[Sequence[float]] | np.ndarray = AXES,
    frame: str = "chief_hill",
) -> np.ndarray:
    """Return the fraction of the points in each region that has been inspected, [n].

    Args:
        servicer: The inspector.
        chief: The inspected satellite.
        region_centers: Directions of the regions' centers; a point belongs to the nearest one.
        frame: Frame of the centers, ``"chief_hill"`` or ``"chief_body"``.
    """
    if frame not in ("chief_hill", "chief_body"):
        raise ValueError(f"frame={frame!r} must be 'chief_hill' or 'chief_body'")
    status = servicer.data_store.data.point_inspect_status
    imaged, total = np.zeros(len(region_centers)), np.zeros(len(region_centers))
    if not any(status.values()):
        return imaged
    turn = chief.dynamics.BN @ chief.dynamics.HN.T if frame == "chief_hill" else np.eye(3)
    centers = np.asarray(region_centers) @ turn.T
    for point, inspected in status.items():
        nearest = np.argmin(np.linalg.norm(centers - point.r_PB_B, axis=1))
        total[nearest] += 1
        imaged[nearest] += bool(inspected)
    return imaged / np.maximum(total, 1)


PRESETS: dict[str, Callable[[Satellite, Satellite], np.ndarray]] = {
    name: value for name, value in list(globals().items()) if name in __all__ and name != "RelativeProperties"
}
"""Functions of deputy and chief by name."""


class RelativeProperties(Observation):
    """Quantities of the satellite, the deputy, relative to another one, the chief."""

    def __init__(self, *rel_properties: Entry, chief_name: str, name: str = "rel_props") -> None:
        """Observe quantities.

        Args:
            *rel_properties: Dictionaries with ``prop``, the name of a function of this module, or ``fn``, a function of deputy
                and chief; ``norm``, a divisor; and ``name``.
            chief_name: Name of the chief.
            name: Name of the observation.
        """
        super().__init__(name=name)
        checked_entries(rel_properties, ("prop", "norm", "name", "fn"))
        for entry in rel_properties:
            if "fn" not in entry:
                if entry["prop"] not in PRESETS:
                    raise ValueError(
                        f"Property prop={entry['prop']} is not predefined and no `fn` was provided; "
                        f"predefined are {list(PRESETS)}"
                    )
                entry["fn"] = PRESETS[entry["prop"]]
            if "name" not in entry:
                name_entry(entry, entry["prop"])
        self.rel_properties, self.chief_name = rel_properties, chief_name

    def reset_post_sim_init(self) -> None:
        """Find the chief; ValueError if there is none of its name."""
        named = [satellite for satellite in self.satellite.simulator.satellites if satellite.name == self.chief_name]
        if not named:
            raise ValueError(f"Chief satellite {self.chief_name} not found")
        self.chief = named[0]

    @override
    def get_obs(self) -> dict[str, object]:
        observation = {}
        for entry in self.rel_properties:
            value = entry["fn"](self.satellite, self.chief)
            observation[entry["name"]] = (np.array(value) if isinstance(value, list) else value) / entry["norm"]
        return observation
