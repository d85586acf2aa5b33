"""Epochs in all forms that SPICE reads; ``tests/basilisk/recorders/record_arguments.py`` asked SPICE itself."""

from __future__ import annotations

import json
from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path

import numpy as np
import pytest

from bsk_torch.astro.ephemeris import parse_utc
from bsk_torch.astro.epochs import read_epoch
from bsk_torch.rand import random_epoch

SPICE = json.loads((Path(__file__).parents[1] / "sim" / "data" / "epochs.json").read_text())

NOON = parse_utc("2018-06-27T12:00:00")

LENIENT = {"2018 JUN 27 12:00:00 A.D."}
"""Epochs that SPICE refuses though their meaning is plain."""

BEYOND = {"2018 JUN 27 12:00:00 TT": "2018 JUN 27 12:00:00 TDT", "jd 2458297.25 tt": "jd 2458297.25 tdt"}
"""Epochs that later releases of SPICE read, and what they mean."""


@pytest.mark.parametrize("text", [text for text, et in SPICE.items() if et is not None])
def test_epochs_are_read_as_spice_reads_them(text):
    assert parse_utc(text) == pytest.approx(SPICE[text], abs=1e-4)


@pytest.mark.parametrize("text", [text for text, et in SPICE.items() if et is None and text not in LENIENT])
def test_epochs_that_spice_refuses_are_refused_with_an_example(text):
    with pytest.raises(ValueError, match="one like") as caught:
        parse_utc(text)
    assert repr(text) in str(caught.value)


@pytest.mark.parametrize(("text", "same"), BEYOND.items())
def test_terrestrial_time_under_its_newer_name(text, same):
    assert parse_utc(text) == parse_utc(same)


def test_the_form_that_random_epochs_have_is_read_as_any_other():
    texts = random_epoch(1990, 2060).at(np.random.default_rng(0).random((300, 7)))
    assert len(texts) == 300
    for text in texts:
        assert read_epoch(text) == read_epoch(text.replace(" (UTC)", "  UTC"))


def test_at_least_fifty_forms_are_compared():
    assert sum(et is not None for et in SPICE.values()) >= 50


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


def test_microseconds_of_datetimes_count():
    assert parse_utc(datetime(2018, 6, 27, 12, 0, 1, 250000)) == NOON + 1.25


@pytest.mark.parametrize(
    ("text", "example"),
    [
        ("2018-178", "2021-036T09:12:05"),
        ("Jun 27, 2018 12:00 o'clock", "February 5, 2021 09:12"),
        ("JD2458297,5", "JD 2459250.8834"),
        ("2018-06-27T12:00:00 UTC", "2021-02-05 09:12:05"),
    ],
)
def test_the_example_is_the_nearest_form(text, example):
    with pytest.raises(ValueError, match="one like it is") as caught:
        parse_utc(text)
    assert str(caught.value).endswith(repr(example))


@pytest.mark.parametrize("text", ["2018 JUN 27.5", "June 27.25, 2018", "2018-06-27.5"])
def test_fractions_of_a_day_which_spice_drops_are_refused(text):
    with pytest.raises(ValueError, match="SPICE drops fractions of a day; write the hour"):
        parse_utc(text)


def test_a_leap_second_exists_on_the_clock_of_utc_only():
    assert parse_utc("2016 DEC 31 23:59:60") == pytest.approx(parse_utc("2017 JAN 01 00:00:00") - 1.0)
    with pytest.raises(ValueError, match="second must be below 60"):
        parse_utc("2016 DEC 31 23:59:60 TDB")
