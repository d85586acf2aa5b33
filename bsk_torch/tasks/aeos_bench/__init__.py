"""AEOS-Bench: up to 50 satellites point at tasks on the ground, second by second.

Attributes are imported when they are first read (PEP 562), so that the help of the commands does not wait for torch.
"""

from typing import TYPE_CHECKING

from bsk_torch.sim.names import lazy as _lazy

if TYPE_CHECKING:
    from bsk_torch.tasks.aeos_bench.act import PointAtTask
    from bsk_torch.tasks.aeos_bench.dyn import AEOSBenchDynModel, AEOSBenchTracedDynModel
    from bsk_torch.tasks.aeos_bench.files import Cases, read_cases
    from bsk_torch.tasks.aeos_bench.fsw import AEOSBenchFSWModel
    from bsk_torch.tasks.aeos_bench.generator import AEOSBenchGenerator
    from bsk_torch.tasks.aeos_bench.obs import TaskProperties
    from bsk_torch.tasks.aeos_bench.reward import TaskReward
    from bsk_torch.tasks.aeos_bench.rules import NearestTask
    from bsk_torch.tasks.aeos_bench.scene import AEOSBench
    from bsk_torch.tasks.aeos_bench.writing import write_cases

__all__ = [
    "AEOSBench",
    "AEOSBenchDynModel",
    "AEOSBenchFSWModel",
    "AEOSBenchGenerator",
    "AEOSBenchTracedDynModel",
    "Cases",
    "NearestTask",
    "PointAtTask",
    "TaskProperties",
    "TaskReward",
    "read_cases",
    "write_cases",
]

__getattr__ = _lazy(
    __name__,
    {
        "act": ["PointAtTask"],
        "dyn": ["AEOSBenchDynModel", "AEOSBenchTracedDynModel"],
        "files": ["Cases", "read_cases"],
        "fsw": ["AEOSBenchFSWModel"],
        "generator": ["AEOSBenchGenerator"],
        "obs": ["TaskProperties"],
        "reward": ["TaskReward"],
        "rules": ["NearestTask"],
        "scene": ["AEOSBench"],
        "writing": ["write_cases"],
    },
)
