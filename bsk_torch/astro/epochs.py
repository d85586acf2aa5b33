"""Reading of epochs, in the forms that SPICE's ``str2et`` reads: ISO 8601, calendar dates, days of the year, Julian dates.

The rules follow NAIF's Time Required Reading; ``tests/sim/data/epochs.json`` holds what SPICE itself says to each of the forms.
"""

from __future__ import annotations

import difflib
import re
from datetime import datetime, timedelta, timezone
from fractions import Fraction
from typing import NamedTuple

__all__ = ["Epoch", "read_epoch"]

EXAMPLES = (
    "2021 FEB 05 09:12:05.830 (UTC)",
    "2021-02-05T09:12:05.830Z",
    "2021-02-05 09:12:05",
    "2021-036T09:12:05",
    "2021-036 // 09:12:05",
    "2021/02/05 09:12",
    "02/05/2021 09:12",
    "February 5, 2021 09:12",
    "5 FEB 2021 9:12 PM",
    "2021 FEB 05 09:12:05 TDB",
    "2021 FEB 05 09:12:05 EST",
    "JD 2459250.8834",
)
"""One epoch of each form, for messages."""

MONTHS = (
    *("JANUARY", "FEBRUARY", "MARCH", "APRIL", "MAY", "JUNE"),
    *("JULY", "AUGUST", "SEPTEMBER", "OCTOBER", "NOVEMBER", "DECEMBER"),
)
DAYS = ("MONDAY", "TUESDAY", "WEDNESDAY", "THURSDAY", "FRIDAY", "SATURDAY", "SUNDAY")
ZONES = {"EST": -5, "EDT": -4, "CST": -6, "CDT": -5, "MST": -7, "MDT": -6, "PST": -8, "PDT": -7}
"""Hours that the clocks of American time zones are ahead of UTC."""

FIRST_SHORT_YEAR = 1969
"""Years of two digits are this one and the 99 that follow."""

JD_J2000 = Fraction(2451545)
J2000 = datetime(2000, 1, 1, 12)

STANDARD = re.compile(r"(\d{4}) ([A-Z]{3}) (\d\d) (\d\d):(\d\d):(\d\d(?:\.\d+)?) \(UTC\)", re.A)
ISO = re.compile(r"(\d{4})-(\d{1,2})-(\d{1,2})T(.*?)Z?", re.A)
ISO_DAY = re.compile(r"(\d{4})-(\d{3})T(.*?)Z?", re.A)
LABEL = re.compile(r"\(?\b(UTC|TDB|TDT|TT)\b([+-]\d{1,2}(?::\d{2})?)?\)?", re.A)
ZONE = re.compile(rf"\(?\b({'|'.join(ZONES)})\b\)?", re.A)
HALF = re.compile(r"\b([AP])(?:M\b|\.\s?M\.)", re.A)
ERA = re.compile(r"\bA\.\s?D\.|\bAD\b", re.A)
JULIAN = re.compile(r"JD\s?(UTC|TDB|TDT|TT)?\s*(\d+(?:\.\d*)?)|(\d+(?:\.\d*)?)\s*JD\s?(UTC|TDB|TDT|TT)?", re.A)
TIME = re.compile(r"(?<![\d.])\d{1,2}:\d{1,2}(?:\.\d*)?(?!\d|:)|(?<![\d.])\d{1,2}:\d{1,2}:\d{1,2}(?:\.\d*)?(?!\d|:)", re.A)
TOKEN = re.compile(r"'?\d+(?:\.\d*)?|[A-Z]+\.?|//|[-/,:\s]", re.A)


class Epoch(NamedTuple):
    """An epoch as it was written.

    Attributes:
        minute: Its minute, on the clock of ``scale``.
        second: Seconds since then, less than 61.
        scale: ``"UTC"``, ``"TDB"`` or ``"TT"``.
    """

    minute: datetime
    second: float
    scale: str


class _UnknownFormError(ValueError):
    """The text has none of the forms."""


def read_epoch(value: str | datetime) -> Epoch:
    """Return an epoch; ``datetime`` objects without a time zone are UTC.

    ValueError for a text of another form, or one that names no date or time.
    """
    if isinstance(value, datetime):
        utc = value.astimezone(timezone.utc).replace(tzinfo=None) if value.tzinfo else value
        return Epoch(utc.replace(second=0, microsecond=0), utc.second + utc.microsecond * 1e-6, "UTC")
    text = " ".join(value.upper().split())
    try:
        return _standard(text) or _julian(text) or _iso(text) or _calendar(text)
    except _UnknownFormError as error:
        reason = f" ({error})" if str(error) else ""
        words = f"epoch {value!r} is not a UTC time of a form that SPICE knows{reason}; one like it is {_like(text)!r}"
        raise ValueError(words) from None
    except (ValueError, OverflowError) as error:
        raise ValueError(f"epoch {value!r} is not a valid UTC time, expected one like {_like(text)!r}: {error}") from error


def _like(text: str) -> str:
    """Return the example whose pattern of digits and letters is closest to that of a text."""

    def pattern(epoch: str) -> str:
        return re.sub(r"[A-Za-z]+", "A", re.sub(r"\d", "9", epoch))

    return max(EXAMPLES, key=lambda example: difflib.SequenceMatcher(None, pattern(text), pattern(example)).ratio())


# -- the standard form --------------------------------------------------------------------------------------------------------


def _standard(text: str) -> Epoch | None:
    """Return an epoch of the form that :func:`bsk_torch.rand.random_epoch` draws by thousands; the other ways read it, slower."""
    match = STANDARD.fullmatch(text)
    if match is None or not (month := _names(match[2], MONTHS)) or float(match[6]) >= 60.0:
        return None
    return Epoch(datetime(int(match[1]), month, int(match[3]), int(match[4]), int(match[5])), float(match[6]), "UTC")


# -- Julian dates ----------------------------------------------------------------------------------------------------------------


def _julian(text: str) -> Epoch | None:
    number, scale = text, "UTC"
    if label := LABEL.search(number):
        if label[2]:
            return None
        rest = f"{number[: label.start()]}{number[label.end() :]}".strip()
        if "JD" in rest:
            number, scale = rest, label[1]
    match = JULIAN.fullmatch(number)
    if match is None:
        return None
    seconds = (Fraction(match[2] or match[3]) - JD_J2000) * 86400
    minutes = seconds // 60
    return Epoch(J2000 + timedelta(minutes=int(minutes)), float(seconds - minutes * 60), _scale(match[1] or match[4] or scale))


def _scale(label: str) -> str:
    return "TT" if label == "TDT" else label


# -- ISO 8601 --------------------------------------------------------------------------------------------------------------------


def _iso(text: str) -> Epoch | None:
    if match := ISO.fullmatch(text):
        day = datetime(int(match[1]), int(match[2]), int(match[3]))
    elif match := ISO_DAY.fullmatch(text):
        day = _day_of_year(int(match[1]), int(match[2]))
    else:
        return None
    clock = match[match.lastindex or 0]
    hour, minute, second = _clock(clock) if clock else (0, 0, 0.0)
    return Epoch(day + timedelta(hours=hour, minutes=minute), second, "UTC")


def _day_of_year(year: int, day: int) -> datetime:
    date = datetime(year, 1, 1) + timedelta(days=day - 1)
    if date.year != year or day < 1:
        raise ValueError(f"day {day} is not in the year {year}")
    return date


def _clock(text: str) -> tuple[int, int, float]:
    """Return hour, minute and second of "12", "12:00" or "12:00:00", the last of which may have a fraction."""
    parts = text.split(":")
    if not re.fullmatch(r"(\d{1,2}:){0,2}\d{1,2}(\.\d*)?", text):
        raise _UnknownFormError
    exact = [Fraction(part.rstrip(".")) for part in parts] + [Fraction(0)] * (3 - len(parts))
    for value, limit, what in zip(exact, (24, 60, 61), ("hour", "minute", "second"), strict=True):
        if value >= limit:
            raise ValueError(f"{what} must be below {limit}")
    if len(parts) == 3:
        return int(exact[0]), int(exact[1]), float(parts[2])
    seconds = exact[0] * 3600 + exact[1] * 60
    return int(seconds // 3600), int(seconds % 3600 // 60), float(seconds % 60)


# -- calendar dates --------------------------------------------------------------------------------------------------------------


def _calendar(text: str) -> Epoch:
    """Return an epoch of a date, in any usual order, and a clock before or behind it."""
    scale, ahead, half, rest = "UTC", timedelta(0), "", text
    if match := LABEL.search(rest):
        scale, rest = _scale(match[1]), _without(rest, match)
        if match[2]:
            if scale != "UTC":
                raise _UnknownFormError("only UTC has offsets")
            hours, _, minutes = match[2][1:].partition(":")
            ahead = timedelta(hours=int(hours), minutes=int(minutes or 0)) * (-1 if match[2][0] == "-" else 1)
    elif match := ZONE.search(rest):
        ahead, rest = timedelta(hours=ZONES[match[1]]), _without(rest, match)
    if match := HALF.search(rest):
        half, rest = match[1], _without(rest, match)
    if match := ERA.search(rest):
        rest = _without(rest, match)
    time = TIME.search(rest)
    date = rest if time is None else _without(rest, time)
    day, hours = _date(date, time is not None and rest[: time.start()].rstrip(" ").endswith("/"))
    if time is not None and hours is not None:
        raise _UnknownFormError
    hour, minute, second = _clock(hours or "0") if time is None else _clock(time[0])
    if half:
        if not 1 <= hour <= 12:
            raise ValueError(f"hour {hour} with A.M. or P.M. must be from 1 to 12")
        hour = hour % 12 + (12 if half == "P" else 0)
    return Epoch(day + timedelta(hours=hour, minutes=minute) - ahead, second, scale)


def _without(text: str, match: re.Match[str]) -> str:
    return f"{text[: match.start()]} {text[match.end() :]}".strip()


def _date(text: str, slash: bool) -> tuple[datetime, str | None]:
    """Return the day, and the hours if they follow it; ``slash`` is True if a slash precedes the clock."""
    tokens = TOKEN.findall(text)
    if "".join(tokens) != text:
        raise _UnknownFormError
    by_day = "//" in tokens
    words = [token.rstrip(".") for token in tokens if token[0].isalpha() and not _names(token, DAYS)]
    numbers = [token for token in tokens if token[0] in "'0123456789"]
    if len(words) > 1 or any(not _names(word, MONTHS) for word in words):
        raise _UnknownFormError
    if not words and len(numbers) == 2 and (by_day or slash):
        return _of_ordinal(numbers), None
    if by_day:
        raise _UnknownFormError
    count = 2 if words else 3
    if len(numbers) not in (count, count + 1):
        raise _UnknownFormError
    hours = numbers[count] if len(numbers) > count else None
    numbers = numbers[:count]
    if any("." in number for number in numbers):
        raise _UnknownFormError("SPICE drops fractions of a day; write the hour")
    if not words:
        return _of_numbers(numbers), hours
    first = next(token for token in tokens if token[0].isdigit() or token[0] == "'" or token.rstrip(".") == words[0])
    return _of_month(_names(words[0], MONTHS), numbers, month_first=first[0].isalpha()), hours


def _names(word: str, names: tuple[str, ...]) -> int:
    """Return the number, from 1, of the known name that a word of at least three letters begins, else 0."""
    word = word.rstrip(".")
    return next((k for k, name in enumerate(names, 1) if len(word) >= 3 and name.startswith(word)), 0)


def _is_year(number: str) -> bool:
    return number[0] == "'" or len(number) == 4


def _year(number: str) -> int:
    digits = number.lstrip("'")
    if len(digits) == 4:
        return int(digits)
    if len(digits) > 2:
        raise _UnknownFormError("years have two or four digits")
    return FIRST_SHORT_YEAR + (int(digits) - FIRST_SHORT_YEAR) % 100


def _of_ordinal(numbers: list[str]) -> datetime:
    """Return the day of a year and a day of the year, of which the year has four digits or stands first."""
    year, day = reversed(numbers) if _is_year(numbers[1]) else numbers
    if not day.isdigit() or len(day) > 3:
        raise _UnknownFormError
    return _day_of_year(_year(year), int(day))


def _of_numbers(numbers: list[str]) -> datetime:
    """Return the day of three numbers: year, month and day where a year of four digits comes first, else month, day and year."""
    year, month, day = numbers if _is_year(numbers[0]) else (numbers[2], *numbers[:2])
    if any(len(part) > 2 or not part.isdigit() for part in (month, day)):
        raise _UnknownFormError
    return datetime(_year(year), int(month), int(day))


def _of_month(month: int, numbers: list[str], month_first: bool) -> datetime:
    """Return the day of a month and two numbers; short ones are day and year behind a month, else year and day."""
    years = [_is_year(number) for number in numbers]
    year, day = reversed(numbers) if years[1] or month_first else numbers
    if all(years) or (month_first and years[0]) or len(day) > 2:
        raise _UnknownFormError
    return datetime(_year(year), month, int(day))
