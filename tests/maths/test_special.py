"""Special functions against SciPy, in both precisions; relative errors, because tails are what counts."""

import numpy as np
import pytest
from helpers import rounding
from scipy import stats

from lidarscene.kernel.device import transfer
from lidarscene.maths import special


def relative_error(computed, expected):
    return np.max(np.abs(computed / expected - 1.0))


def test_normal_tail():
    x = np.linspace(-10.0, 16.0, 20_001)
    assert relative_error(special.normal_tail(x), stats.norm.sf(x)) < 2e-10
    x32 = np.linspace(-8.0, 8.0, 20_001, dtype=np.float32)
    bound = 5e-7 * (1.0 + 0.5 * x32.astype(float) ** 2)
    error = np.abs(special.normal_tail(x32) / stats.norm.sf(x32.astype(float)) - 1.0)
    assert (error < bound).all()
    assert special.normal_tail(np.float32([40.0]))[0] == 0.0


def test_polynomial(mi):
    """Tolerance: one rounding for each power, on NumPy in double and on the device in single precision."""
    x, coefficients = np.linspace(-2.0, 2.0, 101), (0.25, -0.5, 0.0, 3.0, 7.0)
    np.testing.assert_allclose(special.polynomial(x, *coefficients), np.polyval(coefficients, x), rtol=1e-14)
    on_device = special.polynomial(transfer.from_numpy(x), *coefficients).numpy()
    np.testing.assert_allclose(on_device, np.polyval(coefficients, x.astype(np.float32).astype(float)), rtol=1e-6)


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_log1p_and_expm1(dtype):
    x = np.concatenate([-np.geomspace(1e-12, 0.5, 500), np.geomspace(1e-12, 0.5, 500)]).astype(dtype)
    allowed = 1e-9 if dtype == np.float64 else 1e-5  # the series are cut for float32, and good to that here
    assert relative_error(special.log1p(x).astype(float), np.log1p(x.astype(float))) < allowed
    assert relative_error(special.expm1(x).astype(float), np.expm1(x.astype(float))) < allowed


@pytest.mark.parametrize("trials", [1, 20, 400, 3000])
def test_binomial_tail(trials):
    rng = np.random.default_rng(0)
    least, probability = rng.integers(0, trials + 2, 3000).astype(float), rng.random(3000)
    expected = stats.binom.sf(least - 1, trials, probability)
    computed = special.binomial_tail(least=least, trials=float(trials), probability=probability)
    sizable = expected > 1e-25
    assert np.max(np.abs(computed - expected)[sizable] / expected[sizable]) < 1e-8
    assert (computed[~sizable] < 1e-24).all()


@pytest.mark.parametrize(("trials", "good_to"), [(400, 2e-4), (10**6, 2e-3), (10**9, 2e-2)])
def test_binomial_tail_on_the_device(trials, good_to, mi):
    """Tails around the mean: single precision knows n p of many trials to a part of a deviation."""
    rng = np.random.default_rng(1)
    probability = (0.9 * (10.0 / trials) ** rng.random(3000)).astype(np.float32)
    share = probability.astype(float)
    spread = np.sqrt(trials * share * (1.0 - share))
    least = np.rint(trials * share + 3.0 * spread * rng.normal(size=3000)).clip(0, trials + 1).astype(np.float32)
    computed = special.binomial_tail(
        least=mi.Float(least), trials=mi.Float(float(trials)), probability=mi.Float(probability)
    )
    expected = stats.binom.sf(least.astype(float) - 1.0, trials, share)
    sizable = expected > 1e-12
    assert np.max(np.abs(computed.numpy() - expected)[sizable] / expected[sizable]) < good_to


def test_series_on_the_device(mi):
    """Single precision where 1 + x has lost most digits of x: 1e-6 of it on either side of where the series ends."""
    x = np.concatenate([-np.geomspace(1e-6, 0.4, 100), np.geomspace(1e-6, 0.4, 100)]).astype(np.float32)
    for ours, numpys in ((special.log1p, np.log1p), (special.expm1, np.expm1)):
        computed = np.array(ours(transfer.from_numpy(x)).numpy(), dtype=float)
        assert relative_error(computed, numpys(x.astype(float))) < rounding.limit(1e-5)
