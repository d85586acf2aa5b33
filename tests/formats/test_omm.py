"""Orbit mean-elements messages."""

import json

import pytest

from bsk_torch.formats import omm
from bsk_torch.formats.omm import read_omm
from bsk_torch.formats.orbits import read_orbits
from bsk_torch.formats.tle import read_tle
from tests.formats.samples import FIELDS, GREENSAT, OMM_CSV, OMM_JSON, OMM_XML, OPM, SPACE_TRACK_JSON, STATES, oem
from tests.support.refusals import check_refusals, refusal


@pytest.mark.parametrize("text", [OMM_CSV, OMM_JSON, OMM_XML, SPACE_TRACK_JSON, OMM_JSON[1:-1]])
def test_every_form_holds_the_set_of_two_lines(text):
    (found,), (expected,) = read_omm(text), read_tle(GREENSAT)
    assert found.epoch == pytest.approx(expected.epoch, abs=1e-3)  # the two lines have eight digits of a day
    values = ("inclination", "node", "eccentricity", "perigee", "mean_anomaly", "mean_motion", "bstar")
    for name in values:
        assert getattr(found, name) == pytest.approx(getattr(expected, name), rel=1e-13), name
    assert (found.name, found.norad_id) == (expected.name, expected.norad_id)


def test_formats_are_told_apart(tmp_path):
    kinds = [type(read_orbits(text)[0]).__name__ for text in (GREENSAT, OMM_CSV, OMM_JSON, OMM_XML, OPM, oem(STATES))]
    assert kinds == ["ElementSet"] * 4 + ["Ephemeris"] * 2
    (tmp_path / "gp.csv").write_text(OMM_CSV)
    assert read_orbits(tmp_path / "gp.csv") == read_orbits(OMM_CSV)


@pytest.mark.parametrize("encoding", ["UVF-8", "utf-16"])
def test_files_are_utf_8_whatever_encoding_they_declare(encoding):
    assert read_omm(OMM_XML.replace("UTF-8", encoding)) == read_omm(OMM_XML)


def edited(**fields):
    return json.dumps([{**FIELDS, **fields}])


def test_wrong_messages_are_refused(monkeypatch):
    lacking = {name: value for name, value in FIELDS.items() if name != "BSTAR"}
    bomb = '<!DOCTYPE lolz [<!ENTITY lol "lol"><!ENTITY lol2 "&lol;&lol;">]>\n<ndm><omm>&lol2;</omm></ndm>'
    check_refusals(
        refusal(lambda: read_omm(edited(INCLINATION="198.0")), ValueError, "entry [0]", "inclination=198", "180"),
        refusal(lambda: read_omm(edited(MEAN_MOTION="1_4")), ValueError, "entry [0]", "MEAN_MOTION='1_4'", "number"),
        refusal(lambda: read_omm(edited(EPOCH="yesterday")), ValueError, "entry [0]", "EPOCH", "yesterday"),
        refusal(lambda: read_omm(edited(REF_FRAME="EME2000")), ValueError, "REF_FRAME='EME2000'", "TEME"),
        refusal(lambda: read_omm(edited(EPHEMERIS_TYPE="4")), ValueError, "EPHEMERIS_TYPE='4'", "SGP4"),
        refusal(lambda: read_omm(edited(NORAD_CAT_ID="x")), ValueError, "NORAD_CAT_ID='x'", "whole"),
        refusal(lambda: read_omm(json.dumps([lacking])), ValueError, "entry [0]", "BSTAR is missing"),
        refusal(lambda: read_omm(json.dumps([FIELDS, FIELDS])), ValueError, "line 2", "identifier 28051", "line 1"),
        refusal(lambda: read_omm("[1]"), ValueError, "entry [0]", "object"),
        refusal(lambda: read_omm("[]"), ValueError, "no element set"),
        refusal(lambda: read_omm("a,b\n1,2\n"), ValueError, "line 1", "MEAN_MOTION"),
        refusal(lambda: read_omm(OMM_CSV + "x,y\n"), ValueError, "line 3", "2 fields", "17"),
        refusal(lambda: read_omm(OMM_CSV.replace("98.1985", "-1")), ValueError, "line 2", "inclination=-1"),
        refusal(lambda: read_omm(bomb), ValueError, "line 1", "<!DOCTYPE"),
        refusal(lambda: read_omm("<ndm>\n<omm>"), ValueError, "line 2", "no XML"),
        refusal(lambda: read_omm("<ndm></ndm>"), ValueError, "no element set"),
    )
    monkeypatch.setattr(omm, "MOST_SETS", 1)
    check_refusals(refusal(lambda: read_omm(json.dumps([FIELDS, FIELDS])), ValueError, "more than 1", "split"))
