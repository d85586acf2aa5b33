"""Two-line element sets."""

import dataclasses
import math

import pytest

from bsk_torch.astro.ephemeris import date_in_words
from bsk_torch.formats.tle import read_tle
from tests.formats.samples import FLEET, GREENSAT
from tests.support.refusals import check_refusals, refusal


def test_names_are_those_of_the_file(tmp_path):
    sets = read_tle(FLEET)
    assert [(each.name, each.norad_id) for each in sets] == [("GREENSAT-1 (A)", 28051), ("HAWK 2 [x/y]", 33396), ("52912", 52912)]
    (tmp_path / "fleet.tle").write_bytes(b"\xef\xbb\xbf" + FLEET.replace("\n", "\r\n\n").encode())
    assert read_tle(tmp_path / "fleet.tle") == read_tle(str(tmp_path / "fleet.tle")) == sets


def test_numbers_are_those_of_the_columns():
    (found,) = read_tle(GREENSAT, gravity="wgs84", max_age_days=3.0)
    assert date_in_words(found.epoch) == "2026-04-13T22:18:17.006Z"
    assert found.eccentricity == 0.0064246
    assert found.bstar == pytest.approx(5.5914e-5, rel=1e-12)
    assert math.degrees(found.inclination) == pytest.approx(98.1985, abs=1e-12)
    assert found.mean_motion * 720.0 / math.pi == pytest.approx(14.3613785, rel=1e-14)
    assert (found.gravity, found.max_age_days) == ("wgs84", 3.0)
    assert dataclasses.replace(found, gravity="wgs72", max_age_days=30.0) == read_tle(GREENSAT)[0]


def test_old_years_blank_designators_and_letters_are_read():
    old = """1 88888U          80275.98708465  .00073094  13844-3  66816-4 0    87
2 88888  72.8435 115.9689 0086731  52.6988 110.5714 16.05824518  1058"""
    assert date_in_words(read_tle(old + "\n")[0].epoch).startswith("1980-10-01")
    lines = [line.replace("28051", "A8051") for line in GREENSAT.splitlines()]
    lines[1:] = [line[:-1] + str((int(line[-1]) - 2) % 10) for line in lines[1:]]
    assert read_tle("\n".join(lines))[0].norad_id == 108051


def edited(line, start, text, mend=True):
    """The first set with other text from a column of a line on, and its checksum mended."""
    lines = GREENSAT.splitlines()
    changed = lines[line][: start - 1] + text + lines[line][start - 1 + len(text) :]
    total = sum(int(c) if c.isdigit() else c == "-" for c in changed[:68]) % 10
    lines[line] = changed[:68] + (str(total) if mend else changed[68:])
    return "\n".join(lines) + "\n"


def test_wrong_sets_are_refused(tmp_path):
    file = tmp_path / "x.tle"
    file.write_text(edited(1, 69, "5", mend=False))
    twice = GREENSAT + GREENSAT.replace("GREENSAT", "OTHER")
    same = GREENSAT + FLEET.splitlines()[0] + "\n" + "\n".join(FLEET.splitlines()[4:6]) + "\n"
    decayed = """DEBRIS
1 28872U 05037B   05333.02012661  .25992681  00000-0  24476-3 0  1534
2 28872  96.4736 157.9986 0303955 244.0492 110.6523 16.46015938 10708
"""
    check_refusals(
        refusal(lambda: read_tle(file), ValueError, "x.tle", "line 2", "checksum '5'", "must be 4"),
        refusal(lambda: read_tle(GREENSAT.replace("9994", "999")), ValueError, "line 2", "68 columns", "69"),
        refusal(lambda: read_tle(edited(2, 3, "28052")), ValueError, "line 3", "'28052'", "'28051'"),
        refusal(lambda: read_tle(edited(2, 9, "198.1985")), ValueError, "line 3", "inclination=198.198", "180"),
        refusal(lambda: read_tle(edited(2, 9, " 9x.1985")), ValueError, "line 3", "inclination=' 9x.1985'", "98.1985"),
        refusal(lambda: read_tle(edited(2, 53, "19.36137850")), ValueError, "line 3", "mean motion=19.36", "18"),
        refusal(lambda: read_tle(edited(1, 63, "4")), ValueError, "line 2", "ephemeris type=4", "SGP4"),
        refusal(lambda: read_tle(edited(1, 21, "400.00000000")), ValueError, "line 2", "epoch day=400", "2026"),
        refusal(lambda: read_tle(twice), ValueError, "line 5", "identifier 28051", "line 2"),
        refusal(lambda: read_tle(same), ValueError, "line 5", "name 'GREENSAT-1 (A)'", "line 2"),
        refusal(lambda: read_tle(GREENSAT.replace("A)", "A)\x07")), ValueError, "name", "shown"),
        refusal(lambda: read_tle("a name\nanother\n"), ValueError, "line 2", "'another'", "'1 '"),
        refusal(lambda: read_tle("\n".join(GREENSAT.splitlines()[:2]) + "\n"), ValueError, "line 2", "ends after its first line"),
        refusal(lambda: read_tle("\n".join(GREENSAT.splitlines()[::2]) + "\n"), ValueError, "line 2", "without its first line"),
        refusal(lambda: read_tle(decayed), ValueError, "line 2", "'DEBRIS'", "28872", "decayed"),
        refusal(lambda: read_tle(" \n"), ValueError, "empty"),
        refusal(lambda: read_tle(3), TypeError, "source=3"),
        refusal(lambda: read_tle(GREENSAT, gravity="wgs27"), ValueError, "gravity='wgs27'", "wgs72"),
        refusal(lambda: read_tle(GREENSAT, max_age_days=-1.0), ValueError, "max_age_days=-1.0"),
        refusal(lambda: read_tle(tmp_path / "none.tle"), FileNotFoundError, "none.tle"),
    )
