"""SPADs under a background: closed forms there and back, and the noise of a filter over simulated firings."""

import math

import numpy as np
import pytest
from helpers import photons
from helpers.run_seed import chosen
from helpers.trains import train
from scipy import ndimage

from lidarscene.detection.photon_counting.histograms import histograms
from lidarscene.physics.photon_counting import matched_filter

BACKGROUND_W = np.array([2e-10])


@pytest.mark.parametrize("coincidence", [1, 2])
@pytest.mark.parametrize("coates", ["true", "false"])
def test_power_and_photons_are_inverse(coincidence, coates):
    """The inverse holds to 1e-6, the bisection of the response of coincidences to 1e-4."""
    counter = photons.sensor(f"detector.coincidence={coincidence}", f"histogram.coates={coates}")
    pixel = counter.pixel(BACKGROUND_W)
    power = np.geomspace(1e-10, 5e-9, 9)
    recovered_w = pixel.power_w(pixel.counts(pixel.detections(power)))
    np.testing.assert_allclose(recovered_w, power, rtol=1e-6 if coincidence == 1 else 1e-4)


def sensor_in_sun(rate_hz, *overrides):
    """A sensor of the tests and the power (1,) at which a free SPAD of it detects this rate."""
    counter = photons.sensor(*overrides)
    dark = counter.pixel(np.zeros(1))
    return counter, (rate_hz - float(dark.rate_hz[0])) / float(dark.per_watt) * np.ones(1)


@pytest.mark.parametrize(("rate_mhz", "dead_ns"), chosen(2, [(2.0, 12.0), (60.0, 5.0), (100.0, 5.0), (50.0, 4.0)]))
@pytest.mark.parametrize("least", [1, 2])
def test_background_counts_are_those_of_free_spads(rate_mhz, dead_ns, least):
    """Rationale: firings renew themselves, so a bin of length D has a lambda D of them, a = 1 / (1 + lambda tau), and
    SPADs that come alive within the bin count too. With coincidence that is the probability of each SPAD.
    Reference: 30 bins of 64 SPADs that are followed from one firing to the next.
    Tolerance: four standard errors of 2,000 shots, in which bins exclude each other: fewer than of Poisson counts.
    """
    counter, power_w = sensor_in_sun(
        1e6 * rate_mhz, f"detector.dead_time_ns={dead_ns}", f"detector.coincidence={least}", "histogram.shots=2000"
    )
    pixel = counter.pixel(power_w)
    mean = float(1e-3 * rate_mhz / (1.0 + 1e-3 * rate_mhz * dead_ns))
    options = {"rate_per_ns": 1e-3 * rate_mhz, "dead": dead_ns, "bins": 30, "bin_ns": 1.0}
    of_spads = photons.renewal_counts(np.random.default_rng(8), (128_000, 1), **options).reshape(2000, 64, 30)
    assert of_spads.max() == 1.0
    counts = float((of_spads.sum(axis=1) >= least).mean()) * 2000 if least > 1 else float(of_spads.mean()) * 128e3
    expected = 1e-9 * float(pixel.count_rate_hz[0])
    assert counts == pytest.approx(expected, abs=4.0 * math.sqrt(expected / 30))
    if least == 1:
        assert expected == pytest.approx(128e3 * mean, rel=1e-9)
        # NEAR_IR counts the same ones.
        assert pixel.background_counts(1e-6)[0][0] == pytest.approx(pixel.count_rate_hz[0], rel=1e-12)
    # No light, no echo: the background of the response is that of the sum.
    assert pixel.counts(np.zeros(1))[0] == pytest.approx(0.0, abs=1e-9 * expected)


def test_background_counts_of_first_photons():
    """N (1 - exp(-lambda window)) in all; in a bin in the middle of which the echo comes, N lambda D exp(-lambda t)."""
    counter = photons.sensor("detector.stamps='first'")
    pixel = counter.pixel(BACKGROUND_W)
    rate = float(pixel.rate_hz[0])
    counts, narrowing = pixel.background_counts(1e-6)
    assert counts[0] * 1e-6 == pytest.approx(64 * 50 * -math.expm1(-rate * 1e-6), rel=1e-9)
    assert narrowing[0] == pytest.approx(math.exp(-0.5 * rate * 1e-6), rel=1e-9)
    late = counter.pixel(BACKGROUND_W, range_m=30.0)
    armed_s = 60.0 / 299792458.0 - float(counter.tdc.blanking_s)
    assert late.count_rate_hz[0] == pytest.approx(64 * 50 * rate * math.exp(-rate * armed_s), rel=1e-9)


@pytest.mark.parametrize("least", chosen(1, [1, 2, 3]))
def test_the_threshold_of_first_photons_is_that_of_the_window(least):
    """Rationale: it does not know where the echo is. Reference: bins of 20,000 shots of 16 SPADs, of each its first
    firing. Tolerance: 4 standard errors of their counts.
    """
    keys = ("detector.stamps='first'", f"detector.coincidence={least}", "detector.spads=16", "histogram.shots=20000")
    counter = photons.sensor(*keys, "histogram.threshold_floor=0", "histogram.threshold_slope=1")
    levels = [counter.threshold(counter.working_point(BACKGROUND_W, range_m=range_m))[0] for range_m in (5.0, 120.0)]
    assert levels[0] == levels[1]
    rng, rate = np.random.default_rng(2), 1e-9 * float(counter.pixel(BACKGROUND_W).rate_hz[0])
    bins = np.floor(rng.exponential(1.0 / rate, (20_000, 16))).astype(np.int64)
    numbers = (np.arange(20_000)[:, None] * 1000 + bins)[bins < 1000]
    counts = np.bincount(numbers)
    total = len(numbers) if least == 1 else (counts >= least).sum()
    assert total > 100
    assert levels[0] ** 2 == pytest.approx(total, abs=4.0 * math.sqrt(total))


@pytest.mark.parametrize(
    ("rate_mhz", "dead_ns", "within"),
    chosen(2, [(20.0, 12.0, 0.0), (20.0, 4.0, 0.0), (60.0, 12.0, 0.0), (60.0, 5.0, 0.007), (100.0, 5.0, 0.016)]),
)
def test_dead_time_narrows_the_noise_of_the_filter(rate_mhz, dead_ns, within):
    """`variance_share`: 1,000 SPADs for 1.5 us, each followed from one firing to the next; four standard errors of the
    variance, and ``within`` for second firings in the template, (a lambda w sigma)^2, where the dead time lets them in.
    """
    counter, power_w = sensor_in_sun(1e6 * rate_mhz, "histogram.bin_ns=0.5", f"detector.dead_time_ns={dead_ns}")
    pixel = counter.pixel(power_w)
    w = 1e9 * matched_filter.TEMPLATE * float(pixel.sigma_s)
    template = np.exp(-0.5 * (0.5 * np.arange(-24, 25) / w) ** 2)
    options = {"rate_per_ns": 1e-3 * rate_mhz, "dead": dead_ns, "bins": 3000, "bin_ns": 0.5}
    counts = photons.renewal_counts(np.random.default_rng(5), (1000, 1), **options)
    filtered = np.stack([np.convolve(of_spad, template, "valid") for of_spad in counts])
    share = filtered.var(axis=0).mean() / (counts.mean() * np.sum(template**2))
    # Some 1000 x 1500 ns / (w sqrt(2 pi)) independent values.
    error = share * math.sqrt(2.0 / (1000 * 1500 / (3.5 * w)))
    assert share == pytest.approx(float(pixel.variance_share[0]), abs=4.0 * error + within)
    assert share < 0.95


def test_afterpulses_widen_the_noise_of_the_filter():
    """Rationale: an afterpulse within the template counts with the firing before it: 5 % more variance with a dead time
    of 3 ns and 15 % that fire again, 4 ns later on average.
    Reference: 10,000 SPADs for 0.2 us at 10 MHz, each followed from one firing to the next.
    Tolerance: four standard errors, 3.1 %; 0.5 % for afterpulses of afterpulses.
    """
    keys = ("histogram.bin_ns=0.5", "detector.dead_time_ns=3", "detector.jitter_ps=2000", "laser.pulse_fwhm_ns=3")
    afterpulses = ("detector.afterpulse=0.15", "detector.afterpulse_ns=4")
    counter, power_w = sensor_in_sun(10e6, *keys)
    pixel = photons.sensor(*keys, *afterpulses).pixel(power_w)
    assert pixel.primary_hz[0] == pytest.approx(10e6, rel=1e-6)
    w = 1e9 * matched_filter.TEMPLATE * float(pixel.sigma_s)
    template = np.exp(-0.5 * (0.5 * np.arange(-24, 25) / w) ** 2)
    options = {"rate_per_ns": 0.01, "dead": 3.0, "bins": 500, "bin_ns": 0.5, "afterpulse": (0.15, 4.0)}
    counts = photons.renewal_counts(np.random.default_rng(5), (10_000, 1), **options)[:, 80:]
    assert counts.mean() == pytest.approx(float(pixel.free[0] * pixel.rate_hz[0]) * 0.5e-9, rel=0.03)
    filtered = ndimage.convolve1d(counts, template, axis=1)[:, 24:-24]
    share = filtered.var(axis=0).mean() / (counts.mean() * np.sum(template**2))
    independent = 10_000 * 200 / (3.5 * w)
    # Few counts have more scatter of their variance than a Gaussian: by the fourth cumulant.
    fourth = np.mean((filtered - filtered.mean()) ** 4) / filtered.var() ** 2
    error = share * math.sqrt((fourth - 1.0) / independent)
    within = 4.0 * error + 0.005
    assert share == pytest.approx(float(pixel.variance_share[0]), abs=within)
    assert float(counter.pixel(power_w).variance_share[0]) < float(pixel.variance_share[0]) - within


@pytest.mark.parametrize("detections", [0.003, 0.05, 1.0])
def test_coincidences_of_an_echo_in_the_sun_are_those_of_its_bins(detections):
    """Rationale: pairs of firings grow with the light, on a background that has pairs of its own. Reference: counts of
    the whole histogram with the echo less those without, while the SPADs that it fired are blind. Tolerance: 6 %, since
    they are missing for the sun too, of which fewer are blind then.
    """
    counter, power_w = sensor_in_sun(
        20e6, "detector.coincidence=2", "histogram.window_us=0.4", "detector.dead_time_ns=40"
    )
    pixel = counter.pixel(power_w)
    range_m = 30.0 + np.linspace(0.0, 0.15, 40, endpoint=False)[:, None]
    peak_w = detections / float(pixel.detections(1.0))
    pulse = np.arange(40, dtype=np.uint32)
    lit, dark = (
        histograms(train(range_m, peak, background_w=float(power_w[0])), counter, seed=1, pulse=pulse).expected
        for peak in (peak_w, 0.0)
    )
    near = slice(190, 211)
    echo_counts = (lit - dark)[:, near].sum(axis=1).mean()
    assert float(pixel.counts(np.array([detections]))[0]) == pytest.approx(echo_counts, rel=0.06)


def test_the_most_photons_that_tell_the_light():
    """The number of SPADs tells no more above 0.995 of the free ones; with Coates' correction there is no such
    number.
    """
    counter = photons.sensor()
    pixel, point = counter.pixel(BACKGROUND_W), counter.working_point(BACKGROUND_W)
    most = float(pixel.counts(np.array([50.0]))[0])
    assert float(point.response.largest[0]) == pytest.approx(0.995 * most, rel=1e-9)
    assert photons.sensor("histogram.coates=true").working_point(BACKGROUND_W).response.largest is None


def test_the_noise_of_near_ir_is_narrowed_by_dead_times():
    """Rationale: of a long time a renewal process counts with the variance a^2 of its mean. Reference: 10,000 SPADs in
    600 ns. Tolerance: 4.5 standard errors of the variance, 6.4 %, and 2 % for the window's ends.
    """
    counter, power_w = sensor_in_sun(40e6)
    _, narrowing = counter.pixel(power_w).background_counts(600e-9)
    options = {"rate_per_ns": 0.04, "dead": 12.0, "bins": 600, "bin_ns": 1.0}
    counts = photons.renewal_counts(np.random.default_rng(9), (10_000, 1), **options).sum(axis=1)
    assert counts.var() / counts.mean() == pytest.approx(narrowing[0] ** 2, rel=0.064 + 0.02)
