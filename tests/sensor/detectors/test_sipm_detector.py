"""Cells against arrays of them that are simulated one by one."""

import numpy as np
import pytest

from lidarscene import load_sensor
from lidarscene.kernel.device import transfer
from lidarscene.physics.electronics import sipm
from lidarscene.physics.reference import sipm as reference_sipm


def fire(rng, *, photons_per_dead_time, cells, pde, dead_steps, steps):
    """Slow and obvious: cells that each take a Poisson stream and are dead for tau after firing."""
    rate = photons_per_dead_time * pde / cells / dead_steps
    dead_for = np.zeros(cells, dtype=np.int64)
    busy = []
    for step in range(steps):
        dead_for = np.maximum(dead_for - 1, 0)
        fired = (dead_for == 0) & (rng.random(cells) < -np.expm1(-rate))
        dead_for[fired] = dead_steps
        if step > 6 * dead_steps and step % (2 * dead_steps) == 0:
            busy.append(np.count_nonzero(dead_for))
    return np.array(busy)


def test_busy_cells_in_steady_state():
    """x / (1 + x) and its binomial variance, against the cell array itself; (23) is far outside.

    By another simulation from 1 to 2000 photons in `validation/sipm_events/test_events.py`.

    The time step is tau / 200, which shortens the dead time by at most half a step: 0.3 % here.
    """
    rng, photons, steps = np.random.default_rng(11), 686.093, 48_000
    busy = fire(rng, photons_per_dead_time=photons, cells=400, pde=0.22, dead_steps=200, steps=steps)
    share = sipm.busy_share_steady_state(
        photons=photons, pde=0.22, cells=400.0, dark_count_rate_hz=0.0, dead_time_s=6e-9
    )
    error = np.sqrt(400 * share * (1 - share) / len(busy))
    assert abs(busy.mean() - 400 * share) < 4.0 * error + 0.004 * 400 * share
    variance = sipm.busy_variance_steady_state(busy_share=share, cells=400.0)
    assert busy.var() == pytest.approx(variance, rel=4.0 * np.sqrt(2.0 / len(busy)))
    published = 400 * sipm.fired_share_published(photons=photons, pde=0.22, cells=400.0)
    assert published - busy.mean() > 4.0 * error


@pytest.mark.parametrize("cells", [400, 10**6])
def test_few_busy_ones_of_many_cells_keep_their_digits(cells, mi):
    """Noise that rises through 1.3 cells at night, in double and in single precision; all less the free ones are not
    the busy ones there.
    """
    equipped = load_sensor("sipm-905", overrides=[f"detector.cells={cells}", "detector.dark_count_rate_hz=100"])
    rates = [
        sensor.working_point(dark).crossing_rate_hz(1.3 + dark, 1.0)
        for sensor, dark in ((equipped, np.zeros(2)), (transfer.opaque(equipped), mi.Float([0.0, 0.0])))
    ]
    np.testing.assert_allclose(rates[1].numpy(), rates[0], rtol=1e-5)


def test_fired_share_of_a_flash():
    """Independent cells under Poisson light fire with 1 - exp(-n pde / N); as printed it is pde / 2N lower."""
    rng = np.random.default_rng(4)
    photons, cells, pde = 300.0, 100, 0.22
    fired = np.mean(rng.poisson(photons * pde / cells, (20_000, cells)) > 0)
    exact = sipm.fired_share(photons=photons, pde=pde, cells=float(cells))
    assert fired == pytest.approx(exact, abs=4.0 * np.sqrt(0.25 / 2e6))
    printed = sipm.fired_share_published(photons=photons, pde=pde, cells=float(cells))
    assert 1.0 - np.log(1.0 - printed) / np.log(1.0 - exact) == pytest.approx(pde / (2 * cells), rel=0.01)


@pytest.mark.parametrize("name", ["fired_share", "fired_share_published"])
def test_response_and_its_inverse(name):
    inverse = {"fired_share": sipm.photons_for_share, "fired_share_published": sipm.photons_for_share_published}
    photons = np.geomspace(1e-3, 5e3, 50)
    share = getattr(sipm, name)(photons=photons, pde=0.22, cells=400.0)
    np.testing.assert_allclose(inverse[name](share=share, pde=0.22, cells=400.0), photons, rtol=1e-6)


def test_approximate_snr_of_few_photons():
    """(28) against (27) far from saturation, dark counts off: they meet to the cells' 1 %."""
    sensor = load_sensor(
        "table1-sipm",
        overrides=["detector.statistics='published'", "detector.cells=4000000", "detector.dark_count_rate_hz=0"],
    )
    point = sensor.working_point(2.5e-8)
    exact = point.response.signal(1e-7) / point.noise.deviation
    photon = sensor.laser.photon_energy_j
    approximate = sipm.snr_approximate(
        signal_photons=sipm.signal_photons(peak_power_w=1e-7, pulse_fwhm_s=6e-9, photon_energy_j=photon),
        background_photons=sipm.background_photons(power_w=2.5e-8, dead_time_s=6e-9, photon_energy_j=photon),
        pde=0.22,
    )
    assert exact == pytest.approx(approximate, rel=1e-3)


def test_photon_detection_efficiency_is_a_product():
    pde = reference_sipm.photon_detection_efficiency(quantum_efficiency=0.5, trigger_probability=0.8, fill_factor=0.55)
    assert pde == pytest.approx(0.22)
