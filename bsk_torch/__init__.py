"""Spacecraft tasking for reinforcement learning: BSK-RL's problems and Basilisk's physics, in batched torch operations.

Attributes are imported when they are first read (PEP 562), so that ``bsk-torch --help`` does not wait for torch.
"""

from importlib import import_module as _import_module
from importlib.util import find_spec as _find_spec
from typing import TYPE_CHECKING

from bsk_torch._portable import choose_instructions as _choose_instructions

_choose_instructions()  # before NumPy and torch, which Gymnasium imports

from bsk_torch._listed import register_listed as _register_listed  # noqa: E402
from bsk_torch.sim.names import nearest as _nearest  # noqa: E402

if TYPE_CHECKING:
    from bsk_torch import act, comm, craft, data, formations, obs, rand, sats, scene
    from bsk_torch.env import NO_ACTION, ConstellationTasking, GeneralSatelliteTasking, SatelliteTasking
    from bsk_torch.presets import make
    from bsk_torch.rl.evaluation.evaluate import evaluate
    from bsk_torch.rl.evaluation.results import compare
    from bsk_torch.rl.marl.one_call import train
    from bsk_torch.rl.policies.loading import load_policy
    from bsk_torch.rl.policies.readers import reader
    from bsk_torch.rl.policies.shared_policy import rule
    from bsk_torch.rl.tuning import tune
    from bsk_torch.sim import dyn, faults, fsw

__version__ = "0.3.0"

__all__ = [
    "NO_ACTION",
    "ConstellationTasking",
    "GeneralSatelliteTasking",
    "SatelliteTasking",
    "act",
    "comm",
    "compare",
    "craft",
    "data",
    "dyn",
    "evaluate",
    "faults",
    "formations",
    "fsw",
    "load_policy",
    "make",
    "obs",
    "rand",
    "reader",
    "rule",
    "sats",
    "scene",
    "train",
    "tune",
]

_HOMES = {
    "NO_ACTION": "bsk_torch.env",
    "ConstellationTasking": "bsk_torch.env",
    "GeneralSatelliteTasking": "bsk_torch.env",
    "SatelliteTasking": "bsk_torch.env",
    "compare": "bsk_torch.rl.evaluation",
    "dyn": "bsk_torch.sim.dyn",
    "evaluate": "bsk_torch.rl.evaluation",
    "faults": "bsk_torch.sim.faults",
    "fsw": "bsk_torch.sim.fsw",
    "load_policy": "bsk_torch.rl.policies.loading",
    "make": "bsk_torch.presets",
    "reader": "bsk_torch.rl.policies.readers",
    "rule": "bsk_torch.rl.policies.shared_policy",
    "train": "bsk_torch.rl.marl.one_call",
    "tune": "bsk_torch.rl.tuning",
}
"""Modules that have, or are, what is not a module of the package itself."""


def __getattr__(name: str) -> object:
    """Import an attribute: a name of ``_HOMES``, or a module of the package."""
    if name in _HOMES:
        home = _import_module(_HOMES[name])
        found: object = home if home.__name__.endswith(f".{name}") else getattr(home, name)
    elif not name.startswith("__") and _find_spec(f"{__name__}.{name}") is not None:
        found = _import_module(f"{__name__}.{name}")
    else:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}; {_nearest(name, __all__)}")
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


_register_listed()
