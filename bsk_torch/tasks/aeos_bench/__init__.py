"""AEOS-Bench: up to 50 satellites point at tasks on the ground, second by second."""

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
