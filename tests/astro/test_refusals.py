"""Epochs that are none or lie outside of the ephemeris, and tensors of the wrong type or shape."""

import torch

from bsk_torch.astro import ephemeris, relative
from bsk_torch.astro.ephemeris import parse_utc
from tests.support.refusals import check_refusals, refusal


def test_rejects_wrong_epochs_and_tensors():
    check_refusals(
        refusal(lambda: parse_utc("2021 FEB 29 00:00:00"), ValueError, "'2021 FEB 29 00:00:00'", "day"),
        refusal(lambda: parse_utc("2021-13-01T00:00:00"), ValueError, "'2021-13-01T00:00:00'", "month"),
        refusal(lambda: parse_utc("2021-02-05T24:00:00"), ValueError, "'2021-02-05T24:00:00'", "hour", "24"),
        refusal(lambda: parse_utc("2021-02-05T23:60:00"), ValueError, "'2021-02-05T23:60:00'", "minute"),
        refusal(lambda: parse_utc("2021-02-05T23:59:60"), ValueError, "'2021-02-05T23:59:60'", "second", " 60"),
        refusal(lambda: parse_utc("2016-12-31T23:59:61"), ValueError, "'2016-12-31T23:59:61'", "second", " 61"),
        refusal(lambda: parse_utc("9999-12-31T23:59:59"), ValueError, "'9999-12-31T23:59:59'", "range"),
        refusal(lambda: parse_utc("2016 DEC 31 23:59:60 TDB"), ValueError, "'2016 DEC 31 23:59:60 TDB'", "second", " 60"),
        # fractions of a day, which SPICE drops
        refusal(lambda: parse_utc("2018 JUN 27.5"), ValueError, "'2018 JUN 27.5'", "SPICE", "day", "hour"),
        refusal(lambda: parse_utc("June 27.25, 2018"), ValueError, "'June 27.25, 2018'", "SPICE", "day", "hour"),
        refusal(lambda: parse_utc("2018-06-27.5"), ValueError, "'2018-06-27.5'", "SPICE", "day", "hour"),
        # with an example of the nearest form
        refusal(lambda: parse_utc("2018-178"), ValueError, "'2018-178'", "'2021-036T09:12:05'"),
        refusal(lambda: parse_utc("Jun 27, 2018 12:00 o'clock"), ValueError, "Jun 27, 2018", "'February 5, 2021 09:12'"),
        refusal(lambda: parse_utc("JD2458297,5"), ValueError, "'JD2458297,5'", "'JD 2459250.8834'"),
        refusal(lambda: parse_utc("2018-06-27T12:00:00 UTC"), ValueError, "2018-06-27T12:00:00 UTC", "'2021-02-05 09:12:05'"),
        # outside of the table
        refusal(lambda: parse_utc("1989 NOV 01 00:00:00 (UTC)"), ValueError, "1989 NOV 01", "1989-11-30", "2060-03-06"),
        refusal(lambda: parse_utc("2060 APR 01 00:00:00 (UTC)"), ValueError, "2060 APR 01", "1989-11-30", "2060-03-06"),
    )
    single = torch.zeros(2)  # epochs would be rounded to about a minute
    check_refusals(
        refusal(lambda: ephemeris.sun_position(single), TypeError, "et", "float64", "float32"),
        refusal(lambda: ephemeris.sun_state(single), TypeError, "et", "float64", "float32"),
        refusal(lambda: ephemeris.earth_angles(single), TypeError, "et", "float64", "float32"),
        refusal(lambda: ephemeris.earth_orientation(single), TypeError, "et", "float64", "float32"),
        refusal(lambda: ephemeris.earth_orientation_rate(single), TypeError, "et", "float64", "float32"),
        refusal(lambda: relative.rv2HN([1.0, 2.0], [-5543.2, -4210.9, 3605.4]), ValueError, "vector", "[2]", "[3]"),
        refusal(lambda: relative.fibonacci_sphere(0), ValueError, "n_points", "0", "1"),
    )
