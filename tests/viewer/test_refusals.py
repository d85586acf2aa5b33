"""What the viewer cannot record or export."""

import bsk_torch
from bsk_torch.recording import record
from bsk_torch.viewer.czml import czml
from bsk_torch.viewer.oem import oem
from bsk_torch.viewer.schedule import schedule
from tests.support.recordings import synthetic_recording
from tests.support.refusals import check_refusals, refusal


def test_rejects_what_cannot_be_recorded_or_exported():
    whole, earthless = synthetic_recording(), synthetic_recording()
    earthless.scenes[0].PN0.clear()
    joint = bsk_torch.make("Constellation-v1", num_envs=1, joint=True, backend="eager")
    table = [
        refusal(lambda: czml(whole, 9), IndexError, "track=9", "0 to 1"),
        refusal(lambda: oem(whole, 9), IndexError, "track=9", "0 to 1"),
        refusal(lambda: oem(earthless), ValueError, "Synthetic-v1", "Earth", ".html"),
        refusal(lambda: schedule(whole, "csv", 9), IndexError, "track=9", "0 to 1"),
        refusal(lambda: czml(earthless), ValueError, "Synthetic-v1", "Earth", ".html"),
        refusal(lambda: record(joint, lambda td: td), ValueError, "env", "joint=True"),
    ]
    check_refusals(table)
