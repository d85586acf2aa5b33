import math
import re
from itertools import pairwise

import numpy as np
import pytest
import torch

from bsk_torch import rand
from bsk_torch.astro.ephemeris import parse_utc
from tests.support.refusals import check_refusals, refusal

MANY = 40_000
FIVE_SIGMA = 5.0 / math.sqrt(MANY)  # sampling error of a mean of MANY draws, in standard deviations


def key(n: int = 4, seed: int = 7, episode: int = 0, name: str = "") -> rand.Key:
    ids = torch.arange(n)
    return rand.Key(torch.full_like(ids, seed), ids, torch.full_like(ids, episode), name)


@pytest.mark.parametrize(
    ("counter", "philox_key", "expected"),
    [  # kat_vectors of Random123, philox4x32 with 10 rounds
        ([0] * 4, [0] * 2, [0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8]),
        ([0xFFFFFFFF] * 4, [0xFFFFFFFF] * 2, [0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD]),
        (
            [0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344],
            [0xA4093822, 0x299F31D0],
            [0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1],
        ),
    ],
)
def test_philox_known_answers(counter, philox_key, expected):
    words = rand.philox([torch.tensor([c]) for c in counter], [torch.tensor([k]) for k in philox_key])
    assert [int(word) for word in words] == expected


def test_uniform_uses_53_bits_of_the_first_block():
    """The first number of environment 0, episode 0, seed 0 follows from the generator by hand."""
    name = torch.tensor([0])  # crc32 of the empty string is 0, so counter and key are all zero
    words = rand.philox([name] * 4, [name] * 2)
    expected = ((int(words[0]) >> 5) * 2**26 + (int(words[1]) >> 6)) / 2**53
    assert key(1, seed=0).uniform(1).item() == expected


@pytest.mark.parametrize("method", ["uniform", "normal"])
def test_draws_depend_on_nothing_else(method):
    """Not on the size of the batch, its order, or the number of values asked for beyond the block."""
    big = getattr(key(64), method)(3)
    order = torch.tensor([9, 3, 63, 0])
    part = key(64)
    part = rand.Key(part.seed[order], part.env_id[order], part.episode[order], "")
    assert torch.equal(getattr(part, method)(3), big[order])
    assert torch.equal(getattr(key(2), method)(3), big[:2])


def test_longer_draws_begin_like_shorter_ones_and_chunks_do_not_show(monkeypatch):
    assert torch.equal(key(5).uniform(7)[:, :4], key(5).uniform(4))
    whole = key(50).uniform(7)
    monkeypatch.setattr(rand, "philox_kernel", lambda: None)
    monkeypatch.setattr(rand, "BLOCKS_AT_ONCE", 9)  # two rows at a time, and one where a row is larger than that
    assert torch.equal(key(50).uniform(7), whole)
    assert torch.equal(key(3).uniform(101)[:, :7], whole[:3])


@pytest.mark.parametrize("count", [0, 1, 2, 7, 100])
def test_numpy_draws_the_numbers_of_the_kernel(count, monkeypatch, caplog):
    """Without a compiler nothing else changes: for large and negative words, several satellites and moments, too."""
    words = torch.tensor([0, 3, 2**32 - 1, 2**32, 2**62 + 5, -1])
    keys = [rand.Key(words, words.flip(0), words.roll(1), "a"), key(9, name="b").of_satellites(torch.tensor([0, 4095]))]
    keys.append(rand.Key(words, words, words, "c", satellite=torch.arange(6), moment=torch.tensor([0, 1, 10**9, 2**40, 7, 8])))
    kernel = [each.uniform(count) for each in keys]
    caplog.set_level("INFO", "bsk_torch.rand")

    def load(source, name):
        raise RuntimeError("no compiler")

    monkeypatch.setattr(rand, "load", load)
    monkeypatch.setattr(rand, "philox_kernel", rand.philox_kernel.__wrapped__)
    assert all(torch.equal(each.uniform(count), numbers) for each, numbers in zip(keys, kernel, strict=True))
    assert "no compiler" in caplog.text


def test_every_part_of_the_key_matters():
    base = key(3).uniform(2)
    others = [key(3, seed=8), key(3, episode=1), key(3, name="a"), key(3, seed=7 + 2**32), key(3, seed=-7)]
    for other in others:
        assert (other.uniform(2) != base).all()
    assert (key(3, name="a").uniform(2) != key(3).named("b").uniform(2)).all()
    assert torch.equal(key(3, name="a").uniform(2), key(3).named("a").uniform(2))


def test_moments_of_uniform_and_normal_numbers():
    u = key(MANY).uniform(2)
    assert ((u >= 0) & (u < 1)).all()
    assert u.mean(0) - 0.5 == pytest.approx([0, 0], abs=FIVE_SIGMA * 12**-0.5)
    assert u.var(0) == pytest.approx([1 / 12] * 2, abs=FIVE_SIGMA / 12)
    assert torch.corrcoef(u.T)[0, 1].abs() < FIVE_SIGMA
    assert torch.corrcoef(torch.stack([u[1:, 0], u[:-1, 0]]))[0, 1].abs() < FIVE_SIGMA  # neighbouring environments
    z = key(MANY).normal(1)[:, 0]
    assert z.mean().abs() < FIVE_SIGMA
    assert (z**2).mean() - 1 == pytest.approx(0, abs=FIVE_SIGMA * 2**0.5)
    assert (z**3).mean() == pytest.approx(0, abs=FIVE_SIGMA * 15**0.5)
    assert (z**4).mean() == pytest.approx(3, abs=FIVE_SIGMA * 96**0.5)
    assert torch.isfinite(z).all()


def skipping(stream, count, options):
    """The first ``count`` different indices that a stream of uniform numbers stands for."""
    return list(dict.fromkeys(int(u * options) for u in stream))[:count]


@pytest.mark.parametrize(("count", "options"), [(1, 1), (1, 2), (4, 8), (5, 8), (8, 8), (30, 100), (100, 34_000)])
def test_distinct_indices(count, options):
    picks = key(64).distinct(count, options)
    assert (picks.shape, picks.dtype) == ((64, count), torch.int64)
    assert 0 <= picks.min() <= picks.max() < options
    assert (picks.sort(dim=-1).values.diff(dim=-1) > 0).all()
    assert torch.equal(key(2).distinct(count, options), picks[:2])
    if 2 * count <= options:
        stream = key(64).uniform(4 * count + 64)
        assert picks.tolist() == [skipping(row, count, options) for row in stream.tolist()]


@pytest.mark.parametrize(("count", "options"), [(3, 8), (3, 5)])
def test_every_ordered_selection_is_as_likely(count, options):
    """Chi-square over all ordered selections, at five standard deviations above its mean, the degrees of freedom."""
    picks = key(MANY).distinct(count, options)
    cells = math.perm(options, count)
    code = (picks * torch.tensor([options**k for k in range(count)])).sum(-1)
    _, counts = code.unique(return_counts=True)
    assert len(counts) == cells
    chi2 = float(((counts - MANY / cells) ** 2 / (MANY / cells)).sum())
    assert abs(chi2 - (cells - 1)) < 5 * math.sqrt(2 * (cells - 1))


def test_unlucky_rows_draw_more_and_change_no_other(monkeypatch):
    plain, original = key(6).distinct(4, 20), rand.Key.uniform

    def unlucky(self, count):
        u = original(self, count)
        u[2, :60] = 0.0
        return u

    monkeypatch.setattr(rand.Key, "uniform", unlucky)
    picks = key(6).distinct(4, 20)
    assert torch.equal(picks[[0, 1, 3, 4, 5]], plain[[0, 1, 3, 4, 5]])
    assert picks[2].tolist() == skipping(unlucky(key(6), 200)[2].tolist(), 4, 20)


def test_uniform_and_normal_distributions():
    one = rand.Uniform(-2.0, 6.0).draw(key(MANY))
    assert (one.shape, one.mean()) == ((MANY,), pytest.approx(2.0, abs=FIVE_SIGMA * 8 * 12**-0.5))
    assert one.min() >= -2
    assert one.max() < 6
    three = rand.Uniform((0.0, 10.0, -1.0), (1.0, 11.0, 1.0), 3).draw(key(9))
    assert three.shape == (9, 3)
    assert ((three >= torch.tensor([0.0, 10.0, -1.0])) & (three < torch.tensor([1.0, 11.0, 1.0]))).all()
    assert rand.Uniform(size=1).draw(key(9)).shape == (9, 1)
    z = rand.Normal(5.0, 0.1, 2).draw(key(MANY))
    assert (z.shape, z.mean(0)) == ((MANY, 2), pytest.approx([5, 5], abs=0.1 * FIVE_SIGMA))
    assert z.std(0) == pytest.approx([0.1, 0.1], abs=0.1 * FIVE_SIGMA)
    assert rand.Normal().draw(key(3)).shape == (3,)
    for std in (-0.1, torch.tensor([0.1, -0.1])):
        with pytest.raises(ValueError, match=r"std=.* must not be negative"):
            rand.Normal(0.0, std)


def test_choice_is_even():
    picks = rand.Choice(["a", "b", None]).draw(key(MANY))
    for option in ("a", "b", None):
        assert picks.count(option) / MANY == pytest.approx(1 / 3, abs=FIVE_SIGMA * (2 / 9) ** 0.5)
    check_refusals(refusal(lambda: rand.Choice([]), ValueError, "options", "Choice"))
    # The first of them is the one that would be drawn alone.
    numbers = rand.Choice([1, 2.5, 4], 3).draw(key(MANY))
    assert numbers.shape == (MANY, 3)
    for option in (1, 2.5, 4):
        assert (numbers == option).double().mean(0) == pytest.approx([1 / 3] * 3, abs=FIVE_SIGMA * (2 / 9) ** 0.5)
    assert numbers[:, 0].tolist() == rand.Choice([1, 2.5, 4]).draw(key(MANY))
    assert torch.corrcoef(numbers.mT).fill_diagonal_(0).abs().max() < FIVE_SIGMA
    words = rand.Choice(["a", "b"], 2).draw(key(50))
    assert {tuple(row) for row in words} == {("a", "a"), ("a", "b"), ("b", "a"), ("b", "b")}


@pytest.mark.parametrize("values", [torch.arange(8.0).view(4, 2), np.arange(8.0).reshape(4, 2), [[0, 1], [2, 3], [4, 5], [6, 7]]])
def test_per_env_takes_row_of_the_index(values):
    rows = rand.Key(*(torch.tensor(x) for x in ([0, 0], [3, 1], [5, 6])))
    drawn = rand.per_env(values).draw(rows)
    assert np.array_equal(np.stack([np.asarray(row) for row in drawn]), [[6, 7], [2, 3]])


def test_per_env_with_strings_and_too_few_rows():
    assert rand.per_env(["x", "y"]).draw(key(2)) == ["x", "y"]
    check_refusals(refusal(lambda: rand.per_env(["x", "y"]).draw(key(3)), ValueError, "per_env", "2"))


def test_random_orbits_keep_what_is_given():
    a, e, i, *others = rand.random_orbit().draw(key(MANY)).unbind(-1)
    assert (a == 6871e3).all()
    assert (e == 0).all()
    assert (i.min(), i.max()) == (pytest.approx(-math.pi, abs=1e-3), pytest.approx(math.pi, abs=1e-3))
    for angle in others:
        assert 0 <= angle.min() < 1e-3
        assert 2 * math.pi - 1e-3 < angle.max() < 2 * math.pi
    for one, two in pairwise((i, *others)):
        assert torch.corrcoef(torch.stack([one, two]))[0, 1].abs() < FIVE_SIGMA
    oe = rand.random_orbit(i=98.0, a=7000.0, e=0.01, Omega=10.0, omega=20.0).draw(key(5))
    assert oe[:, :5].tolist() == [[7e6, 0.01, *map(math.radians, (98.0, 10.0, 20.0))]] * 5
    assert len(set(oe[:, 5].tolist())) == 5
    free = rand.random_orbit().draw(key(5))
    assert torch.equal(free[:, 5], oe[:, 5])  # fixing an angle does not change the draws of the others


def test_random_epochs_parse_in_any_language(monkeypatch):
    form = re.compile(r"\d{4} [A-Z]{3} \d\d \d\d:\d\d:\d\d\.\d{3} \(UTC\)")
    epochs = rand.random_epoch(2001, 2003).draw(key(500))
    assert all(form.fullmatch(text) for text in epochs)
    assert {text[:4] for text in epochs} == {"2001", "2002"}
    assert len({text[5:8] for text in epochs}) == 12
    assert {int(text[9:11]) for text in epochs} == set(range(1, 28))  # 28 is bsk_rl's exclusive end
    assert parse_utc("2001-01-01T00:00:00") <= min(map(parse_utc, epochs))
    assert max(map(parse_utc, epochs)) < parse_utc("2003-01-01T00:00:00")
    monkeypatch.setattr("calendar.month_abbr", ["", *("\u00e9" * 3 for _ in range(12))])
    for text in rand.random_epoch().draw(key(20)):
        parse_utc(text)


@pytest.mark.parametrize("years", [(1990, 2060), (2016, 2018), (2000, 2001)])
def test_random_epochs_are_those_that_their_words_say(years):
    epochs = rand.random_epoch(*years)
    words, et = epochs.draw(key(3000)), epochs.draw_et(key(3000))
    # two ways to the same sine; ET has steps of 1e-7 s
    assert torch.allclose(et, torch.tensor(list(map(parse_utc, words)), dtype=torch.float64), rtol=0.0, atol=1.2e-7)
    assert torch.equal(et[:7], epochs.draw_et(key(7)))


def test_satellites_of_an_environment_draw_apart():
    """The first one draws what an environment with a single satellite would; the others differ from it and from one another."""
    several = key(3, name="a").of_satellites(torch.tensor([0, 2, 1, rand.MOST_SATELLITES - 1]))
    assert len(several) == 12
    u = several.uniform(5).view(3, 4, 5)
    assert torch.equal(u[:, 0], key(3, name="a").uniform(5))
    assert u.unique().numel() == u.numel()


@pytest.mark.parametrize("method", ["uniform", "normal"])
def test_draws_of_a_satellite_depend_on_nothing_else(method):
    """Not on the other satellites, their order, or the environments around."""
    many = getattr(key(9).of_satellites(torch.arange(6)), method)(4).view(9, 6, 4)
    few = getattr(key(2).of_satellites(torch.tensor([5, 3])), method)(4).view(2, 2, 4)
    assert torch.equal(few, many[:2, [5, 3]])
    named = [key(2).named("a").of_satellites(torch.tensor([3])), key(2).of_satellites(torch.tensor([3])).named("a")]
    assert torch.equal(*(getattr(each, method)(4) for each in named))


def test_the_satellite_stands_above_the_number_of_the_block():
    """The third number of the last satellite follows from the generator by hand; its last block is the last of the counter."""
    last = rand.MOST_SATELLITES - 1
    zero = torch.tensor([0])  # crc32 of the empty string
    words = rand.philox([torch.tensor([(last << rand.BLOCK_BITS) + 1]), zero, zero, zero], [zero] * 2)
    expected = ((int(words[0]) >> 5) * 2**26 + (int(words[1]) >> 6)) / 2**53
    assert key(1, seed=0).of_satellites(torch.tensor([last])).uniform(3)[0, 2].item() == expected
    assert (rand.MOST_SATELLITES << rand.BLOCK_BITS) - 1 == 2**32 - 1


def test_chunks_do_not_show_in_draws_of_satellites(monkeypatch):
    several = key(20).of_satellites(torch.tensor([4, 0, 7]))
    whole = several.uniform(7)
    monkeypatch.setattr(rand, "philox_kernel", lambda: None)
    monkeypatch.setattr(rand, "BLOCKS_AT_ONCE", 9)
    assert torch.equal(several.uniform(7), whole)


def test_neighbouring_satellites_and_high_words_of_keys_are_independent():
    u = key(MANY).of_satellites(torch.arange(2)).uniform(1).view(MANY, 2)
    assert u.mean(0) - 0.5 == pytest.approx([0, 0], abs=FIVE_SIGMA * 12**-0.5)
    assert torch.corrcoef(u.T)[0, 1].abs() < FIVE_SIGMA
    zero, high = torch.zeros(2, dtype=torch.int64), torch.tensor([2**32, 0])
    drawn = rand.Key(zero, high, high.flip(0), "a").uniform(2)
    assert len(drawn.unique()) == 4


@pytest.mark.parametrize("word", ["env_id", "episode", "seed"])
def test_all_bits_of_a_key_count(word):
    """Environments, episodes and seeds 2**32 apart have other numbers, and rows do not depend on others with large numbers."""
    numbers = torch.tensor([5, 5 + 2**32, 5 + 2**33, 5 + 2**62, 2**32, 2**33], dtype=torch.int64)
    rows = dict.fromkeys(("seed", "env_id", "episode"), torch.full((6,), 3, dtype=torch.int64)) | {word: numbers}
    key = rand.Key(**rows, name="a")
    drawn = key.uniform(4)
    assert len(drawn.unique()) == drawn.numel()
    assert torch.equal(key.take([0]).uniform(4), drawn[:1])
    assert torch.equal(key.take([1, 4]).uniform(4), drawn[[1, 4]])
