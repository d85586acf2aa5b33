"""Satellites as targets of others; counterpart of ``bsk_rl.scene.rso_targets``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from bsk_torch.bsk_rl.scene.scenario import Scenario
from bsk_torch.sim.dyn import EclipseDynModel
from bsk_torch.sim.names import nearest
from bsk_torch.tasks.objects import SpaceToSpaceImagingDynModel, SpaceToSpaceImagingFSWModel
from bsk_torch.tasks.objects.catalog import RSOPriorityEvent, RSOTarget, RSOTargetCatalog
from bsk_torch.tasks.objects.scene import partition_name

if TYPE_CHECKING:
    from bsk_torch.bsk_rl.sats.satellite import Satellite


__all__ = ["RSOPriorityEvent", "RSOTarget", "RSOTargetCatalog", "RSOTargets"]


@dataclass
class EpisodeTarget:
    """A target of an episode: its entry in the catalog, the satellite in its place, and its present priority."""

    definition: RSOTarget
    target_spacecraft: Satellite
    priority: float

    @property
    def id(self) -> str:
        """Its id in the catalog."""
        return self.definition.id


def _images(satellite: Satellite) -> bool:
    models = satellite.dyn_type if isinstance(satellite.dyn_type, tuple) else (satellite.dyn_type,)
    return any(isinstance(model, type) and issubclass(model, SpaceToSpaceImagingDynModel) for model in models)


class RSOTargets(Scenario):
    """Satellites of the environment as targets of a catalog, which imagers image; see :class:`~bsk_torch.bsk_rl.act.ImageRSO`.

    At a reset, the satellite of each target gets the initial state and the parameters of the catalog, and the store of each
    imager a partition for every target.

    Attributes:
        targets_by_id: Targets of the episode by id.
        imagers: Imagers of the episode.
        pending: Ids of the images of each target that wait for their downlink.
        cooldown_until: Time at which targets have cooled down, s, by id.
        applied_events: Numbers of the changes of priorities that have been made, and when, s.
        revision: Number of changes of what imagers may choose.
    """

    def __init__(self, catalog: RSOTargetCatalog, imager_names: Sequence[str], *, block_pending_targets: bool = True) -> None:
        """ValueError for a wrong argument.

        Args:
            catalog: The targets.
            imager_names: Names of the satellites that image them.
            block_pending_targets: Whether a target with images that have not been downlinked cannot be chosen.
        """
        self.catalog, self.imager_names, self.block_pending_targets = catalog, tuple(imager_names), block_pending_targets
        wrong = [name for name in self.imager_names if not isinstance(name, str) or not name]
        if wrong or not self.imager_names or len(set(self.imager_names)) < len(self.imager_names):
            raise ValueError(f"imager_names={list(self.imager_names)} must be unique names of satellites")
        if both := sorted(set(self.imager_names) & {target.satellite_name for target in catalog.targets}):
            raise ValueError(f"{both} are both imagers and targets; a satellite is one of them")
        self.reset_overwrite_previous()

    @property
    def catalog(self) -> RSOTargetCatalog:
        """The catalog; in an episode with its epoch, to be saved."""
        return self._given if self._current is None else self._current

    @catalog.setter
    def catalog(self, value: RSOTargetCatalog) -> None:
        """Set the catalog of later episodes."""
        self._given: RSOTargetCatalog = value
        self._current: RSOTargetCatalog | None = None

    @staticmethod
    def partition_name(target_id: str) -> str:
        """Return the name of the partition of the store for images of a target."""
        return partition_name(target_id)

    def validate_satellite_names(self, satellites: list[Satellite]) -> None:
        """Raise ValueError for repeated names of satellites, imagers and targets that no satellite is, and other imagers."""
        names = [satellite.name for satellite in satellites]
        if twice := sorted({name for name in names if names.count(name) > 1}):
            raise ValueError(f"satellites has several called {twice}; RSOTargets needs unique names")
        for name in (*self.imager_names, *(target.satellite_name for target in self.catalog.targets)):
            if name not in names:
                raise ValueError(f"RSOTargets needs a satellite called {name!r}; {nearest(name, names)}")
        able = [satellite.name for satellite in satellites if _images(satellite)]
        if unlisted := [name for name in able if name not in self.imager_names]:
            raise ValueError(
                f"satellites {unlisted} have SpaceToSpaceImagingDynModel, but are not among the imager_names of RSOTargets"
            )

    def link_satellites(self, satellites: list[Satellite]) -> None:
        """See :meth:`Scenario.link_satellites`; ValueError unless imagers and targets are among them."""
        self.validate_satellite_names(satellites)
        super().link_satellites(satellites)

    def reset_overwrite_previous(self) -> None:
        """Forget the last episode."""
        self._current = None
        self.targets_by_id: dict[str, EpisodeTarget] = {}
        self.imagers: list[Any] = []
        self.pending: dict[str, set[str]] = {}
        self.cooldown_until: dict[str, float] = {}
        self.applied_events: list[tuple[int, float]] = []
        self.revision = 0

    def reset_pre_sim_init(self) -> None:
        """Give targets and imagers their arguments; ValueError for another epoch or for satellites of other models."""
        epoch, catalog = self.utc_init, self._given
        if catalog.utc_init not in (None, epoch):
            raise ValueError(
                f"the catalog has utc_init={catalog.utc_init!r}, the world {epoch!r}; give world_args={{'utc_init': "
                f"{catalog.utc_init!r}}}, or a catalog with utc_init=None"
            )
        self._current = catalog if catalog.utc_init is not None else replace(catalog, utc_init=epoch)
        satellites = {satellite.name: satellite for satellite in self.satellites}
        for target in catalog.targets:
            satellite = satellites[target.satellite_name]
            if not issubclass(satellite.dyn_type, EclipseDynModel):
                raise ValueError(f"target {satellite.name} needs dyn.RSOTargetDynModel, or another dyn.EclipseDynModel")
            satellite.sat_args.update(target.sat_args())
            self.targets_by_id[target.id] = EpisodeTarget(target, satellite, target.priority)
        partitions = [self.partition_name(target.id) for target in catalog.targets]
        self.imagers = [satellites[name] for name in self.imager_names]
        for imager in self.imagers:
            models = (imager.dyn_type, SpaceToSpaceImagingDynModel), (imager.fsw_type, SpaceToSpaceImagingFSWModel)
            for model, needed in models:
                if not issubclass(model, needed):
                    raise ValueError(f"imager {imager.name} has {model.__name__}; it needs {needed.__name__}")
            imager.sat_args.update(bufferNames=partitions, transmitterNumBuffers=len(partitions))
            imager.rso_scenario, imager._rso_candidate_snapshot = self, None
        self.after_step(0.0)

    def reset_during_sim_init(self) -> None:
        """Let each imager know all targets."""
        for imager in self.imagers:
            for target in self.targets_by_id.values():
                imager.dynamics.bind_rso_target(target)

    def is_eligible(self, target_id: str, time_s: float) -> bool:
        """Return whether a target can be chosen at a time, s: it has cooled down, and no image of it waits for its downlink."""
        waits = self.block_pending_targets and bool(self.pending.get(target_id))
        return not waits and time_s >= self.cooldown_until.get(target_id, -np.inf)

    def after_step(self, sim_time: float) -> None:
        """See :meth:`Scenario.after_step`; make the changes of priorities that are due."""
        applied = {number for number, _ in self.applied_events}
        for number, event in enumerate(self.catalog.priority_events):
            if number in applied or event.time_s > sim_time:
                continue
            for target_id, priority in event.priorities:
                self.targets_by_id[target_id].priority = priority
            self.applied_events.append((number, float(sim_time)))
            self.revision += 1
