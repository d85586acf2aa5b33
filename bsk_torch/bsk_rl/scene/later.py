"""Names of bsk_rl that bsk_torch does not have yet, and what to write instead."""

from __future__ import annotations

from typing import NoReturn

RSO = (
    "imaging other satellites is not in bsk_torch yet. Their surfaces can be inspected: scene.SphericalRSO with "
    "data.RSOInspectionReward"
)
MIXED = "several scenarios in one environment are not in bsk_torch yet. Satellites of several types can share one scenario"

GROUPS = {
    RSO: "RSOImageData RSOImageRecord RSOImageReward RSOImageStore RSOPriorityEvent RSOTarget RSOTargetCatalog RSOTargets "
    "CandidateSnapshot target_geometry candidate_snapshot illumination_factor",
    MIXED: "MixedData MixedDataStore MixedReward MixedScenario",
}

NAMES = {name: advice for advice, names in GROUPS.items() for name in names.split()}


def raise_for(name: str, module: str) -> NoReturn:
    """Raise ImportError for a name that is to come, AttributeError for one that ``module`` never had."""
    if name in NAMES:
        raise ImportError(f"{name}: {NAMES[name]}")
    raise AttributeError(f"module {module!r} has no attribute {name!r}")
