"""Wrong filters and numbers of deputies: what each must raise, and what its message must name."""

import itertools

import bsk_torch
from bsk_torch.tasks.safe_autonomy import HeldThrust
from bsk_torch.tasks.safe_autonomy.assurance import DOCKING, Backup, Barriers
from tests.support.refusals import check_refusals, refusal


def test_rejects_wrong_filters_and_numbers_of_deputies():
    numbers = list(itertools.product(("CWDocking-v1", "CWInspection-v1"), (0, 1.5, "2")))
    guarded = lambda preset: bsk_torch.make(preset, num_envs=1, assurance="safe", backend="eager")
    table = [
        *(refusal(lambda p=p, n=n: bsk_torch.make(p, deputies=n), ValueError, f"deputies={n!r}") for p, n in numbers),
        refusal(lambda: guarded("CWDocking-v1"), ValueError, "assurance", "'safe'", "'simplex'"),
        refusal(lambda: guarded("CWInspection-v1"), ValueError, "assurance", "'safe'", "'asif'"),
        *(refusal(lambda kind=kind: kind([]), ValueError, "barriers", "Barrier") for kind in (Barriers, Backup)),
        refusal(lambda: Backup(DOCKING, window=-1.0), ValueError, "window", -1.0, "[0, inf) s"),
        refusal(lambda: HeldThrust(assurance=3), ValueError, "assurance", 3, "deputies, forces and seconds"),
    ]
    check_refusals(table)
