"""Counter-based random numbers, and the distributions that ``sat_args`` and ``world_args`` accept.

A draw depends only on the seed, the environment's index, its episode and the name of the argument: environment 7 has the same
episodes in a batch of 8 and in one of 8192, whatever the others do. The generator is Philox4x32-10 (Salmon et al., "Parallel
random numbers: as easy as 1, 2, 3", 2011).
"""

from __future__ import annotations

import logging
import math
import random
import zlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch._checks import no_gradient, number, text, whole
from bsk_torch.astro.elements import ClassicElements
from bsk_torch.astro.ephemeris import et_of_dates
from bsk_torch.codegen.build import entry, load

__all__ = [
    "Blend",
    "Choice",
    "Distribution",
    "Key",
    "Normal",
    "PerEnv",
    "RandomEpoch",
    "RandomOrbit",
    "Uniform",
    "UnitVector",
    "blended",
    "per_env",
    "random_circular_orbit",
    "random_epoch",
    "random_orbit",
    "random_unit_vector",
]

logger = logging.getLogger(__name__)

WORD_MASK = 0xFFFFFFFF
"""Lowest 32 bits."""

PHILOX_MULTIPLIERS = np.uint64(0xD2511F53), np.uint64(0xCD9E8D57)
PHILOX_WEYL = np.uint64(0x9E3779B9), np.uint64(0xBB67AE85)
LOW_WORD, WORD_BITS = np.uint64(WORD_MASK), np.uint64(32)

BLOCK_BITS = 20
"""Bits of the first counter word that number the blocks of a draw; the other 12 hold the satellite."""

MOST_SATELLITES = 1 << (32 - BLOCK_BITS)

HIGH_WORDS = zlib.crc32(b"high words of environment and episode")
"""Stream of the keys of environments and episodes from 2**32 on."""

MOMENTS = 0x1E3779B97F4A7C15
"""Odd number multiplied by ticks to change the seed, so that every moment of an episode has separate random numbers."""

SEED_BITS = 2**63 - 1

BLOCKS_AT_ONCE = 1 << 14
"""Philox blocks that NumPy draws at once, so that their words stay in the processor's cache."""

SOURCE = Path(__file__).with_name("philox.cpp")


@cache
def philox_kernel() -> Callable[..., None] | None:
    """Return the function that draws uniform numbers in C++, 14 times as fast as NumPy; None where there is no compiler."""
    try:
        return entry(load(SOURCE.read_text(), "random numbers"), "iiii" + "ppppp")
    except RuntimeError as error:
        logger.info("random numbers are drawn by NumPy, which is slower and gives the same ones: %s", error)
        return None


MONTHS = ("JAN", "FEB", "MAR", "APR", "MAY", "JUN", "JUL", "AUG", "SEP", "OCT", "NOV", "DEC")


def philox(counter: Sequence[Tensor], key: Sequence[Tensor]) -> tuple[Tensor, ...]:
    """Return four random 32-bit numbers, in int64, for four counter words and two key words of one shape, on the CPU.

    A round multiplies two counter words by constants, and exchanges and mixes high and low halves with the key::

        (c0, c1, c2, c3) <- (hi(M1 c2) ^ c1 ^ k0, lo(M1 c2), hi(M0 c0) ^ c3 ^ k1, lo(M0 c0))
        (k0, k1)         <- (k0 + W0, k1 + W1)

    See the reference at the top of the module.
    """
    c0, c1, c2, c3 = (word.numpy().astype(np.uint64) for word in counter)
    k0, k1 = (word.numpy().astype(np.uint64) for word in key)
    for _ in range(10):
        p0, p1 = c0 * PHILOX_MULTIPLIERS[0], c2 * PHILOX_MULTIPLIERS[1]
        c0, c1, c2, c3 = (p1 >> WORD_BITS) ^ c1 ^ k0, p1 & LOW_WORD, (p0 >> WORD_BITS) ^ c3 ^ k1, p0 & LOW_WORD
        k0, k1 = (k0 + PHILOX_WEYL[0]) & LOW_WORD, (k1 + PHILOX_WEYL[1]) & LOW_WORD
    return tuple(torch.from_numpy(word.astype(np.int64)) for word in (c0, c1, c2, c3))


@dataclass(frozen=True)
class Key:
    """Key of the random numbers of n environments.

    Attributes:
        seed: Seed, [n] int64.
        env_id: Index of each environment, [n] int64.
        episode: Number of each environment's episode, [n] int64.
        name: Name of the drawn quantity.
        satellite: Number of the satellite that a row belongs to, [n] int64; None, which is the same as zeros, for quantities
            of a whole environment.
        moment: Ticks since reset at which the quantity is drawn, [n] int64; None for what is drawn once for an episode.
    """

    seed: Tensor
    env_id: Tensor
    episode: Tensor
    name: str = ""
    satellite: Tensor | None = None
    moment: Tensor | None = None

    def named(self, name: str) -> Key:
        """Return the key of another quantity; ValueError for anything but a string."""
        text("name of key.named", name)
        return replace(self, name=name)

    def of_satellites(self, index: Tensor) -> Key:
        """Return the key with a row for each satellite in ``index`` [S] of every environment, [n * S] rows, environment-major."""
        each = torch.arange(len(self)).repeat_interleave(len(index))
        return replace(self._rows(each), satellite=index.to(self.seed.device).repeat(len(self)))

    def __len__(self) -> int:
        return len(self.env_id)

    def split(self, rows: int) -> list[Key]:
        """Return keys of at most ``rows`` environments each, in order."""
        return [self._rows(index) for index in torch.arange(len(self)).split(rows)]

    def take(self, rows: Sequence[int]) -> Key:
        """Return the key of some of its environments."""
        return self._rows(torch.tensor(rows, dtype=torch.int64))

    def _rows(self, index: Tensor) -> Key:
        satellite, moment = (None if x is None else x[index] for x in (self.satellite, self.moment))
        return Key(self.seed[index], self.env_id[index], self.episode[index], self.name, satellite, moment)

    def uniform(self, count: int) -> Tensor:
        """Return uniform float64 numbers in [0, 1), [n, count], with 53 random bits each; see also :func:`blended`.

        ValueError for a ``count`` that is not a whole number.
        """
        whole("count", count, 0)
        return self._independent(count) if _blend is None else _blend.uniform(self, count)

    def _independent(self, count: int) -> Tensor:
        """Return the numbers of the seeds themselves; see :meth:`uniform`."""
        kernel = philox_kernel()
        if kernel is None:
            rows = max(1, BLOCKS_AT_ONCE // max(1, (count + 1) // 2))
            return self._uniform(count) if len(self) <= rows else torch.cat([part._uniform(count) for part in self.split(rows)])
        numbers = torch.empty(len(self), count, dtype=torch.float64)
        first = None if self.satellite is None else self._contiguous(self.satellite) << BLOCK_BITS
        key = [self._contiguous(word) for word in (self._seed(), self.env_id, self.episode)]
        kernel(len(self), count, zlib.crc32(self.name.encode()), HIGH_WORDS, *key, first, numbers)
        return numbers

    def _contiguous(self, words: Tensor) -> Tensor:
        """Return words of the key as the kernel reads them, by address; ValueError for a wrong number of them."""
        if words.shape != self.env_id.shape:
            raise ValueError(f"a key of {len(self)} environments has a part of shape {list(words.shape)}")
        return words.to("cpu", torch.int64).contiguous()

    def _seed(self) -> Tensor:
        """Return the seed of each row at its moment, [n]."""
        return self.seed if self.moment is None else (self.seed ^ (self.moment + 1) * MOMENTS) & SEED_BITS

    def _uniform(self, count: int) -> Tensor:
        """Return the numbers by NumPy."""
        blocks = (count + 1) // 2
        shape = (len(self), blocks)
        stream = torch.full(shape, zlib.crc32(self.name.encode()), device=self.env_id.device)
        block = torch.arange(blocks, device=self.env_id.device).expand(shape)
        if self.satellite is not None:
            block = block + (self.satellite << BLOCK_BITS).unsqueeze(-1)
        counter = [block, *((x & WORD_MASK).unsqueeze(-1).expand(shape) for x in (self.episode, self.env_id)), stream]
        key = [word.unsqueeze(-1).expand(shape) for word in self._key_words()]
        words = torch.stack(philox(counter, key), -1).reshape(len(self), blocks * 2, 2)
        high, low = words[..., 0] >> 5, words[..., 1] >> 6
        return ((high * 67108864 + low).double() / 9007199254740992.0)[:, :count]

    def _key_words(self) -> list[Tensor]:
        """Return the two key words, [n] each: those of the seed, exchanged where environment or episode do not fit into 32 bits.

        The counter has their low words. Where there are high words, Philox of them under the seed gives another key, so that all
        64 bits count, and numbers below 2**32 have the seed itself as their key.
        """
        seed = self._seed()
        key = [seed & WORD_MASK, (seed >> 32) & WORD_MASK]
        high = [(x >> 32) & WORD_MASK for x in (self.episode, self.env_id)]
        large = (high[0] | high[1]) != 0
        if not bool(large.any()):
            return key
        zero = torch.zeros_like(self.seed)
        other = philox([zero, *high, torch.full_like(zero, HIGH_WORDS)], key)
        return [torch.where(large, new, old) for new, old in zip(other[:2], key, strict=True)]

    def normal(self, count: int) -> Tensor:
        """Return standard normal float64 numbers [n, count], by the Box-Muller transform ``sqrt(-2 ln(1 - u)) cos(2 pi u')``.

        See also :func:`blended`. ValueError for a ``count`` that is not a whole number.
        """
        whole("count", count, 0)
        return self._independent_normal(count) if _blend is None else _blend.normal(self, count)

    def _independent_normal(self, count: int) -> Tensor:
        """Return the numbers of the seeds themselves; see :meth:`normal`."""
        u = self._independent(2 * count)
        radius = torch.sqrt(-2.0 * torch.log1p(-u[:, :count]))
        return radius * torch.cos(2.0 * math.pi * u[:, count:])

    def distinct(self, count: int, options: int) -> Tensor:
        """Return ``count`` different indices below ``options`` in random order, [n, count] int64; ValueError if there are fewer.

        Every ordered selection is equally likely: indices are drawn one after the other, and repeated ones are skipped.
        """
        if not 0 < count <= options:
            raise ValueError(f"count={count} different indices cannot be drawn from options={options}; allowed is 1 to {options}")
        if 2 * count > options:
            return self.uniform(options).argsort(dim=-1, stable=True)[:, :count]
        draws = count + 2 * count * count // options + 16  # twice as many repeats as expected
        while True:
            picks = (self.uniform(draws) * options).long()
            first = _first_occurrences(picks)
            if bool((first.sum(-1) >= count).all()):
                return picks.gather(-1, (~first).byte().argsort(dim=-1, stable=True)[:, :count])
            draws *= 2  # longer draws begin like shorter ones, so this changes no row that had enough


def _first_occurrences(values: Tensor) -> Tensor:
    """Return whether an entry of ``values`` [n, m] differs from all entries before it in its row."""
    ordered, where = values.sort(dim=-1, stable=True)
    new = torch.ones_like(ordered, dtype=torch.bool)
    new[:, 1:] = ordered[:, 1:] != ordered[:, :-1]
    return torch.zeros_like(new).scatter(-1, where, new)


def first_key(n: int) -> Key:
    """Return the key of the first episodes of environments 0 to n - 1 under seed 0, for trial draws."""
    zeros = torch.zeros(n, dtype=torch.int64)
    return Key(zeros, torch.arange(n), zeros)


# -- blended seeds -----------------------------------------------------------------------------------------------------------

LEAST = 2.0**-54
"""Half the smallest distance of two uniform numbers: bound of the numbers that are converted to normal ones."""

MOST_BLENDED = 1 << 21
"""Numbers of parts drawn at once."""


@dataclass(frozen=True)
class Blend:
    """Seeds whose random numbers are blended from those of others, in small steps from one draw to another one.

    Blended numbers start from those of the first part. Each further part, of step s in (0, 1], changes a normal number z to
    ``sqrt(1 - s^2) z + s z'``, where z' is its own, and a uniform number u likewise as ``Phi^-1(u)``, with the normal
    distribution function ``Phi``. It changes each quantity, by name, satellite and moment, with the probability ``share``, and
    leaves others unchanged. So blended numbers have the distribution of all others, and a part with a small step or share
    changes little. A seed whose only part is the seed itself keeps its numbers.

    Attributes:
        seeds: Blended seeds, [M] int64, all different.
        parts: Seeds that they are made of, in order, [M, J] int64.
        steps: Steps of the parts, [M, J] float64; 1 for the first part, and 0 for parts that do not count.
        shares: Shares of the parts, [M, J] float64; 1 for the first part.

    Raises:
        ValueError: For other shapes, repeated seeds, and steps or shares out of range.
    """

    seeds: Tensor
    parts: Tensor
    steps: Tensor
    shares: Tensor

    def __post_init__(self) -> None:
        m, shapes = len(self.seeds), [list(table.shape) for table in (self.parts, self.steps, self.shares)]
        if m == 0 or any(shape != shapes[0] or len(shape) != 2 or shape[0] != m or shape[1] == 0 for shape in shapes):
            raise ValueError(f"Blend: parts, steps and shares of {m} seeds have shapes {shapes}; they must be [M, J] of M seeds")
        if len(self.seeds.unique()) < m:
            raise ValueError("Blend: seeds are repeated; each may be there once only")
        for name, table in (("steps", self.steps), ("shares", self.shares)):
            if not bool(((table >= 0.0) & (table <= 1.0)).all()) or not bool((table[:, 0] == 1.0).all()):
                raise ValueError(f"Blend: {name} must be from 0 to 1, and 1 for the first part")
        order = self.seeds.argsort()
        for name in ("seeds", "parts", "steps", "shares"):
            object.__setattr__(self, name, getattr(self, name)[order])

    def uniform(self, key: Key, count: int) -> Tensor:
        """Return the numbers of a key, [n, count]; see :meth:`Key.uniform`."""

        def normal(part: Key) -> Tensor:
            return torch.special.ndtri(part._independent(count).clamp(min=LEAST))

        rows, mixed = self._mixed(key, count, normal)
        return key._independent(count).index_copy(0, rows, torch.special.ndtr(mixed).clamp(max=1.0 - 2.0 * LEAST))

    def normal(self, key: Key, count: int) -> Tensor:
        """Return the numbers of a key, [n, count]; see :meth:`Key.normal`."""
        rows, mixed = self._mixed(key, count, lambda part: part._independent_normal(count))
        return key._independent_normal(count).index_copy(0, rows, mixed)

    def _mixed(self, key: Key, count: int, normal: Callable[[Key], Tensor]) -> tuple[Tensor, Tensor]:
        """Return the rows [m] of a key with blended seeds, and their normal numbers, [m, count]."""
        place = torch.searchsorted(self.seeds, key.seed).clamp(max=len(self.seeds) - 1)
        itself = (self.parts[:, 0] == self.seeds) & (self.steps[:, 1:] == 0.0).all(1)
        rows = torch.nonzero((self.seeds[place] == key.seed) & ~itself[place]).squeeze(1)
        totals = [torch.zeros(0, count, dtype=torch.float64)]
        for block in rows.split(max(1, MOST_BLENDED // (self.parts.shape[1] * max(count, 1)))):
            parts, steps, shares = (table[place[block]] for table in (self.parts, self.steps, self.shares))
            part_key = replace(key._rows(block.repeat_interleave(parts.shape[1])), seed=parts.flatten())
            changes = part_key.named(f"{key.name} changes")._independent(1).view(parts.shape) < shares
            step = torch.where(changes, steps, 0.0)
            keep, numbers = (1.0 - step.square()).sqrt(), normal(part_key).view(*parts.shape, count)
            total = torch.zeros(len(block), count, dtype=torch.float64)
            for j in range(parts.shape[1]):
                total = keep[:, j, None] * total + step[:, j, None] * numbers[:, j]
            totals.append(total)
        return rows, torch.cat(totals)


_blend: Blend | None = None
"""The blend in whose context numbers are drawn."""


@contextmanager
def blended(blend: Blend) -> Iterator[None]:
    """Give the seeds of a blend its numbers, wherever keys draw within this context; other seeds keep their own.

    An environment that is reset to a blended seed, and flown to the end of the episode, within the context plays the episode of
    the blended numbers: initial states, scenarios, faults, noise, and random numbers of policies.

    Example:
        >>> one = torch.ones(1, 2, dtype=torch.float64)
        >>> with blended(Blend(torch.tensor([9]), torch.tensor([[1, 2]]), torch.tensor([[1.0, 0.1]]), one)):
        ...     env.reseed(9)
        ...     env.rollout(100, policy)
    """
    global _blend
    before = _blend
    _blend = blend
    try:
        yield
    finally:
        _blend = before


# -- user functions ----------------------------------------------------------------------------------------------------------

_drawing = False
"""Whether a function of the user's is being called to draw a value."""


@contextmanager
def seeded(key: Key, reseed: bool = False) -> Iterator[Iterator[Key]]:
    """Seed the global generators of NumPy, ``random`` and torch for user functions that draw values with them.

    Iterating over the result gives the key of each environment, and seeds the generators from it before; what a function draws
    then depends on nothing but the key. Their states are put back at the end. Where one of these contexts contains another, the
    outer one seeds, unless the inner one is to ``reseed``. Gradients are recorded, so that a value that depends on parameters can
    be told, see :func:`bsk_torch._checks.no_gradient`.
    """
    global _drawing
    rows = (key.take([k]) for k in range(len(key)))
    if _drawing and not reseed:
        yield rows
        return
    states, within = (np.random.get_state(), random.getstate(), torch.default_generator.get_state()), _drawing
    _drawing = True
    try:
        with torch.enable_grad():
            yield _seeded_rows(key, rows)
    finally:
        _drawing = within
        np.random.set_state(states[0])
        random.setstate(states[1])
        torch.default_generator.set_state(states[2])


def _seeded_rows(key: Key, rows: Iterator[Key]) -> Iterator[Key]:
    words = (key.named(f"{key.name} functions").uniform(3) * 2.0**32).long().tolist()
    for row, (first, second, third) in zip(rows, words, strict=True):
        np.random.seed([first, second])
        random.seed(second << 32 | third)
        torch.default_generator.manual_seed(third << 32 | first)
        yield row


# -- distributions ---------------------------------------------------------------------------------------------------------------


class Distribution:
    """A value drawn for each environment at each reset. Subclasses define :meth:`draw`."""

    def draw(self, key: Key) -> Tensor | list[Any]:
        """Return the values of the key's n environments: a float64 tensor [n, ...] or a list of n objects."""
        raise TypeError(f"{type(self).__name__} must implement draw(key)")


MOST = 1e300
"""Bound of the numbers of distributions: their differences are finite."""


def _check_numbers(**arguments: object) -> None:
    """Raise ValueError for numbers, or sequences of them, that are not finite; the names are those of the arguments."""
    for name, value in arguments.items():
        if type(value) is float and -MOST <= value <= MOST:
            continue
        no_gradient(name, value)
        try:
            table = torch.as_tensor(value, dtype=torch.float64)
            wrong = not table.numel() or not bool((table.abs() <= MOST).all())
        except (TypeError, ValueError, RuntimeError, OverflowError):
            wrong = True
        if wrong:
            raise ValueError(f"{name}={value!r} must be a finite number, or a sequence of them")


def _check_size(size: object) -> None:
    if size is not None:
        whole("size", size, 1)


def _sized(values: Tensor, size: int | None) -> Tensor:
    return values.squeeze(-1) if size is None else values


@dataclass(frozen=True)
class Uniform(Distribution):
    """Uniform in [low, high); ``size`` numbers each, or one number if None. Bounds may be sequences, which then set the size."""

    low: float | Sequence[float] = 0.0
    high: float | Sequence[float] = 1.0
    size: int | None = None

    def __post_init__(self) -> None:
        _check_numbers(low=self.low, high=self.high)
        _check_size(self.size)
        if bool((torch.as_tensor(self.low) > torch.as_tensor(self.high)).any()):
            raise ValueError(f"low={self.low!r} must not be above high={self.high!r}")

    @override
    def draw(self, key: Key) -> Tensor:
        low, high = (torch.as_tensor(x, dtype=torch.float64, device=key.env_id.device) for x in (self.low, self.high))
        size = self.size or max((len(bound) for bound in (low, high) if bound.ndim), default=None)
        u = key.uniform(size or 1)
        return _sized(low + (high - low) * u, size)


@dataclass(frozen=True)
class Normal(Distribution):
    """Normal with the given mean and standard deviation; ``size`` numbers each, or one number if None."""

    mean: float = 0.0
    std: float = 1.0
    size: int | None = None

    def __post_init__(self) -> None:
        _check_numbers(mean=self.mean, std=self.std)
        for name, value in (("mean", self.mean), ("std", self.std)):
            if isinstance(value, list | tuple):
                raise ValueError(f"{name}={value!r} must be a number, or a tensor of several")
        if bool((torch.as_tensor(self.std) < 0.0).any()):
            raise ValueError(f"std={self.std!r} must not be negative")
        _check_size(self.size)

    @override
    def draw(self, key: Key) -> Tensor:
        return _sized(self.mean + self.std * key.normal(self.size or 1), self.size)


@dataclass(frozen=True)
class Choice(Distribution):
    """One of ``options`` with equal probability; ``size`` of them each (repeats allowed), or one if None.

    Drawn values are a list, or a tensor [n, size] if a size is set and all options are numbers.
    """

    options: tuple[object, ...]
    size: int | None = field(default=None, repr=False)

    def __init__(self, options: Sequence[object], size: int | None = None) -> None:
        """Choose among ``options``, a non-empty sequence."""
        if isinstance(options, str | type) or not hasattr(options, "__len__") or not hasattr(options, "__getitem__"):
            raise ValueError(f"options={options!r} must be a sequence, such as [1.0, 2.0]")
        _check_size(size)
        if len(options) == 0:
            raise ValueError("options is empty; Choice needs at least one option")
        object.__setattr__(self, "options", tuple(options))
        object.__setattr__(self, "size", size)

    @override
    def draw(self, key: Key) -> Tensor | list[Any]:
        picks = (key.uniform(self.size or 1) * len(self.options)).long()
        if self.size is None:
            return [self.options[i] for i in picks.squeeze(-1).tolist()]
        if all(isinstance(option, int | float) for option in self.options):
            return torch.tensor(self.options, dtype=torch.float64)[picks]
        return [[self.options[i] for i in row] for row in picks.tolist()]


@dataclass(frozen=True)
class PerEnv(Distribution):
    """Row i for environment i, at every reset."""

    values: Any

    def draw(self, key: Key) -> Tensor | list[Any]:
        """Return the rows of the key's environments; ValueError if there are too few."""
        if int(key.env_id.max()) >= len(self.values):
            of = f"{key.name}: " if key.name else ""
            raise ValueError(f"{of}per_env has {len(self.values)} rows, but environment {int(key.env_id.max())} needs one")
        rows = key.env_id.tolist()
        if isinstance(self.values, Tensor):
            return self.values[key.env_id.to(self.values.device)]
        return [self.values[i] for i in rows]


def per_env(values: object) -> PerEnv:
    """Return the distribution that gives row i of ``values`` to environment i, at every reset.

    ``values`` is a tensor, an array or a list, which may hold strings.
    """
    return PerEnv(values)


@dataclass(frozen=True)
class RandomOrbit(Distribution):
    """Orbital elements [n, 6] (a in m, angles in rad); None stands for a uniform draw. See :func:`random_orbit`."""

    a: float
    e: float
    i: float | None
    Omega: float | None
    omega: float | None
    f: float | None

    @override
    def draw(self, key: Key) -> Tensor:
        u = key.uniform(4)
        columns = [torch.full_like(u[:, 0], x) for x in (self.a, self.e)]
        for k, angle in enumerate((self.i, self.Omega, self.omega, self.f)):
            free = math.pi * (2.0 * u[:, k] - (1.0 if k == 0 else 0.0))
            columns.append(free if angle is None else torch.full_like(free, math.radians(angle)))
        return torch.stack(columns, -1)


def random_orbit(
    i: float | None = None,
    a: float = 6871.0,
    e: float = 0.0,
    Omega: float | None = None,
    omega: float | None = None,
    f: float | None = None,
    alt: float | None = None,
    r_body: float = 6371.0,
) -> Any:
    """Return a distribution of orbital elements.

    Within a user function that draws a value, it returns drawn elements instead,
    :class:`~bsk_torch.astro.elements.ClassicElements`, from NumPy's global generator.

    Args:
        i: Inclination, degrees; None for uniform in [-180, 180).
        a: Semi-major axis, km.
        e: Eccentricity, at least 0 and below 1.
        Omega: Right ascension of the ascending node, degrees; None for uniform in [0, 360).
        omega: Argument of perigee, degrees; likewise.
        f: True anomaly, degrees; likewise.
        alt: Altitude above ``r_body``, km, of a circular orbit with ``omega = 0``, in place of ``a``, ``e`` and ``omega``; the
            old form of :func:`random_circular_orbit`.
        r_body: Radius from which ``alt`` counts, km.
    """
    if alt is not None:
        if (a, e, omega) != (6871.0, 0.0, None):
            ignored = f"a={a}, e={e} and omega={omega}"
            logger.warning("random_orbit(alt=%g): %s do not count, the orbit is circular", alt, ignored)
        return random_circular_orbit(i, alt, r_body, Omega, f)
    for name, angle in (("i", i), ("Omega", Omega), ("omega", omega), ("f", f)):
        if angle is not None:
            number(name, angle, unit="degrees", none=True)
    e = number("e", e, 0.0, math.nextafter(1.0, 0.0))
    orbit = RandomOrbit(number("a", a, 0.0, 1e9, unit="km", above=True) * 1e3, e, i, Omega, omega, f)
    return _elements(orbit) if _drawing else orbit


def random_circular_orbit(
    i: float | None = None,
    alt: float = 500.0,
    r_body: float = 6371.0,
    Omega: float | None = None,
    f: float | None = None,
) -> object:
    """Return a distribution of circular orbits with argument of perigee zero; like :func:`random_orbit`.

    Args:
        i: Inclination, degrees; None for uniform in [-180, 180).
        alt: Altitude above ``r_body``, km.
        r_body: Radius from which ``alt`` counts, km.
        Omega: Right ascension of the ascending node, degrees; None for uniform in [0, 360).
        f: True anomaly, degrees; likewise.
    """
    radius = number("r_body", r_body, 0.0, 1e9, unit="km") + number("alt", alt, -1e9, 1e9, unit="km")
    return random_orbit(i, radius, 0.0, Omega, 0.0, f)


def _elements(orbit: RandomOrbit) -> ClassicElements:
    """Return elements that NumPy's global generator draws, in a fixed order of draws."""
    angles = []
    for k, angle in enumerate((orbit.i, orbit.Omega, orbit.omega, orbit.f)):
        low, high = (-math.pi, math.pi) if k == 0 else (0.0, 2.0 * math.pi)
        angles.append(float(np.random.uniform(low, high)) if angle is None else math.radians(angle))
    return ClassicElements(orbit.a, orbit.e, *angles)


@dataclass(frozen=True)
class UnitVector(Distribution):
    """Directions that are uniform over the sphere, [n, 3]."""

    @override
    def draw(self, key: Key) -> Tensor:
        vector = key.normal(3)
        return vector / torch.linalg.vector_norm(vector, dim=-1, keepdim=True)


def random_unit_vector() -> Any:
    """Return a distribution of unit vectors that are uniform over the sphere.

    Within a user function that draws a value, it returns a drawn vector [3] instead, from NumPy's global generator.
    """
    if not _drawing:
        return UnitVector()
    vector = np.random.randn(3)
    return vector / np.linalg.norm(vector)


@dataclass(frozen=True)
class RandomEpoch(Distribution):
    """Epochs as strings. See :func:`random_epoch`."""

    start: int
    end: int

    @override
    def draw(self, key: Key) -> list[str]:
        return self.at(key.uniform(7))

    def at(self, u: Tensor | np.ndarray) -> list[str]:
        """Return the epochs for uniform numbers in [0, 1), [n, 7]."""
        rows = self._dates(u).tolist()
        return [f"{y} {MONTHS[mo - 1]} {d:02d} {h:02d}:{mi:02d}:{s:02d}.{ms:03d} (UTC)" for y, mo, d, h, mi, s, ms in rows]

    def draw_et(self, key: Key) -> Tensor:
        """Return the same epochs as :meth:`draw` as ET, [n] s past J2000, without a word in between."""
        return et_of_dates(self._dates(key.uniform(7)))

    def _dates(self, u: Tensor | np.ndarray) -> Tensor:
        """Return year, month, day, hour, minute, second and millisecond for uniform numbers in [0, 1), [n, 7]."""
        spans = torch.tensor([self.end - self.start, 12, 27, 23, 59, 59, 999])
        return (torch.as_tensor(u).cpu() * spans).long() + torch.tensor([self.start, 1, 1, 0, 0, 0, 0])


def random_epoch(start: int = 2000, end: int = 2022) -> Any:
    """Return a distribution of epochs in the years ``start`` to ``end - 1``.

    Days are at most 27, hours 22, minutes and seconds 58 and milliseconds 998. Within a user function
    that draws a value, it returns a drawn epoch instead, from NumPy's global generator. ValueError for an empty range.
    """
    whole("start", start, 1)
    whole("end", end, 1, 9999)
    if not start < end:
        raise ValueError(f"random_epoch(start={start}, end={end}): the first year must come before the last")
    epochs = RandomEpoch(start, end)
    return epochs.at(np.random.rand(1, 7))[0] if _drawing else epochs


MAKERS = (random_orbit, random_circular_orbit, random_unit_vector, random_epoch)
"""Functions that return a distribution where they are called without arguments."""


def as_value(value: Any) -> Any:
    """Return the value of an argument, which for :func:`random_orbit` and the like, given uncalled, is what they return."""
    return value() if any(value is maker for maker in MAKERS) else value
