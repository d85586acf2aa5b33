"""Names of bsk_rl that bsk_torch does not have yet: reading one raises ImportError with an alternative."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

SPACE_TO_SPACE = (
    "imaging other satellites is not in bsk_torch.bsk_rl yet; bsk_torch has it for batched environments: "
    "bsk_torch.scene.RSOTargets, act.ImageRSO, data.RSOImageReward"
)

ABSENT: dict[str, str] = {
    name: advice
    for advice, names in (
        (
            SPACE_TO_SPACE,
            "CandidateSnapshot ImageRSO RSOImageData RSOImageRecord RSOImageReward RSOImageStore RSOPriorityEvent RSOTarget "
            "RSOTargetCatalog RSOTargetDynModel RSOTargetProperties RSOTargets SpaceToSpaceImagingDynModel "
            "SpaceToSpaceImagingFSWModel candidate_snapshot illumination_factor target_geometry target_properties",
        ),
    )
    for name in names.split()
}
"""Advice for each name."""


def not_yet(module: str) -> Callable[[str], Any]:
    """Return the ``__getattr__`` of a module: ImportError for a name that is to come, AttributeError for others."""

    def read(name: str) -> Any:
        if name in ABSENT:
            raise ImportError(f"{module}.{name}: {ABSENT[name]}", name=module)
        raise AttributeError(f"module {module!r} has no attribute {name!r}")

    return read
