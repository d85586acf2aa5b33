"""Resident space objects (RSO) of a catalog as targets of imagers."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Hashable, Sequence
from dataclasses import replace
from datetime import datetime, timedelta
from typing import Any

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch._checks import function, switch, text
from bsk_torch.astro.eclipse import illumination
from bsk_torch.astro.ephemeris import parse_utc
from bsk_torch.astro.sight import line_clearance, stretch
from bsk_torch.rand import MONTHS, Key, PerEnv
from bsk_torch.sats.bound import BoundSatellite, SatelliteFleet
from bsk_torch.sats.satellite import Satellite
from bsk_torch.scene.base import Memo, Scenario, Value
from bsk_torch.scene.recorded import RecordedTargets
from bsk_torch.sim.dyn.hub import initial_orbit
from bsk_torch.sim.hooks import check_tensor
from bsk_torch.sim.names import nearest, one_of
from bsk_torch.sim.orbit.flights import make_flights
from bsk_torch.sim.state import FINITE
from bsk_torch.tasks.objects.aim import AIM, NO_AIM, AimedNodes
from bsk_torch.tasks.objects.candidates import Candidates, Moment, Views, in_order, ranked, views
from bsk_torch.tasks.objects.catalog import RandomRSOCatalog, RSOTarget, RSOTargetCatalog
from bsk_torch.tasks.objects.dyn import RSO_TRACK, SpaceToSpaceImagingDynModel
from bsk_torch.tasks.objects.fsw import SpaceToSpaceImagingFSWModel
from bsk_torch.tasks.objects.orbits import CatalogOrbits
from bsk_torch.tasks.objects.outlook import Outlook, elevation, image_end
from bsk_torch.tasks.objects.records import RecordBook
from bsk_torch.vec3 import Vec3

POSITIONS, VELOCITIES, PRIORITIES = "rso_r_N", "rso_v_N", "rso_priority"
"""Names of the drawn states of targets, m and m/s in N, and of their priorities."""

PENDING, COOLDOWN = "rso_pending", "rso_cooldown"
"""Names of what rewarders keep of targets: number of images that have not been downlinked, and until when they cool down, s."""


OWN_PENDING = "rso_own_pending"
"""Name of the number of images of each target that wait on board of each imager."""

KNOWLEDGE = ("common", "own")
"""What candidates follow from: all images, or those of which an imager knows."""

PREFIX = "rso_"
"""Beginning of the names of partitions."""


def partition_name(target_id: str) -> str:
    """Return the name of the partition of the store for images of a target."""
    return PREFIX + hashlib.sha256(target_id.encode()).hexdigest()[:32]


Order = Callable[["RSOTargets", BoundSatellite], Tensor]
"""Ranks all targets for each satellite of a type, [n, G]."""


class RSOTargets(Scenario):
    """Targets on orbits of a catalog, which named satellites image.

    Targets have neither attitude nor tick, and take no place among the satellites. They fly in the force field of satellites
    whose orbits are solved in advance, without drag. Imagers have
    :class:`~bsk_torch.tasks.objects.SpaceToSpaceImagingDynModel`, :class:`~bsk_torch.tasks.objects.SpaceToSpaceImagingFSWModel`
    and :class:`~bsk_torch.tasks.objects.ImageRSO`; the store of each gets a partition for every target.

    A target is *eligible* unless images of it wait for their downlink (with ``block_pending_targets``), and once it has cooled
    down; see :class:`~bsk_torch.tasks.objects.RSOImageReward`. The *candidates* of an imager are the eligible targets, first
    those with an elevation from -21 to 90 degrees above its horizontal, in ascending order, then the others by their distance;
    or in another order that you give.

    With ``knowledge="own"``, candidates of an imager follow from what it knows. A target is eligible for it unless an image of
    it waits on its board, or it knows of a capture of sufficient quality that is younger than the cooldown. It knows its
    captures, and those of which others have told it; see :class:`~bsk_torch.tasks.objects.RSOTeamReward`, which keeps the
    records. An imager that learns of such a capture of the target that it is imaging requires another task.

    N is the number of episodes, G that of targets, A that of imagers in the order of ``imager_columns``.

    Attributes:
        ids: Ids of the targets.
        records: Records of captures and who knows them, with ``knowledge="own"``, once an environment has been built.
        imager_types: Indices of the types of satellites with imagers, once an environment has been built.
        imager_columns: Indices of the imagers among the satellites of an episode, [A], likewise.
        peers: Numbers of the other imagers of each imager, sorted by their names, [1, A, A - 1], with ``knowledge="own"``.
    """

    imager_types: tuple[int, ...]
    imager_columns: list[int]
    records: RecordBook
    peers: Tensor
    _service: float | None = None
    _keeps_records = False
    _link_needs_super = True

    def __init__(
        self,
        catalog: RSOTargetCatalog | RandomRSOCatalog | PerEnv,
        imager_names: Sequence[str],
        *,
        block_pending_targets: bool = True,
        knowledge: str = "common",
        order: Order | None = None,
    ) -> None:
        """Choose targets and imagers; ValueError for a wrong argument.

        Args:
            catalog: Targets of all episodes, random ones, or ``rand.per_env`` of catalogs with equal ids and equal changes of
                priorities, one for each environment.
            imager_names: Names of the satellites that image.
            block_pending_targets: Whether a target with images that have not been downlinked cannot be chosen.
            knowledge: ``"common"`` if candidates follow from all images at once, ``"own"`` if those of each imager follow from
                what it knows.
            order: Function of this scenario and a type of satellites that ranks all targets for each of them, [n, G]: candidates
                are in ascending order of their ranks, such as :func:`~bsk_torch.tasks.objects.by_priority_per_second` (default:
                by their elevation, see above). Targets of infinite rank are no candidates.
        """
        catalogs: list[Any] = list(catalog.values) if isinstance(catalog, PerEnv) else [catalog]
        kinds = (RSOTargetCatalog,) if isinstance(catalog, PerEnv) else (RSOTargetCatalog, RandomRSOCatalog)
        if not catalogs or not all(isinstance(part, kinds) for part in catalogs):
            raise ValueError(f"catalog={catalog!r} must be an RSOTargetCatalog, a RandomRSOCatalog, or rand.per_env of catalogs")
        first = catalogs[0]
        for part in catalogs[1:]:
            if part.ids != first.ids or part.priority_events != first.priority_events:
                raise ValueError("rand.per_env: all catalogs must have the same ids in the same order, and equal priority_events")
        self.catalogs, self.ids = tuple(catalogs), first.ids
        self.per_env = isinstance(catalog, PerEnv)
        if isinstance(imager_names, str) or not isinstance(imager_names, Sequence) or not imager_names:
            raise ValueError(f"imager_names={imager_names!r} must be a list of names of satellites")
        self.imager_names = tuple(text("imager_names", name) for name in imager_names)
        if len(set(self.imager_names)) < len(self.imager_names):
            raise ValueError(f"imager_names={list(self.imager_names)} must be unique")
        self.block_pending_targets = switch("block_pending_targets", block_pending_targets)
        self.knowledge = one_of("knowledge", knowledge, KNOWLEDGE)
        self.order = None if order is None else function("order", order, "scenario and satellite")
        self._events = _event_table(first)

    # -- draws --------------------------------------------------------------------------------------------------------

    @property
    @override
    def calls_user(self) -> bool:
        return isinstance(self.catalogs[0], RandomRSOCatalog) and self.catalogs[0].calls_user

    def draw(self, key: Key) -> dict[str, Tensor]:
        """See :meth:`Scenario.draw`; states and priorities of the targets."""
        first = self.catalogs[0]
        if isinstance(first, RandomRSOCatalog):
            values: tuple[Tensor, ...] = first.draw(key)
        else:
            stacked = [torch.stack(part) for part in zip(*(part.tables() for part in self.catalogs), strict=True)]
            values = tuple(torch.as_tensor(PerEnv(part).draw(key)) if self.per_env else part for part in stacked)
        return dict(zip((POSITIONS, VELOCITIES, PRIORITIES), values, strict=True))

    @override
    def _bounds(self) -> dict[str, tuple[float, float]]:
        return {POSITIONS: (-1e9, 1e9), VELOCITIES: (-1e6, 1e6), PRIORITIES: (0.0, FINITE)}

    @property
    def n_targets(self) -> int:
        """Number of targets G."""
        return len(self.ids)

    def catalog_of(self, env: int) -> RSOTargetCatalog:
        """Return the catalog of the current episode of environment ``env``, with its epoch, to be saved."""
        r_N, v_N, priority = (self.drawn(name)[env].tolist() for name in (POSITIONS, VELOCITIES, PRIORITIES))
        first = self.catalogs[int(self.fleet.env_ids[env])] if self.per_env else self.catalogs[0]
        utc_init = epoch_text(self._et[env].item())
        if isinstance(first, RSOTargetCatalog):
            return first if first.utc_init is not None else replace(first, utc_init=utc_init)
        rows = zip(self.ids, r_N, v_N, priority, strict=True)
        targets = tuple(RSOTarget(key, key.replace("-", "_"), r, v, weight) for key, r, v, weight in rows)
        return RSOTargetCatalog(targets, utc_init, first.priority_events)

    # -- satellites ---------------------------------------------------------------------------------------------------

    @override
    def _own_arguments(self, satellite: Satellite) -> dict[str, object]:
        if satellite.name not in self.imager_names:
            return {}
        return {"bufferNames": [partition_name(key) for key in self.ids], "transmitterNumBuffers": self.n_targets}

    @override
    def validate_satellite_names(self, satellites: Sequence[Satellite]) -> None:
        by_name = {satellite.name: satellite for satellite in satellites}
        for name in self.imager_names:
            if name not in by_name:
                raise ValueError(
                    f"imager_names has {name!r}, but no satellite of the environment is called that; {nearest(name, by_name)}"
                )
            kinds = by_name[name].get_dyn_type(), by_name[name].get_fsw_type()
            if not (issubclass(kinds[0], SpaceToSpaceImagingDynModel) and issubclass(kinds[1], SpaceToSpaceImagingFSWModel)):
                raise ValueError(
                    f"imager {name!r} must have SpaceToSpaceImagingDynModel and SpaceToSpaceImagingFSWModel; it has "
                    f"{kinds[0].__name__} and {kinds[1].__name__}"
                )
        imagers = [s.name for s in satellites if issubclass(s.get_dyn_type(), SpaceToSpaceImagingDynModel)]
        if left_out := [name for name in imagers if name not in self.imager_names]:
            raise ValueError(f"satellites {left_out} have SpaceToSpaceImagingDynModel, but are not among imager_names")
        names = {target.satellite_name for part in self.catalogs if isinstance(part, RSOTargetCatalog) for target in part.targets}
        if both := sorted(names & set(by_name)):
            raise ValueError(
                f"satellites {both} have the names of targets of the catalog, which fly without satellites; leave them out"
            )

    def link(self, fleet: SatelliteFleet) -> None:
        """See :meth:`Scenario.link`; ValueError if only some satellites of a type are imagers."""
        super().link(fleet)
        of_imagers = {fleet.place_of(name)[0] for name in self.imager_names if name in fleet.places}
        self.imager_types = tuple(sorted(of_imagers))
        self.imager_columns = [column for k in self.imager_types for column in fleet.columns[k].tolist()]
        first = fleet.simulators[0]
        solver = make_flights(first.h, first.type.options.backend, fleet.device, first.type.gravity_degree)
        followed = len(self.imager_columns) if self.knowledge == "own" else 0
        self.orbits = CatalogOrbits(fleet.num_envs, self.n_targets + followed, solver, lambda envs: self._et[envs], self._states)
        fleet.memory.add("rso_orbits", self.orbits)
        self.memory.declare(PENDING, 0, self.n_targets, low=0)
        self.memory.declare(COOLDOWN, 0.0, self.n_targets, low=-FINITE, high=FINITE)
        numbers = [len(fleet.columns[k]) for k in self.imager_types]
        missing = len(self.imager_names) - len(self.imager_columns)  # on a trial, where there is one satellite of each type
        self._padded_columns = self.imager_columns + self.imager_columns[:1] * missing
        self._first_imager = {k: sum(numbers[:n]) for n, k in enumerate(self.imager_types)}
        if self.knowledge == "own":
            self.records = RecordBook(fleet.num_envs, len(self.imager_names), self.n_targets, fleet.device)
            fleet.memory.add("rso_records", self.records)
            self.peers = sorted_peers([fleet.names[column] for column in self._padded_columns]).to(fleet.device)
            self.memory.declare(OWN_PENDING, 0, len(self.imager_names), self.n_targets, low=0)
        for k in self.imager_types:
            simulator = fleet.simulators[k]
            simulator.memory.declare(AIM, NO_AIM, low=NO_AIM, high=self.n_targets - 1)
            simulator.sources[RSO_TRACK.name] = AimedNodes(simulator, self.orbits)
        self._catalog_epochs = _epochs(self.catalogs)
        self._memo = Memo()

    @property
    def _et(self) -> Tensor:
        """ET at time zero, [N] s."""
        first = self.fleet.simulators[0]
        return self.fleet.first_of_each(first.state.arguments["utc_init"], first.count)

    def _states(self, envs: Tensor) -> tuple[Tensor, Tensor]:
        """Return the states of the targets of episodes ``envs`` [n] at time zero; ValueError if the catalog has another epoch."""
        if self._catalog_epochs is not None:
            et, index = self._et[envs], self.fleet.env_ids[envs] if self.per_env else torch.zeros_like(envs)
            expected = self._catalog_epochs.to(et.device)[index]
            wrong = torch.nonzero(~torch.isnan(expected) & (expected != et)).flatten()
            if len(wrong):
                env, name = int(envs[wrong[0]]), self.catalogs[int(index[wrong[0]])].utc_init
                raise ValueError(
                    f"the catalog of environment {env} has utc_init={name!r}, but its world has another epoch; give "
                    f"world_args={{'utc_init': {name!r}}}, or a catalog with utc_init=None"
                )
        targets = self.drawn(POSITIONS)[envs], self.drawn(VELOCITIES)[envs]
        if self.knowledge != "own":
            return targets
        starts = [self._initial_orbits(k) for k in self.imager_types]
        imagers = (torch.cat(parts, 1)[envs] for parts in zip(*starts, strict=True))
        r_N, v_N = (torch.cat(pair, 1) for pair in zip(targets, imagers, strict=True))
        return r_N, v_N

    def _initial_orbits(self, k: int) -> tuple[Tensor, Tensor]:
        """Return positions, m, and velocities, m/s, at time zero of the imagers of a type, [N, count, 3] each."""
        simulator = self.fleet.simulators[k]
        orbit = initial_orbit(simulator.state.all_arguments)
        r_N, v_N = (part.expand(simulator.state.rows, 3).view(-1, simulator.count, 3) for part in orbit)
        return r_N, v_N

    # -- targets ------------------------------------------------------------------------------------------------------

    def priority_at(self, time: Tensor) -> Tensor:
        """Return the priorities of the targets, [N, G], with the changes at or before ``time`` [N] s."""
        drawn = self.drawn(PRIORITIES)
        if self._events is None:
            return drawn
        times, table = (part.to(time.device) for part in self._events)
        changed = table[torch.searchsorted(times, time, right=True)]
        return torch.where(torch.isnan(changed), drawn, changed)

    @property
    def priority(self) -> Tensor:
        """Current priorities of the targets, [N, G]."""
        return self.priority_at(self.fleet.sim_time)

    @property
    def pending(self) -> Tensor:
        """Images of each target that wait for their downlink, [N, G]."""
        return self.memory[PENDING]

    @property
    def cooldown_until(self) -> Tensor:
        """Time at which each target has cooled down, [N, G] s."""
        return self.memory[COOLDOWN]

    @property
    def eligible(self) -> Tensor:
        """Targets that can be chosen, [N, G]; by imager with ``knowledge="own"``, [N, A, G]."""
        if self.knowledge == "own":
            free = ~self.satisfied
            return free & (self.memory[OWN_PENDING] == 0) if self.block_pending_targets else free
        ready = self.fleet.sim_time.unsqueeze(1) >= self.cooldown_until
        return ready & (self.pending == 0) if self.block_pending_targets else ready

    def eligible_for(self, satellite: BoundSatellite) -> Tensor:
        """Return the targets that each satellite of a type can choose, [n, G]."""
        return self.of_imagers(satellite, self.eligible) if self.knowledge == "own" else satellite.of_env(self.eligible)

    def of_imagers(self, satellite: BoundSatellite, table: Tensor) -> Tensor:
        """Return the rows [n, ...] of the satellites of a type from a table by imager, [N, A, ...]."""
        first = self._first_imager[satellite.type_index]
        return table[:, first : first + satellite.simulator.count].flatten(0, 1)

    # -- knowledge ----------------------------------------------------------------------------------------------------

    def keep_records(self, cooldown_s: float | None) -> None:
        """Tell that a rewarder adds to the records, and the cooldown of ``service_time``; ValueError for common knowledge."""
        if self.knowledge != "own":
            raise ValueError(f"RSOTargets has knowledge={self.knowledge!r}; records of what imagers know need 'own'")
        self._keeps_records, self._service = True, cooldown_s

    @property
    def service_time(self) -> Tensor:
        """Time after a capture in which no other is wanted, [N] s; twice the median orbital period of imagers unless given."""
        if self._service is not None:
            return torch.full_like(self.fleet.sim_time, self._service)
        return 2.0 * self.median_period

    @property
    def median_period(self) -> Tensor:
        """Median of the orbital periods of the imagers at the beginning of their episodes, [N] s."""
        return self._once(("period",), self._median_period)

    def _median_period(self) -> Tensor:
        periods = []
        for k in self.imager_types:
            r_N, v_N = self._initial_orbits(k)
            mu = self.fleet.simulators[k].state.argument("mu").view(r_N.shape[:2])
            a = 1.0 / (2.0 / r_N.norm(dim=-1) - (v_N * v_N).sum(-1) / mu)
            periods.append(2.0 * math.pi * torch.sqrt(a**3 / mu))
        return torch.cat(periods, 1).quantile(0.5, dim=1)

    @property
    def known_records(self) -> RecordBook:
        """Records of captures; ValueError with common knowledge."""
        if self.knowledge != "own":
            raise ValueError("what imagers know of images needs RSOTargets with knowledge='own'")
        return self.records

    def each_imager(self, read: Callable[[BoundSatellite], Tensor]) -> Tensor:
        """Return what ``read`` returns, [n, ...] for the satellites of a type, for all imagers, [N, A, ...]."""
        return self.fleet.each(read)[:, self._padded_columns]

    def imager_states(self) -> tuple[Tensor, Tensor]:
        """Return positions, m, and velocities, m/s, of all imagers in N, [N, A, 3] each."""
        r_N = self.each_imager(lambda satellite: satellite.dynamics.r_BN_N)
        return r_N, self.each_imager(lambda satellite: satellite.dynamics.v_BN_N)

    @property
    def linked(self) -> Tensor:
        """Whether the segment between two imagers does not touch a sphere of the Earth's equatorial radius, [N, A, A]."""
        r_N, _ = self.imager_states()
        first, second = (Vec3(*part.movedim(-1, 0)) for part in (r_N.unsqueeze(1), r_N.unsqueeze(2)))
        return line_clearance(first, second) > 0.0

    @property
    def imagers_alive(self) -> Tensor:
        """Imagers that had not died when the last step ended, [N, A]."""
        return ~self.each_imager(lambda satellite: satellite.task.dead)

    def by_imager(self, satellite: BoundSatellite, rows: Tensor, missing: float | bool) -> Tensor:
        """Return a table by imager, [N, A, ...], of rows [n, ...] of one type, with ``missing`` for all other imagers."""
        first, count = self._first_imager[satellite.type_index], satellite.simulator.count
        table = rows.new_full((self.fleet.num_envs, len(self.imager_names), *rows.shape[1:]), missing)
        table[:, first : first + count] = rows.view(-1, count, *rows.shape[1:])
        return table

    @property
    def satisfied(self) -> Tensor:
        """Targets of which each imager knows a capture that is younger than ``service_time``, [N, A, G].

        RuntimeError unless a rewarder keeps records.
        """
        if not self._keeps_records:
            raise RuntimeError("RSOTargets with knowledge='own' needs a rewarder that keeps records of images: RSOTeamReward")
        return self._once(("satisfied",), lambda: self.records.satisfied(self.fleet.sim_time, self.service_time))

    @property
    def r_TN_N(self) -> Tensor:
        """Positions of the targets, [N, G, 3] m in N."""
        return self._positions().movedim(0, -1)

    def _positions(self) -> Tensor:
        def find() -> Tensor:
            self.orbits.catch_up(self.fleet.sim_time)
            return self.orbits.positions(self.fleet.sim_time)[..., : self.n_targets]

        return self._once(("positions",), find)

    def _once(self, name: Hashable, find: Callable[[], Value]) -> Value:
        """Return what ``find`` returns, which is valid until the state changes."""
        return self._memo.once(name, self.fleet, find, (self.records.version,) if self.knowledge == "own" else ())

    # -- candidates ---------------------------------------------------------------------------------------------------

    def candidates(self, satellite: BoundSatellite, count: int) -> Candidates:
        """Return the first ``count`` candidates of each satellite of a type, [n, count]."""

        def find() -> Candidates:
            eligible = self.eligible_for(satellite)
            if self.order is None:
                r_TN_N = self._positions().repeat_interleave(satellite.simulator.count, 1)
                return in_order(r_TN_N, satellite.dynamics.r_BN_N, eligible)
            rank = self.order(self, satellite)
            check_tensor("order(scenario, satellite)", rank, eligible.shape, torch.float64)
            if bool(rank.isnan().any()):
                raise ValueError(f"order(scenario, satellite) is NaN for some target of {satellite.name}; ranks must be numbers")
            return ranked(rank, eligible)

        candidates = self._once(("candidates", satellite.type_index), find)
        missing = count - self.n_targets
        if missing <= 0:
            return Candidates(candidates.place[:, :count], candidates.exists[:, :count])
        return Candidates(*(torch.nn.functional.pad(part, (0, missing)) for part in candidates))

    def all_targets(self, satellite: BoundSatellite) -> Candidates:
        """Return all targets for each satellite of a type, in their order and whether they are candidates or not, [n, G]."""
        place = torch.arange(self.n_targets, device=self.fleet.device).expand(satellite.simulator.state.rows, -1)
        return Candidates(place, torch.ones_like(place, dtype=torch.bool))

    def views(self, satellite: BoundSatellite, candidates: Candidates) -> Views:
        """Return what satellites of a type see of their candidates, [n, k, ...] each."""
        return views(*self._states_of(satellite, candidates), self._moment(satellite))

    def outlook(self, satellite: BoundSatellite, candidates: Candidates) -> Outlook:
        """Return what satellites of a type can expect of images of their candidates that they begin now, [n, k] each."""
        self._positions()  # which catch up
        r_TN_N, v_TN_N = self.orbits.motion(self._envs(satellite), candidates.place, self.fleet.sim_time)
        at = self._moment(satellite)
        end = image_end(r_TN_N, v_TN_N, at)
        light = illumination(end.r_TN_N, Vec3.of(at.r_SN_N.unsqueeze(1)))
        clear = candidates.exists & self._clear(satellite, end.r_TN_N, end.r_BN_N)
        return Outlook(end.duration, elevation(end.r_TN_N, end.r_BN_N), light, clear.double())

    def _states_of(self, satellite: BoundSatellite, candidates: Candidates) -> tuple[Tensor, Tensor, Tensor]:
        """Return the states of the candidates of each satellite of a type, now and one tick ago."""
        now = self.fleet.sim_time
        self._positions()  # which catch up
        return self.orbits.states(self._envs(satellite), candidates.place, now, (now - self.fleet.h).clamp(min=0.0))

    @staticmethod
    def _envs(satellite: BoundSatellite) -> Tensor:
        return satellite.simulator.state.all_rows // satellite.simulator.count

    def _moment(self, satellite: BoundSatellite) -> Moment:
        dynamics = satellite.dynamics
        return Moment(dynamics.r_BN_N, dynamics.v_BN_N, self.axis_N(satellite), satellite.simulator.world.r_SN_N)

    def axis_N(self, satellite: BoundSatellite) -> Tensor:
        """Return the axis of the instrument of each satellite of a type, a unit vector in N, [n, 3]."""
        axis_B = satellite.sat_args["inst_pHat_B"]
        return (satellite.dynamics.BN.mT @ (axis_B / axis_B.norm(dim=-1, keepdim=True)).unsqueeze(-1)).squeeze(-1)

    def in_sight(self, satellite: BoundSatellite, candidates: Candidates) -> Tensor:
        """Return whether satellites of a type see their candidates past the Earth and within their range, [n, k].

        This is the condition of :func:`bsk_torch.tasks.objects.dyn.see_rso` at a decision; light and pointing do not matter.
        """
        place = candidates.place.unsqueeze(-1).expand(-1, -1, 3)
        r_TN_N = satellite.of_env(self.r_TN_N).gather(1, place)
        return candidates.exists & self._clear(satellite, Vec3.of(r_TN_N), Vec3.of(satellite.dynamics.r_BN_N.unsqueeze(1)))

    @staticmethod
    def _clear(satellite: BoundSatellite, r_TN_N: Vec3, r_BN_N: Vec3) -> Tensor:
        """Return whether objects are in sight of satellites of a type, and in range, at positions [n, k] m; [n, k]."""
        pole_N = Vec3.of(satellite.simulator.world.PN[:, 2].unsqueeze(1))
        clear = line_clearance(stretch(r_TN_N, pole_N), stretch(r_BN_N, pole_N)) > 0.0
        reach = satellite.sat_args["imageTargetMaximumRange"].view(-1, 1)
        return clear & ((reach < 0.0) | ((r_TN_N - r_BN_N).norm() <= reach))

    @override
    def recorded_targets(self, env: int) -> RecordedTargets:
        self._positions()  # which catch up
        envs, place = (
            torch.arange(first, last, device=self.fleet.device) for first, last in ((env, env + 1), (0, self.n_targets))
        )
        r_N, v_N = (part.stack()[0].cpu() for part in self.orbits.motion(envs, place.unsqueeze(0), self.fleet.sim_time))
        return RecordedTargets(
            places="orbit",
            r=r_N,
            priority=self.priority[env].cpu(),
            v_N=v_N,
            names=self.ids,
            viewers=self.imager_columns,
        )

    @override
    def sees(self, satellite: BoundSatellite, target: Tensor) -> Tensor:
        if satellite.type_index not in self.imager_types:
            return torch.zeros_like(target, dtype=torch.bool)
        place = target.unsqueeze(1)
        return self.in_sight(satellite, Candidates(place.clamp(min=0), place >= 0)).squeeze(1)

    def candidate_ids(self, satellite: BoundSatellite, row: int, count: int) -> list[str | None]:
        """Return the ids of the first ``count`` candidates of one satellite of a type; None for those that do not exist."""
        candidates = self.candidates(satellite, count)
        pairs = zip(candidates.place[row].tolist(), candidates.exists[row].tolist(), strict=True)
        return [self.ids[place] if exists else None for place, exists in pairs]


def sorted_peers(names: Sequence[str]) -> Tensor:
    """Return the numbers of the other imagers of each of A imagers, sorted by their ``names``, [1, A, A - 1]."""
    order = sorted(range(len(names)), key=lambda k: names[k])
    peers = [[peer for peer in order if peer != k] for k in range(len(names))]
    return torch.tensor(peers, dtype=torch.int64).view(1, len(names), -1)


def _event_table(catalog: RSOTargetCatalog | RandomRSOCatalog) -> tuple[Tensor, Tensor] | None:
    """Return times [K] s, and the changed priorities after the first k changes, [K + 1, G], NaN for unchanged ones."""
    events = catalog.priority_events
    if not events:
        return None
    rows = [torch.full((len(catalog.ids),), torch.nan, dtype=torch.float64)]
    for event in events:
        row = rows[-1].clone()
        for key, value in event.priorities:
            row[catalog.ids.index(key)] = value
        rows.append(row)
    return torch.tensor([event.time_s for event in events], dtype=torch.float64), torch.stack(rows)


def _epochs(catalogs: Sequence[RSOTargetCatalog | RandomRSOCatalog]) -> Tensor | None:
    """Return the epochs of catalogs, [E] s ET, NaN for those of none; None if none has one."""
    epochs = [getattr(catalog, "utc_init", None) for catalog in catalogs]
    if all(epoch is None for epoch in epochs):
        return None
    return torch.tensor([torch.nan if epoch is None else parse_utc(epoch) for epoch in epochs], dtype=torch.float64)


def check_imager(satellite: BoundSatellite, title: str) -> None:
    """Raise ValueError unless the satellites of a type image the targets of a catalog; ``title`` names the caller."""
    if POSITIONS not in satellite.simulator.scenario_state:
        raise ValueError(f"{title} needs RSOTargets as the scenario of the environment")
    names = satellite.simulator.state.constants.get("bufferNames") or [""]
    if not names[0].startswith(PREFIX):
        raise ValueError(f"{title} needs an imager; {satellite.name!r} is not among the imager_names of RSOTargets")


def epoch_text(et: float) -> str:
    """Return an epoch, s past J2000 TDB, as a text that :func:`bsk_torch.astro.ephemeris.parse_utc` reads as the same number."""
    minutes, second = divmod(et, 60.0)
    date = datetime(2000, 1, 1, 12) + timedelta(minutes=minutes)
    return f"{date.year} {MONTHS[date.month - 1]} {date.day:02d} {date:%H:%M}:{second:012.9f} TDB"
