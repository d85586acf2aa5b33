"""The benchmark's own verifier on plans of this package, where brahe and a copy of github.com/Mtrya/astro-reason are at hand.

The variable ``BSK_TORCH_ASTRO_REASON`` names the folder of the copy.
"""

import os
import sys
from pathlib import Path

import pytest

from bsk_torch.tasks.aeossp import check, flyable, plan, read_case, verifier, write_solution

COPY = os.environ.get("BSK_TORCH_ASTRO_REASON", "")


@pytest.fixture(scope="module")
def verify():
    if not COPY:
        pytest.skip("needs a copy of astro-reason, named by BSK_TORCH_ASTRO_REASON, and brahe")
    pytest.importorskip("brahe")
    sys.path.insert(0, COPY)
    try:
        from benchmarks.aeossp_standard.verifier.engine import verify_solution
    finally:
        sys.path.remove(COPY)
    return verify_solution


@pytest.mark.parametrize("model", [verifier, flyable])
@pytest.mark.parametrize("name", ["test/case_0001", "test_easy/case_0001", "test_horizon_2022/case_0001"])
def test_plans_are_accepted(verify, name, model, tmp_path):
    folder = Path(COPY, "benchmarks/aeossp_standard/dataset/cases", name)
    case = read_case(folder)
    observations = plan(case, model).observations
    write_solution(tmp_path / "s.json", case, observations)
    theirs, ours = verify(folder, tmp_path / "s.json"), check(case, observations)
    assert theirs.valid, theirs.violations[:3]
    for metric in ("WCR", "CR", "TAT"):
        assert getattr(ours, metric) == pytest.approx(theirs.metrics[metric], rel=1e-12)
    assert pytest.approx(theirs.metrics["PC"], abs=1e-3) == ours.PC
