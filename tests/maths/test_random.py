"""Random numbers: the published test vectors, the same bits on both array types, and the right distributions."""

import itertools

import numpy as np
import pytest
from scipy import stats

from lidarscene.kernel.device import transfer
from lidarscene.maths import random

# Random123's kat_vectors for threefry2x32, 20 rounds (Salmon et al., SC11): counter, key, result.
KNOWN = [
    ((0x00000000, 0x00000000), (0x00000000, 0x00000000), (0x6B200159, 0x99BA4EFE)),
    ((0xFFFFFFFF, 0xFFFFFFFF), (0xFFFFFFFF, 0xFFFFFFFF), (0x1CB996FC, 0xBB002BE7)),
    ((0x243F6A88, 0x85A308D3), (0x13198A2E, 0x03707344), (0xC4923A9C, 0x483DF7A0)),
]
FALSE_ALARM = 1e-4  # of each statistical test below, at a fixed seed


def words_of(pair):
    return tuple(np.array([value], dtype=np.uint32) for value in pair)


@pytest.mark.parametrize(("counter", "key", "expected"), KNOWN)
def test_published_vectors(counter, key, expected):
    first, second = random.threefry2x32(words_of(key), words_of(counter))
    assert (int(first[0]), int(second[0])) == expected


def test_same_bits_on_the_device(mi):
    pulse = np.arange(5000, dtype=np.uint32) * np.uint32(858_993)
    for seed, stage, draw, rollover in ((0, 1, 0, 0), (4_294_967_295, 3, 7, 0), (4_294_967_295, 3, 7, 2**24 - 1)):
        host = random.words(seed=(seed, rollover), stage=stage, pulse=pulse, draw=draw)
        words = transfer.seed_word(seed), transfer.opaque_uint32(rollover)
        device = random.words(seed=words, stage=stage, pulse=mi.UInt32(pulse), draw=draw)
        for a, b in zip(host, device, strict=True):
            np.testing.assert_array_equal(a, b.numpy())
    for deviate in (random.normal_pair, lambda w: (random.exponential(w),)):
        for a, b in zip(deviate(host), deviate(device), strict=True):
            np.testing.assert_allclose(a, b.numpy(), rtol=2e-5, atol=2e-6)


def test_no_two_draws_share_key_and_counter(monkeypatch):
    """Least and greatest of each number, and some between, all with all; and the first rollover has the plain key."""
    assert max(random.Stage) < 2**8
    monkeypatch.setattr(random, "threefry2x32", lambda key, counter: (*key, *counter))
    pulse = np.array([0, 1, 2**24, 2**31 - 1], dtype=np.uint32)
    seen = set()
    seeds, stages, rollovers, draws = (0, 1, 2**32 - 1), (0, 1, 255), (0, 1, 2**8, 2**24 - 1), (0, 1, 2**32 - 1)
    for seed, stage, rollover, draw in itertools.product(seeds, stages, rollovers, draws):
        pair = random.words(seed=(seed, rollover), stage=stage, pulse=pulse, draw=draw)
        assert all(word.dtype == np.uint32 for word in pair)
        seen |= set(zip(*(word.tolist() for word in pair), strict=True))
        if rollover == 0:
            plain = random.words(seed=seed, stage=stage, pulse=pulse, draw=draw)
            assert np.array_equal(plain, pair)
    assert len(seen) == len(seeds) * len(stages) * len(rollovers) * len(draws) * len(pulse)


def test_stages_draws_and_seeds_are_independent():
    pulse = np.arange(100_000, dtype=np.uint32)
    streams = [
        random.normal_pair(random.words(seed=seed, stage=stage, pulse=pulse, draw=draw))
        for seed, stage, draw in ((0, 1, 0), (1, 1, 0), (0, 2, 0), (0, 1, 1), ((0, 1), 1, 0))
    ]
    flat = np.stack([deviate for pair in streams for deviate in pair])
    correlation = np.corrcoef(flat)[np.triu_indices(len(flat), 1)]
    limit = stats.norm.isf(FALSE_ALARM / 2 / len(correlation)) / np.sqrt(len(pulse))
    assert np.abs(correlation).max() < limit


def test_neighbouring_pulses_are_independent():
    deviate, _ = random.normal_pair(random.words(seed=0, stage=1, pulse=np.arange(200_000, dtype=np.uint32)))
    for lag in (1, 2, 601):
        r = np.corrcoef(deviate[:-lag], deviate[lag:])[0, 1]
        assert abs(r) < stats.norm.isf(FALSE_ALARM / 2) / np.sqrt(len(deviate))


@pytest.mark.parametrize("component", [0, 1])
def test_normal(component):
    deviate = random.normal_pair(random.words(seed=5, stage=1, pulse=np.arange(300_000, dtype=np.uint32)))[component]
    assert stats.kstest(deviate, "norm").pvalue > FALSE_ALARM
    assert 4.0 < np.abs(deviate).max() < 6.8


def test_exponential_and_its_small_values():
    pulse = np.arange(2_000_000, dtype=np.uint32)
    deviate = random.exponential(random.words(seed=5, stage=2, pulse=pulse))
    assert stats.kstest(deviate[:300_000], "expon").pvalue > FALSE_ALARM
    # Rare events live down here: 2e6 draws put 2000 +- 45 below 1e-3, evenly. There are some 2e7 float32 numbers in the
    # upper half of that, so that two draws of all are the same in one of eight runs, and six in none.
    small = deviate[deviate < 1e-3]
    assert abs(len(small) - 2e6 * 1e-3) < 5.0 * np.sqrt(2e3)
    assert stats.kstest(small / 1e-3, "uniform").pvalue > FALSE_ALARM
    assert len(np.unique(small)) > len(small) - 6


def test_words_at_the_ends_of_their_range():
    lowest, highest = (np.array([v], dtype=np.uint32) for v in (0, 0xFFFFFFFF))
    for word in ((lowest, lowest), (highest, highest), (lowest, highest), (highest, lowest)):
        assert np.isfinite(random.normal_pair(word)).all()
        assert np.isfinite(random.exponential(word)).all()
        assert random.exponential(word)[0] > 0.0
