"""Compares what a page's blocks print with what the comment behind a print says.

A comment quotes results in one of these forms, several of them separated by semicolons: ``True`` or ``False``; a list of numbers
or truth values, which is what is printed or the shape of it; numbers, with a unit or words behind them; the beginning of the text
that is printed, if it starts with a brace or holds parentheses, with ``...`` for what is left out. Other comments explain.
"""

import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

NUMBER = r"-?\d+(?:,\d{3})*(?:\.\d+)?"
BRACKETS = re.compile(r"\[(?:[^\[\]]|\[[^\[\]]*\])*\]")
LIST = re.compile(r"(?:[\d\s,.\[\]-]|True|False)+")
NUMBERS = re.compile(rf"(?:{NUMBER}(?:, | and | to )?)+(?=\s|$)")
TEXT = re.compile(r"[{\w].*[}\)]$")


def quoted(comment: str) -> tuple[list[str], list[list[str]], list[str]]:
    """Texts, lists of numbers, and bracketed lists that a comment quotes."""
    texts, numbers, lists = [], [], [each for each in BRACKETS.findall(comment) if LIST.fullmatch(each)]
    for part in (part.strip() for part in comment.split(";")):
        if part in ("True", "False") or (TEXT.match(part) and re.match(r"\{|\w+\(", part)):
            texts.append(part)
        elif part.startswith("True "):
            texts.append("True")
        elif (found := NUMBERS.match(part)) and not part.startswith("["):
            numbers.append([number.replace(",", "") for number in re.findall(NUMBER, found[0])])
    return texts, numbers, [re.sub(r"\s", "", each) for each in lists]


def contradictions(comment: str, values: tuple[Any, ...]) -> list[str]:
    """What a comment quotes and the printed values are not."""
    texts, numbers, lists = quoted(comment)
    printed = " ".join(map(str, values))
    plain = re.sub(r"\s|tensor\(|torch\.Size\(|array\(", "", printed)
    wrong = [text for text in texts if not re.match(re.escape(text).replace(r"\.\.\.", ".*"), printed, re.DOTALL)]
    shapes = {str(list(value.shape)).replace(" ", "") for value in values if hasattr(value, "shape")}
    shapes |= {re.sub(r"\s", "", str(list(value))) for value in values if isinstance(value, tuple)}
    wrong += [each for each in lists if each not in shapes and each not in plain]
    known = list(_numbers(values))
    for row in numbers:
        wrong += [number for number in row if not any(_agrees(value, number) for value in known)]
    return wrong


def _agrees(value: float, number: str) -> bool:
    """Whether a value rounds to a number, of which the comment has so many decimals."""
    decimals = len(number.partition(".")[2])
    return abs(value - float(number)) <= 0.5 * 10.0**-decimals * (1 + 1e-6)


def _numbers(values: tuple[Any, ...]) -> Iterator[float]:
    for value in values:
        try:
            yield from np.asarray(value, dtype=float).flatten().tolist()
        except (TypeError, ValueError):
            yield from map(float, re.findall(r"-?\d+(?:\.\d+)?(?:e[+-]?\d+)?", str(value)))


def checking_print(path: Path, seen: list[str]) -> Callable[..., None]:
    """A ``print`` for the blocks of a page, which compares; it notes the comments that quote something."""
    lines = path.read_text().splitlines()

    def show(*values: Any, **options: Any) -> None:
        print(*values, **options)  # noqa: T201
        frame = sys._getframe(1)
        if frame.f_code.co_filename != str(path):
            return
        first = lines[frame.f_lineno - 1]
        last = first if not first.endswith("(") else next(line for line in lines[frame.f_lineno :] if line.startswith(")"))
        comment = last.partition("  # ")[2].strip()
        if comment and any(quoted(comment)):
            seen.append(comment)
            assert not (wrong := contradictions(comment, values)), f"line {frame.f_lineno}: {wrong} of {comment!r}: {values}"

    return show
