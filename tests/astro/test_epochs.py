"""Epochs in all forms that SPICE reads; ``scripts/recorders/record_arguments.py`` asked SPICE itself."""

import json
from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path

import numpy as np
import pytest

from bsk_torch.astro.ephemeris import parse_utc
from bsk_torch.astro.epochs import EXAMPLES, read_epoch
from bsk_torch.rand import random_epoch

SPICE = json.loads((Path(__file__).parents[1] / "sim" / "data" / "epochs.json").read_text())

NOON = parse_utc("2018-06-27T12:00:00")

LENIENT = {"2018 JUN 27 12:00:00 A.D."}
"""Epochs that SPICE refuses though their meaning is plain."""

BEYOND = {"2018 JUN 27 12:00:00 TT": "2018 JUN 27 12:00:00 TDT", "jd 2458297.25 tt": "jd 2458297.25 tdt"}
"""Epochs that later releases of SPICE read, and what they mean."""


def read(text):
    """The epoch, or the message that says why it is none."""
    try:
        return parse_utc(text)
    except ValueError as error:
        return str(error)


def test_epochs_are_read_as_spice_reads_them():
    found = {text: (read(text), et) for text, et in SPICE.items() if et is not None}
    failures = [f"{text!r}: {value}, not {et}" for text, (value, et) in found.items() if value != pytest.approx(et, abs=1e-4)]
    assert len(found) >= 50
    assert not failures, "\n".join(failures)


def test_epochs_that_spice_refuses_are_refused_with_an_example():
    failures = []
    for text in [*(text for text, et in SPICE.items() if et is None and text not in LENIENT), "", "now", "2021 FOO 05 09:12:05"]:
        found = str(read(text))
        if repr(text) not in found or not any(repr(example) in found for example in EXAMPLES):
            failures.append(f"{text!r}: {found}")
    assert not failures, "\n".join(failures)


@pytest.mark.parametrize(("text", "same"), BEYOND.items())
def test_terrestrial_time_under_its_newer_name(text, same):
    assert parse_utc(text) == parse_utc(same)


def test_the_form_that_random_epochs_have_is_read_as_any_other():
    texts = random_epoch(1990, 2060).at(np.random.default_rng(0).random((300, 7)))
    assert len(texts) == 300
    for text in texts:
        assert read_epoch(text) == read_epoch(text.replace(" (UTC)", "  UTC"))


@pytest.mark.parametrize(
    "given",
    [
        datetime(2018, 6, 27, 12),
        datetime(2018, 6, 27, 12, tzinfo=UTC),
        datetime(2018, 6, 27, 14, tzinfo=timezone(timedelta(hours=2))),
    ],
    ids=["naive", "UTC", "another zone"],
)
def test_datetimes_are_utc_unless_they_say_otherwise(given):
    assert parse_utc(given) == NOON


def test_microseconds_and_leap_seconds_count():
    assert parse_utc(datetime(2018, 6, 27, 12, 0, 1, 250000)) == NOON + 1.25
    assert parse_utc("2016 DEC 31 23:59:60") == pytest.approx(parse_utc("2017 JAN 01 00:00:00") - 1.0)
