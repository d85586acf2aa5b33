"""Confidence intervals of means and fractions."""

from __future__ import annotations

from dataclasses import dataclass
from statistics import NormalDist

from torch import Tensor


@dataclass(frozen=True)
class Estimate:
    """A mean and the half width of its confidence interval."""

    mean: float
    half_width: float

    def __str__(self) -> str:
        return f"{self.mean:.3f} ± {self.half_width:.3f}"


def mean(samples: Tensor) -> float:
    """Return the mean of numbers or booleans, in float64."""
    return float(samples.double().mean())


def student_quantile(probability: float, freedom: int) -> float:
    """Return a quantile of Student's t distribution, by its expansion about the normal one.

    It is accurate to 1e-3 for six degrees of freedom or more.

    Source: Abramowitz and Stegun, equation 26.7.5.
    """
    x, v = NormalDist().inv_cdf(probability), float(freedom)
    first = (x**3 + x) / 4.0
    second = (5.0 * x**5 + 16.0 * x**3 + 3.0 * x) / 96.0
    third = (3.0 * x**7 + 19.0 * x**5 + 17.0 * x**3 - 15.0 * x) / 384.0
    return x + first / v + second / v**2 + third / v**3


def confidence(samples: Tensor, level: float = 0.95) -> Estimate:
    """Return the mean of independent ``samples`` [n] with Student's confidence interval, which is infinite for one sample."""
    n = len(samples)
    if n < 2:
        return Estimate(mean(samples), float("inf"))
    return Estimate(mean(samples), student_quantile(0.5 + 0.5 * level, n - 1) * float(samples.double().std()) / n**0.5)


def nan_confidence(samples: Tensor) -> Estimate:
    """Return the mean of the ``samples`` [n] that are not NaN with its 95 % confidence interval; NaN if all are."""
    numbers = samples[~samples.isnan()]
    return confidence(numbers) if len(numbers) else Estimate(float("nan"), float("nan"))


def wilson(successes: int, trials: int, level: float = 0.95) -> tuple[float, float]:
    """Return Wilson's confidence interval of a probability, which remains valid near 0 and 1.

    Source: E. B. Wilson, "Probable inference, the law of succession, and statistical inference", J. Am. Stat. Assoc. 22 (1927).
    """
    z = NormalDist().inv_cdf(0.5 + 0.5 * level)
    share, widening = successes / trials, z * z / trials
    centre = (share + 0.5 * widening) / (1.0 + widening)
    half = z * (share * (1.0 - share) / trials + 0.25 * widening / trials) ** 0.5 / (1.0 + widening)
    return max(0.0, centre - half), min(1.0, centre + half)
