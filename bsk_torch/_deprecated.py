"""Names of earlier releases that still work, with a warning, for one release.

Four tables list them: modules that were moved, modules that became packages, names inside modules, and attributes of objects.
A renamed module, name or attribute gets one row; a module listed in ``SPLIT`` or ``NAMES`` also ends with::

    if not TYPE_CHECKING:
        __getattr__ = deprecated_names(__name__)

The guard hides the function from type checkers, which otherwise accept every name. A class listed in ``ATTRIBUTES`` is decorated
with :func:`deprecated_attributes`.
"""

from __future__ import annotations

import importlib
import sys
import warnings
from collections.abc import Callable, Sequence
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from operator import attrgetter
from types import ModuleType
from typing import Any, TypeVar

Class = TypeVar("Class", bound=type)

REMOVED_IN = "0.3"
"""Release without the names below."""

MODULES: dict[str, str] = {
    "bsk_torch.lanes": "bsk_torch.codegen",
    "bsk_torch.lanes.expr": "bsk_torch.codegen.ir",
    "bsk_torch.lanes.emit": "bsk_torch.codegen.cpp",
    "bsk_torch.lanes.kernel": "bsk_torch.codegen.build",
    "bsk_torch.lanes.loop": "bsk_torch.codegen.kernel",
    "bsk_torch.lanes.team": "bsk_torch.codegen.tiling",
    "bsk_torch.sim.compiler": "bsk_torch.codegen.inductor",
    "bsk_torch.sim.memory": "bsk_torch.sim.state",
    "bsk_torch.sim.model": "bsk_torch.sim.readout.model",
    "bsk_torch.sim.observe": "bsk_torch.sim.readout.observables",
    "bsk_torch.sim.surroundings": "bsk_torch.sim.readout.surroundings",
    "bsk_torch.sim.paths": "bsk_torch.sim.orbit.builder",
    "bsk_torch.sim.solver": "bsk_torch.sim.orbit.solvers",
    "bsk_torch.sim.span": "bsk_torch.sim.orbit.equations",
    "bsk_torch.sim.sky": "bsk_torch.sim.environment.ephemeris",
    "bsk_torch.sim.search": "bsk_torch.sim.access.passes",
    "bsk_torch.sim.sight": "bsk_torch.sim.access.visibility",
    "bsk_torch.sim.eclipse": "bsk_torch.sim.access.eclipses",
    "bsk_torch.sim.los": "bsk_torch.sim.access.line_of_sight",
    "bsk_torch.sim.ragged": "bsk_torch.sim.access.padded",
    "bsk_torch.sim.aim": "bsk_torch.sim.access.relative_geometry",
    "bsk_torch.sim.queries": "bsk_torch.sim.access.lookahead",
    "bsk_torch.rl.attention": "bsk_torch.rl.networks.attention",
    "bsk_torch.rl.sight": "bsk_torch.rl.networks.normaliser",
    "bsk_torch.rl.ppo": "bsk_torch.rl.training.ppo",
    "bsk_torch.rl.collect": "bsk_torch.rl.training.collect",
    "bsk_torch.rl.config": "bsk_torch.rl.training.config",
    "bsk_torch.rl.recipes": "bsk_torch.rl.training.recipes",
    "bsk_torch.rl.log": "bsk_torch.rl.training.log",
    "bsk_torch.rl.progress": "bsk_torch.rl.training.progress",
    "bsk_torch.rl.crew": "bsk_torch.rl.policies.shared_policy",
    "bsk_torch.rl.benchmarl": "bsk_torch.rl.marl.benchmarl",
    "bsk_torch.rl.evaluate": "bsk_torch.rl.evaluation.evaluate",
    "bsk_torch.rl.statistics": "bsk_torch.rl.evaluation.statistics",
    "bsk_torch.rl.replay": "bsk_torch.rl.evaluation.replay",
    "bsk_torch.rl.failures": "bsk_torch.rl.evaluation.failures",
    "bsk_torch.rl.rescue": "bsk_torch.rl.evaluation.rescue",
    "bsk_torch.rl.charge_bound": "bsk_torch.rl.evaluation.charge_bound",
    "bsk_torch.rl.episodes": "bsk_torch.rl.training.episodes",
    "bsk_torch.rl.pretrained": "bsk_torch.rl.policies.pretrained",
    "bsk_torch.rl.baselines": "bsk_torch.rl.rules.baselines",
    "bsk_torch.rl.imaging": "bsk_torch.rl.rules.imaging",
    "bsk_torch.rl.targets": "bsk_torch.rl.rules.targets",
    "bsk_torch.rl.shield": "bsk_torch.rl.rules.shield",
    "bsk_torch.viz.frames": "bsk_torch.viz.render.frames",
    "bsk_torch.viz.frames_globe": "bsk_torch.viz.render.globe",
    "bsk_torch.viz.frames_marks": "bsk_torch.viz.render.marks",
    "bsk_torch.viz.frames_moment": "bsk_torch.viz.render.moment",
    "bsk_torch.viz.frames_panel": "bsk_torch.viz.render.panel",
    "bsk_torch.viz.report_curves": "bsk_torch.viz.report.curves",
    "bsk_torch.viz.report_deaths": "bsk_torch.viz.report.deaths",
    "bsk_torch.viz.record": "bsk_torch.viz.recorders.episode",
    "bsk_torch.viz.track": "bsk_torch.viz.recorders.track",
    "bsk_torch.viz.imaging": "bsk_torch.viz.recorders.imaging",
    "bsk_torch.viz.constellation_record": "bsk_torch.viz.recorders.constellation",
    "bsk_torch.viz.timeline": "bsk_torch.viz.figures.timeline",
    "bsk_torch.viz.decisions": "bsk_torch.viz.figures.decisions",
    "bsk_torch.viz.ground_track": "bsk_torch.viz.figures.ground_track",
    "bsk_torch.viz.track_map": "bsk_torch.viz.figures.track_map",
    "bsk_torch.viz.curves": "bsk_torch.viz.figures.curves",
    "bsk_torch.viz.constellation": "bsk_torch.viz.figures.constellation",
    "bsk_torch.viz.world": "bsk_torch.viz.figures.world",
    "bsk_torch.viz.style": "bsk_torch.viz.figures.style",
    "bsk_torch.env.squad": "bsk_torch.env.satellite_group",
    "bsk_torch.env.groups": "bsk_torch.env.agents",
}
"""Moved modules: old to new dotted name. Submodules of a moved package move with it."""

SPLIT: dict[str, str] = {
    "bsk_torch.rl.marl": "bsk_torch.rl.marl.mappo",
    "bsk_torch.rl.networks": "bsk_torch.rl.networks.plans",
    "bsk_torch.rl.policies": "bsk_torch.rl.policies.files",
    "bsk_torch.rl.training": "bsk_torch.rl.training.trainer",
    "bsk_torch.sim.access": "bsk_torch.sim.access.windows",
    "bsk_torch.sim.orbit": "bsk_torch.sim.orbit.arcs",
    "bsk_torch.sim.world": "bsk_torch.sim.environment.world",
    "bsk_torch.viz.report": "bsk_torch.viz.report.page",
}
"""Modules that are packages, or hold something else, now: to the module that holds their contents."""

NAMES: dict[str, dict[str, str]] = {
    "bsk_torch.act": {"never": "forbid", "of_target": "image_target", "only": "allow_only"},
    "bsk_torch.act.base": {"Table": "ActionTable"},
    "bsk_torch.act.image": {"NOTHING": "NO_TARGET", "of_target": "image_target"},
    "bsk_torch.act.masks": {"never": "forbid", "only": "allow_only"},
    "bsk_torch.sim.access": {"Access": "bsk_torch.sim.access.windows:AccessWindows"},
    "bsk_torch.rl.evaluation.evaluate": {"LONGEST": "bsk_torch.env.rollout:LONGEST"},
    "bsk_torch.rl.marl.mappo": {
        "CrewConfig": "MAPPOConfig",
        "CrewCritic": "ConstellationCritic",
        "CrewLearner": "MAPPOLearner",
        "CrewTraining": "MAPPOTraining",
        "WhereDeciding": "DecidingOnly",
        "by_team": "team_batch",
    },
    "bsk_torch.rl.policies.shared_policy": {
        "Crew": "SharedPolicy",
        "Member": "MemberView",
        "crew_baseline": "shared_baseline",
        "evaluate_crew": "bsk_torch.rl.evaluation.evaluate:evaluate",
        "member": "member_view",
    },
    "bsk_torch.rl.training.log": {"MEASURES": "bsk_torch.rl.training.episodes:MEASURES"},
    "bsk_torch.rl.networks.normaliser": {
        "Normaliser": "FeatureNormaliser",
        "SetSight": "SetNormaliser",
        "Sight": "ObservationNormaliser",
        "VectorSight": "VectorNormaliser",
    },
    "bsk_torch.rl.rules.imaging": {"by_haste": "by_discounted_priority"},
    "bsk_torch.rl.training.ppo": {
        "timed": "bsk_torch.rl.training.advantages:timed",
        "values": "bsk_torch.rl.training.advantages:values",
    },
}
"""Renamed contents of modules, by new module name: old to new name; ``package.module:Name`` for a name of another module."""

ATTRIBUTES: dict[str, dict[str, str]] = {
    "Fleet": {"inert": "state.removed", "parts": "satellites", "tables": "scenario_state"},
    "Satellite": {"absent": "removed"},
    "Simulator": {
        "all_rows": "state.all_rows",
        "drawn": "state.all_arguments",
        "eclipses": "lookahead.eclipses",
        "own": "state.parameters",
        "pack": "state.planes",
        "shared": "uniform",
        "sim_time_ns": "state.sim_time_ns",
        "size": "state.rows",
        "tables": "scenario_state",
    },
    "Tasking": {
        "limit_ticks": "state.limit_ticks",
        "originals": "builder.satellites",
        "seed_rows": "state.seed",
        "squads": "fleet.groups",
        "time_limit_generator": "options.time_limit",
        "types": "builder.types",
    },
    "World": {"r_sun_N": "r_SN_N"},
}
"""Renamed attributes, by name of the class: old name to new name, dotted for an attribute of an attribute."""


def warn_deprecated(old: str, new: str, stacklevel: int = 2) -> None:
    """Warn that ``old`` has become ``new``, pointing to the caller's caller.

    Args:
        old: Deprecated name, as users write it.
        new: Name to use instead.
        stacklevel: Frame that the warning points to: 1 is the function that calls this one, 2 its caller.
    """
    message = f"{old} is deprecated and will be removed in bsk_torch {REMOVED_IN}; use {new}"
    warnings.warn(message, DeprecationWarning, stacklevel=stacklevel + 1)


def deprecated_names(module: str) -> Callable[[str], Any]:
    """Return the ``__getattr__`` of a module listed in ``SPLIT`` or ``NAMES``: a lookup of old names."""

    def find(name: str) -> Any:
        new = _new_place(module, name)
        if new is None:
            raise AttributeError(f"module {module!r} has no attribute {name!r}")
        warn_deprecated(f"{module}.{name}", ".".join(new))
        value = getattr(importlib.import_module(new[0]), new[1])
        setattr(sys.modules[module], name, value)  # warns once; `from module import name` looks twice
        return value

    return find


def deprecated_attributes(cls: Class) -> Class:
    """Decorate a class listed in ``ATTRIBUTES``: its old attributes read and set the new ones, with a warning."""
    for old, new in ATTRIBUTES[cls.__name__].items():
        setattr(cls, old, _renamed_attribute(old, new))
    return cls


def _renamed_attribute(old: str, new: str) -> property:
    """Return the property ``old``, which stands for the attribute ``new`` of the same object."""
    owner, _, name = new.rpartition(".")

    def warn(instance: Any) -> None:
        title = type(instance).__name__
        warn_deprecated(f"{title}.{old}", f"{title}.{new}", stacklevel=3)

    def read(instance: Any) -> Any:
        warn(instance)
        return attrgetter(new)(instance)

    def write(instance: Any, value: Any) -> None:
        warn(instance)
        setattr(attrgetter(owner)(instance) if owner else instance, name, value)

    return property(read, write, doc=f"Old name of ``{new}``.")


def _new_place(module: str, name: str) -> tuple[str, str] | None:
    """New module and name of an old name of ``module``; None if there is none."""
    if new := NAMES.get(module, {}).get(name):
        place, _, renamed = new.rpartition(":")
        return place or module, renamed
    if module in SPLIT and not name.startswith("_") and hasattr(importlib.import_module(SPLIT[module]), name):
        return SPLIT[module], name
    return None


class _Alias(Loader):
    """Loads a module under its old name: the same object, so that classes and their state exist once."""

    def __init__(self, new: str) -> None:
        """Keep the new name."""
        self.new = new

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        """Return the module itself; the import system then overwrites its ``__spec__``, which is therefore kept."""
        module = importlib.import_module(self.new)
        self.spec = module.__spec__
        return module

    def exec_module(self, module: ModuleType) -> None:
        """Restore the specification that :meth:`create_module` kept; the module has run already."""
        module.__spec__ = self.spec


class _Finder(MetaPathFinder):
    """Finds moved modules under their old names."""

    def find_spec(self, name: str, path: Sequence[str] | None, target: ModuleType | None = None) -> ModuleSpec | None:
        """Return how to load a moved module; None for all others."""
        new = _moved(name) if name.startswith("bsk_torch.") else None
        if new is None:
            return None
        warn_deprecated(name, new)
        return ModuleSpec(name, _Alias(new))


def _moved(name: str) -> str | None:
    """New name of a moved module or of a submodule of one; None for all others."""
    if name in MODULES:
        return MODULES[name]
    parent, _, child = name.rpartition(".")
    new = _moved(parent) if parent else None
    return new and f"{new}.{child}"


def install() -> None:
    """Make old names of modules importable."""
    sys.meta_path.insert(0, _Finder())
