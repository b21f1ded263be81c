"""McIntyre's distribution: its moments, its tail by three roads, and how far the Gaussian is off."""

import math

import numpy as np
import pytest
from helpers import chain
from helpers.run_seed import chosen
from scipy.integrate import quad
from scipy.special import gammaln
from scipy.stats import invgauss, nbinom, norm, poisson

from lidarscene import Simulator, load_sensor
from lidarscene.physics.electronics import apd, mcintyre, tdc
from lidarscene.physics.reference import mcintyre as reference_mcintyre
from lidarscene.rendering.simulator import Summary
from lidarscene.studies.ranging import statistics
from lidarscene.studies.ranging.plane import Target

TABLE_1 = {"primaries": 241.0, "gain": 80.0, "ionisation_ratio": 0.02225, "amplifier": 311.0}


def second_moment(gain, k):
    return apd.excess_noise_mcintyre(gain=gain, ionisation_ratio=k)


@pytest.mark.parametrize(
    ("primary", "gain", "k"), [(1, 80.0, 0.022), (5, 80.0, 0.022), (3, 10.0, 0.2), (2, 5.0, 0.5), (4, 20.0, 0.0)]
)
def test_moments(primary, gain, k):
    """One in all, mean n M, variance n M^2 (F - 1): F is McIntyre's. Tolerance: sums of 4e5 terms."""
    total = np.arange(primary, 400_000.0)
    p = np.exp(reference_mcintyre.log_probability(primary=primary, total=total, gain=gain, ionisation_ratio=k))
    mean = (p * total).sum()
    assert p.sum() == pytest.approx(1.0, rel=1e-8)
    assert mean == pytest.approx(primary * gain, rel=1e-8)
    variance = (p * (total - mean) ** 2).sum()
    assert variance == pytest.approx(primary * gain**2 * (second_moment(gain, k) - 1.0), rel=1e-6)


def test_special_cases():
    """k = 0 is negative binomial; a gain of one changes nothing; fewer cannot leave than entered."""
    total = np.arange(4.0, 200.0)
    p = np.exp(reference_mcintyre.log_probability(primary=4.0, total=total, gain=20.0, ionisation_ratio=0.0))
    np.testing.assert_allclose(p, nbinom.pmf(total - 4.0, 4, 1.0 / 20.0), rtol=1e-9)
    log_probability = reference_mcintyre.log_probability(
        primary=4.0, total=np.arange(3.0, 6.0), gain=1.0, ionisation_ratio=0.3
    )
    np.testing.assert_allclose(np.exp(log_probability), [0.0, 1.0, 0.0], atol=1e-12)


def test_ionisation_ratio_of_table_1():
    k = mcintyre.ionisation_ratio(gain=80.0, excess_noise=80.0**0.3)
    assert k == pytest.approx(0.02225, abs=5e-6)
    assert second_moment(80.0, k) == pytest.approx(80.0**0.3)
    assert mcintyre.ionisation_ratio(gain=1.0, excess_noise=1.0) == 0.0


def by_double_sum(excess, primaries, gain, ionisation_ratio, amplifier):
    """The compound distribution added up term by term, with SciPy: n primaries, m electrons, amplifier."""
    k, limit, tail = ionisation_ratio, excess + primaries * gain, 0.0
    total = np.arange(1.0, limit + 60.0 * (amplifier + gain) + 12.0 * excess)
    through = k * total / (1.0 - k)
    for n in range(1, int(primaries + 12.0 * math.sqrt(primaries) + 20.0)):
        m, u = total[n - 1 :], through[n - 1 :]
        log_p = (
            np.log(n / m)
            + gammaln(m + u + 1)
            - gammaln(m - n + 1)
            - gammaln(u + n + 1)
            + (n + u) * math.log((1 + k * (gain - 1)) / gain)
            + (m - n) * math.log((1 - k) * (gain - 1) / gain)
        )
        tail += poisson.pmf(n, primaries) * (np.exp(log_p) * norm.sf((limit - m) / amplifier)).sum()
    return tail + poisson.pmf(0, primaries) * norm.sf(limit / amplifier)


@pytest.mark.parametrize(
    ("times", "primaries", "gain", "k", "amplifier"),
    [
        (2.0, 5.0, 20.0, 0.05, 60.0),
        (8.0, 5.0, 20.0, 0.05, 60.0),
        (5.0, 30.0, 10.0, 0.3, 20.0),
        (8.0, 8.0, 30.0, 0.0, 80.0),
    ],
)
def test_exact_tail_against_a_double_sum(times, primaries, gain, k, amplifier):
    """Fourier against plain addition. Tolerance: the amplifier smooths the count to a part in 1e4."""
    excess = times * math.hypot(amplifier, gain * math.sqrt(primaries * second_moment(gain, k)))
    numbers = {"primaries": primaries, "gain": gain, "ionisation_ratio": k, "amplifier": amplifier}
    exact = reference_mcintyre.tail_probability_exact(excess=excess, **numbers)
    assert exact == pytest.approx(by_double_sum(excess, **numbers), rel=1e-3)


def test_exact_tail_against_random_avalanches():
    """2e5 counts drawn from the distribution itself; 4 standard errors."""
    k, gain, primaries, amplifier = 0.1, 20.0, 10.0, 50.0
    random = np.random.default_rng(7)
    total = np.arange(1.0, 20_000.0)
    single = np.exp(reference_mcintyre.log_probability(primary=1.0, total=total, gain=gain, ionisation_ratio=k))
    number = random.poisson(primaries, 200_000)
    electrons = np.searchsorted(np.cumsum(single), random.random(number.sum())) + 1.0
    ends = np.cumsum(number)
    running = np.concatenate([[0.0], np.cumsum(electrons)])
    output = running[ends] - running[ends - number] + random.normal(0.0, amplifier, len(number))
    sigma = math.hypot(amplifier, gain * math.sqrt(primaries * second_moment(gain, k)))
    assert output.std() == pytest.approx(sigma, rel=0.01)
    for times in (1.0, 3.0, 4.0):
        count = np.count_nonzero(output > primaries * gain + times * sigma)
        p = reference_mcintyre.tail_probability_exact(
            excess=times * sigma, primaries=primaries, gain=gain, ionisation_ratio=k, amplifier=amplifier
        )
        assert abs(count - len(output) * p) < 4.0 * math.sqrt(len(output) * p)


@pytest.mark.parametrize(
    ("primaries", "gain", "k", "amplifier", "tolerance"),
    [
        (241.0, 80.0, 0.02225, 311.0, 1e-3),
        (241.0, 80.0, 0.02225, 0.0, 1e-3),
        (24.0, 80.0, 0.02225, 311.0, 0.01),
        (2.4, 80.0, 0.02225, 311.0, 0.12),
        (0.5, 80.0, 0.02225, 311.0, 0.5),
        (1.9, 80.0, 0.02225, 3110.0, 1e-3),
        (241.0, 20.0, 0.2, 100.0, 2e-3),
        (2000.0, 10.0, 0.4, 100.0, 1e-3),
        (50.0, 30.0, 0.0, 50.0, 1e-3),
        (241.0, 1.0, 0.0, 5.0, 1e-2),
        (0.0, 80.0, 0.02, 311.0, 1e-4),
    ],
)
def test_saddle_point(primaries, gain, k, amplifier, tolerance):
    """The accuracy that the docstring states, from one to eight standard deviations; float32 too."""
    numbers = {"primaries": primaries, "gain": gain, "ionisation_ratio": k, "amplifier": amplifier}
    sigma = math.hypot(amplifier, gain * math.sqrt(primaries * second_moment(gain, k)))
    for times in (1.0, 3.0, 5.0, 8.0):
        exact = reference_mcintyre.tail_probability_exact(excess=times * sigma, **numbers)
        if primaries == 0.0:
            exact = norm.sf(times)
        assert mcintyre.tail_probability(excess=times * sigma, **numbers) == pytest.approx(exact, rel=tolerance)
        single = {name: np.float32(value) for name, value in numbers.items()}
        narrow = mcintyre.tail_probability(excess=np.float32(times * sigma), **single)
        assert narrow == pytest.approx(exact, rel=tolerance + 5e-3)


def test_no_noise_no_alarm():
    none = {"primaries": 0.0, "gain": 80.0, "ionisation_ratio": 0.02, "amplifier": 0.0}
    assert mcintyre.tail_probability(excess=1.0, **none) == 0.0


def test_tail_falls_with_the_threshold():
    excess = np.linspace(10.0, 60_000.0, 4001)
    tail = mcintyre.tail_probability(excess=excess, **TABLE_1)
    assert (np.diff(tail) < 0.0).all()
    assert (tail > 0.0).all()
    assert tail[0] < 0.51


def webb_density(*, excess, primaries, gain, excess_noise):
    """Density per electron of the output of Poisson primaries, ``excess`` above its mean (Webb et al., 1974).

    With sigma^2 = N M^2 F, x = excess / sigma and lambda = sqrt(N F) / (F - 1):
    exp(-x^2 / (2 (1 + x / lambda))) / (sqrt(2 pi) sigma (1 + x / lambda)^(3/2)), zero below x = -lambda.
    """
    sigma = gain * math.sqrt(primaries * excess_noise)
    x = excess / sigma
    y = 1.0 + x * (excess_noise - 1.0) / math.sqrt(primaries * excess_noise)
    inside = np.where(y > 0.0, y, 1.0)
    return np.where(y > 0.0, np.exp(-0.5 * x * x / inside) / (math.sqrt(2.0 * math.pi) * sigma * inside**1.5), 0.0)


def test_webb():
    """A density of unit area with the right variance, its closed tail, and SciPy's inverse Gaussian."""
    numbers = {"primaries": 241.0, "gain": 80.0, "excess_noise": 80.0**0.3}
    sigma = 80.0 * math.sqrt(241.0 * 80.0**0.3)
    grid = np.linspace(-7.0 * sigma, 30.0 * sigma, 200_001)
    density = webb_density(excess=grid, **numbers)
    step = grid[1] - grid[0]
    assert density.sum() * step == pytest.approx(1.0, rel=1e-6)
    assert (density * grid).sum() * step == pytest.approx(0.0, abs=1e-6 * sigma)
    assert (density * grid**2).sum() * step == pytest.approx(sigma**2, rel=1e-6)
    shape = math.sqrt(241.0 * 80.0**0.3) / (80.0**0.3 - 1.0)
    for times in (-3.0, 0.0, 1.0, 5.0):
        tail = reference_mcintyre.webb_tail(excess=times * sigma, **numbers)
        area = quad(lambda x: webb_density(excess=x, **numbers), times * sigma, 40 * sigma)[0]
        assert tail == pytest.approx(area, rel=1e-6)
        mean = 1.0 / shape**2
        assert tail == pytest.approx(invgauss.sf((1.0 + times / shape), mean, scale=shape**2), rel=1e-8)


def test_the_gaussian_mispredicts_false_alarms():
    """Huntington, Williams and Lee, Opt. Eng. 57, 073106 (2018): the threshold for a given false-alarm rate is
    often not predicted by the Gaussian of the same mean and variance. At Table 1 with k = 0.02225: 38 times
    as many at TNR 5, and 6.1 is needed for the alarms of 5.
    """
    sigma = math.hypot(311.0, 80.0 * math.sqrt(241.0 * second_moment(80.0, 0.02225)))
    at_five = reference_mcintyre.tail_probability_exact(excess=5.0 * sigma, **TABLE_1)
    assert at_five / norm.sf(5.0) == pytest.approx(37.8, rel=0.01)
    ratios = np.linspace(5.0, 7.0, 2001)
    tail = mcintyre.tail_probability(excess=ratios * sigma, **TABLE_1)
    assert ratios[np.argmin(abs(np.log(tail / norm.sf(5.0))))] == pytest.approx(6.08, abs=0.01)
    # The same with k = 0, the quietest avalanche there is: still far above.
    quiet = {**TABLE_1, "ionisation_ratio": 0.0}
    sigma = math.hypot(311.0, 80.0 * math.sqrt(241.0 * second_moment(80.0, 0.0)))
    assert reference_mcintyre.tail_probability_exact(excess=5.0 * sigma, **quiet) > 5.0 * norm.sf(5.0)


def test_on_the_device(mi):
    """Dr.Jit's single precision against numpy's double, over backgrounds from darkness to full sun."""
    primaries = np.array([0.0, 1e-4, 0.5, 1.9, 24.0, 241.0, 3e4])
    excess = 5.0 * np.hypot(311.0, 80.0 * np.sqrt(primaries * second_moment(80.0, 0.02225)))
    diode = {"gain": 80.0, "ionisation_ratio": 0.02225, "amplifier": 311.0}
    expected = mcintyre.tail_probability(excess=excess, primaries=primaries, **diode)
    computed = mcintyre.tail_probability(
        excess=mi.Float(excess),
        primaries=mi.Float(primaries),
        **{name: mi.Float(value) for name, value in diode.items()},
    )
    np.testing.assert_allclose(computed.numpy(), expected, rtol=5e-3)


@pytest.mark.parametrize("counted", chosen(1, ["published", "crossings"]))
def test_rendered_false_alarms(mi, counted):
    """`detector.tail` in a frame: a million beams at a target in full sun; 4 standard errors."""
    fine = [
        "scanner.azimuth_fov_deg=0.001",
        "scanner.elevation_fov_deg=0.001",
        "scanner.azimuth_step_deg=1e-6",
        "scanner.elevation_step_deg=1e-6",
    ]
    sensor = load_sensor("table1-apd", overrides=[*fine, "detector.tail='mcintyre'", f"tdc.false_alarms='{counted}'"])
    summary = Summary()
    Simulator(chain.scene(chain.facing(range_m=300.0)), sensor).render(seed=2, summary=summary)
    expected = statistics.false_points(sensor, Target(), 300.0).per_frame
    assert abs(summary.false_alarms - expected) < 4.0 * math.sqrt(expected)
    gaussian = load_sensor("table1-apd", overrides=[*fine, f"tdc.false_alarms='{counted}'"])
    assert expected > 20.0 * statistics.false_points(gaussian, Target(), 300.0).per_frame


def test_rare_crossings_are_known_by_their_bound():
    """The bound is one, for any diode in any light, and a rate is left out only where it is below the least.

    Tolerance: the series of the cumulants, 1e-9.
    """
    rng, count = np.random.default_rng(8), 20_000
    gain, primaries = 10.0 ** rng.uniform(0.05, 2.5, count), 10.0 ** rng.uniform(-4.0, 6.0, count)
    k, amplifier = rng.choice([0.0, 0.02, 0.5], count), 10.0 ** rng.uniform(0.0, 5.0, count)
    deviation = np.sqrt(primaries * gain**2 * (k * gain + (1.0 - k) * (2.0 - 1.0 / gain)) + amplifier**2)
    noise = {
        "excess": rng.uniform(2.0, 8.0, count) * deviation,
        "primaries": primaries,
        "gain": gain,
        "ionisation_ratio": k,
        "amplifier": amplifier,
    }
    rate = mcintyre.crossings_per_frequency(**noise)
    assert (mcintyre.crossings_bound(**noise) >= rate * (1.0 - 1e-9)).all()
    currents = mcintyre.Currents(
        primary_a=5e-9 * 10.0 ** rng.uniform(-2.0, 2.0, count),
        unmultiplied_a2=1e-15,
        gain=80.0,
        excess_noise=80.0**0.3,
        bandwidth_hz=167e6,
    )
    threshold_a, least_hz = 1.2e-6, 10.0 ** rng.uniform(-2.0, 6.0, count)
    exact_hz = mcintyre.crossing_rate_hz(currents, threshold_a=threshold_a)
    rate_hz = mcintyre.crossing_rate_hz(currents, threshold_a=threshold_a, least_hz=least_hz)
    matters = exact_hz >= least_hz
    assert 0.1 < matters.mean() < 0.9
    np.testing.assert_array_equal(rate_hz[matters], exact_hz[matters])
    assert ((rate_hz == 0.0) | (rate_hz == exact_hz)).all()
    assert (rate_hz == 0.0).sum() > 0.7 * (~matters).sum()


def test_slope_of_crossings_on_the_device(mi):
    """Derivatives come through the saddle point's last step; reference: differences in double precision."""
    import drjit as dr

    threshold = mi.Float(np.array([4e3, 8e3, 1.2e4]))
    dr.enable_grad(threshold)
    share = mcintyre.crossings_per_frequency(**{**TABLE_1, "excess": threshold})
    dr.forward(threshold)
    excess = np.array([4e3, 8e3, 1.2e4])
    high, low = (mcintyre.crossings_per_frequency(**{**TABLE_1, "excess": excess * scale}) for scale in (1.001, 0.999))
    np.testing.assert_allclose(dr.grad(share).numpy(), (high - low) / (0.002 * excess), rtol=5e-3)


@pytest.mark.parametrize(
    ("primaries", "amplifier", "level", "slack", "samples"),
    [(24.0, 300.0, 3.0, 0.25, 2**19), (24.0, 1000.0, 2.5, 0.1, 2**19), (100.0, 300.0, 2.5, 0.1, 2**18)],
)
def test_crossings_of_multiplied_shot_noise(primaries, amplifier, level, slack, samples):
    """Electrons at random times through McIntyre's avalanche and an ideal low-pass, counted sample by sample.

    (T28b) takes slopes as independent of heights and heights as those of a box of 1 / (2 B): up to 25 % low with 24
    electrons in that time, 10 % with more or behind a noisy amplifier; besides 4 standard errors. By these Rice's rate
    is exceeded, too.
    """
    gain, k, oversampling = 80.0, 0.02225, 16
    rng = np.random.default_rng(15)
    size = np.arange(1.0, 8000.0)
    share = np.exp(reference_mcintyre.log_probability(primary=1.0, total=size, gain=gain, ionisation_ratio=k))
    number = rng.poisson(2.0 * primaries * samples / oversampling)
    electrons = np.searchsorted(np.cumsum(share / share.sum()), rng.random(number)) + 1.0
    shots = np.bincount(rng.integers(0, samples, number), weights=electrons, minlength=samples)
    white = shots + rng.standard_normal(samples) * amplifier / math.sqrt(0.5 * oversampling)
    spectrum = np.fft.rfft(white) * 0.5 * oversampling
    spectrum[np.fft.rfftfreq(samples, 1.0 / oversampling) > 1.0] = 0.0
    spectrum[0] = 0.0
    noise = np.fft.irfft(spectrum, samples)
    deviation = math.hypot(amplifier, gain * math.sqrt(primaries * second_moment(gain, k)))
    assert noise.std() == pytest.approx(deviation, rel=0.02)
    excess = level * deviation
    per_frequency = mcintyre.crossings_per_frequency(
        excess=excess, primaries=primaries, gain=gain, ionisation_ratio=k, amplifier=amplifier
    )
    expected = float(per_frequency) * tdc.MEAN_FREQUENCY_LOW_PASS * samples / oversampling
    crossings = np.count_nonzero((noise[1:] >= excess) & (noise[:-1] < excess))
    assert abs(crossings - expected) < 4.0 * math.sqrt(expected) + slack * expected
    rice = tdc.MEAN_FREQUENCY_LOW_PASS * samples / oversampling * math.exp(-0.5 * level**2)
    assert crossings > rice + 4.0 * math.sqrt(rice)


def test_crossings_without_electrons_are_rices() -> None:
    """Rice's rate with next to no electrons, and with so many that the sum is Gaussian."""
    for primaries, amplifier, rel in ((0.0, 300.0, 1e-6), (1e-4, 300.0, 1e-3), (1e7, 300.0, 2e-2)):
        deviation = math.hypot(amplifier, 80.0 * math.sqrt(primaries * second_moment(80.0, 0.02225)))
        share = mcintyre.crossings_per_frequency(
            excess=4.0 * deviation, primaries=primaries, gain=80.0, ionisation_ratio=0.02225, amplifier=amplifier
        )
        assert float(share) == pytest.approx(math.exp(-8.0), rel=rel)


@pytest.mark.parametrize("primaries", [2e-3, 0.05, 0.5])
def test_the_amplifier_alone_passes_the_level_as_often(primaries):
    """No electron comes in a share exp(-N) of the times: its noise alone then passes what lies above none."""
    excess = np.linspace(200.0, 700.0, 26)
    tail = mcintyre.tail_probability(
        excess=excess, primaries=primaries, gain=80.0, ionisation_ratio=0.02, amplifier=150.0
    )
    assert np.all(tail >= math.exp(-primaries) * norm.sf((excess + primaries * 80.0) / 150.0) * (1.0 - 1e-9))
