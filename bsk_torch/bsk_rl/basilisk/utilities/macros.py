"""Units of time and angle, with Basilisk's names."""

import math

NANO2SEC = 1e-9
SEC2NANO = 1e9
NANO2MIN = NANO2SEC / 60.0
NANO2HOUR = NANO2SEC / 3600.0
NANO2DAY = NANO2SEC / 86400.0
MIN2SEC = 60.0
HOUR2SEC = 3600.0
DAY2SEC = 86400.0
D2R = math.pi / 180.0
R2D = 180.0 / math.pi
RPM = 2.0 * math.pi / 60.0
rpm2radsec = RPM
radsec2rpm = 1.0 / RPM


def sec2nano(seconds: float) -> int:
    """Return seconds as nanoseconds, rounded."""
    return int(seconds * SEC2NANO + 0.5)


def min2nano(minutes: float) -> int:
    """Return minutes as nanoseconds, rounded."""
    return sec2nano(minutes * MIN2SEC)


def hour2nano(hours: float) -> int:
    """Return hours as nanoseconds, rounded."""
    return sec2nano(hours * HOUR2SEC)


def day2nano(days: float) -> int:
    """Return days as nanoseconds, rounded."""
    return sec2nano(days * DAY2SEC)
