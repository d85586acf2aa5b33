"""Orbits of real satellites in all formats: sets of Space-Track of 2026-04-13."""

import json

GREENSAT = """GREENSAT-1 (A)
1 28051U 03046A   26103.92936350  .00000126  00000+0  55914-4 0  9994
2 28051  98.1985 143.5711 0064246 173.9227 286.4737 14.36137850171300
"""

FLEET = (
    GREENSAT
    + """0 HAWK 2 [x/y]
1 33396U 08049A   26103.92431574  .00000228  00000+0  12693-3 0  9997
2 33396  98.5635 163.2775 0001215  96.0005 264.1311 14.20124562908846
1 52912U 22069A   26103.95907240  .00000113  00000+0  21656-4 0  9994
2 52912  97.8359 353.4264 0001854  52.2815 307.8565 14.79930234205115
"""
)
"""A name, a name after ``0``, and a set without one."""

EPOCH = "2026-04-14T00:00:00Z"

FIELDS = {
    "OBJECT_NAME": "GREENSAT-1 (A)",
    "OBJECT_ID": "2003-046A",
    "EPOCH": "2026-04-13T22:18:17.006400",
    "MEAN_MOTION": "14.36137850",
    "ECCENTRICITY": ".0064246",
    "INCLINATION": "98.1985",
    "RA_OF_ASC_NODE": "143.5711",
    "ARG_OF_PERICENTER": "173.9227",
    "MEAN_ANOMALY": "286.4737",
    "EPHEMERIS_TYPE": "0",
    "CLASSIFICATION_TYPE": "U",
    "NORAD_CAT_ID": "28051",
    "ELEMENT_SET_NO": "999",
    "REV_AT_EPOCH": "17130",
    "BSTAR": ".55914E-4",
    "MEAN_MOTION_DOT": ".126E-5",
    "MEAN_MOTION_DDOT": "0",
}
"""The first set as CelesTrak's CSV has it."""

OMM_CSV = ",".join(FIELDS) + "\n" + ",".join(FIELDS.values()) + "\n"
NUMBERS = ("MEAN_MOTION", "ECCENTRICITY", "INCLINATION", "BSTAR", "RA_OF_ASC_NODE", "ARG_OF_PERICENTER", "MEAN_ANOMALY")
OMM_JSON = json.dumps([{k: float(v) if k in NUMBERS else int(v) if k == "NORAD_CAT_ID" else v for k, v in FIELDS.items()}])
"""CelesTrak's JSON has numbers, Space-Track's has strings."""
SPACE_TRACK_JSON = json.dumps(
    [{"CCSDS_OMM_VERS": "3.0", "CENTER_NAME": "EARTH", "REF_FRAME": "TEME", "TIME_SYSTEM": "UTC"} | FIELDS]
)


def tags(*names: str) -> str:
    return "".join(f"<{name}>{FIELDS[name]}</{name}>" for name in names)


OMM_XML = f"""<?xml version="1.0" encoding="UTF-8"?>
<ndm xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" xsi:noNamespaceSchemaLocation="ndmxml-3.0.0-master-3.0.xsd">
<omm id="CCSDS_OMM_VERS" version="3.0">
<header><CREATION_DATE>2026-04-14T00:00:00</CREATION_DATE><ORIGINATOR>CelesTrak</ORIGINATOR></header>
<body><segment><metadata>{tags("OBJECT_NAME", "OBJECT_ID")}<CENTER_NAME>EARTH</CENTER_NAME><REF_FRAME>TEME</REF_FRAME>
<TIME_SYSTEM>UTC</TIME_SYSTEM><MEAN_ELEMENT_THEORY>SGP4</MEAN_ELEMENT_THEORY></metadata>
<data><meanElements>{tags("EPOCH", "MEAN_MOTION", "ECCENTRICITY", "INCLINATION", "RA_OF_ASC_NODE", "ARG_OF_PERICENTER")}
{tags("MEAN_ANOMALY")}</meanElements><tleParameters>{tags("EPHEMERIS_TYPE", "NORAD_CAT_ID", "BSTAR")}</tleParameters></data>
</segment></body></omm></ndm>
"""


def oem(states: str, frame: str = "EME2000", scale: str = "UTC", name: str = "GREENSAT-1 (A)") -> str:
    return f"""CCSDS_OEM_VERS = 2.0
CREATION_DATE = 2026-04-14T00:00:00
ORIGINATOR = TEST

META_START
OBJECT_NAME = {name}
OBJECT_ID = 2003-046A
CENTER_NAME = EARTH
REF_FRAME = {frame}
TIME_SYSTEM = {scale}
START_TIME = 2026-04-13T22:00:00
STOP_TIME = 2026-04-13T23:00:00
META_STOP
COMMENT positions in km
{states}
"""


STATES = """2026-04-13T22:00:00.000 1580.996 84.049 6951.379 5.787107 -4.558542 -1.306022
2026-103T22:01:00 1924.8 -189.6 6860.3 5.66 -4.56 -1.72
"""

OPM = """CCSDS_OPM_VERS = 2.0
CREATION_DATE = 2026-04-14T00:00:00
ORIGINATOR = TEST
OBJECT_NAME = GREENSAT-1 (A)
OBJECT_ID = 2003-046A
CENTER_NAME = EARTH
REF_FRAME = ICRF
TIME_SYSTEM = UTC
EPOCH = 2026-04-13T22:18:17.006
X = 1580.996 [km]
Y = 84.049 [km]
Z = 6951.379 [km]
X_DOT = 5.787107 [km/s]
Y_DOT = -4.558542 [km/s]
Z_DOT = -1.306022 [km/s]
MASS = 100.0 [kg]
"""
