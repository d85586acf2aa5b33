"""Comparison of recordings that were made on different processors, which round differently."""

import pytest

RELATIVE, ABSOLUTE = 1e-9, 1e-7
"""Tolerances: angles, rates and fractions are of the order of 1, positions of 1e6 m."""


def to_rounding(recorded: object) -> object:
    """Return a value of JSON in which every float equals one that differs from it by rounding errors."""
    match recorded:
        case dict():
            return {key: to_rounding(value) for key, value in recorded.items()}
        case list():
            return [to_rounding(value) for value in recorded]
        case float():
            return pytest.approx(recorded, rel=RELATIVE, abs=ABSOLUTE, nan_ok=True)
        case _:
            return recorded
