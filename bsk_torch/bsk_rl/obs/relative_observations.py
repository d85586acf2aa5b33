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


AXES = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]])
"""Centers of the six regions of a surface that are told apart by default."""


def _mrp(matrix: object) -> np.ndarray:
    return dcm_to_mrp(Mat3.of(torch.as_tensor(np.asarray(matrix, dtype=float)))).stack().numpy()


CHIEF, DEPUTY = 1, 0
"""Places of the satellites in the calls of the functions here, ``(deputy, chief)``."""

Relative = Callable[["Satellite", "Satellite"], np.ndarray]
"""A function of deputy and chief."""


def r_DC_N(deputy: Satellite, chief: Satellite) -> np.ndarray:
    """Return the deputy's position relative to the chief, m in N."""
    return np.array(deputy.dynamics.r_BN_N) - np.array(chief.dynamics.r_BN_N)


def v_DC_N(deputy: Satellite, chief: Satellite) -> np.ndarray:
    """Return the deputy's velocity relative to the chief, m/s in N."""
    return np.array(deputy.dynamics.v_BN_N) - np.array(chief.dynamics.v_BN_N)


def _seen_from(owner: int, axes: str) -> tuple[Relative, Relative]:
    """Return the relative position, m, and the relative velocity as seen from a frame, m/s, in that frame of a satellite."""

    def position(*pair: Satellite) -> np.ndarray:
        return getattr(pair[owner].dynamics, axes) @ r_DC_N(*pair)

    def velocity(*pair: Satellite) -> np.ndarray:
        model = pair[owner].dynamics
        rate_N = rv2omega(model.r_BN_N, model.v_BN_N) if axes == "HN" else model.BN.T @ model.omega_BN_B
        return getattr(model, axes) @ (v_DC_N(*pair) - np.cross(rate_N, r_DC_N(*pair)))

    return position, velocity


def _attitude(owner: int, axes: str, other: int, other_axes: str) -> Relative:
    """Return the attitude of a frame of a satellite relative to another frame, an MRP."""

    def attitude(*pair: Satellite) -> np.ndarray:
        return _mrp(getattr(pair[owner].dynamics, axes) @ getattr(pair[other].dynamics, other_axes).T)

    return attitude


# in Hill frames Hc and Hd, and in the bodies C and D, of chief and deputy
r_DC_Hc, v_DC_Hc = _seen_from(CHIEF, "HN")
r_DC_Hd, v_DC_Hd = _seen_from(DEPUTY, "HN")
r_DC_C, v_DC_C = _seen_from(CHIEF, "BN")
r_DC_D, v_DC_D = _seen_from(DEPUTY, "BN")
sigma_DC = _attitude(DEPUTY, "BN", CHIEF, "BN")
sigma_DHc = _attitude(DEPUTY, "BN", CHIEF, "HN")
sigma_HdC = _attitude(DEPUTY, "HN", CHIEF, "BN")
sigma_HdHc = _attitude(DEPUTY, "HN", CHIEF, "HN")
rso_sigma_BH = _attitude(CHIEF, "BN", CHIEF, "HN")


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


PRESETS: dict[str, Relative] = {
    name: value for name, value in list(globals().items()) if name.startswith(("r_DC_", "v_DC_", "sigma_", "rso_"))
}
"""Functions of deputy and chief by name."""

__all__ = ["RelativeProperties", *PRESETS]


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
        self.chief = self.satellite.simulator.get_satellite(self.chief_name)

    @override
    def get_obs(self) -> dict[str, object]:
        observation = {}
        for entry in self.rel_properties:
            value = entry["fn"](self.satellite, self.chief)
            observation[entry["name"]] = (np.array(value) if isinstance(value, list) else value) / entry["norm"]
        return observation
